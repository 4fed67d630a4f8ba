"""The table: Parquet in the format ``seqsweep-admittance``, one row per operating point and frequency.

``docs/table-format.md`` is the contract, ``schema/`` holds the JSON schema of the metadata and
`table_rules` what a conforming table must satisfy. pyarrow is imported where it is used: a command
that only prints its help must not pay for it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from .response import FrequencyResponse

FORMAT = "seqsweep-admittance"
VERSION = "1.0.0"
METADATA_KEY = b"seqsweep"

MIRROR = "f_mirror_hz = 2 f1_hz - f_hz, signed; the second component is the conjugate of the phasor found there"
DIRECTION = "current positive into the device under test (load direction)"
AMPLITUDE_PU = "peak over rated peak: sqrt(2/3) U for a voltage, sqrt(2) S / (sqrt(3) U) for a current"

ELEMENTS = ("pp", "pn", "np", "nn")
QUALITY = ("amplitude_pu", "n_periods", "window_s", "cond_v", "linearity", "residual")
UPPER = np.triu_indices(8)  # where the 36 entries of `cov` stand in the 8x8 matrix, row after row
N_COV = len(UPPER[0])

# Rows are regrouped to this size whatever the caller's portions, so that they leave no trace in the bytes.
ROW_GROUP_ROWS = 8192

_HOW = "another tool's file becomes a table by `seqsweep import`, a recording by `seqsweep identify`"

_REQUIRED = {"f1_hz", "bases", "power_meaning", "operating_points", "configuration", "plant"}
_FIXED = {"format": FORMAT, "version": VERSION, "frame": "pn", "mirror": MIRROR, "direction": DIRECTION}
_BASES = {"rated_voltage_v", "rated_power_va"}
_POINT = {"op_id", "active_power_mw", "terminal_voltage_pu"}
_OPTIONAL = {*_FIXED, "configuration_sha256", "tool", "seeds", "sha256"}


class TableError(ValueError):
    """A file that is not a readable table, or rows and metadata that cannot become one."""


class Column(NamedTuple):
    """A column of the table; ``kind`` is "string", "double" or "list of double"."""

    name: str
    kind: str
    unit: str


COLUMNS = (
    Column("op_id", "string", ""),
    Column("f_hz", "double", "Hz"),
    Column("f_mirror_hz", "double", "Hz"),
    *(Column(f"y_{element}_{part}", "double", "S") for element in ELEMENTS for part in ("re", "im")),
    *(Column(f"y_{element}_std", "double", "S") for element in ELEMENTS),
    Column("cov", "list of double", "S^2"),
    Column("status", "string", ""),
    Column("reason", "string", ""),
    Column("amplitude_pu", "double", "pu"),
    Column("n_periods", "double", "1"),
    Column("window_s", "double", "s"),
    Column("cond_v", "double", "1"),
    Column("linearity", "double", "1"),
    Column("residual", "double", "1"),
)


@dataclass(frozen=True, slots=True)
class Table:
    """A table in memory.

    Attributes
    ----------
    meta : dict
        The JSON under the metadata key ``seqsweep``.
    responses : tuple of FrequencyResponse
        In campaign order; the ``meta`` of each is its entry in ``operating_points``.
    """

    meta: dict[str, Any]
    responses: tuple[FrequencyResponse, ...]

    @property
    def op_ids(self) -> tuple[str, ...]:
        """Names of the operating points, in campaign order."""
        return tuple(response.meta["op_id"] for response in self.responses)

    def response(self, op_id: str) -> FrequencyResponse:
        """The response of one operating point; `TableError` where there is none of that name."""
        if op_id not in self.op_ids:
            raise TableError(f"no operating point {op_id!r} in the table; it has {', '.join(self.op_ids)}")
        return self.responses[self.op_ids.index(op_id)]


# Writing


def write_table(path: str | Path, responses: Iterable[FrequencyResponse], meta: Mapping[str, Any]) -> None:
    """Write a table atomically: afterwards the whole of it is at ``path``, or what was there before.

    Parameters
    ----------
    path : path
        Replaced if it exists. A writer killed half-way leaves ``.NAME.PID.tmp`` beside it.
    responses : iterable of FrequencyResponse
        In the order of ``meta["operating_points"]``, named by their ``meta["op_id"]``, in the pn
        frame, equally long. May be a generator: at most `ROW_GROUP_ROWS` rows and one response
        are held at a time, and the bytes do not depend on how the rows arrive.
    meta : mapping
        ``f1_hz``, ``bases`` (rated_voltage_v, rated_power_va), ``power_meaning``,
        ``operating_points``, ``configuration``, ``plant``, and ``seeds`` where there are any; see
        `complete_metadata` for the rest.

    Raises
    ------
    TableError
        If metadata and responses do not agree; nothing is written.
    OSError
        If the machine refuses (disk full, permission); nothing is left behind.
    """
    completed = complete_metadata(meta)
    with atomic_file(path) as file:
        _write(file, responses, completed)


def complete_metadata(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata as it is stored: definitions, tool version and hashes added to what the caller knows.

    Raises
    ------
    TableError
        If a required key is missing, a key is unknown, a fixed one differs, or a value is not JSON.
    """
    if missing := sorted(_REQUIRED - set(meta)):
        raise TableError(f"metadata lacks {', '.join(missing)}")
    if unknown := sorted(set(meta) - _REQUIRED - _OPTIONAL):
        raise TableError(f"metadata has no place for {', '.join(unknown)}; put it into configuration or plant")
    for key, value in _FIXED.items():
        if meta.get(key, value) != value:
            raise TableError(f"metadata {key} is {meta[key]!r}; this version of the format has {value!r}")
    _check_points(meta["operating_points"])
    if set(meta["bases"]) - {"amplitude_pu"} != _BASES:
        raise TableError(f"metadata bases are {', '.join(sorted(_BASES))}; given {', '.join(sorted(meta['bases']))}")
    completed: dict[str, Any] = {"seeds": {}, "tool": _tool(), **meta, **_FIXED}
    completed["bases"] = {**meta["bases"], "amplitude_pu": AMPLITUDE_PU}
    completed["configuration_sha256"] = content_hash(meta["configuration"])
    return {**json.loads(canonical_json(completed)), "sha256": metadata_hash(completed)}


