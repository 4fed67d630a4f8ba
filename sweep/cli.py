"""The command line. Errors become one message and an exit status here, and nowhere else.

Exit status: 0 done, 1 done but some rows are not ok, 2 the input is wrong, 3 interrupted, 4 the
machine failed us. What a command needs is imported inside it: ``--help`` must not wait.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..plant.protocol import Plant
    from ..plant.registry import PlantCard
    from .plan import Plan

PLOT_SUFFIXES = (".png", ".svg", ".pdf")

OK, NOT_ALL_OK, WRONG_INPUT, INTERRUPTED, MACHINE = range(5)

_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]
"""`ClickException`: newer versions of typer bring a click of their own, older ones import it."""

app = typer.Typer(
    name="seqsweep",
    help="Sweep a converter nobody can look into: its 2x2 sequence admittance, as a table.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

CampaignFile = Annotated[Path, typer.Argument(metavar="CAMPAIGN.toml", help="The campaign file.")]
TableFile = Annotated[Path, typer.Argument(metavar="TABLE.parquet", help="A table of this format.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="a.b=c", help="Replace a value of the campaign; repeatable.")
]


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        from importlib.metadata import version as version_of

        typer.echo(version_of("seqsweep"))
        raise typer.Exit


@app.command()
def init(
    output: Annotated[Path, typer.Option("-o", "--output", help="Where to write it.")] = Path("campaign.toml"),
) -> None:
    """Write a commented campaign for the reference turbine."""
    from importlib.resources import files

    if output.exists():
        raise _WrongInput(f"{output} exists; choose another name with -o")
    _check_folder(output)
    output.write_text(files("seqsweep.sweep").joinpath("campaign_template.toml").read_text("utf-8"), "utf-8")
    typer.echo(f"{output} written; next: seqsweep run {output} -o y.parquet")


@app.command()
def plan(campaign: CampaignFile, settings: Settings = None, jobs: int = os.cpu_count() or 1) -> None:
    """Print every shot, the simulated seconds and the expected wall time; no shot is fired."""
    from .plan_text import plan_text

    planned, plant = _planned(campaign, settings)
    typer.echo(plan_text(planned, plant, jobs))


@app.command()
def run(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    jobs: Annotated[int, typer.Option(min=1, help="Workers.")] = os.cpu_count() or 1,
    backend: Annotated[
        str | None, typer.Option(help="threading, loky or dask; by default what suits the plant.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="A dask scheduler.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing table.")] = False,
    settings: Settings = None,
) -> None:
    """Sweep, and write the table. Interrupted, the same command goes on where it was."""
    if backend not in (None, "threading", "loky", "dask"):
        raise _WrongInput(f"--backend {backend!r}: known are threading, loky and dask")
    if scheduler is not None and backend != "dask":
        raise _WrongInput("--scheduler goes with --backend dask")
    _check_new(output, force)
    planned, plant = _planned(campaign, settings)
    from .campaign import run as run_campaign
    from .progress import progress

    with progress() as report:
        outcome = run_campaign(
            planned, plant, output, jobs=jobs, backend=backend, scheduler=scheduler, discard=force, report=report
        )
    _report(output, outcome.statuses)
    for remark in outcome.remarks:
        typer.echo(remark, err=True)
    if not outcome.all_ok:
        raise typer.Exit(NOT_ALL_OK)


@app.command()
def identify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings, or folders of them.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    manifest: Annotated[Path | None, typer.Option(metavar="FILE", help="What was injected (manifest.json).")] = None,
    channels: Annotated[str, typer.Option(metavar="va=NAME,...", help="Which channel is which.")] = "",
    direction: Annotated[str | None, typer.Option(metavar="load|generator", help="Of the recorded current.")] = None,
    f1: Annotated[str, typer.Option(metavar="auto|HZ", help="Fundamental; auto: out of the data.")] = "auto",
    sample_rate: Annotated[float | None, typer.Option(metavar="HZ", help="Overrules the files.")] = None,
    rated_voltage_v: Annotated[float | None, typer.Option(metavar="V", help="Base, line-to-line RMS.")] = None,
    rated_power_va: Annotated[float | None, typer.Option(metavar="VA", help="Base.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Name of the operating point.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Workers.")] = os.cpu_count() or 1,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing table.")] = False,
) -> None:
    """Recordings of a perturbed device in, the same table out."""
    from .identify_run import identify as identify_recordings
    from .identify_run import request_of

    _check_new(output, force)
    request = request_of(files, manifest, channels, direction, f1, sample_rate, (rated_voltage_v, rated_power_va), op)
    outcome = identify_recordings(request, output, jobs=jobs, say=lambda text: typer.echo(text, err=True))
    _report(output, outcome.statuses)
    if not outcome.all_ok:
        raise typer.Exit(NOT_ALL_OK)


@app.command()
def show(
    table: TableFile,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Bode plot: .png, .svg or .pdf.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Operating point to draw.")] = None,
) -> None:
    """Summarise a table, and draw its Bode plot."""
    from .show import summary

    if op is not None and plot is None:
        raise _WrongInput("--op names the operating point to draw: it goes with --plot FILE")
    _check_outputs(None, plot)
    terminal = sys.stdout.isatty()
    typer.echo(summary(table, width=shutil.get_terminal_size((80, 24)).columns, plain=not terminal))
    if plot is not None:
        from .plot import bode

        drawn = bode(table, plot, op)
        typer.echo(f"{plot}: operating point{'s' if len(drawn) > 1 else ''} {', '.join(drawn)}")


@app.command()
def validate(table: TableFile) -> None:
    """Hold a table against the format; exit status 0 or 2."""
    from ..identify.table import validate_table

    violations = validate_table(table)
    for violation in violations:
        typer.echo(violation, err=True)
    if violations:
        raise typer.Exit(WRONG_INPUT)
    typer.echo(f"{table}: conforms")


@app.command()
def check(
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="A plant's id, a CAMPAIGN.toml, or a file to read.")],
) -> None:
    """Hold a plant against its promise; of a file (.fmu, .so, .dll, .py) say what it is, executing nothing."""
    from .inspection import findings_of, findings_of_campaign, inspect, is_inspected

    if is_inspected(plant):
        typer.echo(inspect(Path(plant)))
        return
    findings = findings_of_campaign(Path(plant)) if plant.endswith(".toml") else findings_of(plant)
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        typer.echo(f"{'pass' if finding.passed else 'FAIL'}  {finding.name:<{width}}  {finding.detail}".rstrip())
    if not all(finding.passed for finding in findings):
        raise typer.Exit(NOT_ALL_OK)


@app.command()
def tune(
    table: TableFile,
    grid: Annotated[str, typer.Option(metavar="R+jX", help="Grid impedance in ohm at f1, such as 0.012+0.25j.")],
    scale: Annotated[float, typer.Option(help="Multiplies the grid impedance.")] = 1.0,
    margin: Annotated[float, typer.Option(help="Required magnitude margin m.")] = 1.4,
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="TUNING.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Bode, locus and poles: .png, .svg, .pdf.")] = None,
    confirm: Annotated[bool, typer.Option("--confirm", help="Sweep again with damping and iterate k.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Workers of --confirm.")] = os.cpu_count() or 1,
) -> None:
    """Is it stable on this grid, with what margin, and which k makes it so? Reads the table alone."""
    from ..identify.table import read_table
    from ..tuning.result import format_table, write_json
    from ..tuning.siso import parse_grid
    from ..tuning.tune import tune as judge

    _check_outputs(output, plot)
    content = read_table(table)
    result = judge(content, parse_grid(grid, content.meta["f1_hz"], scale), margin=margin, op_ids=op)
    if confirm:
        from .confirm import confirm as confirm_gain

        result = confirm_gain(
            result, content.meta["configuration"], jobs=jobs, report=lambda text: typer.echo(text, err=True)
        )
    typer.echo(format_table(result, shutil.get_terminal_size((100, 24)).columns))
    if output is not None:
        write_json(result, output)
    if plot is not None:
        from ..tuning.plot import plot_result

        plot_result(result, plot, result.worst.op_id)


@app.command()
def verify(
    tuning: Annotated[Path, typer.Argument(metavar="TUNING.json", help="What tune wrote.")],
    table: Annotated[
        Path | None, typer.Option(metavar="TABLE.parquet", help="Damping stops where this table says stable.")
    ] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Operating point; by default the worst.")] = None,
    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="What happens; by default a step onto the tuned grid.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="VERIFY.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Power, r(t), ...: .png, .svg or .pdf.")] = None,
) -> None:
    """The same device in time, with and without damping control."""
    from .verify_job import VerifyJob, verified

    _check_outputs(output, plot)
    width = shutil.get_terminal_size((100, 24)).columns
    typer.echo(verified(VerifyJob(tuning, table, op, scenario, output, plot, width)))


@app.command()
def grid(
    campaign: CampaignFile,
    signal_kind: Annotated[str, typer.Option("--signal", metavar="KIND", help="multisine or qrb.")] = "multisine",
    amplitude_pu: Annotated[float, typer.Option(help="Peak of the current over the rated peak.")] = 0.02,
    duration_s: Annotated[float, typer.Option(help="Length of the record (s).")] = 1.0,
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="GRID.json", help="Write JSON.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="R and X of every line: .png, .svg, .pdf.")] = None,
    settings: Settings = None,
) -> None:
    """R + jX of the grid behind the PCC, identified while the plant runs on it."""
    from ..plant.registry import PlantCard
    from .grid_probe import format_report, make_probe, probe_grids, probe_in_a_child, to_json, write_json

    _check_outputs(output, plot)
    planned, plant = _planned(campaign, settings)
    probe = make_probe(signal_kind, plant, amplitude_pu, duration_s)
    if isinstance(plant, PlantCard):
        seen = probe_in_a_child(planned, probe, op)
    else:
        seen = probe_grids(plant, planned, probe, op)
    typer.echo(format_report(seen, probe, plant.f1_hz))
    if output is not None:
        write_json(to_json(seen, probe, planned), output)
    if plot is not None and any(each.found for each in seen):
        from .grid_plot import plot as draw

        draw(seen, plot)
    if any(each.reason for each in seen):
        raise typer.Exit(NOT_ALL_OK)


@app.command("export")
def export_command(
    table: TableFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The suffix decides the format.")],
    kind: Annotated[str | None, typer.Option("--format", help="csv, mat or touchstone.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Only this operating point.")] = None,
    frame: Annotated[str, typer.Option(help="pn or dq.")] = "pn",
    z0: Annotated[float | None, typer.Option(metavar="OHM", help="Touchstone's reference; by default U^2/S.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a table for other tools: CSV, MATLAB (frd-ready) or Touchstone."""
    from .exchange import export_table, format_of

    if frame not in ("pn", "dq"):
        raise _WrongInput(f"--frame {frame!r}: known are pn and dq")
    if z0 is not None and not z0 > 0.0:
        raise _WrongInput(f"--z0 {z0:g}: needed: a number above 0, in ohm")
    found = format_of(output, kind)
    _check_new(output, force)
    typer.echo(export_table(table, output, found, op, frame, z0))  # type: ignore[arg-type]


