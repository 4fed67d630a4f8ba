"""Where a device may be operated, and the one refusal of what lies outside."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from .errors import SeqsweepError

SLACK = 1e-9
"""A limit that was computed is met to this part of it: 0.9 pu times 690 V, and back."""


class Asked(NamedTuple):
    """One quantity of an operating point: what was asked, its limits in the same unit, and the unit it is told in."""

    name: str
    value: float
    limits: tuple[float, float]
    unit: float
    symbol: str


def is_within(value: float, limits: tuple[float, float]) -> bool:
    """Whether ``value`` lies between the limits, a little slack allowed; NaN lies nowhere."""
    low, high = limits
    return low - SLACK * abs(low) <= value <= high + SLACK * abs(high)


def refuse_outside(plant_id: str, asked: Iterable[Asked]) -> None:
    """Refuse the first quantity outside its limits.

    Raises
    ------
    SeqsweepError
        With what was asked and what the plant takes.
    """
    for name, value, (low, high), unit, symbol in asked:
        if not is_within(value, (low, high)):
            raise SeqsweepError(
                f"{name} of {value / unit:g} {symbol} is outside the range of {plant_id}: "
                f"{low / unit:g} to {high / unit:g} {symbol}"
            )
