"""A vendor's controller in time: through grid steps, faults and damping control, as `seqsweep verify` drives it.

The library is the reference turbine's own controls, so `dpmsg-v1` in the same scenario is the truth from outside.
Figures: ``python -m pytest -s tests/sweep/test_grey_verify.py`` (and ``-m evidence``).
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.events import (
    Fault,
    GridStep,
    PowerStep,
    Scenario,
    WindStep,
    fault_conductance,
    resonance_between,
    simulate,
)
from seqsweep.plant.greybox.circuit import faulted
from seqsweep.plant.greybox.turbine import GreyTurbine
from seqsweep.plant.protocol import (
    Compensation,
    Conditions,
    Job,
    MeasuredPlant,
    NotSettled,
    OperatingPoint,
    Source,
)
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, LINE_X_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.verify.reading import report
from seqsweep.sweep.verify.runs import compare
from seqsweep.sweep.verify.tuned import Tuned, VerifyError
from seqsweep.tuning.siso import SeriesRL

from ..plant.test_grey import LINE, POINT, plant
from ..plant.test_grey_fmu import plant as fmu_plant
from ..support.commands import command, ended
from ..support.controllers import INPUTS, OUTPUTS, build, needs_compiler

pytestmark = needs_compiler

REFERENCE = ReferenceTurbine(dt_s=20e-6)
ON_LINE = Conditions(LINE_R_OHM, LINE_L_H)
KINDS = ["a-b-c", "a-g", "b-c", "b-c-g"]
EVIDENCE = pytest.mark.evidence


@cache
def library(*switches, **parameters):
    return plant(*switches, **parameters)


def scenario(power_w, *events, scale=1.2):
    return Scenario(power_w, LINE_R_OHM, LINE_L_H, 690.0, events, scale)


def settings(scale, k=0.5):
    return DampingSettings(k, scale * LINE_R_OHM, scale * LINE_L_H, 77.0)


def behind(scale, power_w=0.60e6, device=None):
    """The equilibrium on ``scale`` times the line of Table I, its source at 690 V."""
    source = Source("thevenin", scale * LINE_R_OHM, scale * LINE_L_H, voltage_v=690.0)
    return (device or library()).equilibrium(OperatingPoint(power_w, None), source)


# ---------------------------------------------------------------------- the circuit with a fault


@pytest.mark.parametrize("fault_s", [*(fault_conductance(kind, 0.01) for kind in KINDS), (3.0, -1.5, 2.0)])
def test_a_step_with_a_fault_is_the_one_of_an_independent_integrator(fault_s):
    """LSODA on two real axes, the conductance a matrix; a step of 50 us is five of the shunt's time constants."""
    x_0, u, e_0 = np.array([700.0 + 90j, 550.0 - 3j, 650.0 - 70j]), 400.0 + 300j, 560.0 + 20j
    r_f, c_f, l_c, step_s = TABLE_I.r_f_ohm, TABLE_I.c_f_f, TABLE_I.l_c_h, 50e-6
    aa, ab, bb = fault_s
    inverse = np.linalg.inv(np.eye(2) + r_f * np.array([[aa, ab], [ab, bb]]))

    def pcc(x):
        v = inverse @ np.array([(z := x[1] + r_f * (x[0] - x[2])).real, z.imag])
        return v[0] + 1j * v[1]

    def slopes(t, packed):
        x = packed[:4] + 1j * packed[4:]
        v, e = pcc(x), e_0 * np.exp(2j * pi * 50.0 * t)
        d = np.array([(u - v) / l_c, (v - x[1]) / r_f / c_f, (v - e - LINE_R_OHM * x[2]) / LINE_L_H, x[0]])
        return np.concatenate([d.real, d.imag])

    start = np.append(x_0, 0.0)
    solved = solve_ivp(slopes, (0.0, step_s), np.concatenate([start.real, start.imag]), "LSODA", rtol=1e-12, atol=1e-12)
    network, forcing, skew = faulted(TABLE_I, LINE, 50.0, step_s, fault_s)

    def both(of):
        """What the mean network gives, and the turned conjugate of what the skew gives."""
        more = 0.0 if skew is None else skew.turn * np.conj(of(skew.network, skew.forcing))
        return of(network, forcing) + more

    found = both(lambda net, force: net.phi @ x_0 + net.beta * u + force[0] * e_0)
    assert np.allclose(found, solved.y[:4, -1] + 1j * solved.y[4:, -1], rtol=1e-9, atol=1e-9)
    v = pcc(x_0)
    assert both(lambda net, force: net.v_states @ x_0) == pytest.approx(v, rel=1e-12)
    assert both(lambda net, force: net.i_states @ x_0) == pytest.approx(x_0[0] - (v - x_0[1]) / r_f, rel=1e-12)


