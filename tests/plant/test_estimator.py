"""Resonance beside the fundamental: the estimators' errors on synthetic records."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.plant.damping.estimator import NO_RESONANCE, block_means, matrix_pencil, sliding_fft

FAR_HZ = (18.0, 23.0, 30.0, 38.0, 62.0, 70.0, 77.0, 80.0)
GROWTH_PER_S = 2.0


def synthetic(
    f_r_hz: float, generator: np.random.Generator, amplitude: float = 0.05, noise: float = 1e-3, f1_hz: float = 50.0
) -> np.ndarray:
    """150 ms at 10 kHz, block means at 500 Hz: fundamental 1, a pair that grows, 5th and 7th harmonic, noise.

    ``amplitude`` is the stronger component's at the end of the window; its mirror has half of it.
    """
    t = np.arange(1500) / 10e3
    phase = np.exp(2j * np.pi * generator.uniform(size=5))
    pair = phase[1] * np.exp(2j * np.pi * f_r_hz * t) + 0.5 * phase[2] * np.exp(2j * np.pi * (2 * f1_hz - f_r_hz) * t)
    x = phase[0] * np.exp(2j * np.pi * f1_hz * t) + amplitude * np.exp(GROWTH_PER_S * (t - 0.15)) * pair
    x += 0.01 * phase[3] * np.exp(-10j * np.pi * f1_hz * t) + 0.007 * phase[4] * np.exp(14j * np.pi * f1_hz * t)
    return block_means(x + noise * (generator.normal(size=t.size) + 1j * generator.normal(size=t.size)), 20)


def trials(f_hz, n: int, **conditions) -> list[tuple[float, object]]:
    generator = np.random.default_rng(1)
    return [(f, matrix_pencil(synthetic(f, generator, **conditions))) for f in f_hz for _ in range(n)]


def errors_p95(f_hz, n: int, **conditions) -> np.ndarray:
    """95th percentiles: frequency (Hz), A_r (relative), growth (1/s), A_0."""
    amplitude = conditions.get("amplitude", 0.05)
    error = [
        (found.f_hz - f, found.amplitude / amplitude - 1.0, found.growth_per_s - GROWTH_PER_S, found.fundamental - 1.0)
        for f, found in trials(f_hz, n, **conditions)
    ]
    return np.quantile(np.abs(error), 0.95, axis=0)


@pytest.mark.parametrize(
    ("conditions", "f_error_hz"),
    [({}, 0.006), ({"amplitude": 0.01}, 0.03), ({"f1_hz": 49.9}, 0.006)],
)
def test_pencil_finds_signed_frequency_amplitude_and_growth(conditions, f_error_hz):
    """Bars of the methods page, at least 12 Hz from the fundamental. A_r follows noise / (A_r sqrt(n))."""
    f, amplitude, growth, fundamental = errors_p95(FAR_HZ, 12, **conditions)
    assert f < f_error_hz
    assert amplitude < 0.5 * f_error_hz
    assert growth < 8.0 * f_error_hz
    assert fundamental < 3e-4


def test_pencil_five_hertz_from_the_fundamental_is_within_a_tenth_of_a_hertz():
    assert errors_p95((45.0, 55.0), 25)[0] < 0.1


@pytest.mark.evidence
@pytest.mark.parametrize(("conditions", "f_error_hz"), [({}, 0.006), ({"amplitude": 0.01}, 0.03)])
def test_pencil_in_full(conditions, f_error_hz):
    f_hz = np.concatenate([np.arange(15.0, 39.0), np.arange(62.0, 86.0)])
    found = errors_p95(f_hz, 200, **conditions)
    print(f"\n{conditions}: p95 of f {found[0]:.4f} Hz, A_r {found[1]:.4f}, growth {found[2]:.3f} 1/s")
    assert found[0] < f_error_hz


@pytest.mark.parametrize("f_r_hz", FAR_HZ)
def test_stronger_component_is_told_from_its_mirror(f_r_hz):
    """The mirror has half the amplitude and lies on the other side."""
    x = synthetic(f_r_hz, np.random.default_rng(5))
    found = matrix_pencil(x)
    assert abs(found.f_hz - f_r_hz) < 0.03
    assert found.mirror == pytest.approx(0.5 * found.amplitude, rel=0.03)
    if abs(f_r_hz - 50.0) > 15.0:  # Hann's main lobe
        line = sliding_fft(x)
        assert abs(line.f_hz - f_r_hz) < 3.7  # half a line
        assert line.mirror == pytest.approx(0.5 * line.amplitude, rel=0.1)


def test_fft_amplitude_is_the_mean_over_the_window_less_scalloping():
    """On a line 7 / 0.14 s from the fundamental; Hann loses at most 15 % between lines."""
    found = sliding_fft(synthetic(50.0 + 4 / 0.14, np.random.default_rng(2)))
    assert found.f_hz == pytest.approx(50.0 + 4 / 0.14)
    assert found.amplitude == pytest.approx(0.05 * np.exp(-GROWTH_PER_S * 0.07), rel=0.02)
    assert found.fundamental == pytest.approx(1.0, rel=1e-3)
    assert found.growth_per_s == pytest.approx(GROWTH_PER_S, abs=0.5)


@pytest.mark.parametrize("estimate", [matrix_pencil, sliding_fft])
def test_pure_fundamental_has_no_resonance(estimate):
    x = np.exp(0.2j * np.pi * np.arange(75))
    found = estimate(x)
    assert np.isnan(found.f_hz)
    assert found.ratio == 0.0
    assert found.fundamental == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("estimate", [matrix_pencil, sliding_fft])
def test_what_cannot_be_judged_is_said_to_be_nothing(estimate):
    broken = np.ones(75, complex)
    broken[3] = np.nan
    assert estimate(broken) is NO_RESONANCE
    assert np.isnan(NO_RESONANCE.ratio)
    silent = estimate(np.zeros(75, complex))
    assert np.isnan(silent.ratio)
    with pytest.raises(ValueError, match=r"needed|needs"):
        estimate(np.ones(20, complex))


def test_direct_current_is_not_a_resonance():
    """A decaying direct current, as every switching leaves it, has f = 0."""
    t = 2e-3 * np.arange(75)
    found = matrix_pencil(np.exp(100j * np.pi * t) + 0.3 * np.exp(-20.0 * t))
    assert np.isnan(found.f_hz)


def test_block_means_leave_out_the_oldest_samples():
    np.testing.assert_array_equal(block_means(np.arange(7.0), 3), [2.0, 5.0])
