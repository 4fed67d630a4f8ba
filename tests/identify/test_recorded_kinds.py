"""Kinds of recordings that misled: random ones of each kind, of a device whose answer is exact.

Whatever is drawn, a row that is `ok` contains the truth in its region as often as it promises; what cannot be known is
`noisy`, `ill_conditioned` or refused by name. A few draws here, hundreds with `-m evidence` (a new seed each time,
which is printed).
"""

from __future__ import annotations

import secrets
from typing import NamedTuple

import numpy as np
import pytest

from seqsweep.identify.recorded.detect import survey
from seqsweep.identify.recorded.points import Experiment, points_of, without_common_lines
from seqsweep.identify.recorded.quiet import quiet_lines, without_background
from seqsweep.identify.recorded.tones import hear

from ..support.by_hand import Heard as Waveforms
from ..support.by_hand import Stretch
from ..support.recorded_device import chi_square, joined, noisy, random_device, tones

CHI2_95 = 5.991
FAR = 40.0
"""A chi-square of two degrees of freedom exceeds this once in 5e8 draws: no `ok` row may."""


class Case(NamedTuple):
    """Recordings of a device, and the frequencies (Hz) at which it was asked."""

    device: object
    recordings: list
    asked: list


class Outcome(NamedTuple):
    """Chi-squares of the elements of `ok` rows, frequencies that are missing, rows that nobody asked for."""

    chi2: np.ndarray
    missing: list
    extra: list
    statuses: list
    unused: list


def found_in(recordings):
    """Experiments of recordings that nobody described, as `identify` finds them, and what was not used."""
    experiments, unused = [], []
    for number, stretch in enumerate(recordings):
        waveforms = Waveforms(stretch)
        seen = survey(waveforms)
        unused += seen.unused
        together = {}
        for each in seen.found:
            together.setdefault((each.start, each.stop), []).append(each)
        for (start, stop), found in together.items():
            heard = hear(waveforms, start, stop, tuple(each.f_hz for each in found))
            before = found[0].quiet and quiet_lines(waveforms, *found[0].quiet, heard, None)
            heard = [without_background(each, before) for each in heard] if before else heard
            experiments += [Experiment(str(number), each) for each in heard]
    kept, words = without_common_lines(experiments)
    return kept, unused + words


def outcome(case):
    """What becomes of recordings that nobody described."""
    experiments, unused = found_in(case.recordings)
    points = points_of(experiments, case.device.f1_hz)
    return judged(case, points, unused)


def judged(case, points, unused=()):
    """Rows against the truth."""
    good = [p for p in points if p.status == "ok"]
    chi2 = [chi_square(p, case.device.y(p.f_hz)) for p in good]
    missing = [f for f in case.asked if min((abs(p.f_hz - f) for p in good), default=9.0) > 0.02]
    extra = [p.f_hz for p in points if min(abs(p.f_hz - f) for f in case.asked) > 0.02]
    return Outcome(np.array(chi2).ravel(), missing, extra, [(p.status, p.reason) for p in points], list(unused))


def apart(rng, n, f1_hz, highest=300.0, distance=2.0):
    """n frequencies that do not meet one another, a mirror, or a harmonic (Hz)."""
    found = []
    while len(found) < n:
        f = float(np.round(rng.uniform(1.0, highest), 2))
        free = all(abs(abs(f - f1_hz) - abs(g - f1_hz)) > distance for g in found)
        if free and abs(f - f1_hz) > 3.0 and min(abs(f - k * f1_hz) for k in range(21)) > 1.0:
            found.append(f)
    return found


def points_asked(frequencies, f1_hz):
    """The points that pairs of experiments serve."""
    return sorted(f for f in [*frequencies, *(2.0 * f1_hz - f for f in frequencies)] if f > 0.0)


