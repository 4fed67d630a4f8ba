"""Which operating point to sweep next, and when enough have been swept.

The first points are a Latin design at Chebyshev levels: along every axis each level is taken once, and the levels crowd
towards the ends, where a polynomial goes astray first. From then on the next point is where the error bar is largest.
A surrogate is certified when `WIDER` times its largest bar is within the tolerance and the last `FRESH` sweeps,
predicted before they were made, were met within it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fit.dq_data import to_dq
from ..response import FrequencyResponse
from .surrogate import Region, Surrogate

FRESH = 2
"""Sweeps in a row that must meet their prediction."""

WIDER = 2.0
"""A bar holds at 95 of 100 places; the largest error of all places and frequencies is to stay below the certificate."""

WIDTH = 0.02
"""Parts of its feature's range to which the border of a jump is located."""

_CANDIDATES = 512
_APART = 0.02  # a candidate closer to a swept point, in parts of the region, would tell nothing


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the design has come.

    Attributes
    ----------
    doubt : float
        The largest that is left over the region, in the unit of the tolerance: of Y, its 95 % radius relative to ||Y||.
    at : (d,) float
        Where it stands (MW, Mvar, pu, parameters).
    missed : tuple of float
        By how much the latest sweeps missed their prediction at most, in the same unit, oldest first; sweeps that were
        made where nothing was predicted, in the gap of a jump, are not among them.
    width : float
        Of the gap of a jump, in parts of the feature's range; zero without one.
    """

    doubt: float
    at: np.ndarray
    missed: tuple[float, ...]
    width: float = 0.0

    def is_certified(self, tolerance: float, wider: float = WIDER) -> bool:
        """Whether the doubt, ``wider`` times, and the last `FRESH` sweeps agree with the tolerance."""
        fresh = self.missed[-FRESH:]
        known = self.width <= WIDTH and wider * self.doubt <= tolerance
        return known and len(fresh) == FRESH and max(fresh) <= tolerance


def first_count(n_axes: int) -> int:
    """Sweeps before the first surrogate: 6 along two axes, 8 along three, 10 along four."""
    return max(4, 2 * n_axes + 2)


def first_points(region: Region, seed: int = 0) -> np.ndarray:
    """Latin design at Chebyshev levels (n, d), in the units of the region; the same for the same seed.

    Notes
    -----
    Of many Latin designs the one whose points keep farthest apart is taken. Level k of n is (1 - cos(pi k/(n-1)))/2.
    """
    axes = np.flatnonzero(region.varies)
    n = first_count(len(axes))
    levels = 0.5 - 0.5 * np.cos(np.pi * np.arange(n) / (n - 1))
    random = np.random.default_rng(seed)
    designs = [np.stack([levels[random.permutation(n)] for _ in axes], axis=1) for _ in range(200)]
    unit = max(designs, key=_least_distance)
    points = np.tile(region.low, (n, 1))
    points[:, axes] += unit * (region.high - region.low)[axes]
    return points


def next_point(surrogate: Surrogate, region: Region) -> tuple[np.ndarray, float]:
    """The operating point (d,) of the region with the largest bar, not too near a swept one, and that bar."""
    candidates = region.samples(_CANDIDATES)
    candidates = candidates[surrogate.holds(candidates)]
    relative = surrogate.cautious.evaluate(candidates).relative.max(axis=1)
    return apart_from_swept(surrogate, candidates, relative), float(relative.max())


def apart_from_swept(surrogate: Surrogate, candidates: np.ndarray, doubt: np.ndarray) -> np.ndarray:
    """Of points (p, d) the one (d,) with the largest doubt that is not too near a swept point to tell anything."""
    region = surrogate.region
    axes = np.flatnonzero(region.varies)
    size = (region.high - region.low)[axes]
    apart = np.abs(candidates[:, None, axes] - surrogate.points[None][:, :, axes]) / size
    free = apart.max(axis=2).min(axis=1) > _APART
    return np.asarray(candidates[int(np.argmax(np.where(free, doubt, -1.0)))])


def gap_of(surrogate: Surrogate) -> tuple[float, np.ndarray | None]:
    """Width of the gap of a jump, and the operating point (d,) that narrows it; None where it is narrow enough.

    A jump that is only suspected has no width yet, but its point too: two sweeps close together tell a jump from a
    slope.
    """
    border = surrogate.border or surrogate.suspected
    if border is None:
        return 0.0, None
    points = surrogate.region.samples(_CANDIDATES)
    width = border.width(points)
    question = border.question(surrogate.points, points, WIDTH) if width > WIDTH else None
    return (0.0 if surrogate.border is None else width), question


def fresh_rows(surrogate: Surrogate, response: FrequencyResponse) -> tuple[np.ndarray, np.ndarray]:
    """The usable rows of a sweep at the surrogate's frequencies: their places (n,) there, and Y (n, 2, 2) in dq."""
    data = to_dq(response)
    at = np.abs(surrogate.nu_hz[None] - data.nu_hz[:, None]).argmin(axis=1)
    same = np.abs(surrogate.nu_hz[at] - data.nu_hz) <= 1e-6 * data.nu_hz
    return at[same], data.y[same]


def missed_by(surrogate: Surrogate, response: FrequencyResponse, point: np.ndarray) -> float:
    """Largest ||Y - Y predicted||_F / ||Y||_F over the rows of a fresh sweep at ``point`` (d,)."""
    at, y = fresh_rows(surrogate, response)
    predicted = surrogate.evaluate(point[None]).y[0, at]
    off = np.linalg.norm(predicted - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2))
    return float(off.max(initial=0.0))


def _least_distance(unit: np.ndarray) -> float:
    apart = np.linalg.norm(unit[:, None] - unit[None], axis=2)
    return float(apart[np.triu_indices(len(unit), 1)].min())
