"""The turbine in time: against an independent integration, against linear theory, and as the paper tells it."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from time import perf_counter

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.estimator import sliding_fft
from seqsweep.plant.damping.events import (
    Fault,
    GridStep,
    PowerStep,
    Scenario,
    Trajectory,
    TurbineStep,
    WindStep,
    conditions_at,
    fault_conductance,
    resonance_between,
    simulate,
)
from seqsweep.plant.protocol import Conditions, OperatingPoint, Source
from seqsweep.plant.rl_branch import RLBranch
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine

from ..support import oracle
from ..support.damped_oracle import damped_equilibrium, damped_grid_rhs, turn

PLANT = ReferenceTurbine()
W1 = TABLE_I.w1_rad_s


def scenario(power_w: float, *events, scale: float = 1.2) -> Scenario:
    return Scenario(power_w, LINE_R_OHM, LINE_L_H, 690.0, events, scale)


def settings(scale: float, k: float = 0.5, **others) -> DampingSettings:
    return DampingSettings(k, scale * LINE_R_OHM, scale * LINE_L_H, 77.0, **others)


# ---------------------------------------------------------------- against an independent integration


def start_of_oracle(power_w: float, scale: float) -> tuple[np.ndarray, np.ndarray, float]:
    """State (21,) with notch and line, source voltage (2,) and wind, in the frame of v_pcc."""
    line = scale * LINE_R_OHM, scale * LINE_L_H
    terminal_voltage_v = oracle.terminal_voltage(power_w, *line, 690.0)
    x, i_g, wind = damped_equilibrium(power_w, terminal_voltage_v)
    v_g = oracle.source_voltage(power_w, terminal_voltage_v, *line)
    return np.concatenate([x, i_g]), np.array([v_g.real, v_g.imag]), wind


def integrated(rates, x: np.ndarray, from_s: float, to_s: float) -> np.ndarray:
    """States (21, n) at 50 us by an eighth-order method."""
    t = np.arange(round(from_s / 5e-5), round(to_s / 5e-5) + 1) * 5e-5
    return solve_ivp(rates, (t[0], t[-1]), x, method="DOP853", t_eval=t, rtol=1e-10, atol=1e-8).y


def agrees(trajectory: Trajectory, states: np.ndarray, v_g: np.ndarray, i_g: np.ndarray, limit: float) -> None:
    """Current, DC voltage and PLL angle of the trajectory's first samples are those of ``states``."""
    n = states.shape[1]
    turned = np.exp(1j * (W1 * trajectory.time_s[:n] - np.arctan2(v_g[1], v_g[0])))
    i = -sqrt(2.0 / 3.0) * (i_g[0] + 1j * i_g[1]) * turned
    assert np.max(np.abs(trajectory.i[:n] - i)) < limit * np.max(np.abs(i))
    assert np.max(np.abs(trajectory.v_dc_v[:n] - states[9])) < limit * 1200.0
    sync = states[4] - np.arctan2(v_g[1], v_g[0])
    assert np.max(np.abs(trajectory.sync_rad[:n] - sync)) < limit


def test_grid_step_and_damping_agree_with_an_independent_integration():
    """1.2 Z to 1.4 Z at 0.02 s, damping on at 0.1 s; equations and integrator share nothing with the kernel."""
    x, v_g, wind = start_of_oracle(0.60e6, 1.2)
    line = 1.4 * LINE_R_OHM, 1.4 * LINE_L_H

    def rates(k: float):
        return lambda t, z: damped_grid_rhs(z, v_g, wind, k, 2.0 * pi * 77.0, line)

    before = np.repeat(x[:, None], 400, axis=1)
    undamped = integrated(rates(0.0), x, 0.02, 0.1)
    damped = integrated(rates(0.5), undamped[:, -1], 0.1, 0.25)
    states = np.concatenate([before, undamped[:, :-1], damped[:, :-1]], axis=1)
    trajectory = simulate(PLANT, scenario(0.60e6, GridStep(0.02, 1.4)), settings(1.4), 0.25, on_from_s=0.1)
    agrees(trajectory, states, v_g, states[19:21], 1e-8)
    assert np.ptp(trajectory.sync_rad) > 0.1