@app.command("import")
def import_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV or other text, .mat or Touchstone.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    kind: Annotated[str | None, typer.Option("--format", help="csv, mat or touchstone.")] = None,
    frame: Annotated[str | None, typer.Option(help="pn or dq.")] = None,
    direction: Annotated[str | None, typer.Option(help="load: current into the device; or generator.")] = None,
    f1: Annotated[float | None, typer.Option(metavar="HZ", help="Fundamental frequency.")] = None,
    quantity: Annotated[str | None, typer.Option(help="admittance or impedance.")] = None,
    unit: Annotated[str | None, typer.Option(help="S, mS, ohm, pu, ...")] = None,
    phase_unit: Annotated[str | None, typer.Option(help="deg or rad.")] = None,
    frequency_unit: Annotated[str | None, typer.Option(help="Hz, kHz or rad/s.")] = None,
    q_axis: Annotated[str | None, typer.Option(help="leading (default) or lagging the d axis.")] = None,
    rated_voltage_v: Annotated[float | None, typer.Option(metavar="V", help="Rated line-to-line RMS.")] = None,
    rated_power_va: Annotated[float | None, typer.Option(metavar="VA", help="Rated apparent power.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Name of the operating point.")] = None,
    active_power_mw: Annotated[float | None, typer.Option(metavar="MW", help="Its active power.")] = None,
    terminal_voltage_pu: Annotated[float | None, typer.Option(metavar="PU", help="Its |v_pcc|.")] = None,
    variable: Annotated[str | None, typer.Option(metavar="NAME", help="The matrix in a .mat file.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing table.")] = False,
) -> None:
    """Make a table of another tool's file. What the file does not say, an option must; nothing is assumed."""
    from .exchange import format_of, import_file

    given = {
        "frame": frame,
        "direction": direction,
        "f1_hz": f1,
        "quantity": quantity,
        "unit": unit,
        "phase_unit": phase_unit,
        "frequency_unit": frequency_unit,
        "q_axis": q_axis,
        "rated_voltage_v": rated_voltage_v,
        "rated_power_va": rated_power_va,
        "op_id": op,
        "active_power_mw": active_power_mw,
        "terminal_voltage_pu": terminal_voltage_pu,
        "variable": variable,
    }
    found = format_of(file, kind)
    _check_new(output, force)
    typer.echo(import_file(file, output, found, given))