def _check_points(points: Sequence[Mapping[str, Any]]) -> None:
    """Refuse operating points without name, power or voltage, and names used twice."""
    if not points:
        raise TableError("metadata has no operating points")
    for number, point in enumerate(points, start=1):
        if missing := sorted(_POINT - set(point)):
            raise TableError(f"operating point {number} of the metadata lacks {', '.join(missing)}")
    counts = Counter(point["op_id"] for point in points)
    if twice := [name for name, n in counts.items() if n > 1]:
        raise TableError(f"operating point {twice[0]!r} is listed twice in the metadata")


def metadata_hash(meta: Mapping[str, Any]) -> str:
    """Hash of the metadata without the hash itself: Parquet checksums its pages, not its footer."""
    return content_hash({key: value for key, value in meta.items() if key != "sha256"})


def content_hash(value: Any) -> str:
    """sha256 (hexadecimal) of the canonical JSON of ``value``."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no blanks: equal values give equal text.

    Raises
    ------
    TableError
        If ``value`` holds something JSON does not know, NaN and infinity included.
    """
    try:
        return json.dumps(
            value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_plain
        )
    except (TypeError, ValueError) as error:
        raise TableError(f"metadata must be JSON: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} {value!r} has no JSON form")


def _tool() -> dict[str, str]:
    from importlib.metadata import version

    return {"name": "seqsweep", "version": version("seqsweep")}


@contextmanager
def atomic_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new binary file that takes the place of ``path`` if, and only if, the block succeeds."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Make a rename durable; it lives in the folder, not in the file."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write(file: BinaryIO, responses: Iterable[FrequencyResponse], meta: Mapping[str, Any]) -> None:
    import pyarrow.parquet as pq

    schema = _arrow_schema()
    strings = [column.name for column in COLUMNS if column.kind == "string"]
    doubles = [_leaf(column) for column in COLUMNS if column.kind != "string"]
    with pq.ParquetWriter(
        file,
        schema,
        compression="zstd",
        use_dictionary=strings,
        use_byte_stream_split=doubles,
        write_page_checksum=True,
    ) as writer:
        for group in _row_groups(_checked(responses, meta), schema):
            writer.write_table(group, row_group_size=ROW_GROUP_ROWS)
        writer.add_key_value_metadata({METADATA_KEY: canonical_json(meta).encode()})


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


