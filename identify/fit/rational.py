"""A rational model of the 2x2 admittance in the dq frame: its values, its slopes and its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..frames import dq_to_pn
from .dq_data import ELEMENTS
from .partial_fractions import basis, counts, counts_upper


class Rational(NamedTuple):
    """Poles (m,), residues (m, 2, 2), D and E (2, 2) of a rational function, as in `RationalModel`."""

    poles: np.ndarray
    residues: np.ndarray
    d: np.ndarray
    e: np.ndarray


class Omitted(NamedTuple):
    """Terms that a model leaves out (`identify.fit.omitted`), each of the q columns an error of unit variance.

    ``poles`` (p,) are the upper ones of pairs that may be missing, ``split`` (j,) the poles of the model, real ones or
    upper ones of pairs, that may stand for several; ``by_fit`` (k, q) is what the errors do to the real parameters of
    the model, ``coefficients`` (4c, q) are those of the columns of `omitted_basis`, for dd, dq, qd and qq.
    """

    poles: np.ndarray
    split: np.ndarray
    by_fit: np.ndarray
    coefficients: np.ndarray


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
    omitted : Omitted or None
        What the model leaves out. None where the rows show no noise.
    rival : Rational or None
        The fit with pairs more that many tables ask for together (`identify.fit.pooled`), whose difference is one error
        that they have in common.
    pole_std : (m,) complex
        Standard errors of the poles, real part + 1j imaginary part (rad/s).
    notes : tuple of str
        What the reader of a result should know: rows that were left out, an instability of the device's own.
    remarks : tuple of str
        What was decided on the way and asks for nothing: faint poles left out, signs that the data leave open.
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
    omitted: Omitted | None
    rival: Rational | None
    pole_std: np.ndarray
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

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
    n_real, n_pair = counts(model.poles)
    slopes = np.einsum("nij,kij->nk", weight, model.residues) / (s[:, None] - model.poles) ** 2
    upper, lower = slopes[:, n_real : n_real + n_pair], slopes[:, n_real + n_pair :]
    rows = basis(s, model.poles[: n_real + n_pair], model.tail)
    coefficients = weight.reshape(-1, ELEMENTS, 1) * rows[:, None, :]
    by_pole = [slopes[:, :n_real], upper + lower, 1j * (upper - lower)]
    return np.concatenate([*by_pole, coefficients.reshape(len(s), -1)], axis=1)


def row_slopes(model: RationalModel) -> np.ndarray:
    """Derivatives (8 n, k) of the weighted rows with respect to the real parameters; of a row re of four, then im."""
    slopes = _element_slopes(model, 2j * np.pi * model.nu_hz) * model.weight[:, :, None]
    return np.concatenate([slopes.real, slopes.imag], axis=1).reshape(2 * ELEMENTS * len(model.nu_hz), -1)


def _element_slopes(model: RationalModel, s: np.ndarray) -> np.ndarray:
    """`gradient` of each of dd, dq, qd, qq: (n, 4, k)."""
    return gradient(model, *_each_element(s)).reshape(len(s), ELEMENTS, -1)


def _each_element(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (4n,) and weights (4n, 2, 2) for `gradient` that read dd, dq, qd and qq at each of ``s`` (n,)."""
    return np.repeat(s, ELEMENTS), np.tile(np.eye(ELEMENTS).reshape(ELEMENTS, 2, 2), (len(s), 1, 1))


def row_shares(model: RationalModel, g: np.ndarray) -> np.ndarray:
    """What every fitted row contributes to the variance of ``g @ parameters``: (n,), adding up to one.

    The noise is taken as the weights have it, uncorrelated between elements.
    """
    jacobian = row_slopes(model)
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    lever = np.linalg.lstsq((jacobian / size).T, g / size, rcond=1e-12)[0]
    share = np.sum(lever.reshape(len(model.nu_hz), -1) ** 2, axis=1)
    return share / np.sum(share)


def omitted_basis(omitted: Omitted, s: np.ndarray) -> np.ndarray:
    """(n, c): partial fractions of the missing pairs, then the slopes 1/(s - p)^2 of the poles that may be split."""
    n_real, _ = counts_upper(omitted.split)
    upper = 1.0 / (s[:, None] - omitted.split) ** 2
    lower = 1.0 / (s[:, None] - omitted.split[n_real:].conj()) ** 2
    pairs = upper[:, n_real:]
    slopes = [upper[:, :n_real], pairs + lower, 1j * (pairs - lower)]
    return np.concatenate([basis(s, omitted.poles, 0), *slopes], axis=1)


def n_errors(model: RationalModel) -> int:
    """Number of independent errors of unit variance in `spread`."""
    return model.covariance_root.shape[1] + (0 if model.omitted is None else model.omitted.by_fit.shape[1]) + 1


def spread(model: RationalModel, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """What the independent errors of the fit, each of unit variance, do to ``sum_ij weight_ij Ydq_ij(s)``: (n, j).

    The covariance of such sums is that of the columns: ``spread @ spread.T`` for the real parts. ``s`` and ``weight``
    are those of `gradient`. Noise comes first, then what the model leaves out; the last error is the difference to the
    rival.
    """
    return np.concatenate([_smooth_errors(model, s, weight), _by_rival(model, s, weight)[:, None]], axis=1)


def _smooth_errors(model: RationalModel, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, j - 1): by noise, and by what the model leaves out, both beside it and through its parameters."""
    slopes = gradient(model, s, weight)
    if model.omitted is None:
        return slopes @ model.covariance_root
    beside = weight.reshape(-1, ELEMENTS, 1) * omitted_basis(model.omitted, s)[:, None, :]
    by_omitted = slopes @ model.omitted.by_fit + beside.reshape(len(s), -1) @ model.omitted.coefficients
    return np.concatenate([slopes @ model.covariance_root, by_omitted], axis=1)


def _by_rival(model: RationalModel, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,): zero where there is no rival."""
    if model.rival is None:
        return np.zeros(len(s), dtype=complex)
    return np.sum(weight * (evaluate(model.rival, s) - evaluate(model, s)), axis=(1, 2))


def joint(models: Sequence[RationalModel], errors: Sequence[np.ndarray]) -> np.ndarray:
    """Errors (..., k) of what several tables make together, of `spread` of each: their rivals' are one error."""
    shared = sum(e[..., -1:] for e in errors)
    return np.concatenate([*[e[..., :-1] for e in errors], shared], axis=-1)


def with_errors(model: RationalModel, s: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Ydq (..., n, 2, 2) in S with the errors (..., j) of `spread`, to first order, at ``s`` (n,) in rad/s.

    Moving the parameters themselves would be worse: neighbouring poles, only combinations of which are known, would
    take Y, of second order, to where no row lets it be.
    """
    slopes = spread(model, *_each_element(s))
    y = evaluate(model, s)
    return y + (errors @ slopes.T).reshape(*errors.shape[:-1], *y.shape)
