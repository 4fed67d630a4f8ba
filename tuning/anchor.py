"""What experiment proved of the device alone: how many unstable modes of its own it has.

A device whose disturbed runs came to rest on an ideal source has none. One that came to rest behind a grid Z0 has as
many as make that loop come out stable: as many as det(1 + Y Z0) turns, read from the rows.

The runs bound the growth of what they excite: a mode that grows more slowly than that would not have been seen. Such a
mode stays open, unless the rows tell that it decays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import erf, isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np

from ..identify.fit.dq_data import DqData
from ..identify.fit.model import FreePoles, unheld, unheld_exactly
from ..identify.fit.rational import RationalModel
from .grids.in_time import grid_of_fact
from .poles import SURELY
from .rows import Rows, wind_rows
from .siso import Grid

_GROWING = 0.02  # how likely a slow mode of a device that came to rest grows, over that it decays, before any row
_MODE = 1.0 / 3.0  # how likely a row that disagrees with its neighbours is a mode, and no error


@dataclass(frozen=True, slots=True)
class Anchor:
    """The fact ``stable_on`` of a table's operating point.

    Attributes
    ----------
    n_unstable : int or None
        Unstable modes of the device's own; None if nothing is known.
    grid : Grid or None
        The grid on which the device was seen to be stable; None for an ideal source, or if nothing is known.
    where : str
        The same in words.
    problem : str
        Why the fact cannot be used; empty where it can.
    growth_bound_per_s : float
        What grows more slowly (1/s) stays open; zero where somebody states that the device is stable.
    still_open : OpenMode or None
        The slow mode that the rows decide the least, once they were asked.
    """

    n_unstable: int | None
    grid: Grid | None
    where: str
    problem: str = ""
    growth_bound_per_s: float = 0.0
    still_open: OpenMode | None = None


class OpenMode(NamedTuple):
    """A mode of the device's own (rad/s) that the runs leave open, its error, and how probably it decays."""

    pole: complex
    std_per_s: float
    decays: float


def open_mode(model: RationalModel, anchor: Anchor, rows: Rows) -> OpenMode | None:
    """The mode held stable on an ideal source that may be slower than the bound and of which the rows tell the least.

    A row that was left out for disagreeing with its neighbours may be such a mode, too: one that is narrower than
    their distance.
    """
    bound = anchor.growth_bound_per_s
    if anchor.n_unstable != 0 or bound == 0.0:
        return None
    found = _asked_of_rows(model, bound, rows.data)
    if rows.left_out is not None:
        place = 2j * np.pi * float(rows.left_out.nu_hz[0])
        found.append(OpenMode(place, bound, 1.0 - _GROWING * _MODE))
    return min(found, key=lambda mode: mode.decays, default=None)


def _asked_of_rows(model: RationalModel, bound: float, data: DqData) -> list[OpenMode]:
    """Modes that may be slower than the bound.

    What rows say of them is what they say where nothing holds them on their side: the fit that is held hides whether
    they ask for one that grows.
    """
    exact = unheld_exactly(model, data)
    if exact is None:
        slow = _slow(model.poles, model.pole_std.real, bound)
        free = unheld(model, data) if len(slow) else None
        return [] if free is None else [_opened(model, int(k), free, bound) for k in slow]
    slow = _slow(exact.poles, exact.std_per_s, bound)
    return [_told(complex(exact.poles[k]), float(exact.std_per_s[k]), bound) for k in slow]


def _slow(poles: np.ndarray, std_per_s: np.ndarray, bound: float) -> np.ndarray:
    """Indices of the upper poles that may be slower than the bound."""
    return np.flatnonzero((np.abs(poles.real) < bound + SURELY * std_per_s) & (poles.imag >= 0.0))


def _opened(model: RationalModel, k: int, free: FreePoles, bound: float) -> OpenMode:
    """How probably a mode decays by the fit that nothing holds.

    Rows that ask for one that grows faster than the runs let it are in error, and say nothing beside the fit that is
    held.
    """
    nearest = int(np.argmin(np.abs(free.poles - model.poles[k])))
    pole, std = complex(free.poles[nearest]), float(free.std_per_s[nearest])
    if pole.real - SURELY * std > bound:
        pole, std = complex(model.poles[k]), float(model.pole_std[k].real)
    return _told(pole, std, bound)


def _told(pole: complex, std_per_s: float, bound: float) -> OpenMode:
    """How probably a mode decays, if it does not grow faster than the runs let it."""
    decays, slower = (_normal((limit - pole.real) / max(std_per_s, 1e-300)) for limit in (0.0, bound))
    return OpenMode(pole, std_per_s, decays / (decays + _GROWING * max(slower - decays, 1e-300)))


def _normal(x: float) -> float:
    """Standard normal distribution function."""
    return 0.5 * (1.0 + erf(x / sqrt(2.0)))


def anchor_of(meta: Mapping[str, Any], rows: Rows, f1_hz: float) -> Anchor:
    """The anchor that a table's operating point offers."""
    fact = meta.get("stable_on")
    place = fact.get("grid") if isinstance(fact, Mapping) else None
    if place == "ideal":
        return Anchor(0, None, "an ideal source", growth_bound_per_s=_bound(fact))
    if not isinstance(place, Mapping):
        return Anchor(None, None, "")
    grid = grid_of_fact(place, f1_hz)
    return _on(grid, wind_rows(rows, grid).number, _bound(fact))


def _bound(fact: Any) -> float:
    """The growth bound of a fact; zero where it has none."""
    bound = fact.get("growth_bound_per_s") if isinstance(fact, Mapping) else None
    return float(bound) if isinstance(bound, (int, float)) and isfinite(bound) else 0.0


def recounted(anchor: Anchor, rows: Rows, model: RationalModel) -> Anchor:
    """The anchor as it is if the way between f1 and the lowest row is that of ``model``, not a straight one.

    A pole of the device's own near f1, as an integrator has it, turns the locus there.
    """
    if anchor.grid is None:
        return anchor
    return _on(anchor.grid, wind_rows(rows, anchor.grid, model).number, anchor.growth_bound_per_s)


def _on(grid: Grid, turns: int, bound: float) -> Anchor:
    """What a device that was seen to be stable on a grid has of its own, if det(1 + Y Z) turns so often there."""
    if turns < 0:
        return Anchor(
            None,
            grid,
            grid.label,
            f"the device was stable on {grid.label}, but the rows turn det(1 + Y Z) {turns} times there, which is "
            "unstable whatever the device's own poles: table and grid do not belong together, or rows are missing",
        )
    return Anchor(turns, grid, grid.label, growth_bound_per_s=bound)
