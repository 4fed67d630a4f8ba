"""`seqsweep judge`: the pairs through joblib, shards on the way, one Parquet file at the end.

Each operating point is fitted once and judged on the whole bank, grid by grid. What is done is kept in
``OUTPUT.parts`` under a hash of the table, the grid and the options: the same command goes on where it was ended, and
a grid that was changed is judged again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.response import FrequencyResponse
from ...plant.errors import SeqsweepError
from ...tuning.bank.edges import ElementEdge
from ...tuning.bank.entries import BankEntry
from ...tuning.bank.judgement import PairVerdict, judge_pair
from ...tuning.tune import Device, fitted
from ..run import shards
from .following import Following

VERSION = "2"
"""Of the judgement: other numbers for the same pair are another version."""

CHUNK = 25
"""Pairs judged and kept together."""

DeviceOn = Callable[[BankEntry], Device]
"""The device as it is judged on a grid."""

Report = Callable[[int, int], None]
"""Called with (pairs done, pairs in all)."""


class JudgeError(SeqsweepError):
    """A bank that cannot be judged as the call was made."""


class Chunk(NamedTuple):
    """Grids that one worker judges for one operating point; ``key`` names the shard."""

    op: int
    entries: tuple[BankEntry, ...]
    key: str


def judge_bank(
    responses: Sequence[FrequencyResponse] | Following,
    bases: Mapping[str, Any],
    digest: str,
    entries: Sequence[BankEntry],
    *,
    output: Path | None,
    jobs: int,
    elements: int,
    discard: bool = False,
    report: Report = lambda done, total: None,
) -> list[PairVerdict]:
    """Every operating point on every grid, worst first.

    Parameters
    ----------
    responses : sequence of FrequencyResponse or Following
        Operating points of the device, or dispatches whose operating point follows from each grid.
    bases : mapping
        Its rating.
    digest : str
        Hash of the device's table.
    entries : sequence of BankEntry
        The bank.
    output : path or None
        Beside it the shards are kept; None keeps none.
    jobs : int
        Workers (processes).
    elements : int
        For how many of the worst pairs the critical value of every element is sought.
    discard : bool
        Whether unfinished work of another bank on this output may go.
    report : callable
        Progress.
    """
    chunks = list(_chunks(len(responses), entries, digest))
    folder = None if output is None else shards.folder_of(output)
    with nullcontext() if folder is None else shards.locked(folder):
        if folder is not None and not discard:
            _refuse_strangers(folder, chunks)
        done = {} if folder is None else {c.key: found for c in chunks if (found := _kept(folder, c.key)) is not None}
        total, finished = len(responses) * len(entries), sum(len(found) for found in done.values())
        report(finished, total)
        for key, found in _missing(responses, bases, [c for c in chunks if c.key not in done], jobs):
            if folder is not None:
                shards.keep(folder, key, json.dumps([_plain(v) for v in found]))
            done[key] = found
            finished += len(found)
            report(finished, total)
    verdicts = sorted((v for chunk in chunks for v in done[chunk.key]), key=severity)
    return _with_elements(responses, bases, entries, verdicts, elements)


def severity(verdict: PairVerdict) -> tuple[int, float, str, str]:
    """Order of the report: unstable, undecided, failed, stable; the least damped first."""
    order = {"unstable": 0, "undecided": 1, "stable": 3}[verdict.verdict] if verdict.status == "ok" else 2
    worth = -np.inf if verdict.re_rad_s is None else -verdict.re_rad_s
    return order, float(worth), verdict.grid_id, verdict.op_id


# Chunks --------------------------------------------------------------------------------------------------------------


def _chunks(n_points: int, entries: Sequence[BankEntry], digest: str) -> Iterator[Chunk]:
    marks = [_mark(entry) for entry in entries]
    for op in range(n_points):
        for first in range(0, len(entries), CHUNK):
            part = slice(first, first + CHUNK)
            text = json.dumps([VERSION, digest, op, marks[part]])
            yield Chunk(op, tuple(entries[part]), hashlib.sha256(text.encode()).hexdigest())


def _mark(entry: BankEntry) -> str:
    """A hash of what the grid is: the file's bytes, the document, or the rows."""
    content = hashlib.sha256(entry.grid_id.encode())
    if entry.file:
        path = Path(entry.file.partition("#")[0])
        content.update(path.read_bytes() if path.is_file() else b"")
        content.update(entry.file.partition("#")[2].encode())
    if entry.document is not None:
        content.update(json.dumps(entry.document, sort_keys=True, default=str).encode())
    if entry.table is not None:
        for column in (entry.table.f_hz, entry.table.z, entry.table.std):
            content.update(b"" if column is None else np.ascontiguousarray(column).tobytes())
    return content.hexdigest()


