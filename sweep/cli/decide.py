"""Commands from a table to a decision: tune, verify, grid."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .anywhere import Asked, Parameter, Power, SourceVoltage, is_surrogate, on_grid, tune_worst
from .shared import (
    NOT_ALL_OK,
    CampaignFile,
    Force,
    Settings,
    StableOn,
    TableFile,
    WrongInput,
    check_outputs,
    planned_of,
)
from .telling import columns, remark, result

if TYPE_CHECKING:
    from ...identify.table.read import Table
    from ...tuning.region.worst import Least
    from ...tuning.siso import Grid


def tune(
    table: TableFile,
    grid: Annotated[
        str,
        typer.Option(
            metavar="R+jX|FILE|own",
            help="0.012+0.25j (ohm at f1), a file with a grid, or own: the one each point was swept for.",
        ),
    ],
    scale: Annotated[
        str, typer.Option(metavar="X[,X...]", help="Multiplies the grid impedance; several: a verdict for each.")
    ] = "1",
    margin: Annotated[float, typer.Option(help="Required magnitude margin m.")] = 1.4,
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="TUNING.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Bode, locus and poles: .png, .svg, .pdf.")] = None,
    confirm: Annotated[bool, typer.Option("--confirm", help="Sweep again with damping and iterate k.")] = False,
    stable_on: StableOn = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="HZ-HZ", help="Leave these rows out, such as 50-70; repeatable.")
    ] = None,
    worst: Annotated[
        bool, typer.Option("--worst", help="Search all operating points between the table's; --grid may be a bank.")
    ] = False,
    least: Annotated[str, typer.Option(help="What is least there: margin, damping or probability.")] = "margin",
    sweeps: Annotated[int, typer.Option(min=0, help="Sweeps to confirm the worst point; 0: none.")] = 4,
    power: Power = None,
    source_voltage: SourceVoltage = None,
    parameter: Parameter = None,
    jobs: Annotated[int, typer.Option(min=1, help="Workers of --confirm and --worst.")] = os.cpu_count() or 1,
    force: Force = False,
) -> None:
    """Is it stable on this grid, with what margin, and which k makes it so? Reads the table alone."""
    from ...identify.table.read import read_table
    from ...tuning.grids.open import open_grid
    from ...tuning.result import to_json, write_json
    from ...tuning.text import format_table
    from ...tuning.tune import tune as judge

    check_outputs(output, force, plot, ".json")
    scales = _scales(scale)
    content = as_told(read_table(table), stable_on, exclude or ())
    told, asked = "", Asked(power, source_voltage, parameter)
    if worst:
        found, told = tune_worst(content, grid, _least(least), margin, asked, sweeps, jobs)
    else:
        on: Grid | Literal["own"] = "own" if grid.strip().lower() == "own" else open_grid(grid, content.meta["f1_hz"])
        if is_surrogate(content) and on != "own":
            content = on_grid(content, on, asked.behind(grid))
        else:
            asked.check_unasked()
        found = judge(content, on, margin=margin, op_ids=op, scales=scales)
    if confirm:
        from ..confirm import confirm as confirm_gain

        found = confirm_gain(found, content.meta["configuration"], jobs=jobs, report=remark)
    result(lambda: "\n".join(filter(None, [format_table(found, columns()), told])), lambda: to_json(found))
    if output is not None:
        write_json(found, output)
    if plot is not None and found.worst_fitted is None:
        remark(f"{plot}: not drawn, for no operating point has a fit")
    elif plot is not None:
        from ...tuning.figures import plot_result

        plot_result(found, plot)


def _least(text: str) -> Least:
    if text not in ("margin", "damping", "probability"):
        raise WrongInput(f"--least {text!r}: needed is margin, damping or probability")
    return text  # type: ignore[return-value]


def as_told(table: Table, stable_on: str | None, exclude: Sequence[str]) -> Table:
    """The table with what the user knows of the device, and without the rows that are to be left out."""
    from ...identify.exclusion import parse_bands, without_bands
    from ...identify.operating_state import stated, with_statement

    responses = table.responses
    if stable_on is not None:
        fact = stated(stable_on)
        responses = tuple(with_statement(response, fact) for response in responses)
    if exclude:
        bands = parse_bands(exclude)
        responses = tuple(without_bands(response, bands) for response in responses)
    return replace(table, responses=responses)


def _scales(text: str) -> tuple[float, ...]:
    """One or several scales, as ``1.0,1.2,1.4``."""
    try:
        scales = tuple(float(part) for part in text.split(","))
    except ValueError:
        scales = ()
    if not scales or not all(isfinite(scale) and scale > 0.0 for scale in scales):
        raise WrongInput(f"--scale {text!r}: needed are numbers above 0, separated by commas, such as 1.0,1.2,1.4")
    return tuple(dict.fromkeys(scales))


def verify(
    tuning: Annotated[Path, typer.Argument(metavar="TUNING.json", help="What tune wrote, or a farm file FARM.toml.")],
    table: Annotated[
        Path | None, typer.Option(metavar="TABLE.parquet", help="Damping stops where this table says stable.")
    ] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Operating point; by default the worst.")] = None,
    scale: Annotated[float | None, typer.Option(help="Which of its scales, where it was tuned at several.")] = None,
    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="What happens; by default a step onto the tuned grid.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="VERIFY.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Power, r(t), ...: .png, .svg or .pdf.")] = None,
    force: Force = False,
) -> None:
    """The same device in time, with and without damping control; of a farm file, all its devices together."""
    from ..verify.job import VerifyJob, verified
    from ..verify.report import format_report, to_json

    check_outputs(output, force, plot, ".json")
    if tuning.suffix.lower() == ".toml":
        return _verify_farm(tuning, [table, op, scale], scenario, output, plot)
    found = verified(VerifyJob(tuning, table, op, scale, scenario, output, plot))
    result(lambda: format_report(found, columns()), lambda: to_json(found))


def _verify_farm(
    document: Path, of_a_tuning: Sequence[Any], scenario: Path | None, output: Path | None, plot: Path | None
) -> None:
    """A farm file in time."""
    from ..verify.farm_figure import plot_farm
    from ..verify.farm_report import format_report, to_json, write_json
    from ..verify.farm_runs import verify_farm
    from ..verify.farm_story import DEFAULT, read_farm_story
    from .farm import library_beside, naming, read_document

    if any(option is not None for option in of_a_tuning):
        raise WrongInput("--table, --op and --scale go with a tuning; a farm file names its tables itself")
    story = DEFAULT if scenario is None else read_farm_story(scenario)
    with naming(document):
        found = verify_farm(read_document(document), library_beside(document), story)
    if output is not None:
        write_json(found, output)
    if plot is not None:
        plot_farm(found, plot)
    result(lambda: format_report(found, columns()), lambda: to_json(found))


def grid(
    campaign: CampaignFile,
    signal_kind: Annotated[str, typer.Option("--signal", metavar="KIND", help="multisine or qrb.")] = "multisine",
    amplitude_pu: Annotated[float, typer.Option(help="Peak of the current over the rated peak.")] = 0.02,
    duration_s: Annotated[float, typer.Option(help="Length of the record (s).")] = 1.0,
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="GRID.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="R and X of every line: .png, .svg, .pdf.")] = None,
    force: Force = False,
    settings: Settings = None,
) -> None:
    """R + jX of the grid behind the PCC, identified while the plant runs on it."""
    from ..grid_probe.probe import format_report, make_probe, probe_hosted, to_json, write_json
    from ..run.host import host_at_hand

    check_outputs(output, force, plot, ".json")
    planned, plant = planned_of(campaign, settings)
    probe = make_probe(signal_kind, plant, amplitude_pu, duration_s)
    seen = probe_hosted(host_at_hand(plant, planned.hosting), planned, probe, op)
    result(lambda: format_report(seen, probe, plant.f1_hz), lambda: to_json(seen, probe, planned))
    if output is not None:
        write_json(to_json(seen, probe, planned), output)
    if plot is not None and any(each.found for each in seen):
        from ..grid_probe.figure import plot as draw

        draw(seen, plot)
    if any(each.reason for each in seen):
        raise typer.Exit(NOT_ALL_OK)
