"""Results kept while a campaign runs: one file per batch, beside the output, found by its hash.

A shard is one line of checksum and one of text: what was seen of the operating point and the words of the rows as
JSON, their numbers as they stand in memory, in base 64. It is written to a temporary name and renamed, so it is whole
or not there; what a flipped bit or a full disk made of it is noticed and measured again. Writing the same shard twice
is harmless.
"""

from __future__ import annotations

import hashlib
import json
import os
from binascii import a2b_base64, b2a_base64
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import numpy as np

from ...identify.files import naming
from ...identify.table.format import N_COV
from ..measure.rows import N_Y, BatchResult, Row
from ..plan import Batch

_FORMAT = "condition, words, numbers"
"""Part of every check sum: a shard of another form counts as damaged, and is measured anew."""

_BETWEEN = "\t"
"""Between the three parts of a shard: neither JSON nor base 64 has such a character."""

_NUMBERS = "<f8"
"""Numbers of a shard: little-endian doubles."""


class OutputInUse(OSError):
    """Another run is writing this output."""


def folder_of(output: Path) -> Path:
    """Where the shards of ``output`` are kept."""
    return output.with_name(output.name + ".parts")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one run; the lock goes with the process, however it ends.

    Raises
    ------
    OutputInUse
        If another run holds it.
    """
    import fcntl

    while True:
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / "lock", "w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise OutputInUse(
                    f"{folder}: another run is writing this output; wait for it, or choose another one"
                ) from None
            if _still_there(lock, folder / "lock"):
                yield
                return


def _still_there(file: IO[str], path: Path) -> bool:
    """Whether ``path`` is this file, not one made anew after a run that ended meanwhile removed its own."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


class Store(Protocol):
    """Where the results of batches are kept while a campaign runs."""

    def read(self, batch: Batch) -> BatchResult | None:
        """The result of a batch; None where there is none, or it is damaged."""

    def condition(self, batch: Batch) -> dict[str, float] | None:
        """What the result of a batch says of its operating point; None as `read`."""

    def write(self, batch: Batch, result: BatchResult) -> None:
        """Keep the result of a batch."""


class Folder(NamedTuple):
    """Results as shards in a folder: they outlive the run."""

    path: Path

    def read(self, batch: Batch) -> BatchResult | None:
        return read(self.path, batch.key)

    def condition(self, batch: Batch) -> dict[str, float] | None:
        text = kept(self.path, batch.key)
        return None if text is None else json.loads(text.partition(_BETWEEN)[0])

    def write(self, batch: Batch, result: BatchResult) -> None:
        write(self.path, batch.key, result)

    def __str__(self) -> str:
        return str(self.path)


class Memory:
    """Results in memory, for a run whose table nobody asked for."""

    def __init__(self) -> None:
        self.kept: dict[str, tuple[Batch, BatchResult]] = {}

    def read(self, batch: Batch) -> BatchResult | None:
        kept = self.kept.get(batch.key)
        return None if kept is None else kept[1]

    def condition(self, batch: Batch) -> dict[str, float] | None:
        result = self.read(batch)
        return None if result is None else result.condition

    def write(self, batch: Batch, result: BatchResult) -> None:
        self.kept[batch.key] = batch, result


def write(folder: Path, key: str, result: BatchResult) -> None:
    """Keep ``result`` as the shard ``key``."""
    words = [(row.status, row.reason) for row in result.rows]
    numbers = np.array([_numbers(row) for row in result.rows], _NUMBERS).tobytes()
    parts = json.dumps(result.condition), json.dumps(words), b2a_base64(numbers, newline=False).decode("ascii")
    keep(folder, key, _BETWEEN.join(parts))


def keep(folder: Path, key: str, text: str) -> None:
    """Keep one line of ``text`` as the shard ``key``."""
    temporary = folder / f"{key}.{os.getpid()}.tmp"
    try:
        with naming(folder / key, temporary):
            with open(temporary, "w", encoding="utf-8") as file:
                file.write(f"{_checksum(key, text)}\n{text}\n")
            os.replace(temporary, folder / key)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        if not folder.is_dir():
            raise OSError(f"{folder} was moved or removed while the run was at work; run the command again") from error
        raise


def read(folder: Path, key: str) -> BatchResult | None:
    """The shard ``key``, or None where there is none or it is damaged."""
    text = kept(folder, key)
    if text is None:
        return None
    condition, all_words, packed = text.split(_BETWEEN)
    words = json.loads(all_words)
    numbers = np.frombuffer(a2b_base64(packed), _NUMBERS).reshape(len(words), -1).tolist()
    return BatchResult(tuple(map(_row, words, numbers)), json.loads(condition))


def kept(folder: Path, key: str) -> str | None:
    """The line of the shard ``key``, or None where there is none or it is damaged."""
    try:
        checksum, text, _ = (folder / key).read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return None
    return text if checksum == _checksum(key, text) else None


def keys(folder: Path) -> set[str]:
    """Names of all shards in the folder, whoever wrote them."""
    return {path.name for path in folder.iterdir() if _is_key(path.name)}


def remove(folder: Path) -> None:
    """Remove the shards once the table is written; a file that is not ours stays, and so does the folder."""
    for path in folder.iterdir():
        if path.name == "lock" or path.suffix == ".tmp" or _is_key(path.name):
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _is_key(name: str) -> bool:
    return len(name) == 64 and set(name) <= set("0123456789abcdef")


def _checksum(key: str, text: str) -> str:
    """Over the key too: a shard under another's name is not that other."""
    return hashlib.sha256(f"{_FORMAT}\n{key}\n{text}".encode()).hexdigest()


def _numbers(row: Row) -> tuple[float, ...]:
    """All of a row but its words; see `_row`."""
    f_hz, y, cov, _, _, *others = row
    return (f_hz, *y, *cov, *others)


def _row(words: Sequence[str], numbers: Sequence[float]) -> Row:
    status, reason = words
    y, cov, others = numbers[1 : 1 + N_Y], numbers[1 + N_Y :][:N_COV], numbers[1 + N_Y + N_COV :]
    return Row(numbers[0], tuple(y), tuple(cov), status, reason, *others)
