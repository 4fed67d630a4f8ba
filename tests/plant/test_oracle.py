"""The oracle against the printed numbers of the reference turbine, and the plant's equilibria against it."""

from __future__ import annotations

import cmath
from decimal import Decimal
from math import degrees, pi, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from seqsweep.plant.turbine.equilibrium import (
    grid_side_equilibrium,
    machine_equilibrium,
    terminal_voltage_for_source,
    thevenin_voltage,
)
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, LINE_X_OHM, TABLE_I

from ..support import oracle

P_W = 0.65e6
U_V = 690.0
V_LIMIT_V = 1200.0 / sqrt(2.0)
POWERS_W = (0.05e6, 0.2e6, 0.65e6, 1.1e6, 1.3e6, 1.35e6)

ADMITTANCE_TEXT = """
5    | +0.234844-1.166782j   | -0.0778075+0.4003271j | -0.0778043+0.4003336j | +0.2366293-1.480966j
23   | -0.173006-1.910209j   | +0.2245512+1.520572j  | +0.2245612+1.520576j  | -0.1719478-2.224378j
60   | -0.8320882+0.2671487j | +0.8298293+0.0570844j | +0.8298293+0.0570837j | -0.8324830-0.0470075j
150  | +0.8613961+2.292534j  | +0.0166181-0.1662755j | +0.0166180-0.1662656j | +0.8573100+1.978310j
400  | +2.831369-0.5595668j  | -0.0469478-0.0380197j | -0.0469492-0.0380275j | +2.818054-0.8730620j
1000 | +0.5325129+2.032454j  | -0.0074511-0.0013679j | -0.0074516-0.0013678j | +0.4953099+1.721583j
"""
ADMITTANCE_ROWS = [line.split("|") for line in ADMITTANCE_TEXT.strip().splitlines()]

ROUNDED_UP = {"+0.0570837": "+0.05708365"}
"""Ynp at 60 Hz is 0.0570836475 (in rational arithmetic too): the page's last digit is one too high."""


def agrees_as_printed(value: float, printed: str) -> bool:
    """Whether ``value`` rounds to ``printed``: half a unit of its last digit, and a little for ties."""
    unit = 10.0 ** Decimal(printed).as_tuple().exponent
    return abs(value - float(printed)) <= 0.5001 * unit


def split_complex(printed: str) -> tuple[str, str]:
    """'+1.5-2.25j' to ('+1.5', '-2.25')."""
    text = printed.strip().rstrip("j")
    cut = max(text.rfind("+"), text.rfind("-"))
    return text[:cut], text[cut:]


def poles_at(power_w: float, scale: float) -> np.ndarray:
    return oracle.closed_loop_poles(power_w, scale * LINE_R_OHM, scale * LINE_L_H, source_voltage_v=U_V)


def scale_of_scr(scr: float) -> float:
    """Multiple of Table I's line at a short-circuit ratio U^2 / (S |Z|)."""
    return TABLE_I.u_rated_v**2 / (TABLE_I.s_rated_va * abs(complex(LINE_R_OHM, LINE_X_OHM))) / scr


@pytest.mark.parametrize("row", ADMITTANCE_ROWS, ids=lambda row: f"{row[0].strip()} Hz")
def test_admittance_is_the_printed_one_to_the_last_digit(row):
    y = oracle.admittance_pn(np.array([float(row[0])]), P_W, U_V)[0].ravel()
    for value, printed in zip(y, row[1:], strict=True):
        real, imag = split_complex(printed)
        assert agrees_as_printed(value.real, real)
        assert agrees_as_printed(value.imag, ROUNDED_UP.get(imag, imag))


@pytest.mark.parametrize(
    ("scale", "volts", "angle", "sigma", "hertz"),
    [
        (1.0, "687.02", "19.925", "-13.45", "25.59"),
        (1.2, "672.46", "24.703", "-4.74", "26.14"),
        (1.4, "647.31", "30.445", "9.57", "26.26"),
    ],
)
def test_scaled_lines_give_the_printed_voltage_angle_and_mode(scale, volts, angle, sigma, hertz):
    r, l_h = scale * LINE_R_OHM, scale * LINE_L_H
    v = oracle.terminal_voltage(P_W, r, l_h, U_V)
    assert agrees_as_printed(v, volts)
    assert agrees_as_printed(-degrees(cmath.phase(oracle.source_voltage(P_W, v, r, l_h))), angle)
    pole = oracle.resonance_pole(poles_at(P_W, scale))
    assert agrees_as_printed(pole.real, sigma)
    assert agrees_as_printed(pole.imag / (2.0 * pi), hertz)