# ---------------------------------------------------------------------- the promise of `MeasuredPlant`


def test_it_is_a_plant_with_a_measurement_port():
    assert isinstance(library(), MeasuredPlant)
    assert library().compensation == Compensation()
    assert plant(damping_gain=0.5).compensation == Compensation(0.5 * LINE_R_OHM, 0.5 * 2.0 * pi * 77.0 * LINE_L_H)


def test_a_trace_under_unchanged_conditions_is_the_run_to_the_byte():
    device = plant(damping_gain=0.3)
    state = device.settle(POINT, LINE)
    moved, _ = device.trace(state, replace(ON_LINE, r_ohm=2.0 * LINE_R_OHM), 777)
    state, _ = device.trace(moved, ON_LINE, 777)  # not at rest, so that the comparison can tell
    (end, record), (again, trace) = device.run([Job(state, None)], 1500)[0], device.trace(state, ON_LINE, 1500)
    assert record.v.tobytes() == trace.record.v.tobytes()
    assert record.i.tobytes() == trace.record.i.tobytes()
    assert (end.x.tobytes(), end.energy, end.memory) == (again.x.tobytes(), again.energy, again.memory)
    assert np.ptp(np.abs(record.i)) > 1.0


@pytest.mark.parametrize("fault_s", [(0.0, 0.0, 0.0), fault_conductance("b-c-g", 0.5)], ids=["sound", "faulted"])
def test_two_halves_are_the_whole(fault_s):
    """But for rounding: the source's phasor turns step by step within a call."""
    state, weak = behind(1.0), Conditions(1.3 * LINE_R_OHM, 1.3 * LINE_L_H, fault_s, power_scale=1.02)
    end, whole = library().trace(state, weak, 3001)
    middle, first = library().trace(state, weak, 1234)
    last, second = library().trace(middle, weak, 3001 - 1234)
    for name, size in (("v_dc_v", 1200.0), ("sync_rad", 1.0)):
        halves = np.concatenate([getattr(first, name), getattr(second, name)])
        assert np.max(np.abs(halves - getattr(whole, name))) <= 1e-8 * size
    halves = np.concatenate([first.record.i, second.record.i])
    assert np.max(np.abs(halves - whole.record.i)) <= 1e-8 * np.max(np.abs(halves))
    assert np.max(np.abs(last.x - end.x)) <= 1e-8 * np.max(np.abs(end.x))
    assert last.step == end.step


def test_nothing_is_mutated_and_what_physics_keeps_is_continuous():
    """Currents through inductances, v_C and the energy at the end of one piece are those at the start of the next."""
    device, state = library(), behind(1.0)
    x, memory = state.x.copy(), state.memory
    conditions = [Conditions(1.4 * LINE_R_OHM, 1.4 * LINE_L_H, fault_conductance("a-g", 0.1)), ON_LINE]
    middle, _ = device.trace(state, conditions[0], 500)
    _, back = device.trace(middle, conditions[1], 1)
    assert state.x.tobytes() == x.tobytes()
    assert state.memory == memory
    assert -back.record.i[0] == pytest.approx(middle.x[2], rel=1e-12)  # the line's current, all there is now
    assert back.v_dc_v[0] == pytest.approx((2.0 * middle.energy / TABLE_I.c_dc_f) ** 0.5, rel=1e-12)


