"""The `identify` command: from files of recordings to a table."""
