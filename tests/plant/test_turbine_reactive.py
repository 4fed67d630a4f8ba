"""Reactive power of the reference turbine, against the exact linearisation with the same set-point."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np
import pytest

from seqsweep.plant.protocol import Injection, Job, NotSettled, OperatingPoint, Source, Tone
from seqsweep.plant.turbine.equilibrium import grid_side_equilibrium, terminal_voltage_for_source, thevenin_voltage
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.measure.loadflow import terminal_voltage
from seqsweep.sweep.plan import Grid

from ..support import oracle
from ..sweep.test_accuracy import BAR_MEDIAN, BAR_WORST, relative, swept

U_V = 690.0
LINE = Source("thevenin", LINE_R_OHM, LINE_L_H)
POINTS = ((0.2e6, -0.4e6, 0.9), (0.65e6, 0.3e6, 1.0), (1.3e6, -0.4e6, 1.1), (1.3e6, 0.4e6, 1.02))
PLAIN, COMPENSATED, EMT = {}, {"damping_gain": 0.3}, {"integrator": "emt"}


@pytest.mark.parametrize(("power_w", "q_var", "voltage_pu"), POINTS)
def test_equilibrium_is_the_oracles(power_w, q_var, voltage_pu):
    voltage_v = voltage_pu * U_V
    x, _ = oracle.equilibrium(power_w, voltage_v, q_var=q_var)
    g = grid_side_equilibrium(TABLE_I, complex(power_w, q_var), voltage_v)
    found = [g.i_l.real, g.i_l.imag, g.v_c.real, g.v_c.imag, 0.0, 0.0, g.xi_dc, g.xi_d, g.xi_q, 1200.0]
    assert x[:10] == pytest.approx(np.array(found), rel=1e-11, abs=1e-9)
    assert g.v_pcc * g.i_l.conjugate() == pytest.approx(complex(power_w, q_var), rel=1e-12)
    ahead = thevenin_voltage(TABLE_I, complex(power_w, q_var), voltage_v, LINE_R_OHM, LINE_L_H)
    assert ahead == pytest.approx(oracle.source_voltage(power_w, voltage_v, LINE_R_OHM, LINE_L_H, q_var=q_var))


@pytest.mark.parametrize("parameters", [PLAIN, COMPENSATED, EMT], ids=["plain", "compensated", "emt"])
@pytest.mark.parametrize("source", [Source(), replace(LINE, l_h=0.3 * LINE_L_H)], ids=["ideal", "line"])
def test_an_equilibrium_stays_where_it_is(parameters, source):
    plant = ReferenceTurbine(**parameters)
    for power_w, q_var, voltage_pu in POINTS:
        state = plant.equilibrium(OperatingPoint(power_w, voltage_pu * U_V, q_var), source)
        ((end, record),) = plant.run([Job(state, None)], 400)
        assert end.values == pytest.approx(state.values, rel=1e-9, abs=1e-7)
        into = 1.5 * record.v[0] * record.i[0].conj()
        shunt_var = TABLE_I.w1_rad_s * TABLE_I.c_f_f * (voltage_pu * U_V) ** 2
        assert -into.imag == pytest.approx(q_var + shunt_var, rel=1e-4)


@pytest.mark.parametrize("parameters", [PLAIN, EMT], ids=["plain", "emt"])
@pytest.mark.parametrize(("power_mw", "q_mvar", "voltage_pu"), [(0.2, -0.4, 0.9), (1.3, 0.4, 1.05)])
def test_the_swept_turbine_is_its_exact_linearisation(parameters, power_mw, q_mvar, voltage_pu):
    plant = ReferenceTurbine(**parameters)
    band = {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 24}
    f_hz, y = swept(plant, band, power_mw=power_mw, voltage_pu=voltage_pu, q_mvar=q_mvar)
    error = relative(y, oracle.admittance_pn(f_hz, power_mw * 1e6, voltage_pu * U_V, q_var=q_mvar * 1e6))
    print(f"\n  {power_mw} MW, {q_mvar} Mvar, {voltage_pu} pu: worst {error.max():.1e}, median {np.median(error):.1e}")
    assert error.max() <= BAR_WORST
    assert np.median(error) <= BAR_MEDIAN


def test_poles_behind_a_line_are_the_oracles():
    q_var = 0.2e6
    source = replace(LINE, voltage_v=0.98 * U_V)
    plant = ReferenceTurbine()
    found = plant.linearise(plant.equilibrium(OperatingPoint(0.65e6, None, q_var), source))
    exact = oracle.closed_loop_poles(0.65e6, LINE_R_OHM, LINE_L_H, source_voltage_v=0.98 * U_V, q_var=q_var)
    assert oracle.resonance_pole(found) == pytest.approx(oracle.resonance_pole(exact), rel=1e-4)
    idle = oracle.closed_loop_poles(0.65e6, LINE_R_OHM, LINE_L_H, source_voltage_v=0.98 * U_V)
    assert abs(oracle.resonance_pole(exact) - oracle.resonance_pole(idle)) > 1.0


def test_load_flow_on_the_black_box_finds_the_oracles_voltage():
    grid = Grid(LINE_R_OHM, LINE_L_H, U_V)
    for q_var in (-0.05e6, 0.2e6):
        exact = oracle.terminal_voltage(0.65e6, LINE_R_OHM, LINE_L_H, U_V, q_var=q_var)
        assert terminal_voltage(ReferenceTurbine(), 0.65e6, grid, q_var) == pytest.approx(exact, rel=1e-6)
        power_va = complex(0.65e6, q_var)
        closed = terminal_voltage_for_source(TABLE_I, power_va, U_V, LINE_R_OHM, LINE_L_H)
        assert closed == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("parameters", [PLAIN, COMPENSATED, EMT], ids=["plain", "compensated", "emt"])
def test_a_job_ends_with_the_same_bytes_whatever_it_runs_with(parameters):
    plant = ReferenceTurbine(**parameters)
    tone = Injection("series_voltage", (Tone(77.0, 0.5),))
    jobs = [Job(plant.equilibrium(OperatingPoint(0.65e6, U_V, q), Source()), tone) for q in (0.0, 1e5, 0.0, -3e5)]
    together = plant.run(jobs, 50)
    for job, (end, record) in zip(jobs, together, strict=True):
        ((alone, alone_record),) = plant.run([job], 50)
        assert alone.values.tobytes() == end.values.tobytes()
        assert alone_record.i.tobytes() == record.i.tobytes()


@pytest.mark.parametrize("parameters", [PLAIN, EMT], ids=["plain", "emt"])
def test_the_limit_holds_the_whole_current(parameters):
    """Through a dip to 60 % the DC voltage control asks for all it can get; reactive current goes first."""
    i_limit = 2100.0
    plant = ReferenceTurbine(**parameters, i_limit_a=i_limit)
    state = plant.equilibrium(OperatingPoint(1.3e6, U_V, -0.5e6), replace(LINE, l_h=0.1 * LINE_L_H))
    ((end, _),) = plant.run([Job(replace(state, v_source=0.6 * state.v_source), None)], 3000)
    assert hypot(*end.values[:2]) == pytest.approx(i_limit, rel=5e-3)


def test_what_cannot_be_is_refused():
    plant = ReferenceTurbine()
    with pytest.raises(
        ValueError, match=r"reactive power of 2 Mvar is outside the range of dpmsg-v1: -0.6 to 0.6 Mvar"
    ):
        plant.equilibrium(OperatingPoint(0.65e6, U_V, 2e6), Source())
    tight = ReferenceTurbine(i_limit_a=1500.0)
    with pytest.raises(NotSettled, match=r"the converter would need 1529 A; its limit is 1500 A"):
        tight.equilibrium(OperatingPoint(0.9e6, U_V, 0.55e6), Source())
    message = r"no equilibrium: 1.1e\+06 W and -300000 var cannot be carried"
    with pytest.raises(NotSettled, match=message):
        plant.equilibrium(OperatingPoint(1.1e6, None, -0.3e6), replace(LINE, voltage_v=U_V))
