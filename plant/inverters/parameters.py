"""Parameters of the two inverters: per unit on their own rating, where a field does not say otherwise.

Reactances ``l_..._pu`` and susceptance ``c_f_pu`` are those at f1. Voltages and currents are per unit of the rated
phase peak. Currents flow out of the device. The controllers work in their own dq frame, d on the voltage
they synchronise to.
"""

from __future__ import annotations

from math import inf, pi
from typing import NamedTuple


class FormingParameters(NamedTuple):
    """A grid-forming inverter: virtual synchronous machine (VSM); droop and power synchronisation are other numbers.

    Attributes
    ----------
    u_rated_v, s_rated_va : float
        Rated line-to-line RMS voltage (V) and apparent power (VA).
    w1_rad_s : float
        Fundamental angular frequency (rad/s).
    l_f_pu, r_f_pu, c_f_pu, r_c_pu, l_g_pu, r_g_pu : float
        Converter choke; capacitor and the resistor in series with it; grid-side inductance (a transformer).
    c_dc_s : float
        DC capacitor, C U_dc^2 / S (s); infinite: a constant DC voltage.
    i_limit_pu : float
        Largest converter current of an operating point.
    t_a_s : float
        Acceleration time constant 2 H (s) of the virtual rotor.
    k_d : float
        Damping against the PLL's frequency.
    k_w : float
        Damping against nominal frequency: 1 / droop.
    k_q, w_f_rad_s : float
        Reactive droop, and the filter (rad/s) of the power it uses.
    w_lp_rad_s, k_ppll, k_ipll : float
        The PLL's voltage filter (rad/s), proportional gain and integral gain (1/s).
    r_v_pu, l_v_pu : float
        Virtual impedance.
    k_pv, k_iv, k_ffi : float
        Voltage control: proportional, integral (1/s), feed-forward of i_g.
    k_pc, k_ic, k_ffv : float
        Current control: proportional, integral (1/s), feed-forward of v.
    k_ad, w_ad_rad_s : float
        Active damping: gain and filter (rad/s).

    Notes
    -----
    S. D'Arco, J. A. Suul, O. B. Fosso, "A virtual synchronous machine implementation for distributed control of power
    converters in smart grids", Electric Power Systems Research 122 (2015); numbers of the public test system
    "test 08" of PowerSimulationsDynamics.jl.
    """

    u_rated_v: float = 690.0
    s_rated_va: float = 2.75e6
    w1_rad_s: float = 2.0 * pi * 50.0
    l_f_pu: float = 0.08
    r_f_pu: float = 0.003
    c_f_pu: float = 0.074
    r_c_pu: float = 0.0
    l_g_pu: float = 0.2
    r_g_pu: float = 0.01
    c_dc_s: float = inf
    i_limit_pu: float = 1.2
    t_a_s: float = 2.0
    k_d: float = 400.0
    k_w: float = 20.0
    k_q: float = 0.2
    w_f_rad_s: float = 1000.0
    w_lp_rad_s: float = 500.0
    k_ppll: float = 0.084
    k_ipll: float = 4.69
    r_v_pu: float = 0.0
    l_v_pu: float = 0.2
    k_pv: float = 0.59
    k_iv: float = 736.0
    k_ffi: float = 0.0
    k_pc: float = 1.27
    k_ic: float = 14.3
    k_ffv: float = 0.0
    k_ad: float = 0.2
    w_ad_rad_s: float = 50.0


class FollowingParameters(NamedTuple):
    """A grid-following inverter: PLL in the synchronous frame, current control, outer loops by their weights.

    Attributes
    ----------
    u_rated_v ... i_limit_pu : float
        As in `FormingParameters`.
    k_ppll, k_ipll : float
        The PLL's proportional gain (w1 per unit of v_q) and integral gain (1/s).
    c_p, c_dc : float
        Weights of active power and DC voltage in the error that drives i_d.
    k_p, k_i : float
        Their PI: proportional, integral (1/s).
    c_q, c_v : float
        Weights of reactive power and AC voltage in the error that drives i_q.
    k_q, k_iq : float
        Their PI: proportional, integral (1/s).
    w_m_rad_s : float
        Filter (rad/s) of measured power.
    k_pc, k_ic, k_rd : float
        Current control: proportional, integral (1/s), decoupling.
    k_ff, w_ff_rad_s : float
        Feed-forward of the capacitor's voltage and its filter (rad/s).

    Notes
    -----
    PLL and current control have the gains of the reference turbine (docs/turbine.md) in per unit.
    """

    u_rated_v: float = 690.0
    s_rated_va: float = 1.632e6
    w1_rad_s: float = 2.0 * pi * 50.0
    l_f_pu: float = 0.16
    r_f_pu: float = 0.003
    c_f_pu: float = 0.046
    r_c_pu: float = 0.07
    l_g_pu: float = 0.06
    r_g_pu: float = 0.003
    c_dc_s: float = inf
    i_limit_pu: float = 1.2
    k_ppll: float = 0.18669
    k_ipll: float = 70.283
    c_p: float = 1.0
    c_dc: float = 0.0
    k_p: float = 0.1
    k_i: float = 20.0
    c_q: float = 1.0
    c_v: float = 0.0
    k_q: float = 0.1
    k_iq: float = 20.0
    w_m_rad_s: float = 2.0 * pi * 100.0
    k_pc: float = 0.857
    k_ic: float = 1217.0
    k_rd: float = 0.16
    k_ff: float = 0.0
    w_ff_rad_s: float = 5000.0
