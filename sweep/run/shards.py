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
from typing import IO, NamedTuple

import numpy as np

from ...identify.files import naming
from ...identify.table.format import N_COV
from ..measure.rows import N_Y, BatchResult, Row

_FORMAT = "condition, words, numbers"
"""Part of every check sum: a shard of another form counts as damaged, and is measured anew."""

_BETWEEN = "\t"
"""Between the three parts of a shard: neither JSON nor base 64 has such a character."""

PACK = ".pack"
"""Suffix of files of many shards, numbered."""

NUMBERS = "<f8"
"""Numbers of a shard: little-endian doubles."""

N_NUMBERS = len(Row._fields) - len(("y", "cov", "status", "reason")) + N_Y + N_COV
"""Numbers of a row; see `_row`."""


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


def write(folder: Path, key: str, result: BatchResult) -> None:
    """Keep ``result`` as the shard ``key``."""
    words = [(row.status, row.reason) for row in result.rows]
    numbers = np.array([_numbers(row) for row in result.rows], NUMBERS).tobytes()
    parts = json.dumps(result.condition), json.dumps(words), b2a_base64(numbers, newline=False).decode("ascii")
    keep(folder, key, _BETWEEN.join(parts))


def keep(folder: Path, key: str, text: str) -> None:
    """Keep one line of ``text`` as the shard ``key``."""
    temporary = folder / f"{key}.{os.getpid()}.tmp"
    with there(folder):
        try:
            with naming(folder / key, temporary):
                with open(temporary, "w", encoding="utf-8") as file:
                    file.write(f"{_checksum(key, text)}\n{text}\n")
                os.replace(temporary, folder / key)
        except OSError:
            with suppress(OSError):
                temporary.unlink()
            raise


@contextmanager
def there(folder: Path) -> Iterator[None]:
    """What cannot be written because the folder is gone says so."""
    try:
        yield
    except OSError as error:
        if not folder.is_dir():
            raise OSError(f"{folder} was moved or removed while the run was at work; run the command again") from error
        raise


class Parts(NamedTuple):
    """What a shard says: what was seen and the words of the rows as JSON, and the numbers of the rows, (n, 53)."""

    condition: str
    words: str
    numbers: np.ndarray


def read(folder: Path, key: str) -> BatchResult | None:
    """The shard ``key``, or None where there is none or it is damaged."""
    parts = parts_of(folder, key)
    return None if parts is None else result_of(parts)


def parts_of(folder: Path, key: str) -> Parts | None:
    """The shard ``key`` as it is stored, or None where there is none or it is damaged."""
    text = kept(folder, key)
    if text is None:
        return None
    condition, words, packed = text.split(_BETWEEN)
    return Parts(condition, words, np.frombuffer(a2b_base64(packed), NUMBERS).reshape(-1, N_NUMBERS))


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
        is_pack = path.suffix == PACK and path.stem.isdecimal()
        if path.name == "lock" or path.suffix == ".tmp" or is_pack or _is_key(path.name):
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _is_key(name: str) -> bool:
    return len(name) == 64 and set(name) <= set("0123456789abcdef")


def _checksum(key: str, text: str) -> str:
    """Over the key too: a shard under another's name is not that other."""
    return hashlib.sha256(f"{_FORMAT}\n{key}\n{text}".encode()).hexdigest()


def result_of(parts: Parts) -> BatchResult:
    """The result that a shard tells of."""
    rows = map(_row, json.loads(parts.words), parts.numbers.tolist())
    return BatchResult(tuple(rows), json.loads(parts.condition))


def _numbers(row: Row) -> tuple[float, ...]:
    """All of a row but its words; see `_row`."""
    f_hz, y, cov, _, _, *others = row
    return (f_hz, *y, *cov, *others)


def _row(words: Sequence[str], numbers: Sequence[float]) -> Row:
    status, reason = words
    y, cov, others = numbers[1 : 1 + N_Y], numbers[1 + N_Y :][:N_COV], numbers[1 + N_Y + N_COV :]
    return Row(numbers[0], tuple(y), tuple(cov), status, reason, *others)
