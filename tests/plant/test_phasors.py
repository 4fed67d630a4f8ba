"""From samples to a 2x2 admittance: windows, block sums, the solve and the frames, each against a slow twin."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from seqsweep.identify.admittance import solve_pn
from seqsweep.identify.fourier import block_phasors, harmonics, line, periodic_window, rotation, taper
from seqsweep.identify.frames import dq_to_pn, pn_to_dq, to_frame
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.settling import COND_LIMIT, first_agreement, period_change, windows
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Phasors, Record, Source, Tone, Window
from seqsweep.plant.registry import make_plant

DT_S, F1_HZ, STEPS = 50e-6, 50.0, 400
RNG = np.random.default_rng(3)


def complex_normal(*shape):
    return RNG.normal(size=shape) + 1j * RNG.normal(size=shape)


# Windows


def test_a_whole_window_has_mean_one_and_parts_join_to_it():
    whole = taper(1200)
    assert np.mean(whole) == pytest.approx(1.0, abs=1e-14)
    parts = np.concatenate([taper(1200, first, 300) for first in (0, 300, 600, 900)])
    assert np.array_equal(parts, whole)
    assert np.array_equal(taper(1200, 1200, 300), whole[:300])  # the next window begins anew


def test_a_tapered_window_is_deaf_to_lines_three_bins_away():
    n = 1000
    heard = [abs(np.mean(taper(n) * rotation(-k / (n * DT_S), 0.0, DT_S, n))) for k in range(6)]
    assert heard[0] == pytest.approx(1.0, abs=1e-14)
    assert heard[1] == pytest.approx(0.25 / 0.42, abs=1e-14)
    assert heard[2] == pytest.approx(0.04 / 0.42, abs=1e-14)
    assert max(heard[3:]) <= 1e-14


def test_the_rotation_does_not_tire_after_a_day():
    """exp of a large angle loses digits; whole turns taken off first, a coherent window a day on is the same."""
    early, late = (rotation(370.0, t0, DT_S, 400) for t0 in (0.0, 86_400.0))
    # 370 Hz * 86400 s = 3.2e7 turns, of which a double keeps 4e-9.
    assert np.max(np.abs(late - early)) <= 1e-7


def test_the_phasor_of_a_line_is_its_amplitude_and_its_phase_at_time_zero():
    t0_s = 7 * STEPS * DT_S
    t = t0_s + DT_S * np.arange(STEPS)
    x = 3.0 * np.exp(1j * (2 * pi * 50.0 * t + 0.7)) + 2.0 * np.exp(1j * (-2 * pi * 150.0 * t - 1.1))
    assert line(x, 50.0, t0_s, DT_S) == pytest.approx(3.0 * np.exp(0.7j), abs=1e-13)
    assert line(x, -150.0, t0_s, DT_S) == pytest.approx(2.0 * np.exp(-1.1j), abs=1e-13)
    assert abs(line(x, 150.0, t0_s, DT_S)) <= 1e-13


# Block sums


@pytest.mark.parametrize("plant_id", ["branch-v1", "dpmsg-v1"])
@pytest.mark.parametrize("f_hz", [1.0, 60.0, 370.0, -30.0])
def test_the_plants_accumulated_phasors_are_those_of_its_record(plant_id, f_hz):
    """The kernels turn phasors step by step; the twin evaluates every exponential. 1e-10 of 1e4 roundings."""
    plant = make_plant(plant_id)
    state = plant.settle(OperatingPoint(0.65e6, 690.0), Source(angle_rad=0.4))
    job = Job(state, Injection("series_voltage", (Tone(f_hz, 5.0, 0.3),)))
    ((state, _),) = plant.run([job], 3 * STEPS)  # somewhere in mid-flight
    job, window = Job(state, job.injection), Window(f_hz, 10, 3)
    ((_, accumulated),) = plant.run_phasors([job], [window], STEPS, 20)
    ((_, record),) = plant.run([job], 20 * STEPS)
    twin = block_phasors(record, window, STEPS)
    for fast, slow in ((accumulated.v, twin.v), (accumulated.i, twin.i)):
        assert np.max(np.abs(fast - slow)) <= 1e-10 * np.max(np.abs(slow))


def test_block_sums_of_a_whole_window_are_its_phasor():
    t = DT_S * np.arange(10 * STEPS)
    v = (2 + 1j) * np.exp(2j * pi * 75.0 * t) + (0.5 - 1j) * np.exp(2j * pi * 25.0 * t)
    record = Record(0.0, DT_S, v, 2j * v, F1_HZ)
    v_lines, i_lines = windows(block_phasors(record, Window(75.0, 10), STEPS), 10)
    assert v_lines == pytest.approx(np.array([[2 + 1j, 0.5 - 1j]]), abs=1e-13)
    assert i_lines == pytest.approx(2j * v_lines, abs=1e-13)


def test_a_record_that_does_not_hold_whole_blocks_is_refused():
    record = Record(0.0, DT_S, np.zeros(401, complex), np.zeros(401, complex), F1_HZ)
    with pytest.raises(ValueError, match="401 samples; whole blocks of 400"):
        block_phasors(record, Window(75.0, 1), STEPS)


def test_an_incomplete_window_is_not_heard():
    blocks = complex_normal(7, 2)
    v, _ = windows(Phasors(blocks, blocks), 3)
    assert v == pytest.approx(np.array([blocks[:3].sum(0), blocks[3:6].sum(0)]))


# The baseline


@settings(deadline=None, max_examples=60)
@given(
    n_cycles=st.integers(-60, 60),
    n_blocks=st.integers(1, 12),
    t0_blocks=st.integers(0, 1000),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_a_window_hears_of_a_periodic_signal_is_known_without_listening(n_cycles, n_blocks, t0_blocks, seed):
    """Against brute force: repeat the block, weigh it, demodulate it."""
    n, rng = 64, np.random.default_rng(seed)
    block = rng.normal(size=n) + 1j * rng.normal(size=n)
    dt_s = 0.02 / n
    t0_s = t0_blocks * 0.02
    lines = harmonics(block, t0_s, dt_s)
    lines[n // 2] = 0.0  # Nyquist: neither +n/2 nor -n/2, the prediction leaves it out
    block = np.fft.ifft(lines * n * np.exp(2j * pi * ((np.fft.fftfreq(n, 1 / n) * (t0_s / (n * dt_s))) % 1.0)))
    length = n_blocks * n
    f_hz = n_cycles / (length * dt_s)
    brute = np.mean(np.tile(block, n_blocks) * taper(length) * rotation(f_hz, t0_s, dt_s, length))
    # n_cycles beyond the block's harmonics alias in the brute force; the grid keeps lines below Nyquist.
    if abs(n_cycles) + 2 < n // 2 * n_blocks:
        assert abs(periodic_window(lines, n_cycles, n_blocks, t0_blocks / n_blocks) - brute) <= 1e-11


# The solve


def synthetic(y, phi1, v_pn):
    """Phasors (experiment, line) of a device with Y whose fundamental stands at ``phi1``."""
    i_pn = y @ v_pn
    turn = np.array([[1.0], [np.exp(2j * phi1)]])

    def lines(x):  # undo: the second component is conj X(2 f1 - f) exp(2j phi1)
        return np.stack([x[0], np.conj(x[1] / turn[1])], axis=1)

    return lines(v_pn), lines(i_pn)


@settings(deadline=None)
@given(phi1=st.floats(-pi, pi), seed=st.integers(0, 2**32 - 1))
def test_any_admittance_is_recovered_from_any_two_independent_experiments(phi1, seed):
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2))
    v_pn = rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2))
    found, cond_v = solve_pn(*synthetic(y, phi1, v_pn), phi1)
    assert np.max(np.abs(found - y)) <= 1e-14 * 10 * cond_v * np.linalg.norm(y)


def test_leaving_out_the_angle_of_the_fundamental_turns_the_coupling():
    """What solve_pn's third argument is for: Ypn and Ynp turn by 2 phi1, here by more than their size."""
    y = np.array([[1.0, 0.5], [0.5, 1.0]], complex)
    v, i = synthetic(y, 0.6, np.eye(2) + 0.1)
    right, wrong = solve_pn(v, i, 0.6)[0], solve_pn(v, i, 0.0)[0]
    assert right == pytest.approx(y)
    assert wrong[0, 1] == pytest.approx(y[0, 1] * np.exp(1.2j))
    assert wrong[1, 0] == pytest.approx(y[1, 0] * np.exp(-1.2j))
    assert abs(wrong[0, 1] - y[0, 1]) > 0.5 * abs(y[0, 1])