@app.command("inject")
def inject_command(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="A folder, made if it is not there.")],
    kind: Annotated[str, typer.Option("--format", help="csv, comtrade, pscad or mat.")],
    rate: Annotated[float, typer.Option(metavar="HZ", help="Sample rate of the files.")] = 10_000.0,
    quiet: Annotated[float, typer.Option(metavar="S", help="Silence at the start of a file.")] = 1.0,
    settle: Annotated[float, typer.Option(metavar="S", help="Tones play so long before they are evaluated.")] = 1.0,
    windows: Annotated[int, typer.Option(metavar="N", help="Coherent windows of an experiment.")] = 2,
    longest: Annotated[float, typer.Option(metavar="S", help="Longest file; 0: one pair per file.")] = 60.0,
    encoding: Annotated[str, typer.Option(help="Of COMTRADE: ASCII, BINARY, BINARY32 or FLOAT32.")] = "BINARY",
    op: Annotated[str | None, typer.Option(metavar="ID", help="Operating point, where there are several.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an earlier manifest and its files.")] = False,
    settings: Settings = None,
) -> None:
    """Write the perturbations as files, for PSCAD, RTDS, Simulink or a laboratory."""
    from .config import load_config
    from .inject import Timing, chosen, inject, planned
    from .manifest_file import FILE_NAME
    from .playback import SUFFIXES

    if kind not in SUFFIXES:
        raise _WrongInput(f"--format {kind!r}: known are {', '.join(SUFFIXES)}")
    if encoding not in ("ASCII", "BINARY", "BINARY32", "FLOAT32"):
        raise _WrongInput(f"--encoding {encoding!r}: known are ASCII, BINARY, BINARY32 and FLOAT32")
    timing = Timing(rate, quiet, settle, windows, longest)
    plan, plant = planned(load_config(campaign, settings or ()), timing)
    condition = chosen(plan, op)
    if output.exists() and not output.is_dir():
        raise _WrongInput(f"{output} is a file; name a folder")
    if (output / FILE_NAME).exists() and not force:
        raise _WrongInput(f"{output / FILE_NAME} exists; --force writes over it")
    _check_folder(output)
    for warning in plan.warnings:
        typer.echo(f"warning: {warning}", err=True)
    output.mkdir(exist_ok=True)
    written = inject(plan, plant, condition, output, kind, timing, encoding)  # type: ignore[arg-type]
    ends = {experiment.file: experiment.end_s for experiment in written.experiments}
    typer.echo(
        f"{output}: {condition.op_id}, {len(written.experiments)} experiments in {len(ends)} files, "
        f"{sum(ends.values()):.1f} s at {rate:g} Hz; next: docs/inject.md, then seqsweep identify with {FILE_NAME}"
    )


