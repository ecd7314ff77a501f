"""The service over HTTP: versioned REST under /api/v1, and a WebSocket that carries events from a cursor."""
