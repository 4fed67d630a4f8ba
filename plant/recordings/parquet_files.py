"""Parquet: one column per channel, one of them the time. Row groups are read one at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .clock_times import since_first
from .names import base_from, channels_of, time_column
from .recording import TEXT_LIMIT_BYTES, Channel, Recording, RecordingError


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a Parquet recording (see `read_recording`)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        fields = list(file.schema_arrow)
        columns = [field.name for field in fields]
        index = _index(file.schema_arrow)
    except (pa.ArrowException, OSError, ValueError) as error:  # a name that is no UTF-8 is a ValueError
        words = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: not a Parquet file, or a damaged one ({words})") from None
    numeric = [k for k, field in enumerate(fields) if _is_number(field.type)]
    if not numeric:
        kinds = ", ".join(f"{field.name} ({field.type})" for field in fields)
        raise RecordingError(f"{path}: no column of numbers; one per channel is needed, there are {kinds[:200]}")
    _refuse_large_groups(path, file.metadata)
    units = [_metadata(field, b"unit") for field in fields]
    channels = channels_of(columns, units)
    groups = _Groups(path, file)
    at = _time_column(fields, channels, index)
    base = base_from(path, None if at is None else channels[at], _times(groups, fields, at), sample_rate_hz)
    kept = [k for k in numeric if k != at and columns[k] not in index]
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


def _metadata(field: Any, key: bytes) -> str:
    return str((field.metadata or {}).get(key, b"").decode("utf-8", "replace"))


def _index(schema: Any) -> list[str]:
    """Columns that pandas would make the index of its table."""
    try:
        said = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
        return [each for each in said.get("index_columns", []) if isinstance(each, str)]
    except (ValueError, AttributeError, TypeError):
        return []


def _time_column(fields: Sequence[Any], channels: list[Channel], index: Sequence[str]) -> int | None:
    """The column called time, else one of time stamps, else an index of fractions."""
    import pyarrow.types as types

    named = time_column(channels)
    stamps = [k for k, field in enumerate(fields) if _ticks_per_s(field.type)]
    counted = [k for k, field in enumerate(fields) if field.name in index and types.is_floating(field.type)]
    return next(iter(([] if named is None else [named]) + stamps + counted), None)


def _times(groups: _Groups, fields: Sequence[Any], at: int | None) -> Iterator[np.ndarray] | None:
    if at is None:
        return None
    ticks = _ticks_per_s(fields[at].type)
    if ticks:
        return since_first(groups.ticks(fields[at].name), 1.0 / ticks)
    return (block[:, 0] for block in groups.all([fields[at].name]))


def _ticks_per_s(kind: Any) -> float:
    """Units of a time stamp, duration or time of day per second; 0 for other types."""
    import pyarrow.types as types

    if not (types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind)):
        return 0.0
    return {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit]


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

    def ticks(self, name: str) -> Iterator[np.ndarray]:
        """A column of time stamps as the integers that they are."""
        import pyarrow as pa

        for k in range(len(self._ends)):
            column = self._read(k, [name]).column(name)
            if column.null_count:
                raise RecordingError(f"{self._path}: a time is missing in {name!r}")
            kind = pa.int32() if column.type.bit_width == 32 else pa.int64()
            yield column.cast(kind).to_numpy().astype(np.int64)

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
            table = self._read(number, names)
            self._kept = np.array([table.column(name).cast(pa.float64()).to_numpy() for name in names]).T
            self._key = number, names
        return self._kept

    def _read(self, number: int, names: Sequence[str]) -> Any:
        import pyarrow as pa

        try:
            return self._file.read_row_group(number, columns=list(names), use_threads=False)
        except (pa.ArrowException, OSError) as error:
            words = " ".join(str(error).split())[:120]
            raise RecordingError(f"{self._path}: damaged, row group {number} cannot be read ({words})") from None
