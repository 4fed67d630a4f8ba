"""Which lines of a broadband signal are played, and which are listened to for distortion.

Lines are odd multiples of 1/T. Even-order distortion of what they drive then falls on even lines, and
some of the odd lines are left out to hear odd-order distortion.
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError

DETECTION_GROUP = 8
"""One of so many neighbouring odd lines is never played."""


class SignalError(SeqsweepError):
    """A broadband signal that cannot do what is asked, with the way out."""


class OddLines(NamedTuple):
    """Odd lines for wanted points.

    Attributes
    ----------
    cycles : (n,) int
        Signed cycles per period of every point, ascending: the point is at f1 + cycles/T.
    played : (m,) int
        The lines a signal needs for them, |cycles| without doubles, ascending: one line serves both sides of f1.
    merged : int
        Wanted points that fell on the line of a neighbour and were placed elsewhere instead.
    """

    cycles: np.ndarray
    played: np.ndarray
    merged: int


def odd_lines(wanted_nu_hz: np.ndarray, period_s: float, detection_group: int = DETECTION_GROUP) -> OddLines:
    """As many distinct odd lines as points are wanted, where they are wanted as far as the period resolves.

    Each point goes to the nearest odd line between the ends of the list. Where the list is denser than
    the lines, points would merge: the list is then drawn denser as a whole, in its own spacing, until
    it meets enough lines.

    Parameters
    ----------
    wanted_nu_hz : (n,) float
        f - f1 (Hz), ascending; below 0 on the side below f1.
    period_s : float
        Period T (s): lines are 2/T apart.
    detection_group : int
        One of so many neighbouring odd lines is left unplayed, on both sides of f1 alike; 0 leaves none.

    Raises
    ------
    SignalError
        If there are fewer lines than points, with the period that has enough; or if f1 itself is wanted.
    """
    wanted = np.asarray(wanted_nu_hz, dtype=float)
    if np.any(wanted == 0.0):
        raise SignalError("f1 itself is wanted: the perturbation cannot be told from the operating point there")
    if not len(wanted) or np.any(np.diff(wanted) < 0.0):
        raise SignalError("the wanted points must be at least one, and ascend")
    usable = _usable(wanted[0] * period_s, wanted[-1] * period_s, detection_group)
    if len(usable) < len(wanted):
        raise SignalError(_too_few(wanted, usable, period_s))
    nearest = _met(wanted * period_s, usable)
    chosen = _densified(wanted * period_s, usable)
    return OddLines(chosen, np.unique(np.abs(chosen)), len(wanted) - len(nearest))


def detection_lines(played: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Even lines, and odd lines that are not played, between the lowest and the highest line of a signal."""
    between = np.arange(played[0], played[-1] + 1)
    silent = np.setdiff1d(between, played)
    return silent[silent % 2 == 0], silent[silent % 2 == 1]


def _usable(low: float, high: float, detection_group: int) -> np.ndarray:
    """Signed odd cycles from ``low`` to ``high`` that are not kept for detection."""
    first, last = ceil(low - 1e-9), ceil(high + 1e-9)
    odd = np.arange(first, last + 1)
    odd = odd[(odd % 2 != 0) & (odd <= high + 1e-9)]
    return odd[~_kept_silent(np.abs(odd) // 2, detection_group)] if detection_group else odd


def _kept_silent(number: np.ndarray, group: int) -> np.ndarray:
    """One of every ``group`` odd lines, numbered from 0 on; its place changes, so that they make no comb."""
    places = np.random.default_rng(group).integers(group, size=int(np.max(number, initial=0)) // group + 1)
    return number % group == places[number // group]


def _met(wanted: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Indices of the usable lines that are nearest to wanted ones, ascending, without doubles."""
    above = np.clip(np.searchsorted(usable, wanted), 1, max(len(usable) - 1, 1))
    above = np.minimum(above, len(usable) - 1)
    below = np.maximum(above - 1, 0)
    return np.unique(np.where(wanted - usable[below] <= usable[above] - wanted, below, above))


def _densified(wanted: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """``len(wanted)`` usable lines in the spacing of ``wanted``."""
    n, drawn = len(wanted), float(len(wanted))
    met = _met(wanted, usable)
    while len(met) < n:
        drawn *= 1.02
        met = _met(np.interp(np.linspace(0.0, n - 1.0, ceil(drawn)), np.arange(n), wanted), usable)
    rank = np.interp(usable[met], wanted, np.arange(n))
    while len(met) > n:  # the last draw met too many: leave out those that are missed least
        spare = 1 + int(np.argmin(rank[2:] - rank[:-2]))
        met, rank = np.delete(met, spare), np.delete(rank, spare)
    return usable[met]


def _too_few(wanted: np.ndarray, usable: np.ndarray, period_s: float) -> str:
    longer = period_s * (len(wanted) + 2) / max(len(usable), 1)
    return (
        f"{len(wanted)} points between nu = {wanted[0]:g} and {wanted[-1]:g} Hz are wanted; a period of {period_s:g} s "
        f"has {len(usable)} odd lines to play there, {2 / period_s:g} Hz apart: take fewer points or a wider band, or "
        f"a period of about {longer:.2g} s"
    )
