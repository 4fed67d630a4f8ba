"""The metrics of one operating point on one page: Jacobian, network frequency perturbation, passivity."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .intervals import NORMAL_95
from .metrics import SUB_TRANSIENT_HZ, Metrics, Response, Swing, swing_response
from .metrics_report import point_text
from .style import DEVICE, GRID, QUIET, escaped, grid_lines, new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_metrics(m: Metrics, path: str | Path) -> None:
    """Draw one operating point to a file (.png, .svg or .pdf)."""
    write_figure(path, lambda: metrics_figure(m))


def metrics_figure(m: Metrics) -> Figure:
    """Jacobian's moduli, dP/df in modulus and phase, and the passivity index over nu, with 95 % regions."""
    figure = new_figure(8.0)
    where = "" if m.behind is None else f", seen from the source behind {m.behind}"
    figure.suptitle(escaped(f"{m.op_id}: {point_text(m)}{where}"))
    jacobian, modulus, phase, passivity = np.ravel(np.asarray(figure.subplots(4, 1, sharex=True)))
    _draw_jacobian(jacobian, m)
    _draw_nfp(modulus, phase, m)
    _draw_passivity(passivity, m)
    for axes in (jacobian, modulus, phase, passivity):
        axes.axvspan(*SUB_TRANSIENT_HZ, color="0.93", zorder=0)
        grid_lines(axes)
    passivity.set_xscale("log")
    passivity.set_xlabel(r"$\nu$ = |f $-$ f1| (Hz); grey: the band of the least stiffness")
    return figure


def _draw_jacobian(axes: Axes, m: Metrics) -> None:
    named = (
        (r"|dP/d$\theta$| (pu/rad)", m.p_theta, DEVICE, "-"),
        ("|dQ/dV| (pu/pu)", m.q_v, GRID, "-"),
        ("|dP/dV|", m.p_v, DEVICE, ":"),
        (r"|dQ/d$\theta$|", m.q_theta, GRID, ":"),
    )
    for label, of, colour, dashes in named:
        axes.plot(m.nu_hz, np.abs(of.value), dashes, color=colour, label=label)
        _band(axes, m.nu_hz, np.abs(of.value), of.magnitude_std, colour)
    axes.set_yscale("log")
    axes.set_ylabel("Jacobian (pu)")
    axes.legend(ncols=4, fontsize=7.5, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 0.98))


def _draw_nfp(modulus: Axes, phase: Axes, m: Metrics) -> None:
    from matplotlib.ticker import MaxNLocator

    modulus.plot(m.nu_hz, np.abs(m.nfp.value), color=DEVICE, marker=".", markersize=3)
    _band(modulus, m.nu_hz, np.abs(m.nfp.value), m.nfp.magnitude_std, DEVICE)
    phase.plot(m.nu_hz, _phase_deg(m.nfp), color=DEVICE, marker=".", markersize=3)
    _band(phase, m.nu_hz, _phase_deg(m.nfp), m.nfp.phase_std_deg, DEVICE)
    if isinstance(m.swing, Swing) and m.swing.is_swing:
        nu = np.geomspace(*m.swing.band_hz)
        g = swing_response(2j * np.pi * nu, (m.swing.k, m.swing.m_s, m.swing.d), m.swing.w1_rad_s)
        label = f"swing: M {m.swing.m_s:.3g} s, D {m.swing.d:.3g} pu, K {m.swing.k:.3g} pu/rad"
        modulus.plot(nu, np.abs(g), "--", color=GRID, label=label)
        phase.plot(nu, np.degrees(np.angle(g)) % 360.0, "--", color=GRID)
        modulus.legend(frameon=False, fontsize=7.5)
    modulus.set_yscale("log")
    modulus.set_ylabel("|dP/df| (pu/pu)")
    phase.set_ylabel("phase (deg)")
    phase.yaxis.set_major_locator(MaxNLocator(4, steps=[1.0, 1.5, 3.0, 4.5, 9.0, 10.0], min_n_ticks=3))


def _phase_deg(of: Response) -> np.ndarray:
    """Without jumps, begun between 0 and 360 degrees: a device that supports the frequency begins about 180."""
    phase = np.degrees(np.unwrap(np.angle(of.value)))
    return np.asarray(phase + (phase[0] % 360.0 - phase[0]))


def _draw_passivity(axes: Axes, m: Metrics) -> None:
    axes.axhline(0.0, color=QUIET, linewidth=0.6)
    axes.plot(m.nu_hz, m.passivity, color=DEVICE)
    _band(axes, m.nu_hz, m.passivity, m.passivity_std, DEVICE)
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_ylabel("passivity index (pu)")


def _band(axes: Axes, nu_hz: np.ndarray, values: np.ndarray, std: np.ndarray, colour: str) -> None:
    """The 95 % region about a line."""
    half = NORMAL_95 * std
    if np.any(np.isfinite(half)):
        axes.fill_between(nu_hz, values - half, values + half, color=colour, alpha=0.25, linewidth=0)
