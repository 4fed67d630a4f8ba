"""Grid-side damping converter (GSDC): a converter at a bus that draws current at a mode's two frequencies, no others.

Space vectors in the common dq frame at w1, current in load direction (into the converter), v the bus voltage::

    m'  = w_w (v - m)                              what is steady in v: m follows it slowly and is taken off
    x1' = (+1j nu - w_b) x1 + w_b (v - m)          band-pass at the mode, f1 + nu / 2 pi
    x2' = (-1j nu - w_b) x2 + w_b (v - m)          band-pass at its mirror image, f1 - nu / 2 pi
    i'  = (s (y_mode x1 + y_mirror x2) - i) / T    the converter's lag; s <= 1 scales the whole to the current limit

Below the limit it is linear: i(s) = G(s) v(s) with

    G(s) = s / (s + w_w) w_b (y_mode / (s - 1j nu + w_b) + y_mirror / (s + 1j nu + w_b)) / (1 + s T)

for the positive component v_d + 1j v_q, and conj(G(conj s)) for v_d - 1j v_q. Without a washout, w_w = 0, m is zero and
the factor s / (s + w_w) one. Of the fundamental the band-passes then let the part w_b / |w_b - 1j nu| through, which
takes some of its current. `GridSideDamper.admittance` and `GridSideDamper.states` are this in frequency, for
the pencil and the locus; `plant.kernels` steps the same in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite, pi
from typing import NamedTuple

import numpy as np

from ..errors import SeqsweepError

BANDWIDTH_RAD_S = 2.0 * pi * 5.0
"""Half width of the band-passes."""

WASHOUT_RAD_S = 2.0 * pi * 1.0
"""What is slower in the dq frame belongs to the operating point."""

LAG_S = 1e-3
"""Lag of the converter's current behind what it is asked for."""

N_STATES = 8
"""Real states: m, x1, x2 and i, d before q."""


class DamperStates(NamedTuple):
    """x' = A x + B v, i = C x in the dq frame: a (8, 8), b (8, 2), c (2, 8), d before q."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@dataclass(frozen=True, slots=True)
class GridSideDamper:
    """A grid-side damping converter as it is set.

    Attributes
    ----------
    nu_rad_s : float
        |Im| of the mode in dq (rad/s).
    y_mode, y_mirror : complex
        Admittance (S) at the mode (f1 + nu / 2 pi) and at its mirror image, of the positive component, load direction.
    limit_a : float
        Largest |i|, power-invariant (A): a share of the farm's S / U. It acts in time alone.
    bandwidth_rad_s, washout_rad_s, lag_s : float
        w_b, w_w (rad/s; zero: no washout) and T (s).

    Raises
    ------
    SeqsweepError
        If a number is out of its range.
    """

    nu_rad_s: float
    y_mode: complex
    y_mirror: complex
    limit_a: float = inf
    bandwidth_rad_s: float = BANDWIDTH_RAD_S
    washout_rad_s: float = WASHOUT_RAD_S
    lag_s: float = LAG_S

    def __post_init__(self) -> None:
        for name in ("nu_rad_s", "bandwidth_rad_s", "lag_s"):
            value = getattr(self, name)
            if not (value > 0.0 and isfinite(value)):
                raise SeqsweepError(f"{name} of the grid-side damper is {value:g}; needed is a finite number above 0")
        if not (self.washout_rad_s >= 0.0 and isfinite(self.washout_rad_s)):
            raise SeqsweepError(
                f"washout_rad_s of the grid-side damper is {self.washout_rad_s:g}; needed is 0 or above"
            )
        if not self.limit_a >= 0.0:
            raise SeqsweepError(f"limit_a of the grid-side damper is {self.limit_a:g} A; needed is a number from 0 on")

    def positive(self, s: np.ndarray) -> np.ndarray:
        """G (n,) in S at complex ``s`` (n,) in rad/s: current of v_d + 1j v_q."""
        s, nu, w_b = np.asarray(s, dtype=complex), 1j * self.nu_rad_s, self.bandwidth_rad_s
        passed = self.y_mode / (s - nu + w_b) + self.y_mirror / (s + nu + w_b)
        return _shaping(s, self.washout_rad_s, self.lag_s) * w_b * passed

    def admittance(self, s: np.ndarray) -> np.ndarray:
        """Ydq (n, 2, 2) in S at complex ``s`` (n,) in rad/s, load direction, below the limit."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        of_plus, of_minus = self.positive(s), self.positive(s.conj()).conj()
        own, across = (of_plus + of_minus) / 2.0, (of_plus - of_minus) / 2j
        return np.stack([np.stack([own, -across], -1), np.stack([across, own], -1)], -2)

    def states(self) -> DamperStates:
        """The same as a state space, for a pencil."""
        w_b, w_w, rate = self.bandwidth_rad_s, self.washout_rad_s, 1.0 / self.lag_s
        nu = 1j * self.nu_rad_s
        a = np.array(
            [
                [-w_w, 0.0, 0.0, 0.0],
                [-w_b, nu - w_b, 0.0, 0.0],
                [-w_b, 0.0, -nu - w_b, 0.0],
                [0.0, rate * self.y_mode, rate * self.y_mirror, -rate],
            ]
        )
        b, c = np.array([[w_w], [w_b], [w_b], [0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]])
        return DamperStates(_real(a), _real(b), _real(c))

    def at_rest(self, v: complex) -> np.ndarray:
        """States (8,) where the bus's voltage has been ``v`` (V, d + 1j q) for long, and no current flows yet."""
        w_b, nu = self.bandwidth_rad_s, 1j * self.nu_rad_s
        held, left = (v, 0.0) if self.washout_rad_s else (0.0, v)
        z = np.array([held, w_b * left / (w_b - nu), w_b * left / (w_b + nu), 0.0], dtype=complex)
        return np.stack([z.real, z.imag], axis=1).ravel()

    def scaled(self, factor: float) -> GridSideDamper:
        """The same with its admittances multiplied."""
        return replace(self, y_mode=factor * self.y_mode, y_mirror=factor * self.y_mirror)