def test_the_scale_of_an_experiment_does_not_look_like_dependence():
    """A shot of a thousandth of the voltage is as good as any; cond(V) compares directions."""
    y = complex_normal(2, 2)
    v_pn = np.array([[1.0, 1e-3], [0.2, 2e-3]], complex)
    equal, unequal = (solve_pn(*synthetic(y, 0.0, v_pn * s), 0.0)[1] for s in ([1.0, 1e3], [1.0, 1.0]))
    assert equal == pytest.approx(unequal, rel=1e-12)


def test_two_experiments_that_are_one_are_told_by_their_condition():
    same = np.array([[1.0, 1.0 + 1e-9], [0.5, 0.5]], complex)
    _, cond_v = solve_pn(*synthetic(complex_normal(2, 2), 0.0, same), 0.0)
    assert cond_v > COND_LIMIT
    exactly = np.array([[1.0, 1.0], [0.5, 0.5]], complex)
    with pytest.raises(np.linalg.LinAlgError):
        solve_pn(*synthetic(complex_normal(2, 2), 0.0, exactly), 0.0)


def test_an_experiment_without_voltage_is_refused_in_words():
    with pytest.raises(np.linalg.LinAlgError, match="no voltage"):
        solve_pn(np.array([[1.0, 0.5], [0.0, 0.0]]), np.ones((2, 2)), 0.0)


