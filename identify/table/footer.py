"""The metadata of a table as text, written while its operating points come by, and put into the foot of the file.

What is kept in memory of an operating point is its text, some 600 bytes, once. pyarrow by itself holds the text of a
footer up to five times.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from struct import pack, unpack
from typing import Any, BinaryIO

from .format import METADATA_KEY, canonical_json

_PLACE = b"here comes the metadata"
"""Stands in the footer that pyarrow writes, until all operating points have come by."""

_END = b"PAR1"

_TEXT = b"\x18"
"""Thrift, compact protocol: the next field of the struct is binary; its length and its bytes follow."""


class MetadataText:
    """The JSON of a table's metadata: first what is known before the rows, then an entry per operating point.

    Parameters
    ----------
    meta : mapping
        Completed metadata; its operating points and its hash are left out.
    """

    def __init__(self, meta: Mapping[str, Any]):
        self._parts = {key: _text(value) for key, value in meta.items() if key not in ("operating_points", "sha256")}
        self._points = bytearray()

    def add(self, point: Mapping[str, Any]) -> None:
        """The entry of the next operating point."""
        self._points += (b"," if self._points else b"[") + canonical_json(point).encode()

    def pieces(self) -> list[bytes | bytearray]:
        """The whole text, piece by piece, with the hash of all but itself."""
        self._points += b"]"
        parts: dict[str, bytes | bytearray] = {**self._parts, "operating_points": self._points}
        digest = hashlib.sha256()
        for piece in _object_of(parts):
            digest.update(piece)
        return list(_object_of({**parts, "sha256": canonical_json(digest.hexdigest()).encode()}))


def _text(value: Any) -> bytes:
    """Read back once: keys that are no text are sorted as the text that they become."""
    return canonical_json(json.loads(canonical_json(value))).encode()


def _object_of(parts: Mapping[str, bytes | bytearray]) -> Iterator[bytes | bytearray]:
    """`canonical_json` of an object, piece by piece, from that of its values."""
    for number, key in enumerate(sorted(parts)):
        yield f'{"," if number else "{"}"{key}":'.encode()
        yield parts[key]
    yield b"}"


def reserve(writer: Any) -> None:
    """Keep a place for the metadata in the footer that a `pyarrow.parquet.ParquetWriter` will write."""
    writer.add_key_value_metadata({METADATA_KEY: _PLACE})


def fill(file: BinaryIO, pieces: list[bytes | bytearray]) -> None:
    """Put the metadata into the place that was reserved, at the end of a Parquet file that is open to read and write.

    A footer is a struct of Thrift's compact protocol, its length and "PAR1"
    (https://github.com/apache/parquet-format). A text in it is its length, seven bits a byte, and its bytes.
    """
    file.seek(-8, 2)
    (length,) = unpack("<i", file.read(4))
    start = file.seek(-8 - length, 2)
    footer = file.read(length)
    name = _TEXT + _sized(METADATA_KEY) + _TEXT
    before, after = footer.split(name + _sized(_PLACE))
    size = sum(map(len, pieces))
    head = before + name + _varint(size)
    file.seek(start)
    file.write(head)
    file.writelines(pieces)
    file.write(after + pack("<i", len(head) + size + len(after)) + _END)


def _sized(text: bytes) -> bytes:
    return _varint(len(text)) + text


def _varint(number: int) -> bytes:
    """A number, seven bits a byte, the lowest first; all bytes but the last have their highest bit set."""
    low, rest = number & 0x7F, number >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])
