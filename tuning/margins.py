"""How far from the edge: margins of the locus, the critical grid, passivity, and who takes part in the mode."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate, evaluate_pn
from ..identify.frames import T_INVERSE, T, dq_to_pn
from .poles import closed_loop_poles, is_beyond, mode_shape
from .siso import Grid, impedance_dq

SCALE_RANGE = (0.05, 20.0)
"""Multipliers of the grid impedance among which the critical one is sought."""

ELEMENTS = ("pp", "pn", "np", "nn")

_SCAN_STEP = 1.15
_BACK_STEP = 0.36
_CLEAR = 1.001  # so far inside a stable range its other end is looked for


class LocusMargins(NamedTuple):
    """Distances of the winding locus, normalised to det(Y + Yg)/det(Yg) = 1 + l, from zero.

    Attributes
    ----------
    gain : float or None
        1/|l| where l is real and negative, the one nearest to one; None without such a crossing.
    phase_deg : float or None
        Smallest angle between l and the negative real axis where |l| = 1 (degrees).
    vector : float
        Smallest |1 + l|.
    f_vector_hz : float
        Where that is, above f1 (Hz); its mirror image is 2 f1 - f.
    """

    gain: float | None
    phase_deg: float | None
    vector: float
    f_vector_hz: float


class Passivity(NamedTuple):
    """Smallest eigenvalue of the Hermitian part of Y.

    Attributes
    ----------
    f_hz : (n,) float
        Frequency (Hz).
    index_s : (n,) float
        Passivity index (S); the device takes power at this frequency where it is positive.
    """

    f_hz: np.ndarray
    index_s: np.ndarray


class Participation(NamedTuple):
    """What the resonance mode is made of.

    Attributes
    ----------
    elements : dict of str to float
        Share of pp, pn, np, nn: relative effect on the pole of a relative change of that element; adds up to one.
    strongest : str
        The element with the largest share.
    current_ratio : float
        |i(f1 + nu)| / |i(f1 - nu)| of the mode: above one the component above f1 is the stronger one.
    f_hz : float
        Frequency of the stronger component (Hz).
    """

    elements: dict[str, float]
    strongest: str
    current_ratio: float
    f_hz: float


def locus_margins(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> LocusMargins:
    """Gain, phase and vector margin of det(1 + Y Z) = det(Y + Yg)/det(Yg) inside the swept band.

    ``nu_hz`` (n,) are the refined frequencies of the winding locus. The determinant is not proportional to the
    grid's size: its gain margin is a distance, the grid that can be stood is `critical_scale`.
    """
    nu = nu_hz[(nu_hz >= model.nu_hz[0]) & (nu_hz <= model.nu_hz[-1])]
    s = 2j * np.pi * nu
    value = np.linalg.det(np.eye(2) + evaluate(model, s) @ impedance_dq(grid, s))
    loop = value - 1.0
    nearest = int(np.argmin(np.abs(value)))
    return LocusMargins(
        gain=_gain_margin(loop),
        phase_deg=_phase_margin_deg(loop),
        vector=float(np.abs(value[nearest])),
        f_vector_hz=float(model.f1_hz + nu[nearest]),
    )


class StableRange(NamedTuple):
    """Multipliers of the grid impedance between which the loop is stable, the device's admittance being held.

    Attributes
    ----------
    low, high : float or None
        Ends of the stable range that holds one, or of the nearest one where the loop is unstable: the strongest and
        the weakest grid. None where there is no such end within `SCALE_RANGE`.
    """

    low: float | None
    high: float | None

    @property
    def nearest(self) -> float | None:
        """The end nearest to one, by their ratio."""
        return min((end for end in self if end is not None), key=lambda end: abs(np.log(end)), default=None)

    @property
    def averse(self) -> bool:
        """Whether the nearest edge lies on the side of strong grids: a smaller impedance is worse there."""
        return self.low is not None and self.nearest == self.low


def stable_range(model: RationalModel, grid: Grid) -> StableRange:
    """Both ends of the range of multipliers of R and X in which the loop is stable.

    A grid-following device loses stability on weak grids and has an upper end; a grid-forming one may lose it on
    strong grids and has a lower one. From inside a stable range the lower end is looked for in steps of `_BACK_STEP`,
    every other one in steps of `_SCAN_STEP`.
    """

    def rightmost(scale: float) -> float:
        poles = closed_loop_poles(model, grid.scaled(scale))
        return float(poles.real[~is_beyond(model, poles)].max(initial=-np.inf))

    here = (1.0, rightmost(1.0))
    if here[1] <= 0.0:
        return StableRange(_edge(rightmost, here, _BACK_STEP), _edge(rightmost, here, _SCAN_STEP))
    high = _edge(rightmost, here, 1.0 / _SCAN_STEP)
    if high is not None:
        return StableRange(_edge(rightmost, (high / _CLEAR, -np.inf), _BACK_STEP), high)
    low = _edge(rightmost, here, _SCAN_STEP)
    return StableRange(low, None if low is None else _edge(rightmost, (low * _CLEAR, -np.inf), _SCAN_STEP))


def _edge(rightmost: Callable[[float], float], start: tuple[float, float], step: float) -> float | None:
    """The first scale from that of ``start`` (scale, rightmost pole) on, by factors of ``step``, with another sign."""
    inner, value = start
    while SCALE_RANGE[0] < inner < SCALE_RANGE[1]:
        outer = inner * step
        beyond = rightmost(outer)
        if (beyond > 0.0) != (value > 0.0):
            return _root(rightmost, (inner, value), (outer, beyond))
        inner, value = outer, beyond
    return None


def critical_scale(model: RationalModel, grid: Grid) -> float | None:
    """Multiplier of R and X at which the loop is on the edge: the nearest end of `stable_range`."""
    return stable_range(model, grid).nearest


def critical_scr(scale: float, grid: Grid, voltage_v: float, power_va: float) -> float:
    """Short-circuit ratio U^2 / (S |Z|) of the grid multiplied by ``scale``; U line-to-line RMS (V), S in VA."""
    return voltage_v**2 / (power_va * scale * grid.size_ohm)


def passivity(model: RationalModel, f_hz: np.ndarray) -> Passivity:
    """Passivity index at frequencies (n,) in Hz; the same in both frames."""
    y = evaluate_pn(model, f_hz)
    hermitian = (y + np.swapaxes(y.conj(), 1, 2)) / 2.0
    return Passivity(np.asarray(f_hz, dtype=float), np.linalg.eigvalsh(hermitian)[:, 0])


def participation(model: RationalModel, grid: Grid, pole: complex) -> Participation:
    """Which element and which component matter most, from the null vectors of Y + Yg at a closed-loop pole.

    With left M = 0 and M right = 0 the pole moves by -left dY right / (left M' right): the share of an element is
    |left_i Y_ij right_j| among all, in the pn frame.
    """
    shape = mode_shape(model, grid, pole)
    y = dq_to_pn(evaluate(model, np.array([pole])))[0]
    left, right = shape.left @ T_INVERSE, T @ shape.right
    effect = np.abs(left[:, None] * y * right).ravel()
    share = dict(zip(ELEMENTS, (effect / effect.sum()).tolist(), strict=True))
    above, below = np.abs(y @ right)
    nu = abs(pole.imag) / (2.0 * np.pi)
    return Participation(
        elements=share,
        strongest=max(share, key=lambda name: share[name]),
        current_ratio=float(above / below),
        f_hz=model.f1_hz + nu if above >= below else model.f1_hz - nu,
    )


def _gain_margin(loop: np.ndarray) -> float | None:
    at = np.flatnonzero(np.diff(np.signbit(loop.imag)) != 0)
    part = loop.imag[at] / (loop.imag[at] - loop.imag[at + 1])
    real = loop.real[at] + part * (loop.real[at + 1] - loop.real[at])
    real = real[real < 0.0]
    if len(real) == 0:
        return None
    return float(1.0 / -real[np.argmin(np.abs(np.log(-real)))])


def _phase_margin_deg(loop: np.ndarray) -> float | None:
    at = np.flatnonzero(np.diff(np.abs(loop) > 1.0))
    if len(at) == 0:
        return None
    part = (1.0 - np.abs(loop[at])) / (np.abs(loop[at + 1]) - np.abs(loop[at]))
    crossing = loop[at] + part * (loop[at + 1] - loop[at])
    return float(np.degrees(np.abs(np.angle(-crossing)).min()))


def _root(function: Callable[[float], float], inner: tuple[float, float], outer: tuple[float, float]) -> float:
    """Zero of a function between two points of different sign: Illinois' false position, halving where it jumps."""
    (a, fa), (b, fb) = inner, outer
    for _ in range(60):
        x = (a * fb - b * fa) / (fb - fa) if np.isfinite(fb - fa) else (a + b) / 2.0
        fx = function(x)
        if abs(fx) < 1e-7 or abs(b - a) < 1e-12 * abs(b):
            return x
        if (fx > 0.0) != (fb > 0.0):
            a, fa = b, fb
        else:
            fa /= 2.0
        b, fb = x, fx
    return b
