"""The command `report`: one file for people who were not there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .shared import Force, WrongInput, check_new
from .telling import is_json, remark, result


def report(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="TABLE.parquet [RESULT...]", help="The table, and results about it; of a farm its JSON alone."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT.html", help="The report to write.")],
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it to PDF as well, by Chromium, Chrome or Edge.")] = False,
    profile: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|FILE", help="Requirements to hold it against; repeatable. By default scan."),
    ] = None,
    stamp: Annotated[bool, typer.Option("--stamp", help="Put date, user and host into the report.")] = False,
    force: Force = False,
) -> None:
    """One HTML file that needs no network: verdict, modes, pictures, what was swept, what is not covered.

    RESULT is what other commands wrote about the table: the JSON of tune, verify, metrics and farm, the Parquet of
    judge and surrogate.
    """
    from ...identify.files import atomic_file
    from ..report.handover.checklist import read_profiles
    from ..report.handover.inputs import FarmInputs, read_any
    from ..report.handover.page import farm_page, page
    from ..report.handover.pdf import browser, printed

    paper, printer = output.with_suffix(".pdf"), None
    _check_output(output, paper if pdf else None, force)
    if pdf:
        printer = browser()
    profiles = profile or []
    read_profiles(profiles)  # a wrong name is refused before anything is computed
    content, stamped = read_any(inputs), _stamp() if stamp else ""

    def made(printing: bool = False) -> str:
        if isinstance(content, FarmInputs):
            return farm_page(content, stamped)
        return page(content, stamped, profiles, printing=printing)

    text = made()
    with atomic_file(output) as file:
        file.write(text.encode())
    size = len(text.encode())
    written: dict[str, object] = {"report": output, "bytes": size}
    remark(f"{output}: {size / 1e3:.0f} kB; open it in a browser")
    if printer is not None:
        content_of_paper = printed(made(printing=True), printer)
        with atomic_file(paper) as file:
            file.write(content_of_paper)
        written |= {"pdf": paper, "pdf_bytes": len(content_of_paper)}
        remark(f"{paper}: {len(content_of_paper) / 1e3:.0f} kB")
    if is_json():
        result("", lambda: written)


def _check_output(output: Path, paper: Path | None, force: bool) -> None:
    if output.suffix.lower() not in (".html", ".htm"):
        raise WrongInput(f"{output}: a report is written as .html; --pdf prints it beside that")
    check_new(output, force)
    if paper is not None:
        check_new(paper, force)


def _stamp() -> str:
    """Date, user and host."""
    import datetime
    import getpass
    import platform

    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    return f"Made on {now} by {getpass.getuser()} on {platform.node()}."
