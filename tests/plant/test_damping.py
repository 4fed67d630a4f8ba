"""Damping control: what it does to the plant, against an exact linearisation; and when it acts."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np
import pytest

from seqsweep.plant.damping import control as damping
from seqsweep.plant.damping.control import DampingSettings, DampingState, Measurement
from seqsweep.plant.damping.estimator import WINDOW_S, sliding_fft
from seqsweep.plant.protocol import Compensation, Injection, Job, OperatingPoint, Source, Tone, Window
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I
from seqsweep.plant.turbine.reference import ReferenceTurbine

from ..support import oracle
from ..support.damped_oracle import W1, damped_admittance, damped_poles
from ..support.machine_code import instructions

SCALE = 1.4
R_OHM, L_H = LINE = SCALE * LINE_R_OHM, SCALE * LINE_L_H
V_PCC_V = 647.31  # at 0.65 MW, 1.4 Z, |v_g| = 690 V


def margin_at_crossing(k: float, w_r: float) -> float:
    """m = |Yg1 / Y1| at the 180-degree crossing of Y1 with f > f1 and the smallest m, at 0.65 MW, 1.4 Z."""
    f = np.arange(51.0, 200.0, 0.01)
    y = damped_admittance(f, 0.65e6, V_PCC_V, k, w_r, LINE)
    z_1, z_2 = R_OHM + 2j * pi * f * L_H, R_OHM + 1j * (2.0 * pi * f - 2.0 * W1) * L_H
    loop = z_1 * (y[:, 0, 0] - y[:, 0, 1] * y[:, 1, 0] / (y[:, 1, 1] + 1.0 / z_2))
    crossing = (loop.real[1:] < 0.0) & (loop.imag[1:] * loop.imag[:-1] <= 0.0)
    return float(np.min(1.0 / np.abs(loop[1:][crossing])))


def damped_turbine(k: float = 0.5, f_r_hz: float = 77.0) -> ReferenceTurbine:
    return ReferenceTurbine(damping_gain=k, damping_r_ohm=R_OHM, damping_l_h=L_H, damping_resonance_hz=f_r_hz)


# ---------------------------------------------------------------- what it does


@pytest.mark.parametrize(("power_w", "sigma"), [(0.65e6, -3.8), (0.60e6, -8.4)])
def test_half_a_gain_moves_the_unstable_mode_to_the_left(power_w, sigma):
    terminal_voltage_v = oracle.terminal_voltage(power_w, R_OHM, L_H, 690.0)
    assert oracle.resonance_pole(oracle.closed_loop_poles(power_w, R_OHM, L_H, source_voltage_v=690.0)).real > 3.0
    pole = oracle.resonance_pole(damped_poles(power_w, terminal_voltage_v, 0.5, 2.0 * pi * 77.0, LINE))
    assert pole.real == pytest.approx(sigma, abs=0.05)


@pytest.mark.parametrize(("k", "m"), [(0.357, 1.00), (0.5, 1.05), (0.9, 1.20), (1.1, 1.29)])
def test_margins_with_damping_are_those_of_the_reference(k, m):
    assert margin_at_crossing(k, 2.0 * pi * 77.0) == pytest.approx(m, abs=0.005)


@pytest.mark.parametrize("k", [0.5, 1.1])
def test_kernel_has_the_closed_loop_poles_of_the_oracle(k):
    """Behind the grid; the stepper's own flow, so its warping is in it: 1e-4 of |s| at 1 kHz, far less below."""
    plant = damped_turbine(k)
    state = plant.equilibrium(OperatingPoint(0.65e6, None), Source("thevenin", R_OHM, L_H, 690.0))
    found = plant.linearise(state)
    terminal_voltage_v = oracle.terminal_voltage(0.65e6, R_OHM, L_H, 690.0)
    exact = damped_poles(0.65e6, terminal_voltage_v, k, 2.0 * pi * 77.0, LINE)
    assert len(found) == len(exact)
    for pole in exact[np.abs(exact) < 3e3]:
        assert np.min(np.abs(found - pole)) < 2e-5 * abs(pole) + 1e-4


