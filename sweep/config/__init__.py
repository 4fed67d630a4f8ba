"""The configuration of a campaign: its sections, its file and its checks."""
