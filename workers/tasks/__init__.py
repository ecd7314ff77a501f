"""The skills. Each is a `Task`."""
