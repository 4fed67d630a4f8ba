"""One look for every picture, and one way of a figure to its file.

matplotlib is imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...plant.errors import SeqsweepError
from ..files import atomic_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")

WIDTH_IN = 7.16
"""Width of a figure over two columns of a report (inches)."""

# Dark to light, so that a grey copy still tells them apart, and by dashes besides.
COLOURS = ("#000000", "#8c2d04", "#08519c", "#238b45", "#e6750a", "#7b9fd4")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (1, 1)))
DEVICE, GRID, WARNING, QUIET = "#08519c", "#8c2d04", "#cb181d", "0.35"
"""Colours with a meaning: the device, the grid, what needs attention, what is only there to help."""

_RC: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "svg.hashsalt": "seqsweep",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}
_DPI = 200
_WITHOUT_TIME: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}


def write_figure(path: str | Path, make: Callable[[], Figure]) -> None:
    """Make a figure and write it, atomically; equal figures give equal bytes.

    Parameters
    ----------
    path : path
        PNG, SVG or PDF by its suffix; replaced if it exists.
    make : callable
        Gives the figure; it is called once the suffix is known to be a good one.

    Raises
    ------
    SeqsweepError
        If the suffix is another one; nothing is drawn or written.
    """
    suffix = checked_suffix(path)
    import matplotlib
    from matplotlib.backend_bases import get_registered_canvas_class

    drawn = BytesIO()  # a writer of PDF that meets a full disk half-way hides it behind errors of its own
    with matplotlib.rc_context(_RC):
        figure = make()
        figure.set_dpi(_DPI)
        canvas = get_registered_canvas_class(suffix[1:])(figure)
        getattr(canvas, f"print_{suffix[1:]}")(drawn, metadata=_WITHOUT_TIME[suffix])  # savefig draws twice
    with atomic_file(path) as file:
        file.write(drawn.getbuffer())


def styled(make: Callable[[], str]) -> str:
    """What ``make`` gives, with every figure that it draws in the common style."""
    import matplotlib

    with matplotlib.rc_context(_RC):
        return make()


def checked_suffix(path: str | Path) -> str:
    """The suffix of a picture's file, in small letters; `SeqsweepError` where no picture is written so."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        given = f"given {suffix!r}" if suffix else "given none"
        raise SeqsweepError(
            f"{path}: the suffix decides the format of the plot; {given}, needed: {', '.join(SUFFIXES)}"
        )
    return suffix


def opened_figure(height_in: float) -> Figure:
    """`new_figure` for a notebook: one that it shows."""
    import matplotlib.pyplot as plt

    from .layout import Layout

    return plt.figure(figsize=(WIDTH_IN, height_in), layout=Layout())


def new_figure(height_in: float) -> Figure:
    """An empty figure of the common width."""
    from matplotlib.figure import Figure

    from .layout import Layout

    return Figure(figsize=(WIDTH_IN, height_in), layout=Layout())


def grid_lines(axes: Axes) -> None:
    """Grid lines behind what is drawn, ticks inside."""
    axes.grid(True, which="major", linewidth=0.4, color="0.8")
    axes.grid(True, which="minor", linewidth=0.25, color="0.92")
    axes.tick_params(which="both", top=False, right=True)
    axes.set_axisbelow(True)


def escaped(text: str) -> str:
    """A name may hold a dollar sign; it does not start mathematics."""
    return text.replace("$", r"\$")