def test_unbalanced_fault_agrees_with_an_independent_integration():
    """30 ms between b and c through 4 ohm: deep enough to matter, too shallow for the converter's voltage limit."""
    x, v_g, wind = start_of_oracle(0.60e6, 1.0)
    g, phase = np.diag([0.0, 2.0 / 4.0]), np.arctan2(v_g[1], v_g[0])

    def pcc(t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """PCC voltage and the current out of the turbine: Kirchhoff's law at the PCC."""
        c, s = np.cos(W1 * t - phase), np.sin(W1 * t - phase)
        to_ab = np.array([[c, -s], [s, c]])
        g_dq = to_ab.T @ g @ to_ab
        v = np.linalg.solve(np.eye(2) / TABLE_I.r_f_ohm + g_dq, z[0:2] - z[19:21] + z[2:4] / TABLE_I.r_f_ohm)
        return v, z[19:21] + g_dq @ v

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        v, _ = pcc(t, z)
        di = (v - v_g - LINE_R_OHM * z[19:21]) / LINE_L_H - W1 * turn(z[19:21])
        return np.concatenate([oracle.rhs(z[:15], v, wind), np.zeros(4), di])

    def healed(t: float, z: np.ndarray) -> np.ndarray:
        return damped_grid_rhs(z, v_g, wind, 0.0, 0.0, (LINE_R_OHM, LINE_L_H))

    faulted = integrated(rates, x, 0.0, 0.03)
    after = integrated(healed, faulted[:, -1], 0.03, 0.05)
    times = np.arange(600) * 5e-5
    i_g = np.array([pcc(t, z)[1] for t, z in zip(times, faulted.T, strict=False)]).T
    states = np.concatenate([faulted[:, :-1], after[:, :-1]], axis=1)
    trajectory = simulate(PLANT, scenario(0.60e6, Fault(0.0, 0.03, "b-c", 4.0), scale=1.0), None, 0.05)
    agrees(trajectory, states, v_g, np.concatenate([i_g, after[19:21, :-1]], axis=1), 1e-7)
    assert np.abs(trajectory.v[:600]).min() < 0.92 * 563.4


# ---------------------------------------------------------------- against linear theory


@pytest.mark.parametrize(("scale", "k"), [(1.0, 0.0), (1.2, 0.0), (1.4, 0.0), (1.4, 0.5)])
def test_growth_after_a_small_kick_is_that_of_linear_theory(scale, k):
    """0.65 MW; the kick is a fault of 500 ohm for 10 ms. Growth from the amplitudes of two windows."""
    kick = scenario(0.65e6, Fault(0.0, 0.01, "a-b-c", 500.0), scale=scale)
    trajectory = simulate(PLANT, kick, settings(scale, k), 0.4, on_from_s=0.0)
    early, late = resonance_between(trajectory, 0.05, 0.2), resonance_between(trajectory, 0.15, 0.3)
    growth = np.log(late.amplitude / early.amplitude) / 0.1
    plant = ReferenceTurbine(
        damping_gain=k, damping_r_ohm=scale * LINE_R_OHM, damping_l_h=scale * LINE_L_H, damping_resonance_hz=77.0
    )
    source = Source("thevenin", scale * LINE_R_OHM, scale * LINE_L_H, 690.0)
    pole = oracle.resonance_pole(plant.linearise(plant.equilibrium(OperatingPoint(0.65e6, None), source)))
    assert growth == pytest.approx(pole.real, rel=0.02)
    assert late.growth_per_s == pytest.approx(pole.real, rel=0.02)
    assert late.f_hz - 50.0 == pytest.approx(pole.imag / (2.0 * pi), abs=0.02)
    if k == 0.0:
        printed = {1.0: -13.45, 1.2: -4.74, 1.4: 9.57}
        assert pole.real == pytest.approx(printed[scale], abs=0.01)


# ---------------------------------------------------------------- as the paper tells it


def component_ratio(trajectory: Trajectory, f_hz: float, from_s: float, to_s: float) -> float:
    """Mean magnitude at ``f_hz`` over that at 50 Hz, Hann's taper."""
    inside = (trajectory.time_s >= from_s - 1e-9) & (trajectory.time_s < to_s - 1e-9)
    t, i = trajectory.time_s[inside], trajectory.i[inside] * np.hanning(np.sum(inside))
    at, fundamental = (abs(np.sum(i * np.exp(-2j * pi * f * t))) for f in (f_hz, 50.0))
    return at / fundamental


def test_grid_step_makes_the_resonance_grow_until_synchronism_is_lost():
    """0.60 MW, 1.2 Z to 1.4 Z at 0.1 s."""
    trajectory = simulate(PLANT, scenario(0.60e6, GridStep(0.1, 1.4)), None, 0.9)
    assert component_ratio(trajectory, 76.5, 0.15, 0.30) == pytest.approx(0.12, abs=0.005)
    assert component_ratio(trajectory, 76.5, 0.50, 0.65) > 0.4
    assert trajectory.lost_s is not None
    assert 0.6 < trajectory.lost_s < 0.9
    assert trajectory.started_s == ()
    before = (trajectory.decision_s > 0.26) & (trajectory.decision_s < 0.45)
    np.testing.assert_allclose(trajectory.resonance_hz[before], 76.6, atol=0.3)
    assert np.median(trajectory.growth_per_s[before]) == pytest.approx(3.3, abs=0.5)  # amplitudes are no longer small


@pytest.mark.parametrize(("on_from_s", "started_s"), [(0.25, 0.252), (None, 0.28)])
def test_damping_ends_the_resonance_by_half_a_second(on_from_s, started_s):
    """Switched on at 0.25 s, and by its own logic: 150 ms after r has passed 3 %."""
    step = scenario(0.60e6, GridStep(0.1, 1.4))
    trajectory = simulate(PLANT, step, settings(1.4), 0.9, on_from_s=on_from_s)
    assert trajectory.started_s == (pytest.approx(started_s, abs=0.006),)
    assert trajectory.lost_s is None
    at = np.searchsorted(trajectory.decision_s, 0.52)
    assert np.all(trajectory.ratio[at:] < 0.03)
    assert trajectory.growth_per_s[-1] == pytest.approx(-8.4, rel=0.03)


def test_paper_way_of_estimating_and_no_preset_end_it_too():
    """The sliding FFT sees the nearest line, 78.6 Hz, and takes w_r from it."""
    step, paper = scenario(0.60e6, GridStep(0.1, 1.4)), settings(1.4, estimator=sliding_fft)
    trajectory = simulate(PLANT, step, replace(paper, resonance_hz=None), 0.9)
    assert trajectory.started_s[0] < 0.35
    assert trajectory.lost_s is None
    assert trajectory.ratio[-1] < 0.01


def test_at_more_power_the_step_alone_loses_synchronism_unless_damping_acts():
    step = scenario(0.65e6, GridStep(0.1, 1.4))
    lost_s = simulate(PLANT, step, None, 0.5).lost_s
    assert lost_s is not None
    assert lost_s < 0.4
    assert simulate(PLANT, step, settings(1.4), 0.5).lost_s is None


@pytest.mark.parametrize("kind", ["a-b-c", "a-g", "b-c", "b-c-g"])
def test_faults_of_40_ms_do_not_start_it_on_a_stable_grid(kind):
    """Short circuit ratio 1.8, as in the paper's scenario 4; the turbine rides through."""
    fault = scenario(0.60e6, Fault(0.1, 0.04, kind), scale=0.648)
    trajectory = simulate(PLANT, fault, settings(0.648), 0.7)
    assert trajectory.started_s == ()
    assert trajectory.lost_s is None
    assert np.any(trajectory.blocked)
    assert np.abs(trajectory.v).min() < 0.3 * 563.4
    assert trajectory.ratio[-1] < 0.005


def test_bearable_grid_step_does_not_start_it():
    """1.0 Z to 1.2 Z rings above 3 % for a while, but decays."""
    trajectory = simulate(PLANT, scenario(0.65e6, GridStep(0.1, 1.2), scale=1.0), settings(1.2), 0.6)
    assert np.sum(trajectory.ratio > 0.03) * 2e-3 > 0.1
    assert trajectory.started_s == ()


def test_it_stops_when_the_grid_is_back_and_the_check_says_so():
    asked = []

    def cause_gone(conditions: Conditions) -> bool:
        asked.append(conditions)
        return conditions.l_h < 1.3 * LINE_L_H

    there_and_back = scenario(0.60e6, GridStep(0.1, 1.4), Fault(0.4, 0.01, "a-b-c", 10.0), GridStep(0.6, 1.2))
    trajectory = simulate(PLANT, there_and_back, settings(1.4), 0.8, cause_gone=cause_gone)
    assert trajectory.stopped_s == (pytest.approx(0.6, abs=0.003),)
    assert trajectory.lost_s is None
    assert [c.l_h / LINE_L_H for c in asked] == pytest.approx([1.2, 1.4])


# ---------------------------------------------------------------- events


def test_at_rest_nothing_happens():
    trajectory = simulate(PLANT, scenario(0.65e6, scale=1.0), settings(1.0), 0.3)
    assert np.ptp(np.abs(trajectory.v)) < 1e-6
    assert np.all(trajectory.ratio == 0.0)
    assert not np.any(trajectory.active | trajectory.blocked)
    loss_w = 235.0  # of the shunt resistor
    assert trajectory.p_w[-1] == pytest.approx(0.65e6 - loss_w, abs=20.0)
    assert trajectory.q_var[-1] == pytest.approx(687.02**2 * W1 * TABLE_I.c_f_f, rel=0.01)
    assert np.abs(trajectory.v[0]) == pytest.approx(687.02 * sqrt(2.0 / 3.0), abs=0.01)
    assert np.degrees(trajectory.sync_rad[0]) == pytest.approx(19.925, abs=0.01)


def test_more_turbines_are_a_weaker_grid():
    """8 to 11 turbines are 1.375 Z for each of them."""
    shared = Scenario(0.60e6, LINE_R_OHM, LINE_L_H, 690.0, (TurbineStep(0.05, 11.0),), turbines=8.0)
    stepped = Scenario(0.60e6, LINE_R_OHM, LINE_L_H, 690.0, (GridStep(0.05, 11.0 / 8.0),))
    np.testing.assert_array_equal(simulate(PLANT, shared, None, 0.1).i, simulate(PLANT, stepped, None, 0.1).i)


def test_power_step_changes_machine_power_at_once_and_wind_with_the_rotor():
    more_power = simulate(PLANT, scenario(0.65e6, PowerStep(0.1, 0.70e6), scale=1.0), None, 0.8)
    dc_link_j = 0.5 * TABLE_I.c_dc_f * more_power.v_dc_v**2
    machine_w = more_power.p_w[2000:].mean() + (dc_link_j[-1] - dc_link_j[2000]) / 0.7
    assert machine_w == pytest.approx(
        0.70e6, rel=0.01
    )  # the rotor gives way by 0.4 % in this time, power by three times that
    more_wind = simulate(PLANT, scenario(0.65e6, WindStep(0.1, 9.0), scale=1.0), None, 0.8)
    assert more_wind.rotor_rad_s[-1] > more_wind.rotor_rad_s[0] + 0.01
    assert more_wind.rotor_rad_s[2000] == pytest.approx(more_wind.rotor_rad_s[0], rel=1e-9)


def test_events_may_fall_between_two_decisions():
    """Cut anywhere, a run without change is the same run."""
    whole = simulate(PLANT, scenario(0.60e6, GridStep(0.02, 1.3)), None, 0.1)
    cut = simulate(PLANT, scenario(0.60e6, GridStep(0.02, 1.3), GridStep(0.05305, 1.3)), None, 0.1)
    np.testing.assert_allclose(cut.i, whole.i, rtol=0, atol=1e-8)


def test_conditions_follow_the_events():
    story = scenario(
        0.6e6, Fault(0.2, 0.04, "a-g", 0.1), GridStep(0.1, 1.4), WindStep(0.3, 9.0), PowerStep(0.3, 0.3e6), scale=1.2
    )
    assert conditions_at(story, 0.0) == Conditions(1.2 * LINE_R_OHM, 1.2 * LINE_L_H)
    assert conditions_at(story, 0.2).fault_s == pytest.approx((20.0 / 3.0, 0.0, 0.0))
    assert conditions_at(story, 0.24).fault_s == (0.0, 0.0, 0.0)
    assert conditions_at(story, 0.3).l_h == pytest.approx(1.4 * LINE_L_H)
    assert (conditions_at(story, 0.3).wind_m_s, conditions_at(story, 0.3).power_scale) == (9.0, 0.5)


def test_fault_of_all_phases_is_the_sum_of_its_parts():
    parts = np.add(fault_conductance("a-g", 0.1), fault_conductance("b-c-g", 0.1))
    np.testing.assert_allclose(parts, fault_conductance("a-b-c", 0.1))


@pytest.mark.parametrize("kind", ["a-b-c", "a-g", "b-c", "b-c-g"])
def test_fault_conductance_is_that_of_the_phases(kind):
    """Phase by phase: a resistor from each faulted phase to ground (v_0 = 0), or between b and c."""
    r = 0.3
    clarke = np.array([[2.0, -1.0, -1.0], [0.0, sqrt(3.0), -sqrt(3.0)]]) / 3.0
    back = np.array([[1.0, 0.0], [-0.5, sqrt(0.75)], [-0.5, -sqrt(0.75)]])
    between = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]]) / r
    phases = {"a-b-c": np.eye(3) / r, "a-g": np.diag([1, 0, 0]) / r, "b-c-g": np.diag([0, 1, 1]) / r, "b-c": between}
    aa, ab, bb = fault_conductance(kind, r)
    np.testing.assert_allclose([[aa, ab], [ab, bb]], clarke @ phases[kind] @ back, atol=1e-12)


