"""Commands that take and give files of other tools: identify, export, import, inject."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .shared import (
    NOT_ALL_OK,
    CampaignFile,
    Force,
    Settings,
    StableOn,
    TableFile,
    WrongInput,
    check_folder,
    check_new,
    check_suffix,
    report_statuses,
)
from .telling import remark, result


def identify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings, or folders of them.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    manifest: Annotated[Path | None, typer.Option(metavar="FILE", help="What was injected (manifest.json).")] = None,
    channels: Annotated[str, typer.Option(metavar="va=NAME,...", help="Which channel is which.")] = "",
    voltage_unit: Annotated[str | None, typer.Option(metavar="kV", help="Of the voltages; overrules.")] = None,
    current_unit: Annotated[str | None, typer.Option(metavar="kA", help="Of the currents; overrules.")] = None,
    direction: Annotated[str | None, typer.Option(metavar="load|generator", help="Of the recorded current.")] = None,
    f1: Annotated[str, typer.Option(metavar="auto|HZ", help="Fundamental; auto: out of the data.")] = "auto",
    sample_rate: Annotated[float | None, typer.Option(metavar="HZ", help="Overrules the files.")] = None,
    rated_voltage_v: Annotated[float | None, typer.Option(metavar="V", help="Base, line-to-line RMS.")] = None,
    rated_power_va: Annotated[float | None, typer.Option(metavar="VA", help="Base.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Name of the operating point.")] = None,
    stable_on: StableOn = None,
    jobs: Annotated[int, typer.Option(min=1, help="Workers.")] = os.cpu_count() or 1,
    force: Force = False,
) -> None:
    """Recordings of a perturbed device in, the same table out."""
    from ..recorded.identify import identify as identify_recordings
    from ..recorded.identify import request_of

    check_new(output, force)
    check_suffix(output, ".parquet")
    rating, units = (rated_voltage_v, rated_power_va), (voltage_unit, current_unit)
    request = request_of(files, manifest, channels, direction, f1, sample_rate, rating, op, stable_on, units)
    outcome = identify_recordings(request, output, jobs=jobs, say=remark)
    report_statuses(output, outcome.statuses)
    if not outcome.all_ok:
        raise typer.Exit(NOT_ALL_OK)


def export_command(
    table: TableFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The suffix decides the format.")],
    kind: Annotated[str | None, typer.Option("--format", help="csv, mat or touchstone.")] = None,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Only this operating point.")] = None,
    frame: Annotated[str, typer.Option(help="pn or dq.")] = "pn",
    z0: Annotated[float | None, typer.Option(metavar="OHM", help="Touchstone's reference; by default U^2/S.")] = None,
    force: Force = False,
) -> None:
    """Write a table for other tools: CSV, MATLAB (frd-ready) or Touchstone."""
    from .exchange import export_table, format_of

    if frame not in ("pn", "dq"):
        raise WrongInput(f"--frame {frame!r}: known are pn and dq")
    if z0 is not None and not z0 > 0.0:
        raise WrongInput(f"--z0 {z0:g}: needed: a number above 0, in ohm")
    found = format_of(output, kind)
    check_new(output, force)
    said = export_table(table, output, found, op, frame, z0)  # type: ignore[arg-type]
    result(said, lambda: {"output": output, "format": found, "text": said})


def import_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV or other text, .mat, .xlsx or Touchstone.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    kind: Annotated[str | None, typer.Option("--format", help="csv, mat, touchstone or xlsx.")] = None,
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
    reactive_power_mvar: Annotated[float | None, typer.Option(metavar="MVAR", help="Its reactive power.")] = None,
    terminal_voltage_pu: Annotated[float | None, typer.Option(metavar="PU", help="Its |v_pcc|.")] = None,
    variable: Annotated[str | None, typer.Option(metavar="NAME", help="The matrix (.mat) or sheet (.xlsx).")] = None,
    terminal: Annotated[str | None, typer.Option(metavar="NAME", help="Where a file holds several.")] = None,
    stable_on: StableOn = None,
    force: Force = False,
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
        "reactive_power_mvar": reactive_power_mvar,
        "terminal_voltage_pu": terminal_voltage_pu,
        "variable": variable,
        "terminal": terminal,
        "stable_on": stable_on,
    }
    found = format_of(file, kind, reading=True)
    check_new(output, force)
    check_suffix(output, ".parquet")
    said = import_file(file, output, found, given)
    result(said, lambda: {"output": output, "format": found, "text": said})


def inject_command(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="A folder, made if it is not there.")],
    kind: Annotated[str, typer.Option("--format", help="csv, comtrade, pscad or mat.")],
    rate: Annotated[float, typer.Option(metavar="HZ", help="Sample rate of the files.")] = 10_000.0,
    silence: Annotated[float, typer.Option(metavar="S", help="Silence at the start of a file.")] = 1.0,
    settle: Annotated[float, typer.Option(metavar="S", help="Tones play so long before they are evaluated.")] = 1.0,
    windows: Annotated[int, typer.Option(metavar="N", help="Coherent windows of an experiment.")] = 2,
    longest: Annotated[float, typer.Option(metavar="S", help="Longest file; 0: one pair per file.")] = 60.0,
    encoding: Annotated[str, typer.Option(help="Of COMTRADE: ASCII, BINARY, BINARY32 or FLOAT32.")] = "BINARY",
    op: Annotated[str | None, typer.Option(metavar="ID", help="Operating point, where there are several.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an earlier manifest and its files.")] = False,
    settings: Settings = None,
) -> None:
    """Write the perturbations as files, for PSCAD, RTDS, Simulink or a laboratory."""
    from ..config.sections import load_config
    from ..playback.inject import Timing, chosen, inject, planned
    from ..playback.manifest import FILE_NAME
    from ..playback.waveform_files import SUFFIXES

    if kind not in SUFFIXES:
        raise WrongInput(f"--format {kind!r}: known are {', '.join(SUFFIXES)}")
    if encoding not in ("ASCII", "BINARY", "BINARY32", "FLOAT32"):
        raise WrongInput(f"--encoding {encoding!r}: known are ASCII, BINARY, BINARY32 and FLOAT32")
    timing = Timing(rate, silence, settle, windows, longest)
    plan, plant = planned(load_config(campaign, settings or ()), timing)
    condition = chosen(plan, op)
    if output.exists() and not output.is_dir():
        raise WrongInput(f"{output} is a file; name a folder")
    if (output / FILE_NAME).exists() and not force:
        raise WrongInput(f"{output / FILE_NAME} exists; --force writes over it")
    check_folder(output)
    for warning in plan.warnings:
        remark(f"warning: {warning}")
    output.mkdir(exist_ok=True)
    written = inject(plan, plant, condition, output, kind, timing, encoding)  # type: ignore[arg-type]
    ends = {experiment.file: experiment.end_s for experiment in written.experiments}
    files = f"{len(ends)} file{'s' if len(ends) > 1 else ''}"
    seconds = sum(ends.values())
    result(
        f"{output}: {condition.op_id}, {len(written.experiments)} experiments in {files}, {seconds:.1f} s at {rate:g} "
        f"Hz; next: docs/inject.md, then seqsweep identify with {FILE_NAME}",
        lambda: {"output": output, "op_id": condition.op_id, "files": sorted(ends), "seconds": seconds},
    )
