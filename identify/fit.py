"""A rational model of the 2x2 admittance: vector fitting in the dq frame, order by BIC, poles with errors.

In the dq frame the device is a real system, so coefficients are real, poles come in conjugate pairs and the
points below f1 fall onto those above it: ``Ydq(-j nu) = conj Ydq(j nu)``. All four elements share the poles;
residues have full rank while fitting and are cut to rank one where the second direction is noise. The constant
is there, and a term in s, only if the data ask for them.

The order is the one with the lowest BIC, residuals below a noise floor counting no further. Then what is
spurious goes, in this order, each step with a refit of the rest:

1. a pole that a single row asks for: with that row left out, the fit without the pole has the lower BIC;
2. a pole whose removal lowers the BIC, whichever half-plane it is in;
3. poles in the right half-plane without which the misfit stays below 1e-4 of Y;
4. outside the swept band, where the data may not tell -p from p, a pole in the right half-plane gives way to its
   stable mirror image if that fits as well.

All other poles in the right half-plane stay: the device may be unstable by itself. What was done is in the notes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .folded import ELEMENTS, DqData, to_dq
from .frames import dq_to_pn
from .response import FrequencyResponse

MIN_POINTS = 8
"""Fewest usable rows a model is made from."""

_FAR = 1.5  # a pole is outside the band beyond this multiple of the highest angular frequency
_NEAR = 1e-3  # poles closer than this, relatively, count as coinciding
_FAINT = 1e-4  # what a right-half-plane pole must contribute to Y to be believed
_OUTLIERS_PER_ROW = 10  # at most one row in ten may be left out as an outlier
_ALIKE = 40  # neighbouring rows taken to have the same noise, relative to Y, where the table does not tell
_FEIGNED = 18.0  # chi-squared that a pair of poles sought over the band gains from noise alone, on average
_LIGHT = 0.05  # damping ratio below which a doubtful sign of a pole is worth a note
_EXPLAINED = 1.5  # misfits up to this multiple of the given variances are left to a factor
_SEARCHED = 3  # weight of a pole's place in the BIC: with 1, one fit in 200 takes noise for a mode


class Rational(NamedTuple):
    """Poles (m,), residues (m, 2, 2), D and E (2, 2) of a rational function, as in `RationalModel`."""

    poles: np.ndarray
    residues: np.ndarray
    d: np.ndarray
    e: np.ndarray


@dataclass(frozen=True, slots=True)
class RationalModel:
    """Ydq(s) = sum_k R_k / (s - p_k) + D + s E, with real coefficients.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    poles : (m,) complex
        In rad/s, dq frame: real ones first, then the upper halves of the pairs, then their conjugates.
    residues : (m, 2, 2) complex
        In S rad/s, same order as ``poles``.
    d, e : (2, 2) float
        Constant (S) and slope (S s); zero unless the data ask for them.
    tail : 0, 1 or 2
        How many of the two are there: none, the constant, both.
    ranks : (m,) int
        Rank of each residue: 1 where the second direction is below its own uncertainty.
    bic : float
        Bayesian information criterion of the chosen order.
    residual : float
        Weighted root mean square misfit: in standard deviations where ``weighting`` is "covariance",
        else relative to ||Y||_F / 2 at each frequency.
    noise_floor : float
        Misfit below which a higher order no longer counts as better (relative).
    weighting : "covariance" or "relative"
        What the points were weighted with.
    nu_hz : (n,) float
        Frequencies that were fitted, |f - f1| (Hz).
    weight : (n, 4) float
        What dd, dq, qd, qq of every fitted row were weighted with (1/S).
    covariance_root : (k, k) float
        F with F F^T the covariance of the real parameters, in the order of `gradient`. A root, because neighbouring
        poles have parameters of which only combinations are known: multiply F first, square then.
    rival : Rational or None
        The fit with one pair more, which the data do not pay for. None where it gains no more than noise would give.
    rival_share : float
        Which part of the difference to the rival is taken as one more error of the model, as a standard deviation.
    pole_std : (m,) complex
        Standard errors of the poles, real part + 1j imaginary part (rad/s).
    notes : tuple of str
        What was decided on the way: poles mirrored, poles whose sign the data leave open.
    """

    f1_hz: float
    poles: np.ndarray
    residues: np.ndarray
    d: np.ndarray
    e: np.ndarray
    tail: int
    ranks: np.ndarray
    bic: float
    residual: float
    noise_floor: float
    weighting: str
    nu_hz: np.ndarray
    weight: np.ndarray
    covariance_root: np.ndarray
    rival: Rational | None
    rival_share: float
    pole_std: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.poles)

    @property
    def n_unstable(self) -> int:
        """Open-loop poles in the right half-plane, each counted with its rank."""
        return int(np.sum(self.ranks[self.poles.real > 0.0]))


def evaluate(model: RationalModel | Rational, s: np.ndarray) -> np.ndarray:
    """Ydq (n, 2, 2) in S at complex frequencies ``s`` (n,) in rad/s, dq frame."""
    s = np.atleast_1d(np.asarray(s, dtype=complex))
    strictly_proper = (1.0 / (s[:, None] - model.poles)) @ model.residues.reshape(-1, ELEMENTS)
    return strictly_proper.reshape(-1, 2, 2) + model.d + s[:, None, None] * model.e


def derivative(model: RationalModel, s: complex) -> np.ndarray:
    """dYdq/ds (2, 2) in S s at one complex frequency (rad/s)."""
    return np.tensordot(-1.0 / (s - model.poles) ** 2, model.residues, axes=1) + model.e


def evaluate_pn(model: RationalModel, f_hz: np.ndarray) -> np.ndarray:
    """Ypn (n, 2, 2) in S at signed frequencies (n,) in Hz: Ypn(s) = T Ydq(s - j w1) T^-1."""
    s = 2j * np.pi * (np.asarray(f_hz, dtype=float) - model.f1_hz)
    return dq_to_pn(evaluate(model, s))


def gradient(model: RationalModel, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Derivative of ``sum_ij weight_ij Ydq_ij(s)`` with respect to the real parameters, (n, k) complex.

    ``s`` is (n,) in rad/s, ``weight`` (n, 2, 2). The parameters are: real poles, real parts of the pairs, imaginary
    parts of the pairs; then for each element dd, dq, qd, qq its coefficients: real poles, Re and Im of the pairs'
    residues, D and E if they are there.
    """
    n_real, n_pair = _counts(model.poles)
    slopes = np.einsum("nij,kij->nk", weight, model.residues) / (s[:, None] - model.poles) ** 2
    upper, lower = slopes[:, n_real : n_real + n_pair], slopes[:, n_real + n_pair :]
    rows = _basis(s, model.poles[: n_real + n_pair], model.tail)
    coefficients = weight.reshape(-1, ELEMENTS, 1) * rows[:, None, :]
    by_pole = [slopes[:, :n_real], upper + lower, 1j * (upper - lower)]
    return np.concatenate([*by_pole, coefficients.reshape(len(s), -1)], axis=1)


