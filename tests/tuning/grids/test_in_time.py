"""Elements in time: poles of plant and network against a tableau, transients against an independent integration."""

from __future__ import annotations

import os
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.events import (
    CircuitStep,
    Fault,
    Scenario,
    fault_conductance,
    resonance_between,
    simulate,
)
from seqsweep.plant.protocol import Injection, Job, NotSettled, OperatingPoint, Source, Tone
from seqsweep.plant.registry import make_plant
from seqsweep.plant.rl_branch import RLBranch
from seqsweep.plant.turbine.parameters import TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.grids.in_time import circuit_of, circuit_of_grid, names_of, ready_to_switch
from seqsweep.tuning.grids.scalar_fit import fit_impedance
from tests.support import inverter_oracle, oracle
from tests.support.networks import KINDS, W1, J, near_critical

P_W, U_V = 0.65e6, 690.0
PLANT = ReferenceTurbine()


def behind(document: dict, scale: float = 1.0) -> Source:
    return Source("network", circuit=circuit_of(document, 50.0).scaled(scale))


def nearest(poles: np.ndarray, pole: complex) -> float:
    return float(np.abs(poles - pole).min())


# ---------------------------------------------------------------- poles of the flow


@pytest.fixture(scope="module")
def linear() -> oracle.Linear:
    return oracle.linearise(P_W, U_V)


def critical_error(linear: oracle.Linear, rng: np.random.Generator, kind: str) -> float:
    """Distance (rad/s) of the flow's nearest pole from the tableau's critical one; nothing more unstable is found."""
    case = near_critical(rng, linear, kind)
    poles = PLANT.linearise(PLANT.equilibrium(OperatingPoint(P_W, U_V), behind(case.document, case.scale)))
    assert np.sum(poles.real > 0.0) == np.sum(case.poles.real > 0.0)
    return nearest(poles, case.critical)


@pytest.mark.parametrize("kind", KINDS)
def test_poles_of_turbine_and_elements_are_the_tableau_s(linear, kind):
    assert critical_error(linear, np.random.default_rng(KINDS.index(kind)), kind) < 1e-4


@pytest.mark.evidence
def test_poles_of_turbine_and_random_elements(linear):
    """SEQSWEEP_TRIALS grids of every kind, a new seed every time."""
    seed, n = int(np.random.SeedSequence().entropy % 10**6), int(os.environ.get("SEQSWEEP_TRIALS", "40"))
    rng = np.random.default_rng(seed)
    errors = [critical_error(linear, rng, kind) for _ in range(n) for kind in KINDS]
    print(f"seed {seed}: {len(errors)} grids, pole {np.median(errors):.1e} median, {max(errors):.1e} rad/s at most")
    assert max(errors) < 2e-4


LADDER = {
    "element": [
        {"kind": "filter", "name": "filter", "c_uf": 60.0, "tuned_hz": 350.0, "quality": 30.0},
        {"kind": "series", "r_ohm": 0.006, "x_ohm": 0.12},
        {"kind": "shunt_capacitor", "name": "bank", "c_uf": 200.0},
        {"kind": "series_capacitor", "name": "comp", "x_ohm": 0.06},
        {"kind": "series", "r_ohm": 0.009, "x_ohm": 0.16},
    ]
}


def ladder_impedance(s: np.ndarray) -> np.ndarray:
    """z (n,) of `LADDER` at s of the phase frame, by hand."""
    z_line = 0.009 + s * 0.16 / W1 + 0.06 * W1 / s
    z = 0.006 + s * 0.12 / W1 + 1.0 / (s * 200e-6 + 1.0 / z_line)
    w, c = 2.0 * np.pi * 350.0, 60e-6
    z_filter = 1.0 / (w * c * 30.0) + s / (w**2 * c) + 1.0 / (s * c)
    return 1.0 / (1.0 / z + 1.0 / z_filter)


