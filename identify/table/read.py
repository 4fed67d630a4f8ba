"""Reading the table, and holding it against its format: Parquet, one row per operating point and frequency.

pyarrow is imported where it is used: a command that only prints its help must not pay for it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...plant.errors import place_of
from ..read_only import read_only
from ..response import FrequencyResponse
from .arrow_columns import doubles, doubles_in_lists, strings
from .format import (
    COLUMNS,
    ELEMENTS,
    FORMAT,
    METADATA_KEY,
    N_COV,
    QUALITY,
    ROW_GROUP_ROWS,
    TableError,
    joined,
    metadata_hash,
    unpack_covariance,
)

if TYPE_CHECKING:
    import pandas as pd

_FOOTER_BYTES = 100_000_000
"""Longest text in the foot of a file that is read without being asked; that of a campaign may be longer."""

_HOW = "another tool's file becomes a table by `seqsweep import`, a recording by `seqsweep identify`"


@dataclass(frozen=True, slots=True, repr=False, eq=False)
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

    def __len__(self) -> int:
        return len(self.responses)

    def __iter__(self) -> Iterator[FrequencyResponse]:
        return (self[op_id] for op_id in self.op_ids)

    def __getitem__(self, op_id: str) -> FrequencyResponse:
        """The response of one operating point; under ``meta["table"]`` it keeps what the table says of all of them."""
        response = self.response(op_id)
        shared = read_only(
            {key: value for key, value in self.meta.items() if key not in ("operating_points", "sha256")}
        )
        return replace(response, meta={**response.meta, "table": shared})

    def __repr__(self) -> str:
        from ..views.words import table_in_a_line

        return table_in_a_line(self.responses)

    def _repr_html_(self) -> str:
        from ..views.words import table_as_html

        return table_as_html(self.responses)

    def to_dataframe(self) -> pd.DataFrame:
        """A pandas frame of all operating points, with the index (``op_id``, ``f_hz``)."""
        import pandas as pd

        return pd.concat({str(response.meta["op_id"]): response.to_dataframe() for response in self}, names=["op_id"])

    def plot(self, ax: Any = None) -> Any:
        """Bode plot of the first operating points, as `FrequencyResponse.plot`."""
        from ..views.bode import shown

        return shown(self.responses, ax)

    def response(self, op_id: str) -> FrequencyResponse:
        """The response of one operating point; `TableError` where there is none of that name."""
        return self.responses[place_of(op_id, self.op_ids, "the table", TableError)]


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
        raise TableError(f"{path}: not a file; name a table")
    try:
        longest = max(_FOOTER_BYTES, Path(path).stat().st_size)
        file = pq.ParquetFile(path, page_checksum_verification=True, thrift_string_size_limit=min(longest, 2**31 - 1))
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: not a Parquet file, or a truncated one; {_HOW}") from error
    with file:
        meta = _metadata(path, file)
        try:
            yield file, meta
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise TableError(f"{path}: damaged, its data cannot be read{_checksum(error)}") from error


def _checksum(error: Exception) -> str:
    """What of pyarrow's words helps: that a page is not what was written."""
    return " (CRC of a page is wrong): copy it again" if "CRC" in str(error) else ": copy it again"


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


def _line(error: Exception) -> str:
    """First line of an error message, short enough for a terminal."""
    return str(error).partition("\n")[0][:200] or type(error).__name__


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
            columns[name] = strings(values) if kind == "string" else doubles(values)
    return columns


def _cov(path: str | Path, values: Any) -> np.ndarray:
    cov = doubles_in_lists(values, N_COV)
    if cov is None:
        raise TableError(f"{path}: column 'cov' must hold {N_COV} doubles in every row")
    return cov


def _runs(portions: Iterable[dict[str, np.ndarray]]) -> Iterator[dict[str, np.ndarray]]:
    """Regroup portions of columns into one set per operating point; a point may span portions."""
    pending: list[dict[str, np.ndarray]] = []
    for portion in portions:
        for run in _split(portion):
            if pending and pending[0]["op_id"][0] != run["op_id"][0]:
                yield joined(pending)
                pending = []
            pending.append(run)
    if pending:
        yield joined(pending)


def _split(columns: Mapping[str, np.ndarray]) -> Iterator[dict[str, np.ndarray]]:
    """Cut columns wherever the operating point changes from one row to the next."""
    op_id = columns["op_id"]
    cuts = [0, *(np.flatnonzero(op_id[1:] != op_id[:-1]) + 1).tolist(), len(op_id)]
    for start, stop in pairwise(cuts):
        if stop > start:
            yield {name: values[start:stop] for name, values in columns.items()}


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
    from . import rules as table_rules

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
