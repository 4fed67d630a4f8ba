"""Margin, damping and their doubt at many operating points at once, from the surrogate's own frequencies.

A scan ranks points; what it finds is judged as a whole afterwards (`tune_point`). The margin m (paper eqs. 3 and 4) is
|Yg1/Y1| where Y1/Yg1 passes 180 degrees above f1; between the frequencies log(Y1/Yg1) is a cubic spline over
log|f - f1|.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...identify.frames import dq_to_pn
from ...identify.surrogate.surrogate import Surrogate
from ..siso import Grid, siso

_BISECTIONS = 40
_WINDOW = 9  # rows by which a mode near the axis is followed into the plane
_ORDER = 3  # of the rational function through them


class Scan(NamedTuple):
    """What is known of operating points on one grid.

    Attributes
    ----------
    margin_m : (p,) float
        Least m; infinite where nothing crosses 180 degrees.
    margin_low : (p,) float
        m less what the 95 % region of Y leaves open at the crossing, to first order and in the worst direction.
    damping : (p,) float
        -Re(lambda)/|lambda| in the phase frame's distance from f1, of the mode at the crossing; infinite without one.
    """

    margin_m: np.ndarray
    margin_low: np.ndarray
    damping: np.ndarray


def scan(surrogate: Surrogate, grid: Grid, points: np.ndarray) -> Scan:
    """Margin, its lower bound and damping at operating points (p, d) of the region on a grid."""
    found = surrogate.evaluate(points)
    nu_hz, n = surrogate.nu_hz, len(points)
    y = dq_to_pn(found.y)
    f_hz = np.tile(grid.f1_hz + nu_hz, n)
    flat = siso(f_hz, y.reshape(-1, 2, 2), grid)
    y1, yg1, yg2 = (part.reshape(n, -1) for part in (flat.y1, flat.yg1, flat.yg2))
    log_ratio = np.log(-y1 / yg1)
    log_ratio = log_ratio.real + 1j * np.unwrap(log_ratio.imag, axis=1)
    at = _crossings(np.log(nu_hz), log_ratio)
    wide = found.radius * (1.0 + np.abs(y[..., 0, 1] / (y[..., 1, 1] + yg2)))
    wide = wide * (1.0 + np.abs(y[..., 1, 0] / (y[..., 1, 1] + yg2))) / np.abs(y1)
    return _least(nu_hz, at, wide, y1 + yg1, n)


class _Crossing(NamedTuple):
    """Crossings of all points: which point, which interval of frequencies, log|f - f1|, m, and how m leans."""

    point: np.ndarray
    interval: np.ndarray
    log_nu: np.ndarray
    m: np.ndarray
    lean: np.ndarray


def _crossings(log_nu: np.ndarray, log_ratio: np.ndarray) -> _Crossing:
    """Where the angle is a whole number of turns; a turn of -Y1/Yg1 is 180 degrees of Y1/Yg1."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(log_nu, log_ratio, axis=1)
    turns = np.floor(log_ratio.imag / (2.0 * np.pi))
    point, interval = np.nonzero(np.diff(turns, axis=1) != 0)
    whole = 2.0 * np.pi * np.maximum(turns[point, interval], turns[point, interval + 1])
    c = spline.c[:, interval, point]  # (4, crossings)
    width = (log_nu[1:] - log_nu[:-1])[interval]
    rising = log_ratio.imag[point, interval + 1] > log_ratio.imag[point, interval]
    low, high = np.zeros_like(width), width.copy()
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = (_cubic(c, middle).imag < whole) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    slope = (3.0 * c[0] * low + 2.0 * c[1]) * low + c[2]
    lean = np.abs(slope.real) / np.maximum(np.abs(slope.imag), 1e-12)
    return _Crossing(point, interval, log_nu[interval] + low, np.exp(-_cubic(c, low).real), lean)


def _cubic(c: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.asarray(((c[0] * x + c[1]) * x + c[2]) * x + c[3])


def _least(nu_hz: np.ndarray, at: _Crossing, wide: np.ndarray, loop: np.ndarray, n: int) -> Scan:
    """Of each point's crossings the one with the least m."""
    margin, low, damping = (np.full(n, np.inf) for _ in range(3))
    order = np.lexsort((at.m, at.point))
    first = order[np.concatenate([[True], np.diff(at.point[order]) > 0])] if len(order) else order
    point, interval = at.point[first], at.interval[first]
    doubt = np.maximum(wide[point, interval], wide[point, interval + 1]) * np.hypot(1.0, at.lean[first])
    margin[point] = at.m[first]
    low[point] = at.m[first] * np.maximum(1.0 - doubt, 0.0)
    damping[point] = _dampings(nu_hz, np.exp(at.log_nu[first]), loop[point], interval)
    return Scan(margin, low, damping)


def _dampings(nu_hz: np.ndarray, at_hz: np.ndarray, loop: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """Damping ratio in the dq frame of the zero of Y1 + Yg1 near each crossing, by a rational function."""
    first = np.clip(interval - _WINDOW // 2 + 1, 0, max(len(nu_hz) - _WINDOW, 0))
    rows = first[:, None] + np.arange(min(_WINDOW, len(nu_hz)))
    scale = at_hz[:, None]
    x = (nu_hz[rows] - scale) / scale  # s = j 2 pi at_hz (1 + x)
    values = np.take_along_axis(loop, rows, axis=1)
    powers = x[..., None] ** np.arange(_ORDER + 1)
    system = np.concatenate([powers, -values[..., None] * powers], axis=2) / np.abs(values)[..., None]
    coefficients = np.linalg.svd(system)[2][:, -1].conj()[:, : _ORDER + 1]
    return np.array([_nearest_damping(c) for c in coefficients])


def _nearest_damping(coefficients: np.ndarray) -> float:
    """Of the numerator's zeros x, s proportional to j (1 + x), the one nearest to the crossing."""
    zeros = np.roots(coefficients[::-1])
    if len(zeros) == 0:
        return float("inf")
    s = 1j * (1.0 + zeros[np.argmin(np.abs(zeros))])
    return float(-s.real / abs(s))
