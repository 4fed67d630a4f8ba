"""Running a plan: batches through joblib, child processes, shards on disk, the table at the end."""
