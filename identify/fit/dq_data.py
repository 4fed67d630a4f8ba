"""The usable rows of a response in the dq frame, folded to positive frequency, with their noise and weights.

Weights and noise are two things. A *weight* only has to be sensible, and one estimated from few windows is not: it
follows the row's own luck. So weights come from standard deviations smoothed over neighbouring rows. The *noise*, which
says how far the fit may be wrong, stays as it was measured, correlations included.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import T_INVERSE, T, pn_to_dq
from ..response import FrequencyResponse

ELEMENTS = 4

_NEIGHBOURS = 9  # rows whose median a standard deviation is compared with
_SCATTER = 2.0  # up to this ratio to that median a row differs by chance: four of its standard errors with 3 windows
_BETTER = 10.0  # a row counts as at most so many times better than its neighbours
_SAME = 1e-9  # rows of a mirror pair closer than this, relatively, are one measurement written twice
_SAME_STD = 1e-3  # the same in standard deviations: eight numbers that close never are a coincidence
_CONJUGATE = np.diag(np.tile([1.0, -1.0], ELEMENTS))


class DqData(NamedTuple):
    """Usable rows in the dq frame, folded to positive frequency.

    Attributes
    ----------
    nu_hz : (n,) float
        Frequency seen from the rotating frame, |f - f1| (Hz), ascending.
    y : (n, 2, 2) complex
        Admittance in the dq frame (S).
    std : (n, 2, 2) float or None
        Standard deviation of the real and of the imaginary part (S), smoothed: what weights are made from. None if no
        row has a covariance.
    covariance : (n, 8, 8) float or None
        Covariance over (re, im) of dd, dq, qd, qq (S^2), as measured; None: that of ``std``, or unknown as well.
    """

    nu_hz: np.ndarray
    y: np.ndarray
    std: np.ndarray | None
    covariance: np.ndarray | None = None


def to_dq(response: FrequencyResponse) -> DqData:
    """The response's `usable` rows, in the dq frame at nu > 0; rows at f1 itself are left out.

    Notes
    -----
    Rows at f and at 2 f1 - f fall onto the same nu. Measured by experiments of their own they are two measurements;
    computed from the same experiments they are one, written twice (mirror symmetry holds to rounding), and count once.
    """
    usable = response.usable
    y, nu_hz = response.y[usable], response.f_hz[usable]
    covariance = np.asarray(response.covariance)[usable]
    if response.frame == "pn":
        nu_hz = nu_hz - response.f1_hz
        y = pn_to_dq(y)
        turn = _real_form(np.kron(T_INVERSE, T.T))
        covariance = turn @ covariance @ turn.T
    below = (nu_hz < 0.0)[:, None, None]
    y = np.where(below, y.conj(), y)
    covariance = np.where(below, _CONJUGATE @ covariance @ _CONJUGATE, covariance)
    rows = np.argsort(np.abs(nu_hz), kind="stable")
    rows = rows[nu_hz[rows] != 0.0]
    nu_hz, y, covariance = np.abs(nu_hz)[rows], y[rows], covariance[rows]
    once = ~_is_repeated(nu_hz, y, covariance)
    return _with_noise(nu_hz[once], y[once], covariance[once])


def _is_repeated(nu_hz: np.ndarray, y: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n,) bool: rows that say the same as the row before them, to rounding."""
    same_nu = np.diff(nu_hz) <= _SAME * nu_hz[1:]
    apart = np.abs(np.diff(y, axis=0)).reshape(-1, ELEMENTS)
    size = np.linalg.norm(y[1:], axis=(1, 2))[:, None]
    std = np.sqrt(np.maximum(_mean_variance(covariance[1:]), 0.0))
    same_y = (apart <= np.fmax(_SAME * size, _SAME_STD * std)).all(axis=1)
    return np.concatenate([[False], same_nu & same_y])[: len(nu_hz)]


def _with_noise(nu_hz: np.ndarray, y: np.ndarray, covariance: np.ndarray) -> DqData:
    """A row without a covariance takes the others' median standard deviation, relative to its size."""
    std = np.sqrt(np.maximum(_mean_variance(covariance), 0.0))
    known = np.isfinite(covariance).all(axis=(1, 2)) & (std > 0.0).all(axis=1)
    if not np.any(known):
        return DqData(nu_hz, y, None)
    size = np.linalg.norm(y, axis=(1, 2))[:, None]
    relative = np.where(known[:, None], std / size, np.median((std / size)[known], axis=0))
    assumed = np.repeat((relative * size) ** 2, 2, axis=1)[:, :, None] * np.eye(2 * ELEMENTS)
    covariance = np.where(known[:, None, None], covariance, assumed)
    return DqData(nu_hz, y, (_smoothed(relative) * size).reshape(-1, 2, 2), covariance)


def _mean_variance(covariance: np.ndarray) -> np.ndarray:
    """(n, 4) mean of the variances of the real and the imaginary part."""
    variance = np.einsum("nii->ni", covariance)
    return (variance[:, 0::2] + variance[:, 1::2]) / 2.0


def _smoothed(std: np.ndarray) -> np.ndarray:
    """(n, 4) standard deviations with what is chance taken out: drawn to the median of the rows around each."""
    n = len(std)
    half = min(_NEIGHBOURS, n) // 2
    first = np.clip(np.arange(n) - half, 0, n - 2 * half - 1)
    around = np.log(std)[first[:, None] + np.arange(2 * half + 1)]
    middle = np.median(around, axis=1)
    excess = np.log(std) - middle
    kept = np.sign(excess) * np.maximum(np.abs(excess) - np.log(_SCATTER), 0.0)
    return np.exp(middle + np.maximum(kept, -np.log(_BETTER)))


def _real_form(matrix: np.ndarray) -> np.ndarray:
    """A complex (4, 4) map as a real one (8, 8) on (re, im) of each element."""
    real = np.zeros((2 * ELEMENTS, 2 * ELEMENTS))
    real[0::2, 0::2], real[0::2, 1::2] = matrix.real, -matrix.imag
    real[1::2, 0::2], real[1::2, 1::2] = matrix.imag, matrix.real
    return real
