"""Units of voltages and currents: as files write them, as the user says them, and whether they can be true."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from ..errors import SeqsweepError
from ..space_vectors import LINE_RMS
from .sequences import Kind

_PREFIXES = {"": 1.0, "k": 1e3, "m": 1e-3, "M": 1e6, "u": 1e-6, "µ": 1e-6, "μ": 1e-6}
_WORDS = {"kilo": "k", "milli": "m", "mega": "M", "micro": "u"}
_UNIT = re.compile(r"(?P<prefix>kilo|milli|mega|micro|[kmMuµμK]?)(?P<unit>v|volts?|a|amps?|amperes?)", re.IGNORECASE)

PER_UNIT = ("pu", "p.u.")
SAYS_NOTHING = ("", "1", "-", "?", "none", "n/a")

FACTOR = 10.0
"""A size this far from its rating is not believed."""

LOW_V = 10.0
"""A line-to-line voltage below this (V RMS), in no unit at all, is in kV or per unit, most likely."""


def unit_of(text: str) -> tuple[Kind, float] | None:
    """Quantity of a unit and its factor to V or A; None where it is no unit of either. Capitals tell mV from MV."""
    found = _UNIT.fullmatch(re.sub(r"[\s_]*(rms|eff|peak|inst)\.?$", "", text.strip(), flags=re.IGNORECASE))
    if found is None:
        return None
    prefix = _WORDS.get(found["prefix"].lower(), found["prefix"])
    kind: Kind = "voltage" if found["unit"][0] in "vV" else "current"
    return kind, _PREFIXES["k" if prefix == "K" else prefix]


def is_per_unit(text: str) -> bool:
    """Whether a unit is that of per unit."""
    return text.strip().lower() in PER_UNIT


def says_nothing(text: str) -> bool:
    """Whether a unit is none."""
    return text.strip().lower() in SAYS_NOTHING


class Size(NamedTuple):
    """How large a quantity is: phase peak (V or A), V or A per unit of its file, and whether anybody told that unit."""

    value: float
    factor: float
    stated: bool


def in_the_way(kind: Kind, size: Size, rated: float | None) -> str:
    """What speaks against a unit, in words; empty where nothing does. ``rated`` is the rated phase peak (V or A).

    A current far below its rating is a device at rest, if its unit was told.
    """
    letter = "V" if kind == "voltage" else "A"
    option = f"--{kind}-unit"
    if rated is None:
        line_v = size.value * LINE_RMS
        if kind == "current" or size.stated or line_v >= LOW_V:
            return ""
        return (
            f"the voltage has no unit and a size of {line_v:.4g}, line to line: in kV, or per unit? Say it with "
            f"{option} kV, or pu, or V if it is true"
        )
    ratio = size.value / rated
    low = kind == "voltage" or not size.stated
    if not (ratio > FACTOR or (low and ratio < 1.0 / FACTOR)):
        return ""
    source = "as its unit says" if size.stated else f"taken as {letter}, no unit is given"
    likely = _likely(letter, ratio / size.factor)
    return (
        f"the {kind} is {size.value:.4g} {letter} ({source}), {ratio:.3g} times its rating of {rated:.4g} {letter} "
        f"(phase peak){likely}: {option} says the unit, --rated-voltage-v and --rated-power-va the rating"
    )


def _likely(letter: str, ratio: float) -> str:
    """The unit in which numbers would be near their rating; ``ratio`` is theirs as V or A."""
    for name, factor in ((letter, 1.0), (f"k{letter}", 1e3), (f"m{letter}", 1e-3), (f"M{letter}", 1e6)):
        if 0.1 < ratio * factor < 3.0:
            return f"; its numbers as {name} would be {ratio * factor:.3g} times the rating"
    return ""


def parse_units(voltage: str | None, current: str | None) -> Mapping[str, str]:
    """Units that the user says, by quantity; `SeqsweepError` where one is none."""
    given: dict[str, str] = {}
    for kind, text in (("voltage", voltage), ("current", current)):
        if text is None:
            continue
        known = unit_of(text)
        if not is_per_unit(text) and (known is None or known[0] != kind):
            letter = "V" if kind == "voltage" else "A"
            raise SeqsweepError(f"--{kind}-unit {text!r}: known are {letter}, k{letter}, m{letter}, M{letter} and pu")
        given[kind] = text
    return given
