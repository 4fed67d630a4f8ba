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

from .index_sets import Index, border, chebyshev_products

ELEMENTS = 4

MAX_NUMERATOR_DEGREE = 6
MAX_DENOMINATOR_DEGREE = 3

PASSES = 3
"""Sanathanan-Koerner passes, after a first fit that tells the error: the weights have settled to a per cent by then."""

SMALLEST_WITHIN = 1.05
"""The smallest model whose leave-one-out error is within this factor of the least one is taken."""

RIVALS = 5
"""Next best models that are kept: their spread is part of the error."""

GUARD = 0.25
"""|d| over the region may not fall below this part of its least value at the sweeps: a pole would hide between them."""

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
"""Least eigenvalue of I - H_jj: below it, the other sweeps leave a direction of the coefficients open."""

_PATIENCE = 6  # growth steps without gain until growing ends


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


class Prediction(NamedTuple):
    """Admittance (p, f, 4) in S, |d| (p, f) and the leverage (p, f) relative to ||Y||."""

    y: np.ndarray
    denominator: np.ndarray
    leverage: np.ndarray


def fit_shape(data: Data, shape: Shape, passes: int = PASSES) -> Fitted:
    """Least squares for given products, at all frequencies at once.

    Returns
    -------
    Fitted
        Coefficients, closed-form leave-one-out errors and the factors that give a leverage.
    """
    phi = chebyshev_products(data.x, shape.numerator)
    psi = chebyshev_products(data.x, shape.denominator)
    denominator = np.ones(data.weight.shape, dtype=complex)
    step = _solve(data, phi, psi, data.weight, np.zeros(len(data.y)))
    for _ in range(passes if len(shape.denominator) else 0):
        error = _error(data, shape, step)
        step = _solve(data, phi, psi, data.weight / np.abs(denominator), error / EXPECTED)
        denominator = 1.0 + step.denominator @ psi.T
        denominator = np.where(np.abs(denominator) > LEAST_DENOMINATOR, denominator, LEAST_DENOMINATOR)
    return _judged(shape, step)


def _error(data: Data, shape: Shape, step: _Step) -> np.ndarray:
    """(f,) standard error of an element, relative to ||Y||: what the fit leaves, over its degrees of freedom."""
    free = ELEMENTS * np.sum(data.weight > 0.0, axis=1) - shape.size
    squares = np.sum(np.abs(step.residual) ** 2, axis=(1, 2)) / np.maximum(free, 1)
    return np.sqrt(moving_mean(squares))


class _Step(NamedTuple):
    """One linear least squares: its factors, coefficients and residual."""

    q: np.ndarray
    r: np.ndarray
    q_coupling: np.ndarray
    r_coupling: np.ndarray
    mixing: np.ndarray
    numerator: np.ndarray
    denominator: np.ndarray
    residual: np.ndarray


def _solve(data: Data, phi: np.ndarray, psi: np.ndarray, g: np.ndarray, ridge: np.ndarray) -> _Step:
    """Coefficients for weights g (f, m) = w/|d| and a ridge (f,): numerators projected out, then d, then numerators."""
    n_f, n_m = g.shape
    n_l = psi.shape[1]
    q, r = np.linalg.qr(g[:, :, None] * phi)
    target = np.swapaxes(g[:, :, None] * data.y, 1, 2)  # (f, 4, m)
    coupling = target[..., None] * psi  # (f, 4, m, l)
    qh = np.swapaxes(q.conj(), 1, 2)[:, None]
    mixing = qh @ coupling
    inside = (qh @ target[..., None])[..., 0]
    coupling = coupling - q[:, None] @ mixing
    rest = target - (q[:, None] @ inside[..., None])[..., 0]
    held = np.maximum(ridge, LEAST_RIDGE)[:, None, None] * np.eye(n_l)
    q_c, r_c = np.linalg.qr(np.concatenate([coupling.reshape(n_f, ELEMENTS * n_m, n_l), held], axis=1))
    q_c = q_c[:, : ELEMENTS * n_m]
    delta = -_backwards(r_c, np.swapaxes(q_c.conj(), 1, 2) @ rest.reshape(n_f, -1, 1))[..., 0]
    residual = rest + (coupling @ delta[:, None, :, None])[..., 0]
    numerator = _backwards(r, np.swapaxes(inside + (mixing @ delta[:, None, :, None])[..., 0], 1, 2))
    return _Step(q, r, q_c.reshape(n_f, ELEMENTS, n_m, n_l), r_c, mixing, numerator, delta, residual)