# ---------------------------------------------------------------- figures for the docs


@pytest.mark.evidence
def test_story_in_figures():
    step = {power_w: scenario(power_w, GridStep(0.1, 1.4)) for power_w in (0.60e6, 0.65e6)}
    for power_w, on_from_s, damped in (
        (0.60e6, None, False),
        (0.60e6, 0.25, True),
        (0.60e6, None, True),
        (0.65e6, None, False),
        (0.65e6, None, True),
        (0.65e6, 0.15, True),
    ):
        start = perf_counter()
        trajectory = simulate(PLANT, step[power_w], settings(1.4) if damped else None, 1.0, on_from_s=on_from_s)
        taken_s = perf_counter() - start
        gone = trajectory.decision_s[trajectory.ratio > 0.03][-1]
        print(
            f"\n{power_w / 1e6:.2f} MW, damping {damped}, on {trajectory.started_s}, lost {trajectory.lost_s}, ", end=""
        )
        print(
            f"r > 3 % until {gone:.2f} s, growth at the end {trajectory.growth_per_s[-1]:+.1f}/s, {taken_s:.2f} s wall"
        )
        for from_s in (0.15, 0.30, 0.45, 0.60):
            print(f"  76.5 Hz: {component_ratio(trajectory, 76.5, from_s, from_s + 0.15):.3f}", end="")
    assert not trajectory.lost_s


