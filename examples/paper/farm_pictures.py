"""The farm's figures in time, readable in grey."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pictures import WIDTH, save_all

from seqsweep.plant.damping.events import Trajectory
from seqsweep.sweep.verify.farm_runs import FarmRun

_WITHOUT: dict[str, Any] = {"color": "#f2a35c", "lw": 1.0, "zorder": 2}
_WITH: dict[str, Any] = {"color": "#08306b", "lw": 0.8, "zorder": 3}
_DASHES: tuple[Any, ...] = ((0, (1, 1)), (0, (4, 1)), "-")
_SHOWN = ("1.1 Z", "1.25 Z", "1.375 Z", "1.5 Z", "13 turbines")
_TURBINE = ("1.375 Z", "13 turbines")

Runs = tuple[FarmRun, ...]
Shown = tuple[Trajectory, float]
Quantity = tuple[str, Callable[[Trajectory], np.ndarray]]

_LINE: tuple[Quantity, ...] = (
    ("U (kV)", lambda of: np.sqrt(1.5) * np.abs(of.v) / 1e3),
    ("I (A)", lambda of: np.abs(of.i) / np.sqrt(2.0)),
    ("P (MW)", lambda of: of.p_w / 1e6),
    ("Q (Mvar)", lambda of: of.q_var / 1e6),
)
_DEVICE: tuple[Quantity, ...] = (
    ("U (V)", lambda of: np.sqrt(1.5) * np.abs(of.v)),
    ("I (A)", lambda of: np.abs(of.i) / np.sqrt(2.0)),
    ("DC link (V)", lambda of: of.v_dc_v),
    ("rotor (rad/s)", lambda of: of.rotor_rad_s),
)
"""Magnitudes are those of the space vector: line to line, and of a line's current, RMS at rest."""


def draw_all(
    folder: Path, scenarios: dict[str, Runs], compared: dict[float, dict[str, FarmRun]], on_from_s: float
) -> None:
    """Write every figure into ``folder``; all that is compared is switched on at ``on_from_s`` (s)."""
    figures = {
        "farm-line": lambda: line_waves(scenarios),
        "farm-turbine": lambda: turbine_waves(scenarios),
        "farm-fft": lambda: spectra(scenarios),
        "farm-gsdc": lambda: grid_side(compared, on_from_s),
    }
    save_all(folder, figures)


def line_waves(scenarios: dict[str, Runs]) -> Figure:
    """U, I, P, Q of the farm's line, without and with damping control."""
    return _waves({name: _of_line(scenarios[name]) for name in _SHOWN}, _LINE, 6.4)


def turbine_waves(scenarios: dict[str, Runs]) -> Figure:
    """Terminal voltage, current, DC link and rotor speed of the first turbine."""
    return _waves({name: _of_turbine(scenarios[name]) for name in _TURBINE}, _DEVICE, 6.4)


def _of_line(runs: Runs) -> list[Shown]:
    return [(run.trajectory.line, _end_s(run)) for run in runs[:2]]


def _of_turbine(runs: Runs) -> list[Shown]:
    return [(run.trajectory.devices[0], _end_s(run)) for run in runs[:2]]


def _end_s(run: FarmRun) -> float:
    """When the first turbine loses synchronism (s)."""
    return np.inf if run.trajectory.lost_s is None else run.trajectory.lost_s


