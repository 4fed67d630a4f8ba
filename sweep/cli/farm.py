"""The command `farm`: many devices on a network, whether they are stable together, and who causes which mode."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shared import Force, WrongInput, check_new, check_outputs, check_suffix

if TYPE_CHECKING:
    from ...tuning.farm.farm import Farm


def farm(
    document: Annotated[Path, typer.Argument(metavar="FARM.toml", help="Buses, equipment, source and devices.")],
    out: Annotated[
        list[str] | None, typer.Option("--out", metavar="NAME", help="Take this device or equipment out; repeatable.")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FARM.json", help="Write JSON.")] = None,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE.parquet", help="Write the farm's own admittance at the source's bus.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Modes and shares: .png, .svg or .pdf.")] = None,
    force: Force = False,
) -> None:
    """Load flow, verdict and modes of many devices on one network, and who takes part in each mode."""
    from ...identify.files import write_json
    from ...tuning.farm.result import text_of, to_json

    check_outputs(output, force, plot, ".json")
    if table is not None:
        check_new(table, force)
        check_suffix(table, ".parquet")
    found = _judged(document, out or [])
    typer.echo(text_of(found))
    if output is not None:
        write_json(output, to_json(found))
    if table is not None:
        _write_table(found, table, document)
    if plot is not None:
        from ..report.farm import plot_farm

        plot_farm(plot, found)


def _judged(document: Path, out: list[str]) -> Farm:
    from ...identify.table.read import read_table
    from ...tuning.farm.document import farm_of
    from ...tuning.farm.farm import judged

    entry = farm_of(_read(document), out)
    return judged(entry, lambda name: read_table(document.parent / name))


def _read(document: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(document.read_text("utf-8"))
    except FileNotFoundError:
        raise WrongInput(f"{document}: no such file") from None
    except IsADirectoryError:
        raise WrongInput(f"{document} is a folder; name the farm file, such as farm.toml") from None
    except UnicodeDecodeError:
        raise WrongInput(f"{document}: no text; a farm file is TOML in UTF-8, see examples/farm/farm.toml") from None
    except tomllib.TOMLDecodeError as error:
        raise WrongInput(f"{document}: not a TOML file: {error}") from None


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
    typer.echo(f"{table}: the farm at {found.entry.source_bus}", err=True)
