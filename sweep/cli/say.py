"""What commands say, in lines no wider than the terminal; in a pipe a message stays one line."""

from __future__ import annotations

import os
import shutil
import sys
from typing import TextIO

import typer

from ...tuning.layout import folded

UNKNOWN = 80
"""Columns that a table may take where nobody says how wide the output is."""


def columns() -> int:
    """Columns of standard output: COLUMNS of the environment, else the terminal's, else `UNKNOWN`."""
    return shutil.get_terminal_size((UNKNOWN, 24)).columns


def say(text: str) -> None:
    """Tell standard output a result."""
    typer.echo(_for_eyes(text, sys.stdout))


def tell(text: str) -> None:
    """Tell standard error a message."""
    typer.echo(_for_eyes(text, sys.stderr), err=True)


def _for_eyes(text: str, stream: TextIO) -> str:
    """The text folded where somebody looks at it; as it is for a program that reads it."""
    is_seen = stream.isatty() or os.environ.get("COLUMNS")
    return folded(text, columns()) if is_seen else text
