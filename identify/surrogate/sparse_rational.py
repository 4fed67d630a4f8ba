"""The sparse rational model over operating points: four numerators and one denominator at every frequency.

At each frequency ``Y_e(x) = N_e(x) / d(x)`` for the four elements e, N_e and d sums of a few Chebyshev products of the
coordinates x, the same products at all frequencies, and d normalised to one at its constant. A linearised converter is
rational in its operating currents and voltage, which is why few products suffice.

The coefficients minimise ``sum_j |w_j / d_j (d(x_j) Y_e(x_j) - N_e(x_j))|^2`` over the sweeps j, with w = 1/||Y||. For
given weights this is linear; d from the pass before makes the weights (Sanathanan and Koerner). The numerators are
projected out by a QR of their columns, which leaves a small least squares for d (variable projection). The coefficients
of d have a prior, weighed by the error that the fit leaves (`EXPECTED`): a ridge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .index_sets import Index, chebyshev_products

ELEMENTS = 4

PASSES = 3
"""Sanathanan-Koerner passes, after a first fit that tells the error: the weights have settled to a per cent by then."""

EXPECTED = 0.1
"""Size of a coefficient of the denominator that is expected before anything is swept.

Where Y hardly depends on the operating point any denominator does, with numerators to match, and noise picks one: a
pole and a zero that nearly cancel between the sweeps. The prior holds such coefficients near zero. It costs little: a
coefficient delta that is needed leaves at most error / (2 EXPECTED) |delta| over the rows of all sweeps together.
"""

LEAST_RIDGE = 1e-12
"""Least error that the prior is weighed against, relative to ||Y||."""

NEIGHBOURS = 7
"""Neighbouring frequencies over which squares are averaged."""

LEAST_DENOMINATOR = 1e-9
"""A pole that falls on a sweep during the fit weighs no more than this gives."""

DETERMINED = 1e-7
"""Least pivot of I - H_jj: below it, the other sweeps leave a direction of the coefficients open."""


class Shape(NamedTuple):
    """Indices of the numerators and of the denominator, the latter without its constant, which is one."""

    numerator: tuple[Index, ...]
    denominator: tuple[Index, ...]

    @property
    def size(self) -> int:
        """Complex coefficients at one frequency."""
        return ELEMENTS * len(self.numerator) + len(self.denominator)


class Data(NamedTuple):
    """Sweeps in the unit box.

    Attributes
    ----------
    x : (m, d) float
        Operating points, scaled to -1 ... 1.
    y : (f, m, 4) complex
        Admittance (S); what a weight of zero leaves out may be anything finite.
    weight : (f, m) float
        1/||Y||, zero where a row is not usable.
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, slots=True)
class Fitted:
    """Coefficients at every frequency and what the sweeps say of them.

    Attributes
    ----------
    shape : Shape
        The products.
    numerator : (f, k, 4) complex
        Coefficients of the numerators (S).
    denominator : (f, l) complex
        Coefficients of the denominator beyond its constant one.
    left_out : (f, m, 4) complex
        Error, relative to ||Y||, at each sweep when that sweep is left out (closed form, weights held).
    leverage : (f, m) float
        Mean diagonal of the hat matrix over the four elements of each sweep.
    r_numerator, r_denominator : (f, k, k), (f, l, l) complex
        Triangular factors of the weighted columns and of the projected ones with their prior: what a leverage elsewhere
        needs.
    mixing : (f, 4, k, l) complex
        Q^H B of the projected columns, per element.
    """

    shape: Shape
    numerator: np.ndarray
    denominator: np.ndarray
    left_out: np.ndarray
    leverage: np.ndarray
    r_numerator: np.ndarray
    r_denominator: np.ndarray
    mixing: np.ndarray

    @property
    def score(self) -> float:
        """Root mean square of the leave-one-out errors over frequencies and sweeps."""
        return float(np.sqrt(np.mean(np.sum(np.abs(self.left_out) ** 2, axis=2))))

    @property
    def coherence(self) -> float:
        """How alike the leave-one-out errors are at neighbouring frequencies: 0 for noise, 1 for what varies slowly."""
        here, beside = self.left_out[:-1], self.left_out[1:]
        size = np.linalg.norm(here) * np.linalg.norm(beside)
        return float(np.abs(np.vdot(here, beside)) / size) if size > 0.0 else 0.0


