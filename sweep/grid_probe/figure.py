"""The picture of an identified grid: R and X of every line with their errors, and the fit through them.

matplotlib is imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...identify.grid_impedance import GridImpedance
from ...identify.uncertainty import NORMAL_95
from ...identify.views.style import COLOURS, grid_lines, new_figure, write_figure
from ...plant.errors import SeqsweepError
from .probe import GridSeen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot(seen: Sequence[GridSeen], path: str | Path) -> None:
    """Draw identified grids, up to six, to a PNG, SVG or PDF file, replaced atomically.

    Raises
    ------
    SeqsweepError
        If none was identified.
    """
    if not any(each.found for each in seen):
        raise SeqsweepError("there is no identified grid to draw")
    write_figure(path, lambda: grid_figure(seen))


def grid_figure(seen: Sequence[GridSeen]) -> Figure:
    """The figure that `plot` writes."""
    figure = new_figure(4.6)
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.0, 1.4]})
    drawn = [(each, each.found) for each in seen if each.found is not None][: len(COLOURS)]
    for (each, found), colour in zip(drawn, COLOURS, strict=False):
        _draw(upper, found, 0, colour)
        _draw(lower, found, 1, colour)
        lower.plot([], [], color=colour, label=f"{each.op_id}: {found.r_ohm:.4g} + j{found.x_ohm:.4g} $\\Omega$")
    upper.set_ylabel(r"Re $Z_{\mathrm{grid}}$ ($\Omega$)")
    lower.set_ylabel(r"Im $Z_{\mathrm{grid}}$ ($\Omega$)")
    lower.set_xlabel("Frequency (Hz), negative sequence below zero")
    lower.legend(loc="upper left", frameon=False, title="lines with 95 % intervals, and the fit")
    for axes in (upper, lower):
        axes.axvline(0.0, color="0.8", lw=0.6, zorder=0)
        grid_lines(axes)
    return figure


def _draw(axes: Axes, found: GridImpedance, part: int, colour: str) -> None:
    """Real (0) or imaginary (1) part."""
    values, fit = ((z.real, z.imag)[part] for z in (found.z, found.fitted(found.f_hz)))
    errors = NORMAL_95 * found.z_std / np.sqrt(2.0)  # of one of the two parts
    axes.errorbar(found.f_hz, values, errors, fmt=".", ms=2.5, lw=0.6, color=colour, alpha=0.6)
    axes.plot(found.f_hz, fit, color=colour, lw=1.2)
