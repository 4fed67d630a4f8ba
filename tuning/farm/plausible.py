"""Numbers that no equipment has: a unit that is off by a thousand is told before it makes a wrong verdict."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from .entries import FarmError


class Range(NamedTuple):
    """What a key may be, and which units may have been taken for which beyond either end."""

    low: float
    high: float
    unit: str
    below: str
    above: str


RANGES = {
    "voltage_kv": Range(0.05, 1500.0, "kV", "MV for kV", "V for kV"),
    "length_km": Range(1e-3, 2000.0, "km", "megametres for km", "m for km"),
    "r_ohm_per_km": Range(1e-4, 60.0, "ohm/km", "ohm/m for ohm/km", "mohm/km for ohm/km"),
    "x_ohm_per_km": Range(5e-3, 3.0, "ohm/km", "ohm/m for ohm/km", "mohm/km for ohm/km"),
    "l_mh_per_km": Range(0.02, 10.0, "mH/km", "H/km for mH/km", "uH/km for mH/km"),
    "c_nf_per_km": Range(0.5, 2e4, "nF/km", "uF/km for nF/km", "pF/km for nF/km"),
    "vk_percent": Range(0.5, 60.0, "per cent", "per unit for per cent", "the ohmic value for per cent"),
}
"""Wide of everything that is built, and narrower than a factor of a thousand either way."""

_CURRENT_A = Range(2.0, 2e5, "A", "GVA for MVA", "kVA for MVA")


def check_size(name: str, key: str, value: object) -> None:
    """Refuse a number that no equipment has; zero, and what has no range, passes."""
    if key in RANGES and isinstance(value, int | float) and value != 0.0:
        _check(name, f"{key} = {value:g}", float(value), RANGES[key])


def check_transformer(name: str, sn_mva: float, vn_lv_kv: float) -> None:
    """Refuse a rating whose current on the low side no transformer carries."""
    current = sn_mva * 1e3 / (sqrt(3.0) * vn_lv_kv)
    _check(name, f"sn_mva = {sn_mva:g} at {vn_lv_kv:g} kV is {current:.3g} A", current, _CURRENT_A)


def _check(name: str, text: str, value: float, known: Range) -> None:
    if known.low <= value <= known.high:
        return
    mixed = known.below if value < known.low else known.above
    raise FarmError(f"{name}: {text}; equipment has {known.low:g} to {known.high:g} {known.unit}: {mixed}?")
