"""How trials reach workers: the port, and its adapters (inline for tests and debuggers, Ray for everything else)."""
