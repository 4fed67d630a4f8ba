"""The worst operating point over a bank of grids, searched by a surrogate and confirmed by sweeps."""

from __future__ import annotations

from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from seqsweep.identify.surrogate.design import first_points
from seqsweep.sweep import worst
from seqsweep.tuning.region.worst import worst_of_bank
from tests.support.regions import BASES, PQV, bank_of_27, brute_force, swept

from .rival import build_rival

MOST = 12
"""Sweeps that it may take."""

NEAR = 0.005
"""Relative distance of m from brute force."""


class Searched(NamedTuple):
    """Sweeps that the answer rests on, and m there."""

    sweeps: int
    m: float


def searched(build: str, seed: int) -> Searched:
    """The search from a random first design."""
    situations = list(bank_of_27())
    responses = [swept(point) for point in first_points(PQV, seed)]

    def run() -> worst.ConfirmedWorst:
        return worst.confirmed_worst(responses, PQV, lambda s: worst_of_bank(s, situations), swept, bases=BASES)

    if build == "ours":
        return _found(run())
    with patch.object(worst, "build_surrogate", lambda known, region, bases: build_rival(known, region)):
        return _found(run())


def _found(found: worst.ConfirmedWorst) -> Searched:
    margin = found.tuning.margin_m
    return Searched(found.sweeps, np.inf if margin is None else margin)


def brute_force_on(powers: tuple[int, int], k: int) -> float:
    """Least exact m on grid k of the bank, over so many P and Q and the border of the region's voltages."""
    return brute_force([list(bank_of_27())[k]], *powers)
