"""The command `report`: one file for people who were not there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .say import tell
from .shared import Force, WrongInput, check_new


def report(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="TABLE.parquet [RESULT...]", help="The table, and results about it.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT.html", help="The report to write.")],
    stamp: Annotated[bool, typer.Option("--stamp", help="Put date, user and host into the report.")] = False,
    force: Force = False,
) -> None:
    """One HTML file that needs no network: verdict, modes, pictures, what was swept, what is not covered."""
    from ...identify.files import atomic_file
    from ..report.handover.inputs import read_inputs
    from ..report.handover.page import page

    if output.suffix.lower() not in (".html", ".htm"):
        raise WrongInput(f"{output}: a report is written as .html; a browser prints it to PDF")
    check_new(output, force)
    text = page(read_inputs(inputs), _stamp() if stamp else "")
    with atomic_file(output) as file:
        file.write(text.encode())
    tell(f"{output}: {len(text.encode()) / 1e3:.0f} kB; open it in a browser")


def _stamp() -> str:
    """Date, user and host."""
    import datetime
    import getpass
    import platform

    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    return f"Made on {now} by {getpass.getuser()} on {platform.node()}."
