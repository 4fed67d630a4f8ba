"""Binary sequences with flat spectra: maximum length, quadratic residue, and their inverse repeats."""

from __future__ import annotations

from math import isqrt

import numpy as np

from ...plant.errors import SeqsweepError

_TAPS = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 11, 10, 4),
    13: (13, 12, 11, 8),
    14: (14, 13, 12, 2),
    15: (15, 14),
    16: (16, 15, 13, 4),
}
"""Stages fed back, by order: one primitive polynomial over GF(2) each."""


def maximum_length(order: int) -> np.ndarray:
    """One period (2**order - 1,) of a maximum-length sequence of +-1.

    Its spectrum is flat: |sum_n s_n exp(-2j pi k n/N)|^2 = N + 1 for k != 0, and 1 at k = 0.

    Raises
    ------
    SeqsweepError
        If there is no polynomial for the order.
    """
    if order not in _TAPS:
        raise SeqsweepError(f"a maximum-length sequence of order {order!r}; orders are {min(_TAPS)} to {max(_TAPS)}")
    register, sequence = 1, np.empty(2**order - 1)
    for n in range(len(sequence)):
        sequence[n] = 1.0 - 2.0 * (register & 1)
        fed_back = 0
        for stage in _TAPS[order]:
            fed_back ^= register >> (order - stage)
        register = (register >> 1) | ((fed_back & 1) << (order - 1))
    return sequence


def quadratic_residue(length: int) -> np.ndarray:
    """One period (length,) of the Legendre sequence: +1 at 0 and at the squares modulo ``length``, else -1.

    For a prime ``length`` = 3 (mod 4) the spectrum is flat: |sum_n s_n exp(-2j pi k n/N)|^2 = N + 1 for
    k != 0, and 1 at k = 0 (Gauss).

    Raises
    ------
    SeqsweepError
        If ``length`` is no prime = 3 (mod 4); names the nearest that are.
    """
    if not is_residue_length(length):
        below = next((p for p in range(length - 1, 2, -1) if is_residue_length(p)), None)
        near = [str(p) for p in (below, next_residue_length(length)) if p is not None]
        what = "not prime" if not _is_prime(length) else "1 (mod 4): its spectrum would not be flat"
        raise SeqsweepError(
            f"a quadratic-residue sequence of length {length} is asked; it is {what}. Primes = 3 (mod 4) are needed, "
            f"such as {' or '.join(near)}"
        )
    sequence = -np.ones(length)
    sequence[np.arange(length, dtype=np.int64) ** 2 % length] = 1.0
    return sequence


def is_residue_length(length: int) -> bool:
    """Whether a quadratic-residue sequence of this length has a flat spectrum."""
    return length % 4 == 3 and _is_prime(length)


def next_residue_length(length: int) -> int:
    """The smallest prime = 3 (mod 4) of at least ``length``."""
    return next(p for p in range(max(length, 3), 2 * max(length, 3) + 8) if is_residue_length(p))


def inverse_repeat(sequence: np.ndarray) -> np.ndarray:
    """Two periods of a sequence of odd length, every second sign turned: odd lines only.

    The second half is the first one with its sign turned, so even-order distortion of what the
    sequence drives falls on even lines, where nothing was played.
    """
    twice = np.tile(sequence, 2)
    return twice * (-1.0) ** np.arange(len(twice))


def _is_prime(number: int) -> bool:
    return number > 1 and all(number % divisor for divisor in range(2, isqrt(number) + 1))
