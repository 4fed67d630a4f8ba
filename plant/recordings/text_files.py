"""CSV and TSV with names, and perhaps units, above the columns. Decimal commas and comment lines are seen through."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from .names import base_from, channels_of, time_column
from .number_table import decoded, read_numbers, refuse_too_large, unfit_note
from .recording import Recording, RecordingError, in_memory

HEAD_BYTES = 1 << 16
_COMMENTS = ("#", "%", "//")


class _Layout(NamedTuple):
    """How a text is laid out: lines before the numbers, separators, headings."""

    skip_rows: int
    delimiter: str
    decimal: str
    names: list[str]
    units: list[str] | None
    notes: tuple[str, ...]


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a text recording (see `read_recording`)."""
    refuse_too_large(path, path.stat().st_size)
    layout = _layout(path)
    with open(path, "rb") as file:
        table = read_numbers(
            path,
            file,
            len(layout.names),
            layout.delimiter,
            skip_rows=layout.skip_rows,
            decimal=layout.decimal,
        )
    if not table.parts:
        raise RecordingError(f"{path}: no row of {len(layout.names)} numbers")
    channels = channels_of(layout.names, layout.units)
    at = time_column(channels)
    time = None if at is None else [part[:, at] for part in table.parts]
    base = base_from(path, None if at is None else channels[at], time, sample_rate_hz)
    kept = [k for k in range(len(channels)) if k != at]
    stored = in_memory(table.parts)
    return Recording(
        path=path,
        format="text",
        channels=tuple(channels[k] for k in kept),
        n_samples=table.n_rows,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=lambda columns, start, stop: stored([kept[k] for k in columns], start, stop),
        notes=(*layout.notes, *unfit_note(table.unfit, "the file"), *base.notes),
    )


def _layout(path: Path) -> _Layout:
    with open(path, "rb") as file:
        raw = file.read(HEAD_BYTES)
    if b"\0" in raw and raw[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        raise RecordingError(f"{path}: holds zero bytes: not a text file")
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise RecordingError(f"{path}: UTF-16 text; save it as UTF-8")
    text, notes = decoded(raw[: raw.rfind(b"\n") + 1] or raw)
    lines = text.splitlines()
    first = next((k for k in range(len(lines)) if _is_numbers(lines[k])), None)
    if first is None:
        raise RecordingError(f"{path}: no line of numbers within the first {HEAD_BYTES >> 10} kB")
    delimiter, decimal = _separators(path, lines[first : first + 20])
    n = len(lines[first].rstrip("\r\n").split(delimiter))
    heads = [line for line in lines[:first] if line.strip() and not line.lstrip().startswith(_COMMENTS)]
    cells = [_cells(line, delimiter) for line in heads]
    fitting = [row for row in cells if len(row) == n]
    if not fitting:
        names = ["time", *(f"c{k}" for k in range(1, n))] if n > 1 else ["c0"]
        return _Layout(first, delimiter, decimal, names, None, (*notes, "no headings: the first column is the time"))
    units = _unit_row(fitting[-1]) if len(fitting) > 1 else None
    return _Layout(first, delimiter, decimal, fitting[-2 if units else -1], units, notes)


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip().strip('"') for cell in line.rstrip("\r\n").split(delimiter)]


def _is_numbers(line: str) -> bool:
    """Whether a line holds nothing but numbers, two of them at least."""
    cells = [cell for cell in re.split(r"[;\t, ]+", line.strip()) if cell]
    return len(cells) > 1 and all(re.fullmatch(r'"?[+-]?[\d.]+([eE][+-]?\d+)?"?|nan|NaN', cell) for cell in cells)


def _separators(path: Path, lines: list[str]) -> tuple[str, str]:
    """Delimiter and decimal sign that give every line the same number of cells, more than one."""
    for delimiter, decimal in (("\t", "."), (";", "."), (",", "."), (" ", ".")):
        counts = Counter(line.count(delimiter) for line in lines if line.strip())
        if len(counts) == 1 and next(iter(counts)) > 0:
            comma = delimiter in "\t;" and any("," in line for line in lines)
            return delimiter, "," if comma else decimal
    raise RecordingError(f"{path}: lines of different lengths: neither tab, semicolon nor comma separates the numbers")


def _unit_row(row: list[str]) -> list[str] | None:
    """Units where a row holds nothing but units, such as (ms) (V)."""
    bare = [cell.strip("()[] ") for cell in row]
    known = sum(cell.lower() in ("s", "ms", "us", "v", "kv", "mv", "a", "ka", "ma", "pu") for cell in bare)
    return bare if known >= max(1, len(row) // 2) else None