@pytest.mark.evidence
def test_faults_in_figures():
    """Loss of synchronism is the turbine's, not the damping control's; a start is what must not be."""
    for scale in (0.648, 1.0, 1.2):
        for kind in ("a-b-c", "a-g", "b-c", "b-c-g"):
            for r_ohm in (0.001, 0.01, 0.05):
                fault = scenario(0.60e6, Fault(0.1, 0.04, kind, r_ohm), scale=scale)
                trajectory = simulate(PLANT, fault, settings(scale), 0.7)
                after = trajectory.ratio[trajectory.decision_s > 0.15]
                highest = np.max(after[np.isfinite(after)], initial=0.0)
                lost = f"lost at {trajectory.lost_s:.3f} s" if trajectory.lost_s else f"r <= {highest:.4f} after it"
                print(f"\n{scale} Z, {kind}, {r_ohm} ohm: starts {trajectory.started_s}, {lost}", end="")
                assert trajectory.started_s == ()


# ---------------------------------------------------------------- refusals


def test_plant_without_a_measurement_port_is_refused_by_name():
    with pytest.raises(ValueError, match="branch-v1 has no measurement port"):
        simulate(RLBranch(), scenario(0.6e6), None, 0.1)


def test_wrong_calls_are_refused_in_words():
    with pytest.raises(ValueError, match="was made with damping_gain > 0"):
        simulate(ReferenceTurbine(damping_gain=0.5), scenario(0.6e6), None, 0.1)
    with pytest.raises(ValueError, match=r"not a whole number of steps of 0.002 s"):
        simulate(PLANT, scenario(0.6e6), None, 0.1001)
    with pytest.raises(ValueError, match="set for 60 Hz; dpmsg-v1 has 50 Hz"):
        simulate(PLANT, scenario(0.6e6), settings(1.0, f1_hz=60.0), 0.1)
    with pytest.raises(ValueError, match="needs a state behind a thevenin source"):
        PLANT.trace(PLANT.settle(OperatingPoint(0.6e6, 690.0), Source()), Conditions(0.0, 1e-3), 1)


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ((GridStep(0.1, -1.0),), "scale of the event at 0.1 s must be positive; got -1"),
        ((GridStep(-0.1, 1.0),), "needs a time from 0 s on; got -0.1 s"),
        ((Fault(0.1, 0.04, "a-b"),), "unknown kind of fault 'a-b'"),
        ((Fault(0.1, 0.04, "a-g", 0.0),), "r_ohm of the event at 0.1 s must be positive"),
        ((Fault(0.1, 0.1, "a-g"), Fault(0.15, 0.1, "b-c")), "faults at 0.1 s and 0.15 s overlap"),
    ],
)
def test_impossible_events_are_refused(events, words):
    with pytest.raises(ValueError, match=words):
        scenario(0.6e6, *events)
