"""A rational model of the 2x2 admittance: vector fitting in the dq frame, order by BIC, poles with errors.

In the dq frame the device is a real system, so coefficients are real, poles come in conjugate pairs and the
points below f1 fall onto those above it: ``Ydq(-j nu) = conj Ydq(j nu)``. All four elements share the poles;
residues have full rank while fitting and are cut to rank one where the second direction is noise.

The order is the one with the lowest BIC, residuals below a noise floor counting no further. A pole stays only
if the data pay for it: whatever can be removed and refitted at a lower BIC goes, whichever half-plane it is in.
Poles in the right half-plane are otherwise kept: the device may be unstable by itself. Only outside the swept
band, where the data may not tell -p from p, the stable mirror image is taken if it fits as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .response import FrequencyResponse

T_PN = np.array([[1.0, 1j], [1.0, -1j]])
"""(d, q) to (positive sequence, conjugate of the mirror)."""

MIN_POINTS = 8
"""Fewest usable rows a model is made from."""

_ELEMENTS = 4
_FAR = 1.5  # a pole is outside the band beyond this multiple of the highest angular frequency
_SEARCHED = 3  # weight of a pole's place in the BIC: with 1, one fit in 200 takes noise for a mode


class DqData(NamedTuple):
    """Usable rows in the dq frame, folded to positive frequency.

    Attributes
    ----------
    nu_hz : (n,) float
        Frequency seen from the rotating frame, |f - f1| (Hz), ascending.
    y : (n, 2, 2) complex
        Admittance in the dq frame (S).
    std : (n, 2, 2) float or None
        Standard deviation of the real and of the imaginary part (S); None if no row has a covariance.
    """

    nu_hz: np.ndarray
    y: np.ndarray
    std: np.ndarray | None


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
        Constant (S) and slope (S s); the slope is zero unless the data ask for it.
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
    covariance : (k, k) float
        Covariance of the real parameters, in the order of `gradient`.
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
    ranks: np.ndarray
    bic: float
    residual: float
    noise_floor: float
    weighting: str
    nu_hz: np.ndarray
    covariance: np.ndarray
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


def evaluate(model: RationalModel, s: np.ndarray) -> np.ndarray:
    """Ydq (n, 2, 2) in S at complex frequencies ``s`` (n,) in rad/s, dq frame."""
    s = np.atleast_1d(np.asarray(s, dtype=complex))
    strictly_proper = (1.0 / (s[:, None] - model.poles)) @ model.residues.reshape(-1, _ELEMENTS)
    return strictly_proper.reshape(-1, 2, 2) + model.d + s[:, None, None] * model.e


def derivative(model: RationalModel, s: complex) -> np.ndarray:
    """dYdq/ds (2, 2) in S s at one complex frequency (rad/s)."""
    return np.tensordot(-1.0 / (s - model.poles) ** 2, model.residues, axes=1) + model.e


def evaluate_pn(model: RationalModel, f_hz: np.ndarray) -> np.ndarray:
    """Ypn (n, 2, 2) in S at signed frequencies (n,) in Hz: Ypn(s) = T Ydq(s - j w1) T^-1."""
    s = 2j * np.pi * (np.asarray(f_hz, dtype=float) - model.f1_hz)
    return T_PN @ evaluate(model, s) @ np.linalg.inv(T_PN)


def gradient(model: RationalModel, s: complex, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Derivative of ``left @ Ydq(s) @ right`` with respect to the real parameters, (k,) complex.

    The order is: real poles, real parts of the pairs, imaginary parts of the pairs; then for each element
    dd, dq, qd, qq its coefficients: real poles, Re and Im of the pairs' residues, D, and E if there is one.
    """
    n_real, n_pair = _counts(model.poles)
    slopes = np.einsum("i,kij,j->k", left, model.residues, right) / (s - model.poles) ** 2
    upper, lower = slopes[n_real : n_real + n_pair], slopes[n_real + n_pair :]
    by_pole = np.concatenate([slopes[:n_real], upper + lower, 1j * (upper - lower)])
    row = _basis(np.array([s]), model.poles[: n_real + n_pair], bool(np.any(model.e)))[0]
    return np.concatenate([by_pole, np.kron(np.kron(left, right), row)])


