"""The commands that make the files of a report again, as far as the files themselves say how they were made."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from .inputs import FarmInputs, Inputs


def commands(inputs: Inputs) -> list[str]:
    """One line per file in the order in which they are made, and the report itself last."""
    table = inputs.name_of("table")
    lines = [_of_table(inputs, table)]
    for kind, command in _COMMANDS.items():
        if kind in inputs.results:
            lines.append(command(inputs, table, inputs.name_of(kind)))
    return [*lines, _of_report(inputs)]


def farm_commands(inputs: FarmInputs) -> list[str]:
    """As `commands`, of results of a farm without a table."""
    made = {"farm": _of_farm, "states": _of_states}
    return [*(made[file.kind](inputs, "", file.name) for file in inputs.files), _of_report(inputs)]


def _of_report(inputs: Inputs | FarmInputs) -> str:
    given = " ".join(shlex.quote(file.name) for file in inputs.files)
    return f"seqsweep report {given} -o report.html"


def _of_table(inputs: Inputs, table: str) -> str:
    configuration = inputs.table.meta.get("configuration") or {}
    if "sweep" not in configuration:
        return f"# {table} was not swept by seqsweep run: see its metadata (seqsweep show {shlex.quote(table)})"
    return f"seqsweep run campaign.toml -o {shlex.quote(table)}"


def _of_tuning(inputs: Inputs, table: str, output: str) -> str:
    tuning = inputs.results["tuning"]
    provenance = tuning.get("provenance") or {}
    scales = ",".join(f"{scale:g}" for scale in provenance.get("scales") or [1.0])
    confirmed = any(point.get("with_k") for point in tuning["operating_points"])
    return " ".join(
        [
            f"seqsweep tune {shlex.quote(table)} --grid {_grid(provenance)} --scale {scales}",
            f"--margin {provenance.get('margin_required', 1.4):g}",
            *(["--confirm"] if confirmed else []),
            f"-o {shlex.quote(output)}",
        ]
    )


def _grid(provenance: Mapping[str, Any]) -> str:
    grid = provenance.get("grid") or {}
    if provenance.get("own_grid"):
        return "own"
    if grid.get("kind") == "series_rl":
        return f"{grid['r_ohm']:.12g}+{grid['x_ohm']:.12g}j"
    return shlex.quote(str(grid.get("name") or "GRID"))


def _of_verification(inputs: Inputs, table: str, output: str) -> str:
    tuning = inputs.name_of("tuning") if "tuning" in inputs.results else "tuning.json"
    return f"seqsweep verify {shlex.quote(tuning)} -o {shlex.quote(output)}"


def _of_bank(inputs: Inputs, table: str, output: str) -> str:
    return f"seqsweep judge {shlex.quote(table)} --grids BANK -o {shlex.quote(output)}"


def _of_metrics(inputs: Inputs, table: str, output: str) -> str:
    return f"seqsweep metrics {shlex.quote(table)} -o {shlex.quote(output)}"


def _of_farm(inputs: Inputs | FarmInputs, table: str, output: str) -> str:
    return f"seqsweep farm FARM.toml -o {shlex.quote(output)}"


def _of_states(inputs: Inputs | FarmInputs, table: str, output: str) -> str:
    return f"seqsweep farm FARM.toml --states -o {shlex.quote(output)}"


def _of_surrogate(inputs: Inputs, table: str, output: str) -> str:
    return f"seqsweep surrogate {shlex.quote(table)} -o {shlex.quote(output)}"


_COMMANDS = {
    "surrogate": _of_surrogate,
    "tuning": _of_tuning,
    "verification": _of_verification,
    "bank": _of_bank,
    "metrics": _of_metrics,
    "farm": _of_farm,
    "states": _of_states,
}