def test_reshaped_admittance_swept_on_an_ideal_source_is_exact():
    """Two injections per point; 2 s let the notch (0.3 s) settle; amplitude 1e-4 leaves 1e-6 of nonlinearity."""
    plant, f_hz = damped_turbine(), np.array([5.0, 23.0, 60.0, 150.0, 400.0, 1000.0])
    state = plant.settle(OperatingPoint(0.65e6, V_PCC_V), Source())
    swept = np.array([sweep_point(plant, state, f) for f in f_hz])
    exact = damped_admittance(f_hz, 0.65e6, V_PCC_V, 0.5, 2.0 * pi * 77.0, LINE)
    error = np.linalg.norm(swept - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert np.max(error) < 1e-4
    undamped = oracle.admittance_pn(f_hz, 0.65e6, V_PCC_V)
    assert np.linalg.norm(undamped[1] - exact[1]) > 0.1 * np.linalg.norm(exact[1])


@pytest.mark.evidence
@pytest.mark.parametrize("k", [0.5, 1.1])
def test_reshaped_admittance_in_full(k):
    """1 Hz to 1 kHz. A line closer than 4 Hz to the fundamental would see its mirror through the window of 1 s."""
    plant = damped_turbine(k)
    state = plant.settle(OperatingPoint(0.65e6, V_PCC_V), Source())
    f_hz = np.unique(np.geomspace(1.0, 1000.0, 80).round())
    f_hz = f_hz[np.abs(f_hz - 50.0) >= 4.0]
    exact = damped_admittance(f_hz, 0.65e6, V_PCC_V, k, 2.0 * pi * 77.0, LINE)
    for settle_steps in (5000, 10000, 40000):
        swept = np.array([sweep_point(plant, state, f, settle_steps) for f in f_hz])
        error = np.linalg.norm(swept - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
        at = f_hz[np.argmax(error)]
        print(f"\nk {k}, {settle_steps * plant.dt_s:g} s of settling: error {np.median(error):.1e}, at most ", end="")
        print(f"{np.max(error):.1e} at {at:g} Hz", end="")
    assert np.max(error) < 1e-4


@pytest.mark.evidence
def test_closed_loop_figures():
    """Poles and margins of the printed reference, and the speed of the lanes with the block in them."""
    growth, margins, taken = {}, [], {}
    for power_w in (0.60e6, 0.65e6):
        terminal_voltage_v = oracle.terminal_voltage(power_w, R_OHM, L_H, 690.0)
        for k in (0.0, 0.5):
            pole = oracle.resonance_pole(damped_poles(power_w, terminal_voltage_v, k, 2.0 * pi * 77.0, LINE))
            growth[power_w, k] = pole.real
            print(f"\n{power_w / 1e6:.2f} MW, 1.4 Z, k {k}: {pole.real:+.2f} +- j {pole.imag / 2 / pi:.2f} Hz", end="")
    for k in (0.0, 0.357, 0.5, 0.9, 1.1):
        margins.append(margin_at_crossing(k, 2.0 * pi * 77.0))
        print(f"\n0.65 MW, 1.4 Z, k {k}: m {margins[-1]:.3f}", end="")
    for source in (Source(), Source("thevenin", R_OHM, L_H)):
        for k in (0.0, 0.5):
            taken[source.kind, k] = nanoseconds_per_step(damped_turbine(k), source)
            print(f"\n{source.kind}, k {k}: {taken[source.kind, k]:.1f} ns/step/lane", end="")
    for power_w in (0.60e6, 0.65e6):
        assert growth[power_w, 0.5] < 0.0 < growth[power_w, 0.0]
    assert np.all(np.diff(margins) > 0.0)
    assert margins[0] < 1.0 < margins[1]  # the edge, where the crossing turns the way the pole does
    for kind in ("ideal", "thevenin"):
        assert taken[kind, 0.5] < 2.5 * taken[kind, 0.0]


def nanoseconds_per_step(plant: ReferenceTurbine, source: Source) -> float:
    """Best of five runs of eight lanes with one tone each."""
    from time import perf_counter

    tone = Injection("series_voltage", (Tone(77.0, 0.5),))
    jobs = [Job(plant.equilibrium(OperatingPoint(0.65e6, 690.0), source), tone)] * 8
    taken = []
    for _ in range(5):
        start = perf_counter()
        plant.run_phasors(jobs, [Window(77.0, 20)] * 8, 5000, 20)
        taken.append(perf_counter() - start)
    return min(taken) / (8 * 100000) * 1e9


def test_reshaped_admittance_is_the_same_behind_a_grid():
    plant, f_hz = damped_turbine(), 77.0
    ideal = plant.settle(OperatingPoint(0.65e6, V_PCC_V), Source())
    grid = plant.settle(OperatingPoint(0.65e6, V_PCC_V), Source("thevenin", 0.5 * R_OHM, 0.5 * L_H))
    turned = np.exp(1j * np.angle(grid.values[13] + 1j * grid.values[14] - ideal.values[13] - 1j * ideal.values[14]))
    assert abs(turned) == pytest.approx(1.0)
    y_ideal, y_grid = sweep_point(plant, ideal, f_hz), sweep_point(plant, grid, f_hz)
    assert abs(y_grid[0, 0] - y_ideal[0, 0]) < 1e-5 * abs(y_ideal[0, 0])
    assert abs(y_grid[0, 1]) == pytest.approx(abs(y_ideal[0, 1]), rel=1e-5)


def test_without_gain_the_compensated_kernel_is_the_plain_one():
    """A gain too small to matter takes the other kernel."""
    plain, faint = ReferenceTurbine(), ReferenceTurbine(damping_gain=1e-300)
    tone = Injection("series_voltage", (Tone(77.0, 5.0),))
    for source in (Source(), Source("thevenin", LINE_R_OHM, LINE_L_H)):
        point = OperatingPoint(0.65e6, 690.0)
        jobs = [[Job(plant.equilibrium(point, source), tone)] for plant in (plain, faint)]
        (_, one), (_, other) = plain.run(jobs[0], 4000)[0], faint.run(jobs[1], 4000)[0]
        np.testing.assert_allclose(other.i, one.i, rtol=0, atol=1e-6)


def sweep_point(plant: ReferenceTurbine, state, f_hz: float, settle_steps: int = 40000) -> np.ndarray:
    """2x2 sequence admittance from injections at f and at its mirror, unperturbed branch subtracted."""
    window, steps = Window(f_hz, 20), 1000
    injections = [None, *(Injection("series_voltage", (Tone(f, 1e-4 * 563.0),)) for f in (f_hz, 100.0 - f_hz))]
    settled = [
        Job(end, inj)
        for (end, _), inj in zip(plant.run([Job(state, i) for i in injections], settle_steps), injections, strict=True)
    ]
    quiet, *perturbed = [phasors for _, phasors in plant.run_phasors(settled, [window] * 3, steps, 20)]
    v, i = (
        np.array([(getattr(p, name) - getattr(quiet, name)).sum(axis=0) for p in perturbed]).T for name in ("v", "i")
    )
    v[1], i[1] = np.conj(v[1]), np.conj(i[1])
    return i @ np.linalg.inv(v)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"damping_gain": 2.5}, r"damping_gain is 2.5; dpmsg-v1 takes 0 to 2"),
        ({"damping_gain": -0.1}, r"damping_gain is -0.1"),
        ({"damping_gain": float("nan")}, r"damping_gain is nan"),
        ({"damping_l_h": -1e-3}, r"damping_l_h is -0.001 H; dpmsg-v1 takes 0 to 1 H"),
        ({"damping_resonance_hz": 7700.0}, r"damping_resonance_hz is 7700 Hz"),
        ({"damping_gian": 0.5}, r"no parameter 'damping_gian'; it has damping_gain"),
    ],
)
def test_damping_parameters_are_refused_in_words(given, words):
    with pytest.raises(ValueError, match=words):
        ReferenceTurbine(**given)


