"""What is refused of a grid."""

from __future__ import annotations

from ...plant.errors import SeqsweepError


class GridError(SeqsweepError):
    """A grid that cannot be used as given: what was given, what is needed, and the way out."""
