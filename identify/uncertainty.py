"""How uncertain a 2x2 is: the scatter of repeated windows, carried to the covariance of Y.

What counts is the residual of a window, ``e = i - Y v``: noise of voltage and current alike end in it. The noise is
taken as circular (stationary noise is) and the experiments as independent, so that all windows of a point speak about
one 2x2 complex covariance.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..plant.errors import SeqsweepError
from .admittance import components
from .response import FrequencyResponse

NORMAL_95 = 1.959964
"""Standard errors on either side of a 95 % interval."""

LEVEL = 0.95
"""Level at which a region computed from the stored covariance with normal quantiles holds."""


def scatter(y: np.ndarray, v: np.ndarray, i: np.ndarray, phi1: float) -> tuple[np.ndarray, int]:
    """Complex covariance of one window's residual, pooled over the experiments, and its degrees of freedom.

    Parameters
    ----------
    y : (2, 2) complex
        Admittance from the means over the windows (S).
    v, i : (n_experiments, n_windows, 2) complex
        Phasors of every window at f and 2 f1 - f (V, A; load direction), at least two windows.
    phi1 : float
        Angle of the fundamental voltage's space vector at time zero (rad).

    Returns
    -------
    covariance : (2, 2) complex
        E[e e^H] of a single window in A^2, components (p at f, conjugate of n at the mirror).
    freedom : int
        Complex degrees of freedom: n_experiments (n_windows - 1).
    """
    residual = np.array(
        [components(i_e, phi1) - y @ components(v_e, phi1) for v_e, i_e in zip(v, i, strict=True)]
    )  # (experiments, 2, windows)
    residual = residual - residual.mean(axis=2, keepdims=True)
    freedom = residual.shape[0] * (residual.shape[2] - 1)
    return np.einsum("eaw,ebw->ab", residual, residual.conj()) / freedom, freedom


def propagate(v: np.ndarray, noise: np.ndarray, phi1: float | np.ndarray) -> np.ndarray:
    """Covariance of Y from the noise of the experiments it was solved from, at one frequency or at many.

    Parameters
    ----------
    v : (..., 2, 2) complex
        Voltages the admittance was solved from (V): row = experiment, column = signed frequency f, 2 f1 - f.
    noise : (2, 2) or (..., 2, 2, 2) complex
        E[e e^H] of an experiment's residual i - Y v (A^2), the same for both or one each.
    phi1 : float or (...,) float
        Angle of the fundamental voltage's space vector at time zero (rad).

    Returns
    -------
    (..., 8, 8) float
        Covariance in S^2 over (re, im) of pp, pn, np, nn.

    Notes
    -----
    With columns for experiments, dY = E V^-1, so cov(Y_ab, Y_cd) = sum_e noise_e[a, c] W_eb conj(W_ed), W = V^-1.
    """
    w = np.linalg.inv(components(v, phi1))
    each = np.broadcast_to(noise, (*v.shape[:-2], 2, 2, 2))
    gamma = np.einsum("...eac,...eb,...ed->...abcd", each, w, w.conj())
    return real_covariance(gamma.reshape(*v.shape[:-2], 4, 4))


def propagate_common(v: np.ndarray, noise: np.ndarray, phi1: float) -> np.ndarray:
    """As `propagate`, for an error ``noise`` (2, 2) that both experiments share: what was subtracted from both."""
    w = np.linalg.inv(components(v, phi1)).sum(axis=0)
    return real_covariance(np.einsum("ac,b,d->abcd", noise, w, w.conj()).reshape(4, 4))


def real_covariance(gamma: np.ndarray) -> np.ndarray:
    """Real covariance (..., 2n, 2n) over (re, im) of a circular complex one (..., n, n), E[z z^H]."""
    n = gamma.shape[-1]
    real = np.empty((*gamma.shape[:-2], 2 * n, 2 * n))
    real[..., 0::2, 0::2] = real[..., 1::2, 1::2] = 0.5 * gamma.real
    real[..., 1::2, 0::2] = 0.5 * gamma.imag
    real[..., 0::2, 1::2] = -0.5 * gamma.imag
    return real


@cache
def student_factor(freedom: float) -> float:
    """Factor on a variance of ``freedom`` complex degrees of freedom, for regions at `LEVEL`.

    A complex number whose variance is estimated lies within a circle of radius^2 = s^2 F(2, 2 freedom); with the
    variance known it would be s^2 chi^2(2)/2. A covariance widened by the ratio gives right regions with normal
    quantiles, however few the windows were (Student's t for a complex number).

    Notes
    -----
    F(2, n) has the closed quantile (n/2) ((1 - level)^(-2/n) - 1), and chi^2(2) is -2 ln(1 - level).
    """
    if freedom < 1:
        raise SeqsweepError(f"{freedom} degrees of freedom: a variance needs at least two windows")
    return float(freedom * ((1.0 - LEVEL) ** (-1.0 / freedom) - 1.0) / -np.log(1.0 - LEVEL))


def relative_uncertainty(response: FrequencyResponse) -> np.ndarray:
    """Standard error of Y over its size, sqrt(trace cov) / ||Y||_F, (n,); NaN where unknown."""
    variance = np.trace(np.asarray(response.covariance), axis1=1, axis2=2)
    return np.asarray(np.sqrt(variance) / np.linalg.norm(response.y, axis=(1, 2)))