@pytest.mark.parametrize(
    ("name", "calm"),
    [
        ("advance_ideal", True),
        ("advance_thevenin", True),
        ("advance_ideal_compensated", None),
        ("advance_thevenin_compensated", None),
    ],
)
def test_lanes_are_vector_code(name, calm):
    """A scalar kernel would be three to four times slower."""
    from seqsweep.plant.kernels import turbine

    kept = np.empty((1, 8, turbine.LANES))
    table, x = np.empty((0, 4, turbine.LANES)), np.ones(turbine.array_slots(0) * turbine.LANES)
    kernel = getattr(turbine, name)
    code = instructions(kernel, None, calm, table, x, 0, TABLE_I, 5e-5, 0, turbine.SUM_V, kept)
    if "ymm" not in code and "zmm" not in code:
        pytest.skip("this processor has no wide vectors")
    assert code.count("vmulpd") > 2 * code.count("vmulsd")


def test_notch_stops_the_fundamental_and_nothing_else():
    response = damping.notch(np.array([50.0, -50.0, 23.0, 77.0, 49.5]))
    np.testing.assert_allclose(response[:2], 0.0, atol=1e-15)
    np.testing.assert_allclose(response[2:4], 1.0, atol=0.03)  # phase 2 xi / (f/f0 - f0/f): 1.3 degrees
    assert abs(response[4]) == pytest.approx(np.sqrt(0.5), abs=0.01)  # half width xi f0