@pytest.mark.parametrize(("plant_id", "kind"), [("gfl-v1", "following"), ("gfm-v1", "forming")])
def test_poles_of_an_inverter_behind_elements_are_roots_of_its_loop(plant_id, kind):
    """Of det(1 + Y Z) with Y of the oracle's linearisation and Z by hand; Newton's step from each pole is tiny."""
    plant = make_plant(plant_id)
    power, z_base = 0.4, plant.base_impedance_ohm
    model = inverter_oracle.linearise(plant.parameters, kind, power, 1.0)

    def det(s: complex) -> complex:
        y = -model.c @ np.linalg.solve(s * np.eye(len(model.a)) - model.a, model.b.astype(complex)) / z_base
        z1, z2 = (z_base * ladder_impedance(np.array(s + j * W1)) for j in (1j, -1j))
        return complex(np.linalg.det(np.eye(2) + y @ ((z1 + z2) / 2.0 * np.eye(2) + (z1 - z2) / 2j * J)))

    at_u = OperatingPoint(power * plant.rating.power_va, plant.rating.voltage_v)
    scaled = {**LADDER, "element": [scaled_entry(entry, z_base) for entry in LADDER["element"]]}
    poles = plant.linearise(plant.equilibrium(at_u, behind(scaled)))
    oscillating = poles[(poles.imag > 30.0) & (np.abs(poles) < 2.0 * np.pi * 700.0)]
    assert len(oscillating) >= 4
    for s in oscillating:
        h = 1e-5 * abs(s)
        step = det(s) / ((det(s + h) - det(s - h)) / (2.0 * h))
        assert abs(step) < 3e-6 * abs(s)


def scaled_entry(entry: dict, factor: float) -> dict:
    up, down = ("r_ohm", "x_ohm"), ("c_uf",)
    return {k: v * factor if k in up else v / factor if k in down else v for k, v in entry.items()}


# ---------------------------------------------------------------- transients


def ladder_rates(series_capacitor_f: float):
    """Network states of `LADDER` in dq: i1, v_bank, i2, v_comp, i_filter, v_filter (A, V, in pairs)."""
    l_1, l_2, w, c = 0.12 / W1, 0.16 / W1, 2.0 * np.pi * 350.0, 60e-6
    l_f, r_f = 1.0 / (w**2 * c), 1.0 / (w * c * 30.0)

    def rates(n: np.ndarray, v: np.ndarray, v_g: np.ndarray) -> np.ndarray:
        i_1, v_b, i_2, v_s, i_f, v_f = n.reshape(6, 2)
        d = [
            (v - v_b - 0.006 * i_1) / l_1,
            (i_1 - i_2) / 200e-6,
            (v_b - v_s - v_g - 0.009 * i_2) / l_2,
            i_2 / series_capacitor_f,
            (v - v_f - r_f * i_f) / l_f,
            i_f / c,
        ]
        return np.concatenate([each - W1 * J @ state for each, state in zip(d, n.reshape(6, 2), strict=True)])

    return rates