def test_from_an_empty_dc_link_nothing_goes_on():
    """A step that empties it leaves NaN as its energy; the controller is not asked any more, and all is NaN."""
    state = replace(behind(1.0), energy=np.nan)
    end, trace = library().trace(state, ON_LINE, 50)
    assert end.memory == state.memory
    for x in (trace.v_dc_v, trace.sync_rad, trace.record.v, trace.record.i):
        assert np.all(np.isnan(x))


def test_rotor_speed_is_not_known_and_synchronism_is_the_angle_of_the_terminal_voltage():
    state = behind(1.0)
    _, trace = library().trace(state, ON_LINE, 100)
    assert np.all(np.isnan(trace.rotor_rad_s))
    first = trace.record.v[0] / (state.v_source * np.exp(2j * pi * 50.0 * state.time_s))
    assert trace.sync_rad == pytest.approx(np.angle(first), abs=1e-6)


# ---------------------------------------------------------------------- where it begins


@pytest.mark.parametrize("switch", [pytest.param("SAMPLE_TIME_S=20e-6", marks=EVIDENCE), "SAMPLE_TIME_S=100e-6"])
def test_behind_a_stable_grid_the_equilibrium_is_the_settled_state(switch):
    """Two ways to it: waiting behind the grid, and an ideal source that is then exchanged for the grid."""
    device = library(switch)
    fixed = Source("thevenin", 1.2 * LINE_R_OHM, 1.2 * LINE_L_H, voltage_v=690.0)
    point = OperatingPoint(0.60e6, None)
    ways = device.settle(point, fixed), device.equilibrium(point, fixed)
    sizes = [np.abs(state.x[:3]) for state in ways]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-7)
    records = [device.run([Job(state, None)], 1)[0][1] for state in ways]
    angles = [np.angle(r.v[0] / np.exp(2j * pi * 50.0 * r.t0_s)) for r in records]
    assert angles[1] == pytest.approx(angles[0], abs=1e-7)


@pytest.mark.parametrize("asked", ["source", "terminal"])
def test_behind_an_unstable_grid_the_equilibrium_is_what_was_asked_and_hardly_moves(asked):
    """1.4 Z at 0.65 MW, +9.6 1/s: what the hold between samples leaves grows from parts in 1e5."""
    weak = Source("thevenin", 1.4 * LINE_R_OHM, 1.4 * LINE_L_H, 690.0 if asked == "source" else None, 0.3)
    state = library().equilibrium(OperatingPoint(0.65e6, None if asked == "source" else 690.0), weak)
    assert np.angle(state.v_source) == pytest.approx(0.3, abs=1e-8)
    _, trace = library().trace(state, Conditions(weak.r_ohm, weak.l_h), 5000)
    size_v = np.abs(trace.record.v if asked == "terminal" else state.v_source) * 1.5**0.5
    assert size_v == pytest.approx(690.0, rel=1e-8 if asked == "source" else 1e-4)
    moved = np.ptp(np.abs(trace.record.i)) / np.max(np.abs(trace.record.i))
    print(f"\n  the current moves by {moved:.1e} of its peak in 0.1 s", end="")
    assert moved < 2e-4


def test_at_rest_nothing_happens():
    trajectory = simulate(library(), scenario(0.60e6, scale=1.0), settings(1.0), 0.1)
    assert np.ptp(np.abs(trajectory.v)) < 1e-6 * np.abs(trajectory.v[0])
    assert np.all(trajectory.ratio < 1e-6)


def test_a_controller_that_rests_on_no_ideal_source_is_settled_behind_the_grid(monkeypatch):
    """One that holds the voltage itself, say."""
    device = library()

    def restless(point, source):
        raise NotSettled("no rest")

    monkeypatch.setattr(device._core, "_put_behind", restless)
    state = device._core.equilibrium(POINT, LINE)
    assert state.source == LINE
    assert np.abs(state.x[:3]) == pytest.approx(np.abs(device.settle(POINT, LINE).x[:3]), rel=1e-9)


