"""Summaries and pictures of a table."""
