"""The picture of a judged farm: its modes in the complex plane, and who takes part in the one that decides."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...identify.views.style import DEVICE, QUIET, WARNING, grid_lines, new_figure, write_figure
from ...tuning.farm.farm import Farm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_farm(path: str | Path, farm: Farm) -> None:
    """Draw ``farm``; see `write_figure`."""
    write_figure(path, lambda: farm_figure(farm))


def farm_figure(farm: Farm) -> Figure:
    """Modes on the left, shares of the devices in the critical mode on the right."""
    figure = new_figure(3.4)
    modes, shares = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_modes(modes, farm)
    _draw_shares(shares, farm)
    return figure


def _draw_modes(axes: Axes, farm: Farm) -> None:
    poles = np.array([mode.pole for mode in farm.judgement.modes])
    errors = np.array([1.96 * mode.std.real for mode in farm.judgement.modes])
    axes.axvline(0.0, color=QUIET, linewidth=0.8)
    if len(poles):
        f_hz = poles.imag / (2.0 * np.pi)
        axes.errorbar(poles.real, f_hz, xerr=errors, fmt="none", ecolor=QUIET, linewidth=0.8)
        stable = poles.real <= 0.0
        for chosen, colour, label in ((stable, DEVICE, "damped"), (~stable, WARNING, "growing")):
            if np.any(chosen):
                axes.plot(poles.real[chosen], f_hz[chosen], "x", color=colour, label=label)
        axes.legend(loc="best", frameon=False)
    axes.set_xlabel("Real part (1/s)")
    axes.set_ylabel(r"Frequency $|f - f_1|$ (Hz)")
    axes.set_title(f"{farm.entry.name}: {farm.judgement.verdict}", fontsize=9.0)
    grid_lines(axes)


def _draw_shares(axes: Axes, farm: Farm) -> None:
    mode = farm.judgement.critical
    axes.set_xlabel("Share in the mode (%)")
    if mode is None:
        axes.set_title("No oscillating mode in the band", fontsize=9.0)
        return
    order = np.argsort(mode.shares)[-12:]
    names = [farm.system.units[k].name for k in order]
    axes.barh(names, 100.0 * mode.shares[order], color=DEVICE)
    nu = mode.pole.imag / (2.0 * np.pi)
    axes.set_title(f"Who takes part at {farm.entry.f1_hz - nu:.3g}/{farm.entry.f1_hz + nu:.3g} Hz", fontsize=9.0)
