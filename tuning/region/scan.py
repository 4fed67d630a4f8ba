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

_ORDERS = (6, 5)
"""Of the rational functions that follow a mode near the axis into the plane; the second tells how far to trust it."""


class Scan(NamedTuple):
    """What is known of operating points on one grid.

    Attributes
    ----------
    margin_m : (p,) float
        Least m; infinite where nothing crosses 180 degrees.
    margin_low : (p,) float
        m less what the 95 % region of Y leaves open at the crossing, to first order and in the worst direction.
    damping : (p,) float
        -Re(lambda)/|lambda| of the critical mode, in the phase frame's distance from f1; infinite without one.
    mode : (p,) complex
        The critical mode lambda (rad/s, dq frame, Im > 0): of those at the crossings the least damped; NaN without one.
    mode_radius : (p,) float
        How far it may be off (rad/s): the 95 % region of Y, to first order and in the worst direction, and what two
        rational functions through the rows near it differ by; infinite without one.
    sure : (p,) float
        Distance of the verdict from being another one, in radii of the modes that decide it: positive where all modes
        at crossings decay, negative where one grows; infinite without a crossing.
    """

    margin_m: np.ndarray
    margin_low: np.ndarray
    damping: np.ndarray
    mode: np.ndarray
    mode_radius: np.ndarray
    sure: np.ndarray

    @classmethod
    def of_none(cls) -> Scan:
        """No operating point."""
        none = np.zeros(0)
        return cls(none, none, none, none.astype(complex), none, none)


def scan(surrogate: Surrogate, grid: Grid, points: np.ndarray) -> Scan:
    """Margin, its lower bound, damping and mode at operating points (p, d) of the region on a grid."""
    found = surrogate.evaluate(points)
    return scan_rows(surrogate.nu_hz, found.y, found.radius, grid)


def scan_rows(nu_hz: np.ndarray, y_dq: np.ndarray, radius: np.ndarray, grid: Grid) -> Scan:
    """The same of admittances (p, f, 2, 2) in the dq frame at |f - f1| (f,); ``radius`` (p, f): their 95 % region."""
    n = len(y_dq)
    y = dq_to_pn(y_dq)
    flat = siso(np.tile(grid.f1_hz + nu_hz, n), y.reshape(-1, 2, 2), grid)
    y1, yg1, yg2 = (part.reshape(n, -1) for part in (flat.y1, flat.yg1, flat.yg2))
    log_ratio = np.log(-y1 / yg1)
    log_ratio = log_ratio.real + 1j * np.unwrap(log_ratio.imag, axis=1)
    at = _crossings(np.log(nu_hz), log_ratio)
    wide = radius * (1.0 + np.abs(y[..., 0, 1] / (y[..., 1, 1] + yg2)))
    wide = wide * (1.0 + np.abs(y[..., 1, 0] / (y[..., 1, 1] + yg2))) / np.abs(y1)
    return _least(nu_hz, at, wide, y1, y1 + yg1)


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


def _least(nu_hz: np.ndarray, at: _Crossing, wide: np.ndarray, y1: np.ndarray, loop: np.ndarray) -> Scan:
    """Of each point's crossings the one with the least m, and the mode with the least damping."""
    n = len(loop)
    margin, low, damping, radius, sure = (np.full(n, np.inf) for _ in range(5))
    mode = np.full(n, np.nan, dtype=complex)
    off = np.maximum(wide[at.point, at.interval], wide[at.point, at.interval + 1])
    first = _first_of_each(at.point, at.m)
    margin[at.point[first]] = at.m[first]
    leaning = np.hypot(1.0, at.lean[first])
    low[at.point[first]] = at.m[first] * np.maximum(1.0 - off[first] * leaning, 0.0)
    found, slope = _modes(nu_hz, at, loop, _ORDERS[0])
    other, _ = _modes(nu_hz, at, loop, _ORDERS[1])
    unsure = np.hypot(off * np.abs(y1[at.point, at.interval]) / slope, np.abs(found - other)) + 1e-12
    ratio = -found.real / np.abs(found)
    critical = _first_of_each(at.point, ratio)
    point = at.point[critical]
    damping[point], mode[point], radius[point] = ratio[critical], found[critical], unsure[critical]
    np.minimum.at(sure, at.point, np.where(found.real < 0.0, -found.real / unsure, np.inf))
    growing = np.zeros(n)
    np.maximum.at(growing, at.point, np.maximum(found.real, 0.0) / unsure)
    return Scan(margin, low, damping, mode, radius, np.where(growing > 0.0, -growing, sure))


def _first_of_each(point: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Indices of the least value of each point."""
    order = np.lexsort((value, point))
    return order[np.concatenate([[True], np.diff(point[order]) > 0])] if len(order) else order


def _modes(nu_hz: np.ndarray, at: _Crossing, loop: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """The zero (rad/s) of Y1 + Yg1 near each crossing, and |d(Y1 + Yg1)/ds| there, by a rational function of the rows.

    Numerator and denominator of degree n pass through 2 n + 3 rows about the crossing, in least squares.
    """
    order = max(1, min(order, (len(nu_hz) - 3) // 2))
    count = min(2 * order + 3, len(nu_hz))
    first = np.clip(at.interval - count // 2 + 1, 0, len(nu_hz) - count)
    rows = first[:, None] + np.arange(count)
    scale = np.exp(at.log_nu)
    x = (nu_hz[rows] - scale[:, None]) / scale[:, None]  # s = j 2 pi scale (1 + x)
    values = np.take_along_axis(loop[at.point], rows, axis=1)
    powers = x[..., None] ** np.arange(order + 1)
    system = np.concatenate([powers, -values[..., None] * powers], axis=2) / np.abs(values)[..., None]
    numerator, denominator = np.split(np.linalg.svd(system)[2][:, -1].conj(), 2, axis=1)
    zeros = _nearest_zeros(numerator)
    degrees = np.arange(1, order + 1)
    rising = np.sum(numerator[:, 1:] * degrees * zeros[:, None] ** (degrees - 1), axis=1)
    slope = np.abs(rising / np.sum(denominator * zeros[:, None] ** np.arange(order + 1), axis=1))
    return 2j * np.pi * scale * (1.0 + zeros), slope / (2.0 * np.pi * scale)


def _nearest_zeros(polynomials: np.ndarray) -> np.ndarray:
    """(n,) of polynomials (n, degree + 1) in x, rising, the zeros nearest to x = 0: eigenvalues of their companions."""
    degree = polynomials.shape[1] - 1
    leading = polynomials[:, -1:]
    monic = polynomials[:, :-1] / np.where(np.abs(leading) > 1e-12, leading, 1e-12)
    companion = np.tile(np.eye(degree, k=-1, dtype=complex), (len(polynomials), 1, 1))
    companion[:, :, -1] = -monic
    zeros = np.linalg.eigvals(companion)
    return np.asarray(np.take_along_axis(zeros, np.abs(zeros).argmin(axis=1)[:, None], axis=1)[:, 0])
