"""The figures of docs/turbine.md and docs/turbine-equations.md.

``pytest -m evidence -s tests/plant/test_turbine_figures.py`` prints them.
"""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.plant.protocol import Job, OperatingPoint, Source
from seqsweep.plant.turbine.equilibrium import machine_equilibrium
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine

from ..support import oracle

pytestmark = pytest.mark.evidence


def test_machine_side_at_1_35_mw():
    p, machine = TABLE_I, machine_equilibrium(TABLE_I, 1.35e6)
    loss = p.r_s_ohm * machine.i_q**2 / 1.35e6
    stored_s = 0.5 * p.inertia_kgm2 * machine.w_m**2 / 1.35e6
    print(f"copper loss {loss:.2%}, stored energy {stored_s:.1f} s")
    assert 0.005 < loss < 0.02
    assert 3.0 < stored_s < 8.0


def test_machine_voltage_stays_below_the_limit():
    voltages = []
    for power_w in np.linspace(0.05e6, 1.35e6, 131):
        m, p = machine_equilibrium(TABLE_I, power_w), TABLE_I
        w_e = p.pole_pairs * m.w_m
        voltages.append(np.hypot(w_e * p.l_s_h * m.i_q, w_e * p.flux_wb - p.r_s_ohm * m.i_q))
    limit = TABLE_I.v_dc_ref_v / np.sqrt(2.0)
    print(f"largest machine voltage {max(voltages):.1f} V of {limit:.1f} V, from 0.05 to 1.35 MW")
    assert max(voltages) < limit


def test_resonance_with_either_transform():
    """Amplitude-invariant controllers see sqrt(2/3) of the voltages and currents: PLL and DC gains scale with it."""
    expected = {"power-invariant": 23.0, "amplitude-invariant": 27.0}  # Hz, the lower one; the paper has 23/77 Hz
    for name, share in (("power-invariant", 1.0), ("amplitude-invariant", np.sqrt(2.0 / 3.0))):
        p = TABLE_I._replace(k_pp=TABLE_I.k_pp * share, k_pi=TABLE_I.k_pi * share)
        p = p._replace(k_dcp=TABLE_I.k_dcp / share, k_dci=TABLE_I.k_dci / share)
        poles = oracle.closed_loop_poles(0.65e6, 1.4 * LINE_R_OHM, 1.4 * LINE_L_H, source_voltage_v=690.0, p=p)
        pole = oracle.resonance_pole(poles)
        nu = abs(pole.imag) / 2.0 / np.pi
        print(f"{name}: {pole.real:+.2f} rad/s at {50 - nu:.1f}/{50 + nu:.1f} Hz; the paper has 23/77 Hz")
        assert 50.0 - nu == pytest.approx(expected[name], abs=1.0)


def test_loss_in_the_shunt_resistor():
    p = TABLE_I
    current = 690.0 / abs(p.r_f_ohm + 1.0 / (1j * p.w1_rad_s * p.c_f_f))
    print(f"loss in Rf at 1.0 pu: {p.r_f_ohm * current**2:.0f} W")
    assert p.r_f_ohm * current**2 == pytest.approx(235.0, abs=1.0)


def test_certification_over_the_range():
    plant, changes = ReferenceTurbine(), []
    for power_w in np.linspace(0.05e6, 1.35e6, 14):
        for voltage_v in np.linspace(0.85, 1.1, 6) * 690.0:
            state = plant.settle(OperatingPoint(power_w, voltage_v), Source())
            ((end, _),) = plant.run([Job(state, None)], 400)
            changes.append(np.max(np.abs(end.values - state.values) / np.maximum(np.abs(state.values), 1.0)))
    print(f"largest change of a state over one period, 0.05-1.35 MW, 0.85-1.1 pu: {max(changes):.1e}")
    assert max(changes) < 1e-9


@pytest.mark.parametrize("h_us", [10.0, 20.0, 25.0])
def test_rk4_on_the_shunt(h_us):
    """What the exact solution avoids: the response of RK4, with its half-step inputs, to the same linear system."""
    f_hz = np.geomspace(1.0, 1000.0, 100)
    f_hz = f_hz[np.abs(f_hz - 50.0) > 1.0]
    exact = oracle.admittance_pn(f_hz, 0.65e6, 690.0)
    stepped = np.array([_rk4_admittance(f, h_us * 1e-6) for f in f_hz])
    error = np.linalg.norm(stepped - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    print(f"RK4 on the shunt, {h_us:g} us: {np.median(error):.1e} median, {error.max():.1e} max")
    assert error.max() > 1e-3


def _rk4_admittance(f_hz: float, h: float) -> np.ndarray:
    lin = oracle.linearise(0.65e6, 690.0)
    z, one = h * lin.A, np.eye(len(lin.A))
    step = one + z + z @ z / 2 + z @ z @ z / 6 + z @ z @ z @ z / 24
    begin = h / 6 * (one + z + z @ z / 2 + z @ z @ z / 4) @ lin.B
    middle, end = h / 6 * (4 * one + 2 * z + z @ z / 2) @ lin.B, h / 6 * lin.B
    turn = np.exp(2j * np.pi * (f_hz - 50.0) * h)
    x = np.linalg.solve(turn * one - step, begin + middle * np.sqrt(turn) + end * turn)
    return oracle.T_PN @ (lin.C @ x + lin.D) @ np.linalg.inv(oracle.T_PN)
