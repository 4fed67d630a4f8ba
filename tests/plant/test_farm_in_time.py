"""Turbines on one network in time: against the linearisation of all, one turbine alone, and a damper's equation."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.plant.circuits.branches import GROUND, Branch
from seqsweep.plant.circuits.circuit import PCC, SOURCE, Circuit, series_circuit
from seqsweep.plant.circuits.dynamics import Fault
from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.estimator import block_means, matrix_pencil
from seqsweep.plant.damping.events import Fault as PccFault
from seqsweep.plant.damping.events import GridStep, PowerStep, Scenario, fault_conductance, simulate
from seqsweep.plant.damping.farm_events import (
    BusFault,
    DevicePower,
    FarmControl,
    FarmScenario,
    NetworkStep,
    simulate_farm,
)
from seqsweep.plant.damping.grid_side import GridSideDamper, aimed_at
from seqsweep.plant.errors import SeqsweepError
from seqsweep.plant.protocol import Compensation, FarmConditions, Member, OperatingPoint, Source
from seqsweep.plant.space_vectors import PHASE_PEAK
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
from seqsweep.plant.turbine.reference import ReferenceTurbine
from tests.support import farm_twin, oracle
from tests.support.farm_oracle import W1, J, Star, closed_loop, operating_point

PLANT = ReferenceTurbine()


def star_of(n: int, scale: float) -> Star:
    return Star(0.0017 + 0.0175j, 400e-6, (0.004 + 0.085j) * scale * 3 / n)


def circuit_of(star: Star, n: int) -> Circuit:
    transformers = [Branch(f"z{k}", {f"t{k}": 1.0, "bus": -1.0}, star.z_t.real, star.z_t.imag / W1) for k in range(n)]
    capacitor = Branch("c", {"bus": 1.0, GROUND: -1.0}, c_f=star.c_f)
    source = Branch("source", {"bus": 1.0, SOURCE: -1.0}, star.z_s.real, star.z_s.imag / W1)
    return Circuit((*transformers, capacitor, source))


def powers_of(n: int) -> list[float]:
    return [float(p) for p in np.linspace(0.4e6, 0.8e6, n)]


def farm_of(n: int, dampers=()):
    members = [Member(f"wt{k}", f"t{k}", p) for k, p in enumerate(powers_of(n))]
    return PLANT.together(members, dampers)


def conditions_of(star: Star, n: int, **others) -> FarmConditions:
    watch = (("v", "bus"), ("i", "source"))
    ones = (True,) * n, (1.0,) * n, (Compensation(),) * n
    return FarmConditions(circuit_of(star, n), 690.0, *ones, watch=watch, **others)


def kicked(farm, state, amperes: float = 60.0):
    """The state with one turbine's current moved a little."""
    values = state.turbines[0].values.copy()
    values[0] += amperes
    return replace(state, turbines=(replace(state.turbines[0], values=values), *state.turbines[1:]))


def mode_of(current: np.ndarray, from_s: float, to_s: float) -> complex:
    """Growth and frequency in dq (rad/s) of the line's current, from two windows of 150 ms."""

    def seen(at_s: float):
        window = current[round((at_s - 0.15) / PLANT.dt_s) : round(at_s / PLANT.dt_s)]
        return matrix_pencil(block_means(window, 40), 2e-3, 50.0)

    early, late = seen(from_s), seen(to_s)
    growth = np.log(late.amplitude / early.amplitude) / (to_s - from_s)
    return complex(growth, 2.0 * np.pi * abs(late.f_hz - 50.0))


# ---------------------------------------------------------------- modes


@pytest.mark.parametrize(("n", "scale"), [(2, 1.2), (8, 1.35), (13, 1.35)])
def test_the_farm_s_mode_grows_as_the_linearisation_of_all_says(n, scale):
    """Eight turbines fill a group of lanes, thirteen begin another."""
    star = star_of(n, scale)
    poles, v = closed_loop(star, powers_of(n))
    upper = poles[(poles.imag > 60.0) & (poles.imag < 300.0)]
    critical = upper[np.argmax(upper.real)]
    farm, conditions = farm_of(n), conditions_of(star, n)
    _, trace = farm.trace(kicked(farm, farm.at_rest(conditions, v)), conditions, 10_000)
    found = mode_of(trace.watched[:, 1], 0.3, 0.5)
    assert found.real == pytest.approx(critical.real, rel=0.02)
    assert found.imag == pytest.approx(critical.imag, rel=1e-4)


