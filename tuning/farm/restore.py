"""The smallest change that restores a farm's damping: gains or curtailed powers, each answer judged anew.

What is demanded of every mode that is told is that Re(pole) + z std <= -damping |pole|, or of the Bode margin at the
source's bus that m - z std is at least the required one, z the normal quantile of the stated probability. It is
linearised in the changes, the smallest change is sought, the farm is made anew with it (swept again, or predicted where
it then stands) and linearised again, until the demand holds there with nothing to spare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Protocol

import numpy as np

from .choices import WAYS, Choose
from .farm import Farm
from .levers import Lever
from .margin import margin_at_source
from .participation import ModeParts, parts_of

DAMPED_BAND = 1.2
"""Up to which multiple of f1 modes need damping, as |f - f1|: the sub- and super-synchronous ones."""

ROUNDS = 8
"""Most linearisations."""

ENOUGH = 0.01
"""What may be left over of the movement that was asked, as a part of it."""

MOVED = 0.1
"""A stable mode that no device moves by more than this part of its real part is a device's own, such as its notch's."""

_STEP_MOST = 0.5  # of the most that one round changes, so that a straight line is not believed too far


class Demand(Protocol):
    """What the farm shall have; ``unit`` is that of what is missing."""

    @property
    def unit(self) -> str: ...

    @property
    def probability(self) -> float: ...

    @property
    def words(self) -> str:
        """The demand in words."""
        ...

    def excess(self, farm: Farm) -> float:
        """By how much a farm misses it; zero or less where it holds."""
        ...

    def lines(self, lever: Lever, farm: Farm, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Straight lines in the changes: d(excess) (m, n) and the excess (m,) where the farm stands."""
        ...


