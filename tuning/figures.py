"""The picture of a tuning result: Bode of the SISO equivalents, the locus of det(1 + Y Z), the closed-loop poles.

Numbers stand in titles and legends, outside of what is drawn, so that nothing is printed over anything. matplotlib is
imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..identify.exclusion import excluded
from ..identify.fit.dq_data import to_dq
from ..identify.fit.rational import RationalModel, evaluate, evaluate_pn
from ..identify.uncertainty import NORMAL_95
from ..identify.views.style import (
    COLOURS,
    DEVICE,
    GRID,
    QUIET,
    WARNING,
    escaped,
    grid_lines,
    new_figure,
    opened_figure,
    write_figure,
)
from ..plant.errors import SeqsweepError
from .damping_lines import draw_damping
from .intervals import relative_error_of_y1
from .result import PointTuning, TuningResult, mode_with_k
from .siso import Grid, impedance_dq, siso
from .text import CERTAIN, with_doubt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_DRAWN = len(COLOURS)
"""Entries of a result that the pole map holds; of more it shows the worst."""

_HEIGHT_IN = 8.6
_WITH_K = "#238b45"
_NAME_LENGTH = 16  # longer names have a line of their own in the legend
_VISIBLE = 0.01  # relative half width below which a band is no wider than the line
_FLOOR_DB = -40.0  # the middle of the locus
_TURN_DEG = 4.0  # a drawn locus turns no further from one point to the next
_DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 3.0}


class _Drawn(NamedTuple):
    """An entry that can be drawn: what it was fitted with, and on which grid."""

    point: PointTuning
    model: RationalModel
    grid: Grid


def plot_result(result: TuningResult, path: str | Path, op_id: str | None = None, scale: float | None = None) -> None:
    """Draw one entry of a result (default: the worst that has a fit) to a PNG, SVG or PDF file, and the poles of all.

    Raises
    ------
    SeqsweepError
        If that entry has no fit to draw, or the suffix is another one; nothing is written.
    """
    write_figure(path, lambda: result_figure(result, op_id, scale))


def result_figure(result: TuningResult, op_id: str | None = None, scale: float | None = None) -> Figure:
    """The figure that `plot_result` writes."""
    point = (result.worst_fitted or result.worst) if op_id is None else result.point(op_id, scale)
    _drawn(point)
    figure = new_figure(_HEIGHT_IN)
    _draw_page(_page(figure), result, point)
    return figure


def shown(result: TuningResult, ax: Any = None) -> Any:
    """The worst entry for a notebook, in axes (6,): Bode, locus, poles; a single pair of axes takes the locus."""
    worst = result.worst_fitted or result.worst
    drawn = _drawn(worst)
    if ax is not None and not isinstance(ax, np.ndarray):
        _draw_locus(ax, drawn)
        _legend(ax, 2)
        return ax
    if ax is None:
        ax = _page(opened_figure(_HEIGHT_IN))
    _draw_page(ax, result, worst)
    return ax


def _page(figure: Figure) -> np.ndarray:
    """Axes (6,): magnitudes of Y1 and Y2, their phases below, then the locus and the poles."""
    upper, lower = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=[1.0, 1.1])))
    bode = upper.subplots(2, 2, sharex=True, sharey="row", height_ratios=[3, 2])
    left, right = np.ravel(np.asarray(lower.subfigures(1, 2, width_ratios=[1.0, 1.15])))
    return np.array([*np.ravel(bode), left.subplots(), right.subplots()])


def _draw_page(axes: np.ndarray, result: TuningResult, point: PointTuning) -> None:
    drawn = _drawn(point)
    axes[0].get_figure(root=True).suptitle(_title(result, point), fontsize=10)
    _draw_bode(axes[:4].reshape(2, 2), drawn)
    _draw_locus(axes[4], drawn)
    _draw_poles(axes[5], _entries(result, point), len(result.points))
    for each, columns in ((axes[0], 5), (axes[4], 2), (axes[5], 1)):
        _legend(each, columns)


def _legend(axes: Axes, columns: int) -> None:
    """One legend: outside of what is drawn, where the axes have a part of a figure to themselves."""
    figure = axes.get_figure(root=False)
    assert figure is not None
    handles = axes.get_legend_handles_labels()
    if figure is axes.get_figure(root=True) and len(figure.axes) > 4:
        axes.legend(*handles, fontsize=7.5)
    else:
        figure.legend(*handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=7.5)


def bode_figure(point: PointTuning) -> Figure:
    """Magnitude and phase of Y1 against Yg1 and of Y2 against Yg2, with their 180-degree crossings."""
    figure = new_figure(4.2)
    axes = np.asarray(figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[3, 2]))
    _draw_bode(axes, _drawn(point))
    _legend(axes[0, 0], 5)
    return figure


def locus_figure(point: PointTuning) -> Figure:
    """The locus of det(1 + Y Z) about zero."""
    figure = new_figure(6.0)
    axes = figure.subplots()
    _draw_locus(axes, _drawn(point))
    _legend(axes, 3)
    return figure


def pole_figure(points: Sequence[PointTuning]) -> Figure:
    """Closed-loop poles of one or several entries over the swept band."""
    figure = new_figure(5.0)
    axes = figure.subplots()
    _draw_poles(axes, [_drawn(point) for point in points[:MOST_DRAWN]], len(points))
    _legend(axes, 1)
    return figure


def _drawn(point: PointTuning) -> _Drawn:
    if point.model is None or point.stability is None or point.grid is None:
        raise SeqsweepError(f"operating point {point.op_id!r} has no fit to draw: {point.reason}")
    return _Drawn(point, point.model, point.grid)


def _entries(result: TuningResult, first: PointTuning) -> list[_Drawn]:
    """Entries for the pole map: all that have a fit, or the one that is drawn in full where there are too many."""
    fitted = [point for point in result.points if point.stability is not None]
    return [_drawn(point) for point in (fitted if len(fitted) <= MOST_DRAWN else [first])]


def _title(result: TuningResult, point: PointTuning) -> str:
    """Which entry this is, out of how many, and what was found."""
    of = f" ({_which(result, point)} of {len(result.points)})" if len(result.points) > 1 else ""
    grid = "" if point.grid is None else f" on {point.grid.label}"
    certain = point.probability is None or not 1.0 - CERTAIN < point.probability < CERTAIN
    probability = "" if certain else f" (probability of being stable {point.probability:.3g})"
    return escaped(f"{_name(point)}{of}: {point.verdict}{probability}{grid}")


def _which(result: TuningResult, point: PointTuning) -> str:
    """The worst is the table's; where that one has no fit, the picture is of another one and says so."""
    if point is result.worst:
        return "the worst"
    return "the worst with a fit" if point is result.worst_fitted else "one"


