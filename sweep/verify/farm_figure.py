"""The picture of a farm in time: the line's power and resonance, every device's terminal voltage and r."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...identify.views.style import escaped, new_figure, write_figure
from .farm_runs import FarmRun, FarmVerification
from .figure import quiet, resonance_current, told_below, without_spikes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT_IN = 8.2
_COLOURS = {"without damping": "#f2a35c", "with damping": "#08306b"}
_DASHED = (0, (4, 2))


def plot_farm(result: FarmVerification, path: Path) -> None:
    """Draw all runs to a PNG, SVG or PDF file, replaced atomically."""
    write_figure(path, lambda: farm_figure(result))


def farm_figure(result: FarmVerification) -> Figure:
    """Power of the line, its resonance current, r of the line and of all devices, terminal voltages."""
    figure = new_figure(HEIGHT_IN)
    axes = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": [1.1, 1.1, 1.2, 1.2]})
    for run in result.runs:
        _draw_line(axes, run)
        if len(run.devices) == len(result.names):
            _draw_devices(axes, run, result.farm.units[0].voltage_v)
    axes[0].set_ylabel("P (MW)")
    axes[1].set_ylabel(r"$i_{\alpha,r}$ (A)")
    axes[2].set_ylabel("r (%)")
    axes[2].set_ylim(0.02, 200.0)
    axes[2].axhline(3.0, color="0.3", lw=0.8, ls=_DASHED)
    axes[2].set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    axes[3].set_ylabel("|v|, terminals\n(mean of 20 ms, V)")
    axes[3].set_xlabel("t (s)")
    axes[3].set_xlim(0.0, result.story.duration_s)
    for each in axes:
        quiet(each)
    for each in (axes[0], axes[1]):
        without_spikes(each)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    head = escaped(f"{result.farm.entry.name}: {len(result.names)} devices, thin lines each of them")
    figure.suptitle("\n".join([head, *told_below("; ".join(result.words))]), fontsize=10)
    return figure


def _style(run: FarmRun) -> dict[str, Any]:
    title = run.title.removeprefix("aggregate ")
    dashed = run.title != title
    return {"color": _COLOURS[title], "lw": 1.0 if dashed else 1.4, "ls": _DASHED if dashed else "-"}


def _draw_line(axes: Any, run: FarmRun) -> None:
    line = run.trajectory.line
    end = np.inf if run.trajectory.lost_s is None else run.trajectory.lost_s
    kept = line.time_s <= end
    axes[0].plot(line.time_s[kept], line.p_w[kept] / 1e6, label=run.title, **_style(run))
    axes[1].plot(line.time_s[kept], resonance_current(line).real[kept], **_style(run))
    seen = line.decision_s <= end
    ratio = 100.0 * np.maximum(line.ratio, 1e-5)
    axes[2].semilogy(line.decision_s[seen], ratio[seen], **_style(run))
    if run.trajectory.lost_s is not None:
        where = axes[0].get_xaxis_transform()
        axes[0].plot([end], [0.08], transform=where, color=_style(run)["color"], marker="x", ls="none", ms=7, mew=1.6)


def _draw_devices(axes: Any, run: FarmRun, rated_v: float) -> None:
    thin = {**_style(run), "lw": 0.5, "alpha": 0.7}
    for of in run.trajectory.devices:
        end = np.inf if of.lost_s is None else of.lost_s
        seen = of.decision_s <= end
        axes[2].semilogy(of.decision_s[seen], 100.0 * np.maximum(of.ratio, 1e-5)[seen], **thin)
        n = max(1, round(0.02 / float(of.time_s[1] - of.time_s[0])))
        size = np.abs(of.v[: len(of.v) // n * n]).reshape(-1, n).mean(axis=1) * np.sqrt(1.5)
        time_s = of.time_s[: len(of.v) // n * n].reshape(-1, n).mean(axis=1)
        kept = (time_s <= end) & (size > 0.2 * rated_v)
        axes[3].plot(time_s[kept], size[kept], **thin)