class Prediction(NamedTuple):
    """Admittance (p, f, 4) in S, |d| (p, f) and the leverage (p, f) relative to ||Y||."""

    y: np.ndarray
    denominator: np.ndarray
    leverage: np.ndarray


def fit_shape(data: Data, shape: Shape) -> Fitted:
    """Least squares for given products, at all frequencies at once.

    Returns
    -------
    Fitted
        Coefficients, closed-form leave-one-out errors and the factors that give a leverage.
    """
    step = _settled(_stacked(data, [shape]), PASSES)
    left_out, leverage = _left_out(step)
    return Fitted(shape, step.numerator, step.denominator, left_out, leverage, step.r, step.r_coupling, step.mixing)


class Tried(NamedTuple):
    """What several shapes of one size are worth.

    Attributes
    ----------
    scores : (s,) float
        Root mean square of the leave-one-out errors over frequencies and sweeps.
    denominators : (s, f, l) complex
        Coefficients of the denominators beyond their constant one.
    """

    scores: np.ndarray
    denominators: np.ndarray


def try_shapes(data: Data, shapes: Sequence[Shape], passes: int) -> Tried:
    """Fit shapes that have as many products as one another, all at once."""
    step = _settled(_stacked(data, shapes), passes)
    squares = np.sum(np.abs(_left_out(step)[0]) ** 2, axis=2).reshape(len(shapes), -1)
    denominators = step.denominator.reshape(len(shapes), len(data.y), -1)
    return Tried(np.sqrt(np.mean(squares, axis=1)), denominators)


class _Stack(NamedTuple):
    """Shapes of one size over the same sweeps: n rows are s shapes at f frequencies each, one shape after the other.

    ``y`` (n, m, 4), ``weight`` (n, m), ``phi`` (n, m, k) and ``psi`` (n, m, l) are the data and the products.
    """

    y: np.ndarray
    weight: np.ndarray
    phi: np.ndarray
    psi: np.ndarray
    n_shapes: int


def _stacked(data: Data, shapes: Sequence[Shape]) -> _Stack:
    n_f = len(data.y)
    phi = np.repeat([chebyshev_products(data.x, shape.numerator) for shape in shapes], n_f, axis=0)
    psi = np.repeat([chebyshev_products(data.x, shape.denominator) for shape in shapes], n_f, axis=0)
    y, weight = (np.tile(part, (len(shapes), *[1] * (part.ndim - 1))) for part in (data.y, data.weight))
    return _Stack(y, weight, phi, psi, len(shapes))


def _settled(stack: _Stack, passes: int) -> _Step:
    """The last of the passes, whose weights are the denominator of the one before."""
    step = _solve(stack, stack.weight, np.zeros(len(stack.y)))
    size = np.ones(stack.weight.shape)
    for _ in range(passes if stack.psi.shape[2] else 0):
        step = _solve(stack, stack.weight / size, _error(stack, step) / EXPECTED)
        size = np.maximum(np.abs(1.0 + (stack.psi @ step.denominator[..., None])[..., 0]), LEAST_DENOMINATOR)
    return step


def _error(stack: _Stack, step: _Step) -> np.ndarray:
    """(n,) standard error of an element, relative to ||Y||: what the fit leaves, over its degrees of freedom."""
    coefficients = ELEMENTS * stack.phi.shape[2] + stack.psi.shape[2]
    free = ELEMENTS * np.sum(stack.weight > 0.0, axis=1) - coefficients
    squares = np.sum(np.abs(step.residual) ** 2, axis=(1, 2)) / np.maximum(free, 1)
    return np.sqrt(moving_mean(squares.reshape(stack.n_shapes, -1))).ravel()