def aimed_at(
    pole: complex,
    plus: complex,
    minus: complex,
    size_s: float,
    limit_a: float = inf,
    lag_s: float = LAG_S,
    washout_rad_s: float = WASHOUT_RAD_S,
) -> GridSideDamper:
    """The converter whose current moves a mode straight to the left, to first order.

    Parameters
    ----------
    pole : complex
        The mode (rad/s, dq), Im > 0.
    plus, minus : complex
        What the mode sees of a bus (rad/s per S): d(pole) = -(plus G(pole) + minus conj(G(conj pole))) for a current
        G (v_d + 1j v_q) drawn there. With null vectors l, r of the nodal matrix and D = l M' r:
        plus = (l_d - 1j l_q)(r_d + 1j r_q) / 2D, minus = (l_d + 1j l_q)(r_d - 1j r_q) / 2D.
    size_s : float
        Length (S) of the pair of admittances at the mode; it is parted in proportion to the effect.
    limit_a, lag_s, washout_rad_s : float
        As of `GridSideDamper`; the lag, and the washout, are made up for at the mode.

    Raises
    ------
    SeqsweepError
        If the mode does not oscillate, or the bus does not see it.
    """
    effect = float(np.hypot(abs(plus), abs(minus)))
    if not pole.imag > 0.0:
        raise SeqsweepError(f"the mode {pole:.4g} rad/s does not oscillate: a grid-side damper is set to a frequency")
    if not effect > 0.0:
        raise SeqsweepError("the mode is not seen at this bus: place the grid-side damper where devices take part")
    at_mode, at_mirror = (
        complex(_shaping(np.array(s), washout_rad_s, lag_s) * BANDWIDTH_RAD_S / (pole.real + BANDWIDTH_RAD_S))
        for s in (pole, pole.conjugate())
    )
    y_mode, y_mirror = size_s * plus.conjugate() / effect / at_mode, size_s * minus / effect / at_mirror
    return GridSideDamper(pole.imag, y_mode, y_mirror, limit_a, BANDWIDTH_RAD_S, washout_rad_s, lag_s)


def _shaping(s: np.ndarray, washout_rad_s: float, lag_s: float) -> np.ndarray:
    """Washout and lag."""
    washed = s / (s + washout_rad_s) if washout_rad_s else 1.0
    shaped: np.ndarray = washed / (1.0 + s * lag_s)
    return shaped


def _real(matrix: np.ndarray) -> np.ndarray:
    """A complex matrix acting on x_d + 1j x_q, as a real one acting on (x_d, x_q) pairs."""
    return np.kron(matrix.real, np.eye(2)) + np.kron(matrix.imag, np.array([[0.0, -1.0], [1.0, 0.0]]))
