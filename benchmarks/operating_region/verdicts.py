"""Verdicts and modes from surrogates, at operating points and on grids that nobody swept, beside exact eigenvalues."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seqsweep.identify.surrogate.surrogate import Surrogate
from seqsweep.tuning.result import PointTuning
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune_point
from tests.support import oracle
from tests.support.regions import PQV, TURBINE, U_V, unseen

from .designs import noisy, swept_by
from .rival import BUILDS

PAIRS = 20
"""Grids and operating points that one surrogate is asked for."""

SWEEPS = 20
"""Operating points of the surrogate that modes are asked of; of those that verdicts are asked of, at most."""

NEAR_RAD_S = 5e-3
"""How near the critical mode is to be."""

F_HZ = 50.0 + np.logspace(0.0, np.log10(950.0), 60)

CERTAIN = 0.999
"""Stated probability above which a verdict counts as certain."""

_W1 = 100.0 * np.pi


class Pair(NamedTuple):
    """An operating point (MW, Mvar, pu), a grid near the edge of stability there, and their exact poles (rad/s)."""

    point: np.ndarray
    grid: SeriesRL
    poles: np.ndarray


class Judged(NamedTuple):
    """What a verdict was worth."""

    wrong: bool
    certain: bool
    undecided: bool


def judged(noise: float, build: str, seed: int) -> list[Judged]:
    """`PAIRS` verdicts from one surrogate of 10 to 20 sweeps."""
    random = np.random.default_rng(seed)
    surrogate = _surrogate(noise, build, int(random.integers(10, SWEEPS + 1)), seed)
    return [_verdict(_tuned(surrogate, pair), pair) for pair in pairs(random)]


def modes(noise: float, build: str, seed: int) -> np.ndarray:
    """(PAIRS,) distances of the critical mode from the nearest exact pole (rad/s), from one surrogate."""
    surrogate = _surrogate(noise, build, SWEEPS, seed)
    return np.array([_distance(_tuned(surrogate, pair), pair) for pair in pairs(np.random.default_rng(seed))])


def _surrogate(noise: float, build: str, sweeps: int, seed: int) -> Surrogate:
    return BUILDS[build](swept_by(noisy(TURBINE, noise, seed, f_hz=F_HZ), PQV, sweeps, seed), PQV)


def _tuned(surrogate: Surrogate, pair: Pair) -> PointTuning:
    return tune_point(surrogate.response(pair.point), pair.grid)


def pairs(random: np.random.Generator, n: int = PAIRS) -> list[Pair]:
    """So many pairs by lot; twenty operating points are drawn for each, because not every one has an edge."""
    seeds = random.integers(1 << 30, size=20 * n)
    found: list[Pair] = []
    for seed in seeds:
        pair = _pair(int(seed))
        found += [] if pair is None else [pair]
        if len(found) == n:
            break
    return found


def _pair(seed: int) -> Pair | None:
    """A grid 0.3 to 30 % from the edge of stability of a random operating point; None where there is no edge."""
    random = np.random.default_rng(seed)
    (point,) = unseen(PQV, 1, seed)
    ratio, aside = random.uniform(0.03, 0.3), random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(-2.5, -0.5)
    low, high = 0.02, 1.5
    if _growth(point, ratio, low) > 0.0 or _growth(point, ratio, high) < 0.0:
        return None
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _growth(point, ratio, middle) < 0.0 else (low, middle)
    x_ohm = (1.0 + aside) * low
    return Pair(point, SeriesRL(ratio * x_ohm, x_ohm, 50.0), _poles(point, ratio, x_ohm))


def _growth(point: np.ndarray, ratio: float, x_ohm: float) -> float:
    return float(_poles(point, ratio, x_ohm).real.max())


def _poles(point: np.ndarray, ratio: float, x_ohm: float) -> np.ndarray:
    p, q, v = point
    line = (ratio * x_ohm, x_ohm / _W1)
    return np.asarray(oracle.closed_loop_poles(p * 1e6, *line, terminal_voltage_v=v * U_V, q_var=q * 1e6))


def _verdict(tuning: PointTuning, pair: Pair) -> Judged:
    is_stable = bool(pair.poles.real.max() < 0.0)
    undecided = tuning.verdict == "undecided"
    wrong = not undecided and (tuning.verdict == "stable") != is_stable
    sure = 0.5 if tuning.probability is None else max(tuning.probability, 1.0 - tuning.probability)
    return Judged(wrong, sure > CERTAIN, undecided)


def _distance(tuning: PointTuning, pair: Pair) -> float:
    """Of the mode that is named critical from the nearest exact one; infinite where none is named."""
    loop: Any = None if tuning.stability is None else tuning.stability.closed_loop
    if loop is None or loop.critical is None:
        return float("inf")
    return float(np.abs(pair.poles - loop.poles[loop.critical]).min())
