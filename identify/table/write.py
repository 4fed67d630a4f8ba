"""Writing a table: responses in, Parquet out, atomically and always the same bytes.

pyarrow is imported where it is used: a command that only prints its help must not pay for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..files import atomic_file
from ..response import FrequencyResponse
from . import footer
from .format import (
    CARRIED,
    COLUMNS,
    ELEMENTS,
    N_COV,
    QUALITY,
    ROW_GROUP_ROWS,
    Column,
    TableError,
    check_point,
    complete_header,
    complete_metadata,
    joined,
    pack_covariance,
    std_of,
)


def write_table(path: str | Path, responses: Iterable[FrequencyResponse], meta: Mapping[str, Any]) -> None:
    """Write a table atomically: afterwards the whole of it is at ``path``, or what was there before.

    Parameters
    ----------
    path : path
        Replaced if it exists. A writer killed half-way leaves ``.NAME.PID.tmp`` beside it.
    responses : iterable of FrequencyResponse
        In the order of ``meta["operating_points"]``, named by their ``meta["op_id"]``, in the pn
        frame, equally long. May be a generator: at most `ROW_GROUP_ROWS` rows and one response
        are held at a time, and the bytes do not depend on how the rows arrive. Facts that a response's
        ``meta`` carries (`format.CARRIED`) go into its entry of ``operating_points``.
    meta : mapping
        ``f1_hz``, ``bases`` (rated_voltage_v, rated_power_va), ``power_meaning``,
        ``operating_points``, ``configuration``, ``plant``, and ``seeds`` where there are any; see
        `complete_metadata` for the rest. Without ``operating_points`` the whole ``meta`` of a response is its
        entry: of a large campaign they need not be in memory at once.

    Raises
    ------
    TableError
        If metadata and responses do not agree; nothing is written.
    OSError
        If the machine refuses (disk full, permission); nothing is left behind.
    """
    if "operating_points" in meta:
        completed = complete_metadata(meta)
        described = _as_listed(responses, completed["operating_points"])
    else:
        completed = complete_header(meta)
        described = _as_carried(responses)
    with atomic_file(path) as file:
        _write(file, _checked(described, completed["f1_hz"]), completed)


Described = tuple[FrequencyResponse, Mapping[str, Any]]
"""A response, and the entry of its operating point in the metadata."""


def _write(file: BinaryIO, described: Iterable[Described], meta: Mapping[str, Any]) -> None:
    import pyarrow.parquet as pq

    schema = _arrow_schema()
    strings = [column.name for column in COLUMNS if column.kind == "string"]
    doubles = [_leaf(column) for column in COLUMNS if column.kind != "string"]
    text = footer.MetadataText(meta)
    with pq.ParquetWriter(
        file,
        schema,
        compression="zstd",
        use_dictionary=strings,
        use_byte_stream_split=doubles,
        write_page_checksum=True,
    ) as writer:
        for group in _row_groups(_noted(described, text), schema):
            writer.write_table(group, row_group_size=ROW_GROUP_ROWS)
        footer.reserve(writer)
    footer.fill(file, text.pieces())


def _noted(described: Iterable[Described], text: footer.MetadataText) -> Iterator[FrequencyResponse]:
    """Pass the responses on, and put their operating points into the metadata."""
    for response, point in described:
        text.add(point)
        yield response


def _leaf(column: Column) -> str:
    return f"{column.name}.list.element" if column.kind == "list of double" else column.name


def _arrow_schema() -> Any:
    import pyarrow as pa

    double = pa.float64()
    kinds = {
        "string": pa.string(),
        "double": double,
        "list of double": pa.list_(pa.field("element", double, nullable=False)),
    }
    units = {column.name: {b"unit": column.unit.encode()} if column.unit else None for column in COLUMNS}
    return pa.schema([pa.field(c.name, kinds[c.kind], nullable=False, metadata=units[c.name]) for c in COLUMNS])


def _as_listed(responses: Iterable[FrequencyResponse], points: Sequence[Mapping[str, Any]]) -> Iterator[Described]:
    """The responses with their entries, while they are those that the metadata announces."""
    n_points = 0
    for response in responses:
        op_id = response.meta.get("op_id")
        if n_points == len(points) or op_id != points[n_points]["op_id"]:
            due = points[n_points]["op_id"] if n_points < len(points) else "none"
            raise TableError(f"response {n_points + 1} is of operating point {op_id!r}; the metadata has {due!r} there")
        facts = {key: response.meta[key] for key in CARRIED if key in response.meta}
        yield response, {**points[n_points], **facts}
        n_points += 1
    if n_points != len(points):
        missing = points[n_points]["op_id"]
        raise TableError(f"{n_points} responses for {len(points)} operating points; {missing!r} is missing")


def _as_carried(responses: Iterable[FrequencyResponse]) -> Iterator[Described]:
    """The responses with the entries that they carry themselves."""
    known = set[str]()
    for number, response in enumerate(responses, start=1):
        check_point(response.meta, number)
        op_id = response.meta["op_id"]
        if op_id in known:
            raise TableError(f"response {number} is of operating point {op_id!r}, which was there before")
        known.add(op_id)
        yield response, response.meta
    if not known:
        raise TableError("there are no responses: a table has one operating point at least")


def _checked(described: Iterable[Described], f1_hz: float) -> Iterator[Described]:
    n_rows: int | None = None
    for response, point in described:
        n_rows = len(response) if n_rows is None else n_rows
        _check_response(response, f1_hz, n_rows)
        yield response, point


def _check_response(response: FrequencyResponse, f1_hz: float, n_rows: int) -> None:
    op_id = response.meta["op_id"]
    if response.frame != "pn":
        raise TableError(f"{op_id}: the table holds the pn frame, the response is in {response.frame!r}: convert it")
    if response.f1_hz != f1_hz:
        raise TableError(f"{op_id}: f1 is {response.f1_hz!r} Hz, the metadata says {f1_hz!r} Hz")
    if not len(response) or len(response) != n_rows:
        raise TableError(f"{op_id}: {len(response)} frequencies; every operating point needs the same {n_rows or 1}")
    if unknown := sorted(set(response.quality) - set(QUALITY)):
        raise TableError(f"{op_id}: the table has no column {unknown[0]!r}; it has {', '.join(QUALITY)}")


def _row_groups(responses: Iterable[FrequencyResponse], schema: Any) -> Iterator[Any]:
    """Cut a stream of responses into Arrow tables of `ROW_GROUP_ROWS` rows, the last one shorter."""
    pending, n = list[dict[str, np.ndarray]](), 0
    for response in responses:
        pending.append(_columns(response))
        n += len(response)
        if n >= ROW_GROUP_ROWS:
            rows = joined(pending)
            whole = n - n % ROW_GROUP_ROWS
            for first in range(0, whole, ROW_GROUP_ROWS):
                yield _arrow_table(_cut(rows, first, first + ROW_GROUP_ROWS), schema)
            pending, n = [_cut(rows, whole, n)], n - whole
    if n:
        yield _arrow_table(joined(pending), schema)


def _cut(columns: Mapping[str, np.ndarray], first: int, end: int) -> dict[str, np.ndarray]:
    """Some rows, copied: the others are not kept for their sake."""
    return {name: column[first:end].copy() for name, column in columns.items()}


def rows_of(responses: Iterable[FrequencyResponse]) -> dict[str, np.ndarray]:
    """Columns of several responses, one after the other, before they are written: for `rules`."""
    return joined([_columns(response) for response in responses])


def _columns(response: FrequencyResponse) -> dict[str, np.ndarray]:
    """Columns (n,) of one response; ``cov`` is (n, 36)."""
    n = len(response)
    elements = response.y.reshape(n, 4)  # pp, pn, np, nn: row after row
    covariance = np.asarray(response.covariance)
    std = std_of(covariance)
    columns = {
        "op_id": np.full(n, response.meta["op_id"]),
        "f_hz": response.f_hz,
        "f_mirror_hz": response.f_mirror_hz,
        "cov": pack_covariance(covariance),
        "status": np.asarray(response.status),
        "reason": np.asarray(response.reason),
    }
    for k, element in enumerate(ELEMENTS):
        columns[f"y_{element}_re"] = elements[:, k].real
        columns[f"y_{element}_im"] = elements[:, k].imag
        columns[f"y_{element}_std"] = std[:, k]
    for name in QUALITY:
        columns[name] = np.asarray(response.quality.get(name, np.full(n, np.nan)), dtype=float)
    return columns


def _arrow_table(columns: Mapping[str, np.ndarray], schema: Any) -> Any:
    import pyarrow as pa

    make = {"string": _arrow_strings, "double": _arrow_doubles, "list of double": _arrow_lists}
    return pa.table([make[c.kind](columns[c.name], schema.field(c.name).type) for c in COLUMNS], schema=schema)


# Arrays are made from buffers: `pyarrow.array` imports all of pandas, where there is one, only to ask
# whether its argument is a Series.


def _arrow_doubles(values: np.ndarray, kind: Any) -> Any:
    import pyarrow as pa

    return pa.Array.from_buffers(pa.float64(), values.size, [None, pa.py_buffer(_one_nan(values).ravel())])


def _arrow_lists(values: np.ndarray, kind: Any) -> Any:
    import pyarrow as pa

    offsets = pa.py_buffer(np.arange(0, values.size + 1, N_COV, dtype=np.int32))
    return pa.Array.from_buffers(kind, len(values), [None, offsets], children=[_arrow_doubles(values, kind)])


def _arrow_strings(values: np.ndarray, kind: Any) -> Any:
    import pyarrow as pa

    encoded = [str(value).encode() for value in values]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))


def _one_nan(values: np.ndarray) -> np.ndarray:
    """Copy with every NaN the same NaN: its sign and payload depend on how it came about."""
    return np.where(np.isnan(values), np.nan, values)
