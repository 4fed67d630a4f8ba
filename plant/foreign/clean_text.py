"""Bytes of other people's text files to clean UTF-8, whole lines at a time.

What is mended here no format library knows of: UTF-16, blanks that align columns, Fortran's exponents (1.5D+03,
1.5-103), separators of thousands.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Callable
from typing import Any, NamedTuple

FORTRAN = re.compile(rb"(?<=[\d.])[dD](?=[+-]?\d{1,3}(?![\d.]))")
_NO_LETTER = re.compile(rb"(?<=\.\d)(\d*)([+-]\d{3})(?=[\s,;]|$)", re.MULTILINE)
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"(?m)^ +| +(?=\r?$)")
_BOM = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}

_READABLE = frozenset((*b"\t\r\n", *range(32, 127)))

LONGEST_LINE = 1 << 20
"""Bytes of a line; a text without ends of lines is none."""

LATIN = "text is not UTF-8: names may look odd, numbers are not concerned"


class Mending(NamedTuple):
    """What a text needs before a reader of tables can take it.

    Attributes
    ----------
    encoding : str
        Of the file.
    squeeze : bool
        Runs of blanks are one separator.
    exponents : bool
        Exponents are Fortran's.
    thousands : str
        Sign between thousands, or nothing.
    """

    encoding: str = "utf-8"
    squeeze: bool = False
    exponents: bool = False
    thousands: str = ""

    def __call__(self, raw: bytes) -> bytes:
        """Whole lines of UTF-8, mended."""
        if self.exponents:
            raw = _NO_LETTER.sub(rb"\1E\2", FORTRAN.sub(b"E", raw))
        if self.thousands:
            raw = raw.replace(self.thousands.encode(), b"")
        return _EDGES.sub(b"", _BLANKS.sub(b" ", raw)) if self.squeeze else raw

    @property
    def idle(self) -> bool:
        """Whether the file may be read as it is."""
        return self.encoding in ("utf-8", "utf-8-sig", "latin-1") and not (
            self.squeeze or self.exponents or self.thousands
        )


def encoding_of(raw: bytes) -> str:
    """Encoding of the beginning of a text; empty where it is none, for it holds zero bytes."""
    for mark, encoding in _BOM.items():
        if raw.startswith(mark):
            return encoding
    if b"\0" in raw:
        return _without_mark(raw)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)  # a letter may be cut in two at the end
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _without_mark(raw: bytes) -> str:
    """UTF-16 whose first mark was lost: nearly every second byte is zero."""
    even, odd = raw[::2], raw[1::2]
    for name, zeros, others in (("utf-16-le", odd, even), ("utf-16-be", even, odd)):
        readable = sum(byte in _READABLE for byte in others)
        if zeros.count(0) > 0.9 * len(zeros) and readable > 0.9 * len(others):
            return name
    return ""


def decoded(raw: bytes) -> tuple[str, tuple[str, ...]]:
    """Text of unknown encoding, and what is to be said about it."""
    encoding = encoding_of(raw) or "latin-1"
    return raw.decode(encoding, "replace"), (LATIN,) if encoding == "latin-1" else ()


def mended(file: Any, mending: Mending, skip_rows: int = 0) -> Any:
    """A binary file object of the mended text, from line ``skip_rows`` on."""
    stream: Any = file if mending.idle else _Mended(file, mending)
    for _ in range(skip_rows):
        stream.readline()
    return stream


class _Mended(io.RawIOBase):
    """A text that is mended while it is read: whole lines, never more than asked."""

    def __init__(self, file: Any, mending: Mending):
        self._file, self._mend = file, mending
        decoder = codecs.getincrementaldecoder(mending.encoding)("replace")
        plain = mending.encoding in ("utf-8", "latin-1")
        self._to_utf8: Callable[[bytes, bool], bytes] = (
            (lambda raw, final: raw) if plain else (lambda raw, final: decoder.decode(raw, final).encode())
        )
        self._line, self._ready, self._ended = b"", b"", False

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1, /) -> bytes:
        while not self._ended and (size < 0 or len(self._ready) < size):
            self._fill(max(size, 1 << 20))
        size = len(self._ready) if size < 0 else size
        found, self._ready = self._ready[:size], self._ready[size:]
        return found

    def readline(self, size: int | None = -1, /) -> bytes:
        while b"\n" not in self._ready and not self._ended:
            self._fill(1 << 16)
        line, end, self._ready = self._ready.partition(b"\n")
        return line + end

    def _fill(self, size: int) -> None:
        raw = self._file.read(size)
        self._ended = not raw
        text = self._line + self._to_utf8(raw, self._ended)
        whole = len(text) if self._ended else text.rfind(b"\n") + 1
        if whole == 0 and len(text) > LONGEST_LINE:
            whole = len(text)
        self._ready += self._mend(text[:whole])
        self._line = text[whole:]
