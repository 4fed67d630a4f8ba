"""What would decide an undecided loop: which rows, and how many times the periods."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, gradient, row_shares
from .poles import mode_weight
from .probability import DECIDED_AT, Doubt, locus_errors
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

    Noise goes down with the number of periods; what the model leaves out is taken to go with it. A band grows from the
    row that matters most towards the neighbour that matters more; of all such bands the one with the fewest periods in
    total is taken.
    """
    g = gradient(model, np.array([pole]), mode_weight(model, grid, np.array([pole])))[0]
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


def grid_is_to_blame(model: RationalModel, grid: Grid, at: Doubt) -> bool:
    """Whether more of the doubt comes from the grid's rows than from the device's."""
    by_device, by_grid = locus_errors(model, grid, np.array([at.nu_hz]))
    return bool(np.linalg.norm(by_grid) > np.linalg.norm(by_device))


def advice_on_grid(model: RationalModel, at: Doubt) -> str:
    """How much better the grid's own scan would have to be, and where."""
    times = (DECIDED_AT / max(at.distance, 1e-3)) ** 2
    if times > MOST_PERIODS:
        return "the loop is so close to the edge that no affordable scan of the grid decides"
    places = " and ".join(f"{f:.4g}" for f in sorted({abs(model.f1_hz - at.nu_hz), model.f1_hz + at.nu_hz}))
    return f"a scan of the grid with {int(np.ceil(times))} times the averaging near {places} Hz would decide"