def _name(point: PointTuning) -> str:
    return point.op_id if point.scale == 1.0 else f"{point.op_id} at {point.scale:g} Z"


# Bode ----------------------------------------------------------------------------------------------------------------


def _draw_bode(axes: np.ndarray, drawn: _Drawn) -> None:
    """Magnitudes above, phases below; Y1 to the left, its mirror image Y2 to the right."""
    from matplotlib.ticker import FuncFormatter

    point, model, grid = drawn
    f = _frequencies(drawn)
    pair = siso(f, evaluate_pn(model, f), grid)
    for column, (device, seen) in enumerate(((pair.y1, pair.yg1), (pair.y2, pair.yg2))):
        magnitude, phase = axes[0, column], axes[1, column]
        number = column + 1
        magnitude.loglog(f, np.abs(device), color=DEVICE, label=f"$Y_{number}$ of the device")
        magnitude.loglog(f, np.abs(seen), color=GRID, linestyle="--", label=f"$Y_{{g{number}}}$ of the grid")
        phase.semilogx(f, _difference(device, seen), color=DEVICE)
        _draw_rows(magnitude, phase, drawn, column)
        _draw_with_k(magnitude, phase, point, f, column)
        _mark_crossings(magnitude, phase, point, number)
        phase.axhline(180.0, color=QUIET, linewidth=0.7)
        phase.set_yticks([0, 90, 180, 270, 360])
        phase.set_ylim(0.0, 360.0)
        phase.set_xlabel("f (Hz)")
        phase.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        phase.set_xlim(f[0], f[-1])
        for each in (magnitude, phase):
            grid_lines(each)
    _draw_doubt(axes[0, 0], axes[1, 0], drawn, f)
    axes[0, 0].set_ylabel("Magnitude (S)")
    axes[1, 0].set_ylabel(r"$\angle\,Y/Y_g$ (deg)")


