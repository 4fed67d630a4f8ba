"""What experiment proved of the device alone: how many unstable modes of its own it has.

A device whose disturbed runs came to rest on an ideal source has none. One that came to rest behind a grid Z0 has as
many as make that loop come out stable: as many as det(1 + Y Z0) turns, read from the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .grids.in_time import grid_of_fact
from .rows import Rows, wind_rows
from .siso import Grid


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
    """

    n_unstable: int | None
    grid: Grid | None
    where: str
    problem: str = ""


def anchor_of(meta: Mapping[str, Any], rows: Rows, f1_hz: float) -> Anchor:
    """The anchor that a table's operating point offers."""
    fact = meta.get("stable_on")
    place = fact.get("grid") if isinstance(fact, Mapping) else None
    if place == "ideal":
        return Anchor(0, None, "an ideal source")
    if not isinstance(place, Mapping):
        return Anchor(None, None, "")
    grid = grid_of_fact(place, f1_hz)
    turns = wind_rows(rows, grid).number
    if turns < 0:
        return Anchor(
            None,
            grid,
            grid.label,
            f"the device was stable on {grid.label}, but the rows turn det(1 + Y Z) {turns} times there, which is "
            "unstable whatever the device's own poles: table and grid do not belong together, or rows are missing",
        )
    return Anchor(turns, grid, grid.label)
