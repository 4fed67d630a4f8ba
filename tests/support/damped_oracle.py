"""The exact linearisation of the reference turbine with damping control, the notch as an oscillator of its own."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np

from seqsweep.plant.turbine.parameters import TABLE_I

from . import oracle

W1 = TABLE_I.w1_rad_s
XI = 0.01


def damped_rhs(
    x: np.ndarray, v: np.ndarray, i_g: np.ndarray, wind: float, k: float, w_r: float, line: tuple[float, float]
) -> np.ndarray:
    """Time derivative (19,): the oracle's states, then the notch as an oscillator z'' + 2 xi w0 z' + w0^2 z = i_g.

    The notch lets i_g - 2 xi w0 z' through. The controller uses the voltage in its PLL alone (states 4, 5).
    """
    turbine, z, dz = x[:15], x[15:17], x[17:19]
    through = i_g - 2.0 * XI * W1 * dz
    r_v, x_v = k * line[0], k * w_r * line[1]
    told = v - r_v * through - x_v * turn(through)
    rates = oracle.rhs(turbine, v, wind)
    rates = np.concatenate([rates[:4], oracle.rhs(turbine, told, wind)[4:6], rates[6:]])
    d_dz = i_g - W1**2 * z - 2.0 * XI * W1 * dz - W1 * turn(dz)
    return np.concatenate([rates, dz - W1 * turn(z), d_dz])


def damped_grid_rhs(
    x: np.ndarray, v_g: np.ndarray, wind: float, k: float, w_r: float, line: tuple[float, float]
) -> np.ndarray:
    """Time derivative (21,) behind the line, whose current is the last pair of states."""
    i_g = x[19:]
    v = x[2:4] + TABLE_I.r_f_ohm * (x[0:2] - i_g)
    di_g = (v - v_g - line[0] * i_g) / line[1] - W1 * turn(i_g)
    return np.concatenate([damped_rhs(x[:19], v, i_g, wind, k, w_r, line), di_g])


def damped_equilibrium(power_w: float, terminal_voltage_v: float) -> tuple[np.ndarray, np.ndarray, float]:
    """State (19,), i_g (2,) and wind: the notch lets nothing of the fundamental through."""
    x, wind = oracle.equilibrium(power_w, terminal_voltage_v)
    i_g = -oracle.current(x, np.array([terminal_voltage_v, 0.0]))
    dz = i_g / (2.0 * XI * W1)
    return np.concatenate([x, -turn(dz) / W1, dz]), i_g, wind


def damped_poles(
    power_w: float, terminal_voltage_v: float, k: float, w_r: float, line: tuple[float, float]
) -> np.ndarray:
    """Closed-loop poles (21,) (rad/s, dq frame) on a line of R (ohm) and L (H), which the gain multiplies."""
    x, i_g, wind = damped_equilibrium(power_w, terminal_voltage_v)
    v_g = oracle.source_voltage(power_w, terminal_voltage_v, *line)
    v_g_dq = np.array([v_g.real, v_g.imag])
    closed = np.concatenate([x, i_g])
    return np.linalg.eigvals(jacobian(lambda z: damped_grid_rhs(z, v_g_dq, wind, k, w_r, line), closed))


def damped_admittance(
    f_hz: np.ndarray, power_w: float, terminal_voltage_v: float, k: float, w_r: float, line: tuple[float, float]
) -> np.ndarray:
    """Re-swept admittance (n, 2, 2), sequence frame, load direction (S)."""
    a, b, c, d = damped_system(power_w, terminal_voltage_v, k, w_r, line)
    s = 1j * (2.0 * pi * f_hz - W1)
    y_dq = c @ np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b.astype(complex)) + d
    return oracle.T_PN @ y_dq @ np.linalg.inv(oracle.T_PN)


def damped_system(
    power_w: float, terminal_voltage_v: float, k: float, w_r: float, line: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A (19, 19), B, C and D on an ideal source, current into the turbine."""
    x, _, wind = damped_equilibrium(power_w, terminal_voltage_v)
    v = np.array([terminal_voltage_v, 0.0])

    def rates(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return damped_rhs(z, u, -oracle.current(z[:15], u), wind, k, w_r, line)

    a, b = jacobian(lambda z: rates(z, v), x), jacobian(lambda u: rates(x, u), v)
    c = jacobian(lambda z: oracle.current(z[:15], v), x)
    d = jacobian(lambda u: oracle.current(x[:15], u), v)
    return a, b, c, d


def turn(x: np.ndarray) -> np.ndarray:
    """Multiply by j."""
    return np.array([-x[1], x[0]])


def jacobian(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    h = 1e-40
    return np.column_stack([function(z + 1j * h * unit).imag / h for unit in np.eye(len(z))])