@dataclass(frozen=True, slots=True)
class Damping:
    """A damping of every mode.

    Attributes
    ----------
    damping : float
        Least damping ratio.
    probability : float
        With which probability, for the errors of the tables.
    up_to_hz : float
        Up to which |f - f1| (Hz) that damping is demanded; modes beyond shall be stable, no more: resonances of filters
        and cables have little damping and need none.
    """

    damping: float = 0.0
    probability: float = 0.95
    up_to_hz: float = 60.0
    unit: str = "1/s"

    @property
    def words(self) -> str:
        return f"{100.0 * self.damping:g} % of damping"

    def excess(self, farm: Farm) -> float:
        return max((self.of_mode(mode) for mode in demanded(farm)), default=-np.inf)

    def lines(self, lever: Lever, farm: Farm, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        modes = demanded(farm)
        moved = lever.slopes(farm, x, [mode.pole for mode in modes])
        rows = np.array([self.slope(mode, row) for mode, row in zip(modes, moved, strict=True)])
        return rows, np.array([self.of_mode(mode) for mode in modes])

    def of_mode(self, mode: ModeParts) -> float:
        """By how much (1/s) a mode misses it."""
        quantile = NormalDist().inv_cdf(self.probability)
        return mode.pole.real + quantile * mode.std.real + self.ratio(mode) * abs(mode.pole)

    def ratio(self, mode: ModeParts) -> float:
        """The damping ratio that is demanded of a mode."""
        return self.damping if mode.pole.imag <= 2.0 * np.pi * self.up_to_hz else min(self.damping, 0.0)

    def slope(self, mode: ModeParts, moved: np.ndarray) -> np.ndarray:
        """d(excess) of movements of the pole (n,), its standard error held."""
        along = (np.conj(mode.pole) * moved).real / abs(mode.pole)
        return np.asarray(moved.real + self.ratio(mode) * along)


@dataclass(frozen=True, slots=True)
class SourceMargin:
    """A Bode margin at the source's bus, and stability.

    Attributes
    ----------
    margin : float
        Least magnitude margin m.
    probability : float
        With which probability, for the errors of the tables.
    """

    margin: float
    probability: float = 0.95
    unit: str = "of m"

    @property
    def words(self) -> str:
        return f"m = {self.margin:g}"

    def excess(self, farm: Farm) -> float:
        """In m; m = 0.9 on an unstable farm misses 1.4 by 0.5."""
        found = margin_at_source(farm)
        if found is None:
            return -np.inf if farm.judgement.verdict == "stable" else self.margin
        return self.margin - found.crossing.m + NormalDist().inv_cdf(self.probability) * found.std

    def lines(self, lever: Lever, farm: Farm, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By differences: every device is changed a little, from real data like everything else."""
        here, steps = self.excess(farm), 0.02 * lever.most
        ends = [self.excess(lever.changed(x + step * unit)) for step, unit in zip(steps, np.eye(len(x)), strict=True)]
        return (np.array([ends]) - here) / np.maximum(steps, 1e-12), np.array([here])


@dataclass(frozen=True, slots=True)
class Choice:
    """One way to meet the demand.

    Attributes
    ----------
    way : str
        "least norm", "fewest" or "uniform".
    changes : (n,) float
        Of every device of the lever.
    farm : Farm
        With these changes, from real data.
    excess : float
        By how much the demand is missed there, in its unit; zero or less where it holds.
    rounds : int
        How often the farm was made anew.
    """

    way: str
    changes: np.ndarray
    farm: Farm
    excess: float
    rounds: int

    @property
    def holds(self) -> bool:
        """Whether the demand holds on the changed farm."""
        return self.excess <= 0.0


@dataclass(frozen=True, slots=True)
class Advice:
    """What a lever does to the farm, and the choices that meet the demand.

    Attributes
    ----------
    what, unit : str
        Of the lever.
    names : tuple of str
        Its devices.
    base : Farm
        Without changes.
    slopes : (m, n) complex
        d(pole)/dx_i of every mode that is told.
    demand : Demand or None
        What was asked; None: the slopes alone.
    choices : tuple of Choice
        In the order of `WAYS`.
    """

    what: str
    unit: str
    names: tuple[str, ...]
    base: Farm
    slopes: np.ndarray
    demand: Demand | None
    choices: tuple[Choice, ...]


def advise(lever: Lever, demand: Demand | None, say: Callable[[str], None] = lambda text: None) -> Advice:
    """Slopes of a lever, and with a demand the smallest changes that meet it."""
    nothing = np.zeros(len(lever.names))
    base = lever.changed(nothing)
    slopes = lever.slopes(base, nothing, [mode.pole for mode in base.judgement.modes])
    choices = () if demand is None else tuple(_choose(lever, demand, way, base, say) for way in WAYS)
    return Advice(lever.what, lever.unit, lever.names, base, slopes, demand, choices)


def demanded(farm: Farm) -> tuple[ModeParts, ...]:
    """The modes that devices and network make together, told or not; a device's own is the same on every network."""
    parts = (parts_of(farm.system, complex(pole)) for pole in farm.judgement.in_band)
    return tuple(
        mode for mode in parts if mode.pole.real > 0.0 or np.abs(mode.devices).sum() > MOVED * abs(mode.pole.real)
    )


def _choose(lever: Lever, demand: Demand, way: str, base: Farm, say: Callable[[str], None]) -> Choice:
    x, farm = np.zeros(len(lever.names)), base
    asked = demand.excess(base)
    best = Choice(way, x, farm, asked, 0)
    if asked <= 0.0:
        return best
    for turn in range(1, ROUNDS + 1):
        x = _next(lever, demand, WAYS[way], farm, x, asked)
        farm = lever.changed(x)
        excess = demand.excess(farm)
        largest = f"largest {lever.what} {x.max():.3g} {lever.unit}"
        say(f"{way}, round {turn}: {largest}, demand missed by {excess:+.3g} {demand.unit}")
        if excess < best.excess or (excess <= 0.0 and x.sum() < best.changes.sum()):
            best = Choice(way, x, farm, excess, turn)
        if -ENOUGH * asked <= excess <= 0.0 or np.all(x >= lever.most - 1e-9):
            break
    return best


def _next(lever: Lever, demand: Demand, choose: Choose, farm: Farm, x: np.ndarray, asked: float) -> np.ndarray:
    """The smallest changes by the straight lines through where the farm stands."""
    rows, excess = demand.lines(lever, farm, x)
    new = choose(rows, rows @ x - excess - 0.5 * ENOUGH * asked, lever.most)
    furthest = float(np.max(np.abs(new - x) / np.maximum(lever.most, 1e-12), initial=0.0))
    return np.asarray(x + (new - x) * min(1.0, _STEP_MOST / max(furthest, 1e-12)))
