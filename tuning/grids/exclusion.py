"""Is every grid of a region on the same side of the edge, and how far is the edge: zero outside a convex hull.

det(1 + Y Z) = (1 + Ypp z1)(1 + Ynn z2) - Ypn Ynp z1 z2 is affine in each of the two scalars, z1 = z(f) and
z2 = conj z(2 f1 - f) taken independently of each other, so that its values over two polygons lie in the convex hull of
those at pairs of corners. If zero is outside that hull at every frequency, no member of the region is on the edge of
stability, and as many modes are unstable on all of them as on any one. A device that is passive at a frequency cannot
oscillate there with a passive grid, so that only the others matter.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...identify.fit.rational import RationalModel, evaluate, evaluate_pn, spread
from ...identify.frames import T_INVERSE, T
from .hull import zero_outside
from .regions import RegionGrid

STANDARD_ERRORS = 2.576
"""What the device's errors may do at one frequency: 99.5 % to one side."""

GROWTH_RANGE = (0.05, 20.0)
"""Multiples of a region's extent about its member among which the critical one is sought."""

GROWTH_PRECISION = 1.01

_MOST_HALVINGS = 14


class Exclusion(NamedTuple):
    """Whether zero is outside the set of det(1 + Y Z).

    Attributes
    ----------
    excluded : bool
        At every |f - f1| that matters.
    nu_hz : float
        Where it is not, or where it is the nearest (Hz).
    reason : str
        Empty where it is excluded.
    distance : float
        Least distance of zero from the set where the device is not passive, less what the device's errors may do; 1
        for no grid at all, 0 where zero is not excluded.
    """

    excluded: bool
    nu_hz: float
    reason: str
    distance: float


class _Set(NamedTuple):
    """det(1 + Y Z) at all pairs of corners for one |f - f1|.

    Attributes
    ----------
    nu_hz : float
        |f - f1| (Hz).
    values : (k,) complex
        At the pairs.
    margin : float
        Distance of zero from their hull less what the device's errors may do; not above zero where it is not excluded.
    problem : str
        Why zero is not excluded; empty where it is.
    """

    nu_hz: float
    values: np.ndarray
    margin: float
    problem: str


def exclusion(model: RationalModel, regions: RegionGrid) -> Exclusion:
    """Whether no member of the regions puts a mode on the axis, at any |f - f1| where the device is not passive.

    Parameters
    ----------
    model : RationalModel
        The device.
    regions : RegionGrid
        The grids.
    """
    sets = [_set_at(model, regions, float(nu)) for nu in _active(model)]
    if not sets:
        return Exclusion(True, 0.0, "", 1.0)
    for before, after in pairwise(sets):
        bad = _between(model, regions, before, after)
        if bad is not None:
            return Exclusion(False, bad.nu_hz, bad.problem, 0.0)
    nearest = min(sets, key=lambda each: each.margin)
    return Exclusion(True, nearest.nu_hz, "", nearest.margin)


def critical_growth(model: RationalModel, regions: RegionGrid) -> float | None:
    """By how much the regions may grow about their member, all at once, before zero is no longer excluded.

    Below one they have to shrink so far: what is to be known better of the grid. None where they may grow without an
    end, zero where not even the member with a hair's breadth around it is excluded.
    """

    def holds(growth: float) -> bool:
        return exclusion(model, replace(regions, growth=growth)).excluded

    low, high = GROWTH_RANGE
    if holds(high):
        return None
    if not holds(low):
        return 0.0
    while high > GROWTH_PRECISION * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _active(model: RationalModel) -> np.ndarray:
    """|f - f1| (Hz) over the bands where the device is not passive for certain, close together."""
    end = float(model.nu_hz[-1])
    nu = np.unique(np.concatenate([[0.0], np.geomspace(1e-2, end, 500), np.linspace(0.0, end, 400), model.nu_hz]))
    y = evaluate(model, 2j * np.pi * nu)
    passive = np.linalg.eigvalsh((y + np.swapaxes(y.conj(), 1, 2)) / 2.0)[:, 0] > 1e-6 * np.linalg.norm(y, axis=(1, 2))
    active = np.flatnonzero(~passive)
    if len(active) == 0:
        return np.zeros(0)
    return nu[max(active[0] - 1, 0) : min(active[-1] + 2, len(nu))]


def _between(
    model: RationalModel, regions: RegionGrid, before: _Set, after: _Set, halvings: int = _MOST_HALVINGS
) -> _Set | None:
    """The first set from ``before`` to ``after`` whose hull holds zero; None if none does.

    Sets whose values move by less than half the margin have none between them. What still moves when the interval is
    a hair's breadth is the end of one region and the beginning of the next.
    """
    for each in (before, after):
        if each.problem:
            return each
    same = len(before.values) == len(after.values)
    near = same and np.abs(after.values - before.values).max() < 0.5 * min(before.margin, after.margin)
    if near or halvings == 0:
        return None
    middle = _set_at(model, regions, (before.nu_hz + after.nu_hz) / 2.0)
    left = _between(model, regions, before, middle, halvings - 1)
    return left if left is not None else _between(model, regions, middle, after, halvings - 1)


def _set_at(model: RationalModel, regions: RegionGrid, nu_hz: float) -> _Set:
    """The values at all pairs of corners, and whether zero is outside their hull for certain."""
    f1 = model.f1_hz
    first, mirror = regions.corners_at(f1 + nu_hz), regions.corners_at(abs(f1 - nu_hz))
    if first is None or mirror is None:
        where = f1 + nu_hz if first is None else abs(f1 - nu_hz)
        problem = f"no region is given at {where:.4g} Hz, where the device is not passive"
        return _Set(nu_hz, np.zeros(0, dtype=complex), 0.0, problem)
    z1, z2 = (each.ravel() for each in np.meshgrid(first, _of_mirror(mirror, nu_hz, f1)))
    y = evaluate_pn(model, np.array([f1 + nu_hz]))[0]
    values = (1.0 + y[0, 0] * z1) * (1.0 + y[1, 1] * z2) - y[0, 1] * y[1, 0] * z1 * z2
    _, distance = zero_outside(values)
    margin = distance - STANDARD_ERRORS * _standard_error(model, nu_hz, y, z1, z2)
    place = f"{f1 - nu_hz:.4g}/{f1 + nu_hz:.4g} Hz"
    problem = "" if margin > 0.0 else f"at {place} some members of the region may put a mode on the axis"
    return _Set(nu_hz, values, margin, problem)


def _of_mirror(corners: np.ndarray, nu_hz: float, f1_hz: float) -> np.ndarray:
    """z at the signed frequency nu - f1 (Hz) from the region at its magnitude."""
    return corners if nu_hz >= f1_hz else corners.conj()


def _standard_error(model: RationalModel, nu_hz: float, y: np.ndarray, z1: np.ndarray, z2: np.ndarray) -> float:
    """Largest standard error of the values: d det = tr(adj(1 + Y Z) dY Z)."""
    weight = np.empty((len(z1), 2, 2), dtype=complex)
    weight[:, 0, 0], weight[:, 1, 1] = (1.0 + y[1, 1] * z2) * z1, (1.0 + y[0, 0] * z1) * z2
    weight[:, 0, 1], weight[:, 1, 0] = -y[1, 0] * z1 * z2, -y[0, 1] * z1 * z2
    in_dq = T.T @ weight @ T_INVERSE.T
    s = np.full(len(z1), 2j * np.pi * nu_hz)
    return float(np.linalg.norm(np.abs(spread(model, s, in_dq)), axis=1).max())