def _frequencies(drawn: _Drawn) -> np.ndarray:
    """Frequencies (n,) to draw at (Hz): the table's band, closer about f1."""
    f1_hz = drawn.model.f1_hz
    low, high = (f1_hz - drawn.model.nu_hz[-1], f1_hz + drawn.model.nu_hz[-1])
    if drawn.point.response is not None:
        low, high = float(drawn.point.response.f_hz[0]), float(drawn.point.response.f_hz[-1])
    low = max(low, 1e-3 * high)
    about_f1 = np.geomspace(0.5 * drawn.model.nu_hz[0], 0.5 * f1_hz, 300)
    f = np.concatenate([np.geomspace(low, high, 1200), f1_hz - about_f1, f1_hz + about_f1])
    return np.unique(f[(f >= low) & (f <= high)])


def _difference(device: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Phase (n,) of Y/Yg in 0 to 360 degrees, broken where it leaves them."""
    difference = np.degrees(np.angle(device / seen)) % 360.0
    difference[1:][np.abs(np.diff(difference)) > 180.0] = np.nan
    return difference


def _draw_rows(magnitude: Axes, phase: Axes, drawn: _Drawn, column: int) -> None:
    """The rows of the table as dots, and those left out on purpose as crosses."""
    response = drawn.point.response
    if response is None:
        return
    pair = siso(np.asarray(response.f_hz), np.asarray(response.y), drawn.grid)
    device, seen = (pair.y1, pair.yg1) if column == 0 else (pair.y2, pair.yg2)
    crossed: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 4.0, "color": WARNING}
    dotted: dict[str, Any] = {**_DOTS, "color": DEVICE}
    for mask, style, label in ((response.usable, dotted, "rows"), (excluded(response), crossed, "rows left out")):
        if np.any(mask):
            magnitude.plot(response.f_hz[mask], np.abs(device[mask]), label=label, **style)
            phase.plot(response.f_hz[mask], np.degrees(np.angle(device[mask] / seen[mask])) % 360.0, **style)


def _draw_with_k(magnitude: Axes, phase: Axes, point: PointTuning, f: np.ndarray, column: int) -> None:
    """The device re-swept with damping control, where it was."""
    if point.with_k is None or point.with_k.model is None or point.grid is None:
        return
    pair = siso(f, evaluate_pn(point.with_k.model, f), point.grid)
    device, seen = (pair.y1, pair.yg1) if column == 0 else (pair.y2, pair.yg2)
    magnitude.loglog(f, np.abs(device), color=_WITH_K, linestyle="-.", label=f"with k = {point.k:.3g}")
    phase.semilogx(f, _difference(device, seen), color=_WITH_K, linestyle="-.")


def _draw_doubt(magnitude: Axes, phase: Axes, drawn: _Drawn, f: np.ndarray) -> None:
    """95 % bands of Y1, where they are wide enough to be seen; those of Y2 are their mirror images."""
    modulus, angle = (NORMAL_95 * x for x in relative_error_of_y1(drawn.model, drawn.grid, f))
    if np.quantile(modulus, 0.9) < _VISIBLE:
        return
    pair = siso(f, evaluate_pn(drawn.model, f), drawn.grid)
    y1, modulus = np.abs(pair.y1), np.minimum(modulus, 1.0)  # near f1 it is anyone's guess
    band: dict[str, Any] = {"color": DEVICE, "alpha": 0.22, "linewidth": 0.0}
    magnitude.fill_between(f, y1 * np.exp(-modulus), y1 * np.exp(modulus), label="95 % interval", **band)
    difference = np.degrees(np.angle(pair.y1 / pair.yg1)) % 360.0
    wide = np.degrees(np.minimum(angle, np.pi))
    phase.fill_between(f, np.maximum(difference - wide, 0.0), np.minimum(difference + wide, 360.0), **band)


def _mark_crossings(magnitude: Axes, phase: Axes, point: PointTuning, number: int) -> None:
    """Crossings as circles, full where |Y| > |Yg|; what they are worth stands in the title."""
    assert point.stability is not None
    critical = point.stability.critical
    words: list[str] = []
    for crossing in (c for c in point.stability.crossings if c.component == number):
        style: dict[str, Any] = {"marker": "o", "markersize": 5, "color": WARNING, "linestyle": "none"}
        phase.plot([crossing.f_hz], [180.0], fillstyle="full" if crossing.m < 1.0 else "none", zorder=4, **style)
        if crossing == critical:
            magnitude.axvline(crossing.f_hz, color=WARNING, linewidth=0.7, linestyle=":")
            words.insert(0, f"m = {with_doubt(crossing.m, point.margin_interval, 2)} at {crossing.f_hz:.2f} Hz")
        elif crossing.m < 1.0:
            words.append(f"m = {crossing.m:.2f} at {crossing.f_hz:.2f} Hz")
    text = ", ".join(words[:2]) or "no 180-degree crossing with m < 1"
    magnitude.set_title(f"$Y_{number}$: " + text.replace("+-", r"$\pm$"), fontsize=8.5)


# Locus ---------------------------------------------------------------------------------------------------------------


def _draw_locus(axes: Axes, drawn: _Drawn) -> None:
    """det(1 + Y Z) in the complex plane, its modulus in dB along the rays: rings are labelled, zero is the middle."""
    point, model, grid = drawn
    stability = point.stability
    assert stability is not None
    nu = _smooth(model, grid, stability.winding.nu_hz)
    d = _determinant(model, grid, nu)
    swept = nu >= model.nu_hz[0]
    shown = _in_db(d)
    for part, label, style in (
        (np.where(swept, shown, np.nan), "rising f, f > f1", {"linestyle": "-", "color": DEVICE}),
        (np.where(swept, np.nan, shown), "below the lowest row: the fit", {"linestyle": ":", "color": DEVICE}),
        (np.conj(shown), "its mirror image, f < f1", {"linestyle": "-", "color": COLOURS[5], "linewidth": 0.8}),
    ):
        axes.plot(part.real, part.imag, label=label, **style)
    if point.response is not None:
        _, dots, _ = locus_rows(point)
        axes.plot(dots.real, dots.imag, color="k", label="rows", **_DOTS)
    _draw_arrow(axes, shown[swept])
    if point.with_k is not None and point.with_k.model is not None:
        fine = _smooth(point.with_k.model, grid, nu)
        damped = _in_db(_determinant(point.with_k.model, grid, fine))
        axes.plot(damped.real, damped.imag, "-.", color=_WITH_K, label=f"with k = {point.k:.3g}")
    _draw_rings(axes, shown)
    turns, own = stability.winding.number, stability.n_open_loop_unstable
    axes.set_title(
        f"det(1 + YZ): winding number {turns}, own unstable poles {own}".replace("-", "\N{MINUS SIGN}"),
        fontsize=8.5,
    )


def locus_rows(point: PointTuning) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|f - f1| (n,) in Hz of the rows, their places (n,) in the picture of the locus, and det(1 + Y Z) (n,) there."""
    assert point.response is not None
    assert point.grid is not None
    data = to_dq(point.response)
    s = 2j * np.pi * data.nu_hz
    d = np.linalg.det(np.eye(2) + data.y @ impedance_dq(point.grid, s)) * point.grid.clearing(s)
    return data.nu_hz, _in_db(d), d


def _determinant(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> np.ndarray:
    """det(1 + Y Z) (n,) of the fit, cleared of what the grid has on the axis."""
    s = 2j * np.pi * nu_hz
    return np.asarray(np.linalg.det(np.eye(2) + evaluate(model, s) @ impedance_dq(grid, s)) * grid.clearing(s))


def _smooth(model: RationalModel, grid: Grid, seeds_hz: np.ndarray) -> np.ndarray:
    """Frequencies (n,) from near zero to the end of the band, so close that the locus looks round."""
    end = float(model.nu_hz[-1])
    seeds = np.abs(np.concatenate([seeds_hz, model.nu_hz]))
    nu = np.unique(np.concatenate([[1e-3 * model.nu_hz[0], end], seeds[(seeds > 0.0) & (seeds <= end)]]))
    for _ in range(8):
        d = _determinant(model, grid, nu)
        step = d[1:] / d[:-1]
        coarse = (np.abs(np.angle(step)) > np.radians(_TURN_DEG)) | (np.abs(np.log(np.abs(step))) > 0.15)
        if not np.any(coarse):
            break
        nu = np.sort(np.concatenate([nu, np.sqrt(nu[1:] * nu[:-1])[coarse]]))
    return nu


def _in_db(values: np.ndarray) -> np.ndarray:
    """Complex numbers (n,) with the same angle whose modulus is that of ``values`` in dB above the floor."""
    level = 20.0 * np.log10(np.maximum(np.abs(values), 1e-12))
    return np.maximum(level - _FLOOR_DB, 0.0) * np.exp(1j * np.angle(values))


def _draw_rings(axes: Axes, shown: np.ndarray) -> None:
    """Rings every 20 dB with their level, the critical point zero in the middle; no other axes."""
    top = float(np.max(np.abs(shown)))
    free = _free_direction(shown, top)
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 181))
    for level in np.arange(_FLOOR_DB + 20.0, _FLOOR_DB + top + 20.0, 20.0):
        size = level - _FLOOR_DB
        axes.plot(size * turn.real, size * turn.imag, color="0.8", linewidth=0.5, zorder=0)
        at = size * free
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
        text = f"{level:g} dB".replace("-", "\N{MINUS SIGN}")
        axes.text(at.real, at.imag, text, fontsize=7, color=QUIET, ha="center", va="center", bbox=box, zorder=1)
    axes.axhline(0.0, color="0.8", linewidth=0.5, zorder=0)
    axes.axvline(0.0, color="0.8", linewidth=0.5, zorder=0)
    axes.plot([0.0], [0.0], "+", color=WARNING, markersize=9, markeredgewidth=1.6, zorder=5)
    view = 1.06 * (np.ceil(top / 20.0) * 20.0)
    axes.set_xlim(-view, view)
    axes.set_ylim(-view, view)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _free_direction(shown: np.ndarray, top: float) -> complex:
    """Direction of unit length in which the labels of the rings keep farthest from the locus and its mirror image."""
    rays = np.exp(1j * np.radians(np.arange(10.0, 360.0, 10.0)))
    labels = rays[:, None] * np.arange(20.0, top + 20.0, 20.0)
    curve = np.concatenate([shown, np.conj(shown)])
    distance = np.min(np.abs(labels[:, :, None] - curve), axis=(1, 2))
    return complex(rays[np.argmax(distance)])


