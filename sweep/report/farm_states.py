"""The map of a farm's switching states: verdicts, and where the modes of each state stand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from ...identify.views.style import DEVICE, QUIET, WARNING, grid_lines, new_figure, write_figure
from ...tuning.farm.states import StateVerdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"stable": DEVICE, "unstable": WARNING, "undecided": "#e6750a"}
NAMED = 40
"""States up to which each has its name on the axis."""


def plot_states(path: str | Path, states: Sequence[StateVerdict]) -> None:
    """Draw the map and write it; see `write_figure`."""
    write_figure(path, lambda: states_figure(states))


def states_figure(states: Sequence[StateVerdict]) -> Figure:
    """Above the real part of every sub-synchronous mode by state, below the frequency of the critical one and m."""
    figure = new_figure(4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _draw_growth(above, states)
    _draw_margin(below, states)
    below.set_xticks(range(len(states)))
    names = ["\n".join(wrap(found.state.name, 30)) for found in states]
    below.set_xticklabels(names if len(states) <= NAMED else [], rotation=40, ha="right", rotation_mode="anchor")
    below.set_xlim(-0.6, len(states) - 0.4)
    return figure


def _draw_growth(axes: Axes, states: Sequence[StateVerdict]) -> None:
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    for k, found in enumerate(states):
        if found.farm is None:
            axes.axvspan(k - 0.4, k + 0.4, color="0.85", linewidth=0.0)
            continue
        colour = COLOURS[found.verdict]
        near = [m for m in found.farm.judgement.modes if m.pole.imag <= 2.4 * np.pi * found.farm.entry.f1_hz]
        axes.plot([k] * len(near), [m.pole.real for m in near], "_", color="0.6", markersize=8)
        critical = max(near, key=lambda m: m.pole.real, default=None)
        if critical is not None:
            error = 1.96 * critical.std.real
            axes.errorbar([k], [critical.pole.real], yerr=[error], fmt="o", color=colour, markersize=4, elinewidth=0.8)
            nu, f1 = critical.pole.imag / (2.0 * np.pi), found.farm.entry.f1_hz
            text = f"{f1 - nu:.0f}/{f1 + nu:.0f}"
            where = (k, critical.pole.real)
            if len(states) <= NAMED:
                axes.annotate(text, where, (0, 5), textcoords="offset points", fontsize=6.5, ha="center")
    axes.set_yscale("symlog", linthresh=10.0)
    low, high = axes.get_ylim()
    ticks = [sign * size for size in (1000, 300, 100, 30, 10) for sign in (-1, 1)]
    axes.set_yticks([0, *(tick for tick in ticks if low <= tick <= high)])
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel(r"Re of the modes up to 1.2 $f_1$ (1/s)")
    axes.margins(y=0.12)
    _legend(axes, states)
    grid_lines(axes)


def _legend(axes: Axes, states: Sequence[StateVerdict]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Line2D | Patch] = [
        Line2D([], [], marker="o", linestyle="", markersize=4, color=colour, label=f"{kind} ({n})")
        for kind, colour in COLOURS.items()
        if (n := sum(found.verdict == kind for found in states))
    ]
    if n := sum(found.farm is None for found in states):
        handles.append(Patch(color="0.85", label=f"no operating point ({n})"))
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)


def _draw_margin(axes: Axes, states: Sequence[StateVerdict]) -> None:
    m = np.array([np.nan if found.crossing is None else found.crossing.m for found in states])
    gone = np.array([found.cause_gone for found in states])
    x = np.arange(len(states))
    axes.axhline(1.0, color=QUIET, linewidth=0.8)
    axes.plot(x[gone], m[gone], "s", color=DEVICE, markersize=4, label="damping control may stop")
    axes.plot(x[~gone], m[~gone], "s", color=WARNING, markersize=4, label="it may not")
    axes.set_ylabel("Bode margin $m$ at the source")
    axes.legend(loc="best", frameon=False, fontsize=7.5)
    grid_lines(axes)
