"""The map of a bank, grid by operating point, and the damping of every pair."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...tuning.bank.judgement import PairVerdict
from ...tuning.style import QUIET, WARNING, grid_lines, new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VERDICTS = ("stable", "undecided", "unstable", "failed")
COLOURS = ("#9ecae1", "#fdd49e", "#cb181d", "0.75")
LABELLED = 40
"""Grids up to which each has its name on the axis."""


def plot_bank(verdicts: Sequence[PairVerdict], f1_hz: float, path: Path) -> None:
    """Draw the map and the damping, and write them to one file."""
    write_figure(path, lambda: bank_figure(verdicts, f1_hz))


def bank_figure(verdicts: Sequence[PairVerdict], f1_hz: float) -> Figure:
    """Above the map of verdicts, grids from the worst to the best; below, the real part of each deciding mode."""
    grids = list(dict.fromkeys(v.grid_id for v in verdicts))
    points = sorted({v.op_id for v in verdicts})
    figure = new_figure(2.9 + 0.28 * max(len(points), 3))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[max(len(points), 3) * 0.22 + 0.5, 2.2])
    _draw_map(above, verdicts, grids, points)
    _draw_damping(below, verdicts, grids, points, f1_hz)
    return figure


def _draw_map(axes: Axes, verdicts: Sequence[PairVerdict], grids: list[str], points: list[str]) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    row, column = _places(points), _places(grids)
    cells = np.full((len(points), len(grids)), np.nan)
    for v in verdicts:
        kind = v.verdict if v.status == "ok" else "failed"
        cells[row[v.op_id], column[v.grid_id]] = VERDICTS.index(kind)
    axes.imshow(cells, aspect="auto", cmap=ListedColormap(COLOURS), vmin=-0.5, vmax=3.5, interpolation="nearest")
    axes.set_yticks(range(len(points)), points)
    axes.set_ylabel("operating point")
    shown = [k for k in range(4) if np.any(cells == k)]
    counts = {k: int(np.sum(cells == k)) for k in shown}
    handles = [Patch(facecolor=COLOURS[k], edgecolor="0.4", label=f"{VERDICTS[k]} ({counts[k]})") for k in shown]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    axes.tick_params(top=False, right=False)


def _places(names: Sequence[str]) -> dict[str, int]:
    return {name: k for k, name in enumerate(names)}


def _draw_damping(
    axes: Axes, verdicts: Sequence[PairVerdict], grids: list[str], points: list[str], f1_hz: float
) -> None:
    column = _places(grids)
    known = [
        (column[v.grid_id], v.re_rad_s, abs(v.im_rad_s) / (2.0 * np.pi), v.re_std_rad_s or 0.0)
        for v in verdicts
        if v.re_rad_s is not None and v.im_rad_s is not None
    ]
    x, re, nu, std = np.array(known, dtype=float).reshape(-1, 4).T
    grid_lines(axes)
    axes.axhline(0.0, color=WARNING, linewidth=0.8)
    axes.errorbar(x, re, yerr=1.96 * std, fmt="none", ecolor=QUIET, elinewidth=0.6, zorder=1)
    drawn = axes.scatter(x, re, c=f1_hz + nu, s=14 if len(known) <= 400 else 5, cmap="viridis", zorder=2)
    axes.figure.colorbar(drawn, ax=axes, label="mode, upper component (Hz)", pad=0.01)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylabel("Re of the deciding mode (rad/s)\nbars: 95 %")
    if len(grids) <= LABELLED:
        axes.set_xticks(range(len(grids)), grids, rotation=90, fontsize=7)
    axes.set_xlabel(f"grid, the worst first ({len(grids)})")
    axes.set_xlim(-0.5, len(grids) - 0.5)
