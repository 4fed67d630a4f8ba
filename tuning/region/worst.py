"""The worst operating point of a region, on one grid or on a bank: searched over all of it, not picked from a list.

Every point of an even covering of the region is scanned on every grid (`scan`); the lowest few are refined by a
simplex, and the worst of them is judged as a whole by `tune_point`. What the surrogate's doubt leaves open is told
beside it: the least lower bounds of the margin, and where they stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from ...identify.surrogate.surrogate import Surrogate
from ...plant.errors import SeqsweepError
from ..result import PointTuning
from ..siso import Grid
from ..tune import tune_point
from .loadflow import Situation, admissible
from .scan import Scan, scan

Least = Literal["margin", "damping", "probability"]
"""By what an operating point is worse than another."""

COARSE = 512
"""Points of the covering on one grid; on a bank `COARSE_OF_BANK`."""

COARSE_OF_BANK = 256

REFINED = 3
"""Lowest points of the covering that are refined."""

LOWS = 200
"""Least lower bounds that are kept."""

_EVALUATIONS = 80
_NOWHERE = 1e3  # what a point outside the region costs


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst operating point.

    Attributes
    ----------
    point : (d,) float
        P (MW), Q (Mvar), |v| (pu), and the values of parameters that are axes.
    situation : Situation
        The grid on which it is the worst.
    tuning : PointTuning
        Its judgement by the surrogate.
    points : (p, d) float
        The covering on that grid.
    scanned : Scan
        What is known of every point of the covering.
    least : Least
        By what it was searched.
    free : tuple of int
        Axes of the region that were searched; |v| is not among them where a load flow decides it.
    lows : (q,) float
        The least lower bounds of m over all grids and points, at 95 %, rising; at most `LOWS`.
    low_points : (q, d) float
        Where they stand.
    n_points : int
        Admissible points of all coverings.
    """

    point: np.ndarray
    situation: Situation
    tuning: PointTuning
    points: np.ndarray
    scanned: Scan
    least: Least
    free: tuple[int, ...]
    lows: np.ndarray
    low_points: np.ndarray
    n_points: int

    @property
    def margin_m(self) -> np.ndarray:
        """(p,) m of every point of the covering; infinite where nothing crosses 180 degrees."""
        return self.scanned.margin_m


class _Covered(NamedTuple):
    situation: Situation
    points: np.ndarray
    scanned: Scan
    cost: np.ndarray


def worst_point(
    surrogate: Surrogate, grid: Grid, source_voltage_pu: float | None = None, rated_voltage_v: float | None = None
) -> Worst:
    """Search the region for the operating point with the least margin m on one grid; see `worst_of_bank`."""
    return worst_of_bank(surrogate, [Situation(grid.label, grid, source_voltage_pu, rated_voltage_v)])


def worst_of_bank(
    surrogate: Surrogate, situations: Sequence[Situation], least: Least = "margin", margin: float = 1.4
) -> Worst:
    """Search the region on every grid for the operating point with the least margin, damping or probability.

    Parameters
    ----------
    surrogate : Surrogate
        Y over the region.
    situations : sequence of Situation
        The grids. Where the source's voltage is known |v_pcc| follows from the load flow; points whose |v_pcc| leaves
        the region are not admissible. Elsewhere |v_pcc| is searched over the region like the other axes.
    least : Least
        What is searched for. "probability" goes by how far m is from one in terms of its doubt.
    margin : float
        Required margin m of the judgement.

    Raises
    ------
    SeqsweepError
        If no point of the region is admissible on any grid, or ``least`` is none of the three.
    """
    if least not in get_args(Least):
        raise SeqsweepError(f"least is {least!r}; needed is one of {', '.join(get_args(Least))}")
    covering = surrogate.region.samples(COARSE if len(situations) == 1 else COARSE_OF_BANK)
    covered = [c for each in situations if len((c := _covered(surrogate, each, covering, least)).points)]
    if not covered:
        raise SeqsweepError("no operating point of the swept region exists on this grid: its |v_pcc| would leave it")
    starts = sorted((float(c.cost[k]), n, int(k)) for n, c in enumerate(covered) for k in _lowest(c.cost, covered))
    refined = [_refine(surrogate, covered[n], k, least) for _, n, k in starts[:REFINED]]
    _, point, situation = min(refined, key=lambda found: found[0])
    own = next(c for c in covered if c.situation is situation)
    everywhere = np.concatenate([c.points for c in covered])
    low = np.concatenate([c.scanned.margin_low for c in covered])
    order = np.argsort(low, kind="stable")[:LOWS]
    response = surrogate.response(point)
    return Worst(
        point=point,
        situation=situation,
        tuning=tune_point(response, situation.grid, margin=margin, bases=surrogate.meta.get("bases")),
        points=own.points,
        scanned=own.scanned,
        least=least,
        free=_free(surrogate, situation),
        lows=low[order],
        low_points=everywhere[order],
        n_points=len(everywhere),
    )


