"""Named arrays, as MATLAB, HDF5 and the like hold them, to a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .names import channels_of, time_column
from .recording import BLOCK, Channel, Recording, RecordingError
from .timebase import TimeBase, seconds_per, time_base

SMALLEST = 16
"""Arrays shorter than this are parameters, not waveforms."""

_RATES = ("fs", "fs_hz", "sample_rate", "sample_rate_hz", "samplerate", "sampling_rate")
_STEPS = ("dt", "ts", "dt_s", "tsample", "sampletime", "increment")


def recording_of(
    path: Path,
    file_format: str,
    arrays: Mapping[str, Any],
    scalars: Mapping[str, float],
    units: Mapping[str, str],
    sample_rate_hz: float | None,
    notes: Sequence[str] = (),
) -> Recording:
    """A recording of equally long arrays (n,), (n, c) or (c, n), which may live in a file and are sliced when asked.

    Parameters
    ----------
    arrays : mapping of str to array-like
        Anything with ``shape`` and slicing. One called time or t, or the first row or column of a matrix
        that counts up uniformly, is the time.
    scalars : mapping of str to float
        Where a sampling rate or step (``fs``, ``dt``, ...) may be found.
    units : mapping of str to str
        Units of the arrays that have one.
    """
    rows = {
        name: array for name, array in arrays.items() if len(array.shape) in (1, 2) and max(array.shape) >= SMALLEST
    }
    if not rows:
        found = ", ".join(f"{name} {tuple(array.shape)}" for name, array in arrays.items())
        raise RecordingError(f"{path}: no array of numbers that could be a waveform; found {found[:200] or 'nothing'}")
    n = max(max(array.shape) for array in rows.values())
    used = {name: array for name, array in rows.items() if max(array.shape) == n}
    views = [(name, _View(array, n, k)) for name, array in used.items() for k in range(array.size // n)]
    written = [name if used[name].size == n else f"{name}{view.number}" for name, view in views]
    channels = channels_of(written, [units.get(name, "") for name, _ in views])
    at = time_column(channels)
    if at is None:
        at = next((k for k, (name, view) in enumerate(views) if used[name].size > n and _counts_up(view)), None)
    base = _base(path, None if at is None else (channels[at], views[at][1], n), scalars, sample_rate_hz)
    kept = [k for k in range(len(views)) if k != at]

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return np.array([views[kept[k]][1].read(start, stop) for k in columns]).T

    left = sorted(set(rows) - set(used))
    more = (f"shorter arrays are left out: {', '.join(left[:6])}",) if left else ()
    return Recording(
        path=path,
        format=file_format,
        channels=tuple(channels[k] for k in kept),
        n_samples=n,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=samples,
        notes=(*notes, *more, *base.notes),
    )


class _View:
    """One waveform of an array: itself, or a row or column of it."""

    def __init__(self, array: Any, n: int, number: int):
        self._array, self.number = array, number
        self._along = 0 if len(array.shape) == 1 or array.shape[0] == n else 1

    def read(self, start: int, stop: int) -> np.ndarray:
        if len(self._array.shape) == 1:
            values = self._array[start:stop]
        elif self._along == 0:
            values = self._array[start:stop, self.number]
        else:
            values = self._array[self.number, start:stop]
        return np.asarray(values, dtype=float)


def _counts_up(view: _View) -> bool:
    """Whether the first samples of a waveform are uniform times."""
    steps = np.diff(view.read(0, SMALLEST))
    return bool(steps[0] > 0.0 and np.all(np.abs(steps - steps[0]) <= 1e-3 * steps[0]))


def _base(
    path: Path, time: tuple[Channel, _View, int] | None, scalars: Mapping[str, float], sample_rate_hz: float | None
) -> TimeBase:
    if sample_rate_hz is not None:
        return TimeBase(0.0, 1.0 / sample_rate_hz, (f"{sample_rate_hz:g} samples per second, as asked",))
    if time is not None:
        channel, view, n = time
        unit = seconds_per(channel.unit)
        return time_base(path, (view.read(k, min(k + BLOCK, n)) * unit for k in range(0, n, BLOCK)))
    named = {name.lower(): value for name, value in scalars.items()}
    steps = [1.0 / named[name] for name in _RATES if named.get(name, 0.0) > 0.0]
    steps += [named[name] for name in _STEPS if named.get(name, 0.0) > 0.0]
    if not steps:
        raise RecordingError(
            f"{path}: no array of time ('time' or 't') and no sampling rate ('fs'): give --sample-rate HZ"
        )
    return TimeBase(0.0, steps[0])
