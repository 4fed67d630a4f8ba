"""The command `farm`: many devices on a network, whether they are stable together, and who causes which mode."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...plant.foreign.toml_file import read_toml
from .shared import Elements, Force, WrongInput, check_new, check_outputs, check_plot, check_suffix
from .telling import remark, result

if TYPE_CHECKING:
    from ...tuning.farm.farm import Farm
    from ...tuning.farm.restore import Advice, Demand
    from ...tuning.farm.units import Library

Jobs = Annotated[int | None, typer.Option(metavar="N", min=1, help="Workers; as many as processors unless given.")]


class Lever(StrEnum):
    """What can be changed on a device."""

    gain = "gain"
    power = "power"


def farm(
    document: Annotated[Path, typer.Argument(metavar="FARM.toml", help="Buses, equipment, source and devices.")],
    out: Annotated[
        list[str] | None, typer.Option("--out", metavar="NAME", help="Take this device or equipment out; repeatable.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FARM.json", help="Write JSON.")] = None,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE.parquet", help="Write the farm's own admittance at the source's bus.")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Modes and shares, or with --states their map: .png, .svg or .pdf."),
    ] = None,
    diagram: Annotated[
        Path | None, typer.Option(metavar="FILE", help="One-line diagram with the critical mode drawn on it.")
    ] = None,
    states: Annotated[
        bool, typer.Option("--states", help="Judge every switching state, [[state]] in the file.")
    ] = False,
    margin: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Margin m at the source: asked with --by, or where control may stop (--states)."
        ),
    ] = None,
    grids: Annotated[
        Path | None,
        typer.Option(metavar="BANK", help="Judge it on every grid of a bank, each with a load flow of its own."),
    ] = None,
    elements: Elements = 5,
    by: Annotated[
        list[Lever] | None, typer.Option(help="What can be changed: damping gains, powers given up; repeatable.")
    ] = None,
    damping: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="Damping that every mode shall have; with --by.")
    ] = None,
    probability: Annotated[float, typer.Option(metavar="P", help="Probability with which it shall have it.")] = 0.95,
    jobs: Jobs = None,
    force: Force = False,
) -> None:
    """Load flow, verdict and modes of many devices on one network, and who takes part in each mode."""
    from ...identify.files import write_json
    from ...tuning.farm.advice_text import advice_text
    from ...tuning.farm.result import text_of, to_json

    check_outputs(output, force, plot, ".json" if grids is None else ".parquet")
    check_plot(diagram)
    if table is not None:
        check_new(table, force)
        check_suffix(table, ".parquet")
    of_one = {"--by": by or None, "--damping": damping, "--table": table, "--diagram": diagram}
    if grids is not None:
        _check_alone("--grids judges many grids", {"--states": states or None, **of_one, "--margin": margin})
        return _all_grids(document, out or [], grids, (output, plot), elements, jobs, force)
    if states:
        _check_alone("--states judges every switching state", of_one)
        return _all_states(document, out or [], 1.0 if margin is None else margin, output, plot)
    _check_demand(damping, margin, probability, by)
    library, found = _judged(document, out or [])
    demand = _demand(damping, margin, probability, found)
    advice = [_advice(lever, library, found, demand, jobs) for lever in by or []]
    result(lambda: "\n\n".join([text_of(found), *map(advice_text, advice)]), lambda: to_json(found, advice))
    if output is not None:
        write_json(output, to_json(found, advice))
    if table is not None:
        _write_table(found, table, document)
    if plot is not None:
        from ..report.farm import plot_farm

        plot_farm(plot, found)
    if diagram is not None:
        from ..report.farm_diagram import plot_diagram

        plot_diagram(diagram, found)


def _judged(document: Path, out: list[str]) -> tuple[Library, Farm]:
    from ...tuning.farm.document import farm_of
    from ...tuning.farm.farm import judged

    with naming(document):
        entry = farm_of(read_document(document), out)
        library = library_beside(document)
        return library, judged(entry, library)


@contextmanager
def naming(document: Path) -> Iterator[None]:
    """What a farm is refused for, with the name of its file."""
    from ...tuning.farm.entries import FarmError

    try:
        yield
    except FarmError as error:
        raise WrongInput(f"{document}: {error}") from None


def library_beside(document: Path) -> Library:
    """The tables that a farm file names, relative to it."""
    from ...identify.table.read import read_table
    from ...tuning.farm.units import Library

    return Library(lambda name: read_table(document.parent / name))


def _all_states(document: Path, out: list[str], margin: float, output: Path | None, plot: Path | None) -> None:
    """Every switching state of the farm file: table, JSON and map."""
    from ...identify.files import write_json
    from ...tuning.farm.result import states_json, states_text
    from ...tuning.farm.states import judge_states

    _check_margin(margin)
    content = read_document(document)
    with naming(document):
        found = judge_states(content, library_beside(document), out, margin, remark)
    result(lambda: states_text(found), lambda: states_json(str(content.get("name", "farm")), found))
    if output is not None:
        write_json(output, states_json(str(content.get("name", "farm")), found))
    if plot is not None:
        from ..report.farm_states import plot_states

        plot_states(plot, found)


def _check_alone(many: str, others: Mapping[str, object]) -> None:
    """Refuse what asks something of one farm on one source, where ``many`` are asked about; None is not given."""
    for option, given in others.items():
        if given is not None:
            raise WrongInput(f"{many} and {option} asks about one farm on one source: give one of them")


def _all_grids(
    document: Path,
    out: list[str],
    grids: Path,
    written: tuple[Path | None, Path | None],
    elements: int,
    jobs: int | None,
    force: bool,
) -> None:
    """The farm on every grid of a bank: table, Parquet file and map, as `judge` makes them of one device."""
    from hashlib import sha256

    from ...tuning.bank.entries import check_single, read_bank
    from ...tuning.farm.document import farm_of
    from ...tuning.farm.on_grids import farm_on_grids
    from ..bank.following import FarmFollowing
    from ..bank.judge import judge_bank
    from .bank import progress, tell_pairs

    content, library = read_document(document), library_beside(document)
    with naming(document):
        farm = farm_on_grids(farm_of(content, out), library)
    bank = read_bank(grids)
    for text in bank.remarks:
        remark(text)
    check_single(bank, farm.entry.f1_hz)
    tables = sorted({device.table for device in farm.entry.devices})
    of_tables = [library.table(name).meta["sha256"] for name in tables]
    digest = sha256(repr((sorted(map(repr, content.items())), out, of_tables)).encode()).hexdigest()
    output, plot = written
    verdicts = judge_bank(
        FarmFollowing(farm),
        farm.bases,
        digest,
        bank.entries,
        output=output,
        jobs=jobs or os.cpu_count() or 1,
        elements=elements,
        discard=force,
        report=progress(),
    )
    tell_pairs(verdicts, farm.entry.f1_hz, output, plot, {"farm_sha256": digest})


def _check_demand(damping: float | None, margin: float | None, probability: float, by: list[Lever] | None) -> None:
    if damping is not None and margin is not None:
        raise WrongInput("--damping and --margin are two demands; give one")
    if (damping is not None or margin is not None) and not by:
        raise WrongInput("a demand asks what would restore it; say by what: --by gain, --by power, or both")
    if damping is not None and not -100.0 < damping < 100.0:
        raise WrongInput(f"--damping {damping:g}: needed is a damping ratio in per cent, such as 5")
    if margin is not None:
        _check_margin(margin)
    if not 0.5 <= probability < 1.0:
        raise WrongInput(f"--probability {probability:g}: needed is a number from 0.5 to below 1, such as 0.95")


def _check_margin(margin: float) -> None:
    if not 0.0 < margin < inf:
        raise WrongInput(f"--margin {margin:g}: needed is a magnitude margin above 0, such as 1.4")


def _demand(damping: float | None, margin: float | None, probability: float, found: Farm) -> Demand | None:
    from ...tuning.farm.restore import DAMPED_BAND, Damping, SourceMargin

    if damping is not None:
        return Damping(damping / 100.0, probability, DAMPED_BAND * found.entry.f1_hz)
    return None if margin is None else SourceMargin(margin, probability)


def _advice(lever: Lever, library: Library, found: Farm, demand: Demand | None, jobs: int | None) -> Advice:
    from ..farm_sweeps import gain_advice, power_advice

    if lever == Lever.power:
        return power_advice(library, found, demand, remark)
    return gain_advice(library, found, demand, jobs or os.cpu_count() or 1, remark)


def read_document(document: Path) -> dict[str, Any]:
    """What a farm file holds."""
    return read_toml(document, WrongInput)


def _write_table(found: Farm, table: Path, document: Path) -> None:
    """The farm at the source's bus, at the frequencies of its first device, as an ordinary table."""
    import numpy as np

    from ...identify.table.write import write_table
    from ...tuning.farm.farm import seen_from_source

    f1 = found.entry.f1_hz
    nu = found.units[0].model.nu_hz
    response = seen_from_source(found, np.sort(f1 + nu[nu > 1e-6 * f1]))
    power_w = -sum(unit.power_va.real for unit in found.units)
    meta = {
        "f1_hz": f1,
        "bases": {
            "rated_voltage_v": found.entry.voltages_v[found.entry.source_bus],
            "rated_power_va": float(sum(abs(unit.power_va) for unit in found.units)),
        },
        "power_meaning": "sum of the devices' active power at their terminals",
        "operating_points": [{"op_id": "farm", "active_power_mw": power_w / 1e6, "terminal_voltage_pu": None}],
        "configuration": {"farm": found.entry.name},
        "plant": {"id": "farm", "devices": [unit.key for unit in found.units]},
    }
    write_table(table, [response], meta)
    remark(f"{table}: the farm at {found.entry.source_bus}")
