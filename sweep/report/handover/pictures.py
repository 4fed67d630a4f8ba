"""The pictures of a report, as SVG text that stands in the page itself.

matplotlib's SVG is chosen over an interactive plotting library: the page then needs no script, prints as vectors, stays
small, and has the look of every other picture of this package.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.response import FrequencyResponse
from ....identify.views.bode import MAX_OVERLAID, bode_figure
from ....identify.views.style import COLOURS, DEVICE, QUIET, WARNING, grid_lines, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def svg_of(figure: Figure, name: str) -> str:
    """The figure as an SVG element, its identifiers made unique by ``name`` so that several stand in one page."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    return re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", re.sub(r'height="[^"]*pt"', "", text, count=1), count=1)


def admittance(responses: Sequence[FrequencyResponse]) -> str:
    """Bode picture of the table, at most `MAX_OVERLAID` operating points."""
    return styled(lambda: svg_of(bode_figure(list(responses[:MAX_OVERLAID])), "bode"))


def modes(points: Sequence[Mapping[str, Any]]) -> str:
    """Closed-loop poles of every judged pair inside the swept band, upper half-plane, with 95 % intervals."""
    return styled(lambda: svg_of(_modes(points), "modes"))


def _modes(points: Sequence[Mapping[str, Any]]) -> Figure:
    figure = new_figure(3.4)
    axes = figure.add_subplot()
    axes.axvline(0.0, color=QUIET, linewidth=0.8)
    shown = [point for point in points if point.get("poles")][: len(COLOURS)]
    for colour, point in zip(COLOURS, shown, strict=False):
        poles = [p for p in point["poles"] if p["kind"] != "beyond" and p["im_rad_s"] >= 0.0]
        re, f = np.array([[p["re_rad_s"], p["f_hz"]] for p in poles]).reshape(-1, 2).T
        errors = np.array([1.96 * p["re_std_rad_s"] for p in poles])
        label = f"{point['op_id']} at scale {point['scale']:g}: {point['verdict']}"
        axes.errorbar(re, f, xerr=errors, fmt="x", color=colour, elinewidth=0.8, label=label)
    _limit(axes, [p["re_rad_s"] for point in shown for p in point["poles"] if p["kind"] in ("resonance", "slow")])
    axes.set_xlabel("Real part (1/s); right of the line a mode grows")
    axes.set_ylabel(r"Frequency $|f - f_1|$ (Hz)")
    grid_lines(axes)
    if shown:
        axes.legend(loc="upper left", frameon=False)
    return figure


def _limit(axes: Axes, decisive: Sequence[float]) -> None:
    """Show what decides: modes far to the left say nothing about stability and are cut off."""
    widest = max(20.0, *(abs(value) for value in decisive)) if decisive else 100.0
    axes.set_xlim(-12.0 * widest, max(2.0 * widest, 1.2 * max(decisive, default=0.0)))


def resonance_in_time(runs: Mapping[str, Any]) -> str:
    """The resonance's share of the current in every window, without and with damping control."""
    return styled(lambda: svg_of(_in_time(runs), "time"))


def _in_time(runs: Mapping[str, Any]) -> Figure:
    figure = new_figure(2.8)
    axes = figure.add_subplot()
    for (name, run), colour in zip(runs.items(), (WARNING, DEVICE), strict=False):
        windows = [w for w in run["windows"] if w.get("ratio") is not None]
        time = [(w["from_s"] + w["to_s"]) / 2.0 for w in windows]
        axes.semilogy(time, [100.0 * w["ratio"] for w in windows], "o-", color=colour, label=f"{name} damping control")
    axes.axhline(3.0, color=QUIET, linestyle="--", linewidth=0.8, label="control starts above")
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Resonance over fundamental (%)")
    grid_lines(axes)
    axes.legend(frameon=False)
    return figure
