"""Name and unit out of what people write above a column."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from .recording import Channel, RecordingError
from .timebase import TimeBase, is_time, seconds_per, time_base

_UNIT = r"mV|V|kV|MV|mA|A|kA|pu|p\.u\.|s|sec|ms|us|µs|μs|ns|min|volts?|amps?|amperes?|seconds?"
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$")
_SUFFIX = re.compile(rf"^(.+?)(?:\s*/\s*|\s*,\s*|\s+in\s+|[ _])({_UNIT})$")
_IN = re.compile(r"^(.+?)\s+in\s+(\S{1,8})$")
_PHASE = re.compile(r"^(.+[ _])([AVav])$")
_SIBLINGS = {"a": "bc", "v": "uw"}
"""A name that ends in A is one of three phases where others end in B or C; so is V beside U or W."""


def name_and_unit(written: str, among: Iterable[str] = ()) -> tuple[str, str]:
    """("Va", "kV") of "Va [kV]", "Va (kV)", "Va/kV", "Va, kV", "Va in kV" and "Va_kV"; an unknown unit is empty.

    ``among`` are the names beside it: "V_A" has no unit where there is a "V_B".
    """
    written = _stripped(written)
    patterns = (_BRACKETS, _IN) if _is_phase(written, among) else (_BRACKETS, _IN, _SUFFIX)
    for pattern in patterns:
        if (found := pattern.match(written)) and found[1].strip():
            return found[1].strip(), found[2].strip()
    return written, ""


def _stripped(written: str) -> str:
    return written.strip().strip('"').strip()


def _is_phase(written: str, among: Iterable[str]) -> bool:
    """Whether the letter at the end of a name is its phase, by its siblings."""
    found = _PHASE.match(written)
    if found is None:
        return False
    siblings = {(found[1] + letter).lower() for letter in _SIBLINGS[found[2].lower()]}
    return any(_stripped(other).lower() in siblings for other in among)


def channels_of(names: Sequence[str], units: Sequence[str] | None = None) -> list[Channel]:
    """Channels of column headings; ``units`` where they stand apart."""
    pairs = [name_and_unit(name, names) for name in names]
    return [
        Channel(name, (units[k].strip("()[] ") if units else "") or unit, written=_stripped(names[k]))
        for k, (name, unit) in enumerate(pairs)
    ]


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
    unit = seconds_per(channel.unit, path)
    return time_base(path, (block * unit for block in blocks))
