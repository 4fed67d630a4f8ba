"""Polygons of Z as operators give them: a region of the impedance plane for each band of frequencies.

No corner proves anything by itself. What does: det(1 + Y Z) = (1 + Ypp z1)(1 + Ynn z2) - Ypn Ynp z1 z2 is affine in
each of the two scalars, z1 = z(f) and z2 = conj z(2 f1 - f) taken independently of each other, so that its values over
two polygons lie in the convex hull of those at pairs of corners. If zero is outside that hull at every frequency, no
member of the region is on the edge of stability, and as many modes are unstable on all of them as on any one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ...identify.fit.rational import RationalModel, evaluate, evaluate_pn, spread
from ...identify.frames import T_INVERSE, T
from .errors import GridError
from .promise import Grid
from .rational import RationalGrid
from .series import SeriesRL
from .tables import ZTable, grid_of_table

CIRCLE_CORNERS = 24
STANDARD_ERRORS = 2.576
"""What the device's errors may do at one frequency: 99.5 % to one side."""

_MOST_HALVINGS = 14


class Region(NamedTuple):
    """A convex polygon of z (k,) in ohm that holds from ``f_min_hz`` to ``f_max_hz``."""

    f_min_hz: float
    f_max_hz: float
    corners: np.ndarray


@dataclass(frozen=True, slots=True)
class RegionGrid:
    """Every grid whose impedance lies in the regions, and one of them.

    Attributes
    ----------
    regions : tuple of Region
        Ascending; where bands meet or overlap, both regions are allowed.
    member : Grid
        A grid inside all of them, by which the whole is decided.
    name : str
        For people.
    """

    regions: tuple[Region, ...]
    member: Grid
    name: str = ""

    def corners_at(self, f_hz: float) -> np.ndarray | None:
        """Corners (k,) of what is allowed at ``f_hz`` above zero; None where no region says anything."""
        found = [r.corners for r in self.regions if r.f_min_hz <= f_hz <= r.f_max_hz]
        return np.concatenate(found) if found else None


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
    """

    excluded: bool
    nu_hz: float
    reason: str


# Reading -------------------------------------------------------------------------------------------------------------


def regions_grid(document: Mapping[str, Any], f1_hz: float, name: str = "") -> RegionGrid:
    """Regions from a document with ``[[region]]`` and, if one is known, the ``[member]`` r_ohm and x_ohm.

    A region holds for ``order`` (half an order either way) or from ``f_min_hz`` to ``f_max_hz``, and is ``points``
    (R, X), ``r_ohm`` and ``x_ohm`` from to, ``circle`` (R, X, radius), or ``magnitude_ohm`` and ``angle_deg`` from to.

    Raises
    ------
    GridError
        If a region cannot be read, or the member is not inside all of them.
    """
    entries = document.get("region")
    if not isinstance(entries, Sequence) or not entries:
        raise GridError(f"{name or 'grid'}: no [[region]]")
    regions = tuple(sorted((_region(entry, k, f1_hz) for k, entry in enumerate(entries, 1)), key=lambda r: r[:2]))
    member = _member(document.get("member"), regions, f1_hz, name)
    _check_member(member, regions, name)
    return RegionGrid(regions, member, name)


def _region(entry: Mapping[str, Any], number: int, f1_hz: float) -> Region:
    try:
        if "order" in entry:
            order = float(entry["order"])
            low, high = (order - 0.5) * f1_hz, (order + 0.5) * f1_hz
        else:
            low, high = float(entry["f_min_hz"]), float(entry["f_max_hz"])
        corners = _corners(entry)
    except (KeyError, TypeError, ValueError) as error:
        raise GridError(
            f"region {number}: {error}; needed are order, or f_min_hz and f_max_hz, and one of points, r_ohm and x_ohm "
            "(from, to), circle, magnitude_ohm and angle_deg (from, to)"
        ) from None
    if not 0.0 <= low < high or len(corners) == 0 or not np.all(np.isfinite(corners)):
        raise GridError(f"region {number}: from {low:g} to {high:g} Hz with {len(corners)} points is no region")
    if corners.real.min() < -1e-9 * np.abs(corners).max():
        raise GridError(f"region {number}: it holds impedances of negative resistance; a passive grid has none")
    return Region(max(low, 0.0), high, corners)


def _corners(entry: Mapping[str, Any]) -> np.ndarray:
    """Corners of the convex hull (k,), or of a polygon around it for circle and sector."""
    if "points" in entry:
        return np.array([complex(r, x) for r, x in entry["points"]])
    if "circle" in entry:
        r, x, radius = entry["circle"]
        turn = 2.0 * np.pi * np.arange(CIRCLE_CORNERS) / CIRCLE_CORNERS
        around = complex(r, x) + radius / np.cos(np.pi / CIRCLE_CORNERS) * np.exp(1j * turn)
        return np.maximum(around.real, 0.0) + 1j * around.imag
    if "magnitude_ohm" in entry:
        (near, far), (low, high) = entry["magnitude_ohm"], np.radians(entry["angle_deg"])
        angles = np.linspace(low, high, 9)
        outer = far / np.cos((high - low) / 16.0)
        around = np.concatenate([near * np.exp(1j * angles[[0, -1]]), outer * np.exp(1j * angles)])
        return np.maximum(around.real, 0.0) + 1j * around.imag
    (r0, r1), (x0, x1) = entry["r_ohm"], entry["x_ohm"]
    return np.array([complex(r0, x0), complex(r0, x1), complex(r1, x0), complex(r1, x1)])


def _member(given: Any, regions: Sequence[Region], f1_hz: float, name: str) -> Grid:
    """The member that is given, or a passive grid through the middles of the regions."""
    if given is not None:
        return _given_member(given, f1_hz)
    f = np.array([np.sqrt(max(r.f_min_hz, 0.1 * f1_hz) * r.f_max_hz) for r in regions])
    z = np.array([r.corners.mean() for r in regions])
    w = 2.0 * np.pi * f
    x_ohm = float(np.sum(z.imag * w) / np.sum(w**2)) * 2.0 * np.pi * f1_hz
    series = SeriesRL(max(float(np.median(z.real)), 0.0), x_ohm, f1_hz) if x_ohm > 0.0 else None
    if series is not None and _outside(series, regions) is None:
        return series
    rows = np.array(
        [_middle_row(r, g) for r in regions for g in np.geomspace(max(r.f_min_hz, 1.0), r.f_max_hz, 5)[1:4]]
    )
    order = np.argsort(rows[:, 0].real)
    fitted: RationalGrid = grid_of_table(ZTable(rows[order, 0].real, rows[order, 1]), f1_hz, name)
    return fitted


def _given_member(given: Any, f1_hz: float) -> SeriesRL:
    try:
        return SeriesRL(float(given.get("r_ohm", 0.0)), float(given["x_ohm"]), f1_hz)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise GridError(f"[member]: {error}; needed are r_ohm and x_ohm, numbers in ohm at f1") from None


def _middle_row(region: Region, f_hz: float) -> tuple[float, complex]:
    return f_hz, complex(region.corners.mean())


def _check_member(member: Grid, regions: Sequence[Region], name: str) -> None:
    outside = _outside(member, regions)
    if outside is not None:
        raise GridError(
            f"{name or 'regions'}: the member {member.label} lies outside the region at {outside:.4g} Hz; give a "
            "[member] with r_ohm and x_ohm that is inside all of them"
        )


def _outside(member: Grid, regions: Sequence[Region]) -> float | None:
    """A frequency (Hz) at which the member leaves what is allowed; None if it does not."""
    for region in regions:
        f = np.linspace(max(region.f_min_hz, 1e-3), region.f_max_hz, 9)[1:-1]
        z = member.impedance_dq(2j * np.pi * (f - member.f1_hz))
        own = (z[:, 0, 0] + z[:, 1, 1]) / 2.0 + 1j * (z[:, 1, 0] - z[:, 0, 1]) / 2.0
        inside = [_holds(region.corners, each) for each in own]
        if not all(inside):
            return float(f[inside.index(False)])
    return None


def _holds(corners: np.ndarray, z: complex) -> bool:
    """Whether a point is in the convex hull of corners, to rounding."""
    return not _zero_outside(corners - z)[0] or bool(np.abs(corners - z).min() < 1e-9 * abs(z))


# Zero outside the hull -----------------------------------------------------------------------------------------------


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

    A device that is passive at a frequency cannot oscillate there with a passive grid, whatever its impedance.
    """
    sets = [_set_at(model, regions, float(nu)) for nu in _active(model)]
    if not sets:
        return Exclusion(True, 0.0, "")
    for before, after in pairwise(sets):
        bad = _between(model, regions, before, after)
        if bad is not None:
            return Exclusion(False, bad.nu_hz, bad.problem)
    return Exclusion(True, min(sets, key=lambda each: each.margin).nu_hz, "")


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
    _, distance = _zero_outside(values)
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


def _zero_outside(points: np.ndarray) -> tuple[bool, float]:
    """Whether zero is outside the convex hull of points (k,), and its distance from the hull."""
    angles = np.sort(np.angle(points))
    gaps = np.append(np.diff(angles), angles[0] + 2.0 * np.pi - angles[-1])
    widest = int(np.argmax(gaps))
    if gaps[widest] <= np.pi:
        return False, 0.0
    return True, _distance(points)


def _distance(points: np.ndarray) -> float:
    """Least distance of zero from the segments between points, which the hull's edges are among."""
    a, b = points[:, None], points[None, :]
    along = b - a
    part = np.clip(-(a * along.conj()).real / np.maximum(np.abs(along) ** 2, 1e-300), 0.0, 1.0)
    return float(np.abs(a + part * along).min())
