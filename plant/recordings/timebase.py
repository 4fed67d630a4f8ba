"""From a column of times to one sampling step, or to the reason why there is none."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .recording import RecordingError

_SECONDS = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds", "sek", "sekunden"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "µsec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hour", "hours"), 3600.0),
}
_TIME = re.compile(
    r"t|tid|zeit|temps|tiempo|tempo|tnow|time[ _-]?(stamp|axis|vector)?|(sim(ulation)?|elapsed|rel(ative)?|abs(olute)?)"
    r"[ _-]?time|zeit(stempel|achse)?|domain|x[ _-]?(axis|value)s?|sec(ond)?s?|date[ _-]?(and[ _-]?)?time|datetime"
)
"""Names of a column of time, without what stands before the last colon, point or stroke."""

ROUNDED = "times are rounded"
"""How the note on times that are not quite uniform begins; `uneven` then asks the samples whether that is all."""

LOOSE = 0.75
"""Largest distance of a time from its place on the uniform scale, in steps: printed times are rounded."""


LOOKED_AT = 64
"""Times of a block that are held against the uniform scale of them all."""


class TimeBase(NamedTuple):
    """Time of the first sample and step (s), and what is to be said about them."""

    t0_s: float
    dt_s: float
    notes: tuple[str, ...] = ()


def is_time(name: str) -> bool:
    """Whether a column of that name holds the time."""
    last = re.split(r"[:./|\\\\]", name.strip().lower())[-1].strip()
    return _TIME.fullmatch(last) is not None


def seconds_per(unit: str, path: Path) -> float:
    """Factor from a unit of time to seconds; 1 where the unit is not given.

    Raises
    ------
    RecordingError
        If there is no such unit of time.
    """
    factor = _SECONDS.get(unit.strip().strip(".").lower())
    if factor is None:
        raise RecordingError(
            f"{path}: the time is in {unit!r}, which is no unit known here (s, ms, us, ns, min, h): give --sample-rate "
            "HZ"
        )
    return factor


def time_base(path: Path, blocks: Iterable[np.ndarray]) -> TimeBase:
    """Time base of times (s) that come in blocks.

    Raises
    ------
    RecordingError
        If a time is missing, time runs backwards or stands still, there is a gap, or the step varies.
    """
    first, last, n = np.nan, np.nan, 0
    shortest, longest, longest_at = np.inf, 0.0, np.nan
    places: list[np.ndarray] = []
    for block in blocks:
        if not np.all(np.isfinite(block)):
            raise RecordingError(f"{path}: the time of sample {n + int(np.argmin(np.isfinite(block)))} is missing")
        steps = np.diff(block, prepend=block[:1] if n == 0 else last)[1 if n == 0 else 0 :]
        if len(steps) and np.min(steps) <= 0.0:
            k = int(np.argmax(steps <= 0.0)) + (1 if n == 0 else 0)
            raise RecordingError(
                f"{path}: time runs backwards or stands still at sample {n + k} ({block[k]:.9g} s): "
                "the file holds several recordings (cut it there), its times are printed too coarsely (give "
                "--sample-rate HZ), or it is damaged"
            )
        if len(steps):
            shortest = min(shortest, float(np.min(steps)))
            if np.max(steps) > longest:
                longest, longest_at = float(np.max(steps)), float(block[len(block) - len(steps) + np.argmax(steps)])
        if len(block):
            some = np.unique(np.linspace(0, len(block) - 1, LOOKED_AT).astype(int))
            places.append(np.column_stack([n + some, block[some]]))
            first, last, n = (float(block[0]) if n == 0 else first), float(block[-1]), n + len(block)
    if n < 2:
        raise RecordingError(f"{path}: {n} samples make no recording")
    base = _judge(path, TimeBase(first, (last - first) / (n - 1)), shortest, longest, longest_at)
    if not base.notes:
        return base
    fitted = np.concatenate(places)
    _refuse_drift(path, base, fitted, longest - shortest)
    slope, start = np.polyfit(fitted[:, 0], fitted[:, 1], 1)  # the ends alone are rounded
    return base._replace(t0_s=float(start), dt_s=float(slope))


def _refuse_drift(path: Path, base: TimeBase, places: np.ndarray, rounding_s: float) -> None:
    """Refuse steps that vary slowly: rounded times stay near the uniform scale, wherever one looks."""
    away = np.abs(places[:, 1] - base.t0_s - base.dt_s * places[:, 0])
    k = int(np.argmax(away))
    if away[k] > 2.0 * rounding_s:
        raise RecordingError(
            f"{path}: the time of sample {places[k, 0]:.0f} is {away[k]:.4g} s away from where a fixed step of "
            f"{base.dt_s:.6g} s puts it: the step changes; save at a fixed step, without gaps"
        )


def _judge(path: Path, base: TimeBase, shortest: float, longest: float, longest_at: float) -> TimeBase:
    step = base.dt_s
    if longest > (2.0 - 1e-6) * shortest and longest > (1.0 + LOOSE) * step:
        raise RecordingError(
            f"{path}: the step of time varies from {shortest:.4g} to {longest:.4g} s (longest before {longest_at:.6g} "
            "s): there is a gap, or the simulation chose its own steps; save at a fixed step, without gaps"
        )
    if longest - shortest > 1e-3 * step:
        note = f"{ROUNDED} (steps of {shortest:.6g} to {longest:.6g} s): taken as uniform, {1 / step:.9g} Hz"
        return base._replace(notes=(note,))
    return base