def _checked(responses: Iterable[FrequencyResponse], meta: Mapping[str, Any]) -> Iterator[FrequencyResponse]:
    """Pass the responses on while they are those the metadata announces."""
    expected = [point["op_id"] for point in meta["operating_points"]]
    n_rows: int | None = None
    n_points = 0
    for response in responses:
        op_id = response.meta.get("op_id")
        if n_points == len(expected) or op_id != expected[n_points]:
            due = expected[n_points] if n_points < len(expected) else "none"
            raise TableError(f"response {n_points + 1} is of operating point {op_id!r}; the metadata has {due!r} there")
        n_rows = len(response) if n_rows is None else n_rows
        _check_response(response, meta["f1_hz"], n_rows)
        n_points += 1
        yield response
    if n_points != len(expected):
        raise TableError(
            f"{n_points} responses for {len(expected)} operating points; {expected[n_points]!r} is missing"
        )


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
    import pyarrow as pa

    pending = None
    for response in responses:
        fresh = _arrow_table(_columns(response), schema)
        pending = fresh if pending is None else pa.concat_tables([pending, fresh])
        while pending.num_rows >= ROW_GROUP_ROWS:
            yield pending.slice(0, ROW_GROUP_ROWS).combine_chunks()  # page borders follow chunks: leave none
            pending = pending.slice(ROW_GROUP_ROWS)
    if pending is not None and pending.num_rows:
        yield pending.combine_chunks()


def rows_of(responses: Iterable[FrequencyResponse]) -> dict[str, np.ndarray]:
    """Columns of several responses, one after the other, before they are written: for `table_rules`."""
    return _joined([_columns(response) for response in responses])


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


# Covariance


def pack_covariance(covariance: np.ndarray) -> np.ndarray:
    """Upper triangles (n, 36) of symmetric matrices (n, 8, 8), row after row (S^2)."""
    return covariance[:, UPPER[0], UPPER[1]]


def unpack_covariance(cov: np.ndarray) -> np.ndarray:
    """Symmetric matrices (n, 8, 8) from their upper triangles (n, 36) (S^2)."""
    covariance = np.empty((len(cov), 8, 8))
    covariance[:, UPPER[0], UPPER[1]] = cov
    covariance[:, UPPER[1], UPPER[0]] = cov
    return covariance