def test_only_the_weakest_of_the_three_grids_is_unstable():
    assert [poles_at(P_W, scale).real.max() < 0.0 for scale in (1.0, 1.2, 1.4)] == [True, True, False]


@pytest.mark.parametrize(("power_w", "percent"), [(0.65e6, "-5.8"), (0.70e6, "-10.4")])
def test_damping_ratio_at_1_4_z(power_w, percent):
    pole = oracle.resonance_pole(poles_at(power_w, 1.4))
    assert agrees_as_printed(-100.0 * pole.real / abs(pole), percent)


def test_growth_at_0_60_mw_and_1_4_z():
    assert agrees_as_printed(oracle.resonance_pole(poles_at(0.60e6, 1.4)).real, "3.3")


def test_scr_scenarios_at_1_1_mw():
    assert agrees_as_printed(scale_of_scr(1.8), "0.648")
    assert poles_at(1.1e6, scale_of_scr(1.44)).real.max() < 0.0
    assert agrees_as_printed(oracle.resonance_pole(poles_at(1.1e6, scale_of_scr(1.3))).real, "7.8")
    for scr in (1.2, 1.1):
        with pytest.raises(ValueError, match="no equilibrium"):
            poles_at(1.1e6, scale_of_scr(scr))


def test_closed_loop_poles_are_roots_of_det_i_plus_yz():
    """Joins admittance and poles by a route neither was computed on; fails if the current's sign is wrong."""
    scale = 1.4
    v = oracle.terminal_voltage(P_W, scale * LINE_R_OHM, scale * LINE_L_H, U_V)
    m = oracle.linearise(P_W, v)
    s = oracle.resonance_pole(poles_at(P_W, scale))
    y = m.C @ np.linalg.solve(s * np.eye(15) - m.A, m.B) + m.D
    z_dd, z_dq = scale * (LINE_R_OHM + s * LINE_L_H), scale * TABLE_I.w1_rad_s * LINE_L_H
    z = np.array([[z_dd, -z_dq], [z_dq, z_dd]])
    assert abs(np.linalg.det(np.eye(2) + y @ z)) < 1e-9


def test_mirror_symmetry_is_exact():
    f = np.array([3.0, 23.0, 77.0, 150.0, 700.0])
    y, mirror = (oracle.admittance_pn(x, P_W, U_V) for x in (f, 100.0 - f))
    assert np.allclose(y[:, 1, 1], mirror[:, 0, 0].conj(), rtol=1e-12)
    assert np.allclose(y[:, 1, 0], mirror[:, 0, 1].conj(), rtol=1e-12)


def test_linearisation_follows_the_nonlinear_equations():
    """A 10 mV step of v_pcc for 20 ms: second order leaves less than 1e-3 of the response."""
    m = oracle.linearise(P_W, U_V)
    dv, end = np.array([0.006, 0.008]), 0.02
    run = solve_ivp(
        lambda _, x: oracle.rhs(x, m.v_pcc + dv, m.wind), (0.0, end), m.x, "Radau", rtol=1e-10, atol=1e-10, jac=m.A
    )
    block = np.zeros((17, 17))
    block[:15, :15], block[:15, 15:] = m.A, m.B
    linear = (expm(block * end) @ np.append(np.zeros(15), dv))[:15]
    nonlinear = run.y[:, -1] - m.x
    assert np.linalg.norm(nonlinear - linear) < 1e-3 * np.linalg.norm(linear)


@pytest.mark.parametrize("power_w", np.linspace(0.05e6, 1.35e6, 14))
def test_machine_stays_below_the_dc_link_limit(power_w):
    x, _ = oracle.equilibrium(power_w, U_V)
    v_machine = oracle.machine_voltage(x)
    assert np.hypot(*v_machine) < V_LIMIT_V
    assert v_machine @ x[10:12] == pytest.approx(power_w, rel=1e-12)


def test_machine_reactance_at_rated_speed_is_its_decoupling():
    assert TABLE_I.pole_pairs * TABLE_I.w_m_rated * TABLE_I.l_s_h == pytest.approx(0.2561, rel=1e-12)


