"""Rows without noise, sparse for their device: an interpolant finds the poles where the order search gets stuck.

The search begins with weakly damped pairs. Where its misfit is beyond what the rows state of their errors, interpolants
of growing degree (`aaa`) are asked. If one describes the rows it does not pass through as well, to 1e-5, the rows have
no noise to speak of, and its poles are a start for the fit. Noise is nothing that an interpolant ever describes.
"""

from __future__ import annotations

import numpy as np

from .aaa import Barycentric, interpolants, poles
from .dq_data import DqData
from .least_squares import Problem, Trial, floor_cost, held, refine
from .order import ended, met_exactly, prune, relative_misfit, to_rounding
from .partial_fractions import order_of, upper_half
from .vector_fit import vector_fit

_DESCRIBED = 1e-5  # misfit of an interpolant, relative to Y, that noise does not allow
_TO_ROUNDING = 1e-9  # misfit of one that no error of a sweep allows
_UNEXPLAINED = 4.0  # variances beyond the stated ones from which on a misfit is no noise
_HIGHEST, _PER_ROW = 27, 0.8  # order of an interpolant, and order per row: half as many parameters as numbers
_MOST_PER_ROW = 1.2  # order per row of one that meets rows to rounding: three quarters as many
_ONE_PLACE = 1e-6  # rows closer than this, relatively, are at one place
_SOME = 45  # rows that are asked whether they are exact
_MANY = 150  # rows from which on a search that ended below the highest order is stuck only where rows are exact


def from_interpolant(problem: Problem, data: DqData, trial: Trial, max_order: int) -> Trial:
    """A trial that starts from the poles of an interpolant, where rows are exact and ``trial`` misses them.

    ``max_order`` is where the search for the trial's order had to end.
    """
    if not _is_unexplained(problem, trial):
        return trial
    if len(data.nu_hz) > _MANY and order_of(trial.poles) + 2 <= max_order:
        exact = exact_fit(problem, data)
        return trial if exact is None else exact
    found = _describing(data)
    if found is None:
        return beyond_search(problem, data, trial, max_order)
    return min([trial, *_started(problem, found)], key=lambda t: t.bic)


def beyond_search(problem: Problem, data: DqData, trial: Trial, max_order: int) -> Trial:
    """A trial of more poles than the search may take, where that ended at ``max_order`` for rows that are few.

    Interpolants of noisy rows describe nothing, but are a start if they come nearer to the rows than the search did.
    Which order pays is for the BIC to say.
    """
    if not ended(problem, trial, max_order) or not _is_unexplained(problem, trial) or _is_twofold(data):
        return trial
    best, missed = trial, relative_misfit(problem, trial)
    for found in interpolants(data):
        if _order(found) > min(_HIGHEST, _PER_ROW * len(data.nu_hz)):
            break
        if _order(found) <= max_order or found.misfit > missed:
            continue
        tried = min(_started(problem, found), key=lambda t: t.bic)
        if tried.bic > best.bic and best is not trial:
            break
        best = min(best, tried, key=lambda t: t.bic)
    return best


def _order(found: Barycentric) -> int:
    return 2 * len(found.z) - 1


def exact_fit(problem: Problem, data: DqData) -> Trial | None:
    """A fit that starts from an interpolant and meets the rows to rounding; None where they are not exact.

    Rows that state their errors are not. Of many rows some tell whether the others are worth a look.
    """
    if data.std is not None:
        return None
    step = -(-len(data.nu_hz) // _SOME)
    found = _describing(DqData(data.nu_hz[::step], data.y[::step], None))
    if found is None or found.misfit > _TO_ROUNDING:
        return None
    met = [met_exactly(problem, trial) for trial in _started(problem, found)]
    exact = [trial for trial in met if trial is not None]
    return prune(to_rounding(problem), min(exact, key=lambda t: t.bic)) if exact else None


def _started(problem: Problem, found: Barycentric) -> list[Trial]:
    """Trials that start from the poles of an interpolant."""
    start = held(problem, upper_half(poles(found)))
    return [refine(problem, vector_fit(problem, start, tail)) for tail in (1, 2)]


def _describing(data: DqData) -> Barycentric | None:
    """The first interpolant that describes the rows and is not ten times worse than the next, if any does.

    Rows that were measured twice, at f and at its mirror image, differ: they have noise.
    """
    if _is_twofold(data):
        return None
    best = None
    for found in interpolants(data):
        order, n = _order(found), len(data.nu_hz)
        if order > min(_HIGHEST, _MOST_PER_ROW * n):
            break
        if best is not None and found.misfit > 0.1 * best.misfit:
            break
        if found.misfit < (_DESCRIBED if order <= _PER_ROW * n else _TO_ROUNDING):
            best = found
    return best


def _is_twofold(data: DqData) -> bool:
    """Whether a row was measured twice, at f and at its mirror image."""
    return bool(np.any(np.diff(data.nu_hz) <= _ONE_PLACE * data.nu_hz[1:]))


def _is_unexplained(problem: Problem, trial: Trial) -> bool:
    """Whether the misfit is beyond the floor, and beyond the stated errors where there are any."""
    if trial.cost < _UNEXPLAINED * floor_cost(problem):
        return False
    return problem.noise is None or trial.cost > _UNEXPLAINED * float(np.einsum("nii->", problem.noise))
