"""Maps of a region: the margin on a grid over two axes of the operating point, with the swept points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...identify.surrogate.surrogate import Surrogate
from ...identify.views.style import DEVICE, QUIET, WARNING, new_figure, write_figure
from ...tuning.region.worst import Worst

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.tri import Triangulation

_LEAST_POINTS = 8  # fewer show no border
_LEAST = 1e-12  # below, a doubt is not told from rounding

LABELS = {
    "active_power_mw": "Active power P (MW)",
    "reactive_power_mvar": "Reactive power Q (Mvar)",
    "terminal_voltage_pu": "Terminal voltage |v| (pu)",
}


def plot_map(path: str | Path, surrogate: Surrogate, worst: Worst | None) -> None:
    """Draw the error bar of Y over the region, or the margin where a grid was judged; see `write_figure`."""
    write_figure(path, lambda: map_figure(surrogate, worst))


def map_figure(surrogate: Surrogate, worst: Worst | None) -> Figure:
    """A map over two axes of the operating point; a curve where only one of them is free."""
    figure = new_figure(3.6)
    axes = figure.add_subplot()
    varying = tuple(int(axis) for axis in np.flatnonzero(surrogate.region.varies))
    free = varying if worst is None else worst.free
    if worst is not None and len(free) == 1:
        _curve(axes, worst, free[0])
        axes.set_xlabel(_label(surrogate, free[0]))
        return figure
    across, up = free[0], free[-1]
    _map(figure, axes, surrogate, worst, across, up)
    axes.set_xlabel(_label(surrogate, across))
    axes.set_ylabel(_label(surrogate, up))
    return figure


def _label(surrogate: Surrogate, axis: int) -> str:
    name = surrogate.region.axes[axis]
    return LABELS.get(name, name)


def _curve(axes: Axes, worst: Worst, axis: int) -> None:
    """m along the one free axis, |v| following by load flow."""
    order = np.argsort(worst.points[:, axis])
    axes.plot(worst.points[order, axis], worst.margin_m[order], color=DEVICE, label="m, |v| by load flow")
    axes.axhline(1.0, color=WARNING, linestyle="--", label="edge of stability")
    if (lowest := worst.tuning.margin_m) is not None:
        axes.plot(worst.point[axis], lowest, "*", color=WARNING, markersize=11, label="worst")
    axes.set_ylabel("Magnitude margin m")
    axes.legend(frameon=False)


def _map(figure: Figure, axes: Axes, surrogate: Surrogate, worst: Worst | None, across: int, up: int) -> None:
    """Filled contours; of a third axis the worst value at each place is seen."""
    points, values, label = _values(surrogate, worst)
    places, worst_at = points[:, (across, up)], values
    if np.count_nonzero(surrogate.region.varies) > 2:
        seen = _worst_by_place(places, values, lowest=worst is not None)
        places, worst_at = places[seen], values[seen]
    shown = axes.tricontourf(places[:, 0], places[:, 1], worst_at, levels=12, cmap="cividis")
    figure.colorbar(shown, ax=axes, label=label)
    if worst is not None:
        _border_of_stability(axes, worst, across, up)
    _mark(axes, surrogate, worst, across, up)
    _gap(axes, surrogate, across, up)


def _border_of_stability(axes: Axes, worst: Worst, across: int, up: int) -> None:
    """Where a mode begins to grow, as a line, and where its 95 % region leaves that open, as a band.

    Of a third axis the mode that grows most at each place is seen.
    """
    from matplotlib.tri import LinearTriInterpolator

    known = np.isfinite(worst.scanned.mode) & np.isfinite(worst.scanned.mode_radius)
    places, growth = worst.points[known][:, (across, up)], worst.scanned.mode[known].real
    radius = worst.scanned.mode_radius[known]
    if len(worst.free) > 2 and len(places):
        seen = _worst_by_place(places, growth, lowest=False)
        places, growth, radius = places[seen], growth[seen], radius[seen]
    if len(places) < _LEAST_POINTS or not growth.min() < 0.0 < growth.max():
        return
    triangles = _without_slivers(places)
    x, y = np.meshgrid(*np.linspace(places.min(axis=0), places.max(axis=0), 300).T)
    rising, wide = (LinearTriInterpolator(triangles, values)(x, y) for values in (growth, radius))
    axes.contourf(x, y, wide - np.abs(rising), levels=[0.0, np.inf], colors=[WARNING], alpha=0.35)
    axes.contour(x, y, rising, levels=[0.0], colors=WARNING)
    axes.plot([], [], color=WARNING, label="border of stability; band: open at 95 %")


def _without_slivers(places: np.ndarray) -> Triangulation:
    """Triangles between points, but for flat ones along the edges, across which nothing is to be interpolated."""
    from matplotlib.tri import TriAnalyzer, Triangulation

    unit = (places - places.min(axis=0)) / np.ptp(places, axis=0)
    own = Triangulation(unit[:, 0], unit[:, 1])
    flat = TriAnalyzer(own).get_flat_tri_mask(min_circle_ratio=0.05)
    return Triangulation(places[:, 0], places[:, 1], own.triangles, flat)


def _gap(axes: Axes, surrogate: Surrogate, across: int, up: int) -> None:
    """The gap of a jump, white, where the map's two axes alone decide it: nothing is said there."""
    border, region = surrogate.border, surrogate.region
    if border is None or np.count_nonzero(region.varies) > 2:
        return
    x, y = np.meshgrid(*[np.linspace(region.low[a], region.high[a], 400) for a in (across, up)])
    points = np.tile(region.low, (x.size, 1))
    points[:, across], points[:, up] = x.ravel(), y.ravel()
    side = border.side(points).reshape(x.shape)
    axes.contourf(x, y, (side < 0).astype(float), levels=[0.5, 1.5], colors=["white"])
    axes.contour(x, y, (side == 1).astype(float), levels=[0.5], colors=WARNING, linestyles="--")


