"""Named arrays, as MATLAB, HDF5 and the like hold them, to a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .alignment import Series, recording_of_series
from .names import channels_of
from .recording import BLOCK, Channel, Recording, RecordingError
from .timebase import TimeBase, is_time, seconds_per, time_base

SMALLEST = 16
"""Arrays shorter than this are parameters, not waveforms."""

MOST_CHANNELS = 4096
"""A file that seems to hold more waveforms than this holds something else."""

_RATES = ("fs", "fs_hz", "sample_rate", "sample_rate_hz", "samplerate", "sampling_rate", "sampling_frequency")
_STEPS = ("dt", "ts", "dt_s", "tsample", "sampletime", "sample_time", "increment", "wf_increment")


class Named(NamedTuple):
    """An array, which may live in a file and is sliced when asked.

    Attributes
    ----------
    name : str
        Of its waveform, or of its waveforms together.
    data : array-like
        Anything with ``shape``, ``dtype`` and slicing: a vector, or a matrix with the time along its longest side.
        Complex numbers are space vectors, alpha + j beta.
    unit : str
        Empty where nobody says.
    parent : str
        The structure or group it stands in: its time is there too.
    """

    name: str
    data: Any
    unit: str = ""
    parent: str = ""


def recording_of(
    path: Path,
    file_format: str,
    arrays: Sequence[Named],
    scalars: Mapping[str, float],
    sample_rate_hz: float | None,
    notes: Sequence[str] = (),
) -> Recording:
    """A recording of equally long arrays.

    Parameters
    ----------
    arrays : sequence of Named
        One called time or t, or the first row or column of a matrix that counts up uniformly, is the time. Where
        several structures have times of their own, their waveforms are brought to common instants.
    scalars : mapping of str to float
        Where a sampling rate or step (``fs``, ``dt``, ...) may be found.
    """
    long = [each for each in arrays if each.data.shape and max(each.data.shape) >= SMALLEST]
    if not long:
        found = ", ".join(f"{each.name} {tuple(each.data.shape)}" for each in arrays)
        raise RecordingError(f"{path}: no array of numbers that could be a waveform; found {found[:200] or 'nothing'}")
    if sample_rate_hz is None and (series := _own_times(path, long)):
        return recording_of_series(path, file_format, series, notes)
    n = max(max(each.data.shape) for each in long)
    used = [each for each in long if n in each.data.shape]
    views, channels = _waveforms(path, used, n)
    times = [k for k, channel in enumerate(channels) if is_time(channel.name)]
    at = times[0] if times else next((k for k, view in enumerate(views) if view.several and _counts_up(view)), None)
    base = _base(path, None if at is None else (channels[at], views[at], n), scalars, sample_rate_hz)
    kept = [k for k in range(len(views)) if k != at and k not in times]

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return np.array([views[kept[k]].read(start, stop) for k in columns]).T

    left = sorted({each.name for each in long} - {each.name for each in used})
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
        hints=more,
    )


def _waveforms(path: Path, arrays: Sequence[Named], n: int) -> tuple[list[_View], list[Channel]]:
    """Every waveform of length n, and its channel."""
    if sum(each.data.size // n for each in arrays) > MOST_CHANNELS:
        raise RecordingError(f"{path}: more than {MOST_CHANNELS} waveforms of {n} samples: no recording")
    views = [view for each in arrays for view in _views(path, each, n)]
    units = [view.unit for view in views]
    return views, channels_of([view.name for view in views], units)


class _View(NamedTuple):
    """One waveform of an array: itself, or a row or column of it; of a complex one its real or imaginary part."""

    path: Path
    name: str
    unit: str
    data: Any
    along: int
    others: tuple[int, ...]
    part: str
    several: bool

    def read(self, start: int, stop: int) -> np.ndarray:
        """Samples ``start`` to ``stop``."""
        index: list[Any] = list(self.others)
        index.insert(self.along, slice(start, stop))
        try:
            values = self.data[tuple(index)]
        except (OSError, RuntimeError) as error:  # a piece of a file that does not decompress
            words = " ".join(str(error).split())[:120]
            raise RecordingError(f"{self.path}: {self.name}: damaged, cannot be read ({words})") from None
        return np.asarray(_real_part(values, self.part), dtype=float)


def _real_part(values: Any, part: str) -> Any:
    """A part of complex numbers, which HDF5 keeps as records of two."""
    if not part:
        return values
    if values.dtype.names:
        return values[values.dtype.names[0 if part == "real" else 1]]
    return values.real if part == "real" else values.imag


def _views(path: Path, each: Named, n: int) -> list[_View]:
    shape = each.data.shape
    along = shape.index(n)
    rest = shape[:along] + shape[along + 1 :]
    count = prod(rest)
    parts = (("real", "_alpha"), ("imag", "_beta")) if is_complex(each.data.dtype) else (("", ""),)
    return [
        _View(
            path,
            f"{each.name}{number if count > 1 else ''}{suffix}",
            each.unit,
            each.data,
            along,
            tuple(int(k) for k in np.unravel_index(number, rest)),
            part,
            count > 1,
        )
        for number in range(count)
        for part, suffix in parts
    ]


def is_complex(kind: np.dtype) -> bool:
    """Whether numbers of that type are complex, HDF5's records of two reals included."""
    names = tuple(name.lower() for name in kind.names or ())
    return kind.kind == "c" or names in (("real", "imag"), ("r", "i"), ("re", "im"))


