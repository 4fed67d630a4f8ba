"""Frequency grids: every window exactly coherent, every refusal with its way out."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from seqsweep.sweep.excitation.frequencies import (
    GENERATED_SHIFT,
    LISTED_SHIFT,
    MAX_WINDOW_S,
    MIN_CYCLES,
    MIN_WINDOW_S,
    Frequency,
    GridError,
    coherent_block,
    generated,
    listed,
)

F1_HZ, DT_S = 50.0, 50e-6


def assert_coherent(point: Frequency, f1_hz: float, dt_s: float) -> None:
    """In rational numbers: the window is whole steps and holds whole periods of f, of f1 and of the mirror."""
    block = coherent_block(f1_hz, dt_s)
    f1 = Fraction(f1_hz).limit_denominator(10**6)
    window_s = point.window_blocks * Fraction(block.periods) / f1
    step_s = window_s / (point.window_blocks * block.steps)
    assert float(step_s) == pytest.approx(dt_s, rel=1e-12)  # whole steps of the plant's own length
    f = Fraction(point.n_periods) / window_s
    assert float(f) == pytest.approx(point.f_hz, rel=1e-9)  # whole periods of the line
    assert (f1 * window_s).denominator == 1  # of the fundamental
    assert ((2 * f1 - f) * window_s).denominator == 1  # and so of the mirror


def assert_long_enough(point: Frequency, f1_hz: float, dt_s: float) -> None:
    window_s = point.window_blocks * coherent_block(f1_hz, dt_s).duration_s
    assert window_s >= MIN_WINDOW_S - 1e-9
    assert window_s * abs(point.f_hz - f1_hz) >= MIN_CYCLES - 1e-6


# Generated grids


@settings(deadline=None, max_examples=40)
@given(
    f_min_hz=st.floats(0.2, 40.0),
    decades=st.floats(0.3, 3.0),
    points=st.integers(2, 40),
    spacing=st.sampled_from(["log", "linear"]),
    plant=st.sampled_from([(50.0, 50e-6), (60.0, 1 / 18_000), (50.0, 25e-6), (16.7, 1 / 16_700), (60.0, 50e-6)]),
)
def test_generated_points_are_coherent_increasing_and_never_f1(f_min_hz, decades, points, spacing, plant):
    f1_hz, dt_s = plant
    f_max_hz = min(f_min_hz * 10.0**decades, 3000.0)
    try:
        grid = generated(f_min_hz, f_max_hz, points, spacing, f1_hz, dt_s)
    except GridError as refusal:  # an end or a middle may fall on f1 exactly; a narrow band may have nothing
        assume("fundamental" not in str(refusal) and "no usable frequency" not in str(refusal))
        raise
    assert 1 <= len(grid) <= points
    assert all(a.f_hz < b.f_hz for a, b in pairwise(grid))
    for point in grid:
        assert_coherent(point, f1_hz, dt_s)
        assert_long_enough(point, f1_hz, dt_s)
        assert abs(point.f_hz - f1_hz) > 1e-6


@pytest.mark.parametrize("spacing", ["log", "linear"])
def test_a_usual_grid_keeps_its_ends_its_number_and_its_places(spacing):
    grid = generated(1.0, 1000.0, 100, spacing, F1_HZ, DT_S)
    space = np.geomspace if spacing == "log" else np.linspace
    wanted = space(1.0, 1000.0, 100)
    assert len(grid) == 100
    assert (grid[0].f_hz, grid[-1].f_hz) == (1.0, 1000.0)
    moved = np.abs([point.f_hz for point in grid] - wanted)
    room = np.minimum(np.diff(wanted, prepend=-np.inf), np.diff(wanted, append=np.inf))
    assert np.all(moved <= GENERATED_SHIFT * room + 1e-9)


def test_a_grid_finer_than_the_windows_can_tell_apart_is_thinned_not_doubled():
    grid = generated(10.0, 11.0, 200, "linear", F1_HZ, DT_S)
    f_hz = [point.f_hz for point in grid]
    assert len(set(f_hz)) == len(f_hz) < 200
    for point in grid:
        assert_coherent(point, F1_HZ, DT_S)


# Listed frequencies


def test_listed_frequencies_that_fit_stay_to_the_last_bit():
    f_hz = [0.5, 7.3, 23.0, 49.9, 75.5, 100.0, 333.3, 1000.0]
    points, warnings = listed(f_hz, F1_HZ, DT_S)
    assert [point.f_hz for point in points] == f_hz
    assert warnings == []
    for point in points:
        assert_coherent(point, F1_HZ, DT_S)
        assert_long_enough(point, F1_HZ, DT_S)


@settings(deadline=None, max_examples=60)
@given(st.floats(60.0, 3000.0))
def test_a_listed_frequency_moves_by_a_thousandth_at_most_and_says_so(f_hz):
    (point,), warnings = listed([f_hz], F1_HZ, DT_S)
    assert abs(point.f_hz - f_hz) <= LISTED_SHIFT * f_hz * (1 + 1e-9)
    assert_coherent(point, F1_HZ, DT_S)
    assert len(warnings) == (point.f_hz != f_hz)
    assert all("moved to" in warning for warning in warnings)


def test_the_warning_names_both_frequencies():
    (point,), (warning,) = listed([77.7123], F1_HZ, DT_S)
    assert warning.startswith("77.7123 Hz moved to ")
    assert f"{point.f_hz:.9g} Hz" in warning


def test_a_frequency_that_no_window_can_hold_is_refused_with_those_that_can():
    with pytest.raises(GridError, match=r"0\.123 Hz: no window of up to 10 s .* usable are multiples of 0\.1 Hz"):
        listed([0.123], F1_HZ, DT_S)


def test_two_frequencies_that_would_become_one_are_refused():
    with pytest.raises(GridError, match="moved to the same value"):
        listed([777.0011, 777.0012], F1_HZ, DT_S)


# f1, its double, Nyquist


@pytest.mark.parametrize(("f1_hz", "dt_s"), [(50.0, 50e-6), (60.0, 1 / 18_000)])
def test_f1_itself_is_refused_with_the_reason_and_its_double_is_welcome(f1_hz, dt_s):
    with pytest.raises(GridError, match="is the fundamental itself: the perturbation cannot be told") as refusal:
        listed([10.0, f1_hz], f1_hz, dt_s)
    assert f"{f1_hz - 1:g} or {f1_hz + 1:g} Hz" in str(refusal.value)
    with pytest.raises(GridError, match="is the fundamental itself"):
        generated(f1_hz - 10.0, f1_hz + 10.0, 21, "linear", f1_hz, dt_s)
    (double,), warnings = listed([2.0 * f1_hz], f1_hz, dt_s)
    assert double.f_hz == 2.0 * f1_hz
    assert not warnings
    assert_coherent(double, f1_hz, dt_s)


def test_line_and_mirror_must_both_be_below_nyquist():
    with pytest.raises(GridError, match="Nyquist frequency of 10000 Hz"):
        listed([10_000.0], F1_HZ, DT_S)
    assert listed([9999.0], F1_HZ, DT_S)[0][0].f_hz == 9999.0
    # A mirror at -9999 Hz belongs to 10099 Hz; with a slow step the mirror of a low line is the higher one.
    with pytest.raises(GridError, match="and its mirror at 99 Hz must be below the Nyquist frequency of 80 Hz"):
        listed([1.0], F1_HZ, 1 / 160)


# Steps


@pytest.mark.parametrize(
    ("f1_hz", "dt_s", "steps", "periods"),
    [(50.0, 50e-6, 400, 1), (60.0, 50e-6, 1000, 3), (50.0, 70e-6, 2000, 7), (50.0, 1e-4, 200, 1)],
)
def test_a_block_is_the_shortest_stretch_of_whole_periods_in_whole_steps(f1_hz, dt_s, steps, periods):
    block = coherent_block(f1_hz, dt_s)
    assert (block.steps, block.periods) == (steps, periods)
    assert block.duration_s == pytest.approx(steps * dt_s, rel=1e-12)


@pytest.mark.parametrize(("f1_hz", "dt_s"), [(50.0, 50e-6 * (1 + 1e-7)), (50.0, 2**0.5 * 1e-4), (49.9871, 1e-4)])
def test_an_awkward_step_is_refused_with_one_that_works(f1_hz, dt_s):
    with pytest.raises(GridError, match="use a step such as") as refusal:
        coherent_block(f1_hz, dt_s)
    suggested = float(str(refusal.value).rsplit(" ", 2)[-2])
    assert suggested == pytest.approx(dt_s, rel=0.01)
    coherent_block(f1_hz, suggested)  # typed in as printed, it is taken


def test_no_window_is_longer_than_its_limit_unless_f_is_close_to_f1():
    for point in generated(0.5, 1000.0, 60, "log", F1_HZ, DT_S):
        window_s = point.window_blocks * 0.02
        assert window_s <= MAX_WINDOW_S + MIN_CYCLES / abs(point.f_hz - F1_HZ)