def test_where_it_comes_to_rest_neither_way_the_message_says_the_way_out():
    turned = {**INPUTS, "i_abc": {"signal": "i_l_abc", "sign": -1}}
    device = GreyTurbine(f"cigre:{build()}", turned, OUTPUTS, patience_s=1.0)
    with pytest.raises(NotSettled, match=r"on an ideal source: .*; begin on a stiffer grid \(scale\), or with less"):
        behind(1.2, device=device)
    with pytest.raises(NotSettled, match=r"no equilibrium: .* lower the power or the impedance; begin on a stiffer"):
        behind(3.0)


# ---------------------------------------------------------------------- against the turbine


def compared(trajectories, from_s, to_s):
    """Largest difference of the currents over the peak, between two times."""
    ours, theirs = trajectories
    inside = (ours.time_s >= from_s) & (ours.time_s < to_s)
    phase = np.angle(np.vdot(theirs.i[:50], ours.i[:50]))  # time zero of the state is another one
    return np.max(np.abs(ours.i * np.exp(-1j * phase) - theirs.i)[inside]) / np.max(np.abs(theirs.i[inside]))


@pytest.mark.parametrize(
    ("power_w", "damped"),
    [
        pytest.param(0.60e6, True, id="damped-0.60"),
        pytest.param(0.65e6, False, id="alone-0.65", marks=EVIDENCE),
        pytest.param(0.60e6, False, id="alone-0.60", marks=EVIDENCE),
        pytest.param(0.65e6, True, id="damped-0.65", marks=EVIDENCE),
    ],
)
def test_a_grid_step_is_the_one_of_the_turbine(power_w, damped):
    """1.2 Z to 1.4 Z at 0.1 s, compared where the step has left the window and r is below 50 %.

    Single estimates slip, so that medians tell more than the worst. Synchronism is seen elsewhere here: 20 ms.
    """
    step, control = scenario(power_w, GridStep(0.1, 1.4)), settings(1.4) if damped else None
    ours, theirs = both = [simulate(device, step, control, 0.9) for device in (library(), REFERENCE)]
    large = np.append(theirs.decision_s[theirs.ratio > 0.5], 0.9)[0]
    seen = (theirs.decision_s > 0.26) & (theirs.decision_s < large) & (theirs.ratio > 2e-3)
    r = ours.ratio[: len(seen)][seen] / theirs.ratio[seen] - 1.0
    hz, growth = (
        np.abs(getattr(ours, name)[: len(seen)][seen] - getattr(theirs, name)[seen])
        for name in ("resonance_hz", "growth_per_s")
    )
    i = compared(both, 0.0, large)
    rates = [report(each, step.events, 0.03).rate_per_s for each in both]
    print(
        f"\n  {power_w / 1e6:g} MW, {'damped' if damped else 'alone'}: median and worst difference "
        f"{np.median(hz):.4f} {hz.max():.3f} Hz, {np.median(growth):.3f} {growth.max():.2f} 1/s, "
        f"r {np.median(np.abs(r)):.2%} {np.abs(r).max():.1%}, i {i:.1e} of the peak; "
        f"rates {rates}; lost at {ours.lost_s} and {theirs.lost_s} s",
        end="",
    )
    assert (ours.lost_s is None) == (theirs.lost_s is None)
    if theirs.lost_s is not None:
        assert ours.lost_s == pytest.approx(theirs.lost_s, abs=0.02)
    assert ours.started_s == pytest.approx(theirs.started_s, abs=0.0021)
    assert np.median(hz) < 0.01
    assert hz.max() < 0.1
    assert np.median(growth) < 0.05
    assert np.median(np.abs(r)) < 0.02
    assert i < 0.01
    assert rates[0] == pytest.approx(rates[1], abs=0.05)


def held_through_a_fault(scale, kind, r_ohm):
    fault = scenario(0.60e6, Fault(0.1, 0.04, kind, r_ohm), scale=scale)
    ours, theirs = (simulate(device, fault, settings(scale), 0.7) for device in (library(), REFERENCE))
    print(f"\n  {scale} Z, {kind}, {r_ohm} ohm: lost at {ours.lost_s}, the turbine at {theirs.lost_s}", end="")
    assert (ours.lost_s is None) == (theirs.lost_s is None)
    assert ours.started_s == theirs.started_s == ()
    return [ours, theirs]


