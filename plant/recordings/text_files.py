"""CSV and other text: named columns of numbers, one of them perhaps the time; `layout_of` says what is understood."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..foreign.layout import Layout, layout_of
from .clock_times import past_midnight
from .names import base_from, channels_of, time_column
from .number_table import Columns, column_of, read_numbers, refuse_too_large, unfit_note
from .recording import Recording, RecordingError, in_memory


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a text recording (see `read_recording`)."""
    refuse_too_large(path, path.stat().st_size)
    layout = layout_of(path)
    columns = _columns(layout)
    with open(path, "rb") as file:
        table = read_numbers(path, file, columns)
    if not table.parts:
        raise RecordingError(f"{path}: no row of {len(layout.kinds)} numbers")
    names = layout.names or _numbered(len(layout.kinds))
    channels = channels_of(
        [names[k] for k in columns.read], [layout.units[k] for k in columns.read] if layout.units else None
    )
    kinds = [columns.kinds[k] for k in columns.read]
    at = kinds.index("clock") if "clock" in kinds and time_column(channels) is None else time_column(channels)
    base = base_from(path, None if at is None else channels[at], _times(table.parts, at, kinds), sample_rate_hz)
    kept = [k for k, kind in enumerate(kinds) if k != at and kind == "number"]
    stored = in_memory(table.parts)
    words = [names[k] for k, kind in enumerate(layout.kinds) if kind in ("words", "date") and names[k]]
    return Recording(
        path=path,
        format="text",
        channels=tuple(channels[k] for k in kept),
        n_samples=table.n_rows,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=lambda columns, start, stop: stored([kept[k] for k in columns], start, stop),
        notes=(
            *layout.notes,
            *((f"columns of words are left out: {', '.join(words[:6])}",) if words else ()),
            *unfit_note(table.unfit, "the file"),
            *base.notes,
        ),
        hints=layout.notes,
    )


def _columns(layout: Layout) -> Columns:
    """What is read: a named column without a number in sight may hold some further down."""
    names = layout.names or ("",) * len(layout.kinds)
    kinds = ["number" if kind == "empty" and name else kind for kind, name in zip(layout.kinds, names, strict=True)]
    return Columns(kinds, layout.delimiter, layout.decimal, layout.skip_rows, layout.mending)


def _numbered(n: int) -> tuple[str, ...]:
    """Names of columns that have no headings: the first is the time."""
    return ("time", *(f"c{k}" for k in range(1, n)))


def _times(parts: list[np.ndarray], at: int | None, kinds: Sequence[str]) -> Iterable[np.ndarray] | None:
    if at is None:
        return None
    times = column_of(parts, at)
    return past_midnight(times) if kinds[at] == "clock" else times