def std_of(covariance: np.ndarray) -> np.ndarray:
    """Standard deviations (n, 4) of the complex pp, pn, np, nn: sqrt(var re + var im) (S)."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.sqrt(variance[:, 0::2] + variance[:, 1::2])


# Reading


def read_table(path: str | Path) -> Table:
    """Read a table, page checksums and the hash of its metadata verified.

    Raises
    ------
    TableError
        If the file is missing, is not Parquet, is truncated or damaged, is someone else's Parquet,
        has a version this code does not know, lacks a column or has one of a wrong type, or if its
        rows are not those its metadata announces.
    """
    with _opened(path) as (file, meta):
        return Table(meta, tuple(_responses(path, file, meta)))


def iter_responses(path: str | Path) -> Iterator[FrequencyResponse]:
    """Yield the responses of a table in campaign order, a few operating points in memory at a time.

    Raises
    ------
    TableError
        As `read_table`, but not before the damaged place is reached.
    """
    with _opened(path) as (file, meta):
        yield from _responses(path, file, meta)


def read_metadata(path: str | Path) -> dict[str, Any]:
    """Read the metadata of a table and nothing else; raises as `read_table`."""
    with _opened(path) as (_, meta):
        return meta


@contextmanager
def _opened(path: str | Path) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Parquet file and metadata of a table; whatever pyarrow has to say becomes a `TableError`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not Path(path).exists():
        raise TableError(f"{path}: no such file")
    if not Path(path).is_file():
        raise TableError(f"{path}: not a file")
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: not a Parquet file, or a truncated one ({_line(error)}); {_HOW}") from error
    with file:
        meta = _metadata(path, file)
        try:
            yield file, meta
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise TableError(f"{path}: damaged, its data cannot be read ({_line(error)})") from error


def _line(error: Exception) -> str:
    """First line of an error message, short enough for a terminal."""
    return str(error).partition("\n")[0][:200] or type(error).__name__


def _metadata(path: str | Path, file: Any) -> dict[str, Any]:
    """Parse the metadata of an open Parquet file, and see that this code can read it."""
    text = (file.metadata.metadata or {}).get(METADATA_KEY)
    if text is None:
        raise TableError(
            f"{path}: Parquet, but not a table of seqsweep (no metadata key {METADATA_KEY.decode()!r}); {_HOW}"
        )
    try:
        meta = json.loads(text)
    except ValueError as error:
        raise TableError(f"{path}: metadata is damaged, it is not JSON ({_line(error)})") from error
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise TableError(f"{path}: metadata does not name the format {FORMAT!r}")
    if not re.fullmatch(r"1\.\d+\.\d+", str(meta.get("version"))):
        raise TableError(f"{path}: version {meta.get('version')!r} of the format; this code reads 1.x")
    if meta.get("sha256") != metadata_hash(meta):
        raise TableError(f"{path}: metadata is damaged, it does not match its hash (key 'sha256')")
    return meta


def _responses(path: str | Path, file: Any, meta: Mapping[str, Any]) -> Iterator[FrequencyResponse]:
    if problems := _column_problems(file.schema_arrow):
        raise TableError(f"{path}: {problems[0]}")
    points = _points(path, meta)
    names = [column.name for column in COLUMNS]
    batches = file.iter_batches(batch_size=ROW_GROUP_ROWS, columns=names)
    n_points = 0
    for columns in _runs(_numpy(path, batch) for batch in batches):
        op_id = str(columns["op_id"][0])
        if n_points == len(points) or points[n_points]["op_id"] != op_id:
            raise TableError(f"{path}: rows of {op_id!r} are not where the metadata has that operating point")
        yield _response(path, columns, meta["f1_hz"], points[n_points])
        n_points += 1
    if n_points != len(points):
        raise TableError(f"{path}: no rows for operating point {points[n_points]['op_id']!r}")


def _points(path: str | Path, meta: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Operating points of somebody else's metadata: as much is checked as reading needs."""
    points = meta.get("operating_points")
    named = isinstance(points, list) and all(isinstance(point, dict) and "op_id" in point for point in points)
    if not named or not isinstance(meta.get("f1_hz"), int | float):
        raise TableError(f"{path}: metadata lacks f1_hz or operating_points with op_id; see `seqsweep validate`")
    return list(points or [])


def _column_problems(schema: Any) -> list[str]:
    """What is wrong with the columns of an Arrow schema: missing ones, doubled ones, wrong types."""
    twice = [f"column {c.name!r} is there twice" for c in COLUMNS if schema.names.count(c.name) > 1]
    found = {field.name: _kind(field.type) for field in schema}
    missing = [f"column {c.name!r} is missing" for c in COLUMNS if c.name not in found]
    wrong = [
        f"column {c.name!r} has type {found[c.name]}, not {c.kind}"
        for c in COLUMNS
        if c.name in found and found[c.name] != c.kind
    ]
    return missing + twice + wrong


def _kind(arrow_type: Any) -> str:
    """Kind of an Arrow type; its flavours of strings and lists are one thing in Parquet."""
    import pyarrow.types as types

    if types.is_string(arrow_type) or types.is_large_string(arrow_type):
        return "string"
    if types.is_list(arrow_type) or types.is_large_list(arrow_type) or types.is_fixed_size_list(arrow_type):
        return f"list of {arrow_type.value_type}"
    return str(arrow_type)


