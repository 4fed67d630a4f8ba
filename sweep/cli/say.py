"""What commands say, in lines no wider than the terminal, or than 80 columns where there is none."""

from __future__ import annotations

import shutil

import typer

from ...tuning.layout import folded

UNKNOWN = 80
"""Columns that a line may take where nobody says how wide the output is."""


def columns() -> int:
    """Columns of standard output: COLUMNS of the environment, else the terminal's, else `UNKNOWN`."""
    return shutil.get_terminal_size((UNKNOWN, 24)).columns


def say(text: str) -> None:
    """Tell standard output a result."""
    typer.echo(folded(text, columns()))


def tell(text: str) -> None:
    """Tell standard error a message."""
    typer.echo(folded(text, columns()), err=True)
