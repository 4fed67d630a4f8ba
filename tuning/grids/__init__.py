"""The grid behind the PCC: a promise, and everything that keeps it."""
