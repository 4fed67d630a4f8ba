"""How sure the verdict is: the locus is normally distributed, and keeps so many standard errors from zero."""

from __future__ import annotations

from math import erfc, sqrt
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate, spread
from .grids.response import ResponseGrid
from .poles import SURELY, ClosedLoop
from .siso import Grid
from .winding import det

DECIDED = 0.99
"""Probability from which on a verdict is given."""

DECIDED_AT = SURELY
"""Standard errors that make it so."""

_SAME_PLACE = 1e-6  # parts of the lowest |f - f1| to which a pole's place is known at best
_NEAR_POLE = 20.0  # standard errors of a pole of the device's own within which the locus tells nothing


class Doubt(NamedTuple):
    """Probability of being stable, where in the dq frame (Hz) the doubt comes from, in how many standard errors."""

    probability: float
    nu_hz: float
    distance: float


def doubt(model: RationalModel, grid: Grid, loop: ClosedLoop, nu_hz: np.ndarray, stable: bool) -> Doubt:
    """Probability of being stable, given that the locus of the fit says ``stable``.

    A stable loop is in doubt wherever its locus may pass zero on the other side: the least distance counts. An
    unstable one becomes stable only if the locus is wrong at every unstable mode: the surest mode counts.
    """
    nu = nu_hz[(nu_hz >= loop.hole.doubt_from_hz) & (nu_hz <= model.nu_hz[-1])]
    nu = nu[~_on_own_pole(model, loop, nu)]
    distance = locus_distance(model, grid, nu)
    if stable:
        nearest = int(np.argmin(distance))
        return Doubt(_normal(distance[nearest]), float(nu[nearest]), float(distance[nearest]))
    unstable = loop.poles[(loop.poles.real > 0.0) & ~loop.beyond]
    near = [np.abs(2.0 * np.pi * nu - p.imag) <= p.real for p in unstable]
    nearest_ones = [int(np.argmin(np.where(a, distance, np.inf))) for a in near if np.any(a)]
    surest = max(nearest_ones, key=lambda k: distance[k], default=int(np.argmin(distance)))
    return Doubt(_normal(-distance[surest]), float(nu[surest]), float(distance[surest]))


def _on_own_pole(model: RationalModel, loop: ClosedLoop, nu_hz: np.ndarray) -> np.ndarray:
    """(n,) bool: so near to a pole of the device's own that it is not known on which side of the axis it stands.

    The locus is infinite there, and its errors as well. An integrator's pole turns the locus one way or the other, and
    the device counts one unstable mode less or more: the closed loop has the same, unless a mode of it is as near.
    """
    std = np.maximum(np.abs(model.pole_std), _SAME_PLACE * 2.0 * np.pi * model.nu_hz[0])
    far = np.abs(model.poles[:, None] - loop.poles).min(axis=1, initial=np.inf)
    own = np.flatnonzero((np.abs(model.poles.real) < _NEAR_POLE * std) & (far > 2.0 * _NEAR_POLE * std))
    apart = np.abs(2j * np.pi * nu_hz[:, None] - model.poles[own])
    return np.asarray(np.any(apart < _NEAR_POLE * std[own], axis=1))


def locus_distance(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> np.ndarray:
    """How many standard errors (n,) the locus keeps from zero at frequencies |f - f1| (Hz): Mahalanobis distance.

    By the delta method: det M moves by tr(adj(M) dM), M = 1 + Y Z. Near a lightly damped mode it is Re/std of its
    pole, but unlike that it stays well defined where poles crowd and only their combinations are known.
    """
    loop = _matrix(model, grid, 2j * np.pi * nu_hz)
    errors = np.concatenate(locus_errors(model, grid, nu_hz), axis=1)
    real, imag = errors.real, errors.imag
    value = det(loop)
    rounding = 1e-18 * np.sum(np.abs(loop) ** 2, axis=(1, 2)) ** 2  # at nu = 0 the locus is real, and so is its spread
    var_re, var_im = np.sum(real**2, axis=1) + rounding, np.sum(imag**2, axis=1) + rounding
    across = np.sum(real * imag, axis=1)
    squared = var_im * value.real**2 - 2.0 * across * value.real * value.imag + var_re * value.imag**2
    return np.sqrt(np.maximum(squared, 0.0) / np.maximum(var_re * var_im - across**2, 1e-14 * var_re * var_im))


def locus_errors(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What errors of unit variance of device (n, k) and grid (n, j) do to the locus: tr(adj(M) dM)."""
    s = 2j * np.pi * nu_hz
    loop = _matrix(model, grid, s)
    adjugate = np.stack([loop[:, 1, 1], -loop[:, 0, 1], -loop[:, 1, 0], loop[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    if isinstance(grid, ResponseGrid):
        turned = np.swapaxes(adjugate, 1, 2)
        return spread(model, s, turned), grid.spread_admittance(s, turned)
    y, z = evaluate(model, s), grid.impedance_dq(s)
    by_device = spread(model, s, np.swapaxes(z @ adjugate, 1, 2))
    return by_device, grid.spread_dq(s, np.swapaxes(adjugate @ y, 1, 2))


def _matrix(model: RationalModel, grid: Grid, s: np.ndarray) -> np.ndarray:
    """M = 1 + Y Z (n, 2, 2), whose determinant is the locus; Ys + Y of a source whose admittance was measured.

    Its impedance may be infinite on the axis, and its errors as well: det(Ys + Y) is what is counted.
    """
    y = evaluate(model, s)
    return y + grid.admittance_dq(s) if isinstance(grid, ResponseGrid) else np.eye(2) + y @ grid.impedance_dq(s)


def _normal(x: float) -> float:
    """Standard normal distribution function."""
    return 0.5 * erfc(-x / sqrt(2.0))
