"""The look of every picture stands in `identify.views.style`; this name stays for one release."""

from ..identify.views.style import (
    COLOURS,
    DASHES,
    DEVICE,
    GRID,
    QUIET,
    SUFFIXES,
    WARNING,
    WIDTH_IN,
    escaped,
    grid_lines,
    new_figure,
    write_figure,
)

__all__ = [
    "COLOURS",
    "DASHES",
    "DEVICE",
    "GRID",
    "QUIET",
    "SUFFIXES",
    "WARNING",
    "WIDTH_IN",
    "escaped",
    "grid_lines",
    "new_figure",
    "write_figure",
]
