"""Relaxed vector fitting with real coefficients: poles relocated until they rest."""

from __future__ import annotations

import numpy as np

from .dq_data import ELEMENTS
from .least_squares import Problem, Trial, floor_cost, held, stacked, trial_at
from .partial_fractions import basis, counts_upper, order_of, upper_half


def vector_fit(problem: Problem, poles: np.ndarray, tail: int, n_iterations: int = 12) -> Trial:
    """Relocate poles until they rest; the best iterate counts, because noise lets them wander."""
    best = trial_at(problem, poles, tail)
    for _ in range(n_iterations):
        moved = _relocate(problem, poles, tail)
        if moved is None:
            break
        trial = trial_at(problem, moved, tail)
        gain = best.cost - trial.cost
        best = min(best, trial, key=lambda t: t.cost)
        if abs(gain) < 1e-3 * best.cost or best.cost < floor_cost(problem):
            break
        poles = moved
    return best


def _relocate(problem: Problem, poles: np.ndarray, tail: int) -> np.ndarray | None:
    """One step of relaxed vector fitting: the zeros of sigma(s) = d + sum c_k phi_k(s) are the new poles."""
    phi = basis(problem.s, poles, tail)
    m = order_of(poles)
    sigma = np.append(phi[:, :m], np.ones((len(problem.s), 1)), axis=1)
    block = (
        np.concatenate([np.broadcast_to(phi, (ELEMENTS, *phi.shape)), -problem.y[:, :, None] * sigma], axis=2)
        * problem.weight[:, :, None]
    )
    factor = np.asarray(np.linalg.qr(stacked(block), mode="r"))
    upper = factor[:, phi.shape[1] :, phi.shape[1] :]
    scale = np.sqrt(np.sum(np.abs(problem.weight * problem.y) ** 2)) / len(problem.s)
    rows = np.concatenate([upper.reshape(-1, m + 1), scale * sigma.real.sum(axis=0)[None]])
    norm = np.linalg.norm(rows, axis=0)
    norm[norm == 0.0] = 1.0
    right = np.zeros(len(rows))
    right[-1] = scale * len(problem.s)
    c = np.linalg.lstsq(rows / norm, right, rcond=None)[0] / norm
    if not np.all(np.isfinite(c)) or abs(c[-1]) < 1e-12:
        return None
    a, b = _realisation(poles)
    return upper_half(held(problem, np.linalg.eigvals(a - np.outer(b, c[:m]) / c[-1])))


def _realisation(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real (A, b) whose (sI - A)^-1 b are the basis functions of `basis`."""
    n_real, n_pair = counts_upper(poles)
    pairs = poles[n_real:]
    a = np.diag(np.concatenate([poles.real, pairs.real]))
    i, j = n_real + np.arange(n_pair), n_real + n_pair + np.arange(n_pair)
    a[i, j], a[j, i] = pairs.imag, -pairs.imag
    return a, np.concatenate([np.ones(n_real), np.full(n_pair, 2.0), np.zeros(n_pair)])
