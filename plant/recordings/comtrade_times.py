"""Time of a COMTRADE recording: sections of one rate each, and time stamps of 32 bits that begin anew when full."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .recording import RecordingError
from .timebase import TimeBase, time_base

NO_STAMP = 0xFFFFFFFF
"""A time stamp that is not there."""


class Section(NamedTuple):
    """Samples ``start`` to ``stop`` share one rate (Hz; 0: the time stamps say); None: nobody says when it begins."""

    start: int
    stop: int
    rate_hz: float
    start_s: float | None = 0.0


def unit_of_stamps_s(cfg: Any) -> float:
    """Seconds per unit of a time stamp."""
    unit = float(cfg.time_base * cfg.timemult)
    return unit if np.isfinite(unit) and unit > 0.0 else 1e-6


def stamps_of(raw: Iterable[np.ndarray], unit_s: float) -> Iterator[np.ndarray]:
    """Time stamps (s) in blocks, NaN where there is none; 32 bits begin anew when they are full, time does not."""
    turns, last = 0, 0
    for block in raw:
        known = block != NO_STAMP
        count = np.where(known, block, 0).astype(np.int64)
        wraps = np.diff(count, prepend=last) < -(2**31)
        total = count + 2**32 * (turns + np.cumsum(wraps & known))
        if len(block):
            turns, last = int(total[-1] - count[-1]) >> 32, int(count[-1])
        yield np.where(known, total * unit_s, np.nan)


def longest_section(cfg: Any, n_samples: int) -> tuple[Section, tuple[str, ...]]:
    """The section of one rate with most samples; there may be several rates in a file."""
    sections: list[Section] = []
    start = 0
    start_s: float | None = 0.0
    for rate, end in cfg.sample_rates:
        stop = min(int(end), n_samples) if end else n_samples
        sections.append(Section(start, stop, float(rate), start_s))
        start_s = start_s + (stop - start) / rate if start_s is not None and rate > 0.0 else None
        start = stop
    longest = max(sections, key=lambda section: section.stop - section.start)
    if len(sections) == 1:
        return longest, ()
    rates = ", ".join(f"{section.rate_hz:g} Hz x {section.stop - section.start}" for section in sections)
    return longest, (f"several sampling rates ({rates}): only the longest section is used",)


def time_base_of(path: Path, section: Section, stamps: Iterator[np.ndarray], sample_rate_hz: float | None) -> TimeBase:
    """Start and step (s) of a section: as asked, as the configuration claims, or as its time stamps say."""
    if sample_rate_hz is not None:
        note = f"{sample_rate_hz:g} samples per second, as asked"
        return TimeBase(section.start_s or 0.0, 1.0 / sample_rate_hz, (note,))
    mine = _of_section(section, stamps)
    if not section.rate_hz > 0.0:
        return time_base(path, _all_there(path, mine))
    claimed = 1.0 / section.rate_hz
    seen = _seen(mine)
    start_s = section.start_s
    if start_s is None:
        start_s = section.start * claimed if seen is None else seen.first_s
    return TimeBase(start_s, claimed, () if seen is None else _compared(path, section, seen, claimed))


def _of_section(section: Section, stamps: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Time stamps (s) of a section, in blocks."""
    at = 0
    for block in stamps:
        mine = block[max(0, section.start - at) : max(0, section.stop - at)]
        at += len(block)
        if len(mine):
            yield mine


def _all_there(path: Path, stamps: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    for block in stamps:
        if not np.all(np.isfinite(block)):
            raise RecordingError(f"{path}: neither a sampling rate nor time stamps: give --sample-rate HZ")
        yield block


class _Seen(NamedTuple):
    """What time stamps (s) say: first and last, their number, the shortest and the longest step, and where they are."""

    first_s: float
    last_s: float
    n: int
    shortest_s: float
    shortest_at: int
    longest_s: float
    longest_at: int


def _seen(stamps: Iterable[np.ndarray]) -> _Seen | None:
    """None where a stamp is missing, or all are the same."""
    seen: _Seen | None = None
    for block in stamps:
        if not np.all(np.isfinite(block)):
            return None
        seen = seen or _Seen(float(block[0]), float(block[0]), 0, np.inf, 0, -np.inf, 0)
        steps = np.diff(block, prepend=seen.last_s)
        least, most = int(np.argmin(steps)), int(np.argmax(steps))
        if seen.n == 0 and len(steps) > 1:
            least, most = 1 + int(np.argmin(steps[1:])), 1 + int(np.argmax(steps[1:]))
        seen = seen._replace(last_s=float(block[-1]), n=seen.n + len(block))
        if steps[least] < seen.shortest_s:
            seen = seen._replace(shortest_s=float(steps[least]), shortest_at=seen.n - len(block) + least)
        if steps[most] > seen.longest_s:
            seen = seen._replace(longest_s=float(steps[most]), longest_at=seen.n - len(block) + most)
    return seen if seen is not None and seen.n > 1 and seen.longest_s > 0.0 else None


def _compared(path: Path, section: Section, seen: _Seen, claimed_s: float) -> tuple[str, ...]:
    """What is to be said where time stamps and the claimed step disagree.

    Raises
    ------
    RecordingError
        If the stamps run backwards, or leave out a piece.
    """
    if seen.shortest_s < 0.0:
        raise RecordingError(
            f"{path}: time stamps run backwards at sample {section.start + seen.shortest_at + 1}: the file holds "
            "several recordings, or is damaged; cut it there, or give --sample-rate HZ where the stamps mean nothing"
        )
    stamped = (seen.last_s - seen.first_s) / (seen.n - 1)
    if abs(stamped / claimed_s - 1.0) <= 1e-3 and seen.longest_s < 1.5 * claimed_s:
        return ()
    missing_s = seen.last_s - seen.first_s - (seen.n - 1) * claimed_s
    if missing_s > 2.0 * claimed_s and seen.longest_s - claimed_s > 0.9 * missing_s:
        raise RecordingError(
            f"{path}: {seen.longest_s:.6g} s lie between the time stamps of samples {section.start + seen.longest_at} "
            f"and {section.start + seen.longest_at + 1}, where the step is {claimed_s:.6g} s: there is a gap; cut the "
            "file there, or give --sample-rate HZ where the stamps mean nothing"
        )
    if abs(stamped / claimed_s - 1.0) <= 1e-3:
        return ()
    return (
        f"the configuration says {1 / claimed_s:.6g} samples per second, the time stamps {1 / stamped:.6g}: the "
        "former is used; --sample-rate HZ overrules it",
    )