def to_dq(response: FrequencyResponse) -> DqData:
    """Rows with status "ok" and finite values, in the dq frame at nu > 0; rows at f1 itself are left out."""
    usable = response.ok & np.isfinite(response.y).all(axis=(1, 2))
    y, nu_hz = response.y[usable], response.f_hz[usable]
    covariance = np.asarray(response.covariance)[usable]
    if response.frame == "pn":
        nu_hz = nu_hz - response.f1_hz
        y = np.linalg.inv(T_PN) @ y @ T_PN
        turn = _real_form(np.kron(np.linalg.inv(T_PN), T_PN.T))
        covariance = turn @ covariance @ turn.T
    y = np.where(nu_hz[:, None, None] < 0.0, y.conj(), y)
    ascending = np.argsort(np.abs(nu_hz), kind="stable")
    ascending = ascending[nu_hz[ascending] != 0.0]
    return DqData(np.abs(nu_hz)[ascending], y[ascending], _standard_deviations(y, covariance, ascending))


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
    trial = _prune(problem, _refine(problem, trial))
    trial, notes = _settle_far_poles(problem, trial)
    return _model(problem, data, response.f1_hz, trial, notes)


class _Problem(NamedTuple):
    """Weighted data in one shape: s (n,) rad/s, y (4, n) S, weight (4, n), floor in units of the weighted misfit."""

    s: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    floor: float
    weighting: str
    noise_floor: float


class _Trial(NamedTuple):
    """Poles (upper half, real ones first), the slope switch, the sum of squares and the BIC."""

    poles: np.ndarray
    slope: bool
    cost: float
    bic: float


def _problem(data: DqData, noise_floor: float) -> _Problem:
    size = np.linalg.norm(data.y, axis=(1, 2)) / 2.0
    s = 2j * np.pi * data.nu_hz
    y = data.y.reshape(-1, _ELEMENTS).T
    if data.std is None:
        weight = np.broadcast_to(1.0 / size, y.shape)
        return _Problem(s, y, weight, noise_floor, "relative", noise_floor)
    std = np.maximum(data.std.reshape(-1, _ELEMENTS).T, noise_floor * size)
    floor = float(np.sqrt(np.mean((noise_floor * size / std) ** 2)))
    return _Problem(s, y, 1.0 / std, floor, "covariance", noise_floor)


# Order ---------------------------------------------------------------------------------------------------------


def _select_order(problem: _Problem, max_order: int, start: RationalModel | None) -> _Trial:
    """Grow by a pair where the misfit is largest until two pairs in a row do not pay."""
    poles = _first_poles(problem) if start is None else _upper(start.poles)
    slope = start is not None and bool(np.any(start.e))
    best = trial = _vector_fit(problem, poles, slope)
    misses = 0
    while misses < 2 and _order(trial.poles) + 2 <= max_order and trial.cost > _floor_cost(problem):
        trial = _vector_fit(problem, _with_pair(problem, trial), slope)
        misses = 0 if trial.bic < best.bic else misses + 1
        best = min(best, trial, key=lambda t: t.bic)
    return best


def _prune(problem: _Problem, trial: _Trial) -> _Trial:
    """Remove, one by one, the pole or pair whose removal and refit lowers the BIC most."""
    while len(trial.poles) > 1:
        reduced = [np.delete(trial.poles, k) for k in range(len(trial.poles))]
        costs = [_linear(problem, poles, trial.slope).cost for poles in reduced]
        candidate = _refine(problem, _trial(problem, reduced[int(np.argmin(costs))], trial.slope))
        if candidate.bic >= trial.bic:
            return trial
        trial = candidate
    return trial


