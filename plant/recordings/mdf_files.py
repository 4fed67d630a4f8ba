"""MDF4 (measurement of ECUs), with the extra ``formats``: channel groups, each with times of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .alignment import Series, recording_of_series
from .names import channels_of
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError
from .timebase import TimeBase, is_time, time_base


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open an MDF4 recording (see `read_recording`)."""
    try:
        from asammdf import MDF
    except ImportError:
        raise RecordingError(f"{path}: MDF4 needs the extra: pip install 'seqsweep[formats]'") from None
    try:
        file = MDF(path)
        _refuse_large(path, file)
        groups = [_signals(file, number) for number in range(len(file.groups))]
    except RecordingError:
        raise
    except Exception as error:
        words = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: not an MDF4 file, or a damaged one ({type(error).__name__}: {words})") from None
    series: list[Series] = []
    refusals: list[str] = []
    for signals in filter(None, groups):
        try:
            base = _base(path, signals, sample_rate_hz)
        except RecordingError as error:
            refusals.append(str(error).removeprefix(f"{path}: "))
            continue
        channels = channels_of([each.name for each in signals], [each.unit or "" for each in signals])
        series += [
            Series(channel, base.t0_s, base.dt_s, len(each.samples), _reader(each.samples))
            for channel, each in zip(channels, signals, strict=True)
        ]
    if not series:
        raise RecordingError(f"{path}: {refusals[0] if refusals else 'no channels of numbers'}")
    notes = tuple(f"a channel group is left out: {each}" for each in refusals[:3])
    return recording_of_series(path, "MDF4", _told_apart(series), notes)


def _refuse_large(path: Path, file: Any) -> None:
    n_values = sum(group.channel_group.cycles_nr * len(group.channels) for group in file.groups)
    if n_values * 8 > TEXT_LIMIT_BYTES:
        raise RecordingError(f"{path}: {n_values} values do not fit into memory; cut it into several files")


def _signals(file: Any, number: int) -> list[Any]:
    """Waveforms of one channel group; its times are with each of them."""
    if file.groups[number].channel_group.cycles_nr < 2:
        return []
    found = file.select([(None, number, k) for k in range(len(file.groups[number].channels))])
    return [
        each for each in found if each.samples.dtype.kind in "fiu" and each.samples.ndim == 1 and not is_time(each.name)
    ]


def _base(path: Path, signals: list[Any], sample_rate_hz: float | None) -> TimeBase:
    times = np.asarray(signals[0].timestamps, dtype=float)
    if sample_rate_hz is not None:
        return TimeBase(float(times[0]), 1.0 / sample_rate_hz)
    return time_base(path, [times])


def _told_apart(series: list[Series]) -> list[Series]:
    """Names that two groups share get a number."""
    names = [each.channel.name for each in series]
    return [
        each
        if names.count(each.channel.name) == 1
        else each._replace(channel=replace(each.channel, name=f"{names[:k].count(names[k]) + 1}:{names[k]}"))
        for k, each in enumerate(series)
    ]


def _reader(values: np.ndarray) -> Any:
    return lambda start, stop: np.asarray(values[start:stop], dtype=float)