def _refuse_strangers(folder: Path, chunks: Sequence[Chunk]) -> None:
    strangers = shards.keys(folder) - {chunk.key for chunk in chunks}
    if strangers and not shards.keys(folder) & {chunk.key for chunk in chunks}:
        raise JudgeError(
            f"{folder} holds unfinished work of another table, bank or version: judge that one again to finish it, or "
            "give --force to discard it"
        )


def _missing(
    responses: Sequence[FrequencyResponse] | Following, bases: Mapping[str, Any], chunks: Sequence[Chunk], jobs: int
) -> Iterator[tuple[str, list[PairVerdict]]]:
    """(key, verdicts) of chunks that are not kept yet, as they come."""
    if not chunks:
        return
    devices = {op: _device_of(responses, op) for op in sorted({chunk.op for chunk in chunks})}
    if jobs == 1 or len(chunks) == 1:
        for chunk in chunks:
            yield _judged(devices[chunk.op], chunk, bases)
        return
    from joblib import Parallel, delayed

    work = (delayed(_judged)(devices[chunk.op], chunk, bases) for chunk in chunks)
    yield from Parallel(n_jobs=min(jobs, len(chunks)), return_as="generator_unordered")(work)


def _device_of(responses: Sequence[FrequencyResponse] | Following, op: int) -> DeviceOn:
    """The operating point on any grid: fitted once, or found anew on each."""
    if isinstance(responses, Following):
        return partial(responses.device, op)
    device = fitted(responses[op])
    return partial(_the_same, device)


def _the_same(device: Device, entry: BankEntry) -> Device:
    return device


def _judged(device_on: DeviceOn, chunk: Chunk, bases: Mapping[str, Any]) -> tuple[str, list[PairVerdict]]:
    return chunk.key, [judge_pair(device_on(entry), entry, bases) for entry in chunk.entries]


def _names(responses: Sequence[FrequencyResponse] | Following) -> list[str]:
    if isinstance(responses, Following):
        return responses.names
    return [str(response.meta.get("op_id", "")) for response in responses]


def _with_elements(
    responses: Sequence[FrequencyResponse] | Following,
    bases: Mapping[str, Any],
    entries: Sequence[BankEntry],
    verdicts: list[PairVerdict],
    most: int,
) -> list[PairVerdict]:
    """The worst pairs with the critical value of each element."""
    by_id = {entry.grid_id: entry for entry in entries}
    worst = [v for v in verdicts if v.status == "ok"][:most]
    names = _names(responses)
    devices = {v.op_id: _device_of(responses, names.index(v.op_id)) for v in worst}
    found = {
        (v.grid_id, v.op_id): judge_pair(
            devices[v.op_id](by_id[v.grid_id]), by_id[v.grid_id], bases, elements=True
        ).elements
        for v in worst
    }
    return [replace(v, elements=found.get((v.grid_id, v.op_id), v.elements)) for v in verdicts]


# Shards --------------------------------------------------------------------------------------------------------------


def _plain(verdict: PairVerdict) -> dict[str, Any]:
    return asdict(verdict)


def _kept(folder: Path, key: str) -> list[PairVerdict] | None:
    text = shards.kept(folder, key)
    if text is None:
        return None
    return [_verdict(values) for values in json.loads(text)]


def _verdict(values: dict[str, Any]) -> PairVerdict:
    elements = tuple(ElementEdge(*each) for each in values.pop("elements"))
    missing = values.pop("missing_hz")
    warnings = tuple(values.pop("warnings"))
    return PairVerdict(
        **values, elements=elements, missing_hz=None if missing is None else tuple(missing), warnings=warnings
    )