def _settle_far_poles(problem: _Problem, trial: _Trial) -> tuple[_Trial, tuple[str, ...]]:
    """Mirror right-half-plane poles outside the band, or trade them for a slope, where the fit does not suffer."""
    notes = []
    w_max = abs(problem.s[-1])
    far = np.flatnonzero((trial.poles.real > 0.0) & (np.abs(trial.poles) > _FAR * w_max))
    for pole in trial.poles[far]:
        k = int(np.argmin(np.abs(trial.poles - pole)))
        mirrored = trial.poles.copy()
        mirrored[k] = -pole.conjugate()
        options = [_refine(problem, _trial(problem, mirrored, trial.slope))]
        options.append(_refine(problem, _trial(problem, np.delete(trial.poles, k), True)))
        settled = [t for t in options if not np.any((t.poles.real > 0.0) & (np.abs(t.poles) > _FAR * w_max))]
        best = min(settled, key=lambda t: t.bic, default=trial)
        if best.bic <= trial.bic + np.log(2 * problem.y.size):
            trial = best
            notes.append(
                f"a pole fitted at {pole.real:+.3g} rad/s, outside the swept band, was taken as stable: "
                "the data fit the stable one as well"
            )
    return trial, tuple(notes)


def _floor_cost(problem: _Problem) -> float:
    return 2 * problem.y.size * problem.floor**2


def _bic(problem: _Problem, cost: float, n_poles: int, slope: bool) -> float:
    """N ln(misfit^2 + floor^2) + parameters ln N; a pole's place, sought over the whole band, counts threefold."""
    n = 2 * problem.y.size
    parameters = _SEARCHED * n_poles + _ELEMENTS * (n_poles + 1 + slope)
    return n * float(np.log(cost / n + problem.floor**2)) + parameters * float(np.log(n))


def _trial(problem: _Problem, poles: np.ndarray, slope: bool) -> _Trial:
    cost = _linear(problem, poles, slope).cost
    return _Trial(poles, slope, cost, _bic(problem, cost, _order(poles), slope))


def _first_poles(problem: _Problem) -> np.ndarray:
    """Three weakly damped pairs over the band and a real pole beyond its end."""
    low, high = np.log10(max(abs(problem.s[0]), 1e-3 * abs(problem.s[-1]))), np.log10(abs(problem.s[-1]))
    beta = np.logspace(low, high, 5)[1:4]
    return np.concatenate([[-3.0 * abs(problem.s[-1]) + 0j], beta * (-0.1 + 1j)])


def _with_pair(problem: _Problem, trial: _Trial) -> np.ndarray:
    """The trial's poles and a weakly damped pair at the frequency of the largest misfit."""
    misfit = np.abs(_linear(problem, trial.poles, trial.slope).misfit)
    n = len(problem.s)
    by_line = np.sum(misfit[:, :n] ** 2 + misfit[:, n:] ** 2, axis=0)
    beta = abs(problem.s[int(np.argmax(by_line))])
    return np.append(trial.poles, beta * (-0.1 + 1j))


# Vector fitting ------------------------------------------------------------------------------------------------


def _vector_fit(problem: _Problem, poles: np.ndarray, slope: bool, n_iterations: int = 12) -> _Trial:
    """Relocate poles until they rest; the best iterate counts, because noise lets them wander."""
    best = _trial(problem, poles, slope)
    for _ in range(n_iterations):
        moved = _relocate(problem, poles, slope)
        if moved is None:
            break
        trial = _trial(problem, moved, slope)
        gain = best.cost - trial.cost
        best = min(best, trial, key=lambda t: t.cost)
        if abs(gain) < 1e-3 * best.cost or best.cost < _floor_cost(problem):
            break
        poles = moved
    return best


def _relocate(problem: _Problem, poles: np.ndarray, slope: bool) -> np.ndarray | None:
    """One step of relaxed vector fitting: the zeros of sigma(s) = d + sum c_k phi_k(s) are the new poles."""
    phi = _basis(problem.s, poles, slope)
    m = _order(poles)
    sigma = phi[:, : m + 1]
    block = (
        np.concatenate([np.broadcast_to(phi, (_ELEMENTS, *phi.shape)), -problem.y[:, :, None] * sigma], axis=2)
        * problem.weight[:, :, None]
    )
    upper = np.linalg.qr(_stack(block), mode="r")[:, phi.shape[1] :, phi.shape[1] :]
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


