"""The Bode criterion of the paper: where Y1/Yg1 and Y2/Yg2 pass 180 degrees, and with which margin."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .siso import Grid, impedance_pn, siso

Admittance = Callable[[np.ndarray], np.ndarray]


class Crossing(NamedTuple):
    """Where Y1/Yg1 (component 1) or Y2/Yg2 (component 2) passes 180 degrees.

    Attributes
    ----------
    component : 1 or 2
        SISO equivalent.
    f_hz : float
        Frequency of the first component (Hz).
    m : float
        Magnitude margin |Yg / Y|; below one the plain Bode criterion alarms.
    rising : bool
        True if the phase of Y/Yg rises through 180 degrees.
    """

    component: int
    f_hz: float
    m: float
    rising: bool


def bode_crossings(admittance: Admittance, grid: Grid, f_min_hz: float, f_max_hz: float) -> tuple[Crossing, ...]:
    """Every frequency in a band at which Y1/Yg1 or Y2/Yg2 is real and negative.

    Parameters
    ----------
    admittance : callable
        Frequencies (n,) in Hz to Ypn (n, 2, 2) in S.
    grid : Grid
        The grid.
    f_min_hz, f_max_hz : float
        Positive band (Hz).

    Notes
    -----
    The paper's criterion, Section II-B: |Y| > |Yg| at a phase difference of 180 degrees means instability.
    """
    f = _bode_grid(grid.f1_hz, f_min_hz, f_max_hz)
    ratios = _ratios(admittance, grid, f)
    found = [c for component in (0, 1) for c in _crossings_of(admittance, grid, component, f, ratios[component])]
    return tuple(sorted(found, key=lambda c: c.f_hz))


def critical_crossing(crossings: tuple[Crossing, ...], f1_hz: float) -> Crossing | None:
    """Crossing of Y1 above f1 with the smallest m; that of Y2 below f1 is its mirror image. None if there is none."""
    return min((c for c in crossings if c.component == 1 and c.f_hz > f1_hz), key=lambda c: c.m, default=None)


def _bode_grid(f1_hz: float, f_min_hz: float, f_max_hz: float) -> np.ndarray:
    """Logarithmic over the band, and logarithmic in the distance from f1 on both sides."""
    distance = np.logspace(-2.0, np.log10(max(f_max_hz - f1_hz, f1_hz)), 300)
    f = np.concatenate([np.geomspace(f_min_hz, f_max_hz, 300), f1_hz - distance, f1_hz + distance])
    return np.unique(f[(f >= f_min_hz) & (f <= f_max_hz)])


def _ratios(admittance: Admittance, grid: Grid, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Y1/Yg1 = Y1 Zg1 and Y2/Yg2 = Y2 Zg2."""
    pair = siso(f_hz, admittance(f_hz), grid)
    if grid.couples:
        return pair.y1 / pair.yg1, pair.y2 / pair.yg2
    z1, z2 = impedance_pn(grid, f_hz)  # zero where Yg of a lossless grid is infinite
    return pair.y1 * z1, pair.y2 * z2


def _crossings_of(
    admittance: Admittance, grid: Grid, component: int, f_hz: np.ndarray, ratio: np.ndarray
) -> list[Crossing]:
    found = []
    for k in np.flatnonzero(np.diff(np.signbit(ratio.imag)) & (np.minimum(ratio.real[1:], ratio.real[:-1]) < 0.0)):
        f, q = f_hz[k : k + 2], ratio[k : k + 2]
        for _ in range(2):  # twice 32 parts and a straight line: 1e-7 of the first bracket
            f = np.linspace(f[0], f[-1], 33)
            q = _ratios(admittance, grid, f)[component]
            j = int(np.flatnonzero(np.diff(np.signbit(q.imag)))[0])
            f, q = f[j : j + 2], q[j : j + 2]
        part = q.imag[0] / (q.imag[0] - q.imag[1])
        at = q.real[0] + part * (q.real[1] - q.real[0])
        if at < 0.0 and np.abs(q).max() < 1e3 * np.abs(ratio[k : k + 2]).max():
            found.append(
                Crossing(component + 1, float(f[0] + part * (f[1] - f[0])), float(-1.0 / at), bool(q.imag[0] > 0.0))
            )
    return found