@pytest.mark.parametrize("kind", ["b-c-g", *(pytest.param(k, marks=EVIDENCE) for k in ("a-b-c", "a-g", "b-c"))])
def test_faults_of_40_ms_are_ridden_through_as_the_turbine_does(kind):
    """Waveforms within and after the fault; the turbine's own limit is the converter's voltage, which both have."""
    both = held_through_a_fault(0.648, kind, 0.01)
    during, after = compared(both, 0.1, 0.14), compared(both, 0.14, 0.4)
    print(f"; the current is off by {during:.1e} in it, {after:.1e} behind it", end="")
    assert max(during, after) < 0.01


@pytest.mark.evidence
def test_every_fault_of_the_turbine_s_page_ends_as_it_does_there():
    for scale in (0.648, 1.0, 1.2):
        for kind in KINDS:
            for r_ohm in (0.001, 0.01, 0.05):
                held_through_a_fault(scale, kind, r_ohm)


@pytest.mark.evidence
def test_a_power_step_leaves_the_rotor_out():
    """0.65 to 0.70 MW: at once the same; the turbine's rotor then gives way, its power by three times as much."""
    step = scenario(0.65e6, PowerStep(0.1, 0.70e6), scale=1.0)
    both = [simulate(device, step, None, 0.8) for device in (library(), REFERENCE)]

    def machine_w(trajectory, from_s, to_s):
        """Power into the DC link, from the PCC and the energy."""
        first, last = np.searchsorted(trajectory.time_s, (from_s - 1e-9, to_s - 1e-9))
        energy = 0.5 * TABLE_I.c_dc_f * trajectory.v_dc_v[[first, last]] ** 2
        return trajectory.p_w[first:last].mean() + np.diff(energy)[0] / (to_s - from_s) + 235.0  # of the shunt

    early, late = ([machine_w(each, *span) for each in both] for span in ((0.12, 0.16), (0.74, 0.78)))
    rotor = both[1].rotor_rad_s
    print(
        f"\n  MW, ours and the turbine's: {early} early, {late} late; rotor {rotor[-1] / rotor[0] - 1.0:+.2%}", end=""
    )
    assert early[0] == pytest.approx(early[1], rel=5e-3)  # the machine's current control overshoots
    assert late[0] == pytest.approx(0.70e6, rel=1e-3)
    assert late[1] == pytest.approx(late[0] * (rotor[-1] / rotor[0]) ** 3, rel=2e-3)


# ---------------------------------------------------------------------- every way to keep states


def driven(device):
    """Bytes of a story with everything in it; 50 ms."""
    story = scenario(0.60e6, GridStep(0.01, 1.4), Fault(0.0203, 0.006, "b-c", 0.5), PowerStep(0.04, 0.62e6))
    trajectory = simulate(device, story, settings(1.4), 0.05, on_from_s=0.03)
    assert trajectory.active[-1]
    return [x.tobytes() for x in (trajectory.v, trajectory.i, trajectory.v_dc_v, trajectory.sync_rad)]


@cache
def driven_library():
    return driven(library())


@pytest.mark.parametrize(
    ("switches", "snapshot"),
    [
        (("HIDDEN_STATES",), "auto"),
        pytest.param(("HIDDEN_STATES",), "copy", marks=EVIDENCE),
        pytest.param((), "fork", marks=EVIDENCE),
    ],
)
def test_every_way_to_keep_states_gives_the_same_bytes(switches, snapshot):
    assert driven(plant(*switches, snapshot=snapshot)) == driven_library()


