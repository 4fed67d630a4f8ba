"""Stationary operating points of the reference turbine, in closed form but for one scalar Newton.

Grid-side quantities are in the PLL frame, where v_pcc is real; machine quantities in the rotor
frame. All are power-invariant; `dpmsg_parameters` states the machine's equations and signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import NamedTuple

from ..errors import SeqsweepError
from .parameters import TurbineParameters

STANDS = 1e-12
"""Relative distance from its equilibrium up to which a machine stands still: what rounding leaves of it."""


class MachineEquilibrium(NamedTuple):
    """Machine side and rotor at rest: speed (rad/s), currents (A), PI outputs (V), wind (m/s)."""

    w_m: float
    i_d: float
    i_q: float
    xi_d: float
    xi_q: float
    wind_speed_m_s: float


class GridSideEquilibrium(NamedTuple):
    """Grid side at rest, in the PLL frame.

    Attributes
    ----------
    v_pcc : complex
        Voltage at the PCC (V), real by the choice of frame.
    i_l : complex
        Current out of the converter (A), real where no reactive power is asked for.
    v_c : complex
        Voltage of the shunt capacitor (V).
    v_conv : complex
        Voltage of the converter (V).
    i_g : complex
        Current out of the turbine, towards the grid (A).
    xi_d, xi_q : float
        Outputs of the current PI's integrators (V).
    xi_dc : float
        Output of the DC voltage PI's integrator (A), equal to i_d.
    i_q_ref : float
        Set-point of the reactive current (A): -Q over |v_pcc|.
    """

    v_pcc: complex
    i_l: complex
    v_c: complex
    v_conv: complex
    i_g: complex
    xi_d: float
    xi_q: float
    xi_dc: float
    i_q_ref: float


def machine_equilibrium(p: TurbineParameters, power_w: float) -> MachineEquilibrium:
    """Machine side that delivers ``power_w`` (W, > 0) into the DC link, and the wind it takes.

    Raises
    ------
    SeqsweepError
        If the power is not positive, or more than the torque law can deliver through Rs.
    """
    return _machine_at(p, _rotor_speed(p, power_w))


def machine_stands(p: TurbineParameters, values: Sequence[float], wind_m_s: float) -> bool:
    """Whether the machine of a turbine in the state ``values`` (as the kernel orders them) is at rest in that wind.

    Nothing but the wind reaches it: it then stands still whatever happens on the grid side.
    """
    rest = _machine_at(p, wind_m_s * _tip_speed_ratio(p) / p.radius_m)
    i_d, i_q, xi_d, xi_q, w_m = values[8:13]
    off = (
        max(abs(i_d - rest.i_d), abs(i_q - rest.i_q)) / rest.i_q,
        max(abs(xi_d - rest.xi_d), abs(xi_q - rest.xi_q)) / rest.xi_q,
        abs(w_m - rest.w_m) / rest.w_m,
    )
    return max(map(abs, off)) <= STANDS


def _machine_at(p: TurbineParameters, w_m: float) -> MachineEquilibrium:
    """Machine side at rest at rotor speed ``w_m`` (rad/s)."""
    w_e = p.pole_pairs * w_m
    i_q = p.k_opt * w_m**2 / (p.pole_pairs * p.flux_wb)
    v_d = w_e * p.l_s_h * i_q
    v_q = w_e * p.flux_wb - p.r_s_ohm * i_q
    return MachineEquilibrium(
        w_m=w_m,
        i_d=0.0,
        i_q=i_q,
        xi_d=v_d - p.k_mrd_ohm * i_q,
        xi_q=v_q,
        wind_speed_m_s=w_m * p.radius_m / _tip_speed_ratio(p),
    )


def grid_side_equilibrium(p: TurbineParameters, power_va: complex, terminal_voltage_v: float) -> GridSideEquilibrium:
    """Grid side that carries ``power_va`` (W + j var, out of the converter) at |v_pcc| (V, line-to-line RMS).

    Notes
    -----
    The active power is P = Re(v_conv conj(i_L)), and the drop j w1 Lc i_L carries none of it; the reactive power is
    Im(v_pcc conj(i_L)): that of the converter at the PCC, without the shunt's.
    """
    v = terminal_voltage_v
    i_l = complex(power_va).conjugate() / v
    v_c = v / (1.0 + 1j * p.w1_rad_s * p.r_f_ohm * p.c_f_f)
    v_conv = v + 1j * p.w1_rad_s * p.l_c_h * i_l
    xi = v_conv - 1j * p.k_rd_ohm * i_l
    return GridSideEquilibrium(
        v_pcc=complex(v),
        i_l=i_l,
        v_c=v_c,
        v_conv=v_conv,
        i_g=i_l - _shunt_admittance(p) * v,
        xi_d=xi.real,
        xi_q=xi.imag,
        xi_dc=i_l.real,
        i_q_ref=i_l.imag,
    )


def thevenin_voltage(
    p: TurbineParameters,
    power_va: complex,
    terminal_voltage_v: float,
    r_ohm: float,
    l_h: float,
    w1: float | None = None,
) -> complex:
    """Source voltage v_g (V, PLL frame) behind r + j w1 l that holds |v_pcc| at ``terminal_voltage_v``.

    ``w1`` (rad/s) is that of the parameters if not given.
    """
    if w1 is not None:
        p = p._replace(w1_rad_s=w1)
    z = complex(r_ohm, p.w1_rad_s * l_h)
    return terminal_voltage_v - z * grid_side_equilibrium(p, power_va, terminal_voltage_v).i_g


def terminal_voltage_for_source(
    p: TurbineParameters, power_va: complex, source_voltage_v: float, r_ohm: float, l_h: float
) -> float:
    """|v_pcc| (V) for a given |v_g| behind r + j w1 l: the upper of the two solutions.

    Raises
    ------
    SeqsweepError
        If the grid cannot carry the power.

    Notes
    -----
    ``v_g = a V - Z conj(S) / V`` with ``a = 1 + Z Y_shunt``; its squared modulus times V^2 is a quadratic
    equation in V^2.
    """
    z = complex(r_ohm, p.w1_rad_s * l_h)
    a = 1.0 + z * _shunt_admittance(p)
    half = 0.5 * source_voltage_v**2 + (a * z.conjugate() * power_va).real
    discriminant = half**2 - abs(a * z * power_va) ** 2
    if half <= 0.0 or discriminant < 0.0:
        raise SeqsweepError(
            f"no equilibrium: {_in_words(power_va)} cannot be carried by {source_voltage_v:g} V behind "
            f"{z.real:g} + j{z.imag:g} ohm; lower the power or the impedance"
        )
    return sqrt(half + sqrt(discriminant)) / abs(a)


def _in_words(power_va: complex) -> str:
    reactive = f" and {power_va.imag:g} var" if power_va.imag else ""
    return f"{power_va.real:g} W{reactive}"


def _rotor_speed(p: TurbineParameters, power_w: float) -> float:
    """Speed (rad/s) at which the torque law, less the copper loss, delivers ``power_w``."""
    if not power_w > 0.0:
        raise SeqsweepError(f"power_w must be positive, but is {power_w:g} W")
    loss = p.r_s_ohm * (p.k_opt / (p.pole_pairs * p.flux_wb)) ** 2
    w = (power_w / p.k_opt) ** (1.0 / 3.0)
    for _ in range(50):
        slope = (3.0 * p.k_opt - 4.0 * loss * w) * w**2
        if not slope > 0.0:
            break
        step = (power_w - (p.k_opt - loss * w) * w**3) / slope
        w += step
        if abs(step) <= 1e-14 * w:
            return w
    raise SeqsweepError(f"no equilibrium: the torque law cannot deliver {power_w:g} W through Rs = {p.r_s_ohm:g} ohm")


def _tip_speed_ratio(p: TurbineParameters) -> float:
    """Tip speed ratio at which aerodynamic and MPPT torque agree; the same at every speed."""
    per_w2 = 0.5 * p.rho_kgm3 * pi * p.radius_m**5
    return p.c_q1 / (p.k_opt / per_w2 + p.c_q2)


def _shunt_admittance(p: TurbineParameters) -> complex:
    """Admittance of Rf in series with Cf at the fundamental (S)."""
    y_c = 1j * p.w1_rad_s * p.c_f_f
    return y_c / (1.0 + p.r_f_ohm * y_c)
