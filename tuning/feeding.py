"""Where an oscillation can be fed: the device gives more power than it takes, and the loop gain is not small.

Where the device is passive, or the loop gain stays small, no passive grid brings it to oscillate, whatever Y is there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate
from .siso import Impedance

ACTIVE = 0.01
"""Part of Y that feeds a wave from which on a device counts as active."""

LOUD = 0.5
"""Loop gain from which on an active device may bring about an oscillation."""

QUIET = 0.2
"""Loop gain below which an active device makes no loop oscillate, whatever its phase, with some to spare."""

FAR_HZ = 5.0
"""Rows that begin further from f1 leave room for the loops of power, synchronisation and voltage."""

REACH_HZ = 500.0
"""|f - f1| within which control and filter of converters have modes."""


def activity(y: np.ndarray) -> np.ndarray:
    """Part (n,) of Y (n, 2, 2) that feeds a wave: minus the least eigenvalue of the Hermitian part, relative to Y."""
    hermitian = (y + np.swapaxes(y.conj(), 1, 2)) / 2.0
    return np.asarray(-np.linalg.eigvalsh(hermitian)[:, 0] / np.linalg.norm(y, axis=(1, 2)))


def is_fed(y: np.ndarray, z: np.ndarray) -> bool:
    """Whether at any of the frequencies of Y and Z (n, 2, 2) the device is active and the loop gain not small."""
    loud = np.abs(np.linalg.eigvals(y @ z)).max(axis=1) > LOUD
    return bool(np.any(loud & (activity(y) > ACTIVE)))


class Hole(NamedTuple):
    """The gap between the lowest |f - f1| and its mirror image.

    Attributes
    ----------
    start_hz : float
        |f - f1| from which on the locus is followed: zero, or the lowest row's where nothing is fed below it.
    doubt_from_hz : float
        From where on the locus may be in doubt: a hole with no mode in it cannot turn it.
    guessed : bool
        Whether the device has modes of its own in it that make a loop gain to be reckoned with. Rows outside tell of
        them no more than the first terms of a series: what the fit says of Y in there, passive or not, is a guess.
    """

    start_hz: float
    doubt_from_hz: float
    guessed: bool = False


def hole_of(model: RationalModel, grid: Impedance, loop_poles: np.ndarray) -> Hole:
    """What is known of the hole around f1, from the fit: where it feeds nothing, nothing has to be known."""
    lowest = float(model.nu_hz[0])
    inside = np.concatenate([model.poles, loop_poles])
    inside = inside[np.abs(inside) < 2.0 * np.pi * lowest]
    nu = np.concatenate([np.linspace(0.0, lowest, 9), np.minimum(np.abs(inside.imag) / (2.0 * np.pi), lowest)])
    s = 2j * np.pi * nu
    y, z = evaluate(model, s), grid.impedance_dq(s)
    guessed = _is_guessed(model, np.abs(np.linalg.eigvals(y @ z)))
    if not is_fed(y, z):
        return Hole(lowest, lowest, guessed)
    return Hole(0.0, 0.0 if len(inside) else lowest, guessed)


def _is_guessed(model: RationalModel, gain: np.ndarray) -> bool:
    """Whether modes of the device's own nearer to f1 than all rows bring about the loop gain there."""
    lowest = float(model.nu_hz[0])
    own = np.any(np.abs(model.poles) < 2.0 * np.pi * lowest)
    return bool(lowest > FAR_HZ and own and np.max(gain) > QUIET)