def _draw_arrow(axes: Axes, shown: np.ndarray) -> None:
    """Which way the locus runs, in the middle of its longest way."""
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(shown)))])
    k = int(np.clip(np.searchsorted(length, 0.5 * length[-1]), 1, len(shown) - 1))
    start, end = shown[k - 1], shown[k]
    if start != end:
        direction = (end - start) / abs(end - start)
        axes.annotate(
            "",
            (end.real, end.imag),
            xytext=((end - 2.0 * direction).real, (end - 2.0 * direction).imag),
            arrowprops={"arrowstyle": "-|>", "color": DEVICE, "linewidth": 1.0},
        )


# Poles ---------------------------------------------------------------------------------------------------------------


def _draw_poles(axes: Axes, entries: Sequence[_Drawn], n_all: int) -> None:
    """Closed-loop poles of the swept band with 95 % intervals; damping ratios as lines, numbers in the legend."""
    from matplotlib.ticker import FuncFormatter

    lowest = min(float(entry.model.nu_hz[0]) for entry in entries)
    highest = max(float(entry.model.nu_hz[-1]) for entry in entries)
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.6)
    axes.set_yscale("symlog", linthresh=lowest, linscale=0.4)
    for entry, colour in zip(entries, COLOURS, strict=False):
        _draw_entry(axes, entry, colour)
    left, right = _pole_range(entries, highest)
    axes.set_xlim(left, right)
    axes.set_ylim(-0.05 * lowest, 1.1 * highest)
    poles = np.concatenate([_shown_poles(entry) for entry in entries])
    draw_damping(axes, poles, lowest, highest)
    axes.axvline(0.0, color="k", linewidth=0.8)
    axes.axvspan(0.0, right, color=WARNING, alpha=0.06, linewidth=0.0)
    axes.axhspan(-0.05 * lowest, lowest, color="0.5", alpha=0.08, linewidth=0.0)
    powers = [10.0**n for n in range(0, 7)]
    axes.set_xticks([x for x in (*(-p for p in powers[::-1]), 0.0, *powers) if left <= x <= right])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}".replace("-", "\N{MINUS SIGN}")))
    axes.set_yticks([0.0, *(y for y in (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0, 1e4) if lowest <= y <= highest)])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
    axes.minorticks_off()
    axes.grid(True, linewidth=0.4, color="0.9")
    axes.set_axisbelow(True)
    axes.set_xlabel("real part (rad/s), to the right of zero it grows")
    axes.set_ylabel(r"$|f - f_1|$ (Hz)")
    shown = "" if len(entries) == n_all else f" ({len(entries)} of {n_all} entries)"
    axes.set_title(f"Closed-loop poles, 95 % intervals{shown}", fontsize=8.5)


