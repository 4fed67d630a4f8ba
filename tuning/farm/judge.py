"""Whether a farm is stable: the turns of det(1 + Y Z) over all terminals, and the poles of one pencil, must agree.

    unstable modes = unstable own modes of all devices - counter-clockwise turns of det(1 + Y Z)

The determinant is over every bus with a device, not over the connection point alone: modes between devices, which the
connection point does not see, are counted. Devices that were never proved stable leave the count open.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, sqrt
from typing import NamedTuple

import numpy as np

from ..objections import Decision
from ..poles import BEYOND, EDGE, RESONANCE_DAMPING, RESONANCE_FROM_HZ
from ..probability import DECIDED
from ..uncovered import stated
from .doubt import doubt_of
from .locus import follow, unstable_by
from .participation import ModeParts, parts_of
from .system import System
from .unshown import of_stable, of_unstable

BESIDE = 0.1
"""A stable mode nearer to a device's own pole than this part of its width is told last."""

MODES = 8
"""In-band modes that are told, least damped first."""


@dataclass(frozen=True, slots=True)
class FarmVerdict:
    """The judgement of one farm.

    Attributes
    ----------
    verdict : "stable", "unstable" or "undecided"
        What both counts say.
    reason : str
        Why, in one sentence.
    probability : float or None
        Probability of being stable; None where it is not known; never certain where the rows of a device do not cover
        the question.
    n_unstable_locus : int or None
        Unstable modes by the locus; None if it could not be followed, or a device's own modes are not known.
    n_unstable_poles : int
        Unstable modes by the pencil, inside the band.
    modes : tuple of ModeParts
        In-band oscillating modes, least damped first, unstable ones before all; at most `MODES`, the one with the
        largest real part always among them.
    in_band : (m,) complex
        All of them (rad/s, dq), told or not.
    turns_hz : (n,) float
        |f - f1| from zero on where the determinant was looked at (Hz).
    turns : (n,) float
        Counter-clockwise turns of its half axis up to there.
    uncovered : str
        Why the verdict is not certain, however small the errors; empty where it may be.
    """

    verdict: Decision
    reason: str
    probability: float | None
    n_unstable_locus: int | None
    n_unstable_poles: int
    modes: tuple[ModeParts, ...]
    in_band: np.ndarray
    turns_hz: np.ndarray
    turns: np.ndarray
    uncovered: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the reader should know of the verdict besides its reason."""
        why = self.uncovered
        return (f"{self.verdict}, but not certain, however small the errors: {why}",) if why else ()

    @property
    def critical(self) -> ModeParts | None:
        """The mode with the largest real part; None if there is none."""
        return max(self.modes, key=lambda mode: mode.pole.real, default=None)


def judge_farm(system: System) -> FarmVerdict:
    """Verdict, counts and modes of a farm."""
    poles = system.poles()
    believed = poles[np.abs(poles) <= BEYOND * 2.0 * np.pi * system.end_hz]
    by_poles = int(np.sum(believed.real > 0.0))
    locus = follow(system, poles)
    by_locus = unstable_by(system, locus)
    in_band = _in_band(system, believed)
    modes = tuple(parts_of(system, pole) for pole in _told(system, in_band))
    said = _decided(system, believed, by_locus, modes)
    return FarmVerdict(
        said.verdict,
        said.reason,
        said.probability,
        by_locus,
        by_poles,
        modes,
        in_band,
        locus.nu_hz,
        locus.turns,
        said.uncovered,
    )


def _in_band(system: System, poles: np.ndarray) -> np.ndarray:
    """In-band modes (m,) with a peak, and every unstable one, least damped first."""
    upper = poles[(poles.imag > 0.0) & (poles.imag < 2.0 * np.pi * EDGE * system.end_hz)]
    damping = -upper.real / np.abs(upper)
    oscillates = (upper.imag > 2.0 * np.pi * RESONANCE_FROM_HZ) & (damping < RESONANCE_DAMPING)
    chosen = upper[oscillates | (upper.real > 0.0)]
    return np.asarray(chosen[np.lexsort((-chosen.real / np.abs(chosen), chosen.real <= 0.0))])


def _told(system: System, chosen: np.ndarray) -> list[complex]:
    """The modes that are told.

    Where they are too many, stable ones beside a device's own pole give way: those are hardly moved by the network, and
    as many as there are devices, such as those of the damping control's notches. The mode with the largest real part is
    told always: resonances of many cables have a smaller damping ratio, but die out sooner.
    """
    own = np.concatenate([unit.model.poles for unit in system.units])
    apart = np.min(np.abs(chosen[:, None] - own) / np.maximum(np.abs(own.real), 1e-300), axis=1, initial=np.inf)
    beside = (apart < BESIDE) & (chosen.real <= 0.0)
    slowest = np.arange(len(chosen)) == np.argmax(chosen.real) if len(chosen) else beside
    kept = np.sort(np.lexsort((beside, ~slowest))[:MODES])
    return [complex(pole) for pole in chosen[kept]]


class _Said(NamedTuple):
    verdict: Decision
    reason: str
    probability: float | None = None
    uncovered: str = ""


def _decided(system: System, poles: np.ndarray, by_locus: int | None, modes: tuple[ModeParts, ...]) -> _Said:
    """The verdict; ``poles`` are the believed ones of the farm."""
    by_poles = int(np.sum(poles.real > 0.0))
    objection = _objection(system, by_locus, by_poles, modes)
    if objection:
        return _Said("undecided", objection)
    probability = _probability(modes)
    if 1.0 - DECIDED < probability < DECIDED:
        return _Said("undecided", f"the data leave it open: {_where(system, modes)}", probability)
    unshown = of_unstable(system, modes) if by_poles else of_stable(system, poles, modes)
    probability = stated(min(probability, unshown.sure), unshown.uncovered or unshown.withheld)
    if unshown.withheld:
        return _Said("undecided", unshown.withheld, probability)
    if by_poles:
        text = f"{by_poles} unstable modes, by locus and by poles"
        return _Said("unstable", text, probability, unshown.uncovered)
    return _Said("stable", "no unstable mode, by locus and by poles", probability, unshown.uncovered)


def _objection(system: System, by_locus: int | None, by_poles: int, modes: tuple[ModeParts, ...]) -> str:
    """Why nothing is counted at all; empty where locus and poles agree."""
    problems = sorted(
        {f"{unit.key}: {unit.basis.problem}" for unit in system.units if unit.basis and unit.basis.problem}
    )
    if problems:
        return problems[0]
    open_units = sorted({unit.key for unit in system.units if unit.n_unstable is None})
    if open_units:
        text = f"nothing proves whether the device of {open_units[0]} is stable by itself: sweep it again, or import it"
        return f"{text} with --stable-on"
    if by_locus is None:
        return "the locus turns faster than it can be followed: measure the lightly damped modes closer"
    if by_locus < 0 or by_locus != by_poles:
        return f"the locus says {by_locus} unstable modes, the poles say {by_poles}: {_where(system, modes)}"
    return ""


def _where(system: System, modes: tuple[ModeParts, ...]) -> str:
    """Which measurement would settle it."""
    if not modes:
        return "measure more rows where the devices are active"
    mode = max(modes, key=lambda m: m.pole.real)
    nu = mode.pole.imag / (2.0 * np.pi)
    mode_text = f"of the mode at {system.f1_hz - nu:.4g}/{system.f1_hz + nu:.4g} Hz"
    return f"{mode_text} {doubt_of(system, mode.pole).said(system.f1_hz)}"


def _probability(modes: tuple[ModeParts, ...]) -> float:
    """Of being stable: that the mode nearest to the edge, in standard errors, lies on the left."""
    chances = [0.5 * erfc(mode.pole.real / (sqrt(2.0) * max(mode.std.real, 1e-12))) for mode in modes]
    return float(min(chances, default=1.0))
