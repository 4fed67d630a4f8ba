"""`seqsweep judge`: the pairs through joblib, shards on the way, one Parquet file at the end.

Each operating point is fitted once and judged on the whole bank, grid by grid. What is done is kept in
``OUTPUT.parts`` under a hash of the table, the grid and the options: the same command goes on where it was ended, and
a grid that was changed is judged again. Nothing grows with the number of pairs but an index of theirs (`pairs`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import compress, groupby, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.response import FrequencyResponse
from ...plant.errors import SeqsweepError
from ...tuning.bank.entries import BankEntry
from ...tuning.bank.judgement import PairVerdict, judge_pair
from ...tuning.tune import Device, fitted
from ..run import shards
from .following import Follows
from .pairs import PairFile, Pairs, from_text, to_text

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
    responses: Sequence[FrequencyResponse] | Follows,
    bases: Mapping[str, Any],
    digest: str,
    entries: Sequence[BankEntry],
    *,
    output: Path | None,
    jobs: int,
    elements: int,
    discard: bool = False,
    report: Report = lambda done, total: None,
) -> Pairs:
    """Every operating point on every grid, worst first.

    Parameters
    ----------
    responses : sequence of FrequencyResponse or Follows
        Operating points of the device, or dispatches or a farm whose operating point follows from each grid.
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
    names = _names(responses)
    chunks = partial(_chunks, len(responses), entries, [_mark(entry) for entry in entries], digest)
    pairs = PairFile(None if output is None else output.parent, [entry.grid_id for entry in entries], names)
    folder = None if output is None else shards.folder_of(output)
    with nullcontext() if folder is None else shards.locked(folder):
        if folder is not None and not discard:
            _refuse_strangers(folder, chunks())
        total, done = len(responses) * len(entries), bytearray(_is_kept(folder, chunk, pairs) for chunk in chunks())
        report(len(pairs), total)
        todo = compress(chunks(), (not kept for kept in done))
        for key, found in _judged_chunks(responses, bases, todo, min(jobs, done.count(0))):
            if folder is not None:
                shards.keep(folder, key, to_text(found))
            pairs.add(found)
            report(len(pairs), total)
    return _with_elements(responses, bases, entries, pairs.worst_first(), elements)


def _is_kept(folder: Path | None, chunk: Chunk, pairs: PairFile) -> bool:
    """Whether a chunk was judged before; its pairs are put to the others then."""
    text = None if folder is None else shards.kept(folder, chunk.key)
    if text is not None:
        pairs.add(from_text(text))
    return text is not None


# Chunks --------------------------------------------------------------------------------------------------------------


def _chunks(n_points: int, entries: Sequence[BankEntry], marks: Sequence[str], digest: str) -> Iterator[Chunk]:
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


def _refuse_strangers(folder: Path, chunks: Iterator[Chunk]) -> None:
    there = shards.keys(folder)
    if there and not any(chunk.key in there for chunk in chunks):
        raise JudgeError(
            f"{folder} holds unfinished work of another table, bank or version: judge that one again to finish it, or "
            "give --force to discard it"
        )


def _judged_chunks(
    responses: Sequence[FrequencyResponse] | Follows, bases: Mapping[str, Any], chunks: Iterator[Chunk], jobs: int
) -> Iterator[tuple[str, list[PairVerdict]]]:
    """(key, verdicts) of chunks, as they come; each operating point is fitted when its first chunk is due."""
    of_point = groupby(chunks, key=lambda chunk: chunk.op)
    work = ((device, chunk) for op, of in of_point for device in (_device_of(responses, op),) for chunk in of)
    if jobs <= 1:
        for device, chunk in work:
            yield _judged(device, chunk, bases)
        return
    from joblib import Parallel, delayed

    tasks = (delayed(_judged)(device, chunk, bases) for device, chunk in work)
    yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(tasks)


def _device_of(responses: Sequence[FrequencyResponse] | Follows, op: int) -> DeviceOn:
    """The operating point on any grid: fitted once, or found anew on each."""
    if isinstance(responses, Follows):
        return partial(responses.device, op)
    device = fitted(responses[op])
    return partial(_the_same, device)


def _the_same(device: Device, entry: BankEntry) -> Device:
    return device


def _judged(device_on: DeviceOn, chunk: Chunk, bases: Mapping[str, Any]) -> tuple[str, list[PairVerdict]]:
    return chunk.key, [judge_pair(device_on(entry), entry, bases) for entry in chunk.entries]


def _names(responses: Sequence[FrequencyResponse] | Follows) -> list[str]:
    if isinstance(responses, Follows):
        return responses.names
    return [str(response.meta.get("op_id", "")) for response in responses]


def _with_elements(
    responses: Sequence[FrequencyResponse] | Follows,
    bases: Mapping[str, Any],
    entries: Sequence[BankEntry],
    pairs: Pairs,
    most: int,
) -> Pairs:
    """The worst pairs with the critical value of each element."""
    by_id = {entry.grid_id: entry for entry in entries}
    worst = list(islice(((k, v) for k, v in enumerate(pairs) if v.status == "ok"), most))
    names = _names(responses)
    devices = {v.op_id: _device_of(responses, names.index(v.op_id)) for _, v in worst}

    def with_elements(v: PairVerdict) -> PairVerdict:
        entry = by_id[v.grid_id]
        return replace(v, elements=judge_pair(devices[v.op_id](entry), entry, bases, elements=True).elements)

    return pairs.replacing({k: with_elements(v) for k, v in worst})