# ---------------------------------------------------------------- when it acts

SETTINGS = DampingSettings(0.5, R_OHM, L_H, 77.0)
V_PU, I_A = np.exp(0.3j), 800.0 * np.exp(0.1j)


def current(r: Callable[[float], float], f_r_hz: float = 77.0) -> Callable[[float], complex]:
    """800 A at 50 Hz and r(t) of it at the resonance."""
    return lambda t: I_A * np.exp(100j * pi * t) + abs(I_A) * r(t) * np.exp(2j * pi * f_r_hz * t)


def observe(
    i: Callable[[float], complex],
    to_s: float,
    settings: DampingSettings = SETTINGS,
    v_pu: Callable[[float], complex] = lambda t: V_PU * np.exp(100j * pi * t),
    gone: Callable[[float], bool] = lambda t: False,
) -> list[tuple[float, DampingState]]:
    """The states at every decision; means over 2 ms from 20 samples."""
    state, seen = damping.at_rest(0.0, V_PU, I_A), []
    for block in range(round(to_s / 2e-3)):
        t = 2e-3 * block + (np.arange(20) + 0.5) * 1e-4
        means = [complex(np.mean([x(s) for s in t])) for x in (v_pu, i)]
        end_s = 2e-3 * (block + 1)
        state = damping.decide(settings, state, Measurement(end_s, *means, gone(end_s)))
        seen.append((end_s, state))
    return seen


def started_s(seen: list[tuple[float, DampingState]]) -> float | None:
    return next((t for t, state in seen if state.active), None)


def test_growing_resonance_starts_it_150_ms_after_three_percent():
    seen = observe(current(lambda t: 0.01 * np.exp(4.0 * t)), 0.7)
    at_three_percent = np.log(3.0) / 4.0
    assert started_s(seen) == pytest.approx(at_three_percent + 0.15, abs=0.005)
    state = seen[-1][1]
    assert state.acts
    assert damping.output(SETTINGS, state) == Compensation(0.5 * R_OHM, 0.5 * 2.0 * pi * 77.0 * L_H)


