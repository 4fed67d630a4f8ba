"""Weighted least squares: residues for given poles, and poles moved to where they fit best."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .dq_data import ELEMENTS, DqData
from .partial_fractions import basis, counts_upper, order_of, pairs_joined, separated

_STATED = (
    0.3  # a misfit below this part of the stated errors counts no further: what they hold besides noise is no mode
)
_FARTHEST = 100.0  # poles further out than so many times the band are a polynomial, to rounding
_OFF_AXIS = 1e-12  # poles nearer to the axis than this part of themselves are moved away from it
_ROUNDED = 1e-15  # part of a product that rounding leaves of a difference
_SEARCHED = 3  # weight of a pole's place in the BIC: with 1, one fit in 200 takes noise for a mode


class Problem(NamedTuple):
    """Weighted data in one shape: s (n,) rad/s, y (4, n) S, weight (4, n), floor in units of the weighted misfit.

    ``noise`` (n, 8, 8) is the covariance of the weighted data over (re, im) of each element, to a factor; None where
    only the misfit can tell. ``n_unstable`` is the number of poles in the right half-plane that experiment has proved;
    None: whatever fits. Zero holds every pole in the left half-plane at every step.
    """

    s: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    noise: np.ndarray | None
    floor: float
    weighting: str
    noise_floor: float
    n_unstable: int | None = None


class Trial(NamedTuple):
    """Poles (upper half, real ones first), the number of tail terms, the sum of squares and the BIC."""

    poles: np.ndarray
    tail: int
    cost: float
    bic: float


def weighted(data: DqData, noise_floor: float, part: float | None = None) -> Problem:
    """Weights from the noise and, beside it, a ``part`` of Y (default: the noise floor) in every number."""
    part = noise_floor if part is None else part
    size = np.linalg.norm(data.y, axis=(1, 2)) / 2.0
    s = 2j * np.pi * data.nu_hz
    y = data.y.reshape(-1, ELEMENTS).T
    if data.std is None:
        weight = np.broadcast_to(1.0 / size, y.shape)
        return Problem(s, y, weight, None, noise_floor, "relative", noise_floor)
    std = data.std.reshape(-1, ELEMENTS).T
    weight = 1.0 / np.hypot(std, part * size)
    by_row = np.repeat(weight.T, 2, axis=1)
    own = np.repeat(std.T**2, 2, axis=1)[:, :, None] * np.eye(2 * ELEMENTS)
    noise = own if data.covariance is None else data.covariance
    noise = noise + (part * size)[:, None, None] ** 2 * np.eye(2 * ELEMENTS)
    noise = noise * by_row[:, :, None] * by_row[:, None, :]
    floor = float(np.sqrt(np.mean(((noise_floor * size) ** 2 + (_STATED * std) ** 2) * weight**2)))
    return Problem(s, y, weight, noise, floor, "covariance", noise_floor)


def trial_at(problem: Problem, poles: np.ndarray, tail: int) -> Trial:
    """The best that can be had with these poles where they are."""
    return trial_of(problem, poles, tail, _least_cost(problem, poles, tail))


def trial_of(problem: Problem, poles: np.ndarray, tail: int, cost: float) -> Trial:
    """A trial whose sum of squares is known."""
    return Trial(poles, tail, cost, bic_of(problem, cost, order_of(poles), tail))


def bic_of(problem: Problem, cost: float, n_poles: int, tail: int) -> float:
    """N ln(misfit^2 + floor^2) + parameters ln N; a pole's place, sought over the whole band, counts threefold."""
    n = 2 * problem.y.size
    parameters = _SEARCHED * n_poles + ELEMENTS * (n_poles + tail)
    return n * float(np.log(cost / n + problem.floor**2)) + parameters * float(np.log(n))


def charge_of_parameter(problem: Problem) -> float:
    """What `bic_of` charges for one of a pole's real parameters, in variances of a weighted datum."""
    return (_SEARCHED + ELEMENTS) / (1 + ELEMENTS) * float(np.log(2 * problem.y.size))


def floor_cost(problem: Problem) -> float:
    """Sum of squares of a misfit at the noise floor."""
    return 2 * problem.y.size * problem.floor**2


def shows_noise(problem: Problem, trial: Trial) -> bool:
    """Whether rows are missed by twice their floor or more: only then the misfit tells anything."""
    return bool(trial.cost >= 4.0 * floor_cost(problem))


# Residues for given poles --------------------------------------------------------------------------------------------


