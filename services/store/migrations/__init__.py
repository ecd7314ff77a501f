"""Migrations of the trial database, run by `services.store.upgrade`."""
