"""Units that an FMU declares for its variables, as factors to V, A and W."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Literal

from .variables import Contents, FmuError

Quantity = Literal["voltage", "current", "power"]

_LETTERS = {"voltage": "V", "current": "A", "power": "W"}
_DIMENSIONS = {"voltage": (1, 2, -3, -1), "current": (0, 0, 0, 1), "power": (1, 2, -3, 0)}
"""Exponents of kg, m, s, A."""

_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "m": 1e-3, "u": 1e-6, "µ": 1e-6}


def scale_of(contents: Contents, key: str, quantity: Quantity, variables: Sequence[Any], given: float | None) -> float:
    """V, A or W that 1 of the variables means: as ``given``, else as they declare, else 1.

    Raises
    ------
    FmuError
        If they declare different units, or one that is no unit of the quantity.
    """
    if given is not None:
        return given
    letter = _LETTERS[quantity]
    option = f"{'active_power' if quantity == 'power' else quantity}_unit_{letter.lower()}"
    units = sorted({unit for variable in variables if (unit := _declared(variable))})
    if not units:
        return 1.0
    if len(units) > 1:
        raise FmuError(f"{key}: its variables are in {' and '.join(units)}; needed: one unit, or {option}")
    factor = _by_definition(contents, units[0], quantity) or _by_name(units[0], letter)
    if factor is None:
        names = ", ".join(repr(variable.name) for variable in variables)
        raise FmuError(
            f"{key}: {names} of {contents.path} is in {units[0]!r}, which is no unit of a {quantity} known here: give "
            f"{option}, what 1 of it means in {letter}"
        )
    return factor


def _declared(variable: Any) -> str:
    """Unit of a variable, or of its declared type; empty where there is none."""
    own = getattr(variable, "unit", None) or getattr(variable.declaredType, "unit", None) or ""
    return str(own).strip()


def _by_definition(contents: Contents, unit: str, quantity: Quantity) -> float | None:
    """Factor by the description's own definition in base units."""
    for each in contents.description.unitDefinitions:
        base = each.baseUnit
        if each.name == unit and base is not None and (base.kg, base.m, base.s, base.A) == _DIMENSIONS[quantity]:
            return float(base.factor)
    return None


def _by_name(unit: str, letter: str) -> float | None:
    """Factor by the name of the unit."""
    found = re.fullmatch(rf"([kMGmuµ]?){letter}", unit)
    return _PREFIXES[found[1]] if found else None
