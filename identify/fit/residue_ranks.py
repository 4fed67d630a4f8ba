"""The rank of the residues: two, or one where the second direction is noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .dq_data import ELEMENTS
from .least_squares import Linear, Problem, Trial, block_diagonal, datum_variance, inverse_r
from .partial_fractions import counts_upper, order_of, parts

_SINGULAR = 1e-2  # second direction of a residue, relative to the first, below which an unstable pole counts once


class Cut(NamedTuple):
    """Coefficients (4, c) with some residues made singular, ranks (m,), and rows (j, 4c) that read what was cut."""

    coefficients: np.ndarray
    ranks: np.ndarray
    rows: np.ndarray


def uncut(trial: Trial, linear: Linear) -> Cut:
    """Every residue with its full rank."""
    return Cut(linear.coefficients, np.full(order_of(trial.poles), 2), np.zeros((0, linear.coefficients.size)))


def cut_ranks(problem: Problem, trial: Trial, linear: Linear) -> Cut:
    """Rank one, one residue after the other, while losing the second direction costs less than its BIC penalty.

    The direction is held at zero and all other coefficients are fitted again, poles fixed: a plain conditional least
    squares, so that residues of neighbouring poles, which only their sum is known of, are not cut one by one.
    """
    n_real, n_pair = counts_upper(trial.poles)
    r_inverse = inverse_r(linear)
    covariance = datum_variance(problem, trial, linear) * block_diagonal(r_inverse @ np.swapaxes(r_inverse, 1, 2))
    x = linear.coefficients.ravel()
    open_ones = set(range(n_real + n_pair))
    rows = np.zeros((0, len(x)))
    penalty = float(np.log(2 * problem.y.size))
    while open_ones:
        weights = {k: _second_direction(trial, x.reshape(ELEMENTS, -1), k) for k in open_ones}
        price = {k: _price(w, x, covariance) / len(w) for k, w in weights.items()}
        price.update(dict.fromkeys(_single(problem, trial, x.reshape(ELEMENTS, -1)) & open_ones, 0.0))
        k = min(price, key=lambda at: price[at])
        if price[k] > penalty:
            break
        w = weights[k]
        lever = np.linalg.solve(w @ covariance @ w.T, w @ covariance).T
        x, covariance = x - lever @ (w @ x), covariance - lever @ (w @ covariance)
        rows = np.append(rows, w, axis=0)
        open_ones.remove(k)
    ranks = np.array([2 if k in open_ones else 1 for k in range(n_real + n_pair)], dtype=int)
    return Cut(x.reshape(ELEMENTS, -1), np.append(ranks, ranks[n_real:]), rows)


def _single(problem: Problem, trial: Trial, coefficients: np.ndarray) -> set[int]:
    """Poles in the right half-plane that count once: as many as experiment proved, or all but singular residues.

    A mode has one direction; a second one worth a hundredth of the first is an error of the sweep.
    """
    n_real, n_pair = counts_upper(trial.poles)
    unstable = np.flatnonzero(trial.poles.real > 0.0)
    if problem.n_unstable:
        return set(unstable.tolist())
    singular = np.linalg.svd(parts(n_real, n_pair, trial.tail, coefficients)[0][unstable], compute_uv=False)
    return set(unstable[singular[:, 1] < _SINGULAR * singular[:, 0]].tolist())


def _second_direction(trial: Trial, coefficients: np.ndarray, k: int) -> np.ndarray:
    """Rows (1 or 2, 4c) that read Re and Im of the second singular direction of residue k."""
    n_real, n_pair = counts_upper(trial.poles)
    u, _, vh = np.linalg.svd(parts(n_real, n_pair, trial.tail, coefficients)[0][k])
    direction = np.kron(u[:, 1].conj(), vh[1].conj())
    rows = np.zeros((1 if k < n_real else 2, *coefficients.shape))
    rows[0, :, k] = direction.real
    if k >= n_real:
        rows[1, :, k] = direction.imag
        rows[0, :, k + n_pair], rows[1, :, k + n_pair] = -direction.imag, direction.real
    return rows.reshape(len(rows), -1)


def _price(rows: np.ndarray, x: np.ndarray, covariance: np.ndarray) -> float:
    """Rise of chi-squared when ``rows @ x`` is held at zero."""
    value = rows @ x
    spread = rows @ covariance @ rows.T
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    return float(value / scale @ np.linalg.lstsq(spread / np.outer(scale, scale), value / scale, rcond=None)[0])


def truncated(residues: np.ndarray, ranks: np.ndarray) -> np.ndarray:
    """Residues with the second singular value set to zero where the rank is one."""
    u, singular, vh = np.linalg.svd(residues)
    singular[ranks == 1, 1] = 0.0
    return (u * singular[:, None, :]) @ vh