def test_sustained_resonance_starts_it():
    """Once the resonance is seen the clock of 150 ms runs; it is seen at the latest when the window is full."""
    assert 0.15 < started_s(observe(current(lambda t: 0.05), 0.5)) <= 0.15 + WINDOW_S


def test_weak_resonance_does_not_start_it():
    assert started_s(observe(current(lambda t: 0.02), 1.0)) is None


def test_decaying_resonance_does_not_start_it():
    """Even where r stays above the threshold for longer than the delay."""
    seen = observe(current(lambda t: 0.2 * np.exp(-4.0 * t) if t > 0.1 else 0.0), 1.0)
    assert sum(state.resonance.ratio > 0.03 for _, state in seen) * 2e-3 > 0.2
    assert started_s(seen) is None


def test_low_voltage_blocks_it_and_zeroes_its_buffer():
    """40 ms at 0.2 pu: blocked once the mean over two periods is below 0.8 pu, judged again 150 ms after that."""

    def dip(t: float) -> complex:
        return (0.2 if 0.1 <= t < 0.14 else 1.0) * V_PU * np.exp(100j * pi * t)

    seen = observe(current(lambda t: 0.05), 0.6, v_pu=dip)
    blocked = [t for t, state in seen if state.blocked]
    assert blocked[0] == pytest.approx(0.11, abs=0.003)
    assert blocked[-1] == pytest.approx(0.17, abs=0.003)
    at_end = next(state for t, state in seen if t == blocked[-1])
    assert not np.any(at_end.currents)
    assert np.isnan(at_end.resonance.ratio)
    judged = next(t for t, state in seen if t > 0.17 and state.resonance.ratio > 0.03)
    assert judged == pytest.approx(blocked[-1] + 0.15, abs=1e-6)
    assert started_s(seen) == pytest.approx(judged + 0.15, abs=1e-6)


def test_active_control_pauses_while_blocked():
    def dip(t: float) -> complex:
        return (0.2 if 0.5 <= t < 0.54 else 1.0) * V_PU * np.exp(100j * pi * t)

    seen = observe(current(lambda t: 0.05), 0.7, v_pu=dip)
    for _, state in seen:
        if state.blocked:
            assert state.active
            assert damping.output(SETTINGS, state) == Compensation()
    assert any(state.blocked for _, state in seen)
    assert seen[-1][1].acts


def test_it_stops_when_the_cause_is_gone_and_stays_on_when_only_the_resonance_is():
    def r(t: float) -> float:
        return 0.05 if t < 0.5 else 0.0

    seen = observe(current(r), 1.0, gone=lambda t: t > 0.9)
    assert all(state.active for t, state in seen if 0.4 < t <= 0.9)
    assert not any(state.active for t, state in seen if t > 0.9)
    assert np.isnan(seen[-1][1].resonance_hz)


@pytest.mark.parametrize(("estimator", "within_hz"), [(damping.matrix_pencil, 0.01), (sliding_fft, 3.7)])
def test_without_preset_it_takes_the_estimate(estimator, within_hz):
    settings = DampingSettings(0.5, R_OHM, L_H, None, estimator=estimator)
    state = observe(current(lambda t: 0.05, 23.0), 0.4, settings)[-1][1]
    assert state.resonance_hz == pytest.approx(23.0, abs=within_hz)
    assert damping.output(settings, state).x_ohm > 0.0


def test_lost_numbers_block_it():
    seen = observe(current(lambda t: 0.05), 0.4, v_pu=lambda t: complex("nan") if t > 0.3 else V_PU)
    assert seen[-1][1].blocked


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"k": 10.1}, "k of the damping control is 10.1; needed: -10 to 10"),
        ({"threshold": -1.0}, "threshold"),
        ({"delay_s": -1.0}, "delay_s"),
    ],
)
def test_settings_are_refused_in_words(given, words):
    with pytest.raises(ValueError, match=words):
        DampingSettings(**{"k": 0.5, "r_ohm": 0.01, "l_h": 1e-3, "resonance_hz": 77.0, **given})
