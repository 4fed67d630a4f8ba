"""The picture of an identified grid: R and X of every line with their errors, and the fit through them.

matplotlib is imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...identify.files import atomic_file
from ...identify.grid_impedance import GridImpedance
from ...plant.errors import SeqsweepError
from ..report.bode import _RC, _WITHOUT_TIME
from .probe import GridSeen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#08519c", "#d94801", "#238b45", "#6a51a3", "#000000", "#8c2d04")


def plot(seen: Sequence[GridSeen], path: str | Path) -> None:
    """Draw identified grids, up to six, to a PNG, SVG or PDF file, replaced atomically.

    Raises
    ------
    SeqsweepError
        If none was identified.
    """
    if not any(each.found for each in seen):
        raise SeqsweepError("there is no identified grid to draw")
    import matplotlib

    suffix = Path(path).suffix.lower()
    with matplotlib.rc_context(_RC), atomic_file(path) as file:
        grid_figure(seen).savefig(file, format=suffix[1:], dpi=200, metadata=_WITHOUT_TIME[suffix])


def grid_figure(seen: Sequence[GridSeen]) -> Figure:
    """The figure that `plot` writes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.16, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.0, 1.4]})
    drawn = [(each, each.found) for each in seen if each.found is not None][: len(_COLOURS)]
    for (each, found), colour in zip(drawn, _COLOURS, strict=False):
        _draw(upper, found, 0, colour)
        _draw(lower, found, 1, colour)
        lower.plot([], [], color=colour, label=f"{each.op_id}: {found.r_ohm:.4g} + j{found.x_ohm:.4g} $\\Omega$")
    upper.set_ylabel(r"Re $Z_{\mathrm{grid}}$ ($\Omega$)")
    lower.set_ylabel(r"Im $Z_{\mathrm{grid}}$ ($\Omega$)")
    lower.set_xlabel("Frequency (Hz), negative sequence below zero")
    lower.legend(loc="upper left", frameon=False, title="lines with two standard deviations, and the fit")
    for axes in (upper, lower):
        axes.axvline(0.0, color="0.8", lw=0.6, zorder=0)
        axes.grid(True, color="0.92", lw=0.5)
    return figure


def _draw(axes: Axes, found: GridImpedance, part: int, colour: str) -> None:
    """Real (0) or imaginary (1) part."""
    values, fit = ((z.real, z.imag)[part] for z in (found.z, found.fitted(found.f_hz)))
    errors = np.sqrt(2.0) * found.z_std  # two standard deviations of one of the two parts
    axes.errorbar(found.f_hz, values, errors, fmt=".", ms=2.5, lw=0.6, color=colour, alpha=0.6)
    axes.plot(found.f_hz, fit, color=colour, lw=1.2)