def _judged(shape: Shape, step: _Step) -> Fitted:
    """Leave-one-out errors (I - H_jj)^-1 r_j, with the (4, 4) block of the hat matrix of each sweep.

    Where the other sweeps do not determine the coefficients the error is infinite: a device whose elements depend on
    one another leaves fewer equations than are counted.
    """
    own = np.sum(np.abs(step.q) ** 2, axis=2)  # (f, m)
    block = np.einsum("fajl,fbjl->fjab", step.q_coupling, step.q_coupling.conj())
    block = block + own[:, :, None, None] * np.eye(ELEMENTS)
    leverage = np.einsum("fjaa->fj", block).real / ELEMENTS
    kept = np.eye(ELEMENTS) - block
    size, turn = np.linalg.eigh(np.where(np.isfinite(kept), kept, 0.0))
    seen = np.swapaxes(turn.conj(), 2, 3) @ np.swapaxes(step.residual, 1, 2)[..., None]
    left_out = (turn @ (seen / np.maximum(size, DETERMINED)[..., None]))[..., 0]
    left_out[size[..., 0] < DETERMINED] = np.inf
    return Fitted(shape, step.numerator, step.denominator, left_out, leverage, step.r, step.r_coupling, step.mixing)


def moving_mean(values: np.ndarray) -> np.ndarray:
    """Mean over the `NEIGHBOURS` nearest entries, fewer at the ends."""
    half = NEIGHBOURS // 2
    total = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(len(values))
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, len(values))
    return (total[high] - total[low]) / (high - low)


