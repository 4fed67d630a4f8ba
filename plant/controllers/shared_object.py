"""What a shared library offers, read from its file: nothing of it is loaded, no initialiser runs."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

from ..errors import SeqsweepError

_MACHINES = {3: "i386", 40: "arm", 62: "x86_64", 183: "aarch64", 243: "riscv"}
_DYNSYM = 11
_FUNCTION = 2


class SharedObjectError(SeqsweepError):
    """A file that is no shared library this can read."""


class SharedObject(NamedTuple):
    """A library: its format, what it was built for, and the functions it exports, sorted."""

    kind: str
    machine: str
    functions: tuple[str, ...]


def read_shared_object(path: Path) -> SharedObject:
    """Look into an ELF library; of a Windows library only that it is one.

    Raises
    ------
    SharedObjectError
        If it is neither, or damaged.
    """
    content = path.read_bytes()
    if content[:2] == b"MZ":
        return SharedObject("Windows library (PE)", "Windows", ())
    if content[:4] != b"\x7fELF":
        raise SharedObjectError(f"{path}: neither an ELF shared library nor a Windows one")
    if content[4:6] != b"\x02\x01":
        return SharedObject("ELF, not 64 bits little-endian", "another machine", ())
    try:
        machine = struct.unpack_from("<H", content, 18)[0]
        return SharedObject("ELF", _MACHINES.get(machine, f"machine {machine}"), tuple(sorted(_exports(content))))
    except (struct.error, IndexError, OverflowError, ValueError):
        raise SharedObjectError(f"{path}: a damaged ELF file") from None


def _exports(content: bytes) -> set[str]:
    """Names of the functions defined in the dynamic symbol table."""
    (sections_at,) = struct.unpack_from("<Q", content, 40)
    size, count = struct.unpack_from("<HH", content, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", content, sections_at + k * size) for k in range(count)]
    found = set()
    for _, kind, _, _, begin, length, link, _, _, entry in sections:
        if kind != _DYNSYM:
            continue
        names_at = sections[link][4]
        for at in range(begin, begin + length, entry):
            name, info, _, defined_in = struct.unpack_from("<IBBH", content, at)
            if defined_in and info & 0xF == _FUNCTION:
                end = content.index(b"\0", names_at + name)
                found.add(content[names_at + name : end].decode(errors="replace"))
    return found