@pytest.mark.parametrize(
    ("switches", "snapshot"),
    [
        pytest.param(("STATE",), "auto", marks=EVIDENCE),
        (("FMI3", "STATE"), "auto"),
        pytest.param(("STATE",), "copy", marks=EVIDENCE),
        ((), "auto"),
    ],
)
def test_an_fmu_gives_the_bytes_of_the_library(switches, snapshot):
    assert driven(fmu_plant(*switches, snapshot=snapshot)) == driven_library()


# ---------------------------------------------------------------------- refusals


def test_wind_is_refused_before_anything_is_run():
    with pytest.raises(ValueError, match=r"dpmsg-grey-v1 has no wind: .* give a power step"):
        simulate(library(), scenario(0.60e6, GridStep(0.1, 1.4), WindStep(0.3, 9.0)), None, 0.5)


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        (replace(ON_LINE, power_scale=3.0), r"active power of 1.8 MW is outside the range .*: 0.05 to 1.35 MW"),
        (replace(ON_LINE, l_h=0.0), "a grid needs r_ohm >= 0 and l_h > 0; got 0.012 ohm, 0 H"),
        (replace(ON_LINE, wind_m_s=9.0), "has no wind"),
    ],
)
def test_what_it_cannot_do_is_refused_by_name(conditions, words):
    with pytest.raises(ValueError, match=words):
        library().trace(behind(1.0), conditions, 10)


def test_a_state_on_an_ideal_source_and_damping_of_its_own_are_refused():
    with pytest.raises(ValueError, match="needs a state behind a thevenin source"):
        library().trace(library().settle(POINT, Source()), ON_LINE, 10)
    with pytest.raises(ValueError, match="dpmsg-grey-v1 was made with damping_gain > 0"):
        simulate(plant(damping_gain=0.5), scenario(0.60e6), None, 0.1)


def test_a_controller_that_gives_up_on_the_way_is_told_in_its_words():
    """Its protection, say; the message names the run."""
    last_s = behind(1.0).time_s + 0.05
    device = plant("FAULT_ERROR", settings={"FaultTime": last_s})
    grid = SeriesRL(LINE_R_OHM, LINE_X_OHM, 50.0)
    tuned = Tuned("p", device, grid, 0.60e6, None, 690.0, 0.5, 77.0)
    with pytest.raises(VerifyError, match=r"without damping control does not come .* refuses at .* DC overvoltage"):
        compare(tuned, scenario(0.60e6, scale=1.0), settings(1.0), 0.1)


# ---------------------------------------------------------------------- from the command line


CAMPAIGN = """
[[operating_point]]
id = "weak"
active_power_mw = 0.60
grid = { r_ohm = 0.012, x_ohm = 0.25, scale = 1.4 }

[sweep]
f_min_hz = 2.0
f_max_hz = 1000.0
points = 30
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Library, table and tuning of the example's campaign on 1.4 Z, the gain set to the paper's 0.5."""
    folder = tmp_path_factory.mktemp("grey-verify")
    example = (Path(__file__).parents[2] / "examples" / "cigre.toml").read_text("utf-8")
    head = example.partition("[[operating_point]]")[0].replace("turbine_controller.so", str(build()))
    (folder / "campaign.toml").write_text(head + CAMPAIGN, "utf-8")
    for words in (
        ("run", folder / "campaign.toml", "-o", folder / "y.parquet"),
        ("tune", folder / "y.parquet", "--grid", "0.012+0.25j", "--scale", 1.4, "-o", folder / "tuning.json"),
    ):
        done = command(*words)
        assert done.returncode == 0, done.stderr
    content = json.loads((folder / "tuning.json").read_text())
    content["operating_points"][0]["k"] = 0.5
    (folder / "tuning.json").write_text(json.dumps(content))
    return folder


def verified(folder, *arguments):
    status, said = ended("verify", folder / "tuning.json", *arguments)
    return status, " ".join(said.split())


