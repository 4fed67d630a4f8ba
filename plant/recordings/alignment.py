"""Channels that were sampled at different instants, brought to common ones.

Whole samples are shifted; the rest is interpolated as the sampling theorem has it, x(t) = sum x_k sinc(t / T - k), with
a Kaiser window over the sinc: exact for what lies below `PASSBAND` of the sampling rate.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .recording import Channel, Recording, RecordingError, Samples, names_of

HALF = 64
"""Samples to either side that an interpolated one is made of."""

KAISER = 12.3
"""Shape of the window: 120 dB between what passes and what does not."""

PASSBAND = 0.47
"""Frequency, relative to the sampling rate, up to which interpolation is good to 1e-6."""

SAME = 1e-5
"""Instants this close, in steps, are the same."""

OVERLAP = 0.8
"""A channel that covers less of the longest one is another measurement."""


class Series(NamedTuple):
    """One channel with a time of its own: ``read(start, stop)`` are its samples, the first at ``start_s`` (s)."""

    channel: Channel
    start_s: float
    step_s: float
    n: int
    read: Callable[[int, int], np.ndarray]

    @property
    def end_s(self) -> float:
        return self.start_s + self.n * self.step_s


def recording_of_series(path: Path, file_format: str, series: Sequence[Series], notes: Sequence[str] = ()) -> Recording:
    """A recording of channels that have a start and a step each.

    Those of the most common step that overlap with the longest of them are brought to common instants; the others are
    left out, by name.

    Raises
    ------
    RecordingError
        If there are no channels.
    """
    if not series:
        raise RecordingError(f"{path}: no channels of numbers")
    used, hints = _comparable(series)
    step_s = used[0].step_s

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return np.array([used[k].read(start, stop) for k in columns], dtype=float).T

    start_s = min(each.start_s for each in used)
    return aligned(
        Recording(
            path=path,
            format=file_format,
            channels=tuple(each.channel for each in used),
            n_samples=used[0].n,
            t0_s=start_s,
            dt_s=step_s,
            samples=samples,
            notes=(*notes, *hints),
            hints=hints,
        ),
        [each.start_s - start_s for each in used],
        [each.n for each in used],
    )


def _comparable(series: Sequence[Series]) -> tuple[list[Series], tuple[str, ...]]:
    """Series of the step that most samples have, and what is to be said of the others."""
    samples: Counter[float] = Counter()
    for each in series:
        samples[_rounded(each.step_s)] += each.n
    step = samples.most_common(1)[0][0]
    same = [each for each in series if _rounded(each.step_s) == step]
    longest = max(same, key=lambda each: each.n)
    used = [each for each in same if _common_s(each, longest) >= OVERLAP * longest.n * longest.step_s]
    kept = {id(each) for each in used}
    hints = []
    for other in sorted({_rounded(each.step_s) for each in series} - {step}):
        names = names_of([each.channel for each in series if _rounded(each.step_s) == other], 6)
        hints.append(f"{names} sampled at {1 / other:.6g} Hz, the others at {1 / step:.6g} Hz: left out")
    if apart := [each.channel for each in same if id(each) not in kept]:
        hints.append(f"{names_of(apart, 6)} recorded at another time than {longest.channel.name!r}: left out")
    return used, tuple(hints)


def _rounded(step_s: float) -> float:
    return float(f"{step_s:.9g}")


def _common_s(a: Series, b: Series) -> float:
    return min(a.end_s, b.end_s) - max(a.start_s, b.start_s)


def aligned(recording: Recording, offsets_s: Sequence[float], lengths: Sequence[int] | None = None) -> Recording:
    """A recording whose channels share their instants.

    Parameters
    ----------
    recording : Recording
        Its sample n of channel k was taken at ``t0_s + offsets_s[k] + n dt_s``.
    offsets_s : sequence of float
        Per channel (s).
    lengths : sequence of int, optional
        Samples per channel where they differ.

    Raises
    ------
    RecordingError
        If the channels have no time in common.
    """
    lengths = lengths if lengths is not None else [recording.n_samples] * len(recording.channels)
    dt_s = recording.dt_s
    steps = np.asarray(offsets_s, dtype=float) / dt_s
    reference = Counter(np.round(steps, 4).tolist()).most_common(1)[0][0]
    base = float(steps[np.argmin(np.abs(steps - reference))])
    shifts = [_Shift.of(step - base) for step in steps]
    first = max(shift.whole + shift.margin for shift in shifts)
    last = min(n + shift.whole - shift.margin for n, shift in zip(lengths, shifts, strict=True))
    if last - first < 2:
        raise RecordingError(f"{recording.path}: its channels were not recorded at the same time")
    return Recording(
        path=recording.path,
        format=recording.format,
        channels=recording.channels,
        n_samples=last - first,
        t0_s=recording.t0_s + (base + first) * dt_s,
        dt_s=dt_s,
        samples=_shifted(recording.samples, shifts, first),
        header_f1_hz=recording.header_f1_hz,
        notes=(*recording.notes, *_in_words(recording, shifts)),
        hints=recording.hints,
    )


class _Shift(NamedTuple):
    """How much later than the others a channel was sampled: whole steps, and the fraction of one."""

    whole: int
    fraction: float

    @classmethod
    def of(cls, steps: float) -> _Shift:
        whole = round(steps)
        fraction = float(steps - whole)
        return cls(whole, fraction if abs(fraction) > SAME else 0.0)

    @property
    def margin(self) -> int:
        """Samples at either end that cannot be interpolated."""
        return HALF if self.fraction else 0

    @property
    def kernel(self) -> np.ndarray:
        """Weights (2 HALF,) of samples n - HALF + 1 ... n + HALF for the value a fraction earlier than sample n."""
        u = np.arange(-HALF + 1, HALF + 1) + self.fraction
        inside = np.sqrt(np.maximum(0.0, 1.0 - (u / HALF) ** 2))
        weights = np.sinc(u) * np.i0(KAISER * inside)
        return np.asarray(weights / np.sum(weights))


def _shifted(samples: Samples, shifts: Sequence[_Shift], first: int) -> Samples:
    """`Samples` on the common instants, the first of which is number ``first``."""
    if not any(shift.whole or shift.fraction for shift in shifts) and first == 0:
        return samples

    def read(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        found = np.empty((stop - start, len(columns)))
        for shift in {shifts[k] for k in columns}:
            at = [place for place, k in enumerate(columns) if shifts[k] == shift]
            begin = first + start - shift.whole
            if shift.fraction:
                raw = samples([columns[k] for k in at], begin - HALF + 1, begin + stop - start + HALF)
                found[:, at] = _interpolated(raw, shift.kernel)
            else:
                found[:, at] = samples([columns[k] for k in at], begin, begin + stop - start)
        return found

    return read


def _interpolated(raw: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    return np.column_stack([np.convolve(column, kernel[::-1], mode="valid") for column in raw.T])


def _in_words(recording: Recording, shifts: Sequence[_Shift]) -> tuple[str, ...]:
    """What was moved, and by how much."""
    notes = []
    for shift in dict.fromkeys(shifts):
        moved = [channel for channel, each in zip(recording.channels, shifts, strict=True) if each == shift]
        if steps := shift.whole + shift.fraction:
            late = f"{abs(steps) * recording.dt_s * 1e6:.6g} us {'later' if steps > 0 else 'earlier'} than the others"
            notes.append(f"{names_of(moved, 6)} sampled {late}: brought to common instants")
    return tuple(notes)