def _numpy(path: str | Path, batch: Any) -> dict[str, np.ndarray]:
    """Columns (n,) of an Arrow batch or table; ``cov`` is (n, 36)."""
    if null := next((c.name for c in COLUMNS if batch.column(c.name).null_count), None):
        raise TableError(f"{path}: column {null!r} holds nulls; unknown numbers are NaN")
    columns = {}
    for name, kind, _ in COLUMNS:
        values = batch.column(name)
        if kind == "list of double":
            columns[name] = _cov(path, values)
        else:
            columns[name] = np.asarray(values.to_numpy(zero_copy_only=False), dtype=str if kind == "string" else float)
    return columns


def _cov(path: str | Path, values: Any) -> np.ndarray:
    import pyarrow.compute as pc

    lengths = pc.list_value_length(values).to_numpy(zero_copy_only=False)
    flat = pc.list_flatten(values)
    if np.any(lengths != N_COV) or flat.null_count:
        raise TableError(f"{path}: column 'cov' must hold {N_COV} doubles in every row")
    return np.asarray(flat.to_numpy(zero_copy_only=False), dtype=float).reshape(-1, N_COV)


def _runs(portions: Iterable[dict[str, np.ndarray]]) -> Iterator[dict[str, np.ndarray]]:
    """Regroup portions of columns into one set per operating point; a point may span portions."""
    pending: list[dict[str, np.ndarray]] = []
    for portion in portions:
        for run in _split(portion):
            if pending and pending[0]["op_id"][0] != run["op_id"][0]:
                yield _joined(pending)
                pending = []
            pending.append(run)
    if pending:
        yield _joined(pending)


def _split(columns: Mapping[str, np.ndarray]) -> Iterator[dict[str, np.ndarray]]:
    """Cut columns wherever the operating point changes from one row to the next."""
    op_id = columns["op_id"]
    cuts = [0, *(np.flatnonzero(op_id[1:] != op_id[:-1]) + 1).tolist(), len(op_id)]
    for start, stop in pairwise(cuts):
        if stop > start:
            yield {name: values[start:stop] for name, values in columns.items()}


def _joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _response(
    path: str | Path, columns: Mapping[str, np.ndarray], f1_hz: float, point: Mapping[str, Any]
) -> FrequencyResponse:
    y = np.empty((len(columns["f_hz"]), 4), dtype=complex)
    for k, element in enumerate(ELEMENTS):
        y[:, k].real = columns[f"y_{element}_re"]
        y[:, k].imag = columns[f"y_{element}_im"]
    try:
        return FrequencyResponse(
            f_hz=columns["f_hz"],
            y=y.reshape(-1, 2, 2),
            f1_hz=f1_hz,
            covariance=unpack_covariance(columns["cov"]),
            status=columns["status"],
            reason=columns["reason"],
            quality={name: columns[name] for name in QUALITY},
            meta=point,
        )
    except ValueError as error:
        raise TableError(f"{path}: {point['op_id']}: {error}") from error


# Conformance


def validate_table(path: str | Path) -> list[str]:
    """Every violation of the format found in a file; an empty list says that it conforms.

    Rows are judged once the columns are there and of the right type. Nothing is raised: a file
    that cannot be read at all is a violation too.
    """
    from . import table_rules

    violations: list[str] = []
    try:
        with _opened(path) as (file, meta):
            violations += table_rules.metadata_violations(meta)
            violations += _schema_violations(file.schema_arrow)
            if not _column_problems(file.schema_arrow):
                columns = _numpy(path, file.read([column.name for column in COLUMNS]))
                violations += table_rules.row_violations(columns, meta)
    except TableError as error:
        violations.append(str(error))
    return violations


def _schema_violations(schema: Any) -> list[str]:
    """Problems of the columns, order and units included; further columns may follow ours."""
    if problems := _column_problems(schema):
        return problems
    expected = [column.name for column in COLUMNS]
    order = [] if schema.names[: len(expected)] == expected else [f"columns must begin with {', '.join(expected)}"]
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in expected}
    wrong = [
        f"column {c.name!r} has unit {units[c.name]!r}, not {c.unit!r}" for c in COLUMNS if units[c.name] != c.unit
    ]
    return order + wrong
