"""Phases for a low peak: the crest factor of a sum of cosines, brought down by descent on its L_p norm.

The peak itself has no gradient worth following; the L_p norm has one and becomes the peak as p grows.
So the norm is lowered for p = 4, 8, ..., each time from where the last one ended, by the limited-memory
BFGS method with the gradient from one FFT. How low it can get is the line set's affair: hundreds of
neighbouring lines reach 1.5, a dozen lines spread over three decades 2.7 (docs/excitation.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

DOUBLINGS = (2, 3, 4, 5, 6, 7)
"""log2 of the orders p, in turn."""

STEPS = 40
"""Most steps of one order."""

ENOUGH = 1e-5
"""An order is done when a step lowers the logarithm of its norm by less."""

MEMORY = 12
"""Pairs of steps and gradients that are remembered."""

OVERSAMPLED = 4
"""Samples per half period of the highest line while descending."""

PHASE_GRID = 2.0**20
"""Phases are multiples of 1/PHASE_GRID turns at every step: a last digit that another processor rounds
otherwise is forgotten at once instead of growing into another signal."""


class _Norm(NamedTuple):
    """ln ||b||_p, its gradient over the phases (1/turn), and the peak of |b|."""

    value: float
    gradient: np.ndarray
    peak: float


def samples(phasors: np.ndarray, cycles: np.ndarray, oversampled: int) -> np.ndarray:
    """One period of ``Re sum phasors exp(2j pi cycles t/T)``, a power of two of samples.

    Parameters
    ----------
    phasors, cycles : (n,) complex, (n,) int
        Lines; ``cycles`` ascending and above 0.
    oversampled : int
        At least so many samples per half period of the highest line.
    """
    n = 2 ** int(np.ceil(np.log2(2 * oversampled * cycles[-1])))
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[cycles] = 0.5 * n * phasors
    return np.fft.irfft(spectrum, n)


def low_crest_phases(amplitudes: np.ndarray, cycles: np.ndarray, starts: int, seed: int) -> np.ndarray:
    """Phases (n,) in rad of cosines at ``cycles``, chosen for a low peak.

    Parameters
    ----------
    amplitudes, cycles : (n,) float, (n,) int
        Amplitude above 0 and whole cycles per period, ascending, of every line.
    starts : int
        Descents: the first from Schroeder's phases, further ones from random phases. The lowest wins.
    seed : int
        Of the random phases.
    """
    random = np.random.default_rng(seed)
    found = []
    for start in range(starts):
        turns = schroeder_turns(amplitudes) if start == 0 else random.random(len(cycles))
        found.append(_descend(amplitudes, cycles, _rounded(turns)))
    return 2.0 * np.pi * min(found, key=lambda pair: pair[0])[1]


def schroeder_turns(amplitudes: np.ndarray) -> np.ndarray:
    """Schroeder's phases (n,) in turns: the group delay sweeps once through the period, at the power's pace."""
    power = amplitudes**2 / np.sum(amplitudes**2)
    return -np.concatenate([[0.0], np.cumsum(np.cumsum(power)[:-1])])


def _rounded(turns: np.ndarray) -> np.ndarray:
    return np.round((turns % 1.0) * PHASE_GRID) / PHASE_GRID


def _descend(amplitudes: np.ndarray, cycles: np.ndarray, turns: np.ndarray) -> tuple[float, np.ndarray]:
    """Lowest peak met on the way down, and the phases (turns) that have it."""
    best = (np.inf, turns)
    for doublings in DOUBLINGS:
        pairs: list[tuple[np.ndarray, np.ndarray]] = []
        here = _norm(amplitudes, cycles, turns, doublings)
        for _ in range(STEPS):
            onward = _step(amplitudes, cycles, turns, doublings, here, _direction(here.gradient, pairs))
            if onward is None:
                break
            there_turns, there = onward
            pairs = [*pairs, (there_turns - turns, there.gradient - here.gradient)][-MEMORY:]
            gained, turns, here = here.value - there.value, there_turns, there
            best = min(best, (here.peak, turns), key=lambda pair: pair[0])
            if gained < ENOUGH:
                break
    return best


def _step(
    amplitudes: np.ndarray, cycles: np.ndarray, turns: np.ndarray, doublings: int, here: _Norm, direction: np.ndarray
) -> tuple[np.ndarray, _Norm] | None:
    """A step against ``direction`` that lowers the norm, halved until it does; None where none does."""
    for halvings in range(8):
        there_turns = np.round((turns - 0.5**halvings * direction) * PHASE_GRID) / PHASE_GRID
        there = _norm(amplitudes, cycles, there_turns, doublings)
        if there.value < here.value - 1e-4 * float(np.sum(here.gradient * (turns - there_turns))):
            return there_turns, there
    return None


def _norm(amplitudes: np.ndarray, cycles: np.ndarray, turns: np.ndarray, doublings: int) -> _Norm:
    phasors = amplitudes * np.exp(2j * np.pi * turns)
    b = samples(phasors, cycles, OVERSAMPLED)
    peak = float(np.max(np.abs(b)))
    relative = b / peak
    power = relative * relative
    for _ in range(doublings - 1):  # much faster than relative**p
        power *= power
    total = float(np.sum(power))
    value = np.log(peak) + np.log(total / len(b)) / 2**doublings
    relative[relative == 0.0] = 1.0
    slope = np.fft.rfft(power / relative)[cycles] / (total * peak)
    return _Norm(float(value), 2.0 * np.pi * np.real(1j * phasors * np.conj(slope)), peak)


def _direction(gradient: np.ndarray, pairs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The BFGS direction by two loops over the remembered pairs (Nocedal); a twentieth of a turn at first."""
    pairs = [(s, y) for s, y in pairs if np.sum(s * y) > 1e-14]
    if not pairs:
        return gradient * (0.05 / max(float(np.max(np.abs(gradient))), 1e-300))
    direction, weights = gradient.copy(), []
    for s, y in reversed(pairs):
        weights.append(np.sum(s * direction) / np.sum(s * y))
        direction = direction - weights[-1] * y
    s, y = pairs[-1]
    direction = direction * (np.sum(s * y) / np.sum(y * y))
    for (s, y), weight in zip(pairs, reversed(weights), strict=True):
        direction = direction + s * (weight - np.sum(y * direction) / np.sum(s * y))
    return direction
