"""TDMS (LabVIEW), with the extra ``formats``: every channel has a start and a step of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .alignment import Series, recording_of_series
from .names import base_from, channels_of, time_column
from .number_table import refuse_too_large
from .recording import Channel, Recording, RecordingError

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a TDMS recording (see `read_recording`)."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise RecordingError(f"{path}: TDMS needs the extra: pip install 'seqsweep[formats]'") from None
    refuse_too_large(path, path.stat().st_size)
    try:
        file = TdmsFile.read(path, raw_timestamps=True)
        found = [
            each for group in file.groups() for each in group.channels() if len(each) > 1 and each.dtype.kind in "fiu"
        ]
        series = _series(path, found, sample_rate_hz)
    except RecordingError:
        raise
    except Exception as error:
        words = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: not a TDMS file, or a damaged one ({type(error).__name__}: {words})") from None
    return recording_of_series(path, "TDMS", series)


def _series(path: Path, found: Sequence[Any], sample_rate_hz: float | None) -> list[Series]:
    """Channels with their times: of the waveform's own properties, else of a channel of times."""
    units = [str(next((each.properties[key] for key in _UNITS if each.properties.get(key)), "")) for each in found]
    channels = channels_of([each.name for each in found], units)
    stepless = [k for k, each in enumerate(found) if not _step_s(each) > 0.0]
    at = time_column(channels)
    base = None
    if at is not None and stepless and sample_rate_hz is None:
        base = base_from(path, channels[at], [_values(found[at])], None)
    series = []
    for k, (each, channel) in enumerate(zip(found, channels, strict=True)):
        step_s = 1.0 / sample_rate_hz if sample_rate_hz else (_step_s(each) or (base.dt_s if base else 0.0))
        if k == at or (base is not None and k in stepless and len(each) != len(found[at or 0])):
            continue
        if not step_s > 0.0:
            raise RecordingError(
                f"{path}: {each.name!r} has no step (wf_increment), and no channel is the time: give --sample-rate HZ"
            )
        start_s = base.t0_s if base is not None and k in stepless else _offset_s(each)
        series.append(Series(_qualified(channel, each, found), start_s, step_s, len(each), _reader(each)))
    return _from_first(series, [each for k, each in enumerate(found) if k != at])


def _qualified(channel: Channel, each: Any, found: Sequence[Any]) -> Channel:
    """A channel by its name; by group and name where two groups have a channel of that name."""
    from dataclasses import replace

    if sum(other.name == each.name for other in found) == 1:
        return channel
    return replace(channel, name=f"{each.group_name}:{channel.name}", written=f"{each.group_name}:{each.name}")


def _from_first(series: list[Series], found: Sequence[Any]) -> list[Series]:
    """Starts counted from the first of all, where every channel tells its date; dates are exact, floats are not."""
    stamps = [each.properties.get("wf_start_time") for each in found]
    if len(stamps) != len(series) or any(stamp is None for stamp in stamps):
        return series
    ticks = [int(stamp.seconds) * 2**64 + int(stamp.second_fractions) for stamp in stamps]
    return [
        each._replace(start_s=each.start_s + float(tick - min(ticks)) / 2.0**64)
        for each, tick in zip(series, ticks, strict=True)
    ]


def _step_s(channel: Any) -> float:
    step = float(channel.properties.get("wf_increment", 0.0))
    return step if np.isfinite(step) and step > 0.0 else 0.0


def _offset_s(channel: Any) -> float:
    offset = float(channel.properties.get("wf_start_offset", 0.0))
    return offset if np.isfinite(offset) else 0.0


def _values(channel: Any) -> np.ndarray:
    return np.asarray(channel[:], dtype=float)


def _reader(channel: Any) -> Any:
    return lambda start, stop: np.asarray(channel[start:stop], dtype=float)