def test_an_equilibrium_of_turbines_and_network_stands_still():
    star = star_of(3, 1.0)
    _, v = closed_loop(star, powers_of(3))
    farm, conditions = farm_of(3), conditions_of(star, 3)
    state = farm.at_rest(conditions, v)
    end, trace = farm.trace(state, conditions, 400)
    for before, after in zip(state.turbines, end.turbines, strict=True):
        assert np.max(np.abs(after.values[:13] - before.values[:13])) < 1e-8
    assert np.ptp(np.abs(trace.watched[:, 0])) < 1e-8


def test_a_run_in_pieces_is_the_run():
    star = star_of(3, 1.0)
    _, v = closed_loop(star, powers_of(3))
    farm, fault = farm_of(3), Fault("bus", fault_conductance("a-g", 0.5))
    calm, faulted = conditions_of(star, 3), conditions_of(star, 3, fault=fault)
    state = farm.at_rest(calm, v)
    whole, trace = farm.trace(state, faulted, 300)
    half, _ = farm.trace(state, faulted, 130)
    rest, later = farm.trace(half, faulted, 170)
    for one, other in zip(whole.turbines, rest.turbines, strict=True):
        assert np.max(np.abs(one.values - other.values)[:13] / np.maximum(np.abs(one.values[:13]), 1.0)) < 1e-9
    one, other = trace.devices[1].record.v[130:], later.devices[1].record.v
    assert np.max(np.abs(one - other)) < 1e-7


# ---------------------------------------------------------------- the network split into what all exchange


def string_of(n: int) -> Circuit:
    """Turbines on cables that charge, one behind the other; every transformer is another."""
    z_t = [0.0017 + 0.0175j * (1.0 + 0.07 * k) for k in range(n)]
    transformers = [Branch(f"z{k}", {f"t{k}": 1.0, f"m{k}": -1.0}, z.real, z.imag / W1) for k, z in enumerate(z_t)]
    nodes = ["bus", *(f"m{k}" for k in range(n))]
    cables = [Branch(f"cable{k}", {nodes[k + 1]: 1.0, nodes[k]: -1.0}, 4e-5, 1.2e-7) for k in range(n)]
    charging = [Branch(f"c{node}", {node: 1.0, GROUND: -1.0}, c_f=2e-4) for node in nodes]
    return Circuit((*transformers, *cables, *charging, Branch("source", {"bus": 1.0, SOURCE: -1.0}, 1e-3, 2e-4)))


@pytest.mark.parametrize("network", ["star", "star without a capacitor", "string"])
def test_the_split_network_is_the_dense_one_to_rounding(network):
    """Nine turbines, two groups of lanes, each of another size, against numpy with dense matrices."""
    n, star = 9, star_of(9, 1.0)
    v, _ = operating_point(star, powers_of(n))
    farm, conditions = farm_of(n), conditions_of(star, n)
    state = kicked(farm, farm.at_rest(conditions, v), 5.0)
    circuit = string_of(n) if network == "string" else circuit_of(star, n)
    if network == "star without a capacitor":
        circuit = Circuit(tuple(b for b in circuit.branches if b.name != "c"))
    sizes = tuple(1.0 + 0.02 * k for k in range(n))
    conditions = replace(conditions, circuit=circuit, sizes=sizes, compensation=(Compensation(),) * n)
    truth, seen = farm_twin.advanced(farm, state, conditions, 40)
    end, trace = farm.trace(state, conditions, 40)
    to_dq = np.exp(-2j * np.pi * ((50.0 * PLANT.dt_s * np.arange(40)) % 1.0)) / PHASE_PEAK
    for k in range(n):
        assert np.max(np.abs(end.turbines[k].values[:13] - truth[k]) / np.maximum(np.abs(truth[k]), 1.0)) < 1e-10
        assert np.max(np.abs(trace.devices[k].record.v * to_dq - seen[:, k])) < 1e-8


