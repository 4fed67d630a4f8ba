"""Parquet: one column per channel, one of them the time. Row groups are read one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .names import base_from, channels_of, time_column
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a Parquet recording (see `read_recording`)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
    except (pa.ArrowException, OSError) as error:
        raise RecordingError(f"{path}: not a Parquet file, or a truncated one ({str(error)[:120]})") from None
    numeric = [field for field in file.schema_arrow if _is_number(field.type)]
    if not numeric:
        kinds = ", ".join(f"{field.name} ({field.type})" for field in file.schema_arrow)
        raise RecordingError(f"{path}: no column of numbers; one per channel is needed, there are {kinds[:200]}")
    _refuse_large_groups(path, file.metadata)
    columns = [field.name for field in numeric]
    units = [(field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for field in numeric]
    channels = channels_of(columns, units)
    groups = _Groups(path, file)
    at = time_column(channels)
    time = None if at is None else (block[:, 0] for block in groups.all([columns[at]]))
    base = base_from(path, None if at is None else channels[at], time, sample_rate_hz)
    kept = [k for k in range(len(columns)) if k != at]
    return Recording(
        path=path,
        format="Parquet",
        channels=tuple(channels[k] for k in kept),
        n_samples=file.metadata.num_rows,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=lambda asked, start, stop: groups.samples([columns[kept[k]] for k in asked], start, stop),
        notes=base.notes,
    )


def _is_number(kind: Any) -> bool:
    import pyarrow.types as types

    return bool(types.is_floating(kind) or types.is_integer(kind))


def _refuse_large_groups(path: Path, metadata: Any) -> None:
    """A row group is the least that can be decompressed: its size is known before it is."""
    rows = max((metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)), default=0)
    if rows * metadata.num_columns * 8 > TEXT_LIMIT_BYTES:
        raise RecordingError(f"{path}: a row group of {rows} rows does not fit into memory; write smaller row groups")


class _Groups:
    """Row groups of one file; the last one read is kept, for samples are asked in order."""

    def __init__(self, path: Path, file: Any):
        counts = [file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)]
        self._path, self._file = path, file
        self._ends = np.cumsum(counts)
        self._key: tuple[int, tuple[str, ...]] | None = None
        self._kept = np.empty((0, 0))

    def all(self, names: Sequence[str]) -> Iterator[np.ndarray]:
        """Every row group (n, names) in order."""
        return (self._group(k, tuple(names)) for k in range(len(self._ends)))

    def samples(self, names: Sequence[str], start: int, stop: int) -> np.ndarray:
        """Rows ``start`` to ``stop``, (n, names)."""
        first = int(np.searchsorted(self._ends, start, side="right"))
        pieces = []
        while start < stop:
            before = int(self._ends[first - 1]) if first else 0
            piece = self._group(first, tuple(names))[start - before : stop - before]
            pieces.append(piece)
            start += len(piece)
            first += 1
        return np.concatenate(pieces) if pieces else np.empty((0, len(names)))

    def _group(self, number: int, names: tuple[str, ...]) -> np.ndarray:
        import pyarrow as pa

        if self._key != (number, names):
            try:
                table = self._file.read_row_group(number, columns=list(names), use_threads=False)
            except (pa.ArrowException, OSError) as error:
                raise RecordingError(f"{self._path}: damaged, row group {number} cannot be read ({error})") from None
            self._kept = np.array([table.column(name).cast(pa.float64()).to_numpy() for name in names]).T
            self._key = number, names
        return self._kept
