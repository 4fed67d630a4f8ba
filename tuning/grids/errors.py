"""What is refused of a grid."""

from __future__ import annotations


class GridError(ValueError):
    """A grid that cannot be used as given: what was given, what is needed, and the way out."""