class _WrongInput(ValueError):
    """A call that cannot be carried out as given."""


def _planned(campaign: Path, settings: list[str] | None) -> tuple[Plan, Plant | PlantCard]:
    from .config import load_config
    from .isolate import plant_or_card
    from .plan import make_plan

    config = load_config(campaign, settings or ())
    if config.plant.id == "external":
        raise _WrongInput(f"{campaign}: an external device cannot be driven from here; seqsweep inject writes files")
    plant = plant_or_card(config)
    planned = make_plan(config, plant)
    for warning in planned.warnings:
        typer.echo(f"warning: {warning}", err=True)
    return planned, plant


def _check_outputs(output: Path | None, plot: Path | None) -> None:
    """Refuse, before anything is computed, what could not be written in the end."""
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise _WrongInput(f"{plot}: the suffix decides the format of the plot; needed: {', '.join(PLOT_SUFFIXES)}")
    for path in (output, plot):
        if path is not None:
            _check_folder(path)


def _check_new(output: Path, force: bool) -> None:
    """Refuse an output that is in the way of nothing, or of something that may stay."""
    if output.is_dir():
        raise _WrongInput(f"{output} is a folder; name a file")
    if output.exists() and not output.is_file():
        raise _WrongInput(f"{output} is no ordinary file; a file cannot take its place")
    if output.exists() and not force:
        raise _WrongInput(f"{output} exists; --force replaces it")
    _check_folder(output)