class _Step(NamedTuple):
    """One linear least squares: its factors, coefficients and residual.

    ``q`` (n, m, k), ``r`` (n, k, k), ``q_coupling`` (n, 4, m, l), ``r_coupling`` (n, l, l), ``mixing`` (n, 4, k, l),
    ``numerator`` (n, k, 4), ``denominator`` (n, l) and ``residual`` (n, 4, m) of n rows of a `_Stack`.
    """

    q: np.ndarray
    r: np.ndarray
    q_coupling: np.ndarray
    r_coupling: np.ndarray
    mixing: np.ndarray
    numerator: np.ndarray
    denominator: np.ndarray
    residual: np.ndarray


def _solve(stack: _Stack, g: np.ndarray, ridge: np.ndarray) -> _Step:
    """Coefficients for weights g (n, m) = w/|d| and a ridge (n,): numerators projected out, then d, then numerators."""
    n, n_m = g.shape
    n_l = stack.psi.shape[2]
    q, r = np.linalg.qr(g[:, :, None] * stack.phi)
    target = np.swapaxes(g[:, :, None] * stack.y, 1, 2)  # (n, 4, m)
    coupling = target[..., None] * stack.psi[:, None]  # (n, 4, m, l)
    qh = np.swapaxes(q.conj(), 1, 2)[:, None]
    mixing = qh @ coupling
    inside = (qh @ target[..., None])[..., 0]
    coupling = coupling - q[:, None] @ mixing
    rest = target - (q[:, None] @ inside[..., None])[..., 0]
    held = np.maximum(ridge, LEAST_RIDGE)[:, None, None] * np.eye(n_l)
    q_c, r_c = np.linalg.qr(np.concatenate([coupling.reshape(n, ELEMENTS * n_m, n_l), held], axis=1))
    q_c = q_c[:, : ELEMENTS * n_m]
    delta = -_backwards(r_c, np.swapaxes(q_c.conj(), 1, 2) @ rest.reshape(n, -1, 1))[..., 0]
    residual = rest + (coupling @ delta[:, None, :, None])[..., 0]
    numerator = _backwards(r, np.swapaxes(inside + (mixing @ delta[:, None, :, None])[..., 0], 1, 2))
    return _Step(q, r, q_c.reshape(n, ELEMENTS, n_m, n_l), r_c, mixing, numerator, delta, residual)


def _left_out(step: _Step) -> tuple[np.ndarray, np.ndarray]:
    """(n, m, 4) leave-one-out errors (I - H_jj)^-1 r_j, H_jj the (4, 4) block of the hat matrix of sweep j; leverages.

    Where the other sweeps do not determine the coefficients the error is infinite: a device whose elements depend on
    one another leaves fewer equations than are counted.
    """
    own = np.sum(np.abs(step.q) ** 2, axis=2)  # (n, m)
    rows = np.ascontiguousarray(np.swapaxes(step.q_coupling, 1, 2))
    block = rows @ np.swapaxes(rows.conj(), 2, 3) + own[:, :, None, None] * np.eye(ELEMENTS)
    leverage = np.trace(block, axis1=2, axis2=3).real / ELEMENTS
    left_out, least = _eliminated(np.eye(ELEMENTS) - block, np.swapaxes(step.residual, 1, 2))
    left_out[~(least >= DETERMINED)] = np.inf
    return left_out, leverage


