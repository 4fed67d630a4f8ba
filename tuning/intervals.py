"""How far margin and critical scale may be off: 95 % intervals from the covariance of the fit.

Both are ``-1/q`` where a loop gain q, moving along frequency, is real and negative: Y1 Zg1 for m, an eigenvalue of Y Z
for the critical scale. When the parameters move, q moves and so does the frequency at which it is real (delta method).
The same is done at the two ends of the interval, following the crossing; where that does not agree, as near a fold of
the crossing, the admittance is drawn at random.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate, evaluate_pn, n_errors, spread, with_errors
from ..identify.frames import T_INVERSE, T, dq_to_pn
from ..identify.uncertainty import NORMAL_95
from .crossings import Crossing
from .poles import closed_loop_poles, is_beyond
from .siso import Grid, impedance_dq, impedance_pn, siso

_LINEAR = 0.25  # ends may differ from the delta method's by this part of the half width
_DRAWS = 400
_SEARCHED = 400  # frequencies at which a drawn admittance is looked at
_STEP = 1e-5  # relative step of the derivative along frequency

Admittance = Callable[[np.ndarray], np.ndarray]
Gain = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Interval(NamedTuple):
    """What is known of a positive number.

    Attributes
    ----------
    std : float
        Standard error by the delta method.
    low, high : float or None
        Ends of the 95 % interval; None if ``high`` has no bound: the crossing may not exist.
    """

    std: float
    low: float
    high: float | None


def margin_interval(model: RationalModel, grid: Grid, crossing: Crossing) -> Interval:
    """Interval of m = |Yg1/Y1| at a crossing of component 1."""
    f = np.array([crossing.f_hz])
    weight = (_effect_on_y1(model, grid, f) * impedance_pn(grid, f)[0])[0]

    def gain(y_dq: np.ndarray, nu_hz: np.ndarray) -> np.ndarray:
        f = nu_hz + model.f1_hz
        return siso(f, dq_to_pn(y_dq), grid).y1 * impedance_pn(grid, f)[0]

    return interval_at(model, gain, crossing.f_hz - model.f1_hz, weight)


def relative_error_of_y1(model: RationalModel, grid: Grid, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard errors of ln|Y1| and of its angle (rad), both (n,), at frequencies (n,) in Hz."""
    y1 = siso(f_hz, evaluate_pn(model, f_hz), grid).y1
    weight = _effect_on_y1(model, grid, f_hz) / y1[:, None, None]
    errors = spread(model, 2j * np.pi * (f_hz - model.f1_hz), weight)
    return np.linalg.norm(errors.real, axis=1), np.linalg.norm(errors.imag, axis=1)


def _effect_on_y1(model: RationalModel, grid: Grid, f_hz: np.ndarray) -> np.ndarray:
    """dY1/dYdq (n, 2, 2): dY1 = [1, -Ypn Z2/(1 + Ynn Z2)] dY [1, -Ynp Z2/(1 + Ynn Z2)]^T, from paper eq. 3."""
    y = evaluate_pn(model, f_hz)
    z2 = impedance_pn(grid, f_hz)[1]
    reduced = z2 / (1.0 + y[:, 1, 1] * z2)
    one = np.ones_like(z2)
    left = np.stack([one, -y[:, 0, 1] * reduced], axis=1) @ T
    right = np.stack([one, -y[:, 1, 0] * reduced], axis=1) @ T_INVERSE.T
    return np.asarray(left[:, :, None] * right[:, None, :])


def scale_interval(model: RationalModel, grid: Grid, scale: float) -> Interval:
    """Interval of the critical multiplier of the grid impedance, det(1 + scale Y Z) = 0 at s = j w."""
    poles = closed_loop_poles(model, grid.scaled(scale))
    poles = poles[~is_beyond(model, poles)]
    nu = float(abs(poles[np.argmax(poles.real)].imag)) / (2.0 * np.pi)
    s = np.array([2j * np.pi * nu])
    z = impedance_dq(grid, s)[0]
    values, right = np.linalg.eig(evaluate(model, s)[0] @ z)
    k = int(np.argmin(np.abs(values + 1.0 / scale)))
    left = np.linalg.inv(right)[k]
    weight = np.outer(left, z @ right[:, k])

    def gain(y_dq: np.ndarray, nu_hz: np.ndarray) -> np.ndarray:
        both = np.linalg.eigvals(y_dq @ impedance_dq(grid, 2j * np.pi * nu_hz))
        nearest = np.argmin(np.abs(both + 1.0 / scale), axis=1)
        return both[np.arange(len(nu_hz)), nearest]

    return interval_at(model, gain, nu, weight)


