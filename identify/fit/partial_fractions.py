"""Partial fractions with real coefficients: the basis functions of a real system and what their coefficients mean.

Poles are held as the real ones, then the upper halves of the pairs. A pair has two basis functions,
``1/(s - p) + 1/(s - p*)`` and ``1j/(s - p) - 1j/(s - p*)``: their coefficients are Re and Im of its residue.
"""

from __future__ import annotations

import numpy as np

_NEAR = 1e-3  # poles closer than this, relatively, count as coinciding


def basis(s: np.ndarray, poles: np.ndarray, tail: int) -> np.ndarray:
    """(n, order + tail) real-coefficient partial fractions, then the constant, then s."""
    n_real, n_pair = counts_upper(poles)
    m = n_real + 2 * n_pair
    pairs = poles[n_real:]
    half = 2.0 / ((s[:, None] - pairs) * (s[:, None] - pairs.conj()))
    functions = np.empty((len(s), m + tail), dtype=complex)
    functions[:, :n_real] = 1.0 / (s[:, None] - poles[:n_real])
    functions[:, n_real : n_real + n_pair] = (s[:, None] - pairs.real) * half
    functions[:, n_real + n_pair : m] = -pairs.imag * half
    functions[:, m:] = s[:, None] ** np.arange(tail)
    return functions


def parts(n_real: int, n_pair: int, tail: int, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residues (m, 2, 2), D and E (2, 2) from the coefficients (4, c)."""
    m = n_real + 2 * n_pair
    x = coefficients.T.reshape(-1, 2, 2)
    pair = x[n_real : n_real + n_pair] + 1j * x[n_real + n_pair : m]
    ends = np.concatenate([x[m:], np.zeros((2 - tail, 2, 2))])
    return np.concatenate([x[:n_real].astype(complex), pair, pair.conj()]), ends[0], ends[1]


def pairs_joined(step: np.ndarray, n_real: int, n_pair: int) -> np.ndarray:
    """Real parameters of poles as complex numbers: the real ones, then the upper halves of the pairs."""
    return np.concatenate([step[:n_real], step[n_real : n_real + n_pair] + 1j * step[n_real + n_pair :]])


def upper_half(poles: np.ndarray) -> np.ndarray:
    """Real poles, then the upper halves of the pairs, kept apart from each other."""
    real = np.abs(poles.imag) <= 1e-9 * np.abs(poles)
    return separated(np.concatenate([poles[real].real + 0j, poles[~real & (poles.imag > 0.0)]]))


def separated(poles: np.ndarray) -> np.ndarray:
    """A pair meeting on the real axis becomes two real poles, two equal real poles a pair: no residue explodes."""
    is_real = poles.imag == 0.0
    real, pairs = np.sort(poles[is_real].real), poles[~is_real]
    meeting = np.abs(pairs.imag) < _NEAR * np.abs(pairs)
    close = np.flatnonzero(np.diff(real) < _NEAR * np.abs(real[1:]))[:1]
    if not len(close) and not np.any(meeting):
        return np.concatenate([real + 0j, pairs.real + 1j * np.abs(pairs.imag)])
    apart, met = np.abs(pairs[meeting]) * _NEAR, pairs[meeting].real
    middle = (real[close] + real[close + 1]) / 2.0
    kept = np.delete(real, np.concatenate([close, close + 1]))
    pairs = np.concatenate([pairs[~meeting], middle + 2j * _NEAR * np.abs(middle)])
    real = np.concatenate([kept, met - apart, met + apart])
    return np.concatenate([real + 0j, pairs.real + 1j * np.abs(pairs.imag)])


def counts_upper(poles: np.ndarray) -> tuple[int, int]:
    """Numbers of real poles and of pairs, from the real poles and the upper halves."""
    n_real = int(np.count_nonzero(poles.imag == 0.0))
    return n_real, len(poles) - n_real


def counts(poles: np.ndarray) -> tuple[int, int]:
    """Numbers of real poles and of pairs, from all poles."""
    n_real = int(np.sum(poles.imag == 0.0))
    return n_real, (len(poles) - n_real) // 2


def order_of(poles: np.ndarray) -> int:
    """Number of poles, from the real ones and the upper halves."""
    n_real, n_pair = counts_upper(poles)
    return n_real + 2 * n_pair
