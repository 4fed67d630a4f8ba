"""Designs grown as a campaign grows them, held against the exact admittance after every sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.design import Progress, first_points, missed_by, next_point
from seqsweep.identify.surrogate.surrogate import Region, Surrogate, build_surrogate
from tests.support.regions import F_HZ, Device, errors_of, unseen

Build = Callable[[Sequence[FrequencyResponse], Region], Surrogate]
"""A surrogate from the operating points swept so far."""

Sweep = Callable[[np.ndarray], FrequencyResponse]
"""Sweeps an operating point (3,)."""


def build_ours(responses: Sequence[FrequencyResponse], region: Region) -> Surrogate:
    """The product's own surrogate."""
    return build_surrogate(responses, region=region)


class Grown(NamedTuple):
    """A design after a sweep: its rows, its surrogate, and how sure it is."""

    responses: list[FrequencyResponse]
    surrogate: Surrogate
    progress: Progress


def grown(region: Region, seed: int, sweep: Sweep, build: Build = build_ours) -> Iterator[Grown]:
    """A design by doubt, sweep after sweep, without an end."""
    responses = [sweep(point) for point in first_points(region, seed)]
    missed: tuple[float, ...] = ()
    while True:
        surrogate = build(responses, region)
        at, bar = next_point(surrogate, region)
        yield Grown(list(responses), surrogate, Progress(bar, at, missed))
        responses.append(sweep(at))
        missed = (*missed, missed_by(surrogate, responses[-1], at))


class Certified(NamedTuple):
    """When a design was certified: sweeps it took (NaN: not within what it may take) and the largest true error."""

    sweeps: float
    off: float


def certified(design: Iterator[Grown], tolerances: Sequence[float], truth: Truth, most: int) -> list[Certified]:
    """For each tolerance, the loosest first, when the design was certified and how wrong it was then."""
    found: list[Certified] = []
    for stage in design:
        while len(found) < len(tolerances) and stage.progress.is_certified(tolerances[len(found)]):
            found.append(Certified(len(stage.responses), truth.largest(stage.surrogate)))
        if len(found) == len(tolerances) or len(stage.responses) >= most:
            return found + [Certified(np.nan, np.nan)] * (len(tolerances) - len(found))
    return found


class Truth:
    """Unseen operating points of a device's region and its exact admittance there."""

    def __init__(self, device: Device, region: Region, n: int, seed: int):
        self.points = unseen(region, n, seed)
        self.y = np.array([device.exact(point, F_HZ) for point in self.points])

    def largest(self, surrogate: Surrogate) -> float:
        """Largest true error over points and frequencies, relative to ||Y||."""
        return float(errors_of(surrogate, self.points, self.y)[0].max())

    def held(self, surrogate: Surrogate) -> np.ndarray:
        """(p, f) bool: whether the 95 % region held."""
        off, radius = errors_of(surrogate, self.points, self.y)
        return off <= radius


def noisy(device: Device, noise: float, seed: int, *, stated: float | None = None, f_hz: np.ndarray = F_HZ) -> Sweep:
    """Rows by formula with random relative noise, new at every sweep; ``stated`` is what their covariance says."""
    random = np.random.default_rng(seed)
    honest = noise if stated is None else stated

    def sweep(point: np.ndarray) -> FrequencyResponse:
        response = device.swept(point, noise, random, f_hz)
        told = {**response.meta, "stable_on": {"grid": "ideal", "basis": "shots", "growth_bound_per_s": 0.0}}
        size = np.linalg.norm(response.y, axis=(1, 2))[:, None, None]
        return replace(response, covariance=(honest**2 / 8.0 * size**2) * np.eye(8), meta=told)

    return sweep


def swept_by(sweep: Sweep, region: Region, n: int, seed: int) -> list[FrequencyResponse]:
    """The first design, and random points besides: a table that was listed, not grown."""
    first = first_points(region, seed)
    return [sweep(point) for point in np.vstack([first, unseen(region, max(n - len(first), 0), seed)])]