def _eliminated(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solutions (n, m, 4) of Hermitian systems a x = b, and their least pivots (n, m): Gauss, for thousands at once."""
    rows = np.moveaxis(np.concatenate([a, b[..., None]], axis=3), (2, 3), (0, 1)).copy()  # (4, 5, n, m)
    pivots = np.empty((ELEMENTS, *rows.shape[2:]))
    for k in range(ELEMENTS):
        pivots[k] = rows[k, k].real
        rows[k, k + 1 :] /= np.where(pivots[k] >= DETERMINED, pivots[k], np.inf)
        rows[k + 1 :, k + 1 :] -= rows[k + 1 :, k, None] * rows[k, k + 1 :]
    x = rows[:, ELEMENTS]
    for k in range(ELEMENTS - 1, 0, -1):
        x[:k] -= rows[:k, k] * x[k]
    return np.moveaxis(x, 0, 2).copy(), pivots.min(axis=0)


def moving_mean(values: np.ndarray) -> np.ndarray:
    """Mean over the `NEIGHBOURS` nearest entries along the last axis, fewer at the ends."""
    half, n = NEIGHBOURS // 2, values.shape[-1]
    nothing = np.zeros((*values.shape[:-1], half))
    padded = np.concatenate([nothing, values, nothing], axis=-1)
    at = np.arange(n)
    count = np.minimum(at + half + 1, n) - np.maximum(at - half, 0)
    return np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS, axis=-1).sum(axis=-1) / count


def _backwards(r: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = b for stacks of triangular factors; a column that says nothing gets no coefficient."""
    if r.shape[-1] == 0:
        return np.zeros((*right.shape[:-2], 0, right.shape[-1]), dtype=complex)
    return np.linalg.solve(_regular(r), right)


def _regular(r: np.ndarray) -> np.ndarray:
    """The factors with no diagonal entry that is next to nothing."""
    diagonal = np.abs(np.einsum("fii->fi", r))
    least = diagonal.max(axis=1, initial=0.0)[:, None] * 1e-14 + 1e-300
    faint = diagonal < least
    if not faint.any():
        return r
    r = r.copy()
    np.einsum("fii->fi", r)[faint] = np.broadcast_to(least, diagonal.shape)[faint]
    return r


def values(fitted: Fitted, x: np.ndarray) -> np.ndarray:
    """Y (p, f, 4) at points (p, d) of the unit box, without what a leverage takes."""
    d = 1.0 + fitted.denominator @ chebyshev_products(x, fitted.shape.denominator).T
    return np.swapaxes((chebyshev_products(x, fitted.shape.numerator) @ fitted.numerator) / d[..., None], 0, 1)


def predict(fitted: Fitted, x: np.ndarray, rows: np.ndarray | slice = slice(None)) -> Prediction:
    """The model at points (p, d) of the unit box.

    Notes
    -----
    The leverage of a new point is ``|u|^2 + |c|^2`` with u the weighted numerator row times R^-1 and c the projected
    denominator row times its own R^-1, the mean over the four elements: the variance of the prediction, relative to
    ||Y||, in multiples of the variance of a weighted datum.
    """
    phi = chebyshev_products(x, fitted.shape.numerator)
    psi = chebyshev_products(x, fitted.shape.denominator)
    numerator, delta = fitted.numerator[rows], fitted.denominator[rows]
    d = 1.0 + delta @ psi.T  # (f, p)
    y = (phi @ numerator) / d[..., None]  # (f, p, 4)
    scale = 1.0 / (np.linalg.norm(y, axis=2) * np.abs(d))
    u = (phi @ np.linalg.inv(_regular(fitted.r_numerator[rows]))) * scale[..., None]
    leverage = np.sum(np.abs(u) ** 2, axis=2)
    if delta.shape[1]:
        n_f, n_e, n_k, n_l = fitted.mixing[rows].shape
        mixing = np.swapaxes(fitted.mixing[rows], 1, 2).reshape(n_f, n_k, n_e * n_l)
        bare = (y * scale[..., None])[..., None] * psi[:, None, :]  # (f, p, 4, l)
        projected = bare - (u @ mixing).reshape(bare.shape)
        c = projected.reshape(n_f, -1, n_l) @ np.linalg.inv(_regular(fitted.r_denominator[rows]))
        leverage = leverage + np.sum(np.abs(c) ** 2, axis=2).reshape(n_f, -1, n_e).mean(axis=2)
    return Prediction(np.swapaxes(y, 0, 1), np.abs(d).T, leverage.T)
