"""One device to be judged: drawn from its family until it is fit to be swept, with the edges of its stable grids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .following import Following, draw_following
from .forming import Forming, draw_forming
from .linear import Bases, Linear
from .rational_devices import draw_rational
from .sampled_devices import draw_sampled
from .turbines import BASES as TURBINE_BASES
from .turbines import draw_turbine

FAMILIES = ("turbine", "following", "forming", "rational", "sampled")

SCR = (100.0, 0.8)
"""Strongest and weakest grid of the benchmark, as short-circuit ratio."""

AT_REST = -0.5
"""Slowest mode (rad/s) of a device that can be swept in reasonable time."""


class Device(Protocol):
    """What `Linear` and `Sampled` have in common."""

    def admittance(self, nu_hz: np.ndarray) -> np.ndarray:
        """Ydq (n, 2, 2) in S."""
        ...

    @property
    def own_poles(self) -> np.ndarray:
        """Poles on an ideal source (rad/s)."""
        ...

    def closed_loop(self, r_ohm: float, x_ohm: float) -> np.ndarray:
        """Poles on a grid (rad/s)."""
        ...


@dataclass(frozen=True)
class Unit:
    """A device, what it is called, where it is swept: ``swept_on`` is R, X (ohm) of that grid, None an ideal source.

    ``point`` are the turbine's power (MW) and voltage (pu), NaN for others; ``parameters`` those of an inverter, which
    the product may have as a nonlinear plant as well.
    """

    family: str
    text: str
    bases: Bases
    device: Device
    swept_on: tuple[float, float] | None
    point: tuple[float, float] = (float("nan"), float("nan"))
    parameters: Following | Forming | None = None

    @property
    def own_unstable(self) -> int:
        """Poles of its own in the right half-plane."""
        return int(np.sum(self.device.own_poles.real > 0.0))


def draw_unit(family: str, rng: np.random.Generator) -> Unit:
    """A device of the family that rests where it is swept."""
    while True:
        unit = _drawn(family, rng)
        if unit is not None:
            return unit


def _drawn(family: str, rng: np.random.Generator) -> Unit | None:
    if family == "turbine":
        device, text, point = draw_turbine(rng)
        return Unit(family, text, TURBINE_BASES, device, None, point)
    bases = Bases(*_ratings(rng), float(rng.choice([50.0, 60.0])))
    if family == "sampled":
        sampled, text = draw_sampled(rng, bases)
        return Unit(family, text, bases, sampled, None) if _rests(sampled, None) else None
    if family == "rational":
        found, text = draw_rational(rng, bases)
        return Unit(family, text, bases, found, None) if _rests(found, None) else None
    inverter, text, parameters = (draw_following if family == "following" else draw_forming)(rng, bases)
    ideal = _rests(inverter, None) and rng.random() < 0.85
    grid = None if ideal else _friendly_grid(inverter, bases)
    if grid is None and not ideal:
        return None
    return Unit(family, text, bases, inverter, grid, parameters=parameters)


def _ratings(rng: np.random.Generator) -> tuple[float, float]:
    return [(690.0, 2.75e6), (400.0, 30e3), (690.0, 1.632e6), (33e3, 100e6)][int(rng.integers(4))]


def _rests(device: Device, grid: tuple[float, float] | None) -> bool:
    poles = device.own_poles if grid is None else device.closed_loop(*grid)
    return bool(poles.real.max() < AT_REST)


def _friendly_grid(device: Linear, bases: Bases) -> tuple[float, float] | None:
    """The strongest of some grids on which the device rests, R/X = 0.1."""
    for scr in (20.0, 10.0, 5.0, 3.0, 2.0):
        x = bases.z_ohm / scr
        if _rests(device, (0.1 * x, x)):
            return 0.1 * x, x
    return None


def stable_on(unit: Unit, size_ohm: float, r_over_x: float) -> bool:
    """Truth: whether device and grid are stable."""
    return bool(rightmost(unit, size_ohm, r_over_x) < 0.0)


def rightmost(unit: Unit, size_ohm: float, r_over_x: float) -> float:
    """Largest real part of the closed loop's poles (rad/s)."""
    return float(unit.device.closed_loop(*grid_of(size_ohm, r_over_x)).real.max())


def grid_of(size_ohm: float, r_over_x: float) -> tuple[float, float]:
    """R and X (ohm) of a grid of the given size and ratio."""
    x = size_ohm / float(np.hypot(1.0, r_over_x))
    return r_over_x * x, x


def edges(unit: Unit, r_over_x: float) -> list[float]:
    """Every size |Z| (ohm) between the ends of `SCR` at which stability changes, ascending."""
    from scipy.optimize import brentq

    sizes = unit.bases.z_ohm / np.geomspace(*SCR, 36)
    worst = np.array([rightmost(unit, size, r_over_x) for size in sizes])
    at = np.flatnonzero(np.signbit(worst[1:]) != np.signbit(worst[:-1]))
    return [float(brentq(lambda z: rightmost(unit, z, r_over_x), sizes[k], sizes[k + 1], rtol=1e-10)) for k in at]