def interval_at(model: RationalModel, gain: Gain, nu_hz: float, weight: np.ndarray) -> Interval:
    """Interval of -1/q at the frequency ``nu_hz`` (Hz, dq) where q is real and negative.

    ``gain`` gives q (n,) of Ydq (n, 2, 2) at frequencies (n,) in Hz, dq; ``weight`` (2, 2) is dq/dYdq at ``nu_hz``
    (ohm).
    """
    value, slope = _value_and_slope(lambda nu: evaluate(model, 2j * np.pi * nu), gain, nu_hz)
    errors = spread(model, np.array([2j * np.pi * nu_hz]), weight[None])[0]
    along = slope.real / slope.imag if slope.imag != 0.0 else 0.0  # at nu = 0 q is real whatever the parameters
    effect = (errors.real - along * errors.imag) / value.real**2
    std = float(np.linalg.norm(effect))
    middle = -1.0 / value.real
    if std <= model.noise_floor * middle:  # the fit itself is no better than that
        return Interval(std, middle - NORMAL_95 * std, middle + NORMAL_95 * std)
    step = NORMAL_95 * effect / std
    ends = np.array([_followed(partial(_moved, model, sign * step), gain, nu_hz) for sign in (-1.0, 1.0)])
    expected = middle + np.array([-1.0, 1.0]) * NORMAL_95 * std
    if np.all(np.abs(ends - expected) <= _LINEAR * NORMAL_95 * std):
        return Interval(std, float(ends[0]), float(ends[1]))
    return _drawn(model, gain, nu_hz, std)


def _value_and_slope(admittance: Admittance, gain: Gain, nu_hz: float) -> tuple[complex, complex]:
    step = _STEP * nu_hz
    nu = nu_hz + np.array([-step, 0.0, step])
    below, value, above = gain(admittance(nu), nu)
    return complex(value), complex((above - below) / (2.0 * step)) if step > 0.0 else 0j


def _moved(model: RationalModel, errors: np.ndarray, nu_hz: np.ndarray) -> np.ndarray:
    return with_errors(model, 2j * np.pi * nu_hz, errors)


def _followed(admittance: Admittance, gain: Gain, nu_hz: float) -> float:
    """-1/q at the crossing that Newton's method finds from ``nu_hz``; NaN if it finds none nearby."""
    at = nu_hz
    for _ in range(8):
        value, slope = _value_and_slope(admittance, gain, at)
        if slope.imag == 0.0 or abs(value.imag) < 1e-9 * abs(value):
            break
        at -= value.imag / slope.imag
        if not 0.5 * nu_hz < at < 2.0 * nu_hz:
            return float("nan")
    value = complex(gain(admittance(np.array([at])), np.array([at]))[0])
    real = abs(value.imag) < 1e-6 * abs(value) and value.real < 0.0
    return -1.0 / value.real if real else float("nan")


def _drawn(model: RationalModel, gain: Gain, nu_hz: float, std: float) -> Interval:
    """Quantiles over admittances drawn from the fit's distribution; one without a crossing counts as infinite."""
    normal = np.random.default_rng(0).standard_normal((_DRAWS, n_errors(model)))
    nu = np.geomspace(0.5 * nu_hz, 2.0 * nu_hz, _SEARCHED) if nu_hz > 0.0 else np.zeros(1)
    at = _smallest if nu_hz > 0.0 else _at_zero
    found = [at(gain(y, nu)) for y in _moved(model, normal, nu)]
    low, high = np.quantile(found, [0.025, 0.975], method="inverted_cdf")
    return Interval(std, float(low), float(high) if np.isfinite(high) else None)


def _at_zero(q: np.ndarray) -> float:
    """-1/q at nu = 0, where q is real whatever the parameters; infinite if it is positive."""
    return float(-1.0 / q[0].real) if q[0].real < 0.0 else float("inf")


def _smallest(q: np.ndarray) -> float:
    """Smallest -1/q among the places where q passes the negative real axis; infinite if there is none."""
    k = np.flatnonzero(np.diff(np.signbit(q.imag)))
    part = q.imag[k] / (q.imag[k] - q.imag[k + 1])
    real = q.real[k] + part * (q.real[k + 1] - q.real[k])
    return float(np.min(-1.0 / real[real < 0.0], initial=np.inf))
