"""A rational model of the 2x2 admittance: vector fitting in the dq frame, order by BIC, poles with errors.

In the dq frame the device is a real system, so coefficients are real, poles come in conjugate pairs and the
points below f1 fall onto those above it: ``Ydq(-j nu) = conj Ydq(j nu)``. All four elements share the poles;
residues have full rank while fitting and are cut to rank one where the second direction is noise. The constant
is there, and a term in s, only if the data ask for them.

The order is the one with the lowest BIC, residuals below a noise floor counting no further. Then what is
spurious goes, in this order, each step with a refit of the rest:

1. a pole that a single row asks for: with that row left out, the fit without the pole has the lower BIC;
2. a pole whose removal lowers the BIC, whichever half-plane it is in;
3. one by one, poles in the right half-plane or within two standard errors of it without which the misfit stays below
   1e-4 of Y;
4. outside the swept band, where the data may not tell -p from p, a pole in the right half-plane gives way to its
   stable mirror image if that fits as well.

How many poles the device has in the right half-plane is not for the fit to say where an experiment said it: a device
whose disturbed runs came to rest on an ideal source has none, and the poles are held in the left half-plane at every
step (``n_unstable = 0``). Where as many are known to be there, those beyond are mirrored or removed, the least missed
first, and each counts once. Where nothing is known, those that are left stay. What was done is in the notes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError
from ..response import FrequencyResponse
from .covariance import finished
from .dq_data import ELEMENTS, DqData, to_dq
from .exact_rows import beyond_search, exact_fit, from_interpolant
from .least_squares import Problem, Trial, floor_cost, pole_std, refine, solve_residues, trial_at, weighted
from .order import (
    drop_faint,
    drop_outliers,
    is_exact,
    prune,
    select_order,
    settle_far_poles,
    settle_instability,
    settle_lasting,
    thin_out_far,
)
from .partial_fractions import order_of, upper_half
from .rational import RationalModel
from .row_noise import leave_out_outliers, weighted_by_misfit
from .vector_fit import vector_fit

MAX_ORDER = 24
"""Highest number of poles tried."""

NOISE_FLOOR = 1e-7
"""Relative misfit below which a higher order no longer counts as better."""

MIN_POINTS = 8
"""Fewest usable rows a model is made from."""

_EXPLAINED = 1.5  # misfits up to this multiple of the given variances are left to a factor


def fit_response(
    response: FrequencyResponse,
    *,
    max_order: int = MAX_ORDER,
    noise_floor: float = NOISE_FLOOR,
    start: RationalModel | None = None,
    n_unstable: int | None = None,
) -> RationalModel:
    """Rational model of one operating point.

    Parameters
    ----------
    response : FrequencyResponse
        Either frame; rows that are not "ok" or not finite are left out. Points are weighted by their covariance
        where known, else by 1/||Y||_F.
    max_order : int
        Highest number of poles tried.
    noise_floor : float
        Relative misfit below which a higher order no longer counts as better.
    start : RationalModel or None
        A model of a neighbouring operating point: its poles are the starting point, which saves time.
    n_unstable : int or None
        How many unstable poles of its own the device is known to have, conjugates counted. None: zero where
        ``response.meta["stable_on"]`` says that its disturbed runs came to rest on an ideal source, else whatever fits.

    Returns
    -------
    RationalModel
        In the dq frame, load direction.

    Raises
    ------
    SeqsweepError
        If fewer than `MIN_POINTS` usable rows are there.

    Notes
    -----
    Relaxed vector fitting with real coefficients, one set of poles; then variable projection (Gauss-Newton on the
    poles, residues eliminated), which also gives the covariance. The noise level is estimated from the misfit, so
    a covariance that is too small by a factor does no harm.
    """
    return fit_rows(
        _enough_rows(response),
        response.f1_hz,
        max_order=max_order,
        noise_floor=noise_floor,
        start=start,
        n_unstable=_known_unstable(response, n_unstable),
    )


class Settled(NamedTuple):
    """Poles that the data of a table ask for, before errors are told: what `finished` makes a model of."""

    problem: Problem
    f1_hz: float
    trial: Trial
    notes: tuple[str, ...]
    remarks: tuple[str, ...]


def settled_response(response: FrequencyResponse, n_unstable: int | None = None) -> Settled:
    """`fit_response`, with its defaults, up to the choice of the poles."""
    return _settled(_enough_rows(response), response.f1_hz, _known_unstable(response, n_unstable))


def _enough_rows(response: FrequencyResponse) -> DqData:
    """The usable rows, `MIN_POINTS` or more."""
    data = to_dq(response)
    if len(data.nu_hz) < MIN_POINTS:
        raise SeqsweepError(
            f"{len(data.nu_hz)} of {len(response)} rows are usable; a rational model needs at least {MIN_POINTS}: "
            "sweep more frequencies, or repair the rows whose status is not 'ok'"
        )
    return data


def fit_rows(
    data: DqData,
    f1_hz: float,
    *,
    max_order: int = MAX_ORDER,
    noise_floor: float = NOISE_FLOOR,
    start: RationalModel | None = None,
    n_unstable: int | None = None,
) -> RationalModel:
    """`fit_response` of rows that are in the dq frame already; ``n_unstable`` None: whatever fits."""
    return finished(*_settled(data, f1_hz, n_unstable, max_order, noise_floor, start))


def _settled(
    data: DqData,
    f1_hz: float,
    n_unstable: int | None,
    max_order: int = MAX_ORDER,
    noise_floor: float = NOISE_FLOOR,
    start: RationalModel | None = None,
) -> Settled:
    problem = weighted(data, noise_floor)._replace(n_unstable=n_unstable)
    max_order = min(max_order, (len(data.nu_hz) - 1) // 2)
    trial = select_order(problem, max_order, start)
    trial = trial if problem.noise is None else beyond_search(problem, data, trial, max_order)
    part = _unexplained_part(problem, trial)
    if part is not None:
        problem = weighted(data, noise_floor, part)._replace(n_unstable=n_unstable)
        trial = select_order(problem, max_order, start)
    trial = from_interpolant(problem, data, refine(problem, trial), max_order)
    problem, trial, outlying = leave_out_outliers(problem, trial, max_order)
    uneven = weighted_by_misfit(problem, trial)
    if uneven is not None:
        problem, trial = uneven, refine(uneven, _searched_again(uneven, trial, max_order))
    problem, trial, notes = drop_outliers(problem, trial)
    trial = thin_out_far(problem, prune(problem, trial))
    trial, removed = _without_faint(problem, data, trial)
    trial, mirrored = settle_far_poles(problem, trial)
    trial = settle_lasting(problem, settle_instability(problem, trial))
    return Settled(problem, f1_hz, trial, outlying + notes, removed + mirrored)


def _searched_again(problem: Problem, trial: Trial, max_order: int) -> Trial:
    """The best order for new weights; poles beyond the search are a start of their own."""
    searched = select_order(problem, max_order, None)
    if order_of(trial.poles) <= max_order:
        return searched
    return min(searched, trial_at(problem, trial.poles, trial.tail), key=lambda t: t.bic)


def _without_faint(problem: Problem, data: DqData, trial: Trial) -> tuple[Trial, tuple[str, ...]]:
    """The trial without faint poles, unless rows are exact: there none of its poles is owed to an error of the sweep.

    A fit that stops at the floor need not show that rows are exact, nor have the device's poles; an interpolant does.
    """
    less, removed = drop_faint(problem, trial)
    if is_exact(problem, less) or not (removed or less.cost < floor_cost(problem)):
        return less, removed
    exact = exact_fit(problem, data)
    return (less, removed) if exact is None else (exact, ())


class FreePoles(NamedTuple):
    """Poles (m,) with Im >= 0 (rad/s), and the standard errors of their real parts (1/s)."""

    poles: np.ndarray
    std_per_s: np.ndarray


def unheld(model: RationalModel, data: DqData) -> FreePoles:
    """Where the fitted rows would have the poles if no experiment held them.

    Misfits below the floor are not resolved: no row is taken to be known better than to it.
    """
    problem = weighted(data, model.noise_floor)._replace(weight=model.weight.T)
    free = refine(problem, trial_at(problem, upper_half(model.poles), model.tail))
    floor = floor_cost(problem)
    return FreePoles(free.poles, pole_std(problem, free) * np.sqrt(max(1.0, floor / max(free.cost, 1e-6 * floor))))


def unheld_exactly(model: RationalModel, data: DqData) -> FreePoles | None:
    """The same where the rows are exact; None where they are not.

    A fit that is held may meet exact rows to its floor with poles on the wrong side, or do without a faint one: only
    if it meets them to rounding, its poles are where nothing would hold them.
    """
    if data.std is not None:
        return None
    problem = weighted(data, model.noise_floor)._replace(weight=model.weight.T)
    fitted = trial_at(problem, upper_half(model.poles), model.tail)
    exact = fitted if is_exact(problem, fitted) else exact_fit(problem, data)
    return None if exact is None else FreePoles(exact.poles, pole_std(problem, exact))


def _known_unstable(response: FrequencyResponse, told: int | None) -> int | None:
    """Unstable poles of its own that are told; else zero where disturbed runs came to rest on an ideal source."""
    fact = response.meta.get("stable_on")
    proved = isinstance(fact, Mapping) and fact.get("grid") == "ideal"
    return 0 if told is None and proved else told


def _unexplained_part(problem: Problem, trial: Trial) -> float | None:
    """The part of Y that the misfit has beyond its covariances; None if a factor on them describes it as well.

    A model never fits to better than some part of Y, but covariances may say that some rows are known far better.
    Compared are two variances of the misfit, v the given one and u = size^2: factor * v, and v + part^2 * u.
    """
    if problem.noise is None:
        return None
    n = len(problem.s)
    misfit = solve_residues(problem, trial.poles, trial.tail).misfit
    used = (order_of(trial.poles) + ELEMENTS * (order_of(trial.poles) + trial.tail)) / misfit.size
    squared = (misfit[:, :n] ** 2 + misfit[:, n:] ** 2) / 2.0 / max(1.0 - used, 1e-3)
    variance = np.einsum("nii->in", problem.noise).reshape(ELEMENTS, 2, n).mean(axis=1)
    unit = np.sum(np.abs(problem.y) ** 2, axis=0) / ELEMENTS * problem.weight**2
    factor = float(np.mean(squared / variance))
    if factor < _EXPLAINED:
        return None
    low, high = -16.0, 2.0  # log10 of the part
    for _ in range(40):
        middle = (low + high) / 2.0
        too_small = np.mean(squared / (variance + 100.0**middle * unit)) > 1.0
        low, high = (middle, high) if too_small else (low, middle)
    part = 10.0**high
    added, multiplied = variance + part**2 * unit, factor * variance
    gain = np.sum(np.log(multiplied / added) + squared * (1.0 / multiplied - 1.0 / added))
    return part if gain > np.log(2 * problem.y.size) else None


def fit_poles(data: DqData, poles: np.ndarray, *, f1_hz: float, noise_floor: float) -> RationalModel:
    """Rational model with as many poles as are given, which are moved to where they fit best.

    Nothing is selected, pruned or mirrored, and residues keep their full rank: a description of the data, for
    interpolation, not a statement about the device.

    Parameters
    ----------
    data : DqData
        What `to_dq` gives.
    poles : (m,) complex
        First guess (rad/s), conjugates included or not.
    f1_hz : float
        Fundamental frequency (Hz).
    noise_floor : float
        As in `fit_response`.
    """
    problem = weighted(data, noise_floor)
    trial = refine(problem, vector_fit(problem, upper_half(poles), 1))
    return finished(problem, f1_hz, trial, (), whole_ranks=True)