def _shown_poles(entry: _Drawn) -> np.ndarray:
    """Real part (rad/s) and abs(f - f1) (Hz) of the poles (n, 2) of an entry."""
    assert entry.point.stability is not None
    loop = entry.point.stability.closed_loop
    return np.column_stack([loop.poles.real, loop.f_hz])[~loop.beyond]


def _draw_entry(axes: Axes, entry: _Drawn, colour: str) -> None:
    point = entry.point
    assert point.stability is not None
    loop = point.stability.closed_loop
    inside = ~loop.beyond
    real, nu, std = loop.poles.real[inside], loop.f_hz[inside], loop.std[inside]
    errors = {"xerr": NORMAL_95 * std.real, "yerr": NORMAL_95 * std.imag / (2.0 * np.pi)}
    known = np.isfinite(errors["xerr"]) & np.isfinite(errors["yerr"])
    axes.errorbar(
        real[known], nu[known], **{key: value[known] for key, value in errors.items()}, fmt="none",
        ecolor=colour, elinewidth=0.7,
    )  # fmt: skip
    axes.plot(real, nu, linestyle="none", marker="x", markersize=5, color=colour)
    _mark_mode(axes, point, _name(point), {"marker": "o", "color": colour}, loop.critical)
    if point.with_k is not None and point.with_k.stability is not None:
        with_k = point.with_k.stability.closed_loop
        near = ~with_k.beyond
        axes.plot(with_k.poles.real[near], with_k.f_hz[near], "+", markersize=5, color=_WITH_K)
        name = f"{_name(point)} with k = {point.k:.3g}"
        _mark_mode(axes, point.with_k, name, {"marker": "D", "color": _WITH_K}, mode_with_k(point))


