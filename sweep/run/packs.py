"""Shards of a large campaign, some hundred to a file and a fifth of their size: a pack.

A pack is what its shards say, compressed one by one, then where each of them stands, then the check sum of that. Every
shard carries its own check sum: a damaged one is measured anew, and the others are still there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np

from ...identify.files import atomic_file
from ..measure.rows import BatchResult
from . import shards

PLACE = np.dtype([("key", "S64"), ("at", "<u8"), ("size", "<u4"), ("plain", "<u4"), ("pack", "<u4")])
"""Where a shard stands: its name, byte and length in the pack, its length when unpacked, and the number of the pack."""

_MARK = b"seqsweep pack 1\n"
_END = Struct("<I32s16s")
"""Number of shards, check sum of their places, and what kind of file this is."""

_WIDTH = np.dtype(shards.NUMBERS).itemsize

_SUM = 32
"""Bytes of a check sum, before what it is of."""


def path_of(folder: Path, number: int) -> Path:
    """The pack of that number."""
    return folder / f"{number:06d}{shards.PACK}"


def numbers(folder: Path) -> list[int]:
    """Numbers of the packs in a folder, damaged ones among them."""
    return sorted(int(path.stem) for path in folder.glob(f"*{shards.PACK}") if path.stem.isdecimal())


def write(folder: Path, number: int, named: Iterable[tuple[str, shards.Parts]]) -> np.ndarray:
    """Keep some shards in one file, which is there as a whole or not at all; the places (n,) of their shards."""
    places, at = [], 0
    with atomic_file(path_of(folder, number)) as file:
        for key, parts in named:
            plain = _plain(parts)
            packed = _codec().compress(plain, asbytes=True)
            at += file.write(_checksum(key, packed) + packed)
            places.append((key, at - _SUM - len(packed), _SUM + len(packed), len(plain), number))
        table = np.array(places, PLACE)
        file.write(table.tobytes() + _END.pack(len(table), hashlib.sha256(table.tobytes()).digest(), _MARK))
    return table


def places(folder: Path, number: int) -> np.ndarray:
    """Places (n,) of the shards in a pack; none where it is damaged."""
    try:
        with open(path_of(folder, number), "rb") as file:
            end = file.seek(-_END.size, 2)
            n, checksum, mark = _END.unpack(file.read())
            file.seek(end - n * PLACE.itemsize)
            table = file.read(n * PLACE.itemsize)
    except (OSError, ValueError):
        return np.empty(0, PLACE)
    sound = mark == _MARK and hashlib.sha256(table).digest() == checksum
    return np.frombuffer(table, PLACE) if sound else np.empty(0, PLACE)


def read(folder: Path, place: np.void) -> BatchResult | None:
    """The result at a place, or None where it is damaged."""
    try:
        with open(path_of(folder, int(place["pack"])), "rb") as file:
            file.seek(int(place["at"]))
            content = file.read(int(place["size"]))
    except OSError:
        return None
    checksum, packed = content[:_SUM], content[_SUM:]
    if checksum != _checksum(place["key"].decode(), packed):
        return None
    return _result(_codec().decompress(packed, decompressed_size=int(place["plain"]), asbytes=True))


def _plain(parts: shards.Parts) -> bytes:
    """Words of a shard, and its numbers, column by column, the first bytes of all numbers of a column first."""
    columns = np.ascontiguousarray(parts.numbers.T)
    by_byte = columns.view(np.uint8).reshape(*columns.shape, _WIDTH).transpose(0, 2, 1)
    return b"\n".join((parts.condition.encode(), parts.words.encode(), by_byte.tobytes()))


def _result(plain: bytes) -> BatchResult:
    condition, words, numbers = plain.split(b"\n", 2)
    by_byte = np.frombuffer(numbers, np.uint8).reshape(shards.N_NUMBERS, _WIDTH, -1).transpose(0, 2, 1)
    columns = np.ascontiguousarray(by_byte).view(shards.NUMBERS)[..., 0]
    return shards.result_of(shards.Parts(condition.decode(), words.decode(), np.ascontiguousarray(columns.T)))


def _codec() -> Any:
    from pyarrow import Codec

    return Codec("zstd", compression_level=3)


def _checksum(key: str, packed: bytes) -> bytes:
    """Over the key too: a shard under another's name is not that other."""
    return hashlib.sha256(key.encode() + packed).digest()
