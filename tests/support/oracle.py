"""The exact linearisation of the reference turbine in continuous time: what every sweep is held against.

The right-hand side is written here afresh, in real numbers only, so that its Jacobian comes out of
the complex step to the last digit. Nothing is shared with the plant but the parameters' values.

All vectors are power-invariant dq pairs (|v| = line-to-line RMS). The grid's frame rotates at w1 with
d on the PCC voltage; the machine's on its flux. ``delta`` is the PLL's angle against the grid's frame. Reactive
power ``q_var`` (var, out of the converter at the PCC) is a constant i_q* = -q_var / |v_pcc|.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import pi

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from seqsweep.plant.turbine.parameters import TABLE_I, TurbineParameters

STATES = (
    *("i_l_d", "i_l_q", "v_c_d", "v_c_q", "delta", "xi_pll", "xi_dc", "xi_d", "xi_q", "v_dc"),
    *("i_s_d", "i_s_q", "xi_s_d", "xi_s_q", "w_m"),
)
"""Order of the state: grid side and DC link (0-9), machine and rotor (10-14). A, V, rad, rad/s."""

T_PN = np.array([[1.0, 1j], [1.0, -1j]])
"""(d, q) to (positive sequence, conjugate of the mirror)."""


@dataclass(frozen=True)
class Linear:
    """dx/dt = A x + B v, i = C x + D v about one operating point on an ideal source.

    Attributes
    ----------
    A, B, C, D : (15, 15), (15, 2), (2, 15), (2, 2) float
        Input: v_pcc dq (V). Output: current dq (A) into the turbine (load direction).
    x : (15,) float
        The equilibrium, in the order of `STATES`.
    v_pcc : (2,) float
        PCC voltage dq (V); q is zero.
    wind : float
        Wind speed that delivers the power (m/s).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    x: np.ndarray
    v_pcc: np.ndarray
    wind: float


def rhs(
    x: np.ndarray, v_pcc: np.ndarray, wind: float, p: TurbineParameters = TABLE_I, i_q_ref: float = 0.0
) -> np.ndarray:
    """Time derivative (15,) of the state under the PCC voltage dq (2,) (V) and the wind (m/s), i_q* in A.

    Without limits: valid while the converter voltage and the current reference stay within theirs. Many states (15, n)
    under as many voltages (2, n), or under one (2, 1), are taken at once.
    """
    return np.concatenate([_grid_side(x, v_pcc, p, i_q_ref), _machine_side(x, wind, p)])


def current(x: np.ndarray, v_pcc: np.ndarray, p: TurbineParameters = TABLE_I) -> np.ndarray:
    """Current dq (2,) into the turbine (A, load direction): minus i_L, plus the shunt branch's."""
    return (v_pcc - x[2:4]) / p.r_f_ohm - x[0:2]


def closed_rhs(
    x: np.ndarray,
    v_g: np.ndarray,
    wind: float,
    r_ohm: float,
    l_h: float,
    p: TurbineParameters = TABLE_I,
    i_q_ref: float = 0.0,
) -> np.ndarray:
    """Time derivative (17,) of turbine and line; the last two states are i_g (A, towards the grid)."""
    turbine, i_g = x[:15], x[15:]
    v_pcc = turbine[2:4] + p.r_f_ohm * (turbine[0:2] - i_g)
    di_g = (v_pcc - v_g - r_ohm * i_g) / l_h - p.w1_rad_s * _j(i_g)
    return np.concatenate([rhs(turbine, v_pcc, wind, p, i_q_ref), di_g])


@cache
def linearise(power_w: float, terminal_voltage_v: float, p: TurbineParameters = TABLE_I, q_var: float = 0.0) -> Linear:
    """Linearisation at P_machine (W) and |v_pcc| (V, line-to-line RMS) on an ideal source."""
    x, wind = equilibrium(power_w, terminal_voltage_v, p, q_var)
    v_pcc, i_q_ref = np.array([terminal_voltage_v, 0.0]), -q_var / terminal_voltage_v
    return Linear(
        A=_jacobian(lambda z: rhs(z, v_pcc[:, None], wind, p, i_q_ref), x),
        B=_jacobian(lambda v: rhs(np.stack([x, x], axis=1), v, wind, p, i_q_ref), v_pcc),
        C=_jacobian(lambda z: current(z, v_pcc[:, None], p), x),
        D=_jacobian(lambda v: current(x[:, None], v, p), v_pcc),
        x=x,
        v_pcc=v_pcc,
        wind=wind,
    )


