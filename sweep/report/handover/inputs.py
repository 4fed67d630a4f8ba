"""What a report is made from: one table, and the results that other commands wrote about it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ....identify.table.read import Table, read_table
from ....plant.errors import SeqsweepError

KINDS = {
    "seqsweep-tuning": "tuning",
    "seqsweep-verification": "verification",
    "seqsweep-metrics": "metrics",
    "seqsweep-farm": "farm",
    "seqsweep-judge": "bank",
}
"""Formats of results and what a report calls them."""


class ReportError(SeqsweepError):
    """Files that no report can be made from, with the way out."""


@dataclass(frozen=True)
class Inputs:
    """Everything a report rests on.

    Attributes
    ----------
    table : Table
        The admittance.
    results : mapping of str to object
        Results by kind (`KINDS`): plain JSON values, of a bank the list of its rows.
    hashes : mapping of str to str
        sha256 of every file by its name.
    """

    table: Table
    results: Mapping[str, Any]
    hashes: Mapping[str, str]
    foreign: tuple[str, ...] = field(default=())


def read_inputs(paths: Sequence[Path]) -> Inputs:
    """Read and sort the files; exactly one is a table, of every other kind there is at most one.

    Raises
    ------
    ReportError
        If a file is of no known kind, or a kind is there twice, or the table is missing.
    TableError
        If the table cannot be read.
    """
    tables: list[Path] = []
    results: dict[str, Any] = {}
    for path in paths:
        kind, content = _opened(path)
        if kind == "table":
            tables.append(path)
        elif kind in results:
            raise ReportError(f"{path}: a second result of kind {kind}; a report takes one of each")
        else:
            results[kind] = content
    if len(tables) != 1:
        raise ReportError(f"{len(tables)} tables given; needed is exactly one TABLE.parquet, and results about it")
    table = read_table(tables[0])
    foreign = tuple(kind for kind, content in results.items() if not _belongs(content, table.meta["sha256"]))
    return Inputs(table, results, {path.name: _sha256(path) for path in paths}, foreign)


def _opened(path: Path) -> tuple[str, Any]:
    if not path.is_file():
        raise ReportError(f"{path}: no such file")
    if path.suffix.lower() == ".parquet":
        return _parquet(path)
    try:
        content = json.loads(path.read_text("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ReportError(f"{path}: neither a table nor a JSON result of seqsweep: {error}") from None
    kind = KINDS.get(content.get("format", "")) if isinstance(content, dict) else None
    if kind is None:
        raise ReportError(f"{path}: not a result of seqsweep; known formats are {', '.join(KINDS)}")
    return kind, content


def _parquet(path: Path) -> tuple[str, Any]:
    """A table of admittances, or the rows of `seqsweep judge`."""
    import pyarrow.parquet as pq

    try:
        schema = pq.read_schema(path)
    except Exception as error:  # pyarrow raises its own kinds for every sort of damage
        raise ReportError(f"{path}: not a Parquet file: {str(error).splitlines()[0]}") from None
    meta = json.loads((schema.metadata or {}).get(b"seqsweep", b"{}"))
    if meta.get("format") == "seqsweep-judge":
        return "bank", {**meta, "rows": pq.read_table(path).to_pylist()}
    return "table", None


def _belongs(content: Any, sha256: str) -> bool:
    """Whether a result says that it rests on this table; one that says nothing is taken to."""
    provenance = content.get("provenance") or {}
    said = (provenance.get("table") or {}).get("sha256") or provenance.get("table_sha256")
    return said is None or said == sha256


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