def _report(output: Path, statuses: dict[str, int]) -> None:
    """One line on stderr: rows by status, the most frequent first."""
    counts = ", ".join(f"{n} {status}" for status, n in sorted(statuses.items(), key=lambda item: -item[1]))
    typer.echo(f"{output}: {counts}", err=True)


def _check_folder(output: Path) -> None:
    folder = output.absolute().parent
    if not folder.is_dir():
        raise _WrongInput(f"{folder}: no such folder")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"{folder}: no permission to write there")


def main() -> None:
    """Run the command line and raise ``SystemExit`` with its exit status."""
    raise SystemExit(_status())


def console() -> None:
    """Run the command line and end the process.

    Everything is written by then, and taking the compiler down in order would cost 0.3 s: with no
    other thread left, nothing else waits for an orderly end. Interrupted, workers may be deep in a
    plant, and nothing of theirs is needed any more.
    """
    status = _status()
    sys.stdout.flush()
    sys.stderr.flush()
    if status == INTERRUPTED or threading.active_count() == 1:
        os._exit(status)
    raise SystemExit(status)  # pools of processes are taken down by the interpreter


def _status() -> int:
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # matrices are small here: more threads only get in each other's way
    try:
        result = app(standalone_mode=False)
    except _USAGE_ERROR as error:
        error.show(file=sys.stderr)
        return WRONG_INPUT
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted()
    except ValueError as error:
        typer.echo(str(error), err=True)
        return WRONG_INPUT
    except (BrokenPipeError, SystemExit):  # nobody reads on; typer makes the latter of the former
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except OSError as error:
        typer.echo(f"{error}; what was measured is kept: run the same command again to go on", err=True)
        return MACHINE
    if result == 128 + signal.SIGINT:  # what typer makes of Ctrl-C
        return _interrupted()
    return result if isinstance(result, int) else OK


def _interrupted() -> int:
    typer.echo("interrupted; run the same command again to go on", err=True)
    return INTERRUPTED
