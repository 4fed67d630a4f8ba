"""Polygons of Z as operators give them: a region of the impedance plane for each band of frequencies.

A region holds a grid by its impedance at every frequency, and each frequency by itself: what that proves is the
matter of `exclusion`. One member, a grid inside all of them, is judged as any grid is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .errors import GridError
from .hull import passive_part, zero_outside
from .promise import Grid, own_impedance
from .rational import RationalGrid
from .series import SeriesRL
from .tables import ZTable, grid_of_table

CIRCLE_CORNERS = 24


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
    growth : float
        Multiplies the extent of the regions about the member.
    """

    regions: tuple[Region, ...]
    member: Grid
    name: str = ""
    growth: float = 1.0

    def corners_at(self, f_hz: float) -> np.ndarray | None:
        """Corners (k,) of what is allowed at ``f_hz`` above zero; None where no region says anything."""
        found = [r.corners for r in self.regions if r.f_min_hz <= f_hz <= r.f_max_hz]
        if not found:
            return None
        corners = np.concatenate(found)
        if self.growth == 1.0:
            return corners
        centre = own_impedance(self.member, f_hz)
        return passive_part(centre + self.growth * (corners - centre))


def member_of(grid: Grid | RegionGrid) -> Grid:
    """The grid itself; of regions the one that stands for all."""
    return grid.member if isinstance(grid, RegionGrid) else grid


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
        told = f"{error.args[0]} is missing" if isinstance(error, KeyError) else error
        raise GridError(
            f"region {number}: {told}; needed are order, or f_min_hz and f_max_hz, and one of points, r_ohm and x_ohm "
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
        return np.array([complex(*_pair(point)) for point in entry["points"]])
    if "circle" in entry:
        r, x, radius = _numbers(entry, "circle", 3)
        turn = 2.0 * np.pi * np.arange(CIRCLE_CORNERS) / CIRCLE_CORNERS
        around = complex(r, x) + radius / np.cos(np.pi / CIRCLE_CORNERS) * np.exp(1j * turn)
        return passive_part(around)
    if "magnitude_ohm" in entry:
        (near, far), (low, high) = _numbers(entry, "magnitude_ohm", 2), np.radians(_numbers(entry, "angle_deg", 2))
        angles = np.linspace(low, high, 9)
        outer = far / np.cos((high - low) / 16.0)
        around = np.concatenate([near * np.exp(1j * angles[[0, -1]]), outer * np.exp(1j * angles)])
        return passive_part(around)
    (r0, r1), (x0, x1) = _numbers(entry, "r_ohm", 2), _numbers(entry, "x_ohm", 2)
    return np.array([complex(r0, x0), complex(r0, x1), complex(r1, x0), complex(r1, x1)])


def _numbers(entry: Mapping[str, Any], key: str, n: int) -> list[float]:
    """A list of ``n`` numbers under a key."""
    value = entry[key]
    if not isinstance(value, list) or len(value) != n or not all(_is_number(each) for each in value):
        raise GridError(f"{key} = {value!r}: needed are {n} numbers")
    return [float(each) for each in value]


def _pair(point: Any) -> tuple[float, float]:
    """R and X of a corner."""
    if not isinstance(point, list) or len(point) != 2 or not all(_is_number(each) for each in point):
        raise GridError(f"points: {point!r} is no corner, which has two numbers, R and X")
    return float(point[0]), float(point[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
    try:
        fitted: RationalGrid = grid_of_table(ZTable(rows[order, 0].real, rows[order, 1]), f1_hz, name)
    except GridError:
        raise GridError(
            f"{name or 'regions'}: no grid through the middles of the regions was found by which they could be judged; "
            "give a [member] with r_ohm and x_ohm that is inside all of them"
        ) from None
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
    return not zero_outside(corners - z)[0] or bool(np.abs(corners - z).min() < 1e-9 * abs(z))
