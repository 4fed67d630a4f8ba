"""TOML files as people save them: with or without a mark at the beginning, and what is said where they are none."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from ..errors import SeqsweepError

_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_toml(path: Path, refused: type[SeqsweepError] = SeqsweepError) -> dict[str, Any]:
    """What a TOML file holds, as plain values.

    Raises
    ------
    SeqsweepError
        As ``refused``, if there is no such file, or it is a folder, no UTF-8 text or no TOML; the message begins with
        the path.
    OSError
        If it cannot be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise refused(f"{path}: no such file") from None
    except IsADirectoryError:
        raise refused(f"{path} is a folder; name a file in it") from None
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        what = "UTF-16" if content[:2] in _UTF16 else f"line {line} has a byte 0x{content[error.start]:02x}"
        raise refused(f"{path}: not TOML, which is UTF-8 text ({what}): save it as UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise refused(f"{path}: not TOML: {error}") from None
