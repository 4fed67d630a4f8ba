"""Facts of an operating point besides Y: what a shot that comes to rest proves, the fundamental, and statements."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.operating_state import StatementError, fundamental_facts, stated, with_statement
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.settling import EXCITED, first_agreement, growth_bound, shown_by, steady_mean

W_TONE = 2.0 * np.pi * 20.0


def heard(pole, share, window_s, n_windows):
    """Phasors (n_windows, 2) of a steady response of 1 and a mode ``share * exp(pole t)``, window by window."""
    z = pole - 1j * W_TONE
    k = np.arange(n_windows)
    mode = share * (np.exp(z * window_s) - 1.0) / (z * window_s) * np.exp(z * window_s * k)
    return np.stack([1.0 + mode, np.zeros_like(mode)], axis=1)


def test_a_mode_that_the_windows_did_not_show_grows_no_faster_than_the_bound():
    """Closed form: modes of any frequency and growth, set going with the share `EXCITED`; where windows agree all the
    same within what they agree to, the bound must hold. Random modes, those near the bound among them."""
    rng = np.random.default_rng(1)
    tight = []
    for _ in range(4000):
        window_s, n_windows = rng.uniform(0.3, 3.0), int(rng.integers(2, 9))
        farthest = 2.0 * np.pi * 10.0 ** rng.uniform(1.5, 3.5)
        growth = rng.uniform(0.1, 30.0) / (n_windows * window_s)
        pole = growth + 1j * (W_TONE + rng.uniform(-1.0, 1.0) * np.sqrt(max(farthest**2 - growth**2, 0.0)))
        i = heard(pole, EXCITED * np.exp(2j * np.pi * rng.random()), window_s, n_windows)[-2:]
        agreement = first_agreement(np.ones_like(i), i, 0.0).residual
        tight.append(growth / growth_bound(agreement, window_s, n_windows * window_s, farthest))
    assert max(tight) <= 1.0 + 1e-6
    assert np.percentile(tight, 90) > 0.7  # and it is no idle bound


def test_a_shot_says_more_the_longer_it_lasts_and_the_better_it_agrees():
    assert growth_bound(1e-6, 1.0, 4.0, 6e3) < growth_bound(1e-6, 1.0, 2.0, 6e3) < growth_bound(1e-4, 1.0, 2.0, 6e3)
    assert growth_bound(0.0, 1.0, 2.0, 6e3) == pytest.approx(np.log(2.0))  # modes slower than a window stay open


def test_a_noisy_shot_is_judged_by_the_halves_of_what_counts():
    rng = np.random.default_rng(2)
    i = 1.0 + 1e-3 * (rng.normal(size=(24, 2)) + 1j * rng.normal(size=(24, 2)))
    shot = steady_mean(np.ones((24, 2), complex), i, 0.01)
    agreement, stretch_s = shown_by(shot, 0.5)
    halves = i[-len(shot.v) :]
    middle = len(halves) // 2
    apart = np.linalg.norm(halves[middle:].mean(axis=0) - halves[:middle].mean(axis=0)) / np.sqrt(2.0)
    assert agreement > apart
    assert stretch_s == pytest.approx(0.25 * len(shot.v))


def test_the_fundamental_has_the_signs_of_the_load_direction():
    """R-L load: takes P and Q > 0, the current lags; turned round, a generator has P < 0."""
    v = 563.4 * np.exp(0.3j)
    i = v / (3.0 + 4.0j)
    found = fundamental_facts(v, i)
    power = 1.5 * abs(v) ** 2 / 25.0
    assert found["active_power_into_device_w"] == pytest.approx(power * 3.0)
    assert found["reactive_power_into_device_var"] == pytest.approx(power * 4.0)
    assert found["voltage_v"] == pytest.approx(563.4 * np.sqrt(1.5))
    assert found["angle_rad"] == pytest.approx(0.3)
    assert found["current_a"] == pytest.approx(563.4 / 5.0 / np.sqrt(2.0))
    assert found["current_angle_rad"] == pytest.approx(-np.arctan2(4.0, 3.0))
    assert fundamental_facts(v, -i)["active_power_into_device_w"] == pytest.approx(-power * 3.0)


@pytest.mark.parametrize("text", ["0.012+0.25j", "0.012 + j0.25", "0.012+0.25i"])
def test_a_grid_is_stated_as_everywhere(text):
    assert stated(text) == {"grid": {"r_ohm": 0.012, "x_ohm": 0.25}, "basis": "stated"}
    assert stated(" Ideal ")["grid"] == "ideal"


@pytest.mark.parametrize("text", ["", "weak", "0", "-0.1+0.2j", "nan", "0.1-0.2j", "inf"])
def test_a_statement_that_makes_no_sense_is_refused_with_the_way_out(text):
    with pytest.raises(StatementError, match=r"as ideal or as R\+jX in ohm"):
        stated(text)


def test_what_was_proven_is_not_replaced_by_the_same_statement():
    proof = {"grid": "ideal", "basis": "shots", "growth_bound_per_s": 0.8, "disturbed_s": 15.0}
    y = np.ones((1, 2, 2), complex)
    response = FrequencyResponse(np.array([20.0]), y, 50.0, meta={"op_id": "a", "stable_on": proof})
    assert with_statement(response, stated("ideal")).meta["stable_on"] == proof
    assert with_statement(response, stated("0.1j")).meta["stable_on"] == stated("0.1j")