def whole(network, v_g: np.ndarray, wind: float, conductance=None):
    """Turbine (15) and network (12): d/dt (27,); Kirchhoff's law at the PCC gives its voltage."""

    def pcc(t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = z[15:17] + z[23:25]
        g = np.zeros((2, 2)) if conductance is None else conductance(t)
        v = np.linalg.solve(np.eye(2) / TABLE_I.r_f_ohm + g, z[0:2] - out + z[2:4] / TABLE_I.r_f_ohm)
        return v, out + g @ v

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        v, _ = pcc(t, z)
        return np.concatenate([oracle.rhs(z[:15], v, wind), network(z[15:], v, v_g)])

    return rates, pcc


def integrated(rates, z: np.ndarray, from_s: float, to_s: float) -> np.ndarray:
    t = np.arange(round(from_s / 5e-5), round(to_s / 5e-5) + 1) * 5e-5
    return solve_ivp(rates, (t[0], t[-1]), z, method="DOP853", t_eval=t, rtol=1e-10, atol=1e-8).y


def at_rest(power_w: float, voltage_v: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Turbine and network at rest in the frame of v_pcc, and the source's voltage, by phasors."""
    x, wind = oracle.equilibrium(power_w, voltage_v)
    i_g = -oracle.current(x, np.array([voltage_v, 0.0]))
    v, s = complex(voltage_v), 1j * W1
    w, c = 2.0 * np.pi * 350.0, 60e-6
    i_f = v / (1.0 / (w * c * 30.0) + s / (w**2 * c) + 1.0 / (s * c))
    i_1 = complex(*i_g) - i_f
    v_b = v - (0.006 + 0.12j) * i_1
    i_2 = i_1 - s * 200e-6 * v_b
    v_s = i_2 * 0.06 * W1 / s
    v_g = v_b - v_s - (0.009 + 0.16j) * i_2
    phasors = (i_1, v_b, i_2, v_s, i_f, i_f / (s * c))
    return np.concatenate([x, *([p.real, p.imag] for p in phasors)]), np.array([v_g.real, v_g.imag]), wind


def scenario(v_g: np.ndarray, *events) -> Scenario:
    circuit = circuit_of(LADDER, 50.0)
    return Scenario(0.6e6, 0.0, 1.0, float(np.hypot(*v_g)), events, circuit=circuit)


def agrees(trajectory, states: np.ndarray, v_g: np.ndarray, out: np.ndarray, limit: float) -> None:
    n = states.shape[1]
    turned = np.exp(1j * (W1 * trajectory.time_s[:n] - np.arctan2(v_g[1], v_g[0])))
    i = -sqrt(2.0 / 3.0) * (out[0] + 1j * out[1]) * turned
    assert np.max(np.abs(trajectory.i[:n] - i)) < limit * np.max(np.abs(i))
    assert np.max(np.abs(trajectory.sync_rad[:n] - states[4] + np.arctan2(v_g[1], v_g[0]))) < limit


def test_a_step_of_compensation_agrees_with_an_independent_integration():
    z, v_g, wind = at_rest(0.6e6, 690.0)
    more = ready_to_switch(LADDER, 50.0)
    more["element"][3]["x_ohm"] = 0.15
    step = CircuitStep(0.02, circuit_of(more, 50.0), "comp")
    rates, _ = whole(ladder_rates(1.0 / (W1 * 0.15)), v_g, wind)
    states = np.concatenate([np.repeat(z[:, None], 400, axis=1), integrated(rates, z, 0.02, 0.12)], axis=1)
    start = replace(scenario(v_g, step), circuit=circuit_of(ready_to_switch(LADDER, 50.0), 50.0))
    trajectory = simulate(PLANT, start, None, 0.12)
    agrees(trajectory, states[:, :-1], v_g, states[15:17, :-1] + states[23:25, :-1], 2e-6)
    assert np.ptp(trajectory.sync_rad) > 0.02


def test_an_unsymmetric_fault_behind_elements_agrees_with_an_independent_integration():
    z, v_g, wind = at_rest(0.6e6, 690.0)
    phase, g = np.arctan2(v_g[1], v_g[0]), fault_conductance("b-c", 4.0)

    def conductance(t: float) -> np.ndarray:
        c, s = np.cos(W1 * t - phase), np.sin(W1 * t - phase)
        to_ab = np.array([[c, -s], [s, c]])
        return to_ab.T @ np.array([[g[0], g[1]], [g[1], g[2]]]) @ to_ab

    faulted, pcc = whole(ladder_rates(1.0 / (W1 * 0.06)), v_g, wind, conductance)
    healed, _ = whole(ladder_rates(1.0 / (W1 * 0.06)), v_g, wind)
    during = integrated(faulted, z, 0.0, 0.02)
    after = integrated(healed, during[:, -1], 0.02, 0.04)
    out = np.array([pcc(5e-5 * k, x)[1] for k, x in enumerate(during.T[:-1])]).T
    out = np.concatenate([out, (after[15:17] + after[23:25])[:, :-1]], axis=1)
    states = np.concatenate([during[:, :-1], after[:, :-1]], axis=1)
    trajectory = simulate(PLANT, scenario(v_g, Fault(0.0, 0.02, "b-c", 4.0)), None, 0.04)
    agrees(trajectory, states, v_g, out, 1e-5)


def test_growth_after_a_kick_is_the_tableau_s(linear):
    """Within 2 % of the real part and 0.02 Hz, with damping control off and on."""
    case = near_critical(np.random.default_rng(11), linear, "all")
    circuit = circuit_of(case.document, 50.0).scaled(case.scale)
    state = PLANT.equilibrium(OperatingPoint(P_W, U_V), Source("network", circuit=circuit))
    source_v = abs(state.v_source)
    kick = Scenario(P_W, 0.0, 1.0, source_v, (Fault(0.0, 0.01, "a-b-c", 300.0),), circuit=circuit)
    trajectory = simulate(PLANT, kick, None, 0.5)
    early, late = resonance_between(trajectory, 0.1, 0.25), resonance_between(trajectory, 0.3, 0.45)
    growth = np.log(late.amplitude / early.amplitude) / 0.2
    assert growth == pytest.approx(case.critical.real, rel=0.02, abs=0.02)
    assert abs(late.f_hz - 50.0) == pytest.approx(case.critical.imag / (2.0 * np.pi), abs=0.02)
    damped = simulate(PLANT, kick, DampingSettings(0.3, 0.01, 0.6e-3, 77.0), 0.3, on_from_s=0.0)
    assert resonance_between(damped, 0.1, 0.25).amplitude < 0.7 * early.amplitude


# ---------------------------------------------------------------- as a plant


def test_a_turbine_behind_elements_branches_and_goes_on_as_one_run():
    state = PLANT.settle(OperatingPoint(0.4e6, 690.0), behind(LADDER))
    tones = Injection("series_voltage", tuple(Tone(f, 0.5, 0.1 * f) for f in (77.0, -31.0, 260.0)))
    ((half, _),) = PLANT.run([Job(state, tones)], 300)
    ((_, rest),) = PLANT.run([Job(half, tones)], 300)
    (_, _), (_, record) = PLANT.run([Job(state, None), Job(state, tones)], 600)
    assert np.max(np.abs(record.v[300:] - rest.v)) < 1e-9 * np.max(np.abs(record.v))
    assert np.max(np.abs(record.i[300:] - rest.i)) < 1e-9 * np.max(np.abs(record.i))


def test_a_shunt_current_acts_as_the_series_voltage_of_the_same_thevenin_source():
    state = PLANT.settle(OperatingPoint(0.4e6, 690.0), behind(LADDER))
    z = complex(ladder_impedance(np.array(2j * np.pi * 120.0)))
    current = Injection("shunt_current", (Tone(120.0, 3.0, 0.4),))
    voltage = Injection("series_voltage", (Tone(120.0, 3.0 * abs(z), 0.4 + np.angle(z)),))
    (_, one), (_, other) = PLANT.run([Job(state, current), Job(state, voltage)], 400)
    assert np.max(np.abs(one.i - other.i)) < 1e-9 * np.max(np.abs(one.i))


def test_who_cannot_stand_behind_elements_says_so():
    branch = RLBranch()
    with pytest.raises(ValueError, match=r"simulated behind the built-in plants dpmsg-v1, gfl-v1 and gfm-v1 alone"):
        branch.settle(OperatingPoint(0.0, 690.0), behind(LADDER))
    with pytest.raises(ValueError, match="give this plant a grid R \\+ jX"):
        ReferenceTurbine(integrator="emt").settle(OperatingPoint(0.4e6, 690.0), behind(LADDER))


def test_a_grid_that_cannot_carry_the_power_is_no_wrong_call():
    weak = {"element": [{"kind": "series", "r_ohm": 0.01, "x_ohm": 1.2}]}
    with pytest.raises(NotSettled, match="no equilibrium"):
        PLANT.equilibrium(OperatingPoint(0.9e6, None), replace(behind(weak), voltage_v=690.0))


# ---------------------------------------------------------------- documents


def test_a_table_has_no_time_domain():
    f = np.geomspace(1.0, 2500.0, 40)
    with pytest.raises(GridError, match="no time domain"):
        circuit_of_grid(fit_impedance(f, 0.01 + 0.005j * f, 50.0))


def test_a_grid_without_a_source_is_refused_in_time():
    with pytest.raises(GridError, match="nothing leads to the source"):
        circuit_of({"element": [{"kind": "shunt_reactor", "x_ohm": 5.0}]}, 50.0)


def test_names_and_compensation_do_not_move_when_something_is_switched():
    document = {
        "voltage_kv": 35.0,
        "element": [
            {"kind": "line", "length_km": 10.0, "r_ohm_per_km": 0.1, "x_ohm_per_km": 0.4},
            {"kind": "series_capacitor", "compensation_percent": 40.0},
            {"kind": "line", "length_km": 5.0, "r_ohm_per_km": 0.1, "x_ohm_per_km": 0.4},
        ],
    }
    ready = ready_to_switch(document, 50.0)
    assert names_of(document) == ["line1", "series_capacitor1", "line2"] == [e["name"] for e in ready["element"]]
    assert ready["element"][1]["x_ohm"] == pytest.approx(0.4 * 0.4 * 15.0)
    ready["element"][0]["in_service"] = False
    left = {branch.name: branch for branch in circuit_of(ready, 50.0).branches}
    assert set(left) == {"series_capacitor1", "line2.series1"}
    assert left["series_capacitor1"].c_f == pytest.approx(1.0 / (W1 * 2.4))


def test_the_source_behind_transformers_is_told_as_the_pcc_has_it():
    document = {
        "voltage_kv": 0.69,
        "element": [
            {"kind": "transformer", "sn_mva": 2.0, "vn_lv_kv": 0.69, "vn_hv_kv": 35.0, "vk_percent": 6.0},
            {"kind": "transformer", "sn_mva": 60.0, "vn_lv_kv": 35.0, "vn_hv_kv": 220.0, "vk_percent": 12.0},
            {"kind": "source", "s_sc_mva": 900.0},
        ],
    }
    circuit = circuit_of(document, 50.0)
    assert circuit.source_ratio == pytest.approx(220.0 / 0.69)
    assert circuit.seen_at(1j * W1)[1] == pytest.approx(1.0)