class Linear(NamedTuple):
    """Residues for given poles: coefficients (4, c), misfit (4, 2n), and the factors Q (4, 2n, c), R, column norms."""

    coefficients: np.ndarray
    misfit: np.ndarray
    q: np.ndarray
    r: np.ndarray
    norm: np.ndarray
    cost: float


def solve_residues(problem: Problem, poles: np.ndarray, tail: int) -> Linear:
    """Residues, D and E that fit best with these poles: a least squares by QR, one for each element."""
    columns, norm, target = _system(problem, poles, tail)
    q, r = np.linalg.qr(columns)
    projected = np.einsum("eij,ei->ej", q, target)
    misfit = target - np.einsum("eij,ej->ei", q, projected)
    coefficients = np.linalg.solve(_regular(r), projected[:, :, None])[:, :, 0] / norm
    return Linear(coefficients, misfit, q, r, norm, float(np.sum(misfit**2)))


def _least_cost(problem: Problem, poles: np.ndarray, tail: int) -> float:
    """The cost of `solve_residues` alone: what the last column of the triangular factor has left for itself."""
    columns, _, target = _system(problem, poles, tail)
    r = np.linalg.qr(np.concatenate([columns, target[:, :, None]], axis=2), mode="r")
    return float(np.sum(np.asarray(r)[:, -1, -1] ** 2))


