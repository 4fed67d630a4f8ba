"""An interpolation of the rows that knows nothing of the fit: between two rows, a rational function of those around.

Every interval has a model of its own, ``Y(x) d(x) = N(x)`` with one scalar d of low degree, from the rows nearest to
it by linearised least squares relative to Y. Rows are continued to negative frequency by their conjugates, so that the
interval around f1 is one between rows as well. No poles are sought, none is believed: it is a way from row to row.

R. Pintelon, J. Schoukens, "System Identification", 2nd ed. 2012, chapter 7, has the local rational method for records.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from .dq_data import ELEMENTS, DqData

_DENSE = 60  # from so many distinct rows on a window holds twice as many, which takes noise down
_SPARSE_WINDOW, _DENSE_WINDOW = (8, 3, 2), (16, 4, 3)  # rows, degree of N, degree of d
_ONE_PLACE = 1e-6  # rows closer than this, relatively, are taken together


class LocalRational(NamedTuple):
    """One model for every interval between rows: legendre coefficients over ``(nu - middle) / half``.

    Attributes
    ----------
    nu_hz : (n,) float
        The rows, |f - f1| (Hz), strictly ascending. Interval 0 reaches from -nu[0] to nu[0].
    middle, half : (n,) float
        Of the window of each interval (Hz).
    numerator : (n, 4, p + 1) complex
        N for dd, dq, qd, qq.
    denominator : (n, q + 1) complex
        d.
    """

    nu_hz: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    numerator: np.ndarray
    denominator: np.ndarray


def local_rational(data: DqData) -> LocalRational:
    """The models of all intervals; at least four rows."""
    nu, y = _distinct(data)
    n = len(nu)
    size, p, q = _DENSE_WINDOW if n >= _DENSE else _SPARSE_WINDOW
    size = min(size, 2 * n)
    rows = np.clip(n - size // 2 + np.arange(n), 0, 2 * n - size)[:, None] + np.arange(size)
    both, values = np.concatenate([-nu[::-1], nu]), np.concatenate([y[::-1].conj(), y])
    middle = (both[n - 1 + np.arange(n)] + both[n + np.arange(n)]) / 2.0
    half = np.abs(both[rows] - middle[:, None]).max(axis=1)
    powers = legvander((both[rows] - middle[:, None]) / half[:, None], max(p, q)).astype(complex)
    return LocalRational(nu, middle, half, *_solved(powers, values[rows], p, q))


def between_rows(model: LocalRational, nu_hz: np.ndarray) -> np.ndarray:
    """Ydq (n, 2, 2) in S at frequencies (n,) from zero to the highest row (Hz, dq)."""
    k = np.minimum(np.searchsorted(model.nu_hz, nu_hz), len(model.nu_hz) - 1)
    p, q = model.numerator.shape[2], model.denominator.shape[1]
    powers = legvander((nu_hz - model.middle[k]) / model.half[k], max(p, q) - 1)
    above = np.einsum("nei,ni->ne", model.numerator[k], powers[:, :p])
    below = np.einsum("ni,ni->n", model.denominator[k], powers[:, :q])
    return (above / below[:, None]).reshape(-1, 2, 2)


def sharpness(model: LocalRational, nu_hz: np.ndarray) -> np.ndarray:
    """How many times (n,) the noise of the rows counts at ``nu_hz``: more than once near a zero of d."""
    k = np.minimum(np.searchsorted(model.nu_hz, nu_hz), len(model.nu_hz) - 1)
    powers = legvander((nu_hz - model.middle[k]) / model.half[k], model.denominator.shape[1] - 1)
    below = np.abs(np.einsum("ni,ni->n", model.denominator[k], powers))
    return np.asarray(np.abs(model.denominator[k]).sum(axis=1) / np.maximum(below, 1e-300))


def _distinct(data: DqData) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) and values (n, 4); rows at one place are averaged."""
    new = np.append(True, np.diff(data.nu_hz) > _ONE_PLACE * data.nu_hz[1:])
    place = np.cumsum(new) - 1
    count = np.bincount(place)
    total = np.zeros((len(count), ELEMENTS), dtype=complex)
    np.add.at(total, place, data.y.reshape(-1, ELEMENTS))
    return data.nu_hz[new], total / count[:, None]


def _solved(powers: np.ndarray, y: np.ndarray, p: int, q: int) -> tuple[np.ndarray, np.ndarray]:
    """N (b, 4, p + 1) and d (b, q + 1), of unit length, with the least ||Y d - N|| / ||Y|| over each window's rows."""
    weight = 1.0 / np.linalg.norm(y, axis=2)[:, :, None]
    basis, upper = np.linalg.qr(weight * powers[:, :, : p + 1])
    carried = (weight * y)[:, :, :, None] * powers[:, :, None, : q + 1]
    inside = np.einsum("bmi,bmec->biec", basis.conj(), carried)
    left = carried - np.einsum("bmi,biec->bmec", basis, inside)
    small = np.linalg.qr(left.reshape(len(y), -1, q + 1), mode="r")  # of the same right singular vectors
    denominator = np.linalg.svd(small)[2][:, -1].conj()
    target = np.einsum("biec,bc->bei", inside, denominator)
    numerator = np.linalg.solve(upper[:, None], target[..., None])[..., 0]
    return numerator, denominator
