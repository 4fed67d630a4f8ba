"""Voltage levels of a grid, and voltages that cannot be meant: V taken for kV, or two that contradict each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ..network.assembly import GROUND
from .errors import GridError

if TYPE_CHECKING:
    from .document import Element

LOWEST_KV, HIGHEST_KV = 0.05, 1500.0
"""Voltages that equipment is made for (kV)."""

MISMATCH = 2.0
"""The low side and the voltage of its place contradict each other where they are further apart than this factor."""


def check_sides(name: str, rated_kv: Mapping[str, float]) -> None:
    """Refuse a transformer with a side that nobody builds."""
    for key, value in rated_kv.items():
        if not LOWEST_KV <= value <= HIGHEST_KV:
            raise GridError(
                f"{name}: {key} = {value:g}; needed is a voltage from {LOWEST_KV:g} to {HIGHEST_KV:g} kV: "
                "V and kV mixed up?"
            )


def check_place(name: str, low_kv: float, place_v: float | None) -> None:
    """Refuse a transformer whose low side stands at quite another voltage than its own."""
    if place_v is not None and not 1.0 / MISMATCH < place_v / (low_kv * 1e3) < MISMATCH:
        raise GridError(
            f"{name}: vn_lv_kv = {low_kv:g}, and it stands where the voltage is {place_v / 1e3:g} kV (voltage_kv at "
            "the top is in kV, line to line, at the PCC)"
        )


def check_device(name: str, voltage_kv: float | None, rated_v: float | None) -> None:
    """Refuse a grid whose voltage at the PCC is quite another than the device's rated one (V, line to line)."""
    if voltage_kv and rated_v and not 1.0 / MISMATCH < voltage_kv * 1e3 / rated_v < MISMATCH:
        raise GridError(
            f"{name}: voltage_kv = {voltage_kv:g} at the PCC, and the device of the table is rated {rated_v / 1e3:g} "
            "kV, line to line: V and kV mixed up, or a transformer left out?"
        )


def levels_of(elements: Sequence[Element], voltage_kv: float | None, pcc: str, source: str) -> dict[str, float]:
    """Voltage (V) of every node that can be told: that of the PCC, handed on through lines and transformers."""
    levels = {pcc: voltage_kv * 1e3} if voltage_kv else {}
    _hand_on(elements, levels, source)
    for element in elements:  # a transformer tells its sides, where nothing else does
        if element.kind == "transformer":
            check_place(element.name, element.values["vn_lv_kv"], levels.get(element.a))
            levels.setdefault(element.a, element.values["vn_lv_kv"] * 1e3)
            levels.setdefault(element.b, element.values["vn_hv_kv"] * 1e3)
            _hand_on(elements, levels, source)
    return levels


def _hand_on(elements: Sequence[Element], levels: dict[str, float], source: str) -> None:
    """Give both ends of what is no transformer one voltage, where one of them is known."""
    series = [element for element in elements if element.kind != "transformer" and element.b != GROUND]
    for _ in series:
        for element in series:
            known = [levels[node] for node in (element.a, element.b) if node in levels and node != source]
            for node in (element.a, element.b):
                if known and node != source:
                    levels.setdefault(node, known[0])