def test_a_star_of_equal_transformers_exchanges_three_sums_whatever_its_size():
    for n in (3, 30):
        farm, conditions = farm_of(n), conditions_of(star_of(n, 1.0), n)
        assert [len(each.into) for each in farm._stepped(conditions).split.coupled[:6]] == [0, 3, 0, 1, 1, 2]


# ---------------------------------------------------------------- one turbine is a turbine


LINE = series_circuit(1.2 * LINE_R_OHM, 1.2 * LINE_L_H)


def lone_scenario(*events) -> tuple[object, FarmScenario]:
    farm = PLANT.together([Member("wt", PCC, 0.6e6)])
    state = PLANT.equilibrium(OperatingPoint(0.6e6, None), Source("network", voltage_v=690.0, circuit=LINE))
    v = state.values[13:15] @ np.array([1.0, 1j]) + 0.02 * (complex(*state.values[0:2]) - complex(*state.values[15:17]))
    peak = 690.0 * np.sqrt(2.0 / 3.0)
    return farm, FarmScenario(LINE, 690.0, (True,), (complex(v),), (PCC, "line"), peak, events)


@pytest.mark.parametrize("kind", ["b-c", "a-b-c"])
def test_a_farm_of_one_is_the_turbine_alone_through_a_fault_and_a_power_step(kind):
    farm, scenario = lone_scenario(BusFault(0.05, 0.03, PCC, kind, 2.0), DevicePower(0.15, 0, 0.5e6))
    found = simulate_farm(farm, scenario, None, 0.3)
    alone = Scenario(0.6e6, 0.0, 1.0, 690.0, (PccFault(0.05, 0.03, kind, 2.0), PowerStep(0.15, 0.5e6)), circuit=LINE)
    truth = simulate(PLANT, alone, None, 0.3)
    (of,) = found.devices
    # A fault's current belongs to the network here, and to the line's end there: the turbine's own is compared.
    assert np.max(np.abs(of.v - truth.v)) < 1e-6 * np.max(np.abs(truth.v))
    assert np.max(np.abs(of.sync_rad - truth.sync_rad)) < 1e-7
    assert np.max(np.abs(of.i - truth.i)) < 1e-6 * np.max(np.abs(truth.i))


def test_its_control_starts_when_that_of_the_turbine_alone_does():
    weaker = NetworkStep(0.1, LINE.scaled(1.4 / 1.2), (True,), (690.0 + 0j,), "weaker")
    farm, scenario = lone_scenario(weaker)
    settings = DampingSettings(0.5, 1.4 * LINE_R_OHM, 1.4 * LINE_L_H, 77.0)
    found = simulate_farm(farm, scenario, FarmControl((settings,)), 0.5)
    alone = Scenario(0.6e6, 1.2 * LINE_R_OHM, 1.2 * LINE_L_H, 690.0, (GridStep(0.1, 1.4 / 1.2),))
    truth = simulate(PLANT, alone, settings, 0.5)
    assert found.devices[0].started_s == truth.started_s
    assert found.devices[0].ratio[-1] == pytest.approx(truth.ratio[-1], rel=1e-3)


# ---------------------------------------------------------------- switching


def third_put_in():
    """A farm of three of which the third comes at 0.1 s, and the terminal voltages of two and of three."""
    n, star = 3, star_of(3, 0.7)
    two, _ = operating_point(star, powers_of(3)[:2])
    three, _ = operating_point(star, powers_of(3))
    circuit = circuit_of(star, n)
    farm = farm_of(3)
    step = NetworkStep(0.1, circuit, (True,) * 3, tuple(complex(v) for v in three), "third in")
    start = (*(complex(v) for v in two), 690.0 + 0j)
    scenario = FarmScenario(circuit, 690.0, (True, True, False), start, ("bus", "source"), 563.4, (step,))
    return farm, scenario, step, two, three


def test_a_turbine_that_is_put_in_brings_the_farm_to_its_load_flow():
    """Less than a second later all stand where closed-form phasors say."""
    farm, scenario, _, _, three = third_put_in()
    found = simulate_farm(farm, scenario, None, 0.8)
    assert np.all(found.devices[2].i[:2000] == 0.0)
    assert found.lost_s is None
    for k, of in enumerate(found.devices):
        assert abs(of.v[-1]) * np.sqrt(1.5) == pytest.approx(abs(three[k]), rel=2e-4)


