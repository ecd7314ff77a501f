"""The trial database: the only truth."""
