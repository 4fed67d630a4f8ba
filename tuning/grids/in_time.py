"""Which grids have a time domain: R + jX, and elements as a circuit of branches; a cable as pi sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

from ...plant.circuits.branches import Branch
from ...plant.circuits.circuit import PCC, SOURCE, Circuit
from ..network.assembly import Line
from ..network.equipment import pi_line
from .document import Element, elements_of, parts_of, reactance_compensated
from .elements import CableGrid, ElementsGrid, elements_grid
from .errors import GridError
from .promise import Grid
from .series import SeriesRL

SECTION_KM = 5.0
"""Longest pi section (km) by which a distributed line is simulated."""


def circuit_of(document: Mapping[str, Any], f1_hz: float, name: str = "") -> Circuit:
    """The circuit of a document of elements.

    Raises
    ------
    GridError
        If the document is not one of a grid, or nothing leads to its source.
    """
    parts = parts_of(document, f1_hz, SOURCE)
    branches = tuple(branch for part in parts for branch in _lumped(part))
    if not any(SOURCE in branch.ends for branch in branches):
        raise GridError("nothing leads to the source: there is no voltage to simulate with; see 'source' or 'to'")
    ratio = _source_ratio(elements_of(document, f1_hz))
    return Circuit(branches, ratio, name or str(document.get("name", "elements")))


def circuit_of_grid(grid: Grid) -> Circuit | None:
    """The circuit of a grid; None of R + jX, which needs none.

    Raises
    ------
    GridError
        If the grid has no time domain.
    """
    if isinstance(grid, SeriesRL):
        return None
    if isinstance(grid, ElementsGrid | CableGrid):
        return circuit_of(grid.document, grid.f1_hz, grid.name).scaled(grid.scale)
    raise GridError(
        f"{grid.label}: it has no time domain, for a spectrum or a table is no circuit; simulated are R + jX and "
        "elements (grid.toml with [[element]])"
    )


def grid_of_fact(place: Mapping[str, Any], f1_hz: float) -> Grid:
    """The grid that a table or a campaign names: ``elements``, or r_ohm and x_ohm, times ``scale``."""
    scale = place.get("scale") or 1.0
    if place.get("elements") is not None:
        return elements_grid(place["elements"], f1_hz).scaled(scale)
    return SeriesRL(float(place["r_ohm"]) * scale, float(place["x_ohm"]) * scale, f1_hz)


def ready_to_switch(document: Mapping[str, Any], f1_hz: float) -> dict[str, Any]:
    """The document with every name written out and series capacitors in ohm: what is switched changes nothing else."""
    entries = [{**entry, "name": name} for name, entry in zip(names_of(document), document["element"], strict=True)]
    for k, entry in enumerate(document["element"]):
        if entry.get("compensation_percent", 0.0) > 0.0:
            entries[k]["x_ohm"] = compensating(document, k, entry["compensation_percent"], f1_hz)
            del entries[k]["compensation_percent"]
    return {**document, "element": entries}


def compensating(document: Mapping[str, Any], k: int, percent: float, f1_hz: float) -> float:
    """Reactance (ohm) of ``percent`` of compensation by entry ``k``."""
    return percent / 100.0 * reactance_compensated(document, k, f1_hz)


def names_of(document: Mapping[str, Any]) -> list[str]:
    """The entries' names, given or made of the kind and its number."""
    counts: dict[str, int] = {}
    found = []
    for entry in document["element"]:
        kind = str(entry.get("kind"))
        counts[kind] = counts.get(kind, 0) + 1
        found.append(str(entry.get("name", f"{kind}{counts[kind]}")))
    return found


def _lumped(part: Branch | Line) -> Sequence[Branch]:
    return pi_line(part, ceil(part.length_km / SECTION_KM)) if isinstance(part, Line) else (part,)


def _source_ratio(elements: Sequence[Element]) -> float:
    """Rated voltage at the source over that at the PCC, by the transformers between them."""
    ratios = {PCC: 1.0}
    for _ in elements:
        for element in elements:
            gain = element.values["vn_hv_kv"] / element.values["vn_lv_kv"] if element.kind == "transformer" else 1.0
            if element.a in ratios:
                ratios.setdefault(element.b, ratios[element.a] * gain)
            elif element.b in ratios:
                ratios.setdefault(element.a, ratios[element.b] / gain)
    return ratios.get(SOURCE, 1.0)