def _worst_by_place(places: np.ndarray, values: np.ndarray, lowest: bool) -> np.ndarray:
    """Of 24 x 24 cells the index of the worst value in each that holds any."""
    low, high = places.min(axis=0), places.max(axis=0)
    cell = np.clip(((places - low) / (high - low) * 24.0).astype(int), 0, 23)
    number = cell[:, 0] * 24 + cell[:, 1]
    order = np.lexsort((values if lowest else -values, number))
    first = order[np.concatenate([[True], np.diff(number[order]) > 0])]
    return np.asarray(first)


def _values(surrogate: Surrogate, worst: Worst | None) -> tuple[np.ndarray, np.ndarray, str]:
    if worst is not None:
        finite = np.isfinite(worst.margin_m)
        return (
            worst.points[finite],
            np.minimum(worst.margin_m[finite], 3.0),
            "Magnitude margin m (3 and more are one colour)",
        )
    points = surrogate.samples(512)
    bars = np.log10(np.maximum(surrogate.evaluate(points).relative.max(axis=1), 1e-12))
    return points, bars, "log10 of the 95 % radius of Y, relative"


def _mark(axes: Axes, surrogate: Surrogate, worst: Worst | None, across: int, up: int) -> None:
    swept = surrogate.points
    axes.plot(swept[:, across], swept[:, up], "o", color="white", markeredgecolor=QUIET, markersize=4, label="swept")
    if worst is not None:
        x, y = worst.point[across], worst.point[up]
        axes.plot(x, y, "*", color=WARNING, markersize=11, label="worst", clip_on=False, zorder=5)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False)


def plot_progress(path: str | Path, region: Mapping[str, Any]) -> None:
    """Draw how the doubt fell with the number of operating points; see `write_figure`.

    Parameters
    ----------
    path : path
        Where to.
    region : mapping
        ``region`` of a table's metadata.
    """
    write_figure(path, lambda: progress_figure(region))


def progress_figure(region: Mapping[str, Any]) -> Figure:
    """The doubt that is left, how fresh sweeps were met, and what was asked, over the number of operating points."""
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(3.0)
    axes = figure.add_subplot()
    rounds = region["history"]
    n = [each["operating_points"] for each in rounds]
    axes.semilogy(n, [max(each["doubt"], _LEAST) for each in rounds], "o-", color=DEVICE, label="largest that is open")
    fresh = [(each["operating_points"], each["fresh_error"]) for each in rounds if each["fresh_error"] is not None]
    if fresh:
        at, missed = zip(*fresh, strict=True)
        axes.semilogy(at, np.maximum(missed, _LEAST), "x", color=QUIET, label="fresh sweep against its prediction")
    asked, label = _asked(region)
    axes.axhline(asked, color=WARNING, linestyle="--", label="asked")
    axes.set_xlabel("Operating points swept")
    axes.set_ylabel(label)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False)
    return figure


def _asked(region: Mapping[str, Any]) -> tuple[float, str]:
    """The tolerance, and what it is of."""
    on_grids = region.get("on_grids")
    if on_grids is None:
        return float(region["tolerance"]), "95 % radius of Y, relative"
    if "mode_rad_s" in on_grids:
        return float(on_grids["mode_rad_s"]), "Radius of the critical mode (rad/s)"
    return float(on_grids["verdict"]), "Share of the region without a verdict"
