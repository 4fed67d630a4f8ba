"""Numbers in text, fast and in portions: what CSV, COMTRADE's ASCII and PSCAD have in common."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .recording import TEXT_LIMIT_BYTES, RecordingError

PORTION_BYTES = 4 << 20
MISSING = ("", "NaN", "nan", "NAN", "null", "NULL", "N/A", "NA", "-", "--", "-nan", "inf", "-inf", "Inf", "-Inf")


class NumberTable(NamedTuple):
    """Portions (n_k, columns) in file order, and the numbers of the rows that did not fit (from 0)."""

    parts: list[np.ndarray]
    unfit: list[str]

    @property
    def n_rows(self) -> int:
        return sum(len(part) for part in self.parts)


def read_numbers(
    path: Path, source: Any, n_columns: int, delimiter: str, *, skip_rows: int = 0, decimal: str = "."
) -> NumberTable:
    """Parse ``n_columns`` numbers per row out of a binary file object.

    Parameters
    ----------
    path : Path
        For messages.
    source : binary file object
        Read from where it stands to its end.
    n_columns, delimiter, skip_rows, decimal
        Layout of the text.

    Raises
    ------
    RecordingError
        If a cell is no number, or the text is larger than memory allows.
    """
    import pyarrow as pa
    from pyarrow import csv

    unfit: list[str] = []

    def strange(row: Any) -> str:
        if len(unfit) < 10:
            unfit.append(str(row.text)[:60])
        return "skip"

    names = [f"c{k}" for k in range(n_columns)]
    try:
        with csv.open_csv(
            source,
            csv.ReadOptions(column_names=names, skip_rows=skip_rows, block_size=PORTION_BYTES, use_threads=False),
            csv.ParseOptions(delimiter=delimiter, quote_char='"', invalid_row_handler=strange),
            csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()), null_values=MISSING, decimal_point=decimal
            ),
        ) as reader:
            parts = [_numbers(batch) for batch in reader]
    except pa.ArrowInvalid as error:
        raise RecordingError(f"{path}: no table of {n_columns} numbers per row ({str(error)[:160]})") from None
    return NumberTable([part for part in parts if len(part)], unfit)


def _numbers(batch: Any) -> np.ndarray:
    columns = [batch.column(k).to_numpy(zero_copy_only=False) for k in range(batch.num_columns)]
    return np.array(columns).T


def refuse_too_large(path: Path, n_bytes: int) -> None:
    """What can only be read as a whole must fit into memory."""
    if n_bytes > TEXT_LIMIT_BYTES:
        raise RecordingError(
            f"{path}: {n_bytes / 2**30:.3g} GB, which must be read as a whole; the limit is "
            f"{TEXT_LIMIT_BYTES / 2**30:.3g} GB: save it as binary COMTRADE, Parquet or HDF5, or cut it into several "
            "files"
        )


def decoded(raw: bytes) -> tuple[str, tuple[str, ...]]:
    """Text of unknown encoding, and what is to be said about it."""
    for encoding in ("utf-16",) if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig",):
        try:
            return raw.decode(encoding), ()
        except UnicodeDecodeError:
            pass
    return raw.decode("latin-1"), ("text is not UTF-8: names may look odd, numbers are not concerned",)


def unfit_note(unfit: Sequence[str], what: str) -> tuple[str, ...]:
    """A note about rows that were left out."""
    return (f"{len(unfit)} row(s) of {what} do not fit and were left out, such as {unfit[0]!r}",) if unfit else ()
