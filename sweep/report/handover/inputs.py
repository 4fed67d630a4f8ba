"""What a report is made from: one table, and the results that other commands wrote about it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ....identify.table.read import Table, read_metadata, read_table
from ....plant.errors import SeqsweepError
from .bank import metadata_of, read_bank

KINDS = {
    "seqsweep-tuning": "tuning",
    "seqsweep-verification": "verification",
    "seqsweep-metrics": "metrics",
    "seqsweep-farm": "farm",
    "seqsweep-farm-states": "states",
    "seqsweep-judge": "bank",
}
"""Formats of results and what a report calls them."""

ALONE = ("farm", "states")
"""Kinds of results that need no table: a farm names its tables itself."""


class ReportError(SeqsweepError):
    """Files that no report can be made from, with the way out."""


class File(NamedTuple):
    """One of the files: its name, what it holds, and its sha256."""

    name: str
    kind: str
    sha256: str


@dataclass(frozen=True)
class Inputs:
    """Everything a report rests on.

    Attributes
    ----------
    table : Table
        The admittance.
    results : mapping of str to object
        Results by kind (`KINDS`, and "surrogate"): plain JSON values; of a bank a `Bank`, of a surrogate the model.
    files : tuple of File
        In the order in which they were given.
    foreign : tuple of str
        Kinds of results that say that they were made from another table.
    """

    table: Table
    results: Mapping[str, Any]
    files: tuple[File, ...]
    foreign: tuple[str, ...] = ()

    def name_of(self, kind: str) -> str:
        """Name of the file of a kind."""
        return next(file.name for file in self.files if kind in (file.kind, *file.kind.split(" and ")))


@dataclass(frozen=True)
class FarmInputs:
    """Results of `seqsweep farm`, without a table.

    Attributes
    ----------
    results : mapping of str to object
        "farm", "states" or both, as their files have them.
    files : tuple of File
        Name, kind and sha256.
    """

    results: Mapping[str, Any]
    files: tuple[File, ...]


def read_any(paths: Sequence[Path]) -> Inputs | FarmInputs:
    """As `read_inputs`; results of `seqsweep farm` may also stand without a table."""
    found = [(_kind_of(path), path) for path in paths]
    if not found or any(kind not in ALONE for kind, _ in found):
        return read_inputs(paths)
    kinds = _apart(found)
    files = tuple(File(path.name, kind, _sha256(path)) for kind, path in kinds.items())
    return FarmInputs({kind: _json(path) for kind, path in kinds.items()}, files)


def read_inputs(paths: Sequence[Path]) -> Inputs:
    """Read and sort the files; exactly one is a table, of every other kind there is at most one.

    A surrogate's file holds the sweeps that it rests on: it is the table, too, where no other is given.

    Raises
    ------
    ReportError
        If a file is of no known kind, or a kind is there twice, or the table is missing.
    TableError
        If the table cannot be read.
    """
    kinds = _only_one_each([(_kind_of(path), path) for path in paths])
    table = read_table(kinds.get("table") or kinds["surrogate"])
    results = {kind: _content(kind, path) for kind, path in kinds.items() if kind != "table"}
    foreign = tuple(kind for kind, content in results.items() if not _belongs(content, table.meta["sha256"]))
    alone = "table" not in kinds
    names = {path: "table and surrogate" if alone and kind == "surrogate" else kind for kind, path in kinds.items()}
    return Inputs(table, results, tuple(File(path.name, names[path], _sha256(path)) for path in paths), foreign)


def _only_one_each(found: Sequence[tuple[str, Path]]) -> dict[str, Path]:
    kinds = _apart(found)
    tables = [path for kind, path in found if kind == "table"]
    if len(tables) > 1 or not {"table", "surrogate"} & set(kinds):
        raise ReportError(
            f"{len(tables)} tables given; needed is exactly one TABLE.parquet, and results about it (the JSON of "
            "seqsweep farm alone needs none)"
        )
    return kinds


def _apart(found: Sequence[tuple[str, Path]]) -> dict[str, Path]:
    kinds: dict[str, Path] = {}
    for kind, path in found:
        if kind in kinds and kind != "table":
            raise ReportError(f"{path}: a second result of kind {kind}; a report takes one of each")
        kinds[kind] = path
    return kinds


def _kind_of(path: Path) -> str:
    if not path.is_file():
        raise ReportError(f"{path}: no such file")
    if path.suffix.lower() == ".parquet":
        return _kind_of_parquet(path)
    content = _json(path)
    kind = KINDS.get(content.get("format", "")) if isinstance(content, dict) else None
    if kind is None:
        raise ReportError(f"{path}: not a result of seqsweep; known formats are {', '.join(KINDS)}")
    return kind


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except UnicodeDecodeError:
        raise ReportError(f"{path}: neither a table nor a JSON result of seqsweep: it is no text") from None
    except json.JSONDecodeError as error:
        raise ReportError(f"{path}: neither a table nor a JSON result of seqsweep: {error}") from None


def _kind_of_parquet(path: Path) -> str:
    """A table of admittances, a surrogate, or the rows of `seqsweep judge`."""
    meta = _parquet_meta(path)
    if meta.get("format") == "seqsweep-judge":
        return "bank"
    return "surrogate" if read_metadata(path).get("surrogate") else "table"


def _parquet_meta(path: Path) -> dict[str, Any]:
    import pyarrow.parquet as pq

    try:
        return metadata_of(pq.read_schema(path).metadata)
    except Exception:  # pyarrow raises its own kinds for every sort of damage
        raise ReportError(f"{path}: not a Parquet file, or a truncated one") from None


def _content(kind: str, path: Path) -> Any:
    if kind == "bank":
        return read_bank(path, _parquet_meta(path))
    if kind == "surrogate":
        from ....identify.surrogate.store import read_surrogate

        return read_surrogate(path)
    return _json(path)


def _belongs(content: Any, sha256: str) -> bool:
    """Whether a result says that it rests on this table; one that says nothing is taken to."""
    said = content if isinstance(content, Mapping) else getattr(content, "meta", {})
    provenance = said.get("provenance") or {}
    of_table = (provenance.get("table") or {}).get("sha256") or provenance.get("table_sha256")
    return of_table is None or of_table == sha256


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
