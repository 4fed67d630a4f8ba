"""The worst operating point of a region on a grid: searched over the whole region, not picked from a list.

The margin m (paper eqs. 3 and 4: |Yg/Y1| where Y1/Yg1 passes 180 degrees above f1) of every point of an even covering
of the region comes from the surrogate's own frequencies; the lowest few points are refined by a simplex, and the worst
of them is judged as a whole by `tune_point`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..identify.surrogate.surrogate import AXES, Surrogate
from ..plant.errors import SeqsweepError
from .result import PointTuning
from .siso import Grid, siso
from .tune import tune_point

COARSE = 512
"""Points of the covering."""

REFINED = 3
"""Lowest points of the covering that are refined."""

_EVALUATIONS = 80
_NOWHERE = 1e3  # what a point outside the region costs


@dataclass(frozen=True, slots=True)
class Worst:
    """The operating point with the least margin.

    Attributes
    ----------
    point : (3,) float
        P (MW), Q (Mvar), |v| (pu).
    tuning : PointTuning
        Its judgement by the surrogate.
    points : (p, 3) float
        The covering.
    margin_m : (p,) float
        m of every point of the covering; infinite where nothing crosses 180 degrees.
    free : tuple of int
        Axes of `AXES` that were searched; |v| is not among them where a load flow decides it.
    """

    point: np.ndarray
    tuning: PointTuning
    points: np.ndarray
    margin_m: np.ndarray
    free: tuple[int, ...]


def worst_point(
    surrogate: Surrogate, grid: Grid, source_voltage_pu: float | None = None, rated_voltage_v: float | None = None
) -> Worst:
    """Search the region for the operating point with the least margin m.

    Parameters
    ----------
    surrogate : Surrogate
        Y over the region.
    grid : Grid
        The grid.
    source_voltage_pu : float or None
        With it, |v_pcc| follows from the load flow on this grid and is no free axis; points whose |v_pcc| leaves the
        region are not admissible. None: |v_pcc| is searched over the region like the other axes.
    rated_voltage_v : float or None
        Base of the voltages (V, line-to-line RMS); needed with ``source_voltage_pu``.

    Raises
    ------
    SeqsweepError
        If no point of the region is admissible on this grid.
    """
    points = surrogate.region.samples(COARSE)
    place = _placing(surrogate, grid, source_voltage_pu, rated_voltage_v)
    points = place(points)
    points = points[surrogate.region.holds(points)]
    if len(points) == 0:
        raise SeqsweepError("no operating point of the swept region exists on this grid: its |v_pcc| would leave it")
    margin = margins_of(surrogate, grid, points)
    starts = points[np.argsort(margin, kind="stable")[:REFINED]]
    refined = [_refine(surrogate, grid, start, place) for start in starts]
    point = min(refined, key=lambda x: float(margins_of(surrogate, grid, x[None])[0]))
    held = set() if source_voltage_pu is None else {2}
    free = tuple(sorted({int(a) for a in np.flatnonzero(surrogate.region.varies)} - held))
    return Worst(point, tune_point(surrogate.response(point), grid), points, margin, free)


def _placing(
    surrogate: Surrogate, grid: Grid, source_voltage_pu: float | None, rated_voltage_v: float | None
) -> Callable[[np.ndarray], np.ndarray]:
    """What makes of points (p, 3) those that exist on the grid: a load flow where the source's voltage is known."""
    if source_voltage_pu is None:
        return np.asarray
    if rated_voltage_v is None:
        raise SeqsweepError("a load flow needs the rated voltage (V, line-to-line RMS) that per unit refers to")

    def placed(points: np.ndarray) -> np.ndarray:
        return on_grid(surrogate, grid, points, source_voltage_pu, rated_voltage_v)

    return placed


def margins_of(surrogate: Surrogate, grid: Grid, points: np.ndarray) -> np.ndarray:
    """(p,) margin m at operating points (p, 3), from the surrogate's own frequencies above f1.

    Notes
    -----
    Between the frequencies log(Y1/Yg1) is a cubic spline over log|f - f1|.
    """
    from ..identify.frames import dq_to_pn

    y = dq_to_pn(surrogate.evaluate(points).y)
    return np.array([_least_crossing(surrogate.nu_hz, each, grid) for each in y])