def is_numeric(kind: np.dtype) -> bool:
    """Whether an array of that type may be a waveform."""
    return kind.kind in "fiu" or is_complex(kind)


def _counts_up(view: _View) -> bool:
    """Whether the first samples of a waveform are uniform times."""
    steps = np.diff(view.read(0, SMALLEST))
    return bool(steps[0] > 0.0 and np.all(np.abs(steps - steps[0]) <= 1e-3 * steps[0]))


# Time


def _base(
    path: Path, time: tuple[Channel, _View, int] | None, scalars: Mapping[str, float], sample_rate_hz: float | None
) -> TimeBase:
    if sample_rate_hz is not None:
        return TimeBase(0.0, 1.0 / sample_rate_hz, (f"{sample_rate_hz:g} samples per second, as asked",))
    if time is not None:
        channel, view, n = time
        return _scanned(path, channel, view, n)
    named = {name.rsplit("/", 1)[-1].rsplit(".", 1)[-1].lower(): value for name, value in scalars.items()}
    steps = [1.0 / named[name] for name in _RATES if named.get(name, 0.0) > 0.0]
    steps += [named[name] for name in _STEPS if named.get(name, 0.0) > 0.0]
    if not steps or not np.isfinite(steps[0]) or not steps[0] > 0.0:
        raise RecordingError(
            f"{path}: no array of time ('time' or 't') and no sampling rate ('fs'): give --sample-rate HZ"
        )
    return TimeBase(0.0, steps[0])


def _scanned(path: Path, channel: Channel, view: _View, n: int) -> TimeBase:
    unit = seconds_per(channel.unit, path)
    return time_base(path, (view.read(k, min(k + BLOCK, n)) * unit for k in range(0, n, BLOCK)))


def _own_times(path: Path, arrays: Sequence[Named]) -> list[Series]:
    """Waveforms with the times of the structures they stand in; none where there is but one time for all."""
    times = [
        each for each in arrays if is_time(channels_of([each.name])[0].name) and max(each.data.shape) == each.data.size
    ]
    parents = [each.parent for each in times]
    if len(times) < 2 or len(set(parents)) < len(times) or _all_equal(times):
        return []
    series = []
    for time in times:
        n = time.data.size
        members = [each for each in arrays if each.parent == time.parent and each is not time and n in each.data.shape]
        if not members:
            continue
        (view,), (channel,) = _waveforms(path, [time], n)
        base = _scanned(path, channel, view, n)
        views, channels = _waveforms(path, members, n)
        series += [
            Series(replace(channel, name=channel.name), base.t0_s, base.dt_s, n, view.read)
            for channel, view in zip(channels, views, strict=True)
        ]
    return series


def _all_equal(times: Sequence[Named]) -> bool:
    """Whether arrays of times are the same, by length, first, second and last."""
    seen = set()
    for each in times:
        flat = np.ravel(each.data[...] if each.data.size <= BLOCK else each.data[()])
        seen.add((each.data.size, float(flat[0]), float(flat[1]), float(flat[-1])))
    return len(seen) == 1