def _backwards(r: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = b for stacks of triangular factors; a column that says nothing gets no coefficient."""
    if r.shape[-1] == 0:
        return np.zeros((*right.shape[:-2], 0, right.shape[-1]), dtype=complex)
    return np.linalg.solve(_regular(r), right)


def _regular(r: np.ndarray) -> np.ndarray:
    r = r.copy()
    diagonal = np.einsum("fii->fi", r)
    size = np.abs(diagonal).max(axis=1, initial=0.0)[:, None] * 1e-14 + 1e-300
    diagonal[np.abs(diagonal) < size] = np.broadcast_to(size, diagonal.shape)[np.abs(diagonal) < size]
    return r


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
    d = 1.0 + psi @ delta.T  # (p, f)
    y = np.einsum("pk,fke->pfe", phi, numerator) / d[..., None]
    size = np.linalg.norm(y, axis=2)
    scale = 1.0 / (size * np.abs(d))
    inverse = np.linalg.inv(_regular(fitted.r_numerator[rows]))
    u = np.einsum("pk,fkj->pfj", phi, inverse) * scale[..., None]
    leverage = np.sum(np.abs(u) ** 2, axis=2)
    if delta.shape[1]:
        bare = (y * scale[..., None])[..., None] * psi[:, None, None, :]  # (p, f, 4, l)
        projected = bare - np.einsum("pfj,fejl->pfel", u, fitted.mixing[rows])
        c = projected @ np.linalg.inv(_regular(fitted.r_denominator[rows]))[None]
        leverage = leverage + np.mean(np.sum(np.abs(c) ** 2, axis=3), axis=2)
    return Prediction(y, np.abs(d), leverage)


# Which products ------------------------------------------------------------------------------------------------------


def choose_shapes(data: Data, region: np.ndarray) -> list[Shape]:
    """The best shape and its rivals, grown greedily by the lowest leave-one-out error.

    Parameters
    ----------
    data : Data
        Sweeps at the frequencies that decide (some thirty suffice).
    region : (p, d) float
        Points of the region over which |d| is guarded.

    Returns
    -------
    list of Shape
        Best first; at most ``1 + RIVALS``.
    """
    origin = ((0,) * data.x.shape[1],)
    tried: dict[Shape, float] = {}
    shape = Shape(origin, ())
    tried[shape] = fit_shape(data, shape).score
    best, idle = tried[shape], 0
    while idle < _PATIENCE:
        found = _grown(data, shape, tried, region)
        if found is None:
            break
        shape = found
        idle = 0 if tried[shape] < best / SMALLEST_WITHIN else idle + 1
        best = min(best, tried[shape])
    return _ranked(tried)


def _grown(data: Data, shape: Shape, tried: dict[Shape, float], region: np.ndarray) -> Shape | None:
    """The best shape one index larger, or two where one alone gains nothing; None where no freedom is left."""
    singles = [s for s in _larger(shape) if _has_freedom(data, s)]
    found = _best_of(data, singles, tried, region)
    if found is not None and tried[found] < tried[shape] / SMALLEST_WITHIN:
        return found
    pairs = {two for one in singles for two in _larger(one) if two.denominator != shape.denominator}
    second = _best_of(data, [s for s in pairs if _has_freedom(data, s)], tried, region)
    both = [s for s in (found, second) if s is not None]
    return min(both, key=lambda s: (tried[s], s), default=None)


def _larger(shape: Shape) -> list[Shape]:
    n_axes = len(shape.numerator[0])
    upper = [
        Shape(tuple(sorted((*shape.numerator, i))), shape.denominator)
        for i in border(shape.numerator, n_axes, MAX_NUMERATOR_DEGREE)
    ]
    lower = [
        Shape(shape.numerator, tuple(sorted((*shape.denominator, i))))
        for i in border(shape.denominator, n_axes, MAX_DENOMINATOR_DEGREE)
    ]
    return upper + lower


def _has_freedom(data: Data, shape: Shape) -> bool:
    """Whether the sweeps but one still determine the coefficients."""
    m = int(np.min(np.sum(data.weight > 0.0, axis=1)))
    return len(shape.numerator) < m and shape.size <= ELEMENTS * (m - 1)


def _best_of(data: Data, shapes: Sequence[Shape], tried: dict[Shape, float], region: np.ndarray) -> Shape | None:
    for shape in shapes:
        if shape not in tried:
            tried[shape] = _guarded_score(data, shape, region)
    return min(shapes, key=lambda s: (tried[s], s), default=None)


def _guarded_score(data: Data, shape: Shape, region: np.ndarray) -> float:
    fitted = fit_shape(data, shape, passes=2)
    if not np.isfinite(fitted.score):
        return float("inf")
    if shape.denominator:
        at_sweeps = _size_of_denominator(fitted, data.x).min(axis=0)
        elsewhere = _size_of_denominator(fitted, region).min(axis=0)
        if np.any(elsewhere < GUARD * at_sweeps):
            return float("inf")
    return fitted.score


def _size_of_denominator(fitted: Fitted, x: np.ndarray) -> np.ndarray:
    """|d| (p, f)."""
    psi = chebyshev_products(x, fitted.shape.denominator)
    return np.abs(1.0 + psi @ fitted.denominator.T)


def _ranked(tried: dict[Shape, float]) -> list[Shape]:
    """The smallest shape within `SMALLEST_WITHIN` of the best, then the next best."""
    order = sorted((s for s in tried if np.isfinite(tried[s])), key=lambda s: (tried[s], s))
    near = [s for s in order if tried[s] <= SMALLEST_WITHIN * tried[order[0]]]
    chosen = min(near, key=lambda s: (s.size, tried[s], s))
    return [chosen, *[s for s in order if s != chosen][:RIVALS]]
