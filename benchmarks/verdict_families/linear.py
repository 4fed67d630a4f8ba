"""A linear device between two terminals in the dq frame, and its exact closed loop with an R-L grid.

    x' = A x + B v        i = C x + D v + E v'        v, i (2,): dq, current into the device, V and A

Poles come from plain eigenvalues of the ordinary differential equations of device and grid, never from a pencil or a
locus: that is the product's business.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

J = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Turns a dq pair by 90 degrees."""


@dataclass(frozen=True)
class Bases:
    """Rated line-to-line voltage (V), rated power (VA) and fundamental (Hz)."""

    voltage_v: float
    power_va: float
    f1_hz: float

    @property
    def z_ohm(self) -> float:
        """The impedance that is one per unit (ohm)."""
        return self.voltage_v**2 / self.power_va

    @property
    def w1(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * np.pi * self.f1_hz


@dataclass(frozen=True)
class Linear:
    """A device as matrices in SI units; see the module's text. ``e`` is a number times the unit matrix."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    e: float
    w1: float

    def admittance(self, nu_hz: np.ndarray) -> np.ndarray:
        """Ydq (n, 2, 2) in S at frequencies of the dq frame (Hz), any sign."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(nu_hz, float))
        shift = s[:, None, None] * np.eye(len(self.a)) - self.a
        return self.c @ np.linalg.solve(shift, self.b.astype(complex)) + self.d + s[:, None, None] * self.e * np.eye(2)

    @cached_property
    def own_poles(self) -> np.ndarray:
        """Poles on an ideal source (rad/s)."""
        return np.linalg.eigvals(self.a)

    def closed_loop(self, r_ohm: float, x_ohm: float) -> np.ndarray:
        """Poles (rad/s) of the device on a grid R + jX (ohm at f1)."""
        return np.linalg.eigvals(self.on_grid(r_ohm, x_ohm)[0])

    def on_grid(self, r_ohm: float, x_ohm: float) -> tuple[np.ndarray, ...]:
        """A, B, and C, D for i and for v, of device and grid, driven by the source: x' = A x + B v_s.

        Three forms: v is a state where a capacitor stands at the terminals, i where the device has a resistive path,
        and where it has neither, the grid's inductance adds to the device's and makes no state of its own.
        """
        z, l_h = r_ohm * np.eye(2) + x_ohm * J, x_ohm / self.w1
        if self.e > 0.0:
            return self._with_capacitor(z, l_h)
        if np.linalg.norm(self.d) > 0.0:
            return self._with_resistor(z, l_h)
        return self._inductive(z, l_h)

    def _inductive(self, z: np.ndarray, l_h: float) -> tuple[np.ndarray, ...]:
        """v = v_s - Z C x - l C x', put into x' = A x + B v."""
        mass = np.eye(len(self.a)) + l_h * self.b @ self.c
        a, b = np.linalg.solve(mass, self.a - self.b @ z @ self.c), np.linalg.solve(mass, self.b)
        c_v, d_v = -z @ self.c - l_h * self.c @ a, np.eye(2) - l_h * self.c @ b
        return a, b, self.c, np.zeros((2, 2)), c_v, d_v

    def _with_resistor(self, z: np.ndarray, l_h: float) -> tuple[np.ndarray, ...]:
        """State (x, i): v = D^-1 (i - C x), l i' = v_s - v - Z i."""
        n, to_v = len(self.a), np.linalg.inv(self.d)
        c_v = np.hstack([-to_v @ self.c, to_v])
        a = np.vstack([np.hstack([self.a, np.zeros((n, 2))]) + self.b @ c_v, -c_v / l_h])
        a[n:, n:] -= z / l_h
        b = np.vstack([np.zeros((n, 2)), np.eye(2) / l_h])
        return a, b, np.hstack([np.zeros((2, n)), np.eye(2)]), np.zeros((2, 2)), c_v, np.zeros((2, 2))

    def _with_capacitor(self, z: np.ndarray, l_h: float) -> tuple[np.ndarray, ...]:
        """State (x, i, v): e v' = i - C x - D v, l i' = v_s - v - Z i."""
        n, none = len(self.a), np.zeros((2, 2))
        a = np.block(
            [
                [self.a, np.zeros((n, 2)), self.b],
                [np.zeros((2, n)), -z / l_h, -np.eye(2) / l_h],
                [-self.c / self.e, np.eye(2) / self.e, -self.d / self.e],
            ]
        )
        b = np.vstack([np.zeros((n, 2)), np.eye(2) / l_h, none])
        pick_i = np.hstack([np.zeros((2, n)), np.eye(2), none])
        return a, b, pick_i, none, np.hstack([np.zeros((2, n)), none, np.eye(2)]), none


def parallel(one: Linear, other: Linear) -> Linear:
    """Two devices at the same terminals."""
    return Linear(
        block_diag(one.a, other.a),
        np.vstack([one.b, other.b]),
        np.hstack([one.c, other.c]),
        one.d + other.d,
        one.e + other.e,
        one.w1,
    )


def behind_inductor(device: Linear, r_ohm: float, x_ohm: float) -> Linear:
    """The device with a series R-L of its own in front."""
    a, b, c, d, _, _ = device.on_grid(r_ohm, x_ohm)
    return Linear(a, b, c, d, 0.0, device.w1)


def in_si(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, e: float, bases: Bases) -> Linear:
    """A device whose voltages and currents are per unit of ``bases``, time in seconds."""
    volt, ampere = bases.voltage_v, bases.power_va / bases.voltage_v
    return Linear(a, b / volt, c * ampere, d * ampere / volt, e * ampere / volt, bases.w1)


def jacobian(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Derivative by the complex step: exact to rounding where the function is analytic."""
    h = 1e-40
    return np.column_stack([function(z + 1j * h * unit).imag / h for unit in np.eye(len(z))])


def turned(x: np.ndarray, angle: complex) -> np.ndarray:
    """A dq pair turned forwards by an angle (rad)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


def pair(x: complex) -> np.ndarray:
    """A complex number as a dq pair."""
    return np.array([x.real, x.imag])


def pade(delay_s: float, order: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """State space (a, b, c, d) of the all-pass that stands for a delay here: Pade's, of equal degrees."""
    from math import comb, factorial

    weight = np.array(
        [comb(order, k) * factorial(2 * order - k) / factorial(2 * order) for k in range(order + 1)]
    )  # of s^k, in units of the delay
    top, bottom = weight * (-1.0) ** np.arange(order + 1), weight
    top, bottom = top / bottom[-1], bottom / bottom[-1]
    a = np.diag(np.ones(order - 1), 1)
    a[-1] = -bottom[:-1]
    b = np.zeros(order)
    b[-1] = 1.0
    return a / delay_s, b / delay_s, (top - top[-1] * bottom)[:-1], float(top[-1])
