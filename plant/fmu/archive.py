"""An FMU as an archive from somebody else: looked through before anything of it is unpacked.

Refused are paths that lead out of the folder, links and other special files, names that are there twice, encrypted
members, and archives that unpack to too much. What may be unpacked goes into a folder that the caller gives.
"""

from __future__ import annotations

import hashlib
import stat
import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from ..errors import SeqsweepError, is_without_room

MOST_MEMBERS = 20_000
MOST_BYTES = 2 << 30
MOST_RATIO = 500
"""Unpacked over packed; a member of zeros may do that, a bomb does worse."""

FEW_BYTES = 16 << 20
"""Below this nobody minds the ratio."""


class ArchiveError(SeqsweepError):
    """An FMU that is not unpacked, with the member at fault."""


class Member(NamedTuple):
    """A file in the archive and its size unpacked (bytes)."""

    name: str
    size: int


def look_through(path: Path) -> list[Member]:
    """The members of an archive, all of them fit to be unpacked.

    Raises
    ------
    ArchiveError
        If it is no archive, or something in it is not fit.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            infos = archive.infolist()
    except FileNotFoundError:
        raise ArchiveError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ArchiveError(f"{path}: a folder, not an FMU; give the .fmu file itself") from None
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError, RuntimeError, struct.error) as error:
        raise ArchiveError(f"{path}: not an FMU: {error}") from None
    if len(infos) > MOST_MEMBERS:
        raise ArchiveError(f"{path}: {len(infos)} members; at most {MOST_MEMBERS} are unpacked")
    seen: set[str] = set()
    for info in infos:
        if reason := _unfit(info, seen):
            raise ArchiveError(f"{path}: member {info.filename!r} {reason}; nothing was unpacked")
    size, packed = sum(info.file_size for info in infos), sum(info.compress_size for info in infos)
    if size > MOST_BYTES:
        raise ArchiveError(f"{path}: unpacks to {size} bytes; at most {MOST_BYTES} are taken")
    if size > FEW_BYTES and size > MOST_RATIO * packed:
        raise ArchiveError(f"{path}: unpacks to {size / max(packed, 1):.0f} times its size; it looks like a bomb")
    return [Member(info.filename, info.file_size) for info in infos if not info.is_dir()]


def unpack(path: Path, folder: Path) -> None:
    """Unpack an archive that was looked through, here and now, into an empty folder.

    Raises
    ------
    ArchiveError
        As `look_through`, or if a member is damaged.
    OSError
        If the disk is full.
    """
    look_through(path)
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
    except (zipfile.BadZipFile, zlib.error, OSError, ValueError, NotImplementedError, RuntimeError) as error:
        if is_without_room(error):
            raise
        raise ArchiveError(f"{path}: cannot be unpacked: {error}") from None


def complaint_of(path: Path) -> str:
    """What fmpy's validation says against the description of an FMU that can be read; nothing as a rule."""
    try:
        description_of(path)
    except ArchiveError as refusal:
        description_of(path, validate=False)
        return str(refusal).removeprefix(f"{path}: ")
    return ""


def description_of(path: Path, validate: bool = True) -> Any:
    """The model description of an FMU (fmpy's), read and, unless told otherwise, validated without unpacking.

    Raises
    ------
    ArchiveError
        If fmpy is not installed, or refuses the description; with its words.
    """
    look_through(path)
    try:
        from fmpy import read_model_description
    except ImportError:
        raise ArchiveError(f"{path}: reading an FMU needs the extra: pip install 'seqsweep[fmu]'") from None
    try:
        return read_model_description(str(path), validate=validate)
    except Exception as error:
        way_out = "; validate = false in [plant.parameters] takes it as it is" if validate else ""
        words = " ".join(str(error).split())[:300].rstrip(".")
        raise ArchiveError(f"{path}: its model description is refused: {words}{way_out}") from None


def sha256_of(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _unfit(info: zipfile.ZipInfo, seen: set[str]) -> str:
    """What speaks against a member; nothing for a fit one."""
    name = info.orig_filename
    parts = PurePosixPath(name).parts
    if name.startswith("/") or ".." in parts or "\\" in name or ":" in name or "\0" in name or not name.strip("./"):
        return "leads out of the folder"
    mode = info.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link" if stat.S_ISLNK(mode) else "is a special file"
    if info.flag_bits & 1:
        return "is encrypted"
    if name.casefold() in seen:
        return "is there twice"
    seen.add(name.casefold())
    return ""