def _mark_mode(axes: Axes, point: PointTuning, name: str, style: dict[str, Any], mode: int | None) -> None:
    """A ring around a mode, and what there is to know of it in the legend."""
    assert point.stability is not None
    loop = point.stability.closed_loop
    ring: dict[str, Any] = {"linestyle": "none", "markersize": 9, "fillstyle": "none", **style}
    if mode is None:
        axes.plot([], [], label=escaped(f"{name}: {point.verdict}, no resonance"), **ring)
        return
    pole, nu = complex(loop.poles[mode]), float(loop.f_hz[mode])
    numbers = (
        f"{point.verdict}, {pole.real:+.3g} rad/s at $f_1 \\pm$ {nu:.2f} Hz, damping {100.0 * loop.damping[mode]:.1f} %"
    )
    gap = " " if len(name) <= _NAME_LENGTH else "\n"
    text = f"{escaped(name)}:{gap}{numbers}".replace("-", "\N{MINUS SIGN}")
    axes.plot([pole.real], [nu], label=text, zorder=4, **ring)


def _pole_range(entries: Sequence[_Drawn], highest_hz: float) -> tuple[float, float]:
    """Range of the real axis (rad/s): the poles inside the band, and some room to the right of zero."""
    reals = [
        entry.point.stability.closed_loop.poles.real[~entry.point.stability.closed_loop.beyond]
        for entry in entries
        if entry.point.stability is not None
    ]
    real = np.concatenate([*reals, [-10.0]])
    return float(max(real.min() * 2.0, -2.0 * np.pi * highest_hz * 2.0)), float(max(10.0, 2.5 * real.max()))
