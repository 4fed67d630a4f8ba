"""The pure worker of a campaign: from a batch of shots to rows of the table."""