def dirt(rng, device, *, interharmonic=True):
    """Lines of a network, or none."""
    lines = {}
    if rng.random() < 0.6:
        for order, size in ((-5, 0.02), (7, 0.01), (-1, 0.01), (3, 0.003)):
            lines[order * device.f1_hz] = size * device.v1 * np.exp(1j * rng.uniform(0.0, 6.0))
    if interharmonic and rng.random() < 0.4:
        lines[3.566 * device.f1_hz] = 0.01 * device.v1
    return lines


def both(one, other):
    """Two sets of lines at once."""
    return {f: one.get(f, 0.0) + other.get(f, 0.0) for f in {**one, **other}}


# The kinds


def several_at_once(rng):
    """2 to 11 tones at once in one recording, their mirrors in another, with or without a quiet lead-in."""
    device = random_device(rng, float(rng.choice([50.0, 60.0, 49.97, 50.013, 60.02])))
    frequencies = apart(rng, int(rng.integers(2, 12)), device.f1_hz)
    background, dt_s = dirt(rng, device), float(rng.choice([1e-4, 2.5e-4, 5e-4]))
    lead_s, noise = float(rng.choice([0.0, 0.3, 0.7, 2.0])), float(rng.choice([1e-5, 1e-4, 1e-3]))
    recordings = []
    for at in (frequencies, [2.0 * device.f1_hz - f for f in frequencies]):
        lines = tones(rng, at, 0.01 * device.v1, leak=float(rng.choice([0.0, 0.2, 0.4])))(device.f1_hz)
        parts = [device.stretch(background, lead_s, dt_s, noise=noise, rng=rng)]
        parts += [
            device.stretch(both(lines, background), rng.uniform(4.0, 9.0), dt_s, t0_s=lead_s, noise=noise, rng=rng)
        ]
        recordings.append(joined(parts))
    return Case(device, recordings, points_asked(frequencies, device.f1_hz))


def multisine(rng, n_lines=40, length_s=8.5):
    """Some forty lines, on a grid, odd, sparse or logarithmic, at 0.1 % noise."""
    device = random_device(rng, float(rng.choice([50.0, 60.0, 49.97])))
    f1_hz, step = device.f1_hz, float(rng.choice([2.0, 3.0]))
    candidates = {
        "grid": 1.0 + step * np.arange(1, 2 * n_lines),
        "odd": step * (2.0 * np.arange(2 * n_lines) + 1.0),
        "sparse": np.arange(2.0, 900.0),
        "log": np.unique(np.round(np.geomspace(2.0, 900.0, 3 * n_lines))),
    }[str(rng.choice(["grid", "odd", "sparse", "log"]))]
    lines = []
    for f in rng.permutation(candidates):
        free = all(abs(abs(f - f1_hz) - abs(g - f1_hz)) > 0.9 for g in lines)
        if free and len(lines) < n_lines and abs(f - f1_hz) > 2.5 and abs(f / f1_hz - round(f / f1_hz)) * f1_hz > 0.9:
            lines.append(float(f))
    recordings = []
    for at in (lines, [2.0 * f1_hz - f for f in lines]):
        played = tones(rng, at, 0.004 * device.v1)(f1_hz)
        parts = [device.stretch({}, 0.5, 2e-4, noise=1e-3, rng=rng)]
        parts += [device.stretch(played, length_s - 0.5, 2e-4, t0_s=0.5, noise=1e-3, rng=rng)]
        recordings.append(joined(parts))
    return Case(device, recordings, points_asked(lines, f1_hz))


def one_after_another(rng):
    """Tones of 1.5 to 3 s and their mirrors in one recording, with and without gaps."""
    device = random_device(rng, float(rng.choice([50.0, 60.0, 49.97])))
    frequencies = apart(rng, int(rng.integers(2, 5)), device.f1_hz, distance=3.0)
    background, dt_s = dirt(rng, device, interharmonic=False), float(rng.choice([1e-4, 2e-4, 5e-4]))
    length_s, gap_s = float(rng.choice([1.5, 2.0, 3.0])), float(rng.choice([0.0, 0.2, 0.5, 1.0]))
    noise, parts, t_s = float(rng.choice([1e-5, 3e-4])), [], 0.0
    plan = [({}, float(rng.choice([0.0, 0.5, 1.3])))]
    for f in frequencies:
        for at in (f, 2.0 * device.f1_hz - f):
            plan += [(tones(rng, [at], 0.01 * device.v1)(device.f1_hz), length_s), ({}, gap_s)]
    for lines, duration_s in plan:
        parts.append(device.stretch(both(lines, background), duration_s, dt_s, t0_s=t_s, noise=noise, rng=rng))
        t_s += dt_s * len(parts[-1].v)
    return Case(device, [joined(parts)], points_asked(frequencies, device.f1_hz))


def aircraft(rng):
    """A fundamental between 360 and 800 Hz."""
    device = random_device(rng, float(np.round(rng.uniform(360.0, 800.0), 2)))
    frequencies = apart(rng, 3, device.f1_hz, highest=700.0)
    recordings = []
    for at in (frequencies, [2.0 * device.f1_hz - f for f in frequencies]):
        lines = tones(rng, at, 0.01 * device.v1)(device.f1_hz)
        recordings.append(device.stretch(lines, 3.0, 5e-5, noise=1e-4, rng=rng))
    return Case(device, recordings, points_asked(frequencies, device.f1_hz))


KINDS = [several_at_once, multisine, one_after_another, aircraft]


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.evidence) for k in (1, 2))])
@pytest.mark.parametrize("kind", KINDS)
def test_every_tone_is_found_and_no_region_is_far_from_the_truth(kind, seed):
    found = outcome(kind(np.random.default_rng(seed)))
    assert (found.missing, found.extra) == ([], []), found
    assert found.chi2.max() < FAR
    assert np.mean(found.chi2 < CHI2_95) > 0.8


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("kind", "draws"), [(several_at_once, 120), (multisine, 20), (one_after_another, 80), (aircraft, 40)]
)
def test_regions_of_each_kind_cover_what_they_promise(kind, draws):
    seed = secrets.randbits(32)
    results = [outcome(kind(np.random.default_rng([seed, k]))) for k in range(draws)]
    chi2 = np.concatenate([r.chi2 for r in results])
    missing, extra = (sum(len(getattr(r, name)) for r in results) for name in ("missing", "extra"))
    print(
        f"{kind.__name__} (seed {seed}, {draws} draws): regions cover {np.mean(chi2 < CHI2_95):.1%} of {len(chi2)} "
        f"elements; of {len(chi2) // 4 + missing} points {missing} are missing, {extra} rows nobody asked for; largest "
        f"chi-square {chi2.max():.0f}"
    )
    assert 0.93 < np.mean(chi2 < CHI2_95) < 0.97
    assert chi2.max() < FAR
    assert missing + extra <= 0.02 * len(chi2) / 4


# Next to the fundamental


def beside_f1(rng):
    """A tone with 0.3 to 6 cycles of |f - f1| in its window; f1 is not a round number."""
    device = random_device(rng, 50.0 + float(rng.uniform(-0.05, 0.05)))
    length_s, cycles = float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.3, 6.0))
    f = device.f1_hz + cycles / length_s * float(rng.choice([-1.0, 1.0]))
    noise = float(rng.choice([1e-6, 1e-5, 1e-4]))
    experiments = []
    for at in (f, 2.0 * device.f1_hz - f):
        lines = tones(rng, [at], 0.015 * device.v1)(device.f1_hz)
        waveforms = Waveforms(device.stretch(lines, length_s, 5e-4, noise=noise, rng=rng))
        experiments.append((waveforms, at))
    return Case(device, experiments, [f]), cycles


def near_f1(rng, known):
    """Rows of `beside_f1`, with f1 known or not; the number of cycles."""
    case, cycles = beside_f1(rng)
    f1_hz = case.device.f1_hz if known else None
    heard = [hear(w, 0, w.n_samples, (at,), f1_hz)[0] for w, at in case.recordings]
    points = points_of([Experiment(str(k), each, case.asked[0]) for k, each in enumerate(heard)], case.device.f1_hz)
    return judged(case, points), cycles


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("known", [False, True])
def test_next_to_f1_a_row_is_right_within_its_region_or_says_that_the_window_is_too_short(seed, known):
    found, cycles = near_f1(np.random.default_rng(seed), known)
    if not known and cycles < 0.95:
        ((status, reason),) = found.statuses
        assert status in ("ill_conditioned", "noisy")
        assert "cycles of |f - f1| in the window" in reason or "standard deviation" in reason
    assert not len(found.chi2) or found.chi2.max() < FAR


@pytest.mark.evidence
def test_regions_next_to_f1_cover_what_they_promise():
    seed = secrets.randbits(32)
    for known in (False, True):
        results = [near_f1(np.random.default_rng([seed, k]), known)[0] for k in range(400)]
        chi2 = np.concatenate([r.chi2 for r in results])
        print(
            f"tones next to f1, f1 {'known' if known else 'unknown'} (seed {seed}): {len(chi2) // 4} of {len(results)} "
            f"rows are ok, their 95 % regions cover {np.mean(chi2 < CHI2_95):.1%}; largest chi-square {chi2.max():.0f}"
        )
        assert 0.92 < np.mean(chi2 < CHI2_95) < 0.985
        assert chi2.max() < FAR


def test_a_wandering_of_f1_is_not_followed_where_that_would_take_the_tone_along():
    """Two cycles of |f - f1|, and an f1 that wanders by more than its noise: nobody can tell the two apart."""
    rng = np.random.default_rng(5)
    device = random_device(rng, 50.0)
    stretch = device.stretch({52.0: 4.0}, 1.0, 5e-4, noise=1e-5, rng=rng)
    t = 5e-4 * np.arange(len(stretch.v))
    wander = np.exp(0.02j * np.sin(2 * np.pi * 1.1 * t))
    stretch.v[:], stretch.i[:] = stretch.v * wander, stretch.i * wander
    (heard,) = hear(Waveforms(stretch), 0, len(t), (52.0,))
    assert heard.drift_hz == 0.0 or heard.doubt is not None


def on_a_wandering_grid(rng):
    """Tones of fixed frequencies while f1 wanders; the device follows slowly, so its answer is quasi-static."""
    device, dt_s = random_device(rng, 50.0), 2e-4
    frequencies = apart(rng, int(rng.integers(1, 6)), 50.0)
    drift_hz, period_s = float(rng.choice([0.01, 0.03])), float(rng.choice([10.0, 30.0]))
    t = dt_s * np.arange(round(float(rng.uniform(6.0, 12.0)) / dt_s))
    recordings = []
    for at in (frequencies, [100.0 - f for f in frequencies]):
        wander = drift_hz * period_s * np.sin(2.0 * np.pi * t / period_s + rng.uniform(0.0, 6.0))
        frame = np.exp(1j * (2.0 * np.pi * 50.0 * t + device.phi1 + wander))
        v, i = device.v1 * frame, device.i1 * frame
        for f, phasor in tones(rng, at, 0.01 * device.v1, leak=0.0)(50.0).items():
            tone, y = phasor * np.exp(2j * np.pi * f * t), device.y(f)
            v, i = v + tone, i + y[0, 0] * tone + np.conj(y[1, 0] * tone / frame) * frame
        recordings.append(noisy(Stretch(v, i, dt_s), 1e-4, device, rng))
    return Case(device, recordings, points_asked(frequencies, 50.0))


