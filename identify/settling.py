"""When a shot is over, and what its point is worth."""

from __future__ import annotations

from math import inf, log
from typing import NamedTuple

import numpy as np

from ..plant.protocol import Phasors

COND_LIMIT = 1e6
"""Above this condition number of the voltages two experiments are one (a wrong mirror shows 1e13)."""

SETTLED_LIMIT = 1e-6
"""Largest change of the unperturbed waveforms over one period, relative to their peak."""


STEADY_LIMIT = 4.0
"""Standard errors by which the two halves of a noisy shot may differ; beyond, it is not at rest yet."""

BEST = 1.5
"""Windows are kept while that costs no more than this factor in the standard error of their mean."""

NOISY_WINDOWS = 6
"""Fewest windows from which the scatter of a noisy shot is taken."""

EXCITED = 1e-6
"""Share of the response from which on a mode counts as excited: less of it is below what a row's own error hides."""

ROUNDING = 1e-12
"""Agreement of two windows is not believed to be better than this."""


class Settled(NamedTuple):
    """The windows at which a shot came to rest.

    Attributes
    ----------
    v, i : (n, 2) complex
        Phasors of the windows that count, at f and 2 f1 - f (V, A): the last one of a quiet device, all
        since it is at rest of a noisy one.
    residual : float
        Quiet: disagreement of the last window with the one before, relative. Noisy: standard error of
        the mean of the windows, relative.
    window : int
        Number of the last window, from 0.
    at_rest : bool
        Whether the shot stopped changing, within the tolerance or within the noise.
    agreed : bool
        Whether it is at rest and ``residual`` is within what was asked.
    growth : float
        Factor by which the response grew over the last window; noisy: over the second half.
    """

    v: np.ndarray
    i: np.ndarray
    residual: float
    window: int
    at_rest: bool
    agreed: bool
    growth: float


