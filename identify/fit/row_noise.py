"""Rows that cannot be trusted as much as the others: noise per row where the table has none, and outlying rows.

One weight for all rows buys poles of noise where some rows are noisier, and outlying rows ask for poles of their own.
Both show in the misfit of a first fit: noise as its size over neighbouring rows, outliers as rows that stand out of it
once the poles narrower than the rows are taken away.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .dq_data import ELEMENTS
from .least_squares import Problem, Trial, floor_cost, refine, shows_noise, solve_residues, trial_at
from .order import narrow_poles, outlier_note, select_order, without_rows

_ALIKE = 15  # neighbouring rows taken to have the same noise
_UNEVEN = 2.0  # ratio of the largest noise to the smallest from which on rows are weighted by it
_APART = 6.0  # an outlying row's misfit, in that of its neighbours
_LARGE = 1e-3  # and at least so much of Y
_MOST = 0.15  # part of the rows that may be left out
_UNDAMPED = 0.05  # damping ratio of a pole that stands for a row or two
_TOLERATED = 3.0  # misfits up to so many times the neighbours' keep their full weight in the robust fit


def weighted_by_misfit(problem: Problem, trial: Trial) -> Problem | None:
    """The problem with rows weighted by the noise that the misfit shows; None where it shows none, or an even one."""
    if problem.weighting != "relative" or not shows_noise(problem, trial):
        return None
    size = np.sqrt(_running(np.mean, _row_misfit(problem, trial) ** 2))
    if size.max() < _UNEVEN * size.min():
        return None
    factor = np.median(size) / np.maximum(size, 0.1 * np.median(size))
    return problem._replace(weight=problem.weight * factor)


def leave_out_outliers(problem: Problem, trial: Trial, max_order: int) -> tuple[Problem, Trial, tuple[str, ...]]:
    """Leave out rows that stand out of a fit which has no pole narrower than the rows, where the others agree with it.

    The others agree where a fit to them alone, without those poles, has a BIC no higher than one with them.
    """
    narrow = _lines(problem, trial)
    if len(narrow) == 0 or trial.cost < floor_cost(problem):
        return problem, trial, ()
    wide = np.delete(trial.poles, narrow)
    rows = _outlying(problem, trial_at(problem, wide, trial.tail)) if len(wide) else np.zeros(0, dtype=int)
    if len(rows) == 0 or len(rows) > _MOST * len(problem.s):
        return problem, trial, ()
    rest = without_rows(problem, rows)
    without = refine(rest, select_order(rest, min(max_order, (len(rest.s) - 1) // 2), None))
    with_them = refine(rest, trial_at(rest, trial.poles, trial.tail))
    if without.bic > with_them.bic or len(_lines(rest, without)) >= len(narrow):
        return problem, trial, ()
    return rest, without, tuple(outlier_note(float(nu)) for nu in problem.s.imag[rows] / (2.0 * np.pi))


def _lines(problem: Problem, trial: Trial) -> np.ndarray:
    """Indices of poles narrower than the rows and next to undamped: lines that a row or two ask for."""
    narrow = narrow_poles(problem, trial.poles)
    return narrow[np.abs(trial.poles[narrow].real) < _UNDAMPED * np.abs(trial.poles[narrow])]


def _outlying(problem: Problem, trial: Trial) -> np.ndarray:
    """Rows that stand out of a robust fit: large misfits count the less the larger they are."""
    factor = np.ones(len(problem.s))
    for _ in range(6):
        trial = refine(problem._replace(weight=problem.weight * factor), trial)
        misfit = _row_misfit(problem, trial, factor)
        usual = _running(np.median, misfit)
        factor = 1.0 / np.maximum(1.0, misfit / (_TOLERATED * np.maximum(usual, problem.floor)))
    relative = misfit / (problem.weight.mean(axis=0) * np.sqrt(np.sum(np.abs(problem.y) ** 2, axis=0) / ELEMENTS))
    return np.flatnonzero((misfit > _APART * usual) & (relative > _LARGE))


def _row_misfit(problem: Problem, trial: Trial, factor: np.ndarray | float = 1.0) -> np.ndarray:
    """Root mean square (n,) of each row's weighted misfit, residues fitted with weights times ``factor``."""
    n = len(problem.s)
    misfit = solve_residues(problem._replace(weight=problem.weight * factor), trial.poles, trial.tail).misfit
    return np.asarray(np.sqrt(np.mean(misfit[:, :n] ** 2 + misfit[:, n:] ** 2, axis=0) / 2.0) / factor)


def _running(mean: Callable[..., np.ndarray], values: np.ndarray) -> np.ndarray:
    """A mean over the rows around each."""
    n = len(values)
    half = min(_ALIKE, n) // 2
    first = np.clip(np.arange(n) - half, 0, n - 2 * half - 1)
    return mean(values[first[:, None] + np.arange(2 * half + 1)], axis=1)
