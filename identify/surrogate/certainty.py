"""How far a prediction may be wrong: leave-one-out errors, leverage, rivals and the rows' own noise joined.

Three things are added in squares, each relative to ||Y||:

* what the sweeps themselves show. Left out, sweep j is missed by e_j at a leverage h_j / (1 - h_j); a point x with the
  leverage h(x) is therefore missed by about ``sqrt(mean(|e_j|^2 (1 - h_j) / h_j) h(x))``, the mean taken over the
  sweeps, by `what_each_tells`, and over neighbouring frequencies. What the model lacks does not vanish with the
  leverage: at x itself it is about as much as at the sweeps, ``mean(|e_j|^2 (1 - h_j))``. Each of the two would explain
  all of the sweeps' errors alone, and their sum would count them twice: `_BY_LEVERAGE` and `_EVERYWHERE` are the shares
  that they are given;
* the rows' own noise, where the table states it, carried to x by the same leverage; it replaces the first where it is
  larger, because a mean over few sweeps may be small by luck;
* the spread of the rivals: models of other products that describe the sweeps nearly as well.

The sum is a standard error of few degrees of freedom; its `factor` makes it the radius of a 95 % region.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .sparse_rational import ELEMENTS, Data, Fitted, Prediction, moving_mean

_REAL = 2.0 * ELEMENTS  # real numbers of an error: four complex elements
_FREE = 1.5
"""Independent real numbers that a free sweep tells of the model's error: its elements and frequencies err together."""

_BY_LEVERAGE, _EVERYWHERE = 0.25, 0.5
"""Shares of the two laws of the error. By leverage alone designs with few free sweeps held at 88 % of all places, and
with both in full almost all places of most designs did (99.4 % in the mean): 70 designs by lot, sweeps counted alike.
"""

_EXPLAINED, _LACKING = 1.5, 2.0
"""Multiples of the stated variance: errors below the first are noise, those from the second on are the model's."""

_LEAST_LEVERAGE = 0.02  # a leverage below is as good as none; it keeps the quotient of two small numbers bounded


class Certainty(NamedTuple):
    """What a leverage stands for.

    Attributes
    ----------
    variance : (f,) float
        Variance over all four elements, relative to ||Y||^2, at a leverage of one.
    lacking : (f,) float
        That of what the model lacks anywhere, whatever the leverage.
    factor : (f,) float
        Radius of a 95 % region in standard errors.
    rounding : float
        The least radius: every product of the model is rounded once.
    """

    variance: np.ndarray
    lacking: np.ndarray
    factor: np.ndarray
    rounding: float


def what_each_tells(fitted: Fitted, data: Data) -> np.ndarray:
    """(f, m) weights 1 - h_j of the sweeps in the means of a 95 % region: the degrees of freedom that each leaves.

    Under noise ``|e_j|^2 (1 - h_j)`` is the variance in the mean at every sweep, and with these weights its mean over
    the sweeps is the residual sum of squares over the degrees of freedom. Under what the model lacks it is the variance
    only where h_j is small: a sweep of h_j near one holds a corner alone, the model extrapolates without it, and there
    what is lacking grows faster than noise. Counted alike, such sweeps make the radius too wide everywhere.
    """
    return np.where(data.weight > 0.0, 1.0 - _bounded(fitted.leverage), 0.0)


def all_alike(fitted: Fitted, data: Data) -> np.ndarray:
    """(f, m) weights of one: the sweep that is missed most counts in full, and the radius is on the safe side.

    Sweeps are placed, regions certified and borders of jumps found with it; as a 95 % region it is too wide.
    """
    return np.where(data.weight > 0.0, 1.0, 0.0)


def free_sweeps(fitted: Fitted, data: Data) -> float:
    """Sweeps beyond those that the products of the model take up."""
    return data.x.shape[0] - len(fitted.shape.numerator) - len(fitted.shape.denominator) / ELEMENTS


def _bounded(leverage: np.ndarray) -> np.ndarray:
    return np.clip(leverage, _LEAST_LEVERAGE, 1.0)


def certainty(fitted: Fitted, data: Data, noise: np.ndarray | None, weight: np.ndarray) -> Certainty:
    """How sure the sweeps and the rows' noise make the model.

    Parameters
    ----------
    fitted : Fitted
        The model.
    data : Data
        The sweeps it was fitted to.
    noise : (f, m) float or None
        Variance of a row over its four elements, relative to ||Y||^2; None: not known.
    weight : (f, m) float
        How much each sweep counts in the means: `what_each_tells` or `all_alike`.

    Notes
    -----
    Noise alone makes leave-one-out errors with ``E |e|^2 (1 - h) = variance``. The part of that which the rows state is
    noise of known size, eight real numbers wide; the rest is the model's error, of a size known from few sweeps only.
    """
    used = data.weight > 0.0
    count = np.maximum(used.sum(axis=1), 1)
    h = _bounded(fitted.leverage)
    total = np.maximum(weight.sum(axis=1), 1e-300)
    squared = np.where(used, weight * np.sum(np.abs(fitted.left_out) ** 2, axis=2) * (1.0 - h), 0.0)
    unsure = _quantile(_REAL, _FREE * max(free_sweeps(fitted, data), 0.5))
    missed = _BY_LEVERAGE * moving_mean((squared / h).sum(axis=1) / total)
    found = np.maximum(moving_mean(squared.sum(axis=1) / total), 1e-300)
    rounding = (len(fitted.shape.numerator) + len(fitted.shape.denominator)) * float(np.finfo(float).eps)
    if noise is None:
        return Certainty(missed, _EVERYWHERE * found, np.full(len(missed), unsure), rounding)
    stated = moving_mean(np.where(used, noise, 0.0).sum(axis=1) / count)
    share = np.clip((_LACKING * stated - found) / np.maximum((_LACKING - _EXPLAINED) * stated, 1e-300), 0.0, 1.0)
    variance = np.maximum(stated, (1.0 - share) * missed + share * stated)
    factor = share * _quantile(ELEMENTS, 1e6) + (1.0 - share) * unsure
    return Certainty(variance, _EVERYWHERE * (1.0 - share) * found, factor, rounding)


def _quantile(numerator: float, denominator: float) -> float:
    """Root of the 95 % quantile of F."""
    from scipy.special import fdtri

    return float(np.sqrt(fdtri(numerator, denominator, 0.95)))


def relative_error(
    prediction: Prediction, sure: Certainty, rivals: Sequence[Prediction], worse: Sequence[float]
) -> np.ndarray:
    """(p, f) radius of the 95 % region of Y, relative to ||Y||_F.

    ``worse`` are the rivals' leave-one-out errors in multiples of the chosen model's: a rival that describes the sweeps
    worse differs for that reason, and counts for less. What noise alone sets a rival apart by, the difference of the
    leverages times the variance, is not counted a second time.
    """
    size = np.linalg.norm(prediction.y, axis=2)
    spread = np.zeros_like(size)
    for rival, ratio in zip(rivals, worse, strict=True):
        apart = np.sum(np.abs(rival.y - prediction.y) ** 2, axis=2) / size**2
        noise = sure.variance * np.abs(rival.leverage - prediction.leverage)
        spread += np.maximum(apart - noise, 0.0) / max(ratio, 1.0) ** 2 / len(rivals)
    return np.hypot(sure.factor * np.sqrt(sure.variance * prediction.leverage + sure.lacking + spread), sure.rounding)