@pytest.mark.parametrize("power_w", POWERS_W)
@pytest.mark.parametrize("voltage_v", [0.8 * U_V, U_V, 1.1 * U_V])
def test_every_mode_on_an_ideal_source_is_stable(power_w, voltage_v):
    assert np.linalg.eigvals(oracle.linearise(power_w, voltage_v).A).real.max() < -0.1


@pytest.mark.parametrize("power_w", POWERS_W)
def test_machine_modes_are_a_slow_rotor_and_fast_currents(power_w):
    modes = np.sort(np.linalg.eigvals(oracle.linearise(power_w, U_V).A[10:, 10:]).real)
    assert -0.4 < modes[-1] < -0.1
    assert modes[-2] < -60.0


def test_neither_grid_nor_dc_link_reaches_the_machine():
    a = oracle.linearise(P_W, U_V).A
    assert not np.any(a[10:, :10])


@pytest.mark.parametrize("power_w", POWERS_W)
@pytest.mark.parametrize("voltage_v", [0.8 * U_V, U_V, 1.1 * U_V])
def test_plant_equilibrium_is_the_oracles(power_w, voltage_v):
    x, wind = oracle.equilibrium(power_w, voltage_v)
    g, m = grid_side_equilibrium(TABLE_I, power_w, voltage_v), machine_equilibrium(TABLE_I, power_w)
    grid = [g.i_l.real, g.i_l.imag, g.v_c.real, g.v_c.imag, 0.0, 0.0, g.xi_dc, g.xi_d, g.xi_q, 1200.0]
    assert x == pytest.approx(np.array([*grid, m.i_d, m.i_q, m.xi_d, m.xi_q, m.w_m]), rel=1e-11, abs=1e-9)
    assert wind == pytest.approx(m.wind_speed_m_s, rel=1e-11)
    i_g = -oracle.current(x, np.array([voltage_v, 0.0]))
    assert complex(*i_g) == pytest.approx(g.i_g, rel=1e-9)
    assert (g.v_conv * g.i_l.conjugate()).real == pytest.approx(power_w, rel=1e-12)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.2, 1.4])
def test_plant_source_voltage_and_its_inverse_are_the_oracles(scale):
    r, l_h = scale * LINE_R_OHM, scale * LINE_L_H
    v = terminal_voltage_for_source(TABLE_I, P_W, U_V, r, l_h)
    assert v == pytest.approx(oracle.terminal_voltage(P_W, r, l_h, U_V), rel=1e-10)
    v_g = thevenin_voltage(TABLE_I, P_W, v, r, l_h)
    assert v_g == pytest.approx(oracle.source_voltage(P_W, v, r, l_h), rel=1e-12)
    assert abs(v_g) == pytest.approx(U_V, rel=1e-12)
    assert thevenin_voltage(TABLE_I, P_W, v, r, l_h, w1=TABLE_I.w1_rad_s) == v_g


def test_plant_equilibrium_refuses_what_cannot_be():
    with pytest.raises(ValueError, match=r"no equilibrium: 1\.1e\+06 W cannot be carried"):
        terminal_voltage_for_source(TABLE_I, 1.1e6, U_V, LINE_R_OHM, LINE_L_H)
    with pytest.raises(ValueError, match="must be positive"):
        machine_equilibrium(TABLE_I, 0.0)
    with pytest.raises(ValueError, match="torque law cannot deliver"):
        machine_equilibrium(TABLE_I, 1e12)


def test_closed_loop_poles_want_exactly_one_voltage():
    with pytest.raises(ValueError, match="exactly one"):
        oracle.closed_loop_poles(P_W, LINE_R_OHM, LINE_L_H)
    with pytest.raises(ValueError, match="exactly one"):
        oracle.closed_loop_poles(P_W, LINE_R_OHM, LINE_L_H, source_voltage_v=U_V, terminal_voltage_v=U_V)


def test_either_voltage_gives_the_same_poles():
    v = oracle.terminal_voltage(P_W, LINE_R_OHM, LINE_L_H, U_V)
    by_terminal = oracle.closed_loop_poles(P_W, LINE_R_OHM, LINE_L_H, terminal_voltage_v=v)
    assert np.allclose(np.sort_complex(by_terminal), np.sort_complex(poles_at(P_W, 1.0)), rtol=1e-9)
