"""The figures of docs/paper.md, readable in grey."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from simulated import Run, Story
from swept import K_PAPER, Study, crossing_of, mode_of, moved_poles, pair_of, siso_of

from seqsweep.plant.damping.control import THRESHOLD, notch
from seqsweep.sweep.verify.figure import (
    Curve,
    draw_frequency,
    draw_power,
    draw_ratio,
    draw_resonance_current,
    mark_times,
    mark_unknown,
    quiet,
    resonance_current,
    without_spikes,
)

_RC: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "axes.titlesize": 9.0,
}
_BLACK: dict[str, Any] = {"color": "#000000", "lw": 1.3}
_GRID: dict[str, Any] = {"color": "#b35806", "lw": 1.2, "ls": (0, (5, 2))}
_PAPER: dict[str, Any] = {"color": "#08519c", "lw": 1.2, "ls": (0, (6, 1.5, 1, 1.5))}
_OURS: dict[str, Any] = {"color": "#4d9221", "lw": 1.3, "ls": (0, (1.5, 1))}
_IN_TIME: tuple[dict[str, Any], ...] = (
    {"color": "#f2a35c", "lw": 1.8, "zorder": 2},
    {"color": "#08306b", "lw": 1.1, "zorder": 3},
    {"color": "#5a5a5a", "lw": 1.1, "ls": (0, (4, 1.5)), "zorder": 4},
)
WIDTH = 7.16
"""Of a figure as wide as the paper's page (inches)."""


def draw_all(
    folder: Path, study: Study, steps: Sequence[Story], wider: Sequence[Story], faults: Sequence[Story]
) -> None:
    """Write every figure into ``folder``."""
    figures = {
        "bode": lambda: bode(study),
        "notch": notch_bode,
        "reshaped": lambda: reshaped(study),
        "poles": lambda: poles(study),
        "time": lambda: grid_steps(steps),
        "scenarios": lambda: scenarios(wider),
        "faults": lambda: fault_rides(faults),
    }
    save_all(folder, figures)


