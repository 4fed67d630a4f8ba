"""Broadband signals: closed forms of their spectra, their tones, their peaks, their refusals."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from seqsweep.identify.admittance import solve_pn
from seqsweep.identify.fourier import line
from seqsweep.plant.protocol import Tone
from seqsweep.sweep.excitation.binary_sequences import (
    inverse_repeat,
    is_residue_length,
    maximum_length,
    quadratic_residue,
)
from seqsweep.sweep.excitation.crest_factor import low_crest_phases
from seqsweep.sweep.excitation.odd_lines import SignalError, detection_lines, odd_lines
from seqsweep.sweep.excitation.signals import (
    Signal,
    chirp,
    coherent_blocks,
    multisine,
    negated,
    prbs,
    qrb,
    register_order,
    require_amplitude,
    residue_length,
    tones,
    wave,
)

from ..support.commands import least_cpu_s

F1_HZ, DT_S = 50.0, 50e-6
LOG_POINTS = np.geomspace(1.0, 1000.0, 100)


def space_vector(played: tuple[Tone, ...], t: np.ndarray) -> np.ndarray:
    """The tones, summed one by one as their definition says."""
    u = np.zeros(len(t), complex)
    for tone in played:
        u += tone.amplitude * np.exp(1j * (2.0 * np.pi * tone.f_hz * t + tone.phase_rad))
    return u


def each_kind() -> list[Signal]:
    return [
        multisine(np.array([1, 3, 9, 27, 81, 243]), 0.5),
        prbs(9, 511 / 0.5, (2.0, 400.0)),
        prbs(8, 510 / 0.5, (2.0, 400.0), odd=True),
        qrb(499, 499 / 0.5, (2.0, 400.0)),
        chirp(0.5, (2.0, 400.0)),
        chirp(0.5, (2.0, 400.0), "log", odd=True),
    ]


# From the real signal to its tones


@pytest.mark.parametrize("signal", each_kind(), ids=lambda signal: signal.kind)
def test_the_tones_add_up_to_the_real_signal_on_its_axis(signal):
    t = np.arange(0.0, 0.013, 37e-6)
    b = wave(signal, t)
    for axis, turn in (("d", 1.0), ("q", 1j)):
        u = space_vector(tones(signal, axis, F1_HZ, 7.0, 0.3), t)
        expected = 7.0 * b * np.exp(1j * (2.0 * np.pi * F1_HZ * t + 0.3)) * turn
        assert np.max(np.abs(u - expected)) < 7.0 * 1e-10  # sums of up to 800 tones in double precision


@pytest.mark.parametrize("signal", each_kind(), ids=lambda signal: signal.kind)
def test_the_peak_is_one_and_the_crest_factor_is_that_of_the_samples(signal):
    """A grid of its own, finer than the one the peak was made one on."""
    t = np.arange(60_000) * (signal.period_s / 60_000)
    parts = [wave(signal, part) for part in np.split(t, 60)]
    b = np.concatenate(parts)
    assert 1.0 - 1e-6 < np.max(np.abs(b)) < 1.002  # between two of 32 samples per period a peak hides 1 - cos(pi/32)
    assert signal.crest == pytest.approx(1.0 / np.sqrt(np.mean(b**2)), rel=1e-9)  # Parseval


def test_two_axes_are_independent_at_every_line_and_give_the_admittance():
    """Phasors of the played tones, taken from samples: cond(V) is one, and a known 2x2 comes back."""
    signal, angle = multisine(np.array([1, 5, 7, 33, 95]), 0.2), 1.1
    t = np.arange(4000) * DT_S
    y = np.array([[0.3 - 1.0j, 0.2 + 0.1j], [-0.4j, 0.5 + 0.6j]])
    played = [space_vector(tones(signal, axis, F1_HZ, 2.0, angle), t) for axis in ("d", "q")]
    for nu in signal.nu_hz:
        v = np.array([[line(u, F1_HZ + sign * nu, 0.0, DT_S) for sign in (1, -1)] for u in played])
        pn = np.array([v[:, 0], np.conj(v[:, 1]) * np.exp(2j * angle)])
        i_pn = y @ pn
        i = np.stack([i_pn[0], np.conj(i_pn[1] * np.exp(-2j * angle))], 1)
        found, cond_v = solve_pn(v, i, angle)
        assert cond_v == pytest.approx(1.0, abs=1e-9)
        assert found == pytest.approx(y, abs=1e-9)


def test_a_negated_signal_is_the_same_upside_down():
    signal = multisine(np.array([1, 3, 5]), 0.2)
    t = np.linspace(0.0, 0.2, 50)
    assert wave(negated(signal), t) == pytest.approx(-wave(signal, t), abs=1e-14)


# Multisines


@pytest.mark.parametrize(
    ("cycles", "highest_crest"),
    [
        (np.arange(1, 200, 2), 1.46),  # a hundred neighbours
        (np.arange(1, 2000, 2), 1.50),
        (odd_lines(LOG_POINTS - F1_HZ, 1.0).played, 1.85),  # 83 lines to 949 Hz
        (odd_lines(LOG_POINTS - F1_HZ, 2.0).played, 2.00),
        (np.unique(2 * np.round(np.geomspace(1, 1900, 30) / 2).astype(int) + 1), 2.43),  # 26 lines
    ],
    ids=["dense", "full", "sweep, 1 s", "sweep, 2 s", "sparse"],
)
def test_phases_bring_the_peak_down(cycles, highest_crest):
    """Bounds 3 % above what is reached; random phases of the same lines are worse by a quarter at least."""
    crest = multisine(cycles, 1.0).crest
    random = np.random.default_rng(1)
    drawn = [np.exp(2j * np.pi * random.random(len(cycles))) for _ in range(20)]
    n = 32 * int(cycles[-1])
    by_chance = []
    for phasors in drawn:
        spectrum = np.zeros(n // 2 + 1, complex)
        spectrum[cycles] = n / 2 * phasors
        by_chance.append(np.max(np.abs(np.fft.irfft(spectrum, n))) / np.sqrt(len(cycles) / 2))
    assert crest < highest_crest
    assert crest < 0.8 * np.median(by_chance)


def test_a_hundred_points_take_a_fifth_of_a_second():
    played = odd_lines(LOG_POINTS - F1_HZ, 1.0).played
    multisine(played, 1.0)
    assert least_cpu_s(lambda: multisine(played, 1.0), 0.5) < 0.5  # 0.1 s alone; a loaded machine is slower


def test_the_same_lines_give_the_same_signal_though_the_last_digit_differs():
    """What another processor rounds otherwise must not become another signal: BFGS would blow it up."""
    cycles = odd_lines(LOG_POINTS - F1_HZ, 1.0).played
    amplitudes = np.ones(len(cycles))
    blurred = amplitudes * (1.0 + 2e-16 * np.random.default_rng(3).standard_normal(len(cycles)))
    assert np.any(blurred != amplitudes)
    assert np.array_equal(low_crest_phases(amplitudes, cycles, 2, 0), low_crest_phases(blurred, cycles, 2, 0))
    assert np.array_equal(multisine(cycles, 1.0).phasors, multisine(cycles, 1.0).phasors)


def test_weights_are_kept():
    weights = np.array([3.0, 1.0, 0.5, 2.0])
    signal = multisine(np.array([1, 7, 11, 31]), 1.0, weights)
    assert np.abs(signal.phasors) / np.abs(signal.phasors[1]) == pytest.approx(weights, rel=1e-12)


# Binary sequences


@pytest.mark.parametrize("order", [*range(2, 15), *(pytest.param(k, marks=pytest.mark.evidence) for k in (15, 16))])
def test_maximum_length_sequences_have_the_flat_spectrum_of_the_closed_form(order):
    power = np.abs(np.fft.fft(maximum_length(order))) ** 2
    assert power[0] == pytest.approx(1.0, abs=1e-6)
    assert power[1:] == pytest.approx(np.full(2**order - 2, 2.0**order), rel=1e-9)


def test_a_maximum_length_sequence_is_scipys_up_to_shift_and_direction():
    """Outside truth: the same polynomial (x^9 + x^5 + 1) by somebody else."""
    from scipy.signal import max_len_seq

    ours = maximum_length(9)
    theirs = 1.0 - 2.0 * max_len_seq(9, taps=[5])[0]
    assert max(np.sum(np.roll(other, k) * ours) for other in (theirs, theirs[::-1]) for k in range(511)) == 511.0


@pytest.mark.parametrize("length", [3, 7, 11, 499, 1019, 2003])
def test_quadratic_residue_sequences_have_the_flat_spectrum_of_gauss(length):
    power = np.abs(np.fft.fft(quadratic_residue(length))) ** 2
    assert power[1:] == pytest.approx(np.full(length - 1, length + 1.0), rel=1e-9)


@settings(deadline=None, max_examples=50)
@given(st.integers(3, 400))
def test_squares_are_told_by_eulers_criterion(length):
    """Twin: a**((p-1)/2) = +-1 (mod p); lengths that are no prime = 3 (mod 4) are refused."""
    prime = all(length % d for d in range(2, length))
    assert is_residue_length(length) == (prime and length % 4 == 3)
    if is_residue_length(length):
        euler = [1.0 if n == 0 or pow(n, (length - 1) // 2, length) == 1 else -1.0 for n in range(length)]
        assert quadratic_residue(length).tolist() == euler


def test_an_inverse_repeat_has_odd_lines_only():
    lines = np.abs(np.fft.fft(inverse_repeat(maximum_length(6))))
    assert np.max(lines[0::2]) < 1e-12
    assert lines[1:63:2] == pytest.approx(np.full(31, 2.0 * 8.0), rel=1e-9)  # twice sqrt(N + 1)


@pytest.mark.parametrize("make", [prbs, qrb])
def test_a_held_sequence_is_the_samples_of_the_binary_wave_less_what_the_band_leaves_out(make):
    """Closed form 2 sqrt(N + 1)/N sinc(k/N) of every line, and the lines of the drawn square wave."""
    size, n = (6, 63) if make is prbs else (67, 67)
    signal = make(size, n / 0.1, (10.0, 0.44 * n / 0.1))
    k = signal.cycles
    closed_form = 2.0 * np.sqrt(n + 1.0) / n * np.sinc(k / n)
    assert np.abs(signal.phasors) * signal.raw_peak == pytest.approx(closed_form, rel=1e-9)
    drawn = np.repeat(maximum_length(6) if make is prbs else quadratic_residue(67), 1000)
    by_samples = 2.0 * np.fft.fft(drawn)[k] / len(drawn) * np.exp(-1j * np.pi * k / len(drawn))  # middle of a sample
    assert signal.phasors * signal.raw_peak == pytest.approx(by_samples, abs=1e-5)  # staircase of 1000 steps


def test_the_odd_variants_play_odd_lines_only():
    for signal in (prbs(7, 254 / 0.2, (5.0, 400.0), odd=True), chirp(0.2, (5.0, 400.0), odd=True)):
        assert np.all(signal.cycles % 2 == 1)
        t = np.linspace(0.0, 0.1, 77)
        assert wave(signal, t + 0.1) == pytest.approx(-wave(signal, t), abs=1e-9)


def test_lengths_and_orders_reach_the_band_they_are_asked_for():
    assert residue_length(1.0, 950.0) == 2179
    assert 0.44 * residue_length(1.0, 950.0) >= 950.0
    assert register_order(1.0, 450.0) == 10  # 0.44 * 1023 = 450.1
    assert register_order(1.0, 451.0) == 11
    qrb(2179, 2179.0, (1.0, 950.0))
    prbs(10, 1023.0, (1.0, 450.0))


# Chirps


@pytest.mark.parametrize("odd", [False, True])
def test_a_linear_chirp_is_flat_and_a_logarithmic_one_falls_with_the_root_of_the_frequency(odd):
    """Inside the band, by the method of stationary phase: amplitude^2 = 2/(T d nu/dt); the ends ripple."""
    linear, log = (chirp(4.0, (1.0, 1000.0), spacing, odd=odd) for spacing in ("linear", "log"))
    every = 2.0 if odd else 1.0  # every second line has the power of two
    rates = {"linear": 999.0 / 4.0, "log": 100.0 * np.log(1000.0) / 4.0}  # d nu/dt at 100 Hz
    for signal, rate in ((linear, rates["linear"]), (log, rates["log"])):
        near = (signal.nu_hz > 80.0) & (signal.nu_hz < 125.0)
        found = np.sqrt(np.mean((np.abs(signal.phasors[near]) * signal.raw_peak) ** 2))
        assert found == pytest.approx(np.sqrt(every / (rate * 4.0**2)), rel=0.03)  # Fresnel ripples


# Lines


@settings(deadline=None, max_examples=60)
@given(
    f_min_hz=st.floats(1.0, 40.0),
    decades=st.floats(0.5, 1.4),
    points=st.integers(2, 150),
    period_s=st.sampled_from([0.5, 1.0, 2.0, 3.0, 5.0]),
    group=st.sampled_from([0, 4, 8]),
)
def test_odd_lines_are_odd_distinct_inside_and_as_many_as_asked(f_min_hz, decades, points, period_s, group):
    wanted = np.geomspace(f_min_hz, f_min_hz * 10.0**decades, points) - F1_HZ
    all_odd = [k for k in range(-500, 7000) if k % 2 and wanted[0] <= k / period_s <= wanted[-1]]
    silent = len(all_odd) // group + 4 if group else 0  # at most: two begun groups on either side of f1
    if len(all_odd) < points:
        with pytest.raises(SignalError, match="take fewer points or a wider band"):
            odd_lines(wanted, period_s, group)
    assume(len(all_odd) - silent >= points)
    lines = odd_lines(wanted, period_s, group)
    assert len(lines.cycles) == points
    assert np.all(np.diff(lines.cycles) > 0)
    assert np.all(lines.cycles % 2 == 1)
    assert np.all(lines.cycles / period_s >= wanted[0] - 1e-6)
    assert np.all(lines.cycles / period_s <= wanted[-1] + 1e-6)
    assert lines.played.tolist() == sorted({abs(int(k)) for k in lines.cycles})


def test_a_list_that_the_period_resolves_is_snapped_to_the_nearest_lines():
    wanted = np.array([-40.9, -30.0, -3.2, 1.1, 77.7, 300.4, 950.9])
    lines = odd_lines(wanted, 1.0, 0)
    assert lines.cycles.tolist() == [-39, -31, -3, 1, 77, 301, 949]  # the ends stay inside; halfway goes down
    assert lines.merged == 0


def test_points_that_merge_are_made_up_for_elsewhere():
    """A logarithmic grid is 0.07 Hz fine at 1 Hz, lines are 2 Hz apart: what merges there is placed higher up."""
    lines = odd_lines(LOG_POINTS - F1_HZ, 1.0)
    f_hz = F1_HZ + lines.cycles
    assert len(f_hz) == 100
    assert lines.merged == 36
    usable_below = [f for f in range(1, 51, 2) if (50 - f) % 2]
    assert np.sum(f_hz < 50) > 0.8 * len(usable_below)  # all but those kept for detection
    high = f_hz[f_hz > 300]
    ratios = np.diff(np.log(high))
    assert ratios.max() / ratios.min() < 1.6  # still logarithmic where lines are plenty: 2 Hz steps, silent ones


def test_some_odd_lines_and_every_even_line_stay_silent_for_detection():
    lines = odd_lines(np.linspace(-49.0, 349.0, 160), 1.0)
    even, odd = detection_lines(lines.played)
    assert np.all(even % 2 == 0)
    assert np.all(odd % 2 == 1)
    assert not set(odd.tolist()) & set(np.abs(lines.cycles).tolist())
    full = odd_lines(np.linspace(-49.0, 949.0, 430), 1.0)
    _, silent = detection_lines(full.played)
    groups = np.bincount(silent // 16, minlength=59)[:59]
    assert np.all(groups >= 1)  # one at least in every group of eight odd lines
    assert len(set((silent // 2 % 8).tolist())) == 8  # and at every place of a group: no comb


# Refusals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: odd_lines(np.linspace(1.0, 20.0, 50), 1.0), "has 9 odd lines to play there, 2 Hz apart.*a period of"),
        (lambda: odd_lines(np.array([-1.0, 0.0, 1.0]), 1.0), "f1 itself is wanted"),
        (lambda: odd_lines(np.array([3.0, 1.0]), 1.0), "at least one, and ascend"),
        (lambda: Signal("multisine", 1.0, [0, 1], [1.0, 1.0]), "is f1 itself: lines begin at 1/T"),
        (lambda: Signal("multisine", 1.0, [3, 1], [1.0, 1.0]), "cycles must ascend strictly"),
        (lambda: multisine([1, 3], 1.0, [1.0, 0.0]), "leave a line out instead"),
        (
            lambda: prbs(9, 511.0, (0.5, 100.0)),
            r"0\.5 Hz is finer than a period of 1 s resolves: begin the band at 1 Hz",
        ),
        (
            lambda: prbs(9, 511.0, (1.0, 300.0)),
            r"above 0\.44 of the clock of 511 Hz.*224\.84 Hz, or take a clock of 681",
        ),
        (lambda: qrb(499, 499.0, (0.0, 100.0)), "includes f1 itself: nu begins at 1/T, here 1 Hz"),
        (lambda: chirp(1.0, (1.2, 1.8)), "no line between 1.2 and 1.8 Hz.*one every 1 Hz"),
        (lambda: chirp(1.0, (5.0, 5.0)), "does not sweep: give a wider band"),
        (lambda: prbs(9, 0.0, (1.0, 10.0)), "the clock of a binary sequence is 0 Hz"),
        (lambda: maximum_length(1), "orders are 2 to 16"),
        (lambda: quadratic_residue(1000), "it is not prime.*such as 991 or 1019"),
        (lambda: quadratic_residue(13), r"it is 1 \(mod 4\): its spectrum would not be flat.*such as 11 or 19"),
        (lambda: quadratic_residue(2), "not prime|such as 3"),
        (lambda: tones(multisine([1], 1.0), "d", 50.0, 0.0), "the peak of a perturbation is 0"),
    ],
)
def test_what_cannot_work_is_refused_with_the_way_out(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_a_period_must_be_whole_steps_and_whole_fundamental_periods():
    assert coherent_blocks(multisine([1, 3], 0.5), F1_HZ, DT_S) == 25
    assert coherent_blocks(multisine([1, 3], 0.5), 60.0, DT_S) == 10  # blocks of three periods of 60 Hz
    with pytest.raises(SignalError, match=r"take 0\.5 s or 0\.52 s$"):
        coherent_blocks(multisine([1, 3], 0.511), F1_HZ, DT_S)
    with pytest.raises(SignalError, match=r"take 0\.5 s or 0\.52 s \(the clock of a sequence of N bits is N over that"):
        coherent_blocks(prbs(9, 1000.0, (2.0, 400.0)), F1_HZ, DT_S)
    period_s = Fraction(1, 2)
    fitting = prbs(9, float(511 / period_s), (2.0, 400.0))
    assert coherent_blocks(fitting, F1_HZ, DT_S) == 25


def test_tones_must_be_below_nyquist():
    with pytest.raises(SignalError, match="the tone at 550 Hz must be below the Nyquist frequency of 500 Hz"):
        coherent_blocks(multisine([500], 1.0), F1_HZ, 1e-3)


def test_a_weak_line_is_refused_with_the_peak_it_needs():
    signal = multisine(np.arange(1, 200, 2), 1.0)
    require_amplitude(signal, 1.0, signal.weakest)
    with pytest.raises(SignalError, match=r"for the weakest of 200 tones; 0\.1 is needed: raise the peak to 2\.01"):
        require_amplitude(signal, 1.0, 0.1)


# Evidence


@pytest.mark.evidence
@pytest.mark.parametrize("period_s", [1.0, 2.0])
def test_what_each_signal_leaves_for_its_lines(period_s):
    """Multisines at the odd lines of points from 1 Hz to 1 kHz, others from 1 to 950 Hz beside f1."""
    band, thirty = (1.0, 950.0), np.geomspace(1.0, 1000.0, 30)
    length, half = (residue_length(part * period_s, 950.0) for part in (1.0, 0.5))
    bits = 2 ** register_order(period_s, 950.0) - 1
    signals = {
        "multisine, 100 points": multisine(odd_lines(LOG_POINTS - F1_HZ, period_s).played, period_s),
        "multisine, 30 points": multisine(odd_lines(thirty - F1_HZ, period_s).played, period_s),
        "multisine, all odd": multisine(np.arange(1, int(950 * period_s), 2), period_s),
        f"qrb of {length}": qrb(length, length / period_s, band),
        f"qrb of {half}, odd": qrb(half, 2 * half / period_s, band, odd=True),
        f"prbs of {bits}": prbs(register_order(period_s, 950.0), bits / period_s, band),
        "chirp": chirp(period_s, band),
        "chirp, odd": chirp(period_s, band, odd=True),
        "chirp, log": chirp(period_s, band, "log"),
    }
    print(f"period {period_s:g} s; tones in parts of the peak; raw peak: before it was made one")
    print(f"{'signal':<24}{'lines':>7}{'crest':>7}{'weakest tone':>14}{'median tone':>13}{'raw peak':>10}")
    for name, signal in signals.items():
        middle = 0.5 * np.median(np.abs(signal.phasors))
        print(
            f"{name:<24}{len(signal.cycles):>7}{signal.crest:>7.2f}{signal.weakest:>14.2%}{middle:>13.2%}"
            f"{signal.raw_peak:>10.2f}"
        )
        assert signal.crest < 3.0
