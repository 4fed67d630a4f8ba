"""Where in a long record something goes on unchanged: between the places at which lines appear or vanish.

The record is cut into frames that overlap by three quarters. Of each the fundamental (with its drift within the frame),
its mirror and the offset are taken off; what then stands above the noise of the spectrum is lit. Around a place x the
frame that ends there is held against the frame that begins there: something changed where a bin is lit in one, and all
around it the other is four times weaker. Beats of lines that a frame does not resolve stay within a few bins and are no
change. What lies between two changes is a stretch.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .background import ABOVE_NOISE, taken_off
from .line_fit import Waveforms

OVERLAP = 4
"""Frames begin every so-manieth part of a frame."""

STRONGER = 1.5
"""A tone stands this much higher than a line of the background must."""

DARKER = 4.0
"""A line has gone where everything within `BLUR` bins is so many times weaker."""

BLUR = 3

NEXT_TO_F1 = 2.0
"""Bins next to the fundamental, its mirror and the offset in which a frame sees their remains."""

QUANTILE, RAYLEIGH = 0.2, (-2.0 * np.log(0.8)) ** 0.5
"""The noise of a spectrum is read off a low quantile, so that many lines do not count as noise: a fifth of the bins of
white noise of unit variance per component lie below sqrt(-2 ln 0.8)."""

NEIGHBOURS = 128
OTHER = 0.3
"""Phasors that differ by more than this part from those of the middle, their size apart, are not the tones alone."""

PORTION = 1 << 17
"""Samples read at a time."""

STEPS = 8
"""An edge is looked for in steps of this part of a frame."""


class Frames(NamedTuple):
    """How spectra are taken: samples of a frame, the fundamental (Hz), the step (s)."""

    n: int
    f1_hz: float
    dt_s: float

    @property
    def hop(self) -> int:
        """Samples from one frame to the next."""
        return max(1, self.n // OVERLAP)

    @property
    def frequencies(self) -> np.ndarray:
        """Of the bins (Hz, signed)."""
        return np.fft.fftfreq(self.n, self.dt_s)


class Spectrum(NamedTuple):
    """Amplitude of every bin (V) and the height from which on it is lit, both (n,)."""

    size: np.ndarray
    floor: np.ndarray


class Stretch(NamedTuple):
    """Samples between two changes."""

    start: int
    stop: int


def spectrum(v: np.ndarray, f1_hz: float, dt_s: float) -> Spectrum:
    """Spectrum (Hann) of a space vector (n,) without fundamental, mirror and offset."""
    plan = _plan(len(v), f1_hz, dt_s)
    size = np.abs(np.fft.fft(without_fundamental(v, f1_hz, dt_s) * plan.window)) / np.sum(plan.window)
    floor = STRONGER * ABOVE_NOISE * noise_floor(size) + 1e-7 * float(np.max(np.abs(v)))
    return Spectrum(size, np.where(plan.next_to_f1, np.inf, floor))


def without_fundamental(v: np.ndarray, f1_hz: float, dt_s: float) -> np.ndarray:
    """What is left of a space vector (n,) without a fundamental that drifts quadratically, its mirror and an offset."""
    plan = _plan(len(v), f1_hz, dt_s)
    return taken_off(v, plan.basis, plan.inverse_gram)[0]


class _Plan(NamedTuple):
    """What every frame of n samples needs: the taper, what a fundamental can be (5, n), the inverse of its Gram matrix,
    and which bins are next to it.
    """

    window: np.ndarray
    basis: np.ndarray
    inverse_gram: np.ndarray
    next_to_f1: np.ndarray


@lru_cache(maxsize=4)
def _plan(n: int, f1_hz: float, dt_s: float) -> _Plan:
    t = (np.arange(n) - 0.5 * (n - 1)) / n
    turn = np.exp(2j * np.pi * f1_hz * dt_s * n * t)
    basis = np.array([turn, turn * t, turn * t**2, turn.conj(), np.ones(n)])
    inverse_gram = np.linalg.inv(np.einsum("kn,jn->kj", basis.conj(), basis))
    bins = [np.abs(np.fft.fftfreq(n, dt_s) - line) * n * dt_s for line in (f1_hz, -f1_hz, 0.0)]
    return _Plan(np.hanning(n), basis, inverse_gram, np.min(bins, axis=0) < NEXT_TO_F1)


def noise_floor(size: np.ndarray) -> np.ndarray:
    """Median of the noise around every bin (n,), from a low quantile of its neighbourhood or, where that is more, of
    the next: a slope of the spectrum is no line.
    """
    n = len(size)
    width = min(NEIGHBOURS, n)
    place = int(QUANTILE * (width - 1))
    low = np.partition(size[: n // width * width].reshape(-1, width), place, axis=1)[:, place]
    low = np.max([low, np.roll(low, 1), np.roll(low, -1)], axis=0)
    return np.asarray(low[np.minimum(np.arange(n) // width, len(low) - 1)] * (2.0 * np.log(2.0)) ** 0.5 / RAYLEIGH)


def voltage(waveforms: Waveforms, start: int, stop: int) -> np.ndarray:
    """Voltage of a stretch (V); missing samples are drawn straight between their neighbours."""
    v = waveforms.record(start, stop).v
    good = np.isfinite(v)
    if good.all() or not good.any():
        return np.where(good, v, 0.0)
    at = np.arange(len(v))
    return np.asarray(np.interp(at, at[good], v.real[good]) + 1j * np.interp(at, at[good], v.imag[good]))


def steady_stretches(waveforms: Waveforms, frames: Frames) -> list[Stretch]:
    """Stretches without a change, in the order of time."""
    n, hop = waveforms.n_samples, frames.hop
    last: deque[Spectrum] = deque(maxlen=OVERLAP + 1)
    changed: list[bool] = []
    for v in _frames_of(waveforms, frames):
        last.append(spectrum(v, frames.f1_hz, frames.dt_s))
        if len(last) > OVERLAP:
            changed.append(_differ(last[0], last[-1]))
    edges = np.flatnonzero(np.diff(np.concatenate([[True], np.array(changed, dtype=bool), [True]]).astype(np.int8)))
    found = []
    for first, beyond in zip(edges[::2], edges[1::2], strict=True):
        start = 0 if first == 0 else (first + OVERLAP) * hop
        stop = n if beyond == len(changed) else (beyond - 1 + OVERLAP) * hop
        if stop - start >= frames.n // 2:
            found.append(Stretch(int(start), int(stop)))
    return found if changed else [Stretch(0, n)]


def _frames_of(waveforms: Waveforms, frames: Frames) -> Iterator[np.ndarray]:
    """Voltage (n,) of one frame after another, read in portions of many."""
    n, hop = waveforms.n_samples, frames.hop
    together = max(1, PORTION // hop)
    starts = range(0, n - frames.n + 1, hop)
    for first in range(0, len(starts), together):
        mine = starts[first : first + together]
        v = voltage(waveforms, mine[0], mine[-1] + frames.n)
        yield from (v[start - mine[0] : start - mine[0] + frames.n] for start in mine)


def _differ(before: Spectrum, after: Spectrum) -> bool:
    return _gone(before, after) or _gone(after, before)


def _gone(one: Spectrum, other: Spectrum) -> bool:
    """Whether a line that is lit in one is nowhere near in the other."""
    lit = np.flatnonzero(one.size > one.floor)
    if not len(lit):
        return False
    near = (lit[:, None] + np.arange(-BLUR, BLUR + 1)) % len(one.size)
    return bool(np.any(np.max(other.size[near], axis=1) * DARKER < one.size[lit]))


# Edges


def edges(waveforms: Waveforms, stretch: Stretch, tones_hz: np.ndarray, frames: Frames) -> Stretch:
    """First and last sample between which tones are on, found from within.

    A frame that a tone fills by a part c of its length shows the part c - sin(2 pi c) / (2 pi) of its phasor under a
    Hann taper, half of it where the edge is in the middle of the frame. Where the phasors leave that line something
    else happens in the frame, and the edge is taken well before it.
    """
    start = _edge(waveforms, stretch, tones_hz, frames, -1)
    stop = _edge(waveforms, stretch, tones_hz, frames, 1)
    return Stretch(start, stop)


def _edge(waveforms: Waveforms, stretch: Stretch, tones_hz: np.ndarray, frames: Frames, way: int) -> int:
    n, last = frames.n, waveforms.n_samples - frames.n
    middle = min(max((stretch.start + stretch.stop - n) // 2, 0), last)
    full = _phasors(voltage(waveforms, middle, middle + n), middle, tones_hz, frames)
    at = min(max(stretch.start if way < 0 else stretch.stop - n, 0), last)
    begin, end = max(0, min(at, at + way * 3 * n)), min(waveforms.n_samples, max(at, at + way * 3 * n) + n)
    around = voltage(waveforms, begin, end)

    def part_at(start: int) -> tuple[float, float]:
        return _part(full, _phasors(around[start - begin : start - begin + n], start, tones_hz, frames))

    level, _ = part_at(at)
    for _ in range(3 * STEPS):
        beyond = min(max(at + way * max(1, n // STEPS), begin), end - n)
        if beyond == at:
            break
        part, other = part_at(beyond)
        if other > OTHER:
            return round(at + (0.5 + way * 0.25) * n)
        if part < 0.5 <= level:
            return round(at + (beyond - at) * (level - 0.5) / (level - part) + 0.5 * n)
        at, level = beyond, part
    filled = _filled(level) * n
    return round(at + n - filled) if way < 0 else round(at + filled)


def _part(full: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """How much of phasors (k,) is there now, and how much else: the median of the tones, as two may beat."""
    ratio = now / np.where(full == 0.0, 1e-300, full)
    part = float(np.median(ratio.real))
    return part, float(np.median(np.abs(ratio - part)))


def _phasors(v: np.ndarray, start: int, tones_hz: np.ndarray, frames: Frames) -> np.ndarray:
    """Phasors (k,) of the tones in a frame that begins at a sample, phase zero at the beginning of the record."""
    rest = without_fundamental(v, frames.f1_hz, frames.dt_s) * _plan(frames.n, frames.f1_hz, frames.dt_s).window
    local = np.einsum("kn,n->k", _turns(frames, tuple(tones_hz)), rest)
    return np.asarray(local * np.exp(-2j * np.pi * frames.dt_s * start * tones_hz))


@lru_cache(maxsize=2)
def _turns(frames: Frames, tones_hz: tuple[float, ...]) -> np.ndarray:
    return np.asarray(np.exp(-2j * np.pi * frames.dt_s * np.outer(tones_hz, np.arange(frames.n))))


def _filled(level: float) -> float:
    """Part of a frame that a tone fills, by the part of its amplitude that the frame shows; all of it from 0.97 on."""
    part = np.linspace(0.0, 1.0, 257)
    shown = part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)
    return 1.0 if level > 0.97 else float(np.interp(level, shown, part))