def save_all(folder: Path, figures: Mapping[str, Callable[[], Figure]]) -> None:
    """Draw each figure in the paper's style and write it as paper-NAME.png into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(_RC):
        for name, figure in figures.items():
            figure().savefig(folder / f"paper-{name}.png", dpi=170, metadata={"Software": None})


# Sections II and III -------------------------------------------------------------------------------------------------


def bode(study: Study) -> Figure:
    """SISO equivalents on 1.0, 1.2 and 1.4 Z, each at the operating point that belongs to the grid."""
    figure = Figure(figsize=(WIDTH, 7.4), layout="constrained")
    axes = figure.subplots(4, 3, sharex=True, sharey="row", gridspec_kw={"height_ratios": [3, 2, 3, 2]})
    f = _frequencies()
    for column, scale in enumerate((1.0, 1.2, 1.4)):
        point = study.point(0.65, scale)
        pole, _ = mode_of(point)
        low, high = pair_of(point)
        pair = siso_of(point, scale, f)
        crossing_hz, m = crossing_of(point)
        for row, (device, grid, name, mode_hz, at_hz) in enumerate(
            (
                (pair.y1, pair.yg1, "1", high, crossing_hz),
                (pair.y2, pair.yg2, "2", low, 100.0 - crossing_hz),
            )
        ):
            magnitude, phase = axes[2 * row, column], axes[2 * row + 1, column]
            _pair(magnitude, phase, f, [(device, _BLACK, f"$Y^{name}$ device")], grid, name)
            magnitude.axvline(mode_hz, color="0.45", lw=0.9, ls=":")
            phase.axvline(mode_hz, color="0.45", lw=0.9, ls=":")
            phase.plot([at_hz], [180.0], "o", color="#a50f15", ms=4, zorder=5)
            _note(magnitude, f"mode {mode_hz:.1f} Hz\ncrossing {at_hz:.1f} Hz\n$m$ = {m:.2f}")
        axes[0, column].set_title(f"{scale:.1f} Z: {point.verdict}, {pole.real:+.1f} rad/s")
        axes[3, column].set_xlabel("f (Hz)")
    _bode_labels(axes)
    return figure


def reshaped(study: Study) -> Figure:
    """Y1 and Y2 at 0.65 MW on 1.4 Z: without damping, with k = 0.5, with the tuned k; all swept."""
    k = study.search.k
    cases = ((0.0, _BLACK), (K_PAPER, _PAPER), (k, _OURS))
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": [3, 2]})
    f = _frequencies()
    for column in range(2):
        curves = []
        for gain, style in cases:
            found = siso_of(study.point(0.65, 1.4, gain), 1.4, f)
            curves.append((found[1 + column], style, f"device, k = {gain:.3g}" if gain else "device, no damping"))
        grid = siso_of(study.point(0.65, 1.4), 1.4, f)[3 + column]
        _pair(axes[0, column], axes[1, column], f, curves, grid, str(column + 1))
        for gain, style in cases:
            at_hz = crossing_of(study.point(0.65, 1.4, gain))[0]
            shown = at_hz if column == 0 else 100.0 - at_hz
            axes[1, column].plot([shown], [180.0], "o", color=style["color"], ms=4, zorder=5)
        axes[1, column].set_xlabel("f (Hz)")
        axes[0, column].set_title(f"$Y^{column + 1}$ against the grid's")
    margins = ", ".join(f"{crossing_of(study.point(0.65, 1.4, gain))[1]:.2f}" for gain, _ in cases)
    _note(axes[0, 0], f"$m$ = {margins}")
    axes[0, 0].legend(loc="lower right", fontsize=7.5, frameon=False)
    axes[0, 0].set_ylabel("Magnitude (S)")
    axes[1, 0].set_ylabel("$\\angle\\, Y/Y_g$ (deg)")
    return figure


def notch_bode() -> Figure:
    """The designed notch, G0 = 1 and xi = 0.01."""
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    distance = np.geomspace(1e-3, 40.0, 400)
    f = np.sort(np.concatenate([50.0 - distance, 50.0 + distance, np.linspace(90.0, 200.0, 200)]))
    h = notch(f)
    magnitude.plot(f, 20.0 * np.log10(np.abs(h)), **_BLACK)
    angle = np.degrees(np.angle(h))
    phase.plot(f[f < 50.0], angle[f < 50.0], **_BLACK)
    phase.plot(f[f > 50.0], angle[f > 50.0], **_BLACK)
    for axes in (magnitude, phase):
        quiet(axes)
        for f_hz in (23.0, 77.0):
            axes.axvline(f_hz, color="0.45", lw=0.9, ls=":")
    magnitude.set_ylabel("|$H_{NF}$| (dB)")
    magnitude.set_ylim(-40.0, 3.0)
    phase.set_ylabel("Phase (deg)")
    phase.set_yticks([-90, -45, 0, 45, 90])
    phase.set_xlabel("f (Hz); dotted: 23 and 77 Hz")
    phase.set_xlim(10.0, 120.0)
    return figure


def poles(study: Study) -> Figure:
    """Closed-loop poles at 0.65 MW on 1.4 Z, and the mode's damping over power, before and after."""
    k = study.search.k
    cases = (
        (0.0, "no damping", "x", "#000000"),
        (K_PAPER, f"k = {K_PAPER}", "o", "#08519c"),
        (k, f"k = {k:.2f}", "^", "#4d9221"),
    )
    figure = Figure(figsize=(WIDTH, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for gain, label, marker, colour in cases:
        moved = moved_poles(study.point(0.65, 1.4, gain))
        style = {"color": colour, "ls": "none", "marker": marker, "ms": 6, "mew": 1.4, "fillstyle": "none"}
        left.plot(moved.real, moved.imag / (2.0 * np.pi), label=label, **style)
        powers = (0.60, 0.65, 0.70)
        damping = [100.0 * mode_of(study.point(p, 1.4, gain))[1] for p in powers]
        right.plot(powers, damping, color=colour, marker=marker, lw=1.0, ms=6, fillstyle="none", label=label)
        for power, value in zip(powers, damping, strict=True):
            right.annotate(f"{value:.1f}", (power, value), xytext=(5, 4), textcoords="offset points", fontsize=7.5)
    right.plot([0.65], [-10.9], "s", color="0.4", ms=5, label="paper, before and after")
    right.plot([0.65], [10.1], "s", color="0.4", ms=5)
    for axes in (left, right):
        quiet(axes)
    left.legend(fontsize=7.5, loc="lower left", bbox_to_anchor=(0.0, 0.1))
    right.legend(fontsize=7.5, loc="upper right", bbox_to_anchor=(1.0, 0.78), framealpha=1.0)
    left.axvline(0.0, color="k", lw=0.8)
    left.set_xlabel("Real part (rad/s)")
    left.set_ylabel(r"|Im|/2$\pi$ in dq (Hz)")
    left.set_xlim(-70.0, 20.0)
    left.set_ylim(-2.0, 55.0)
    left.set_title("poles that the grid moves, 0.65 MW, 1.4 Z")
    right.axhline(0.0, color="k", lw=0.8)
    right.set_xlim(0.585, 0.735)
    right.set_xlabel("Active power (MW)")
    right.set_ylabel("Damping of the resonance (%)")
    right.set_title("damping over power, 1.4 Z")
    return figure


def _frequencies() -> np.ndarray:
    f = np.unique(np.concatenate([np.linspace(10.0, 49.8, 400), np.linspace(50.2, 120.0, 500)]))
    return f[np.abs(f - 50.0) > 0.1]


def _pair(
    magnitude: Axes,
    phase: Axes,
    f: np.ndarray,
    devices: list[tuple[np.ndarray, dict[str, Any], str]],
    grid: np.ndarray,
    name: str,
) -> None:
    for device, style, label in devices:
        magnitude.semilogy(f, np.abs(device), label=label, **style)
        angle = np.degrees(np.angle(device / grid)) % 360.0
        angle[1:][np.abs(np.diff(angle)) > 180.0] = np.nan
        phase.plot(f, angle, **style)
    magnitude.semilogy(f, np.abs(grid), label=f"$Y_g^{name}$ grid", **_GRID)
    phase.axhline(180.0, color="0.5", lw=0.8)
    phase.set_yticks([0, 90, 180, 270, 360])
    magnitude.set_ylim(0.08, 30.0)
    magnitude.set_xlim(f[0], f[-1])
    for axes in (magnitude, phase):
        quiet(axes)


def _note(axes: Axes, text: str, x: float = 0.03) -> None:
    axes.text(
        x, 0.05, text, transform=axes.transAxes, fontsize=7.5, va="bottom",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )  # fmt: skip


def _bode_labels(axes: np.ndarray) -> None:
    for row in (0, 2):
        axes[row, 0].set_ylabel("Magnitude (S)")
        axes[row, 2].legend(loc="lower right", fontsize=7.5, frameon=False)
        axes[row + 1, 0].set_ylabel("$\\angle\\, Y/Y_g$ (deg)")


# Sections IV to VI ---------------------------------------------------------------------------------------------------


def grid_steps(stories: Sequence[Story]) -> Figure:
    """1.2 Z to 1.4 Z at 0.1 s: power, resonance current, r(t) and both frequencies."""
    figure = Figure(figsize=(WIDTH, 7.2), layout="constrained")
    axes = figure.subplots(4, len(stories), sharex=True, sharey="row")
    for column, story in enumerate(stories):
        curves = _curves(story.runs)
        draw_power(axes[0, column], curves)
        draw_resonance_current(axes[1, column], curves)
        draw_ratio(axes[2, column], curves, THRESHOLD)
        draw_frequency(axes[3, column], curves, both=True)
        for row in range(4):
            mark_times(axes[row, column], story.scenario.events, story.runs[1].trajectory, named=row == 0)
        axes[0, column].set_title(story.title)
        axes[3, column].set_xlabel("t (s)")
        axes[3, column].set_xlim(0.0, 1.2)
    _labels_left_only(axes)
    axes[3, 0].set_ylabel("components (Hz)")
    _legend_below(figure, axes[0, 0])
    return figure


def scenarios(stories: Sequence[Story]) -> Figure:
    """Scenarios 1 to 3: active power from SCR 1.8 to weaker grids and to more turbines."""
    figure = Figure(figsize=(WIDTH, 7.0), layout="constrained")
    axes = figure.subplots(4, 2, sharex=True)
    for each, story in zip(axes.T.ravel(), stories, strict=False):
        draw_power(each, _curves(story.runs))
        mark_times(each, story.scenario.events, story.runs[-1].trajectory, named=True)
        each.set_title(story.title)
        each.set_ylim(0.0, 2.2)
        if not story.has_equilibrium:
            _note(each, "no operating point carries 1.1 MW here", x=0.36)
    resonant = stories[-2]
    draw_ratio(axes[3, 1], _curves(resonant.runs), THRESHOLD)
    mark_times(axes[3, 1], resonant.scenario.events, resonant.runs[-1].trajectory, named=True)
    axes[3, 1].set_title(f"{resonant.title}: r(t)")
    for each in axes[3]:
        each.set_xlabel("t (s)")
        each.set_xlim(0.0, 1.0)
    _legend_below(figure, axes[2, 0])
    return figure


def fault_rides(stories: Sequence[Story]) -> Figure:
    """Scenario 4: PCC voltage, resonance current and r(t) through faults of 40 ms; damping control armed."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    axes = figure.subplots(3, len(stories), sharex=True, sharey="row")
    for column, story in enumerate(stories):
        (run,) = story.runs
        trajectory = run.trajectory
        v_pu = trajectory.v.real / (690.0 * (2.0 / 3.0) ** 0.5)
        axes[0, column].plot(trajectory.time_s, v_pu, color="#08306b", lw=0.6)
        axes[1, column].plot(trajectory.time_s, resonance_current(trajectory).real, color="#08306b", lw=0.8)
        draw_ratio(axes[2, column], (Curve("", trajectory, {"color": "#08306b"}),), THRESHOLD)
        for row in range(3):
            quiet(axes[row, column])
            mark_times(axes[row, column], story.scenario.events, trajectory, named=False)
        mark_unknown(axes[2, column], trajectory)
        axes[0, column].set_title(f"{story.title}: {'started' if run.report.started_s else 'no start'}")
        axes[0, column].set_ylim(-1.6, 1.6)
        axes[2, column].set_xlabel("t (s)")
        axes[2, column].set_xlim(0.0, 1.0)
    without_spikes(axes[1, 0])
    _labels_left_only(axes)
    for row, text in enumerate((r"$v_\alpha$ (pu)", r"$i_{\alpha,r}$ (A)", "r (%)")):
        axes[row, 0].set_ylabel(text)
    return figure


def _curves(runs: Sequence[Run]) -> tuple[Curve, ...]:
    return tuple(Curve(run.gain.label, run.trajectory, style) for run, style in zip(runs, _IN_TIME, strict=False))


def _labels_left_only(axes: np.ndarray) -> None:
    for each in axes[:, 1:].ravel():
        each.set_ylabel("")


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