def _waves(columns: dict[str, list[Shown]], quantities: tuple[Quantity, ...], height: float) -> Figure:
    """A column for each scenario, a row for each quantity."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(len(quantities), len(columns), sharex=True, sharey="row", squeeze=False)
    for column, (name, trajectories) in enumerate(columns.items()):
        for row, (label, of) in enumerate(quantities):
            for (trajectory, end_s), style in zip(trajectories, (_WITHOUT, _WITH), strict=True):
                seen = trajectory.time_s < end_s
                axes[row, column].plot(trajectory.time_s[seen], of(trajectory)[seen], **style)
            if column == 0:
                axes[row, column].set_ylabel(label)
            axes[row, column].tick_params(labelsize=7)
            axes[row, column].ticklabel_format(axis="y", useOffset=False)
            _near_rest(axes[row, column])
        axes[0, column].set_title(name)
        axes[-1, column].set_xlabel("t (s)")
    _legend(figure, axes[0, 0])
    return figure


def _near_rest(axes: Axes) -> None:
    """Room for what damping control is about: the slip of a lost farm leaves the picture."""
    values = np.concatenate([line.get_ydata() for line in axes.get_lines()])
    low, high = np.nanpercentile(values, [1.0, 99.0])
    now_low, now_high = axes.get_ylim() if not axes.get_autoscaley_on() else (low, high)
    margin = 0.1 * max(high - low, 2e-3 * abs(high))
    axes.set_ylim(min(low - margin, now_low), max(high + margin, now_high))


def _legend(figure: Figure, axes: Axes) -> None:
    handles = axes.get_lines()[:2]
    figure.legend(handles, ["without damping control", "with it, k = 1.5"], loc="outside upper center", ncols=2)


def spectra(scenarios: dict[str, Runs]) -> Figure:
    """The line's current over 300 ms, before the control starts or synchronism is lost, and at the end with it."""
    names = ("1.25 Z", "1.375 Z", "1.5 Z", "11 turbines")
    figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
    axes = figure.subplots(1, len(names), sharey=True)
    for ax, name in zip(axes, names, strict=True):
        without, damped = (run.trajectory.line for run in scenarios[name][:2])
        before_s = min(0.6, _end_s(scenarios[name][0]) - 0.05, without.time_s[-1])
        for trajectory, end_s, style in ((without, before_s, _WITHOUT), (damped, damped.time_s[-1], _WITH)):
            ax.semilogy(*_spectrum(trajectory, end_s), **style)
        ax.set_title(name)
        ax.set_xlabel("f (Hz)")
        ax.set_xlim(0.0, 100.0)
    axes[0].set_ylabel("current / fundamental")
    axes[0].set_ylim(1e-4, 2.0)
    handles = axes[0].get_lines()[:2]
    figure.legend(handles, ["without, while it grows", "with k = 1.5, at the end"], loc="outside upper center", ncols=2)
    return figure


def _spectrum(trajectory: Trajectory, end_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and magnitudes of the 300 ms before ``end_s``, a Hann window, over the fundamental's."""
    seen = (trajectory.time_s >= max(end_s - 0.3, 0.0)) & (trajectory.time_s < end_s)
    current, dt_s = trajectory.i[seen], trajectory.time_s[1] - trajectory.time_s[0]
    n = 8 * len(current)
    found = np.abs(np.fft.fft(current * np.hanning(len(current)), n))
    f_hz = np.fft.fftfreq(n, dt_s)
    inside = (f_hz >= 0.0) & (f_hz <= 100.0)
    return f_hz[inside], found[inside] / found[inside].max()


def grid_side(compared: dict[float, dict[str, FarmRun]], on_from_s: float) -> Figure:
    """r of the line with grid-side dampers of several sizes, and with the turbines' own control."""
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
    axes = figure.subplots(1, len(compared), sharey=True)
    styles = [
        {"color": "#f2a35c", "lw": 1.6},
        *({"color": grey, "lw": 1.0, "ls": ls} for grey, ls in zip(("0.6", "0.35", "0.0"), _DASHES, strict=True)),
        {"color": "#08306b", "lw": 1.6},
    ]
    for ax, (scale, runs) in zip(axes, compared.items(), strict=True):
        for (name, run), style in zip(runs.items(), styles, strict=True):
            line = run.trajectory.line
            seen = line.decision_s < _end_s(run)
            ax.semilogy(line.decision_s[seen], 100.0 * line.ratio[seen], label=name, **style)
        ax.set_title(f"SCR {1.8 / scale:.2f}")
        ax.set_xlabel("t (s)")
        ax.axvline(on_from_s, color="0.8", lw=0.6, zorder=0)
    axes[0].set_ylim(0.03, 300.0)
    axes[0].set_ylabel("r of the line (%)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure
