"""Channels with a time of their own: brought to common instants exactly, or left out by name."""

from pathlib import Path

import numpy as np
import pytest

from seqsweep.plant.recordings.alignment import PASSBAND, Series, aligned, recording_of_series
from seqsweep.plant.recordings.recording import Channel, Recording, RecordingError, in_memory

N, DT = 3000, 1e-3


def wave(f_hz, t):
    """A sine and an offset."""
    return np.cos(2.0 * np.pi * f_hz * t + 0.3) + 0.2


def skewed(f_hz, offsets_s):
    """A recording of one sine, channel k sampled ``offsets_s[k]`` later."""
    t = DT * np.arange(N)
    x = np.column_stack([wave(f_hz, t + offset) for offset in offsets_s])
    channels = tuple(Channel(f"c{k}") for k in range(len(offsets_s)))
    return Recording(Path("a"), "test", channels, N, 0.0, DT, in_memory([x]))


def series(name, f_hz, start_s, n=N, dt_s=DT):
    """One channel of a sine that begins at ``start_s``."""
    x = wave(f_hz, start_s + dt_s * np.arange(n))
    return Series(Channel(name), start_s, dt_s, n, lambda start, stop: x[start:stop])


@pytest.mark.parametrize("f_hz", [3.3, 77.0, 240.0, 1e3 * (PASSBAND - 0.01)])
def test_skewed_channels_are_brought_to_common_instants_below_the_passband(f_hz):
    offsets = [0.0, 0.31e-3, -2.47e-3, 5e-3]
    found = aligned(skewed(f_hz, offsets), offsets)
    x = found.samples(range(4), 0, found.n_samples)
    truth = wave(f_hz, found.t0_s + DT * np.arange(found.n_samples))
    assert np.max(np.abs(x - truth[:, None])) < 3e-6
    assert "'c1' sampled 310 us later" in found.notes[0]


def test_whole_samples_are_shifted_exactly_and_any_stretch_is_the_same():
    offsets = [0.0, 4.0 * DT, 0.25 * DT]
    found = aligned(skewed(77.0, offsets), offsets)
    whole = found.samples(range(3), 0, found.n_samples)
    truth = wave(77.0, found.t0_s + DT * np.arange(found.n_samples))
    assert np.max(np.abs(whole[:, 1] - truth)) < 1e-12
    assert np.array_equal(found.samples([2, 1], 100, 1100), whole[100:1100, [2, 1]])


def test_channels_that_share_a_start_are_left_as_they_are():
    recording = skewed(50.0, [1e-3, 1e-3])
    found = aligned(recording, [1e-3, 1e-3])
    assert found.n_samples == N
    assert found.t0_s == pytest.approx(1e-3)
    assert not found.notes


def test_series_of_another_step_or_another_time_are_left_out_by_name():
    several = [
        *(series(name, 77.0, 0.1) for name in ("Va", "Vb", "Vc")),
        series("Ia", 77.0, 0.1025),
        series("slow", 5.0, 0.0, n=300, dt_s=1e-2),
        series("late", 77.0, 50.0),
    ]
    found = recording_of_series(Path("a"), "test", several)
    assert [channel.name for channel in found.channels] == ["Va", "Vb", "Vc", "Ia"]
    notes = " ".join(found.notes)
    assert "'slow' sampled at 100 Hz, the others at 1000 Hz: left out" in notes
    assert "'late' recorded at another time than 'Va': left out" in notes
    x = found.samples(range(4), 0, found.n_samples)
    assert np.max(np.abs(x - wave(77.0, found.t0_s + DT * np.arange(found.n_samples))[:, None])) < 3e-6


def test_no_common_time_is_refused():
    with pytest.raises(RecordingError, match="not recorded at the same time"):
        aligned(skewed(50.0, [0.0, 0.0]), [0.0, 10.0])
