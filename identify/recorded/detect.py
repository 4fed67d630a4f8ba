"""Experiments in a long record that nobody described: where a tone is on, and which.

The record is cut into frames; in each the fundamental (its drift within the frame included), its mirror and the offset
are taken off, and what stands highest above the noise in the voltage is a tone, unless it is a harmonic that is always
there. Frames that agree make an experiment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .background import ABOVE_NOISE, SPECTRUM_SAMPLES, interpolated, neighbourhood, taken_off
from .fundamental import fundamental
from .line_fit import Waveforms

FRAME_S = (0.2, 1.0)
"""Shortest and longest frame (s)."""

FEWEST_FRAMES = 3
SOME_FRAMES = 16

ALWAYS = 0.9
"""A harmonic in more than this part of the frames was there before any tone."""

STRONGER = 1.5
"""A tone stands this much higher than a line of the background must."""

NEAR_BINS, NEAR_F1 = 0.1, 1e-4
"""A line is a harmonic within this many bins and this part of its distance from f1."""

BLURRED_BINS = 4.0
"""Bins within which a frame blurs a tone with the fundamental, its mirror or the offset."""

SAME_BIN = 0.6
"""Frames agree on a tone within this many bins."""


class Found(NamedTuple):
    """A tone that is on between two samples; ``f_hz`` (signed) is known to a fraction of a bin."""

    start: int
    stop: int
    f_hz: float


class _Seen(NamedTuple):
    """The strongest line of a frame: distance from f1 (Hz, signed) and height above the noise."""

    distance_hz: float
    height: float


def find_tones(waveforms: Waveforms) -> list[Found]:
    """Experiments in the order of time; empty where no tone stands above the noise for three frames.

    Raises
    ------
    HearingError
        If there is no fundamental.
    """
    n = waveforms.n_samples
    frame = int(min(max(n * waveforms.dt_s / 6.0, FRAME_S[0]), FRAME_S[1]) / waveforms.dt_s)
    starts = range(0, n - frame + 1, frame)
    some = starts[:: max(1, len(starts) // SOME_FRAMES)]
    f1_hz = float(np.median([fundamental(waveforms, start, start + frame) for start in some]))
    basis, window = _fundamental(f1_hz, frame, waveforms.dt_s), np.hanning(frame)
    seen = [_lines(waveforms, start, basis, window, f1_hz) for start in starts]
    resolution = 1.0 / (frame * waveforms.dt_s)
    always = _always(seen, f1_hz, resolution)
    strongest = [
        max(
            (line for line in each if _order(line, f1_hz, resolution) not in always),
            key=lambda s: s.height,
            default=None,
        )
        for each in seen
    ]
    return [_refined(waveforms, each, f1_hz, resolution) for each in _runs(strongest, frame, f1_hz, resolution, n)]


def _refined(waveforms: Waveforms, found: Found, f1_hz: float, resolution: float) -> Found:
    """Next to a line that is always there a frame blurs the tone: its peak in a spectrum of the whole stretch."""
    neighbours = (f1_hz, -f1_hz, 0.0)
    if min(abs(found.f_hz - line) for line in neighbours) > BLURRED_BINS * resolution:
        return found
    n = min(found.stop - found.start, SPECTRUM_SAMPLES)
    v = waveforms.record(found.stop - n, found.stop).v
    own_f1_hz = fundamental(waveforms, found.stop - n, found.stop)
    basis = _fundamental(own_f1_hz, n, waveforms.dt_s)
    rest, _ = taken_off(np.where(np.isfinite(v), v, 0.0), basis, np.eye(len(basis)))
    size = np.abs(np.fft.fft(rest * np.hanning(n)))
    f_hz = np.fft.fftfreq(n, waveforms.dt_s)
    near = np.abs(f_hz - found.f_hz) < 2.0 * resolution
    for line in (own_f1_hz, -own_f1_hz, 0.0):
        near &= np.abs(f_hz - line) > 2.0 / (n * waveforms.dt_s)
    if not near.any():
        return found
    return found._replace(f_hz=interpolated(size, int(np.argmax(np.where(near, size, 0.0)))) / (n * waveforms.dt_s))


def _fundamental(f1_hz: float, n: int, dt_s: float) -> np.ndarray:
    """What the fundamental, its mirror and an offset can be in a frame of n samples (5, n), orthonormal."""
    t = dt_s * (np.arange(n) - 0.5 * (n - 1))
    turn = np.exp(2j * np.pi * f1_hz * t)
    q, _ = np.linalg.qr(np.stack([turn, turn * t, turn * t**2, turn.conj(), np.ones(n)], axis=1))
    return np.asarray(q.T)


def _lines(waveforms: Waveforms, start: int, basis: np.ndarray, window: np.ndarray, f1_hz: float) -> list[_Seen]:
    """Lines of the voltage of one frame above the noise, but for those of the fundamental."""
    n = len(window)
    v = waveforms.record(start, start + n).v
    if not np.all(np.isfinite(v)):
        return []
    rest, _ = taken_off(v, basis, np.eye(len(basis)))
    size = np.abs(np.fft.fft(rest * window))
    floor = STRONGER * ABOVE_NOISE * neighbourhood(size) + 1e-7 * float(np.max(np.abs(v))) * n
    top = np.flatnonzero((size > floor) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1)))
    return [_Seen(interpolated(size, int(k)) / (n * waveforms.dt_s) - f1_hz, float(size[k])) for k in top]


def _always(seen: list[list[_Seen]], f1_hz: float, resolution: float) -> set[int]:
    """Orders of the harmonics that are there nearly all the time."""
    counts: dict[int, int] = {}
    for each in seen:
        for order in {_order(line, f1_hz, resolution) for line in each} - {None}:
            counts[order] = counts.get(order, 0) + 1  # type: ignore[index, arg-type]
    return {order for order, count in counts.items() if count > ALWAYS * len(seen)}


def _order(line: _Seen, f1_hz: float, resolution: float) -> int | None:
    """Order of the converter's or the grid's own harmonics (6 k + 1, and those of the third) that a line may be."""
    order = round(line.distance_hz / f1_hz) + 1
    near = NEAR_BINS * resolution + NEAR_F1 * abs(order - 1) * f1_hz
    usual = order % 6 == 1 or order in (-1, 0, 3, -3)
    return order if usual and abs(line.distance_hz - (order - 1) * f1_hz) < near else None


def _runs(strongest: list[_Seen | None], frame: int, f1_hz: float, resolution: float, n: int) -> list[Found]:
    """Frames in a row that agree, as experiments; half a frame at a border that is not the record's is left out."""
    found: list[Found] = []
    run: list[tuple[int, float]] = []
    for k, line in enumerate([*strongest, None]):
        if line is not None and (
            not run or abs(line.distance_hz - np.median([d for _, d in run])) < SAME_BIN * resolution
        ):
            run.append((k, line.distance_hz))
            continue
        if len(run) >= FEWEST_FRAMES:
            first, last = run[0][0], run[-1][0]
            start = 0 if first == 0 else first * frame + frame // 2
            stop = n if last == len(strongest) - 1 else (last + 1) * frame - frame // 2
            found.append(Found(start, stop, f1_hz + float(np.median([d for _, d in run]))))
        run = [] if line is None else [(k, line.distance_hz)]
    return found
