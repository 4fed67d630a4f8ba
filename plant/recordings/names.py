"""Name and unit out of what people write above a column."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .recording import Channel, RecordingError
from .timebase import TimeBase, is_time, seconds_per, time_base

_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$")
_SUFFIX = re.compile(r"^(.+?)(?:\s*/\s*|[ _])(mV|V|kV|mA|A|kA|pu|p\.u\.|s|ms|us|ns)$")


def name_and_unit(written: str) -> tuple[str, str]:
    """("Va", "kV") of "Va [kV]", "Va (kV)", "Va/kV" and "Va_kV"; an unknown unit is empty."""
    written = written.strip().strip('"').strip()
    for pattern in (_BRACKETS, _SUFFIX):
        if found := pattern.match(written):
            return found[1].strip(), found[2].strip()
    return written, ""


def channels_of(names: list[str], units: list[str] | None = None) -> list[Channel]:
    """Channels of column headings; ``units`` where they stand apart."""
    pairs = [name_and_unit(name) for name in names]
    return [Channel(name, (units[k] if units else "") or unit) for k, (name, unit) in enumerate(pairs)]


def time_column(channels: list[Channel]) -> int | None:
    """Number of the column that holds the time, by its name; the first where there are several."""
    return next((k for k, channel in enumerate(channels) if is_time(channel.name)), None)


def base_from(
    path: Path, channel: Channel | None, blocks: Iterable[np.ndarray] | None, sample_rate_hz: float | None
) -> TimeBase:
    """Time base out of a column of times, or of the rate the user names."""
    if sample_rate_hz is not None:
        return TimeBase(0.0, 1.0 / sample_rate_hz, (f"{sample_rate_hz:g} samples per second, as asked",))
    if channel is None or blocks is None:
        raise RecordingError(f"{path}: no column of time ('time' or 't'): give --sample-rate HZ")
    unit = seconds_per(channel.unit)
    return time_base(path, (block * unit for block in blocks))