def admittance_pn(
    f_hz: np.ndarray, power_w: float, terminal_voltage_v: float, p: TurbineParameters = TABLE_I, q_var: float = 0.0
) -> np.ndarray:
    """Sequence admittance (n, 2, 2) in S at signed frequencies (n,) in Hz, phase frame.

    Ypn(s) = T Ydq(s - j w1) T^-1.
    """
    m = linearise(power_w, terminal_voltage_v, p, q_var)
    s = 1j * (2.0 * pi * np.atleast_1d(np.asarray(f_hz, dtype=float)) - p.w1_rad_s)
    y_dq = m.C @ np.linalg.solve(s[:, None, None] * np.eye(len(m.x)) - m.A, m.B.astype(complex)) + m.D
    return T_PN @ y_dq @ np.linalg.inv(T_PN)


@cache
def equilibrium(
    power_w: float, terminal_voltage_v: float, p: TurbineParameters = TABLE_I, q_var: float = 0.0
) -> tuple[np.ndarray, float]:
    """State (15,) and wind speed (m/s) with a vanishing right-hand side and P_machine = ``power_w``."""
    v_pcc, i_q_ref = np.array([terminal_voltage_v, 0.0]), -q_var / terminal_voltage_v

    def residual(z: np.ndarray) -> np.ndarray:
        excess = machine_power(z[:15], p) - power_w
        return np.concatenate([rhs(z[:15], v_pcc[:, None], z[15], p, i_q_ref), [excess]])

    z = _newton(residual, _guess(power_w, terminal_voltage_v, p))
    z.setflags(write=False)  # kept for whoever asks again
    return z[:15], float(z[15])


def machine_power(x: np.ndarray, p: TurbineParameters = TABLE_I) -> float:
    """Power out of the machine into the DC link (W)."""
    return (machine_voltage(x, p) * x[10:12]).sum(axis=0)


def machine_voltage(x: np.ndarray, p: TurbineParameters = TABLE_I) -> np.ndarray:
    """Terminal voltage dq (2,) of the machine (V, rotor frame), as its converter sets it."""
    return p.k_mp * _machine_error(x, p) + x[12:14] - p.k_mrd_ohm * _j(x[10:12])


def terminal_voltage(
    power_w: float,
    r_ohm: float,
    l_h: float,
    source_voltage_v: float,
    p: TurbineParameters = TABLE_I,
    q_var: float = 0.0,
) -> float:
    """|v_pcc| (V) on a Thevenin grid: the upper solution, bracketed by the nose of the curve.

    Raises
    ------
    ValueError
        If the grid cannot carry the power.
    """

    def excess(v: float) -> float:
        return abs(source_voltage(power_w, v, r_ohm, l_h, p, q_var)) - source_voltage_v

    nose = minimize_scalar(excess, bounds=(0.05 * source_voltage_v, 2.0 * source_voltage_v), method="bounded").x
    if excess(nose) > 0.0:
        raise ValueError(f"no equilibrium for {power_w:g} W behind {r_ohm:g} ohm, {l_h:g} H")
    return brentq(excess, nose, 2.0 * source_voltage_v, xtol=1e-11, rtol=1e-14)


def closed_loop_poles(
    power_w: float,
    r_ohm: float,
    l_h: float,
    *,
    source_voltage_v: float | None = None,
    terminal_voltage_v: float | None = None,
    p: TurbineParameters = TABLE_I,
    q_var: float = 0.0,
) -> np.ndarray:
    """Poles (17,) of turbine and Thevenin grid in the dq frame (rad/s); give exactly one voltage."""
    if (source_voltage_v is None) == (terminal_voltage_v is None):
        raise ValueError("give exactly one of source_voltage_v and terminal_voltage_v")
    if terminal_voltage_v is None:
        terminal_voltage_v = terminal_voltage(power_w, r_ohm, l_h, source_voltage_v, p, q_var)
    x, wind = equilibrium(power_w, terminal_voltage_v, p, q_var)
    i_q_ref = -q_var / terminal_voltage_v
    i_g = -current(x, np.array([terminal_voltage_v, 0.0]), p)
    v_g = source_voltage(power_w, terminal_voltage_v, r_ohm, l_h, p, q_var)
    v_g_dq = np.array([v_g.real, v_g.imag])
    x_closed = np.concatenate([x, i_g])
    source = v_g_dq[:, None]
    return np.linalg.eigvals(_jacobian(lambda z: closed_rhs(z, source, wind, r_ohm, l_h, p, i_q_ref), x_closed))


def resonance_pole(poles: np.ndarray, f1_hz: float = 50.0) -> complex:
    """The pole with the largest real part among 5 Hz < |Im|/2pi < f1 - 1 Hz, Im > 0; NaN if none."""
    f = poles.imag / (2.0 * pi)
    among = poles[(f > 5.0) & (f < f1_hz - 1.0)]
    return complex(among[np.argmax(among.real)]) if len(among) else complex(np.nan, np.nan)


