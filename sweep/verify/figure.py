"""The picture of a verification: power, resonance current, r(t) and frequency, without and with damping control.

matplotlib is imported when a figure is made.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...identify.views.style import escaped, new_figure, opened_figure, write_figure
from ...plant.damping.events import Event, Fault, Trajectory
from .report import events_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .runs import Verification

_WITHOUT: dict[str, Any] = {"color": "#f2a35c", "lw": 1.8, "zorder": 2}  # wide and light: seen beneath a dark twin
_WITH: dict[str, Any] = {"color": "#08306b", "lw": 1.1, "zorder": 3}


HEIGHT_IN = 7.2

TITLE_COLUMNS = 95
"""Letters that a line above a picture holds."""


class Curve(NamedTuple):
    """A trajectory as it is drawn."""

    label: str
    trajectory: Trajectory
    style: dict[str, Any]


def plot(result: Verification, path: str | Path) -> None:
    """Draw a verification to a PNG, SVG or PDF file, replaced atomically.

    Raises
    ------
    SeqsweepError
        If the suffix is another one; nothing is written.
    """
    write_figure(path, lambda: verification_figure(result))


def verification_figure(result: Verification) -> Figure:
    """The figure that `plot` writes."""
    figure = new_figure(HEIGHT_IN)
    draw(panels(figure), result)
    return figure


def shown(result: Verification, ax: Any = None) -> Any:
    """The figure for a notebook: drawn into axes (4,), or a figure that is opened for them."""
    if ax is None:
        ax = panels(opened_figure(HEIGHT_IN))
    draw(ax, result)
    return ax


def panels(figure: Figure) -> np.ndarray:
    """Axes (4,) for `draw`, one below the other."""
    return np.asarray(figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": [1.1, 1.1, 1, 1]}))


def draw(axes: np.ndarray, result: Verification) -> None:
    """Draw power, resonance current, r(t) and frequency of both runs into axes (4,), and name their figure."""
    curves = tuple(_curves(result))
    last = curves[-1].trajectory
    draw_power(axes[0], curves)
    draw_resonance_current(axes[1], curves)
    draw_ratio(axes[2], curves, result.threshold)
    draw_frequency(axes[3], curves)
    for each in axes:
        mark_times(each, result.scenario.events, last, named=each is axes[0])
    for each in axes[2:]:
        mark_unknown(each, last)
    axes[3].set_xlabel("t (s)")
    axes[3].set_xlim(0.0, result.duration_s)
    handles, labels = axes[0].get_legend_handles_labels()
    figure = axes[0].figure
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    z = result.tuned.grid.at_f1
    head = (
        f"{result.tuned.plant.id} at {result.scenario.active_power_w / 1e6:.3g} MW, "
        rf"tuned grid {z.real:.3g} + j{z.imag:.3g} $\Omega$"
    )
    figure.suptitle("\n".join([head, *told_below(events_in_words(result.scenario.events))]), fontsize=10)


def told_below(events: str) -> list[str]:
    """What happens, in lines that fit below the head of a picture."""
    return [escaped(line) for line in textwrap.wrap(events, TITLE_COLUMNS)]


def _curves(result: Verification) -> Iterable[Curve]:
    yield Curve("without damping control", result.without, _WITHOUT)
    if result.damped is not None and result.settings is not None:
        k = f"k = {result.settings.k:.3g}"
        name = f"with damping control, {k}" if result.damped.started_s else f"damping control, {k}, never started"
        yield Curve(name, result.damped, _WITH)


def draw_power(axes: Axes, curves: tuple[Curve, ...]) -> None:
    """P at the PCC (MW) until synchronism is lost, with a cross there."""
    label = "synchronism lost"  # once in the legend, however many lose it
    for curve in curves:
        t, p = _until_lost(curve.trajectory, curve.trajectory.p_w / 1e6)
        axes.plot(t, p, label=curve.label, **curve.style)
        if curve.trajectory.lost_s is not None:
            where = axes.get_xaxis_transform()
            style: dict[str, Any] = {"color": "#a50f15", "marker": "x", "ls": "none", "ms": 7, "mew": 1.6, "zorder": 4}
            axes.plot([curve.trajectory.lost_s], [0.08], transform=where, label=label, **style)
            label = "_nolegend_"
    axes.set_ylabel("P (MW)")
    quiet(axes)
    without_spikes(axes)


def draw_resonance_current(axes: Axes, curves: tuple[Curve, ...]) -> None:
    """i_alpha less its fundamental (A)."""
    for curve in curves:
        t, i = _until_lost(curve.trajectory, resonance_current(curve.trajectory).real)
        axes.plot(t, i, label=curve.label, **curve.style)
    axes.set_ylabel(r"$i_{\alpha,r}$ (A)")
    quiet(axes)
    without_spikes(axes)


def draw_ratio(axes: Axes, curves: tuple[Curve, ...], threshold: float) -> None:
    """r(t) in percent on a logarithmic scale, with the threshold."""
    for curve in curves:
        t, r = _decided(curve.trajectory, curve.trajectory.ratio)
        axes.semilogy(t, 100.0 * np.maximum(r, 1e-5), label=curve.label, **{**curve.style, "lw": 1.2})
    axes.axhline(100.0 * threshold, color="0.3", lw=0.8, ls=(0, (4, 2)))
    axes.annotate(
        f"{100.0 * threshold:g} %", (1.0, 100.0 * threshold), xycoords=("axes fraction", "data"), xytext=(-2, 2),
        textcoords="offset points", fontsize=8, ha="right", color="0.3",
    )  # fmt: skip
    axes.set_ylim(0.02, 200.0)
    axes.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    axes.set_ylabel("r (%)")
    quiet(axes)


def draw_frequency(axes: Axes, curves: tuple[Curve, ...], least: float = 2e-3, both: bool = False) -> None:
    """Frequency of the stronger component (Hz) where r is more than ``least``; ``both``: and its mirror, smaller."""
    for curve in curves:
        trajectory = curve.trajectory
        t, f = _decided(trajectory, np.where(trajectory.ratio > least, trajectory.resonance_hz, np.nan))
        axes.plot(t, f, ".", ms=2.5, color=curve.style["color"], label=curve.label)
        if both:
            axes.plot(t, 2.0 * trajectory.f1_hz - f, ".", ms=1.2, color=curve.style["color"])
    axes.axhline(curves[0].trajectory.f1_hz, color="0.35", lw=0.7, ls=(0, (2, 2)))
    axes.set_ylim(0.0, 2.0 * curves[0].trajectory.f1_hz)
    axes.set_ylabel("stronger\ncomponent (Hz)")
    quiet(axes)


def resonance_current(trajectory: Trajectory) -> np.ndarray:
    """i less its fundamental (A), both as space vectors: the mean over two periods around each moment is taken off."""
    dt_s = float(trajectory.time_s[1] - trajectory.time_s[0])
    turn = np.exp(-2j * np.pi * trajectory.f1_hz * trajectory.time_s)
    n = round(2.0 / (trajectory.f1_hz * dt_s))
    slow = np.where(np.isfinite(trajectory.i), trajectory.i, 0.0) * turn
    padded = np.concatenate([np.full(n, slow[:n].mean()), slow, np.full(n, slow[-n:].mean())])
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    first = np.arange(len(slow)) + n - n // 2
    return trajectory.i - (sums[first + n] - sums[first]) / n / turn


def mark_times(axes: Axes, events: tuple[Event, ...], damped: Trajectory, named: bool) -> None:
    """Events as dotted lines or grey spans, start and stop of damping control as dashed lines."""
    for event in events:
        if isinstance(event, Fault):
            axes.axvspan(event.time_s, event.time_s + event.duration_s, color="0.85", lw=0, zorder=0)
        axes.axvline(event.time_s, color="0.3", lw=0.8, ls=":")
    marks = [(time_s, "on") for time_s in damped.started_s] + [(time_s, "off") for time_s in damped.stopped_s]
    for time_s, name in marks:
        axes.axvline(time_s, color=_WITH["color"], lw=0.8, ls=(0, (4, 2)))
        if named:
            axes.annotate(
                name, (time_s, 0.97), xycoords=("data", "axes fraction"), xytext=(2, 0),
                textcoords="offset points", fontsize=8, va="top", color=_WITH["color"],
            )  # fmt: skip


def mark_unknown(axes: Axes, trajectory: Trajectory) -> None:
    """A light span where nothing is known: blocked, or the analysis buffer not yet full again."""
    unknown = np.isnan(trajectory.ratio).astype(int)
    edges = np.flatnonzero(np.diff(unknown, prepend=0, append=0))
    for first, last in zip(edges[0::2], edges[1::2], strict=True):
        axes.axvspan(trajectory.decision_s[first], trajectory.decision_s[last - 1], color="0.93", lw=0, zorder=0)


def without_spikes(axes: Axes) -> None:
    """Limits that a capacitor's discharge of less than 0.2 % of the time does not decide."""
    values = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    bounds = np.array([np.nanquantile(each, (0.001, 0.999)) for each in values if len(each) > 2])
    low, high = float(bounds[:, 0].min()), float(bounds[:, 1].max())
    room = 0.1 * max(high - low, 1e-3)
    axes.set_ylim(low - room, high + room)


def quiet(axes: Axes) -> None:
    """Grid lines behind, ticks inside."""
    axes.grid(True, lw=0.4, color="0.85")
    axes.set_axisbelow(True)


def _until_lost(trajectory: Trajectory, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kept = trajectory.time_s <= (np.inf if trajectory.lost_s is None else trajectory.lost_s)
    return trajectory.time_s[kept], values[kept]


def _decided(trajectory: Trajectory, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kept = trajectory.decision_s <= (np.inf if trajectory.lost_s is None else trajectory.lost_s)
    return trajectory.decision_s[kept], values[kept]
