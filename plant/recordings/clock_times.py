"""Times of day and time stamps, as recorders and databases write them, to seconds that count up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ..foreign.cells import STAMP

DAY_S = 86400.0


def seconds_of_day(texts: Any) -> np.ndarray:
    """Seconds (n,) since midnight of Arrow texts such as "2026-03-02 10:04:07.001"; NaN for what is none."""
    import pyarrow.compute as pc

    found = pc.extract_regex(pc.utf8_trim_whitespace(texts), f"^{STAMP}$")
    hours, minutes, seconds = (_number(pc.struct_field(found, name)) for name in "hms")
    fraction = _number(pc.binary_join_element_wise("0", pc.struct_field(found, "f"), "."))
    half = pc.utf8_lower(pc.struct_field(found, "half"))
    total = 3600.0 * _hours(hours, half) + 60.0 * minutes + seconds + np.nan_to_num(fraction)
    return np.asarray(total)


def _hours(hours: np.ndarray, half: Any) -> np.ndarray:
    """Hours of 24, out of hours of 12 where the text says am or pm; no hours at all are none."""
    import pyarrow.compute as pc

    hours = np.nan_to_num(hours)
    marks = pc.fill_null(half, "")
    am, pm = (np.asarray(pc.starts_with(marks, letter)) for letter in "ap")
    return np.where(am | pm, hours % 12.0, hours) + np.where(pm, 12.0, 0.0)


def _number(texts: Any) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.compute as pc

    cleaned = pc.if_else(pc.equal(pc.fill_null(texts, ""), ""), None, texts)
    return np.asarray(pc.cast(cleaned, pa.float64()).to_numpy(zero_copy_only=False))


def past_midnight(blocks: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Seconds of the day that go on counting where a new day begins."""
    days, last = 0.0, -np.inf
    for block in blocks:
        steps = np.diff(block, prepend=last if np.isfinite(last) else block[:1])
        turned = days + DAY_S * np.cumsum(steps < -0.5 * DAY_S)
        yield block + turned
        if len(block):
            days, last = float(turned[-1]), float(block[-1])


def since_first(stamps: Iterable[np.ndarray], unit_s: float) -> Iterator[np.ndarray]:
    """Seconds since the first of integer stamps: floats hold no nanoseconds since 1970."""
    first = None
    for block in stamps:
        if first is None and len(block):
            first = int(block[0])
        yield (block.astype(np.int64) - (first or 0)) * unit_s