def _basis(s: np.ndarray, poles: np.ndarray, slope: bool) -> np.ndarray:
    """(n, order + 1 (+ 1)) real-coefficient partial fractions, then the constant, then s."""
    n_real, _ = _counts_upper(poles)
    upper = 1.0 / (s[:, None] - poles)
    lower = 1.0 / (s[:, None] - poles[n_real:].conj())
    pairs = upper[:, n_real:]
    columns = [upper[:, :n_real], pairs + lower, 1j * (pairs - lower), np.ones((len(s), 1))]
    return np.concatenate(columns + [s[:, None]] * slope, axis=1)


# Linear and nonlinear least squares ------------------------------------------------------------------------------


class _Linear(NamedTuple):
    """Residues for given poles: coefficients (4, c), misfit (4, 2n), and the factors Q (4, 2n, c), R, column norms."""

    coefficients: np.ndarray
    misfit: np.ndarray
    q: np.ndarray
    r: np.ndarray
    norm: np.ndarray
    cost: float


def _linear(problem: _Problem, poles: np.ndarray, slope: bool) -> _Linear:
    phi = _basis(problem.s, poles, slope)
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
    linear = _linear(problem, trial.poles, trial.slope)
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
            moved = _linear(problem, poles, trial.slope)
            if moved.cost < linear.cost:
                break
            damping *= 30.0
        else:
            break
        gain = linear.cost - moved.cost
        trial, linear, damping = trial._replace(poles=poles), moved, max(damping / 30.0, 1e-12)
        if gain < 1e-7 * linear.cost:
            break
    return trial._replace(cost=linear.cost, bic=_bic(problem, linear.cost, _order(trial.poles), trial.slope))


def _moved(poles: np.ndarray, step: np.ndarray) -> np.ndarray:
    n_real, n_pair = _counts_upper(poles)
    moved = poles + np.concatenate([step[:n_real], step[n_real : n_real + n_pair] + 1j * step[n_real + n_pair :]])
    return np.where(poles.imag == 0.0, moved.real + 0j, moved.real + 1j * np.maximum(moved.imag, 1e-9))


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
    return (full - linear.q @ inside).reshape(-1, m), inside


# The finished model ------------------------------------------------------------------------------------------------


def _model(problem: _Problem, data: DqData, f1_hz: float, trial: _Trial, notes: tuple[str, ...]) -> RationalModel:
    linear = _linear(problem, trial.poles, trial.slope)
    n_real, n_pair = _counts_upper(trial.poles)
    m = n_real + 2 * n_pair
    x = linear.coefficients.T.reshape(-1, 2, 2)
    pair = x[n_real : n_real + n_pair] + 1j * x[n_real + n_pair : m]
    covariance = _covariance(problem, trial, linear)
    std = np.sqrt(np.diag(covariance)[:m])
    pair_std = std[n_real : n_real + n_pair] + 1j * std[n_real + n_pair :]
    model = RationalModel(
        f1_hz=f1_hz,
        poles=np.concatenate([trial.poles, trial.poles[n_real:].conj()]),
        residues=np.concatenate([x[:n_real].astype(complex), pair, pair.conj()]),
        d=x[m],
        e=x[m + 1] if trial.slope else np.zeros((2, 2)),
        ranks=np.full(m, 2),
        bic=trial.bic,
        residual=float(np.sqrt(linear.cost / linear.misfit.size)),
        noise_floor=problem.noise_floor,
        weighting=problem.weighting,
        nu_hz=data.nu_hz,
        covariance=covariance,
        pole_std=np.concatenate([std[:n_real].astype(complex), pair_std, pair_std]),
        notes=notes,
    )
    return _open_signs(_cut_ranks(model))


