"""How far a grid is from the edge: the multiplier of the whole impedance, and of each element by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...identify.fit.rational import RationalModel, evaluate
from ..grids.elements import CableGrid, ElementsGrid, elements_grid, strengths, varied
from ..grids.errors import GridError
from ..grids.promise import Grid
from ..poles import closed_loop_poles, is_beyond

SCALE_RANGE = (0.05, 20.0)
"""Multipliers among which the critical one is sought."""

_POINTS = 600
_REFINED = 25


class ElementEdge(NamedTuple):
    """How much of one element the loop stands.

    Attributes
    ----------
    element, key : str
        The element's name, and which of its numbers is varied.
    value : float
        As given.
    critical : float or None
        The value at which a mode stands on the axis, all else unchanged; None if there is none in reach.
    """

    element: str
    key: str
    value: float
    critical: float | None


def scale_at_the_edge(model: RationalModel, grid: Grid, n_unstable: int) -> float | None:
    """Multiplier of the grid's impedance at which the loop comes to, or from, the edge of stability.

    On the edge det(1 + k Y Z) vanishes at some j w: -1/k is an eigenvalue of Y Z there. Of a stable loop the first k
    above one counts; of an unstable one, on the way down, that which leaves no mode unstable.

    Parameters
    ----------
    model, grid
        Device and grid.
    n_unstable : int
        Unstable closed-loop modes at k = 1, conjugates counted.
    """
    scales = _scales(model, grid)
    if n_unstable == 0:
        above = scales[(scales > 1.0) & (scales <= SCALE_RANGE[1])]
        return float(above.min()) if len(above) else None
    for scale in np.sort(scales[(scales < 1.0) & (scales >= SCALE_RANGE[0])])[::-1]:
        poles = closed_loop_poles(model, grid.scaled(float(scale) * (1.0 - 1e-4)))
        if not np.any(poles.real[~is_beyond(model, poles)] > 0.0):
            return float(scale)
    return None


def _scales(model: RationalModel, grid: Grid) -> np.ndarray:
    """Every k at which an eigenvalue of Y Z is -1/k on the swept axis."""
    end = float(model.nu_hz[-1])
    modes = np.concatenate([model.poles, grid.modes])
    near = np.abs(modes.imag[:, None] + np.abs(modes.real)[:, None] * np.array([-2.0, -0.5, 0.0, 0.5, 2.0])).ravel()
    nu = np.concatenate([np.geomspace(1e-3, end, _POINTS), near / (2.0 * np.pi), model.nu_hz])
    nu = np.unique(nu[(nu > 0.0) & (nu <= end)])
    found = _crossings(model, grid, nu)
    return -1.0 / found[found < 0.0]


def _crossings(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> np.ndarray:
    """Real parts of the eigenvalues of Y Z where they cross the negative real axis, those at f1 among them."""
    values = _eigenvalues(model, grid, nu_hz)
    passing = np.diff(np.signbit(values.imag), axis=0) & (np.minimum(values.real[1:], values.real[:-1]) < 0.0)
    k, branch = np.nonzero(passing)
    found = _refined(model, grid, (nu_hz[k], nu_hz[k + 1]), (values[k, branch], values[k + 1, branch]))
    real = _eigenvalues(model, grid, np.array([1e-6]))[0]
    return np.append(found, real.real[(np.abs(real.imag) < 1e-6 * np.abs(real)) & (real.real < 0.0)])


def _eigenvalues(model: RationalModel, grid: Grid, nu_hz: np.ndarray, followed: bool = True) -> np.ndarray:
    """(n, 2) eigenvalues of Y Z, each followed from point to point, or in any order."""
    s = 2j * np.pi * nu_hz
    gain = evaluate(model, s) @ grid.impedance_dq(s)
    half = (gain[:, 0, 0] + gain[:, 1, 1]) / 2.0
    root = np.sqrt(half**2 - (gain[:, 0, 0] * gain[:, 1, 1] - gain[:, 0, 1] * gain[:, 1, 0]))
    if not followed:
        return np.stack([half + root, half - root], axis=1)
    turned = np.cumprod(np.concatenate([[1.0], np.where((root[1:] * root[:-1].conj()).real < 0.0, -1.0, 1.0)]))
    root = root * turned
    return np.stack([half + root, half - root], axis=1)


def _refined(
    model: RationalModel, grid: Grid, nu_hz: tuple[np.ndarray, np.ndarray], values: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The real values of eigenvalues (m,) where their imaginary parts pass zero between pairs of frequencies (Hz)."""
    (low, high), (before, after) = nu_hz, values
    found = before
    for _ in range(_REFINED if len(low) else 0):
        part = before.imag / (before.imag - after.imag)
        at = np.clip(part, 0.02, 0.98)
        both = _eigenvalues(model, grid, low + at * (high - low), followed=False)
        nearest = np.argmin(np.abs(both - (before + part * (after - before))[:, None]), axis=1)
        found = both[np.arange(len(low)), nearest]
        if np.all(np.abs(found.imag) < 1e-9 * np.abs(found)):
            break
        is_low = (found.imag < 0.0) == (before.imag < 0.0)
        middle = low + at * (high - low)
        low, before = np.where(is_low, middle, low), np.where(is_low, found, before)
        high, after = np.where(is_low, high, middle), np.where(is_low, after, found)
    return found.real[np.abs(found.imag) < 1e-4 * np.abs(found)]


# Element by element --------------------------------------------------------------------------------------------------


def element_edges(model: RationalModel, grid: Grid, stable: bool) -> tuple[ElementEdge, ...]:
    """The critical value of each element of a grid of elements; none for any other grid."""
    if not isinstance(grid, ElementsGrid | CableGrid):
        return ()
    found = []
    for name, (at, key, value) in strengths(grid.document, grid.f1_hz).items():
        with_value = _varying(grid, at, key)
        found.append(ElementEdge(name, key, value, _edge_of(model, with_value, value, stable)))
    return tuple(found)


def _varying(grid: ElementsGrid | CableGrid, at: int, key: str) -> Callable[[float], Grid]:
    def with_value(value: float) -> Grid:
        return elements_grid(varied(grid.document, at, key, value), grid.f1_hz).scaled(grid.scale)

    return with_value


def _edge_of(model: RationalModel, with_value: Callable[[float], Grid], value: float, stable: bool) -> float | None:
    """The nearest value, by ratio, at which the rightmost pole changes sides, sought upwards and downwards."""

    def rightmost(ratio: float) -> float:
        poles = closed_loop_poles(model, with_value(value * ratio))
        return float(poles.real[~is_beyond(model, poles)].max(initial=-np.inf))

    brackets = [found for step in (1.25, 0.8) if (found := _bracket(rightmost, step, stable)) is not None]
    if not brackets:
        return None
    from scipy.optimize import brentq

    inner, outer = min(brackets, key=lambda ends: abs(np.log(ends[1])))
    try:
        return float(value * brentq(rightmost, inner, outer, xtol=1e-6, rtol=1e-6))
    except (GridError, ValueError, np.linalg.LinAlgError):  # a member between cannot be made, or stands on the edge
        return None


def _bracket(rightmost: Callable[[float], float], step: float, stable: bool) -> tuple[float, float] | None:
    """Ratios in powers of ``step`` between which the rightmost pole changes sides; None if it does not in reach."""
    inner = 1.0
    for _ in range(8):
        outer = inner * step
        try:
            if (rightmost(outer) > 0.0) == stable:
                return inner, outer
        except (GridError, np.linalg.LinAlgError):
            return None
        inner = outer
    return None
