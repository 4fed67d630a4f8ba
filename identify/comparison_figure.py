"""The picture of a comparison: both admittances, and their difference against what both state of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .views.style import DEVICE, GRID, QUIET, WARNING, escaped, grid_lines, new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .comparison import Comparison

NAMED = 3
"""Worst places that are named in the picture."""


def plot_comparison(comparison: Comparison, path: str | Path, names: Sequence[str] = ("first", "second")) -> None:
    """Draw a comparison to a PNG, SVG or PDF file; see `write_figure`."""
    write_figure(path, lambda: comparison_figure(comparison, names))


def comparison_figure(comparison: Comparison, names: Sequence[str] = ("first", "second")) -> Figure:
    """Above the four magnitudes of both, below the relative difference, its 95 % region and the worst places."""
    figure = new_figure(6.2)
    above, below = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=[1.35, 1.0])))
    _draw_magnitudes(np.asarray(above.subplots(2, 2, sharex=True, sharey=True)).ravel(), comparison, names)
    _draw_difference(below.subplots(), comparison)
    agree = "agree" if comparison.agrees else "do not agree"
    figure.suptitle(escaped(f"{comparison.op_a} and {comparison.op_b}: {agree} within their uncertainty"), fontsize=10)
    return figure


def _draw_magnitudes(axes: np.ndarray, comparison: Comparison, names: Sequence[str]) -> None:
    f = comparison.f_hz
    for k, element in enumerate(("pp", "pn", "np", "nn")):
        for y, colour, style, name in (
            (comparison.y_b, GRID, "-", names[1]),
            (comparison.y_a, DEVICE, "--", names[0]),
        ):
            size = np.abs(y.reshape(-1, 4)[:, k])
            axes[k].plot(f, np.where(size > 0.0, size, np.nan), style, color=colour, label=escaped(str(name)))
        axes[k].set_title(f"$|Y_{{{element}}}|$ (S)", fontsize=9)
        axes[k].set_xscale("log")
        axes[k].set_yscale("log")
        grid_lines(axes[k])
    axes[0].figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)


def _draw_difference(axes: Axes, comparison: Comparison) -> None:
    f, relative, region = comparison.f_hz, comparison.relative, comparison.region
    seen = np.where(relative > 0.0, relative, np.nan)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axhline(max(comparison.tolerance, 1e-16), color=QUIET, linewidth=0.8, linestyle=":", label="tolerance")
    if np.isfinite(region).any():
        axes.plot(f, region, color=QUIET, linewidth=0.9, label="95 % region of the difference")
    matched = ~comparison.interpolated
    axes.plot(f[matched], seen[matched], ".", color=DEVICE, label="row against row")
    if comparison.interpolated.any():
        axes.plot(f[~matched], seen[~matched], "x", color=DEVICE, markersize=4, label="row against interpolation")
    for where, value in comparison.worst(NAMED):
        if value > 0.0:
            axes.plot([where], [value], "o", color=WARNING, fillstyle="none")
            axes.annotate(f"{where:.4g} Hz", (where, value), xytext=(4, 3), textcoords="offset points", fontsize=8)
    axes.set_xlabel("f (Hz)")
    axes.set_ylabel(r"$\|\Delta Y\| / \|Y\|$")
    grid_lines(axes)
    axes.legend(fontsize=8, loc="best")
