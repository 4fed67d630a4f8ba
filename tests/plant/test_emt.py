"""The second-order step, ``integrator="emt"``. Its figures: ``python -m pytest -s tests/plant/test_emt.py``."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import pi

import numpy as np
import pytest

from seqsweep.plant.check import check_plant
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone
from seqsweep.plant.registry import PlantError, PlantSpec, fingerprint, make_plant
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine

from ..support import oracle
from ..support.machine_code import instructions
from ..sweep.test_accuracy import BAND, BAR_MEDIAN, BAR_WORST, IN_PLACE, P_MW, U_V, relative, swept

LINE = Source("thevenin", LINE_R_OHM, LINE_L_H)
STEPS_US = (50.0, 25.0, 12.5)
POINT = OperatingPoint(P_MW * 1e6, U_V)


@cache
def errors(kind, step_us, points=30):
    """(f, error) of a sweep against the exact linearisation; settled to well below the step's error."""
    plant = ReferenceTurbine(dt_s=step_us * 1e-6, integrator="emt")
    sweep = {**BAND, "points": points, "tolerance": 1e-7}
    f_hz, y = swept(plant, sweep, source=IN_PLACE if kind == "line" else None, amplitude_pu=1e-4)
    return f_hz, relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))


@pytest.mark.parametrize("kind", ["ideal", "line"])
def test_half_the_step_leaves_a_quarter_of_the_error(kind):
    """Against the exact linearisation; the largest errors on the ideal source fall faster still."""
    print(f"\n  {kind}: step (us), worst error, at (Hz), median")
    found = []
    for step_us in STEPS_US:
        f_hz, error = errors(kind, step_us)
        found.append((error.max(), np.median(error)))
        print(f"  | {step_us:g} | {error.max():.1e} | {f_hz[np.argmax(error)]:.4g} | {np.median(error):.1e} |")
    worst, median = np.array(found).T
    assert np.all(worst[:-1] >= 3.8 * worst[1:])
    assert np.all(median[:-1] >= 3.8 * median[1:])
    assert np.all(median[:-1] <= 4.4 * median[1:])


@pytest.mark.parametrize(("power_mw", "voltage_pu"), [(0.65, 1.0), (0.2, 1.1), (1.3, 0.9)], ids=str)
def test_on_an_ideal_source_the_default_step_keeps_the_turbines_bars(power_mw, voltage_pu):
    plant = ReferenceTurbine(integrator="emt")
    f_hz, y = swept(plant, BAND, power_mw=power_mw, voltage_pu=voltage_pu)
    error = relative(y, oracle.admittance_pn(f_hz, power_mw * 1e6, voltage_pu * U_V))
    print(f"\n  {power_mw} MW, {voltage_pu} pu: worst {error.max():.1e}, median {np.median(error):.1e}", end="")
    assert error.max() <= BAR_WORST
    assert np.median(error) <= BAR_MEDIAN


def test_behind_a_line_the_trapezoidal_rule_warps_the_frequency():
    """What is left at 1 kHz is the shunt, Lc and Rf at 2/h tan(w h / 2) instead of w, w seen from the frame at w1."""
    f_hz, error = errors("line", 50.0)
    w_h = (2.0 * pi * f_hz - TABLE_I.w1_rad_s) * 50e-6
    warped = TABLE_I.w1_rad_s + 2.0 / 50e-6 * np.tan(0.5 * w_h)
    exact = oracle.admittance_pn(f_hz, P_MW * 1e6, U_V)
    expected = relative(oracle.admittance_pn(warped / (2.0 * pi), P_MW * 1e6, U_V), exact)
    assert error[-1] == pytest.approx(expected[-1], rel=0.05)


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
@pytest.mark.parametrize("step_us", [5.0, 50.0, 400.0])
def test_an_equilibrium_of_the_equations_is_a_fixed_point(source, step_us):
    plant = ReferenceTurbine(dt_s=step_us * 1e-6, integrator="emt")
    for power_w, voltage_v in [(0.05e6, 0.85 * U_V), (0.65e6, U_V), (1.35e6, 1.15 * U_V)]:
        state = plant.equilibrium(OperatingPoint(power_w, voltage_v), source)
        ((end, record),) = plant.run([Job(state, None)], round(0.02 / plant.dt_s))
        moved = np.abs(end.values - state.values) / np.maximum(np.abs(state.values), 1.0)
        assert moved.max() <= 1e-10
        assert np.abs(np.abs(record.v) - np.abs(record.v[0])).max() <= 1e-9 * voltage_v