def _covered(surrogate: Surrogate, situation: Situation, covering: np.ndarray, least: Least) -> _Covered:
    """The admissible points on one grid: of a covering of the region, or of what the load flow makes of it."""
    points = admissible(surrogate, situation, covering)
    if len(points) == 0:
        return _Covered(situation, points, Scan.of_none(), np.zeros(0))
    found = scan(surrogate, situation.grid, points)
    return _Covered(situation, points, found, _cost(found, least))


def _cost(found: Scan, least: Least) -> np.ndarray:
    if least == "damping":
        return found.damping
    if least == "margin":
        return found.margin_m
    known = np.isfinite(found.margin_m)  # elsewhere nothing crosses 180 degrees: m and its bound are both infinite
    m, low = found.margin_m[known], found.margin_low[known]
    sure = np.full(len(known), np.inf)
    sure[known] = (m - 1.0) / np.maximum(m - low, 1e-9)
    return sure


def _lowest(cost: np.ndarray, covered: Sequence[_Covered]) -> np.ndarray:
    """Starts on one grid: a few where it is the only one, else its lowest point."""
    return np.argsort(cost, kind="stable")[: REFINED if len(covered) == 1 else 1]


def _free(surrogate: Surrogate, situation: Situation) -> tuple[int, ...]:
    held = set() if situation.source_voltage_pu is None else {2}
    return tuple(sorted({int(a) for a in np.flatnonzero(surrogate.region.varies)} - held))


def _refine(surrogate: Surrogate, covered: _Covered, start: int, least: Least) -> tuple[float, np.ndarray, Situation]:
    """The least cost near a point of the covering, by Nelder and Mead's simplex in the unit box."""
    from scipy.optimize import minimize

    region, situation = surrogate.region, covered.situation
    axes = list(_free(surrogate, situation))
    size = (region.high - region.low)[axes]
    begin = covered.points[start]

    def point_of(unit: np.ndarray) -> np.ndarray:
        point = begin.copy()
        point[axes] = region.low[axes] + np.clip(unit, 0.0, 1.0) * size
        return np.asarray(situation.place(surrogate, point[None])[0])

    def cost(unit: np.ndarray) -> float:
        point = point_of(unit)
        if not surrogate.holds(point[None])[0]:
            return _NOWHERE
        return float(np.minimum(_cost(scan(surrogate, situation.grid, point[None]), least)[0], _NOWHERE))

    first = (begin[axes] - region.low[axes]) / size
    if not axes:
        return cost(first), begin, situation
    inwards = np.where(first > 0.5, -0.05, 0.05)
    simplex = np.concatenate([first[None], first + np.diag(inwards)])
    options = {"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4}
    found = minimize(cost, first, method="Nelder-Mead", options=options)
    return float(found.fun), point_of(found.x), situation


__all__ = ["Least", "Situation", "Worst", "worst_of_bank", "worst_point"]