def _system(problem: Problem, poles: np.ndarray, tail: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (4, 2n, c) of length one, their lengths (4, c) before, and the weighted data (4, 2n)."""
    columns = stacked(basis(problem.s, poles, tail)[None] * problem.weight[:, :, None])
    norm = np.sqrt(np.einsum("eic,eic->ec", columns, columns))
    columns /= norm[:, None, :]
    return columns, norm, stacked((problem.y * problem.weight)[:, :, None])[:, :, 0]


def costs_without(problem: Problem, trial: Trial) -> np.ndarray:
    """(m + tail,) costs with one pole or pair less, or one tail term less, from the one factorisation of all.

    Columns S left out cost x_S^T (C_SS)^-1 x_S more, with the coefficients x and C = (R^T R)^-1.
    """
    linear = solve_residues(problem, trial.poles, trial.tail)
    n_real, n_pair = counts_upper(trial.poles)
    root, x = np.linalg.inv(_regular(linear.r)), linear.coefficients * linear.norm
    alone = x**2 / np.einsum("ejc,ejc->ej", root, root)
    real, imag = np.s_[:, n_real : n_real + n_pair], np.s_[:, n_real + n_pair : n_real + 2 * n_pair]
    both = _missed_together(root[real], root[imag], x[real], x[imag])
    more = np.concatenate([alone[:, :n_real], both, alone[:, n_real + 2 * n_pair :]], axis=1)
    return linear.cost + more.sum(axis=0)


def _missed_together(root_1: np.ndarray, root_2: np.ndarray, x_1: np.ndarray, x_2: np.ndarray) -> np.ndarray:
    """What two columns left out together cost, x^T C^-1 x of each two by two block of C = root root^T."""
    c_11, c_12, c_22 = (np.einsum("ejc,ejc->ej", *roots) for roots in ((root_1,) * 2, (root_1, root_2), (root_2,) * 2))
    determinant = np.maximum(c_11 * c_22 - c_12**2, _ROUNDED * c_11 * c_22)
    return (c_22 * x_1**2 - 2.0 * c_12 * x_1 * x_2 + c_11 * x_2**2) / determinant


def _regular(r: np.ndarray) -> np.ndarray:
    """R with exact zeros on its diagonal lifted, so that coinciding poles do not raise."""
    r = r.copy()
    diagonal = np.einsum("eii->ei", r)
    diagonal[np.abs(diagonal) < 1e-15] = 1e-15
    return r


def stacked(block: np.ndarray) -> np.ndarray:
    """(4, n, c) complex to (4, 2n, c) real: real parts above imaginary parts."""
    return np.concatenate([block.real, block.imag], axis=1)


def datum_variance(problem: Problem, trial: Trial, linear: Linear) -> float:
    """Variance of a weighted datum, from the misfit."""
    return max(linear.cost / max(freedom_of(trial, linear), 1), (1e-3 * problem.floor) ** 2)


def freedom_of(trial: Trial, linear: Linear) -> int:
    """Weighted data less the parameters of the fit; not positive where the fit has too many of them."""
    return linear.misfit.size - order_of(trial.poles) - linear.coefficients.size


def pole_std(problem: Problem, trial: Trial) -> np.ndarray:
    """(m,) standard errors of the real parts of the poles (rad/s), noise taken as the weights have it."""
    linear = solve_residues(problem, trial.poles, trial.tail)
    root = inverted(projected_jacobian(problem, trial, linear)[0])[0]
    spread = np.linalg.norm(root, axis=1)[: len(trial.poles)]
    return spread * np.sqrt(datum_variance(problem, trial, linear))


def inverted(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V S^-1 of a Jacobian (r, t), columns scaled, and its orthonormal columns U: errors are V S^-1 U^T noise."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    u, singular, vh = np.linalg.svd(jacobian / size, full_matrices=False)
    return vh.T / np.maximum(singular, 1e-13 * singular.max(initial=0.0)) / size[:, None], u


def inverse_r(linear: Linear) -> np.ndarray:
    """(4, c, c) whose products with their transposes are the coefficients' covariance for given poles."""
    return np.linalg.inv(_regular(linear.r)) / linear.norm[:, :, None]


def block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """(4, c, c) to (4c, 4c)."""
    n, c = blocks.shape[:2]
    full = np.zeros((n, c, n, c))
    full[np.arange(n), :, np.arange(n), :] = blocks
    return full.reshape(n * c, n * c)


# Poles ---------------------------------------------------------------------------------------------------------------


def refine(problem: Problem, trial: Trial, n_iterations: int = 10) -> Trial:
    """Levenberg-Marquardt on the poles with the residues projected out (Kaufman's variable projection)."""
    damping = 1e-6
    linear = solve_residues(problem, trial.poles, trial.tail)
    for _ in range(n_iterations):
        if linear.cost < floor_cost(problem):
            break
        jacobian = projected_jacobian(problem, trial, linear)[0]
        size = np.linalg.norm(jacobian, axis=0)
        size[size == 0.0] = 1.0
        u, singular, vt = np.linalg.svd(jacobian / size, full_matrices=False)
        projected = u.T @ linear.misfit.ravel()
        for _ in range(6):
            step = vt.T @ (singular / (singular**2 + damping) * projected) / size
            poles = held(problem, _moved(trial.poles, step))
            moved = solve_residues(problem, poles, trial.tail)
            if moved.cost < linear.cost:
                break
            damping *= 30.0
        else:
            break
        gain = linear.cost - moved.cost
        trial, linear, damping = trial._replace(poles=poles), moved, max(damping / 30.0, 1e-12)
        if gain < 1e-7 * linear.cost:
            break
    return trial_of(problem, trial.poles, trial.tail, linear.cost)


def held(problem: Problem, poles: np.ndarray) -> np.ndarray:
    """The poles where they may be: not so far out that rounding decides, and on the left where the device is stable.

    None is on the axis itself, where a row may have its very frequency.
    """
    far = np.abs(poles) / (_FARTHEST * abs(problem.s[-1]))
    poles = poles / np.maximum(far, 1.0)
    nearest = _OFF_AXIS * np.abs(poles)
    real = np.where(np.abs(poles.real) < nearest, -nearest, poles.real)
    return (-np.abs(real) if problem.n_unstable == 0 else real) + 1j * poles.imag


def _moved(poles: np.ndarray, step: np.ndarray) -> np.ndarray:
    n_real, n_pair = counts_upper(poles)
    moved = poles + pairs_joined(step, n_real, n_pair)
    return separated(np.where(poles.imag == 0.0, moved.real + 0j, moved))


def projected_jacobian(problem: Problem, trial: Trial, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """d(model)/d(pole parameters) outside the span of the basis (4 * 2n, t), and inside it, Q^T J (4, c, t)."""
    n_real, n_pair = counts_upper(trial.poles)
    x = linear.coefficients
    m = n_real + 2 * n_pair
    pair = x[:, n_real : n_real + n_pair] + 1j * x[:, n_real + n_pair : m]
    upper = 1.0 / (problem.s[:, None] - trial.poles) ** 2
    lower = 1.0 / (problem.s[:, None] - trial.poles[n_real:].conj()) ** 2
    real = x[:, None, :n_real] * upper[None, :, :n_real]
    up, low = pair[:, None] * upper[None, :, n_real:], pair.conj()[:, None] * lower[None]
    full = stacked(np.concatenate([real, up + low, 1j * (up - low)], axis=2) * problem.weight[:, :, None])
    inside = np.swapaxes(linear.q, 1, 2) @ full
    return (full - linear.q @ inside).reshape(linear.misfit.size, m), inside
