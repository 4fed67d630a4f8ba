"""Parameters of the reference turbine: Table I of the paper, and what the paper leaves open.

A direct-drive permanent-magnet synchronous generator (D-PMSG) with back-to-back converters. The
grid side is rated 1.632 MVA; machine and rotor are laid out for 1.35 MW, the end of the operating
range, because 0.2561 ohm of machine reactance and 1200 V of DC link allow 1.40 MW at most.

All space vectors are power-invariant (|v_dq| = line-to-line RMS, P = v_d i_d + v_q i_q).

Machine side, in the rotor frame (d on the flux), i out of the machine into the converter, v the
terminal voltage, written with ``i = i_d + 1j*i_q`` and ``w_e = pole_pairs * w_m``::

    Ls di/dt  = -v - Rs i - 1j w_e Ls i + 1j w_e flux
    v         = Kmp (i - i*) + xi - 1j Kmrd i          xi' = Kmi (i - i*)
    i*        = 1j T* / (pole_pairs flux)              T*  = k_opt w_m^2
    T_e       = pole_pairs flux i_q                    P_machine = Re(v conj(i))
    J dw_m/dt = T_aero - T_e
    T_aero    = 0.5 rho pi R^3 v_w^2 (c_q1 lambda - c_q2 lambda^2)      lambda = w_m R / v_w

The error is ``i - i*``, not ``i* - i``: a higher terminal voltage drives the current *down*. Then
``Ls di/dt = -(Kmp + Rs) i - xi + ...`` and both gains act with the sign that damps. ``-1j Kmrd i``
cancels ``-1j w_e Ls i`` at rated speed and over-compensates below, which Kmp outweighs by far. There
is no flux feed-forward: the integrator carries the machine voltage.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

LINE_R_OHM = 0.012
"""Resistance of the grid line for one turbine (ohm), Table I."""

LINE_X_OHM = 0.25
"""Reactance of the grid line for one turbine at 50 Hz (ohm), Table I."""

LINE_L_H = LINE_X_OHM / (2.0 * pi * 50.0)
"""Inductance of the grid line for one turbine (H), from `LINE_X_OHM`."""

_W_M_RATED = 1.8
_POLE_PAIRS = 44.0
_W_E_RATED = _POLE_PAIRS * _W_M_RATED
_E_RATED_V = 600.0
_X_S_RATED_OHM = 0.2561


class TurbineParameters(NamedTuple):
    """Parameters of the D-PMSG; plain floats in SI, in the order in which the power flows outwards.

    Attributes
    ----------
    u_rated_v : float
        Rated line-to-line RMS voltage U1 (V). Table I.
    s_rated_va : float
        Rated apparent power of the grid side S (VA). Table I.
    w1_rad_s : float
        Fundamental angular frequency, 2 pi 50 Hz (rad/s). Table I.
    l_c_h : float
        Converter inductance Lc (H). Table I.
    r_f_ohm : float
        Resistor in series with the shunt capacitor Rf (ohm). Table I.
    c_f_f : float
        Shunt capacitor Cf (F). Table I.
    c_dc_f : float
        DC-link capacitor C (F). Table I.
    v_dc_ref_v : float
        DC-link voltage reference Udc (V). Table I.
    k_pp, k_pi : float
        PLL proportional (rad/s per V) and integral gain (rad/s^2 per V). Table I.
    k_p, k_i : float
        Grid-side current PI, proportional (ohm) and integral gain (ohm/s). Table I.
    k_rd_ohm : float
        Grid-side current decoupling, about w1 Lc (ohm). Table I.
    k_dcp, k_dci : float
        DC voltage PI, proportional (A/V) and integral gain (A/(V s)). Table I.
    k_mp, k_mi : float
        Machine-side current PI, proportional (ohm) and integral gain (ohm/s). Table I.
    k_mrd_ohm : float
        Machine-side current decoupling, a fixed impedance (ohm). Table I.
    i_limit_a : float
        Limit of |i*| on the grid side (A, power-invariant, rated is S/U1). Assumed: 1.2 of rated, as
        converters of this size allow for seconds.
    pole_pairs : float
        Pole pairs of the machine. Assumed: 44, usual for direct drive at 1.5 MW.
    w_m_rated : float
        Rated rotor speed (rad/s). Assumed: 1.8 (17.2 rpm), usual for direct drive at 1.5 MW.
    l_s_h : float
        Machine inductance Ls (H). Assumed: w_e Ls = `k_mrd_ohm` at rated speed, so that the
        decoupling of Table I fits.
    r_s_ohm : float
        Stator resistance Rs (ohm). Assumed: 1.1 % of copper loss at 1.35 MW.
    flux_wb : float
        Magnet flux linkage (Wb, power-invariant). Assumed: E = 600 V at rated speed, next to
        sqrt(0.2561 P) = 588 V, where the terminal voltage at 1.35 MW is least (832 V of 848 V).
    inertia_kgm2 : float
        Rotor inertia J (kg m^2). Assumed: stored energy of 4.8 s at 1.35 MW.
    k_opt : float
        MPPT torque law T* = k_opt w_m^2 (N m s^2). Assumed: 1.35 MW at rated speed.
    rho_kgm3 : float
        Air density (kg/m^3). Assumed: standard air.
    radius_m : float
        Rotor radius R (m). Assumed: the MPPT law sits on the maximum of Cp (lambda = 8.0).
    c_q1, c_q2 : float
        Torque coefficient Cq = c_q1 lambda - c_q2 lambda^2. Assumed: Cp = lambda Cq has its maximum
        of 0.45 at lambda = 8, torque vanishes at lambda = 12. T_aero is then a polynomial in w_m and
        v_w. The MPPT law meets it at dT/dw = -k_opt w_m, against +2 k_opt w_m of the load: stable.
    """

    u_rated_v: float = 690.0
    s_rated_va: float = 1.632e6
    w1_rad_s: float = 2.0 * pi * 50.0
    l_c_h: float = 0.15e-3
    r_f_ohm: float = 0.02
    c_f_f: float = 500e-6
    c_dc_f: float = 0.15
    v_dc_ref_v: float = 1200.0
    k_pp: float = 0.085
    k_pi: float = 32.0
    k_p: float = 0.25
    k_i: float = 355.0
    k_rd_ohm: float = 0.0471
    k_dcp: float = 0.5
    k_dci: float = 5.0
    k_mp: float = 0.8
    k_mi: float = 50.0
    k_mrd_ohm: float = _X_S_RATED_OHM
    i_limit_a: float = 1.2 * 1.632e6 / 690.0
    pole_pairs: float = _POLE_PAIRS
    w_m_rated: float = _W_M_RATED
    l_s_h: float = _X_S_RATED_OHM / _W_E_RATED
    r_s_ohm: float = 0.003
    flux_wb: float = _E_RATED_V / _W_E_RATED
    inertia_kgm2: float = 4.0e6
    k_opt: float = 2.341e5
    rho_kgm3: float = 1.225
    radius_m: float = 42.49
    c_q1: float = 0.45 * 3.0 / 8.0**2
    c_q2: float = 0.45 * 2.0 / 8.0**3


TABLE_I = TurbineParameters()
