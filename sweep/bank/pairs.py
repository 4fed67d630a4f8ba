"""The pairs of a bank on the disk, not in memory: written as they come, read the worst first.

A line of JSON per pair in a nameless temporary file, and of each pair its order, its place and its length: 29 bytes.
"""

from __future__ import annotations

import json
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, overload

import numpy as np

from ...tuning.bank.edges import ElementEdge
from ...tuning.bank.judgement import PairVerdict

_INDEX = np.dtype([("order", "i1"), ("worth", "f8"), ("grid", "i4"), ("op", "i4"), ("at", "i8"), ("length", "i4")])


def severity(verdict: PairVerdict) -> tuple[int, float, str, str]:
    """Order of the report: unstable, undecided, failed, stable; the least damped first."""
    return *_urgency(verdict), verdict.grid_id, verdict.op_id


def _urgency(verdict: PairVerdict) -> tuple[int, float]:
    order = {"unstable": 0, "undecided": 1, "stable": 3}[verdict.verdict] if verdict.status == "ok" else 2
    return order, float(-np.inf if verdict.re_rad_s is None else -verdict.re_rad_s)


def to_text(verdicts: Sequence[PairVerdict]) -> str:
    """Pairs as one line of JSON."""
    return json.dumps([asdict(verdict) for verdict in verdicts])


def from_text(text: str) -> list[PairVerdict]:
    """What `to_text` wrote."""
    return [_verdict(values) for values in json.loads(text)]


def _verdict(values: dict[str, Any]) -> PairVerdict:
    elements = tuple(ElementEdge(*each) for each in values.pop("elements"))
    missing = values.pop("missing_hz")
    warnings = tuple(values.pop("warnings"))
    return PairVerdict(
        **values, elements=elements, missing_hz=None if missing is None else tuple(missing), warnings=warnings
    )


class _Lines:
    """A nameless temporary file that is closed when nobody reads from it any more."""

    def __init__(self, folder: Path | None) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def put(self, text: bytes) -> int:
        """Put a text at the end; gives its place."""
        at = self._file.seek(0, 2)
        self._file.write(text)
        return at

    def read(self, at: int, length: int) -> bytes:
        """The text of a place."""
        self._file.seek(at)
        return self._file.read(length)


class PairFile:
    """Where pairs are put as they come.

    Parameters
    ----------
    folder : Path or None
        On which disk; None: that of temporary files.
    grid_ids, op_ids : sequence of str
        The names of all grids and operating points.
    """

    def __init__(self, folder: Path | None, grid_ids: Sequence[str], op_ids: Sequence[str]) -> None:
        self._lines = _Lines(folder)
        self._rank = [{name: k for k, name in enumerate(sorted(set(names)))} for names in (grid_ids, op_ids)]
        self._index = np.zeros(len(grid_ids) * len(op_ids), dtype=_INDEX)
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def add(self, verdicts: Sequence[PairVerdict]) -> None:
        """Put pairs at the end."""
        grids, points = self._rank
        for verdict in verdicts:
            text = to_text([verdict]).encode()
            place = grids[verdict.grid_id], points[verdict.op_id], self._lines.put(text), len(text)
            self._index[self._n] = (*_urgency(verdict), *place)
            self._n += 1

    def worst_first(self) -> Pairs:
        """All pairs in the order of `severity`."""
        index = self._index[: self._n]
        order = np.lexsort((index["op"], index["grid"], index["worth"], index["order"]))
        return Pairs(self._lines, index[order])


class Pairs(Sequence[PairVerdict]):
    """Pairs in order, each read from the disk when it is asked for.

    Parameters
    ----------
    lines : _Lines
        Their texts.
    index : (n,) structured array
        Place and length of each.
    replaced : mapping of int to PairVerdict
        Pairs that stand in memory in place of those of the file.
    """

    def __init__(self, lines: _Lines, index: np.ndarray, replaced: Mapping[int, PairVerdict] | None = None) -> None:
        self._lines, self._index, self._replaced = lines, index, replaced or {}

    def __len__(self) -> int:
        return len(self._index)

    @overload
    def __getitem__(self, at: int) -> PairVerdict: ...

    @overload
    def __getitem__(self, at: slice) -> list[PairVerdict]: ...

    def __getitem__(self, at: int | slice) -> PairVerdict | list[PairVerdict]:
        places = range(len(self))[at]
        return self._read(places) if isinstance(places, int) else [self._read(place) for place in places]

    def __iter__(self) -> Iterator[PairVerdict]:
        return map(self._read, range(len(self)))

    def replacing(self, replaced: Mapping[int, PairVerdict]) -> Pairs:
        """The same pairs with others in some places."""
        return Pairs(self._lines, self._index, {**self._replaced, **replaced})

    def _read(self, place: int) -> PairVerdict:
        if place in self._replaced:
            return self._replaced[place]
        at, length = int(self._index["at"][place]), int(self._index["length"][place])
        (verdict,) = from_text(self._lines.read(at, length).decode())
        return verdict
