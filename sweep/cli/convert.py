"""The command `convert`: networks of pandapower and MATPOWER to farm files, and farms to them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .farm import library_beside, read_document
from .shared import Force, WrongInput, check_new
from .telling import is_json, remark, result


def convert(
    source: Annotated[
        Path, typer.Argument(metavar="NETWORK", help="pandapower .json, MATPOWER .m, or a farm's .toml.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help=".toml, or .json or .m for a farm.")],
    table: Annotated[
        str, typer.Option(metavar="FILE.parquet", help="Table that every generator gets.")
    ] = "device.parquet",
    s_sc_mva: Annotated[
        float | None, typer.Option("--s-sc-mva", metavar="MVA", help="Short-circuit power where the file has none.")
    ] = None,
    f1: Annotated[float, typer.Option(metavar="HZ", help="Fundamental where the file has none.")] = 50.0,
    reactive: Annotated[
        bool, typer.Option("--reactive", help="Keep the generators' reactive powers as set-points.")
    ] = False,
    force: Force = False,
) -> None:
    """A network of pandapower or MATPOWER as a farm file, or a farm with its load flow as one of theirs."""
    check_new(output, force)
    remarks: tuple[str, ...]
    if source.suffix.lower() == ".toml":
        text, remarks = _farm_as(source, output.suffix.lower()), ()
    else:
        text, remarks = _network(source, output, table, s_sc_mva, f1, reactive)
    from ...identify.files import atomic_file

    with atomic_file(output) as file:
        file.write(text.encode())
    for told in remarks:
        remark(f"remark: {told}")
    remark(f"{output} written")
    if is_json():
        result("", lambda: {"output": output, "remarks": remarks})


def _network(
    source: Path, output: Path, table: str, s_sc_mva: float | None, f1_hz: float, reactive: bool
) -> tuple[str, tuple[str, ...]]:
    from ...tuning.farm.network_files import imported
    from ...tuning.farm.network_parts import farm_text

    if output.suffix.lower() != ".toml":
        raise WrongInput(f"{output}: a farm file is written as .toml")
    try:
        text = source.read_text("utf-8")
    except FileNotFoundError:
        raise WrongInput(f"{source}: no such file") from None
    except (IsADirectoryError, UnicodeDecodeError):
        raise WrongInput(f"{source}: no text; needed is a network of pandapower (.json) or MATPOWER (.m)") from None
    found = imported(text, table, s_sc_mva, f1_hz)
    if reactive:
        found.keep_reactive()
    return farm_text(found.document(), tuple(found.remarks)), tuple(found.remarks)


def _farm_as(source: Path, suffix: str) -> str:
    from ...tuning.farm.document import farm_of
    from ...tuning.farm.network_files import exported
    from ...tuning.farm.units import flow_of

    content: dict[str, Any] = read_document(source)
    farm = farm_of(content)
    flow = flow_of(farm, library_beside(source))
    powers = {device.name: -power / 1e6 for device, power in zip(farm.devices, flow.power_va, strict=True)}
    return exported(content, powers, suffix)