def source_voltage(
    power_w: float,
    terminal_voltage_v: float,
    r_ohm: float,
    l_h: float,
    p: TurbineParameters = TABLE_I,
    q_var: float = 0.0,
) -> complex:
    """Thevenin voltage v_d + 1j*v_q (V), in the frame of v_pcc.

    The converter feeds (P - j Q)/|v_pcc|, d on v_pcc; the shunt branch takes its share.
    """
    z_shunt = p.r_f_ohm + 1.0 / (1j * p.w1_rad_s * p.c_f_f)
    i_g = (power_w - 1j * q_var) / terminal_voltage_v - terminal_voltage_v / z_shunt
    return terminal_voltage_v - (r_ohm + 1j * p.w1_rad_s * l_h) * i_g


def _grid_side(x: np.ndarray, v_pcc: np.ndarray, p: TurbineParameters, i_q_ref: float) -> np.ndarray:
    i_l, v_c, delta, xi_pll, xi_dc, xi, v_dc = x[0:2], x[2:4], x[4], x[5], x[6], x[7:9], x[9]
    i_pll = _rotate(i_l, -delta)
    v_q = _rotate(v_pcc, -delta)[1]
    error_dc = v_dc - p.v_dc_ref_v
    error = _pair(p.k_dcp * error_dc + xi_dc, i_q_ref) - i_pll
    v_conv = _rotate(p.k_p * error + xi + p.k_rd_ohm * _j(i_pll), delta)
    di_l = (v_conv - v_pcc) / p.l_c_h - p.w1_rad_s * _j(i_l)
    dv_c = (v_pcc - v_c) / (p.r_f_ohm * p.c_f_f) - p.w1_rad_s * _j(v_c)
    dv_dc = (machine_power(x, p) - (v_conv * i_l).sum(axis=0)) / (p.c_dc_f * v_dc)
    slow = [p.k_pp * v_q + xi_pll, p.k_pi * v_q, p.k_dci * error_dc, *(p.k_i * error), dv_dc]
    return np.concatenate([di_l, dv_c, slow])


def _machine_side(x: np.ndarray, wind: float, p: TurbineParameters) -> np.ndarray:
    i_s, w_m = x[10:12], x[14]
    w_e = p.pole_pairs * w_m
    emf = _pair(0.0, w_e * p.flux_wb)
    di_s = (emf - machine_voltage(x, p) - p.r_s_ohm * i_s) / p.l_s_h - w_e * _j(i_s)
    tip_speed_ratio = w_m * p.radius_m / wind
    c_q = p.c_q1 * tip_speed_ratio - p.c_q2 * tip_speed_ratio**2
    t_aero = 0.5 * p.rho_kgm3 * pi * p.radius_m**3 * wind**2 * c_q
    dw_m = (t_aero - p.pole_pairs * p.flux_wb * i_s[1]) / p.inertia_kgm2
    return np.concatenate([di_s, p.k_mi * _machine_error(x, p), [dw_m]])


def _machine_error(x: np.ndarray, p: TurbineParameters) -> np.ndarray:
    i_q_ref = p.k_opt * x[14] ** 2 / (p.pole_pairs * p.flux_wb)
    return x[10:12] - _pair(0.0, i_q_ref)


def _guess(power_w: float, terminal_voltage_v: float, p: TurbineParameters) -> np.ndarray:
    """A start for Newton: no drops, no losses, a tip speed ratio of eight."""
    w_m = (power_w / p.k_opt) ** (1.0 / 3.0)
    emf = p.pole_pairs * w_m * p.flux_wb
    i_l = power_w / terminal_voltage_v
    grid = [i_l, 0.0, terminal_voltage_v, 0.0, 0.0, 0.0, i_l, terminal_voltage_v, 0.0, p.v_dc_ref_v]
    machine = [0.0, power_w / emf, 0.0, emf, w_m]
    return np.array([*grid, *machine, w_m * p.radius_m / 8.0])


def _newton(residual: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Root of ``residual``, of columns, polished until a step no longer moves it by 1e-13 of its size."""
    for _ in range(30):
        step = np.linalg.solve(_jacobian(residual, z), residual(z[:, None])[:, 0])
        z = z - step
        if np.all(np.abs(step) <= 1e-13 * np.maximum(np.abs(z), 1.0)):
            return z
    raise ArithmeticError("Newton did not converge on an equilibrium in 30 steps")


def _jacobian(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Derivative of a function of columns by the complex step: exact to rounding, the function being analytic."""
    h = 1e-40
    found = function(z[:, None] + 1j * h * np.eye(len(z))).imag / h
    found.setflags(write=False)
    return found


def _rotate(x: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


def _pair(d: np.ndarray | float, q: np.ndarray | float) -> np.ndarray:
    """A dq pair of numbers, or of rows of them."""
    return np.array([d + 0.0 * q, q + 0.0 * d])


def _j(x: np.ndarray) -> np.ndarray:
    """Multiply by j: (d, q) to (-q, d)."""
    return np.array([-x[1], x[0]])