@pytest.mark.evidence
def test_a_turbine_that_is_taken_out_again_leaves_the_load_flow_of_before():
    farm, scenario, step, two, _ = third_put_in()
    out = replace(step, connected=(True, True, False), what="third out", time_s=0.3)
    left = simulate_farm(farm, replace(scenario, events=(step, out)), None, 0.8)
    assert abs(left.devices[0].v[-1]) * np.sqrt(1.5) == pytest.approx(abs(two[0]), rel=2e-4)


def test_overlapping_faults_are_refused():
    farm, scenario = lone_scenario(BusFault(0.05, 0.03, PCC, "b-c", 2.0), BusFault(0.06, 0.03, PCC, "a-g", 2.0))
    with pytest.raises(SeqsweepError, match="overlap"):
        simulate_farm(farm, scenario, None, 0.3)


def test_a_farm_goes_by_runge_kutta_alone():
    with pytest.raises(SeqsweepError, match="needs integrator 'rk4'"):
        ReferenceTurbine(integrator="emt").together([Member("wt", PCC, 0.6e6)])


# ---------------------------------------------------------------- a grid-side damper


def bus_matrix(s: complex, star: Star, v: np.ndarray, damper: GridSideDamper) -> np.ndarray:
    """Nodal matrix (2, 2) of the bus at s in dq: turbines behind their transformers, capacitor, source, damper."""
    one = np.eye(2)

    def line(z: complex) -> np.ndarray:
        return (z.real + s * z.imag / W1) * one + z.imag * J

    total = star.c_f * (s * one + W1 * J) + np.linalg.inv(line(star.z_s)) + damper.admittance(np.array([s]))[0]
    for power, at in zip(powers_of(len(v)), v, strict=True):
        m = oracle.linearise(power, abs(at))
        y = m.C @ np.linalg.solve(s * np.eye(len(m.x)) - m.A, m.B.astype(complex)) + m.D
        c, d = np.cos(np.angle(at)), np.sin(np.angle(at))
        turn = np.array([[c, -d], [d, c]])
        total = total + np.linalg.inv(line(star.z_t) + np.linalg.inv(turn @ y @ turn.T))
    return total


def root_near(s: complex, star: Star, v: np.ndarray, damper: GridSideDamper) -> complex:
    """Newton's method on the determinant of `bus_matrix`."""
    for _ in range(30):
        h = 1e-5 * abs(s)
        at, ahead, behind = (np.linalg.det(bus_matrix(x, star, v, damper)) for x in (s, s + h, s - h))
        step = at / ((ahead - behind) / (2.0 * h))
        s = s - complex(step)
        if abs(step) < 1e-9 * abs(s):
            break
    return s


def aimed(pole: complex, star: Star, v: np.ndarray, shift: float) -> GridSideDamper:
    """The damper at the bus that moves a mode to the left by about ``shift`` (1/s), from the bus's null vectors."""
    idle = GridSideDamper(pole.imag, 0j, 0j)
    u, _, vh = np.linalg.svd(bus_matrix(pole, star, v, idle))
    left, right = u[:, -1].conj(), vh[-1].conj()
    h = 1e-5 * abs(pole)
    ahead, behind = (bus_matrix(pole + x, star, v, idle) for x in (h, -h))
    d = left @ (ahead - behind) @ right / (2.0 * h)
    plus = (left[0] - 1j * left[1]) * (right[0] + 1j * right[1]) / (2.0 * d)
    minus = (left[0] + 1j * left[1]) * (right[0] - 1j * right[1]) / (2.0 * d)
    return aimed_at(pole, plus, minus, shift / float(np.hypot(abs(plus), abs(minus))))