def test_the_stepped_poles_are_those_of_the_loop():
    plant = ReferenceTurbine(integrator="emt")
    pole = oracle.resonance_pole(plant.linearise(plant.settle(POINT, LINE)))
    source = oracle.closed_loop_poles(P_MW * 1e6, LINE_R_OHM, LINE_L_H, terminal_voltage_v=U_V)
    exact = oracle.resonance_pole(source)
    assert abs(pole - exact) <= 1e-4 * abs(exact)


def kicked(integrator, step_us, source, tones):
    """PCC current and final v_dc of 20 ms under ``tones``, at whole 100 us."""
    plant = ReferenceTurbine(dt_s=step_us * 1e-6, integrator=integrator)
    job = Job(plant.equilibrium(POINT, source), Injection("series_voltage", tones))
    ((end, record),) = plant.run([job], round(0.02 / plant.dt_s))
    return record.i[:: round(100.0 / step_us)], end.values[7]


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
def test_several_tones_of_large_signal_are_runge_kuttas(source):
    """5 % at two frequencies: nothing is small, no limit acts; the order is that of the nonlinear equations."""
    tones = (Tone(77.0, 28.0, 0.3), Tone(-140.0, 28.0, 1.0))
    exact, v_dc = kicked("rk4", 5.0, source, tones)
    off = []
    for step_us in (50.0, 25.0):
        i, v = kicked("emt", step_us, source, tones)
        off.append([np.abs(i - exact).max() / np.abs(exact).max(), abs(v - v_dc) / v_dc])
    assert off[0][0] <= 1e-3
    assert off[0][1] <= 1e-5
    assert off[0][0] >= 3.6 * off[1][0]


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
def test_the_limits_act_as_runge_kuttas_do(source):
    """Half the voltage more at 90 Hz: converter voltage and current reference meet their limits every few ms."""
    tones = (Tone(90.0, 0.5 * U_V),)
    exact, v_dc = kicked("rk4", 5.0, source, tones)
    off = []
    for step_us in (50.0, 25.0, 12.5):
        i, v = kicked("emt", step_us, source, tones)
        off.append(max(np.abs(i - exact).max() / np.abs(exact).max(), abs(v - v_dc) / v_dc))
    print("\n  limited, off Runge-Kutta's: " + ", ".join(f"{e:.1e}" for e in off), end="")
    assert off[0] <= 2e-3
    for coarse, fine in pairwise(off):
        assert 1.7 * fine <= coarse <= 2.3 * fine  # first order: a limit did act


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
def test_the_promise_of_a_plant_is_kept(source):
    findings = check_plant(ReferenceTurbine(integrator="emt"), POINT, source)
    assert [finding for finding in findings if not finding.passed] == []
    assert len(findings) > 5


def test_the_integrator_is_a_parameter_and_so_in_the_fingerprint():
    spec = PlantSpec("dpmsg-v1", {"integrator": "emt"})
    plant = spec.make()
    assert plant.integrator == "emt"
    assert fingerprint(plant, spec)["parameters"] == {"integrator": "emt"}
    assert make_plant("dpmsg-v1").integrator == "rk4"


def test_other_integrators_and_damping_are_refused_in_words():
    with pytest.raises(ValueError, match=r"integrator is 'euler'; dpmsg-v1 has 'rk4' and 'emt'"):
        ReferenceTurbine(integrator="euler")
    with pytest.raises(ValueError, match="'emt' has no damping control: leave damping_gain at 0"):
        ReferenceTurbine(integrator="emt", damping_gain=0.5)
    with pytest.raises(PlantError, match="'rk4' and 'emt'"):
        make_plant("dpmsg-v1", {"integrator": 4})


@pytest.mark.parametrize("name", ["advance_ideal", "advance_thevenin"])
def test_lanes_are_vector_code(name):
    """The driver's preparation is scalar, once a call."""
    from seqsweep.plant.kernels import turbine, turbine_emt

    kept, x = np.empty((1, 8, turbine.LANES)), np.ones(turbine.array_slots(0) * turbine.LANES)
    code = instructions(getattr(turbine_emt, name), None, x, 0, TABLE_I, 5e-5, 0, turbine.SUM_V, kept)
    if "ymm" not in code and "zmm" not in code:
        pytest.skip("this processor has no wide vectors")
    assert "vsqrtpd" in code
    assert "vsqrtsd" not in code
    assert code.count("vfmadd") + code.count("vmulpd") > 100
