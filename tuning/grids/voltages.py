"""Voltages of transformers that cannot be meant: V were taken for kV, or two numbers contradict each other."""

from __future__ import annotations

from collections.abc import Mapping

from .errors import GridError

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