def test_a_grid_side_damper_moves_the_mode_as_its_admittance_says():
    star = star_of(3, 1.3)
    poles, v = closed_loop(star, powers_of(3))
    upper = poles[(poles.imag > 60.0) & (poles.imag < 300.0)]
    critical = complex(upper[np.argmax(upper.real)])
    damper = aimed(critical, star, v, 2.0)
    truth = root_near(critical, star, v, damper)
    assert abs(truth - critical) > 1.0
    farm, conditions = farm_of(3, [("bus", damper)]), conditions_of(star, 3, dampers_on=(True,))
    _, trace = farm.trace(kicked(farm, farm.at_rest(conditions, v)), conditions, 14_000)
    found = mode_of(trace.watched[:, 1], 0.5, 0.7)  # its band-passes ring for 0.2 s
    assert found.real == pytest.approx(truth.real, rel=0.02, abs=0.05)
    assert found.imag == pytest.approx(truth.imag, rel=2e-4)


def test_a_damper_at_a_bus_of_inductors_alone_is_the_same():
    """Without the capacitor the bus voltage follows the derivative of the damper's current."""
    star = replace(star_of(3, 1.3), c_f=1e-12)
    v, _ = operating_point(star, powers_of(3))
    poles, _ = closed_loop(star_of(3, 1.3), powers_of(3))
    upper = poles[(poles.imag > 60.0) & (poles.imag < 300.0)]
    idle = GridSideDamper(170.0, 0j, 0j)
    critical = root_near(complex(upper[np.argmax(upper.real)]), star, v, idle)
    damper = aimed(critical, star, v, 1.5)
    truth = root_near(critical, star, v, damper)
    circuit = Circuit(tuple(b for b in circuit_of(star, 3).branches if b.name != "c"))
    conditions = replace(conditions_of(star, 3, dampers_on=(True,)), circuit=circuit)
    farm = farm_of(3, [("bus", damper)])
    _, trace = farm.trace(kicked(farm, farm.at_rest(conditions, v)), conditions, 14_000)
    found = mode_of(trace.watched[:, 1], 0.5, 0.7)  # its band-passes ring for 0.2 s
    assert found.real == pytest.approx(truth.real, rel=0.02, abs=0.05)
    assert found.imag == pytest.approx(truth.imag, rel=2e-4)


def test_a_damper_s_current_keeps_its_limit_and_starts_when_the_line_resonates():
    star, calm = star_of(3, 1.35), star_of(3, 1.0)
    _, v = closed_loop(calm, powers_of(3))
    later, _ = operating_point(star, powers_of(3))
    step = NetworkStep(0.1, circuit_of(star, 3), (True,) * 3, tuple(complex(x) for x in later), "weaker")
    begun = FarmScenario(
        circuit_of(calm, 3), 690.0, (True,) * 3, tuple(complex(x) for x in v), ("bus", "source"), 563.4, (step,)
    )
    damper = GridSideDamper(171.0, 3.0 + 0.0j, 0.0j, limit_a=200.0)
    farm = farm_of(3, [("bus", damper)])
    states = []
    trace = farm.trace

    def watched(state, conditions, n_steps):
        end, found = trace(state, conditions, n_steps)
        states.append((conditions.dampers_on, np.hypot(*end.dampers[0, 6:8])))
        return end, found

    farm.trace = watched
    found = simulate_farm(farm, begun, FarmControl((None,) * 3, dampers=1), 0.6)
    started = found.line.started_s
    assert len(started) == 1
    assert started[0] > 0.25
    assert all(size < 1e-9 for on, size in states if on == (False,) and size == states[0][1])
    assert max(size for _, size in states) < 200.0 * 1.0001
    assert max(size for _, size in states) > 20.0


# ---------------------------------------------------------------- cost


@pytest.mark.evidence
def test_cost_of_thirteen_turbines():
    """Prints the CPU time of 2.5 s with control; benchmarks/farm_in_time.py has that of a step."""
    n = int(os.environ.get("SEQSWEEP_TURBINES", "13"))
    star = star_of(n, 1.2)
    _, v = closed_loop(star, powers_of(n))
    farm = farm_of(n)
    scenario = FarmScenario(circuit_of(star, n), 690.0, (True,) * n, tuple(map(complex, v)), ("bus", "source"), 563.4)
    settings = DampingSettings(0.5, LINE_R_OHM, LINE_L_H, 77.0)
    begun = time.process_time()
    simulate_farm(farm, scenario, FarmControl((settings,) * n), 2.5)
    whole = time.process_time() - begun
    print(f"{n} turbines, 2.5 s with control: {whole:.1f} s of CPU")
    assert whole < 20.0