# Frames

FINITE = st.complex_numbers(max_magnitude=1e6, allow_nan=False, allow_infinity=False)


@given(arrays(complex, (3, 2, 2), elements=FINITE))
def test_there_and_back_between_frames_changes_nothing(y):
    size = np.max(np.abs(y)) + 1.0
    assert np.max(np.abs(dq_to_pn(pn_to_dq(y)) - y)) <= 1e-14 * size
    assert np.max(np.abs(pn_to_dq(dq_to_pn(y)) - y)) <= 1e-14 * size


@given(arrays(float, (2, 2), elements=st.floats(-1e6, 1e6)))
def test_a_real_dq_admittance_obeys_the_mirror_identity_at_f1(y_dq):
    """At f = f1 mirror and line coincide: Ynn = conj Ypp and Ynp = conj Ypn there, for Y_dq(0) is real."""
    y = dq_to_pn(y_dq.astype(complex))
    size = np.max(np.abs(y_dq)) + 1.0
    assert abs(y[1, 1] - np.conj(y[0, 0])) <= 1e-14 * size
    assert abs(y[1, 0] - np.conj(y[0, 1])) <= 1e-14 * size


def test_a_symmetric_dq_admittance_has_no_coupling():
    y = dq_to_pn(np.array([[1.0, -2.0], [2.0, 1.0]], complex))
    assert y == pytest.approx(np.array([[1.0 + 2.0j, 0.0], [0.0, 1.0 - 2.0j]]))


def test_a_response_changes_frame_with_its_frequencies_and_an_unknown_frame_is_refused():
    response = FrequencyResponse(np.array([10.0, 60.0]), complex_normal(2, 2, 2), F1_HZ)
    dq = to_frame(response, "dq")
    assert dq.f_hz.tolist() == [-40.0, 10.0]
    assert np.max(np.abs(to_frame(dq, "pn").y - response.y)) <= 1e-14
    assert to_frame(response, "pn") is response
    with pytest.raises(ValueError, match="known: 'pn', 'dq'"):
        to_frame(response, "abc")


# When a shot is over


def test_the_first_window_that_agrees_with_the_one_before_ends_a_shot():
    decaying = np.array([[1.0 + 0.1 * 10.0**-k] * 2 for k in range(8)], complex)
    found = first_agreement(decaying, decaying, 1e-3)
    assert found.window == 3  # 1.01 to 1.001: 9e-3; 1.001 to 1.0001: 9e-4
    assert found.agreed
    assert found.residual == pytest.approx(9e-4, rel=2e-3)
    later = first_agreement(decaying[:3], decaying[:3], 1e-9)
    assert (later.window, later.agreed) == (2, False)


def test_v_and_i_must_both_agree():
    still, moving = np.ones((4, 2), complex), np.array([[1.0 + k] * 2 for k in range(4)], complex)
    assert not first_agreement(still, moving, 1e-3).agreed
    assert not first_agreement(moving, still, 1e-3).agreed


def test_nan_never_agrees_and_no_current_at_all_does():
    """An open terminal has the admittance zero, and is entitled to it."""
    ones = np.ones((3, 2), complex)
    assert not first_agreement(ones, ones * np.nan, 1.0).agreed
    assert not first_agreement(ones * np.nan, ones, 1.0).agreed
    assert first_agreement(ones, np.zeros((3, 2), complex), 1e-9).agreed
    assert not first_agreement(ones, np.array([[1.0] * 2, [0.0] * 2]), 1e-9).agreed


def test_the_growth_from_window_to_window_is_told():
    growing = np.array([[2.0**k] * 2 for k in range(4)], complex)
    assert first_agreement(growing, growing, 1e-6).growth == pytest.approx(2.0)


def test_a_change_over_one_period_is_relative_to_the_peak():
    assert period_change(np.array([3.0, 4.0j, 3.0, 4.04j])) == pytest.approx(0.04 / 4.04)
