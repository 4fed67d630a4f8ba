"""What would decide an undecided loop: which rows, and how many times the periods."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, gradient, row_shares
from .poles import mode_weight
from .siso import Grid

MOST_PERIODS = 1000
"""More times the periods than this is no advice."""


class Remedy(NamedTuple):
    """Rows worth measuring again.

    Attributes
    ----------
    nu_hz : (float, float)
        Lowest and highest |f - f1| of them (Hz).
    times : int
        How many times the periods they need.
    """

    nu_hz: tuple[float, float]
    times: int


def remedy(model: RationalModel, grid: Grid, pole: complex, part: float) -> Remedy | None:
    """The cheapest band of rows that brings the variance of Re(pole) down to ``part`` of itself; None if too dear.

    Noise goes down with the number of periods. A band grows from the row that matters most towards the neighbour that
    matters more; of all such bands the one with the fewest periods in total is taken.
    """
    g = gradient(model, np.array([pole]), mode_weight(model, grid, pole))[0]
    share = row_shares(model, g.real)
    first = last = int(np.argmax(share))
    best: tuple[float, Remedy] | None = None
    while last - first + 1 < len(share):
        inside = float(np.sum(share[first : last + 1]))
        room = part - (1.0 - inside)
        times = int(np.ceil(inside / room)) if room > inside / MOST_PERIODS else MOST_PERIODS + 1
        price = (last - first + 1) * (times - 1.0)
        if times <= MOST_PERIODS and (best is None or price < best[0]):
            best = price, Remedy((float(model.nu_hz[first]), float(model.nu_hz[last])), times)
        below = share[first - 1] if first > 0 else -1.0
        above = share[last + 1] if last + 1 < len(share) else -1.0
        first, last = (first - 1, last) if below > above else (first, last + 1)
    return None if best is None else best[1]