def _covariance(problem: _Problem, trial: _Trial, linear: _Linear) -> np.ndarray:
    """Covariance of poles and coefficients: the Gauss-Newton inverse, scaled by the misfit."""
    jacobian, inside = _projected_jacobian(problem, trial, linear)
    m = jacobian.shape[1]
    c = linear.r.shape[1]
    variance = linear.cost / max(linear.misfit.size - m - _ELEMENTS * c, 1)
    variance = max(variance, (1e-3 * problem.floor) ** 2)
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    poles = np.linalg.pinv(jacobian / size, rcond=1e-13) / size[:, None]
    poles = poles @ poles.T
    r_inverse = np.linalg.inv(_regular(linear.r)) / linear.norm[:, :, None]
    carried = -(r_inverse @ inside).reshape(_ELEMENTS * c, m)
    covariance = np.zeros((m + _ELEMENTS * c,) * 2)
    covariance[:m, :m] = poles
    covariance[m:, :m] = carried @ poles
    covariance[:m, m:] = covariance[m:, :m].T
    covariance[m:, m:] = covariance[m:, :m] @ carried.T
    for k in range(_ELEMENTS):
        at = slice(m + k * c, m + (k + 1) * c)
        covariance[at, at] += r_inverse[k] @ r_inverse[k].T
    return variance * covariance


def _cut_ranks(model: RationalModel) -> RationalModel:
    """Rank one where the residue's second singular value is below four of its standard errors."""
    n_real, n_pair = _counts(model.poles)
    residues, ranks = model.residues.copy(), model.ranks.copy()
    m, c = model.order, (len(model.covariance) - model.order) // _ELEMENTS
    for k in range(n_real + n_pair):
        u, singular, vh = np.linalg.svd(model.residues[k])
        direction = np.kron(u[:, 1].conj(), vh[1].conj())
        index = m + c * np.arange(_ELEMENTS) + k
        if k < n_real:
            weights, index = direction.real, index
        else:
            weights, index = np.concatenate([direction.real, -direction.imag]), np.concatenate([index, index + n_pair])
        std = np.sqrt(weights @ model.covariance[np.ix_(index, index)] @ weights)
        if singular[1] < max(4.0 * std, 1e-12 * singular[0]):
            cut = singular[0] * np.outer(u[:, 0], vh[0])
            residues[k], ranks[k] = cut, 1
            if k >= n_real:
                residues[k + n_pair], ranks[k + n_pair] = cut.conj(), 1
    return replace(model, residues=residues, ranks=ranks)


def _open_signs(model: RationalModel) -> RationalModel:
    """Note every pole whose half-plane the data leave open."""
    open_ones = [
        f"the half-plane of the device's own pole at {p.real:+.3g} +- {std.real:.2g} rad/s, "
        f"{abs(p.imag) / (2 * np.pi):.3g} Hz (dq) is not decided by the data"
        for p, std in zip(model.poles, model.pole_std, strict=True)
        if p.imag >= 0.0 and abs(p.real) < 2.0 * std.real
    ]
    return replace(model, notes=(*model.notes, *open_ones))


# Small things ------------------------------------------------------------------------------------------------------


def _upper(poles: np.ndarray) -> np.ndarray:
    """Real poles, then the upper halves of the pairs."""
    real = np.abs(poles.imag) <= 1e-9 * np.abs(poles)
    return np.concatenate([poles[real].real + 0j, poles[~real & (poles.imag > 0.0)]])


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


def _real_form(matrix: np.ndarray) -> np.ndarray:
    """A complex (4, 4) map as a real one (8, 8) on (re, im) of each element."""
    real = np.zeros((2 * _ELEMENTS, 2 * _ELEMENTS))
    real[0::2, 0::2], real[0::2, 1::2] = matrix.real, -matrix.imag
    real[1::2, 0::2], real[1::2, 1::2] = matrix.imag, matrix.real
    return real


def _standard_deviations(y: np.ndarray, covariance: np.ndarray, rows: np.ndarray) -> np.ndarray | None:
    """(n, 2, 2) standard deviations of the chosen rows; a row without covariance takes the others' median."""
    variance = np.einsum("nii->ni", covariance[rows])
    std = np.sqrt(np.maximum((variance[:, 0::2] + variance[:, 1::2]) / 2.0, 0.0)).reshape(-1, 2, 2)
    known = np.isfinite(std).all(axis=(1, 2)) & (std > 0.0).all(axis=(1, 2))
    if not np.any(known):
        return None
    size = np.linalg.norm(y[rows], axis=(1, 2))[:, None, None]
    return np.where(known[:, None, None], std, np.median((std / size)[known], axis=0) * size)