def on_grid(
    surrogate: Surrogate, grid: Grid, points: np.ndarray, source_voltage_pu: float, rated_voltage_v: float
) -> np.ndarray:
    """Operating points (p, 3) with |v_pcc| from the load flow of the surrogate's own terminal current.

    Notes
    -----
    |V - Z(f1) i| = E for the source voltage E, i out of the device, V real; bisection on V over the region. Where the
    region holds no solution |v_pcc| is NaN.
    """
    z = grid.at_f1
    low, high = surrogate.region.low[2], surrogate.region.high[2]
    found = points.copy()
    at_low, at_high = (
        _source_excess(surrogate, points, np.full(len(points), v), z, source_voltage_pu, rated_voltage_v)
        for v in (low, high)
    )
    lower, upper = np.full(len(points), low), np.full(len(points), high)
    for _ in range(50):
        middle = (lower + upper) / 2.0
        below = _source_excess(surrogate, points, middle, z, source_voltage_pu, rated_voltage_v) < 0.0
        lower, upper = np.where(below, middle, lower), np.where(below, upper, middle)
    found[:, 2] = np.where((at_low <= 0.0) & (at_high >= 0.0), (lower + upper) / 2.0, np.nan)
    return found


def _source_excess(
    surrogate: Surrogate, points: np.ndarray, v_pu: np.ndarray, z: complex, source_pu: float, rated_v: float
) -> np.ndarray:
    at = np.column_stack([points[:, :2], v_pu])
    v = v_pu * rated_v
    return np.asarray(np.abs(v - z * np.sqrt(3.0) * surrogate.terminal_current(at)) - source_pu * rated_v)


def _least_crossing(nu_hz: np.ndarray, y_pn: np.ndarray, grid: Grid) -> float:
    """The least |Yg1/Y1| where Y1/Yg1 is negative real, above f1; infinite where it never is."""
    from scipy.interpolate import CubicSpline

    equivalents = siso(grid.f1_hz + nu_hz, y_pn, grid)
    ratio = np.log(-equivalents.y1 / equivalents.yg1)
    angle = np.unwrap(ratio.imag)  # a whole turn where the ratio is negative real
    size, turn = CubicSpline(np.log(nu_hz), ratio.real), CubicSpline(np.log(nu_hz), angle)
    turns = np.arange(np.ceil(angle.min() / (2.0 * np.pi)), np.floor(angle.max() / (2.0 * np.pi)) + 1.0)
    crossings = [turn.solve(2.0 * np.pi * whole, extrapolate=False) for whole in turns]
    at = np.concatenate(crossings) if crossings else np.zeros(0)
    return float(np.exp(-size(at).max())) if len(at) else float("inf")


def _refine(
    surrogate: Surrogate, grid: Grid, start: np.ndarray, place: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """The least margin near ``start``, by Nelder and Mead's simplex in the unit box."""
    from scipy.optimize import minimize

    region = surrogate.region
    axes = np.flatnonzero(region.varies)
    size = (region.high - region.low)[axes]

    def point_of(unit: np.ndarray) -> np.ndarray:
        point = start.copy()
        point[axes] = region.low[axes] + np.clip(unit, 0.0, 1.0) * size
        return place(point[None])[0]

    def cost(unit: np.ndarray) -> float:
        point = point_of(unit)
        return float(margins_of(surrogate, grid, point[None])[0]) if region.holds(point[None])[0] else _NOWHERE

    first = (start[axes] - region.low[axes]) / size
    inwards = np.where(first > 0.5, -0.05, 0.05)
    simplex = np.concatenate([first[None], first + np.diag(inwards)])
    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4},
    )
    return point_of(found.x)


__all__ = ["AXES", "Worst", "margins_of", "on_grid", "worst_point"]
