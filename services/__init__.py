"""Who runs what, and what is remembered? Studies, the trial database, dispatch, the API, the command line."""
