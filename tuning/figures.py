"""Figures of a tuning result: Bode of the SISO equivalents, the winding locus, the pole map.

matplotlib is imported when a figure is made; figures are plain `matplotlib.figure.Figure`, no window is opened.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate_pn
from ..identify.uncertainty import NORMAL_95
from ..plant.errors import SeqsweepError
from .intervals import relative_error_of_y1
from .result import PointTuning, TuningResult, with_doubt
from .siso import Grid, Siso, siso
from .verdict import swept_band

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAGE = (11.0, 8.5)
_DEVICE = "C0"
_GRID = "C3"
_STYLE = {"lw": 1.3}
_VISIBLE = 0.01  # relative half width below which a band is no wider than the line
_REGION = 2e-3  # width of a pole's 95 % region, relative to the pole, from which on it is drawn


def plot_result(result: TuningResult, path: str | Path, op_id: str | None = None) -> None:
    """Bode, locus and pole map of one operating point (default: the worst) on one page, to a file.

    Raises
    ------
    SeqsweepError
        If that operating point has no fit to draw.
    """
    point = result.worst if op_id is None else result.point(op_id)
    figure = _figure(_PAGE)
    _draw_page(_page(figure), point, result.grid)
    figure.savefig(path)


def shown(result: TuningResult, ax: Any = None) -> Any:
    """The worst operating point for a notebook, in axes (6,): Bode, locus, poles; a single pair takes the locus."""
    if ax is not None and not isinstance(ax, np.ndarray):
        _fitted(result.worst)
        _draw_locus(ax, result.worst)
        return ax
    if ax is None:
        import matplotlib.pyplot as plt

        ax = _page(plt.figure(figsize=_PAGE, layout="constrained"))
    _draw_page(ax, result.worst, result.grid)
    return ax


def _page(figure: Figure) -> np.ndarray:
    """Axes (6,): four of a Bode plot on the left, locus and poles on the right."""
    left, right = np.ravel(np.asarray(figure.subfigures(1, 2, width_ratios=[1.25, 1.0])))
    bode = left.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 3, 2]})
    return np.concatenate([bode, right.subplots(2, 1)])


def _draw_page(axes: np.ndarray, point: PointTuning, grid: Grid) -> None:
    _, stability = _fitted(point)
    title = f"{point.op_id}: {point.verdict} on {grid.at_f1.real:.4g} + j{grid.at_f1.imag:.4g} $\\Omega$"
    pair = stability.closed_loop.resonance_hz
    figure = axes[0].get_figure(root=True)
    figure.suptitle(title if pair is None else f"{title}, resonance {pair[0]:.2f}/{pair[1]:.2f} Hz")
    _draw_bode(axes[:4], point, grid)
    _draw_locus(axes[4], point)
    _draw_poles(axes[5], point)


def bode_figure(point: PointTuning, grid: Grid) -> Figure:
    """Magnitude and phase of Y1 against Yg1 and of Y2 against Yg2, 180-degree crossings marked with their m."""
    figure = _figure((7.0, 8.0))
    _draw_bode(figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 3, 2]}), point, grid)
    return figure


def locus_figure(point: PointTuning) -> Figure:
    """The locus of det(Y + Yg) about zero, moduli compressed so that both ends and the origin show."""
    figure = _figure((5.5, 5.0))
    _draw_locus(figure.subplots(), point)
    return figure


def pole_figure(point: PointTuning) -> Figure:
    """Closed-loop poles in the dq frame near the axis, with standard errors and lines of equal damping."""
    figure = _figure((5.5, 5.0))
    _draw_poles(figure.subplots(), point)
    return figure


def _figure(size: tuple[float, float]) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained", dpi=120)


def _fitted(point: PointTuning) -> tuple[RationalModel, Any]:
    if point.model is None or point.stability is None:
        raise SeqsweepError(f"operating point {point.op_id!r} has no fit to draw: {point.reason}")
    return point.model, point.stability


def _draw_bode(axes: Sequence[Axes] | np.ndarray, point: PointTuning, grid: Grid) -> None:
    model, stability = _fitted(point)
    low, high = swept_band(model)
    low = max(low, 0.01 * high / 10.0)
    about_f1 = np.geomspace(1e-3 * grid.f1_hz, 0.3 * grid.f1_hz, 300)
    f = np.concatenate([np.geomspace(low, high, 1200), grid.f1_hz - about_f1, grid.f1_hz + about_f1])
    f = np.unique(f[(f >= low) & (f <= high)])
    pair = siso(f, evaluate_pn(model, f), grid)
    _draw_doubt(axes[0], axes[1], model, grid, f, pair)
    drawn = ((1, pair.y1, pair.yg1), (2, pair.y2, pair.yg2))
    for (magnitude, phase), (component, device, seen) in zip((axes[0:2], axes[2:4]), drawn, strict=True):
        _draw_pair(magnitude, phase, f, device, seen, component)
        for crossing in stability.crossings:
            if crossing.component == component:
                critical = crossing == stability.critical
                _mark_crossing(magnitude, phase, crossing.f_hz, _m_text(point, crossing.m, critical), critical)
    axes[-1].set_xlabel("Frequency (Hz)")
    axes[-1].set_xlim(f[0], f[-1])


def _draw_pair(magnitude: Axes, phase: Axes, f: np.ndarray, device: np.ndarray, seen: np.ndarray, number: int) -> None:
    magnitude.loglog(f, np.abs(device), color=_DEVICE, label=f"$Y^{number}_{{\\mathrm{{device}}}}$", **_STYLE)
    magnitude.loglog(f, np.abs(seen), color=_GRID, ls="--", label=f"$Y^{number}_{{\\mathrm{{grid}}}}$", **_STYLE)
    magnitude.set_ylabel("Magnitude (S)")
    magnitude.legend(loc="upper right", fontsize="small")
    magnitude.grid(True, which="both", alpha=0.25)
    difference = np.degrees(np.angle(device / seen)) % 360.0
    difference[1:][np.abs(np.diff(difference)) > 180.0] = np.nan
    phase.semilogx(f, difference, color="k", lw=1.1)
    phase.axhline(180.0, color="0.5", lw=0.8)
    phase.set_yticks([0, 90, 180, 270, 360])
    phase.set_ylabel(f"$\\angle Y^{number}/Y_g^{number}$ (deg)")
    phase.grid(True, which="both", alpha=0.25)


def _draw_doubt(magnitude: Axes, phase: Axes, model: RationalModel, grid: Grid, f: np.ndarray, pair: Siso) -> None:
    """95 % bands of Y1, where they are wide enough to be seen; those of Y2 are their mirror images."""
    modulus, angle = (NORMAL_95 * x for x in relative_error_of_y1(model, grid, f))
    if np.quantile(modulus, 0.9) < _VISIBLE:
        return
    y1, modulus = np.abs(pair.y1), np.minimum(modulus, 1.0)  # near f1 it is anyone's guess
    band: dict[str, Any] = {"color": _DEVICE, "alpha": 0.25, "lw": 0.0}
    magnitude.fill_between(f, y1 * np.exp(-modulus), y1 * np.exp(modulus), label="95 %", **band)
    difference = np.degrees(np.angle(pair.y1 / pair.yg1)) % 360.0
    wide = np.degrees(np.minimum(angle, np.pi))
    phase.fill_between(f, np.maximum(difference - wide, 0.0), np.minimum(difference + wide, 360.0), **band)


def _m_text(point: PointTuning, m: float, critical: bool) -> str:
    """The margin at a crossing where it matters, with its interval at the critical one."""
    if critical:
        return "m = " + with_doubt(m, point.margin_interval, 2).replace("+-", "$\\pm$")
    return f"m = {m:.2f}" if m < 1.0 else ""


def _mark_crossing(magnitude: Axes, phase: Axes, f_hz: float, m_text: str, critical: bool) -> None:
    color = "C1" if critical else "0.45"
    magnitude.axvline(f_hz, color=color, lw=0.9, ls=":")
    phase.plot([f_hz], [180.0], "o", color=color, ms=4)
    if m_text:
        text = f"{f_hz:.2f} Hz\n{m_text}"
        magnitude.annotate(
            text,
            (f_hz, 0.04),
            xycoords=("data", "axes fraction"),
            xytext=(5, 0),
            textcoords="offset points",
            fontsize="x-small",
            color=color,
        )


def _draw_locus(axes: Axes, point: PointTuning) -> None:
    model, stability = _fitted(point)
    winding = stability.winding
    radius = np.abs(winding.locus)
    swept = (np.abs(winding.nu_hz) >= model.nu_hz[0]) & (np.abs(winding.nu_hz) <= model.nu_hz[-1])
    median = np.median(radius[swept])
    shown = np.log1p(radius / median) * np.exp(1j * np.angle(winding.locus))
    view = 1.1 * float(np.abs(shown[swept]).max())
    for mask, label, style in ((swept, "swept", "-"), (~swept, "by the fit", ":")):
        part = np.where(mask, shown, np.nan)
        axes.plot(part.real, part.imag, style, color=_DEVICE, lw=1.2, label=label)
    axes.plot([0.0], [0.0], "+", color=_GRID, ms=12, mew=1.8)
    axes.set_aspect("equal")
    axes.set_xlim(-view, view)
    axes.set_ylim(-view, view)
    axes.set_xlabel(f"Re, modulus drawn as ln(1 + |x| / {median:.3g} S$^2$)")
    axes.set_ylabel("Im")
    axes.set_title(
        f"det(Y + Yg): winding {winding.number}, open-loop unstable {stability.n_open_loop_unstable}", fontsize="medium"
    )
    axes.legend(fontsize="small")
    axes.grid(True, alpha=0.25)


def _draw_poles(axes: Axes, point: PointTuning) -> None:
    _, stability = _fitted(point)
    loop = stability.closed_loop
    near = (loop.f_hz <= loop.f1_hz) & (loop.poles.real > -2.0 * np.pi * loop.f1_hz)  # others do not resonate
    real, nu = loop.poles.real[near], loop.f_hz[near]
    left = min(-10.0, 1.25 * float(real.min(initial=-10.0)))
    right = max(10.0, 1.5 * float(real.max(initial=0.0)))
    for damping in (0.05, 0.1, 0.2):
        edge = loop.f1_hz * 2.0 * np.pi * damping / np.sqrt(1.0 - damping**2)
        axes.plot([0.0, -edge], [0.0, loop.f1_hz], color="0.8", lw=0.8)
        axes.annotate(f"{damping:.0%}", (-edge, loop.f1_hz), fontsize="x-small", color="0.5", clip_on=True)
    axes.axvline(0.0, color="k", lw=0.8)
    axes.axvspan(0.0, right, color=_GRID, alpha=0.06)
    std = loop.std[near]
    axes.errorbar(
        real, nu, xerr=2.0 * std.real, yerr=std.imag / np.pi, fmt="x", color=_DEVICE, ms=7, mew=1.6, capsize=2
    )
    if loop.critical is not None:
        pole = loop.poles[loop.critical]
        _draw_region(axes, complex(pole), loop.covariance[loop.critical])
        text = f"{pole.real:+.2f} rad/s, {loop.f_hz[loop.critical]:.2f} Hz\ndamping {loop.damping[loop.critical]:.1%}"
        axes.annotate(
            text,
            (pole.real, pole.imag / (2.0 * np.pi)),
            xytext=(-8, 8),
            textcoords="offset points",
            fontsize="small",
            ha="right",
        )
    axes.set_xlim(left, right)
    axes.set_ylim(0.0, loop.f1_hz)
    axes.set_xlabel("Real part (rad/s)")
    axes.set_ylabel("|Im|/2$\\pi$ in dq (Hz)")
    axes.set_title("Closed-loop poles, two standard errors", fontsize="medium")
    axes.grid(True, alpha=0.25)


def _draw_region(axes: Axes, pole: complex, covariance: np.ndarray) -> None:
    """The critical pole from near by with its 95 % region, where noise gives it one."""
    edge = _region(pole, covariance)
    width, height = np.ptp(edge.real), np.ptp(edge.imag) / (2.0 * np.pi)
    if width < _REGION * abs(pole):
        return
    near = axes.inset_axes((0.13, 0.1, 0.3, 0.3))
    near.fill(edge.real, edge.imag / (2.0 * np.pi), color="C1", alpha=0.35, lw=0.0)
    near.plot([pole.real], [pole.imag / (2.0 * np.pi)], "x", color=_DEVICE, ms=7, mew=1.6)
    near.axvline(0.0, color="k", lw=0.8)
    left, right = pole.real - width, pole.real + width
    near.set_xlim(min(left, -0.1 * width), max(right, 0.1 * width) if pole.real > -3.0 * width else right)
    near.set_ylim(pole.imag / (2.0 * np.pi) - height, pole.imag / (2.0 * np.pi) + height)
    near.set_title("95 % region", fontsize="x-small")
    near.tick_params(labelsize="x-small")


def _region(pole: complex, covariance: np.ndarray) -> np.ndarray:
    """Edge (n,) of the 95 % ellipse of a pole, complex (rad/s)."""
    variance, axes = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, 90)
    radius = np.sqrt(-2.0 * np.log(0.05))  # chi-squared with two degrees of freedom
    x = radius * (axes * np.sqrt(np.maximum(variance, 0.0))) @ np.stack([np.cos(turn), np.sin(turn)])
    return pole + x[0] + 1j * x[1]
