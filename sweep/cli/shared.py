"""What commands share: their arguments, exit statuses, and what is refused before anything is computed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...plant.errors import SeqsweepError
from .telling import is_json, remark, result

if TYPE_CHECKING:
    from ...plant.protocol import Plant
    from ...plant.registry import PlantCard
    from ..config.sections import Config
    from ..plan import Plan

OK, NOT_ALL_OK, WRONG_INPUT, INTERRUPTED, MACHINE, FAULT, DIFFERENT = range(7)
"""Exit statuses: done; done, but some rows are not ok; the input is wrong; interrupted; the machine failed us;
the program itself is at fault; `compare` finds two tables that differ."""

EXIT_STATUSES = {
    OK: "done, whatever the verdict",
    NOT_ALL_OK: "done, but some rows are not ok: the table says which, and why (check: a promise is broken)",
    WRONG_INPUT: "the input is wrong; nothing is written",
    INTERRUPTED: "interrupted; the same command again goes on",
    MACHINE: "the machine failed (disk full, no permission, output in use); what was measured is kept",
    FAULT: "seqsweep itself is at fault; one line says where the details are (--debug prints them)",
    DIFFERENT: "compare finds that two tables differ",
}
"""Every exit status in words."""

CampaignFile = Annotated[Path, typer.Argument(metavar="CAMPAIGN.toml", help="The campaign file.")]
TableFile = Annotated[Path, typer.Argument(metavar="TABLE.parquet", help="A table of this format.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="a.b=c", help="Replace a value of the campaign; repeatable.")
]
StableOn = Annotated[
    str | None,
    typer.Option(metavar="ideal|R+jX", help="Source, or grid in ohm at f1, on which the device was seen to be stable."),
]
Elements = Annotated[
    int, typer.Option(min=0, metavar="N", help="Critical value of each element, of the N worst pairs.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]

FORMATS = {".parquet": "Parquet", ".json": "JSON"}


class WrongInput(SeqsweepError):
    """A call that cannot be carried out as given."""


def config_of(campaign: Path, settings: list[str] | None) -> Config:
    """The configuration of a campaign whose device can be driven from here."""
    from ..config.sections import load_config

    config = load_config(campaign, settings or ())
    if config.plant.id == "external":
        raise WrongInput(f"{campaign}: an external device cannot be driven from here; seqsweep inject writes files")
    return config


def planned_from(config: Config) -> tuple[Plan, Plant | PlantCard]:
    """The plan of a configuration and the plant it is for; what the user should know is said."""
    from ..planning import make_plan
    from ..run.host import plant_or_card

    plant = plant_or_card(config)
    planned = make_plan(config, plant)
    for warning in planned.warnings:
        remark(f"warning: {warning}")
    return planned, plant


def planned_of(campaign: Path, settings: list[str] | None) -> tuple[Plan, Plant | PlantCard]:
    """The plan of a campaign file whose operating points are listed."""
    config = config_of(campaign, settings)
    if config.sweep.operating_points is not None:
        raise WrongInput(f"{campaign}: its operating points are chosen while it runs; only seqsweep run can take it")
    return planned_from(config)


def check_outputs(output: Path | None, force: bool, plot: Path | None, suffix: str) -> None:
    """Refuse, before anything is computed, what could not be written in the end, or must not be replaced unasked."""
    if output is not None:
        check_new(output, force)
        check_suffix(output, suffix)
    check_plot(plot)


def check_plot(plot: Path | None) -> None:
    """Refuse a picture that cannot be drawn. An earlier one gives way unasked: the same command draws it again."""
    if plot is None:
        return
    from ...identify.views.style import checked_suffix

    checked_suffix(plot)
    check_new(plot, force=True)


def check_new(output: Path, force: bool) -> None:
    """Refuse an output that is in the way of nothing, or of something that may stay."""
    if output.is_dir():
        raise WrongInput(f"{output} is a folder; name a file")
    if output.exists() and not output.is_file():
        raise WrongInput(f"{output} is no ordinary file; a file cannot take its place")
    if output.exists() and not force:
        raise WrongInput(f"{output} exists; --force replaces it")
    check_folder(output)


def check_suffix(output: Path, suffix: str) -> None:
    """Refuse a name that promises another format than the one that will be in the file."""
    if output.suffix.lower() not in ("", suffix):
        raise WrongInput(f"{output}: what is written here is {FORMATS[suffix]}; name it {suffix}")


def report_statuses(output: Path, statuses: dict[str, int]) -> None:
    """Rows by status, the most frequent first, and who says why: on stderr, or the result where JSON is asked for."""
    counts = ", ".join(f"{n} {status}" for status, n in sorted(statuses.items(), key=lambda item: -item[1]))
    if is_json():
        result("", lambda: {"table": output, "rows": statuses})
    else:
        remark(f"{output}: {counts}")
        if set(statuses) - {"ok"}:
            remark(f"seqsweep show {output} says why")


def check_folder(output: Path) -> None:
    folder = output.absolute().parent
    if not folder.is_dir():
        raise WrongInput(f"{folder}: no such folder")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"{folder}: no permission to write there")