def windows(phasors: Phasors, n_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Phasors (n_windows, 2) of v and i of all complete windows of ``n_blocks`` blocks."""
    whole = len(phasors.v) // n_blocks * n_blocks
    v, i = (x[:whole].reshape(-1, n_blocks, 2).sum(axis=1) for x in (phasors.v, phasors.i))
    return v, i


def first_agreement(v: np.ndarray, i: np.ndarray, tolerance: float) -> Settled:
    """The first window that agrees with the one before; the last window where none does.

    Parameters
    ----------
    v, i : (n_windows, 2) complex
        Phasors of the perturbation alone (V, A), at least one window.
    tolerance : float
        Relative disagreement accepted, of v and of i.
    """
    residual, k = np.inf, 0
    for k in range(1, len(v)):
        residual = float(np.max([_change(v[k - 1], v[k]), _change(i[k - 1], i[k])]))  # NaN if either is
        if residual <= tolerance or not np.isfinite(residual):
            break
    agreed = residual <= tolerance
    return Settled(v[k : k + 1], i[k : k + 1], residual, k, agreed, agreed, _growth(i[k - 1], i[k]))


class Agreements:
    """`first_agreement` of many shots at once, block by block, while their windows come in.

    Parameters
    ----------
    n_blocks, limit_blocks : (n,) int
        Blocks of a window of each shot, and those after which its time is over.
    tolerance : (n,) float
        Relative disagreement accepted, of v and of i.

    Attributes
    ----------
    agreed, over : (n,) bool
        Whether two windows agree; whether nothing more is to be heard: they do, are not finite, or time is over.
    """

    def __init__(self, n_blocks: np.ndarray, limit_blocks: np.ndarray, tolerance: np.ndarray):
        n = len(n_blocks)
        self._n_blocks, self._limit_blocks, self._tolerance = n_blocks, limit_blocks, tolerance
        self.agreed, self.over = np.zeros(n, bool), np.zeros(n, bool)
        self._sums, self._windows = np.zeros((2, 2, n), complex), np.zeros((n, 2, 2), complex)
        self._n_windows = np.zeros(n, int)
        self._residual, self._growth = np.full(n, np.inf), np.ones(n)

    def hear(self, who: np.ndarray, phasors: np.ndarray, done: int) -> None:
        """The next blocks of some shots, by their numbers (m,), all of which heard ``done`` blocks before.

        ``phasors`` (m, 2, k, 2) complex are the blocks' sums of v and i.
        """
        n_blocks, limit = self._n_blocks[who], self._limit_blocks[who]
        sums = np.take(self._sums, who, axis=2)
        ends = (done + np.arange(phasors.shape[2] + 1)[:, None]) % n_blocks == 0  # of the block before each
        some = ends.any(axis=1).tolist()
        for block, fresh in enumerate(phasors.transpose(2, 1, 3, 0)):
            sums += fresh
            if some[block]:
                begin = np.flatnonzero(ends[block])
                sums[..., begin] = fresh[..., begin]
            if not some[block + 1]:
                continue
            full = np.flatnonzero(ends[block + 1])
            complete = full[(done + block < limit[full]) & ~self.over[who[full]]]
            if len(complete):
                self._compare(who[complete], np.ascontiguousarray(sums[..., complete].transpose(2, 0, 1)))
        self._sums[..., who] = sums
        self.over[who] |= done + phasors.shape[2] >= limit

    def _compare(self, who: np.ndarray, after: np.ndarray) -> None:
        """The window that some shots have just heard to its end, ``after`` (m, 2, 2), against the one before."""
        before = self._windows[who]
        with np.errstate(divide="ignore", invalid="ignore"):
            size, old_size, change = norms(after), norms(before), norms(after - before)
            relative = np.where(change == 0.0, 0.0, np.where(size != 0.0, change / size, np.inf))
            growth = np.where(old_size[:, 1] != 0.0, size[:, 1] / old_size[:, 1], 1.0)
        residual, second = relative.max(axis=1), self._n_windows[who] > 0
        self._windows[who] = after
        self._n_windows[who] += 1
        self._residual[who] = np.where(second, residual, np.inf)
        self._growth[who] = np.where(second, growth, 1.0)
        self.agreed[who] = second & (residual <= self._tolerance[who])
        self.over[who] = second & ((residual <= self._tolerance[who]) | ~np.isfinite(residual))

    def settled(self, shot: int) -> Settled:
        """What is to be said of a shot that is over."""
        v, i = self._windows[shot, :, None]
        agreed, last = bool(self.agreed[shot]), int(self._n_windows[shot]) - 1
        return Settled(v, i, float(self._residual[shot]), last, agreed, agreed, float(self._growth[shot]))


def norms(x: np.ndarray) -> np.ndarray:
    """Euclidean norms (...) of complex vectors (..., n): to the last bit `numpy.linalg.norm` of each of them."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.vecdot(x.real, x.real) + np.vecdot(x.imag, x.imag)))


def steady_mean(v: np.ndarray, i: np.ndarray, uncertainty: float) -> Settled:
    """The windows of a noisy shot since it is at rest, and how well their mean is known.

    The first window is never believed. Of the others as few are left out as it takes for the rest to be
    known nearly as well as any such rest; it is steady if its two halves have one mean.

    Parameters
    ----------
    v, i : (n_windows, 2) complex
        Phasors of the perturbation alone (V, A), more than `NOISY_WINDOWS`.
    uncertainty : float
        Relative standard error asked of the mean.
    """
    x = np.concatenate([v / np.linalg.norm(v[1:].mean(axis=0)), i / np.linalg.norm(i[1:].mean(axis=0))], axis=1)
    n = len(x)
    errors = np.array([_error_of_mean(x[first:]) for first in range(1, n - NOISY_WINDOWS + 1)])
    first = 1 + int(np.argmax(errors <= BEST * np.min(errors)))
    error, at_rest = float(errors[first - 1]), _halves_apart(x[first:]) <= STEADY_LIMIT
    middle = (first + n) // 2
    growth = _growth(i[first:middle].mean(axis=0), i[middle:].mean(axis=0))
    return Settled(v[first:], i[first:], error, n - 1, at_rest, bool(at_rest and error <= uncertainty), growth)


def shown_by(shot: Settled, window_s: float) -> tuple[float, float]:
    """Agreement of the two stretches that say a shot is at rest, and the length of one of them (s).

    Two windows of a quiet shot; the two halves of what counts of a noisy one, whose means scatter.
    """
    if len(shot.v) > 1:
        return 2.0 * STEADY_LIMIT * shot.residual, 0.5 * len(shot.v) * window_s
    return shot.residual, window_s


def growth_bound(agreement: float, stretch_s: float, disturbed_s: float, farthest_rad_s: float) -> float:
    """Fastest growth (1/s) that a mode of the device can have without the end of a perturbed run showing it.

    A mode exp(p t) that contributes the share e0 = `EXCITED` of Y at the tone is set going with that share of the
    response when the tone begins. A stretch of length W hears the part (e^zW - 1) / (zW) of it, z = p - j w_tone, and
    two successive stretches, the later of which ends at T, differ by at least

        e0 (e^gW - 1)^2 e^(g (T - 2 W)) / (|z| W)  >=  e0 e^(g T) / (4 |z| W)    for g = Re p >= ln 2 / W.

    They were seen to agree within r of the later one, in which the mode itself has at most twice that difference, so
    that g <= ln(4 r / (1 - 2 r) |z| W / e0) / T, or g < ln 2 / W.

    Parameters
    ----------
    agreement : float
        Relative difference r of two successive stretches at the end of the run.
    stretch_s : float
        Length W of one of them (s).
    disturbed_s : float
        Time T from the beginning of the perturbation, or of the record, to the end of the later one (s).
    farthest_rad_s : float
        Largest distance |z| between the tone and a mode that is asked about (rad/s).

    Returns
    -------
    float
        The bound; infinite where the stretches hardly agree at all.
    """
    if not agreement < 0.5:
        return inf
    difference = max(agreement, ROUNDING) / (1.0 - 2.0 * agreement)
    level = 4.0 * difference * farthest_rad_s * stretch_s / EXCITED
    return max(log(level) / disturbed_s if level > 1.0 else 0.0, log(2.0) / stretch_s)


def trend(x: np.ndarray) -> tuple[float, float]:
    """How far a straight line through a complex sequence (n,) goes, and that in its standard errors."""
    t = np.arange(len(x)) - 0.5 * (len(x) - 1)
    slope = np.sum(t * x) / np.sum(t**2)
    rest = x - x.mean() - slope * t
    error = np.sqrt(np.sum(np.abs(rest) ** 2) / (len(x) - 2) / np.sum(t**2))
    return float(np.abs(slope) * (len(x) - 1)), float(np.abs(slope) / error) if error else np.inf


def _error_of_mean(x: np.ndarray) -> float:
    """Standard error of the mean of rows (n, m)."""
    return float(np.linalg.norm(x - x.mean(axis=0)) / np.sqrt((len(x) - 1) * len(x)))


def _halves_apart(x: np.ndarray) -> float:
    """How far the means of the two halves of rows (n, m) lie apart, in standard errors by successive differences."""
    n, middle = len(x), len(x) // 2
    error = np.linalg.norm(np.diff(x, axis=0)) / np.sqrt(2.0 * (n - 1)) * np.sqrt(1.0 / middle + 1.0 / (n - middle))
    apart = np.linalg.norm(x[:middle].mean(axis=0) - x[middle:].mean(axis=0))
    return float(apart / error) if error else 0.0


def _growth(before: np.ndarray, after: np.ndarray) -> float:
    size = float(np.linalg.norm(before))
    return float(np.linalg.norm(after)) / size if size else 1.0


def _change(before: np.ndarray, after: np.ndarray) -> float:
    size = float(np.linalg.norm(after))
    change = float(np.linalg.norm(after - before))
    if change == 0.0:
        return 0.0  # a device that takes no current at all agrees with itself
    return change / size if size else np.inf


def period_change(x: np.ndarray, least_peak: float = 0.0) -> float:
    """Largest difference between the two halves of ``x``, relative to its peak, or to ``least_peak`` if more."""
    half = len(x) // 2
    return float(np.max(np.abs(x[half:] - x[:half])) / max(np.max(np.abs(x)), least_peak))
