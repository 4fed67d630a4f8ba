"""Commands from a campaign to a table: init, plan, run, show, validate, check."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from .say import tell
from .shared import (
    NOT_ALL_OK,
    WRONG_INPUT,
    CampaignFile,
    Force,
    Settings,
    TableFile,
    WrongInput,
    check_folder,
    check_new,
    config_of,
    planned_from,
    planned_of,
    report_statuses,
)
from .telling import columns, is_json, remark, result

if TYPE_CHECKING:
    from ...plant.protocol import Plant
    from ...plant.registry import PlantCard
    from ..config.sections import Config
    from ..plan import Plan
    from ..run.campaign import Outcome


def init(
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Where to write it; by default campaign.toml or .ipynb."),
    ] = None,
    plant: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A real-code controller (.so, .dll): its ports, units and parameters."),
    ] = None,
    notebook: Annotated[bool, typer.Option("--notebook", help="A notebook from the sweep to the decision.")] = False,
) -> None:
    """Write a commented campaign for the reference turbine or around a real-code controller, or a notebook."""
    from ...identify.files import atomic_file

    if notebook and plant is not None:
        raise WrongInput("--notebook and --plant each write a file of their own: give one of them")
    output = output or Path("campaign.ipynb" if notebook else "campaign.toml")
    if notebook != (output.suffix.lower() == ".ipynb"):
        raise WrongInput(f"{output}: a notebook is named .ipynb and asked for by --notebook")
    if output.exists():
        raise WrongInput(f"{output} exists; choose another name with -o")
    check_folder(output)
    text = _template("template.ipynb" if notebook else "template.toml") if plant is None else _drafted(plant)
    with atomic_file(output) as file:
        file.write(text.encode())
    following = f"open it in Jupyter: jupyter lab {output}" if notebook else f"seqsweep run {output} -o y.parquet"
    result(f"{output} written; next: {following}", lambda: {"output": output})


def _template(name: str) -> str:
    from importlib.resources import files

    return files("seqsweep.sweep.config").joinpath(name).read_text("utf-8")


def _drafted(library: Path) -> str:
    """A campaign around a real-code controller, with what it says of itself filled in."""
    from .check import asked

    if library.suffix.lower() not in (".so", ".dll", ".dylib"):
        raise WrongInput(
            f"--plant {library}: needed is a real-code controller of CIGRE TB 958 (.so, .dll, .dylib); seqsweep check "
            "says what other files are"
        )
    if not library.is_file():
        raise WrongInput(f"--plant {library}: no such file")
    return asked(library, "seqsweep.plant.controllers.draft") + "\n"


def plan(
    campaign: CampaignFile,
    settings: Settings = None,
    jobs: Annotated[int, typer.Option(min=1, help="Workers that the wall time is for.")] = os.cpu_count() or 1,
) -> None:
    """Print every shot, the simulated seconds and the expected wall time; no shot is fired."""
    from ..run.spare import spare_children
    from .plan_text import plan_text, plan_values

    with spare_children():
        planned, plant = planned_of(campaign, settings)
        result(lambda: plan_text(planned, plant, jobs), lambda: plan_values(planned, plant, jobs))


def run(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    jobs: Annotated[int, typer.Option(min=1, help="Workers.")] = os.cpu_count() or 1,
    backend: Annotated[
        str | None, typer.Option(help="threading, loky or dask; by default what suits the plant.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="A dask scheduler.")] = None,
    force: Force = False,
    settings: Settings = None,
) -> None:
    """Sweep, and write the table. Interrupted, the same command goes on where it was."""
    from ..run.spare import spare_children

    if backend not in (None, "threading", "loky", "dask"):
        raise WrongInput(f"--backend {backend!r}: known are threading, loky and dask")
    if scheduler is not None and backend != "dask":
        raise WrongInput("--scheduler goes with --backend dask")
    check_new(output, force)
    if output.suffix.lower() != ".parquet":
        raise WrongInput(f"{output}: the table is Parquet, name it .parquet; seqsweep export makes .csv or .mat of it")
    config = config_of(campaign, settings)
    if config.sweep.operating_points is not None:
        _run_region(config, output, Running(jobs, backend, scheduler), force)
        return
    with spare_children():
        planned, plant = planned_from(config)
        del config  # of 100,000 operating points some 100 MB that nobody needs any more
        outcome = _run_planned(planned, plant, output, Running(jobs, backend, scheduler), force)
    report_statuses(output, outcome.statuses)
    for text in outcome.remarks:
        remark(text)
    if not outcome.all_ok:
        raise typer.Exit(NOT_ALL_OK)


class Running(NamedTuple):
    """How a campaign is run: workers, joblib's backend, the address of a dask scheduler."""

    jobs: int
    backend: str | None
    scheduler: str | None


def _run_planned(planned: Plan, plant: Plant | PlantCard, output: Path, running: Running, force: bool) -> Outcome:
    """A campaign whose operating points are listed."""
    from ..run.campaign import run as run_campaign
    from .progress import progress

    with progress() as shown:
        return run_campaign(
            planned,
            plant,
            output,
            jobs=running.jobs,
            backend=running.backend,
            scheduler=running.scheduler,
            discard=force,
            report=shown.report,
            say=shown.say,
        )


def _run_region(config: Config, output: Path, running: Running, force: bool) -> None:
    """A campaign that chooses its operating points."""
    from ..region.adaptive import sweep_region
    from ..run.spare import spare_children

    def one_round(listed: Config, path: Path) -> None:
        with spare_children():
            _run_planned(*planned_from(listed), path, running, force)

    folder = output.with_name(output.name + ".rounds")
    if force and folder.exists():
        shutil.rmtree(folder)
    outcome = sweep_region(config, output, one_round, remark)
    report_statuses(output, outcome.statuses)
    known = outcome.promise
    if not outcome.certified:
        known = "the tolerance was not reached: a larger `most` sweeps on, or ask for less"
    remark(f"{outcome.n_points} operating points; {known}")
    if not outcome.certified or set(outcome.statuses) - {"ok"}:
        raise typer.Exit(NOT_ALL_OK)


def validate(table: TableFile) -> None:
    """Hold a table against the format; exit status 0 or 2."""
    from ...identify.table.read import validate_table

    violations = validate_table(table)
    for violation in violations:
        tell(violation)
    if is_json() or not violations:
        conforms = {"table": table, "conforms": not violations, "violations": violations}
        result(f"{table}: conforms", lambda: conforms)
    if violations:
        raise typer.Exit(WRONG_INPUT)


def check(
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="A plant's id, a CAMPAIGN.toml, or a file to read.")],
) -> None:
    """Hold a plant against its promise; of a file (.fmu, .so, .dll, .py) say what it is, executing nothing."""
    from dataclasses import asdict

    from ...tuning.layout import labelled
    from .check import findings_of, findings_of_campaign, inspect, is_inspected

    if is_inspected(plant):
        said = inspect(Path(plant))
        result(said, lambda: {"what": plant, "text": said.splitlines()})
        return
    findings = findings_of_campaign(Path(plant)) if plant.endswith(".toml") else findings_of(plant)
    rows = [(f"{'pass' if finding.passed else 'FAIL'}  {finding.name}", finding.detail) for finding in findings]
    result(
        lambda: labelled(rows, columns()),
        lambda: {"what": plant, "promises": list(map(asdict, findings))},
    )
    if not all(finding.passed for finding in findings):
        raise typer.Exit(NOT_ALL_OK)