def row_shares(model: RationalModel, g: np.ndarray) -> np.ndarray:
    """What every fitted row contributes to the variance of ``g @ parameters``: (n,), adding up to one.

    The noise is taken as the weights have it, uncorrelated between elements.
    """
    s = 2j * np.pi * model.nu_hz
    units = np.eye(ELEMENTS).reshape(ELEMENTS, 1, 2, 2)
    slopes = np.stack([gradient(model, s, np.broadcast_to(u, (len(s), 2, 2))) for u in units], axis=1)
    slopes = slopes * model.weight[:, :, None]
    jacobian = np.concatenate([slopes.real, slopes.imag], axis=1).reshape(-1, len(g))
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    lever = np.linalg.lstsq((jacobian / size).T, g / size, rcond=1e-12)[0]
    share = np.sum(lever.reshape(len(s), -1) ** 2, axis=1)
    return share / np.sum(share)


def spread(model: RationalModel, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """What the independent errors of the fit, each of unit variance, do to ``sum_ij weight_ij Ydq_ij(s)``: (n, k + 1).

    The covariance of such sums is that of the columns: ``spread @ spread.T`` for the real parts. ``s`` and ``weight``
    are those of `gradient`. The last error is the difference to the rival.
    """
    by_noise = gradient(model, s, weight) @ model.covariance_root
    if model.rival is None:
        return np.append(by_noise, np.zeros((len(s), 1)), axis=1)
    by_order = np.sum(weight * (evaluate(model.rival, s) - evaluate(model, s)), axis=(1, 2))
    return np.append(by_noise, model.rival_share * by_order[:, None], axis=1)


def shifted(model: RationalModel, errors: np.ndarray) -> Rational:
    """The model as it would be with the independent errors (k + 1,) of `spread`; equal to them to first order.

    Poles move by a factor and residues with their poles: far outside the band only R/|p| is well known, not R and p.
    """
    change = model.covariance_root @ errors[:-1]
    n_real, n_pair = _counts(model.poles)
    m = n_real + 2 * n_pair
    upper = _pairs_joined(change[:m], n_real, n_pair)
    moved = np.concatenate([upper, upper[n_real:].conj()])
    by_factor = np.abs(moved) < np.abs(model.poles)  # not a pole at zero
    relative = np.where(by_factor, moved, 0.0) / np.where(by_factor, model.poles, 1.0)
    residues, d, e = _parts(n_real, n_pair, model.tail, change[m:].reshape(ELEMENTS, -1))
    own = residues - model.residues * relative.real[:, None, None]
    poles = np.where(by_factor, model.poles * np.exp(relative), model.poles + moved)
    residues = (model.residues + own) * np.exp(relative.real)[:, None, None]
    near = Rational(poles, residues, model.d + d, model.e + e)
    return near if model.rival is None else _towards(near, model, model.rival, model.rival_share * float(errors[-1]))


def _towards(near: Rational, model: RationalModel, rival: Rational, part: float) -> Rational:
    """``near + part * (rival - model)``."""
    return Rational(
        np.concatenate([near.poles, model.poles, rival.poles]),
        np.concatenate([near.residues, -part * model.residues, part * rival.residues]),
        near.d + part * (rival.d - model.d),
        near.e + part * (rival.e - model.e),
    )


def fit_response(
    response: FrequencyResponse,
    *,
    max_order: int = 24,
    noise_floor: float = 1e-7,
    start: RationalModel | None = None,
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

    Returns
    -------
    RationalModel
        In the dq frame, load direction.

    Raises
    ------
    ValueError
        If fewer than `MIN_POINTS` usable rows are there.

    Notes
    -----
    Relaxed vector fitting with real coefficients, one set of poles; then variable projection (Gauss-Newton on the
    poles, residues eliminated), which also gives the covariance. The noise level is estimated from the misfit, so
    a covariance that is too small by a factor does no harm.
    """
    data = to_dq(response)
    if len(data.nu_hz) < MIN_POINTS:
        raise ValueError(
            f"{len(data.nu_hz)} of {len(response)} rows are usable; a rational model needs at least {MIN_POINTS}: "
            "sweep more frequencies, or repair the rows whose status is not 'ok'"
        )
    problem = _problem(data, noise_floor)
    max_order = min(max_order, (len(data.nu_hz) - 1) // 2)
    trial = _select_order(problem, max_order, start)
    part = _unexplained_part(problem, trial)
    if part is not None:
        problem = _problem(data, noise_floor, part)
        trial = _select_order(problem, max_order, start)
    trial = _refine(problem, trial)
    problem, trial, notes = _drop_outliers(problem, trial)
    trial = _prune(problem, trial)
    trial, removed = _drop_faint_instability(problem, trial)
    trial, mirrored = _settle_far_poles(problem, trial)
    return _model(problem, response.f1_hz, trial, notes + removed + mirrored)


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
    problem = _problem(data, noise_floor)
    trial = _refine(problem, _vector_fit(problem, _upper(poles), 1))
    return _model(problem, f1_hz, trial, (), whole_ranks=True)


class _Problem(NamedTuple):
    """Weighted data in one shape: s (n,) rad/s, y (4, n) S, weight (4, n), floor in units of the weighted misfit.

    ``noise`` (n, 8, 8) is the covariance of the weighted data over (re, im) of each element, to a factor; None where
    only the misfit can tell.
    """

    s: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    noise: np.ndarray | None
    floor: float
    weighting: str
    noise_floor: float


class _Trial(NamedTuple):
    """Poles (upper half, real ones first), the number of tail terms, the sum of squares and the BIC."""

    poles: np.ndarray
    tail: int
    cost: float
    bic: float


def _problem(data: DqData, noise_floor: float, part: float | None = None) -> _Problem:
    """Weights from the noise and, beside it, a ``part`` of Y (default: the noise floor) in every number."""
    part = noise_floor if part is None else part
    size = np.linalg.norm(data.y, axis=(1, 2)) / 2.0
    s = 2j * np.pi * data.nu_hz
    y = data.y.reshape(-1, ELEMENTS).T
    if data.std is None:
        weight = np.broadcast_to(1.0 / size, y.shape)
        return _Problem(s, y, weight, None, noise_floor, "relative", noise_floor)
    weight = 1.0 / np.hypot(data.std.reshape(-1, ELEMENTS).T, part * size)
    by_row = np.repeat(weight.T, 2, axis=1)
    own = np.repeat(data.std.reshape(-1, ELEMENTS) ** 2, 2, axis=1)[:, :, None] * np.eye(2 * ELEMENTS)
    noise = own if data.covariance is None else data.covariance
    noise = noise + (part * size)[:, None, None] ** 2 * np.eye(2 * ELEMENTS)
    noise = noise * by_row[:, :, None] * by_row[:, None, :]
    floor = float(np.sqrt(np.mean((noise_floor * size * weight) ** 2)))
    return _Problem(s, y, weight, noise, floor, "covariance", noise_floor)


def _unexplained_part(problem: _Problem, trial: _Trial) -> float | None:
    """The part of Y that the misfit has beyond its covariances; None if a factor on them describes it as well.

    A model never fits to better than some part of Y, but covariances may say that some rows are known far better.
    Compared are two variances of the misfit, v the given one and u = size^2: factor * v, and v + part^2 * u.
    """
    if problem.noise is None:
        return None
    n = len(problem.s)
    misfit = _linear(problem, trial.poles, trial.tail).misfit
    used = (_order(trial.poles) + ELEMENTS * (_order(trial.poles) + trial.tail)) / misfit.size
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


# Order ---------------------------------------------------------------------------------------------------------


def _select_order(problem: _Problem, max_order: int, start: RationalModel | None) -> _Trial:
    """Grow by a pair where the misfit is largest until two pairs in a row do not pay."""
    poles = _first_poles(problem) if start is None else _upper(start.poles)
    tail = 1 if start is None else start.tail
    best = trial = _vector_fit(problem, poles, tail)
    misses = 0
    while misses < 2 and _order(trial.poles) + 2 <= max_order and trial.cost > _floor_cost(problem):
        trial = _vector_fit(problem, _with_pair(problem, trial), tail)
        misses = 0 if trial.bic < best.bic else misses + 1
        best = min(best, trial, key=lambda t: t.bic)
    return best


def _prune(problem: _Problem, trial: _Trial) -> _Trial:
    """Take away, one by one, what the data do not pay for: a pole or pair, a tail term, a far pole for a slope."""
    while True:
        reduced = [_trial(problem, poles, tail) for poles, tail in _reductions(problem, trial)]
        if not reduced:
            return trial
        candidate = _refine(problem, min(reduced, key=lambda t: t.bic))
        if candidate.bic >= trial.bic:
            return trial
        trial = candidate


def _reductions(problem: _Problem, trial: _Trial) -> list[tuple[np.ndarray, int]]:
    n = len(trial.poles)
    found = [(np.delete(trial.poles, k), trial.tail) for k in range(n)]
    if trial.tail > 0 and n > 0:
        found.append((trial.poles, trial.tail - 1))
    far = np.flatnonzero(_is_far(problem, trial.poles) & (trial.tail == 1))
    return found + [(np.delete(trial.poles, k), 2) for k in far]


def _drop_outliers(problem: _Problem, trial: _Trial) -> tuple[_Problem, _Trial, tuple[str, ...]]:
    """Leave out rows that ask for a pole of their own, narrower than the distance of the rows, and that pole."""
    notes: tuple[str, ...] = ()
    for _ in range(len(problem.s) // _OUTLIERS_PER_ROW):
        tried = [_without_row(problem, trial, k) for k in _narrow(problem, trial.poles)]
        found = [(p, t) for p, t, pays in tried if pays]
        if not found:
            break
        kept, trial = min(found, key=lambda pt: pt[1].bic)
        nu = np.setdiff1d(problem.s.imag, kept.s.imag)[0] / (2.0 * np.pi)
        notes += (f"the row at |f - f1| = {nu:.4g} Hz does not agree with its neighbours and was left out of the fit",)
        problem = kept
    return problem, trial, notes


def _narrow(problem: _Problem, poles: np.ndarray) -> np.ndarray:
    """Indices of pairs inside the band whose width is below the distance of the rows around them."""
    w = problem.s.imag
    above = np.clip(np.searchsorted(w, poles.imag), 1, len(w) - 1)
    inside = (poles.imag >= w[0]) & (poles.imag <= w[-1])
    return np.flatnonzero(inside & (np.abs(poles.real) < w[above] - w[above - 1]))


def _without_row(problem: _Problem, trial: _Trial, k: int) -> tuple[_Problem, _Trial, bool]:
    """Pole k and the row next to it left out; whether the other rows do not miss the pole, and the row stands apart."""
    row = int(np.argmin(np.abs(problem.s.imag - trial.poles[k].imag)))
    rest = problem._replace(
        s=np.delete(problem.s, row),
        y=np.delete(problem.y, row, axis=1),
        weight=np.delete(problem.weight, row, axis=1),
        noise=None if problem.noise is None else np.delete(problem.noise, row, axis=0),
    )
    with_pole = _refine(rest, _trial(rest, trial.poles, trial.tail))
    without = _refine(rest, _trial(rest, np.delete(trial.poles, k), trial.tail))
    coefficients = _linear(rest, without.poles, without.tail).coefficients
    expected = coefficients @ _basis(problem.s[row : row + 1], without.poles, without.tail)[0]
    apart = np.linalg.norm(problem.y[:, row] - expected) > _FAINT * np.linalg.norm(problem.y[:, row])
    return rest, without, bool(apart and without.bic < with_pole.bic)


def _drop_faint_instability(problem: _Problem, trial: _Trial) -> tuple[_Trial, tuple[str, ...]]:
    """Remove poles in the right half-plane that Y does not need to 1e-4: errors of the sweep ask for them."""
    stable = trial
    while np.any(stable.poles.real > 0.0):
        kept = stable.poles[stable.poles.real <= 0.0]
        stable = _refine(problem, _trial(problem, kept, trial.tail), n_iterations=30)
    n_left_out = _order(trial.poles) - _order(stable.poles)
    if n_left_out == 0 or _relative_misfit(problem, stable) > _FAINT:
        return trial, ()
    note = f"{n_left_out} faint poles, unstable ones among them, left out of the fit: it still matches Y to {_FAINT:g}"
    return stable, (note,)


def _relative_misfit(problem: _Problem, trial: _Trial) -> float:
    """Root mean square misfit relative to ||Y||_F / 2 at each frequency, whatever the weights."""
    n = len(problem.s)
    misfit = _linear(problem, trial.poles, trial.tail).misfit
    absolute = (misfit[:, :n] ** 2 + misfit[:, n:] ** 2) / problem.weight**2
    size = np.sum(np.abs(problem.y) ** 2, axis=0) / ELEMENTS
    return float(np.sqrt(np.mean(absolute / size) / 2.0))


def _settle_far_poles(problem: _Problem, trial: _Trial) -> tuple[_Trial, tuple[str, ...]]:
    """Mirror right-half-plane poles outside the band, or trade them for a slope, where the fit does not suffer."""
    notes = []
    for pole in trial.poles[_is_far(problem, trial.poles) & (trial.poles.real > 0.0)]:
        k = int(np.argmin(np.abs(trial.poles - pole)))
        mirrored = trial.poles.copy()
        mirrored[k] = -pole.conjugate()
        options = [_refine(problem, _trial(problem, mirrored, trial.tail))]
        options.append(_refine(problem, _trial(problem, np.delete(trial.poles, k), 2)))
        settled = [t for t in options if not np.any(_is_far(problem, t.poles) & (t.poles.real > 0.0))]
        best = min(settled, key=lambda t: t.bic, default=trial)
        if best is not trial and best.bic <= trial.bic + np.log(2 * problem.y.size):
            trial = best
            notes.append(
                f"a pole fitted at {pole.real:+.3g} rad/s, outside the swept band, was taken as stable: "
                "the data fit the stable one as well"
            )
    return trial, tuple(notes)


def _is_far(problem: _Problem, poles: np.ndarray) -> np.ndarray:
    """(m,) bool: outside the swept band."""
    return np.abs(poles) > _FAR * abs(problem.s[-1])


def _floor_cost(problem: _Problem) -> float:
    return 2 * problem.y.size * problem.floor**2


def _bic(problem: _Problem, cost: float, n_poles: int, tail: int) -> float:
    """N ln(misfit^2 + floor^2) + parameters ln N; a pole's place, sought over the whole band, counts threefold."""
    n = 2 * problem.y.size
    parameters = _SEARCHED * n_poles + ELEMENTS * (n_poles + tail)
    return n * float(np.log(cost / n + problem.floor**2)) + parameters * float(np.log(n))


def _trial(problem: _Problem, poles: np.ndarray, tail: int) -> _Trial:
    cost = _linear(problem, poles, tail).cost
    return _Trial(poles, tail, cost, _bic(problem, cost, _order(poles), tail))


def _first_poles(problem: _Problem) -> np.ndarray:
    """Three weakly damped pairs over the band and a real pole beyond its end."""
    low, high = np.log10(max(abs(problem.s[0]), 1e-3 * abs(problem.s[-1]))), np.log10(abs(problem.s[-1]))
    beta = np.logspace(low, high, 5)[1:4]
    return np.concatenate([[-3.0 * abs(problem.s[-1]) + 0j], beta * (-0.1 + 1j)])


def _with_pair(problem: _Problem, trial: _Trial) -> np.ndarray:
    """The trial's poles and a weakly damped pair at the frequency of the largest misfit."""
    misfit = np.abs(_linear(problem, trial.poles, trial.tail).misfit)
    n = len(problem.s)
    by_line = np.sum(misfit[:, :n] ** 2 + misfit[:, n:] ** 2, axis=0)
    beta = abs(problem.s[int(np.argmax(by_line))])
    return np.append(trial.poles, beta * (-0.1 + 1j))


# Vector fitting ------------------------------------------------------------------------------------------------


def _vector_fit(problem: _Problem, poles: np.ndarray, tail: int, n_iterations: int = 12) -> _Trial:
    """Relocate poles until they rest; the best iterate counts, because noise lets them wander."""
    best = _trial(problem, poles, tail)
    for _ in range(n_iterations):
        moved = _relocate(problem, poles, tail)
        if moved is None:
            break
        trial = _trial(problem, moved, tail)
        gain = best.cost - trial.cost
        best = min(best, trial, key=lambda t: t.cost)
        if abs(gain) < 1e-3 * best.cost or best.cost < _floor_cost(problem):
            break
        poles = moved
    return best


def _relocate(problem: _Problem, poles: np.ndarray, tail: int) -> np.ndarray | None:
    """One step of relaxed vector fitting: the zeros of sigma(s) = d + sum c_k phi_k(s) are the new poles."""
    phi = _basis(problem.s, poles, tail)
    m = _order(poles)
    sigma = np.append(phi[:, :m], np.ones((len(problem.s), 1)), axis=1)
    block = (
        np.concatenate([np.broadcast_to(phi, (ELEMENTS, *phi.shape)), -problem.y[:, :, None] * sigma], axis=2)
        * problem.weight[:, :, None]
    )
    factor = np.asarray(np.linalg.qr(_stack(block), mode="r"))
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
    return _upper(np.linalg.eigvals(a - np.outer(b, c[:m]) / c[-1]))


def _realisation(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real (A, b) whose (sI - A)^-1 b are the basis functions of `_basis`."""
    n_real, n_pair = _counts_upper(poles)
    pairs = poles[n_real:]
    a = np.diag(np.concatenate([poles.real, pairs.real]))
    i, j = n_real + np.arange(n_pair), n_real + n_pair + np.arange(n_pair)
    a[i, j], a[j, i] = pairs.imag, -pairs.imag
    return a, np.concatenate([np.ones(n_real), np.full(n_pair, 2.0), np.zeros(n_pair)])


def _basis(s: np.ndarray, poles: np.ndarray, tail: int) -> np.ndarray:
    """(n, order + tail) real-coefficient partial fractions, then the constant, then s."""
    n_real, _ = _counts_upper(poles)
    upper = 1.0 / (s[:, None] - poles)
    lower = 1.0 / (s[:, None] - poles[n_real:].conj())
    pairs = upper[:, n_real:]
    powers = s[:, None] ** np.arange(tail)
    return np.concatenate([upper[:, :n_real], pairs + lower, 1j * (pairs - lower), powers], axis=1)


# Linear and nonlinear least squares ------------------------------------------------------------------------------


class _Linear(NamedTuple):
    """Residues for given poles: coefficients (4, c), misfit (4, 2n), and the factors Q (4, 2n, c), R, column norms."""

    coefficients: np.ndarray
    misfit: np.ndarray
    q: np.ndarray
    r: np.ndarray
    norm: np.ndarray
    cost: float


def _linear(problem: _Problem, poles: np.ndarray, tail: int) -> _Linear:
    phi = _basis(problem.s, poles, tail)
    columns = _stack(phi[None] * problem.weight[:, :, None])
    norm = np.linalg.norm(columns, axis=1)
    q, r = np.linalg.qr(columns / norm[:, None, :])
    target = _stack((problem.y * problem.weight)[:, :, None])[:, :, 0]
    projected = np.einsum("eij,ei->ej", q, target)
    misfit = target - np.einsum("eij,ej->ei", q, projected)
    coefficients = np.linalg.solve(_regular(r), projected[:, :, None])[:, :, 0] / norm
    return _Linear(coefficients, misfit, q, r, norm, float(np.sum(misfit**2)))


def _regular(r: np.ndarray) -> np.ndarray:
    """R with exact zeros on its diagonal lifted, so that coinciding poles do not raise."""
    r = r.copy()
    diagonal = np.einsum("eii->ei", r)
    diagonal[np.abs(diagonal) < 1e-15] = 1e-15
    return r


def _refine(problem: _Problem, trial: _Trial, n_iterations: int = 10) -> _Trial:
    """Levenberg-Marquardt on the poles with the residues projected out (Kaufman's variable projection)."""
    damping = 1e-6
    linear = _linear(problem, trial.poles, trial.tail)
    for _ in range(n_iterations):
        if linear.cost < _floor_cost(problem):
            break
        jacobian = _projected_jacobian(problem, trial, linear)[0]
        size = np.linalg.norm(jacobian, axis=0)
        size[size == 0.0] = 1.0
        u, singular, vt = np.linalg.svd(jacobian / size, full_matrices=False)
        projected = u.T @ linear.misfit.ravel()
        for _ in range(6):
            step = vt.T @ (singular / (singular**2 + damping) * projected) / size
            poles = _moved(trial.poles, step)
            moved = _linear(problem, poles, trial.tail)
            if moved.cost < linear.cost:
                break
            damping *= 30.0
        else:
            break
        gain = linear.cost - moved.cost
        trial, linear, damping = trial._replace(poles=poles), moved, max(damping / 30.0, 1e-12)
        if gain < 1e-7 * linear.cost:
            break
    return trial._replace(cost=linear.cost, bic=_bic(problem, linear.cost, _order(trial.poles), trial.tail))


def _moved(poles: np.ndarray, step: np.ndarray) -> np.ndarray:
    n_real, n_pair = _counts_upper(poles)
    moved = poles + _pairs_joined(step, n_real, n_pair)
    return _separated(np.where(poles.imag == 0.0, moved.real + 0j, moved))


def _pairs_joined(step: np.ndarray, n_real: int, n_pair: int) -> np.ndarray:
    """Real parameters of poles as complex numbers: the real ones, then the upper halves of the pairs."""
    return np.concatenate([step[:n_real], step[n_real : n_real + n_pair] + 1j * step[n_real + n_pair :]])


def _separated(poles: np.ndarray) -> np.ndarray:
    """A pair meeting on the real axis becomes two real poles, two equal real poles a pair: no residue explodes."""
    real = np.sort(poles[poles.imag == 0.0].real)
    pairs = poles[poles.imag != 0.0]
    meeting = np.abs(pairs.imag) < _NEAR * np.abs(pairs)
    apart = np.abs(pairs[meeting]) * _NEAR
    close = np.flatnonzero(np.diff(real) < _NEAR * np.abs(real[1:]))[:1]
    middle = (real[close] + real[close + 1]) / 2.0
    kept = np.delete(real, np.concatenate([close, close + 1]))
    pairs = np.concatenate([pairs[~meeting], middle + 2j * _NEAR * np.abs(middle)])
    met = poles[poles.imag != 0.0][meeting].real
    real = np.concatenate([kept, met - apart, met + apart])
    return np.concatenate([real + 0j, pairs.real + 1j * np.abs(pairs.imag)])


def _projected_jacobian(problem: _Problem, trial: _Trial, linear: _Linear) -> tuple[np.ndarray, np.ndarray]:
    """d(model)/d(pole parameters) outside the span of the basis (4 * 2n, t), and inside it, Q^T J (4, c, t)."""
    n_real, n_pair = _counts_upper(trial.poles)
    x = linear.coefficients
    m = n_real + 2 * n_pair
    pair = x[:, n_real : n_real + n_pair] + 1j * x[:, n_real + n_pair : m]
    upper = 1.0 / (problem.s[:, None] - trial.poles) ** 2
    lower = 1.0 / (problem.s[:, None] - trial.poles[n_real:].conj()) ** 2
    real = x[:, None, :n_real] * upper[None, :, :n_real]
    up, low = pair[:, None] * upper[None, :, n_real:], pair.conj()[:, None] * lower[None]
    full = _stack(np.concatenate([real, up + low, 1j * (up - low)], axis=2) * problem.weight[:, :, None])
    inside = np.swapaxes(linear.q, 1, 2) @ full
    return (full - linear.q @ inside).reshape(linear.misfit.size, m), inside


# The finished model ------------------------------------------------------------------------------------------------


def _model(
    problem: _Problem, f1_hz: float, trial: _Trial, notes: tuple[str, ...], whole_ranks: bool = False
) -> RationalModel:
    linear = _linear(problem, trial.poles, trial.tail)
    cut = _uncut(trial, linear) if whole_ranks else _cut_ranks(problem, trial, linear)
    n_real, n_pair = _counts_upper(trial.poles)
    residues, d, e = _parts(n_real, n_pair, trial.tail, cut.coefficients)
    m = n_real + 2 * n_pair
    root = _covariance_root(problem, trial, linear)
    root[m:] = cut.kept @ root[m:]
    rival, rival_share = (None, 0.0) if whole_ranks else _rival(problem, trial)
    std = np.linalg.norm(root[:m], axis=1)
    pair_std = std[n_real : n_real + n_pair] + 1j * std[n_real + n_pair :]
    model = RationalModel(
        f1_hz=f1_hz,
        poles=np.concatenate([trial.poles, trial.poles[n_real:].conj()]),
        residues=_truncated(residues, cut.ranks),
        d=d,
        e=e,
        tail=trial.tail,
        ranks=cut.ranks,
        bic=trial.bic,
        residual=float(np.sqrt(linear.cost / linear.misfit.size)),
        noise_floor=problem.noise_floor,
        weighting=problem.weighting,
        nu_hz=problem.s.imag / (2.0 * np.pi),
        weight=problem.weight.T,
        covariance_root=root,
        rival=rival,
        rival_share=rival_share,
        pole_std=np.concatenate([std[:n_real].astype(complex), pair_std, pair_std]),
        notes=notes,
    )
    return _with_sign_notes(model)


def _rival(problem: _Problem, trial: _Trial) -> tuple[Rational | None, float]:
    """The fit with one pair more, and the share of its difference that counts as an error.

    A mode just too faint to pay is no noise: left out, it moves the others. The squared share is the part of the
    rival's gain in chi-squared that noise does not explain (the positive-part estimate of James and Stein).
    """
    room = _order(trial.poles) + 2 <= (len(problem.s) - 1) // 2
    if trial.cost < 4.0 * _floor_cost(problem) or not room:
        return None, 0.0
    more = _vector_fit(problem, _with_pair(problem, trial), trial.tail, n_iterations=4)
    more = _refine(problem, more, n_iterations=3)
    n_real, n_pair = _counts_upper(more.poles)
    linear = _linear(problem, more.poles, more.tail)
    gain = (trial.cost - more.cost) / _variance(problem, more, linear)
    if gain <= _FEIGNED:
        return None, 0.0
    residues, d, e = _parts(n_real, n_pair, more.tail, linear.coefficients)
    rival = Rational(np.concatenate([more.poles, more.poles[n_real:].conj()]), residues, d, e)
    return rival, float(np.sqrt(1.0 - _FEIGNED / gain))


def _parts(n_real: int, n_pair: int, tail: int, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residues (m, 2, 2), D and E (2, 2) from the coefficients (4, c)."""
    m = n_real + 2 * n_pair
    x = coefficients.T.reshape(-1, 2, 2)
    pair = x[n_real : n_real + n_pair] + 1j * x[n_real + n_pair : m]
    ends = np.concatenate([x[m:], np.zeros((2 - tail, 2, 2))])
    return np.concatenate([x[:n_real].astype(complex), pair, pair.conj()]), ends[0], ends[1]


def _variance(problem: _Problem, trial: _Trial, linear: _Linear) -> float:
    """Variance of a weighted datum, from the misfit."""
    freedom = linear.misfit.size - _order(trial.poles) - linear.coefficients.size
    return max(linear.cost / max(freedom, 1), (1e-3 * problem.floor) ** 2)


def _inverse_r(linear: _Linear) -> np.ndarray:
    """(4, c, c) whose products with their transposes are the coefficients' covariance for given poles."""
    return np.linalg.inv(_regular(linear.r)) / linear.norm[:, :, None]


def _covariance_root(problem: _Problem, trial: _Trial, linear: _Linear) -> np.ndarray:
    """Root of the covariance of poles and coefficients: their least squares' response to the noise of the data.

    Weights need not be those of the noise, and noise is correlated between elements: the error is R^-1 Q^T noise, and
    its covariance R^-1 (Q^T cov Q) R^-T.
    """
    jacobian, inside = _projected_jacobian(problem, trial, linear)
    m, c = jacobian.shape[1], linear.r.shape[1]
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    u, singular, vh = np.linalg.svd(jacobian / size, full_matrices=False)
    poles = vh.T / np.maximum(singular, 1e-13 * singular.max(initial=0.0)) / size[:, None]
    r_inverse = _inverse_r(linear)
    root = np.zeros((m + ELEMENTS * c,) * 2)
    root[:m, :m] = poles
    root[m:, :m] = -(r_inverse @ (inside @ poles)).reshape(ELEMENTS * c, m)
    root[m:, m:] = _block_diagonal(r_inverse)
    directions = np.concatenate([u.reshape(*linear.misfit.shape, m), _block_columns(linear.q)], axis=2)
    return root @ _noise_root(problem, linear, directions)


def _noise_root(problem: _Problem, linear: _Linear, directions: np.ndarray) -> np.ndarray:
    """Root (k, k) of the covariance of the noise along orthonormal ``directions`` (4, 2n, k)."""
    n, k = len(problem.s), directions.shape[2]
    by_row = directions.reshape(ELEMENTS, 2, n, k).transpose(2, 0, 1, 3).reshape(n, 2 * ELEMENTS, k)
    if problem.noise is None:
        noise = _noise_of_misfit(linear, by_row)
    else:
        noise = _noise_of_table(problem.noise, linear, by_row)
    spread = np.tensordot(by_row, noise @ by_row, axes=([0, 1], [0, 1]))
    variance, axes = np.linalg.eigh(spread)
    return axes * np.sqrt(np.maximum(variance, (1e-3 * problem.floor) ** 2))


def _noise_of_table(noise: np.ndarray, linear: _Linear, by_row: np.ndarray) -> np.ndarray:
    """(n, 8, 8): the table's covariances, scaled so that they explain the misfit."""
    left = np.einsum("nii->", noise) - np.sum(by_row * (noise @ by_row))
    return noise * (linear.cost / left)


def _noise_of_misfit(linear: _Linear, by_row: np.ndarray) -> np.ndarray:
    """(n, 8, 8): the misfit's own covariance, averaged over neighbouring rows; what the fit took is given back."""
    n = len(by_row)
    taken = np.minimum(np.sum(by_row**2, axis=2), 0.9)
    misfit = linear.misfit.reshape(ELEMENTS, 2, n).transpose(2, 0, 1).reshape(n, -1) / np.sqrt(1.0 - taken)
    total = np.concatenate([np.zeros((1, 8, 8)), np.cumsum(misfit[:, :, None] * misfit[:, None, :], axis=0)])
    half = min(_ALIKE, n) // 2
    first = np.clip(np.arange(n) - half, 0, n - 2 * half)
    return (total[first + 2 * half] - total[first]) / (2 * half)


def _block_columns(blocks: np.ndarray) -> np.ndarray:
    """(4, n, c) to (4, n, 4 c): block e in columns of its own."""
    e, n, c = blocks.shape
    full = np.zeros((e, n, e, c))
    full[np.arange(e), :, np.arange(e), :] = blocks
    return full.reshape(e, n, e * c)


# The rank of the residues ------------------------------------------------------------------------------------------


class _Cut(NamedTuple):
    """Coefficients (4, c) with some residues made singular, the ranks (m,), and what was kept of a change (4c, 4c)."""

    coefficients: np.ndarray
    ranks: np.ndarray
    kept: np.ndarray


def _uncut(trial: _Trial, linear: _Linear) -> _Cut:
    return _Cut(linear.coefficients, np.full(_order(trial.poles), 2), np.eye(linear.coefficients.size))


def _cut_ranks(problem: _Problem, trial: _Trial, linear: _Linear) -> _Cut:
    """Rank one, one residue after the other, while losing the second direction costs less than its BIC penalty.

    The direction is held at zero and all other coefficients are fitted again, poles fixed: a plain conditional least
    squares, so that residues of neighbouring poles, which only their sum is known of, are not cut one by one.
    """
    n_real, n_pair = _counts_upper(trial.poles)
    r_inverse = _inverse_r(linear)
    covariance = _variance(problem, trial, linear) * _block_diagonal(r_inverse @ np.swapaxes(r_inverse, 1, 2))
    x = linear.coefficients.ravel()
    kept = np.eye(len(x))
    open_ones = set(range(n_real + n_pair))
    penalty = float(np.log(2 * problem.y.size))
    while open_ones:
        weights = {k: _second_direction(trial, x.reshape(ELEMENTS, -1), k) for k in open_ones}
        price = {k: _price(w, x, covariance) / len(w) for k, w in weights.items()}
        k = min(price, key=lambda at: price[at])
        if price[k] > penalty:
            break
        w = weights[k]
        lever = np.linalg.solve(w @ covariance @ w.T, w @ covariance).T
        x, covariance = x - lever @ (w @ x), covariance - lever @ (w @ covariance)
        kept -= lever @ (w @ kept)
        open_ones.remove(k)
    ranks = np.array([2 if k in open_ones else 1 for k in range(n_real + n_pair)], dtype=int)
    return _Cut(x.reshape(ELEMENTS, -1), np.append(ranks, ranks[n_real:]), kept)


def _second_direction(trial: _Trial, coefficients: np.ndarray, k: int) -> np.ndarray:
    """Rows (1 or 2, 4c) that read Re and Im of the second singular direction of residue k."""
    n_real, n_pair = _counts_upper(trial.poles)
    u, _, vh = np.linalg.svd(_parts(n_real, n_pair, trial.tail, coefficients)[0][k])
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


def _truncated(residues: np.ndarray, ranks: np.ndarray) -> np.ndarray:
    """Residues with the second singular value set to zero where the rank is one."""
    u, singular, vh = np.linalg.svd(residues)
    singular[ranks == 1, 1] = 0.0
    return (u * singular[:, None, :]) @ vh


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """(4, c, c) to (4c, 4c)."""
    n, c = blocks.shape[:2]
    full = np.zeros((n, c, n, c))
    full[np.arange(n), :, np.arange(n), :] = blocks
    return full.reshape(n * c, n * c)


def _with_sign_notes(model: RationalModel) -> RationalModel:
    """Note every pole in the right half-plane, and every lightly damped one whose half-plane the data leave open."""
    noted = []
    for pole, std in zip(model.poles, model.pole_std, strict=True):
        text = f"{pole.real:+.3g} +- {std.real:.2g} rad/s, {abs(pole.imag) / (2.0 * np.pi):.3g} Hz (dq)"
        unswept = abs(pole) < 2.0 * np.pi * model.nu_hz[0]
        is_open = abs(pole.real) < min(2.0 * std.real, _LIGHT * abs(pole)) or (pole.real > 0.0 and unswept)
        if pole.imag >= 0.0 and is_open:
            noted.append(f"the half-plane of the device's own pole at {text} is not decided by the data")
        elif pole.imag >= 0.0 and pole.real > 0.0:
            noted.append(f"the device is unstable on an ideal source: it has a pole of its own at {text}")
    return replace(model, notes=(*model.notes, *noted))


# Small things ------------------------------------------------------------------------------------------------------


def _upper(poles: np.ndarray) -> np.ndarray:
    """Real poles, then the upper halves of the pairs, kept apart from each other."""
    real = np.abs(poles.imag) <= 1e-9 * np.abs(poles)
    return _separated(np.concatenate([poles[real].real + 0j, poles[~real & (poles.imag > 0.0)]]))


def _counts_upper(poles: np.ndarray) -> tuple[int, int]:
    n_real = int(np.sum(poles.imag == 0.0))
    return n_real, len(poles) - n_real


def _counts(poles: np.ndarray) -> tuple[int, int]:
    n_real = int(np.sum(poles.imag == 0.0))
    return n_real, (len(poles) - n_real) // 2


def _order(poles: np.ndarray) -> int:
    n_real, n_pair = _counts_upper(poles)
    return n_real + 2 * n_pair


def _stack(block: np.ndarray) -> np.ndarray:
    """(4, n, c) complex to (4, 2n, c) real: real parts above imaginary parts."""
    return np.concatenate([block.real, block.imag], axis=1)