def test_the_command_proves_the_k_of_a_vendor_s_controller(folder):
    """The figures of `dpmsg-v1`: +3.80 and -8.42 1/s, lost at 0.69 s."""
    status, said = verified(folder, "-o", folder / "verify.json", "--plot", folder / "verify.svg")
    assert status == 0, said
    runs = json.loads((folder / "verify.json").read_text())["runs"]
    assert runs["without"]["rate_per_s"] == pytest.approx(3.80, abs=0.05)
    assert runs["without"]["lost_s"] == pytest.approx(0.687, abs=0.02)
    assert runs["with"]["rate_per_s"] == pytest.approx(-8.42, abs=0.05)
    assert runs["with"]["lost_s"] is None
    assert runs["with"]["started_s"] == [pytest.approx(0.278, abs=0.003)]
    assert (folder / "verify.svg").exists()


def test_growth_after_a_step_to_an_unstable_grid_is_the_pole_that_tune_predicts(folder):
    """A small step, 1.38 Z to 1.4 Z, so that everything is linear; the pole is read from the swept table."""
    (point,) = json.loads((folder / "tuning.json").read_text())["operating_points"]
    pole = next(p for p in point["poles"] if p["kind"] == "resonance")
    trajectory = simulate(library(), scenario(0.60e6, GridStep(0.02, 1.4), scale=1.38), None, 0.5)
    early, late = resonance_between(trajectory, 0.07, 0.22), resonance_between(trajectory, 0.27, 0.42)
    growth = np.log(late.amplitude / early.amplitude) / 0.2
    print(f"\n  growth {growth:+.3f} 1/s in time, {pole['re_rad_s']:+.3f} 1/s by the table", end="")
    assert growth == pytest.approx(pole["re_rad_s"], rel=0.05)
    assert late.f_hz - 50.0 == pytest.approx(abs(pole["im_rad_s"]) / (2.0 * pi), abs=0.1)


def test_a_wind_step_in_the_file_is_wrong_input(folder):
    (folder / "windy.toml").write_text('[[event]]\nkind = "wind_step"\ntime_s = 0.1\nwind_m_s = 9.0\n', "utf-8")
    done = command("verify", folder / "tuning.json", "--scenario", folder / "windy.toml")
    assert done.returncode == 2
    assert "dpmsg-grey-v1 has no wind" in done.stderr
    assert "power_step" in done.stderr
    assert "Traceback" not in done.stderr


# ---------------------------------------------------------------------- cost


@pytest.mark.evidence
def test_a_trace_costs_what_a_run_costs():
    """CPU time a step in long pieces, and in the 2 ms of a verification with its analysis; best of three."""
    device, state = library(), behind(1.0)

    def best_us(what, n_steps):
        taken = []
        for _ in range(3):
            begun = time.process_time()
            what()
            taken.append((time.process_time() - begun) / n_steps * 1e6)
        return min(taken)

    run = best_us(lambda: device.run([Job(state, None)], 500_000), 500_000)
    trace = best_us(lambda: device.trace(state, ON_LINE, 500_000), 500_000)
    whole = best_us(lambda: simulate(device, scenario(0.60e6, scale=1.0), settings(1.0), 2.0), 100_000)
    print(f"\n  us a step: {run:.2f} in a run, {trace:.2f} in a trace, {whole:.2f} in a verification", end="")
    assert trace < 0.5


@pytest.mark.evidence
@pytest.mark.parametrize("kept", ["arrays", "snapshots", "fork", "copy"])
def test_five_seconds_take_seconds_however_states_are_kept(kept):
    device = {
        "arrays": lambda: plant(),
        "snapshots": lambda: fmu_plant("STATE"),
        "fork": lambda: plant("HIDDEN_STATES"),
        "copy": lambda: plant("HIDDEN_STATES", snapshot="copy"),
    }[kept]()
    behind(1.0, device=device)
    begun, before = time.monotonic(), os.times()
    simulate(device, scenario(0.60e6, GridStep(0.1, 1.2), scale=1.0), settings(1.2), 5.0)
    used_s = sum(
        after - then for after, then in zip(os.times()[:4], before[:4], strict=True)
    )  # children that ended, too
    print(f"\n  5 s by {kept}: {time.monotonic() - begun:.1f} s of wall time, {used_s:.1f} s of CPU", end="")
    assert used_s < 30.0  # not minutes, which replays of everything before each event would take
