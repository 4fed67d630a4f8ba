"""Numbers in text, fast and in portions: what CSV, COMTRADE's ASCII and PSCAD have in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..foreign.cells import MISSING, Kind
from ..foreign.clean_text import Mending, mended
from .clock_times import seconds_of_day
from .recording import TEXT_LIMIT_BYTES, RecordingError

PORTION_BYTES = 4 << 20

MOST_UNFIT = 10
"""Rows that do not fit are kept for messages, not more than so many."""


class NumberTable(NamedTuple):
    """Portions (n_k, columns) in file order, and the rows that did not fit."""

    parts: list[np.ndarray]
    unfit: list[str]

    @property
    def n_rows(self) -> int:
        return sum(len(part) for part in self.parts)


class Columns(NamedTuple):
    """How rows are laid out; only numbers and times of day are read, the latter as seconds of the day."""

    kinds: Sequence[Kind]
    delimiter: str
    decimal: str = "."
    skip_rows: int = 0
    mending: Mending = Mending()

    @property
    def read(self) -> list[int]:
        """Numbers of the columns that are read."""
        return [k for k, kind in enumerate(self.kinds) if kind in ("number", "clock")]


def read_numbers(path: Path, source: Any, columns: Columns) -> NumberTable:
    """Parse the columns of numbers and times out of a binary file object, from where it stands to its end.

    Raises
    ------
    RecordingError
        If a cell is no number, or the text is larger than memory allows.
    """
    import pyarrow as pa

    start = source.tell()
    try:
        return _read(source, columns)
    except pa.ArrowInvalid as error:
        first = error
    source.seek(start)  # cells further down may be written otherwise than the first ones
    try:
        return _read(source, columns._replace(mending=columns.mending._replace(exponents=True)))
    except pa.ArrowInvalid:
        n = len(columns.kinds)
        words = " ".join(str(first).split())[:160]
        raise RecordingError(f"{path}: no table of {n} numbers per row ({words})") from None


def _read(source: Any, columns: Columns) -> NumberTable:
    import pyarrow as pa
    from pyarrow import csv

    unfit: list[str] = []

    def strange(row: Any) -> str:
        if len(unfit) < MOST_UNFIT:
            unfit.append(_shown(row))
        return "skip"

    names = [f"c{k}" for k in range(len(columns.kinds))]
    types = {names[k]: pa.string() if columns.kinds[k] == "clock" else pa.float64() for k in columns.read}
    with csv.open_csv(
        mended(source, columns.mending, columns.skip_rows),
        csv.ReadOptions(column_names=names, block_size=PORTION_BYTES, use_threads=False),
        csv.ParseOptions(delimiter=columns.delimiter, quote_char='"', invalid_row_handler=strange),
        csv.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=sorted(MISSING),
            decimal_point=columns.decimal,
            check_utf8=False,
        ),
    ) as reader:
        parts = [_numbers(batch) for batch in reader]
    return NumberTable([part for part in parts if len(part)], unfit)


def _shown(row: Any) -> str:
    """A row for a message; its bytes may be no text."""
    try:
        return str(row.text)[:60]
    except UnicodeDecodeError:
        return "(not UTF-8)"


def _numbers(batch: Any) -> np.ndarray:
    import pyarrow as pa

    columns = [
        seconds_of_day(column) if pa.types.is_string(column.type) else column.to_numpy(zero_copy_only=False)
        for column in batch.columns
    ]
    return np.array(columns).T


def refuse_too_large(path: Path, n_bytes: int) -> None:
    """What can only be read as a whole must fit into memory."""
    if n_bytes > TEXT_LIMIT_BYTES:
        raise RecordingError(
            f"{path}: {n_bytes / 2**30:.3g} GB, which must be read as a whole; the limit is "
            f"{TEXT_LIMIT_BYTES / 2**30:.3g} GB: save it as binary COMTRADE, Parquet or HDF5, or cut it into several "
            "files"
        )


def unfit_note(unfit: Sequence[str], what: str) -> tuple[str, ...]:
    """A note about rows that were left out."""
    return (f"{len(unfit)} row(s) of {what} do not fit and were left out, such as {unfit[0]!r}",) if unfit else ()


def column_of(parts: Iterable[np.ndarray], number: int) -> list[np.ndarray]:
    """One column of portions, portion by portion."""
    return [part[:, number] for part in parts]