@pytest.mark.parametrize("seed", range(4))
def test_on_a_wandering_grid_all_tones_are_found_and_no_sideband_of_f1_is_taken_for_one(seed):
    case = on_a_wandering_grid(np.random.default_rng(seed))
    experiments, _ = found_in(case.recordings)
    points = points_of(experiments, 50.0)
    assert [p.f_hz for p in points] == pytest.approx(case.asked, abs=0.05)
    for point, f in zip(points, case.asked, strict=True):
        assert point.status in ("ok", "not_settled", "ill_conditioned")
        assert np.linalg.norm(point.y - case.device.y(f)) < 2e-2 * np.linalg.norm(case.device.y(f))


# On a harmonic


def on_a_harmonic(rng):
    """A tone at n f1, where the network has a line of up to three times its size, after a quiet lead-in."""
    device = random_device(rng, float(rng.choice([50.0, 60.0, 49.98])))
    order = int(rng.choice([3, 5, 7, 11, 13]))
    f = order * device.f1_hz
    share = float(rng.uniform(0.1, 3.0))
    background = {
        place: share * 0.015 * device.v1 * np.exp(1j * rng.uniform(0.0, 6.0))
        for place in (f, 2.0 * device.f1_hz - f)
        if rng.random() < 0.7 or place == f
    }
    lead_s, length_s = float(rng.uniform(0.3, 1.5)), float(rng.uniform(0.8, 2.0))
    noise = float(rng.choice([1e-5, 1e-4, 1e-3]))
    parts = []
    for at in (f, 2.0 * device.f1_hz - f):
        lines = tones(rng, [at], 0.015 * device.v1)(device.f1_hz)
        quiet = device.stretch(background, lead_s, 2e-4, noise=noise, rng=rng)
        loud = device.stretch(both(lines, background), length_s, 2e-4, t0_s=2e-4 * len(quiet.v), noise=noise, rng=rng)
        parts.append((joined([quiet, loud]), len(quiet.v), at))
    return Case(device, parts, [f])


def rows_on_a_harmonic(case, lead_in=True):
    """Rows with or without a look at the lead-in."""
    experiments = []
    for k, (stretch, begin, at) in enumerate(case.recordings):
        waveforms = Waveforms(stretch)
        (heard,) = hear(waveforms, begin, waveforms.n_samples, (at,))
        quiet = quiet_lines(waveforms, 0, begin, [heard], None) if lead_in else None
        experiments.append(Experiment(str(k), without_background(heard, quiet) if quiet else heard, case.asked[0]))
    return judged(case, points_of(experiments, case.device.f1_hz))


@pytest.mark.parametrize("seed", range(8))
def test_a_harmonic_that_was_there_before_the_tone_is_taken_off_or_the_row_says_so(seed):
    case = on_a_harmonic(np.random.default_rng(seed))
    found = rows_on_a_harmonic(case)
    assert not len(found.chi2) or found.chi2.max() < FAR
    if not len(found.chi2):
        assert found.statuses[0][0] == "noisy"
    ((status, reason),) = rows_on_a_harmonic(case, lead_in=False).statuses
    assert status == "noisy"
    assert "record some seconds before the tone begins" in reason


@pytest.mark.evidence
def test_regions_on_harmonics_cover_what_they_promise():
    seed = secrets.randbits(32)
    results = [rows_on_a_harmonic(on_a_harmonic(np.random.default_rng([seed, k]))) for k in range(200)]
    chi2 = np.concatenate([r.chi2 for r in results])
    print(
        f"tones on harmonics (seed {seed}): {len(chi2) // 4} of {len(results)} rows are ok, their 95 % regions cover "
        f"{np.mean(chi2 < CHI2_95):.1%}; largest chi-square {chi2.max():.0f}"
    )
    assert 0.92 < np.mean(chi2 < CHI2_95) < 0.985
    assert np.mean(chi2 > FAR) < 0.003  # a short lead-in has few segments, whose scatter has the tails of Student's t
