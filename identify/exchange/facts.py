"""Files of other tools: what they say, and what they leave open.

A file seldom says everything that decides a sign. What it does say are its *facts*; what it leaves
open the user gives; nothing is assumed, a fact that neither knows is an error that names the option.
Readers (`text`, `mat`, `touchstone`) turn a file into `Found`, in SI but
otherwise as it stands; `convert.to_table` is the one place where it becomes ours.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from math import isfinite, pi
from pathlib import Path
from typing import Any

import numpy as np

from ...plant.errors import SeqsweepError

MAX_BYTES = 128 * 2**20
"""Largest file, and largest content of a compressed one, that is read."""

MAX_TEXT = 1000
"""Longest text of a cell: arrays of texts are as wide as their longest."""

OPTIONS = {
    "frame": "--frame pn|dq",
    "direction": "--direction load|generator",
    "f1_hz": "--f1 HZ",
    "quantity": "--quantity admittance|impedance",
    "unit": "--unit S|mS|ohm|pu|...",
    "phase_unit": "--phase-unit deg|rad",
    "frequency_unit": "--frequency-unit Hz|kHz|rad/s",
    "q_axis": "--q-axis leading|lagging",
    "rated_voltage_v": "--rated-voltage-v V",
    "rated_power_va": "--rated-power-va VA",
}
"""Facts and the options that give them."""

WORDS = {
    "frame": ("pn", "dq"),
    "direction": ("load", "generator"),
    "quantity": ("admittance", "impedance"),
    "phase_unit": ("deg", "rad"),
    "q_axis": ("leading", "lagging"),
}

FREQUENCY_UNITS = {"Hz": 1.0, "kHz": 1e3, "rad/s": 1.0 / (2.0 * pi)}

UNITS = {
    "admittance": {"S": 1.0, "mS": 1e-3, "uS": 1e-6, "kS": 1e3, "1/ohm": 1.0},
    "impedance": {"ohm": 1.0, "mohm": 1e-3, "kohm": 1e3},
}

TABLE_FACTS = ("frame", "direction", "f1_hz", "quantity", "rated_voltage_v", "rated_power_va")
"""Facts without which there is no table."""

SET_POINT = ("active_power_mw", "reactive_power_mvar", "terminal_voltage_pu")
"""What an operating point is given by, as far as it is known."""

Facts = Mapping[str, Any]


class ExchangeError(SeqsweepError):
    """A file that cannot become a table, or a response that a format cannot hold; one line, whatever the file holds."""

    def __init__(self, text: str):
        super().__init__(" ".join(text.split()))


@dataclass(frozen=True, slots=True)
class Sheet:
    """One operating point as a file has it: SI and load or generator direction, pn or dq, Y or Z.

    Attributes
    ----------
    f_hz : (n,) float
        Frequency in the file's frame (Hz).
    matrix : (n, 2, 2) complex
        S or ohm; NaN where the file has a failed row.
    point : mapping
        ``op_id``, `SET_POINT` and ``parameters`` as far as they are known.
    status, reason : (n,) str or None
        As in the table; None where the file knows no such thing: all "ok".
    quality : mapping of str to (n,) float
        Quality columns of the table.
    """

    f_hz: np.ndarray
    matrix: np.ndarray
    point: Mapping[str, Any] = field(default_factory=dict)
    status: np.ndarray | None = None
    reason: np.ndarray | None = None
    quality: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Found:
    """What a reader found: the sheets, and the facts that file and user know together."""

    sheets: tuple[Sheet, ...]
    facts: Facts


# Facts


def agreed(said: Facts, given: Facts, path: str | Path) -> dict[str, Any]:
    """Facts of the file and of the user in one; None is not known.

    Raises
    ------
    ExchangeError
        If the two contradict each other, or a fact has a value that it cannot have.
    """
    known = {key: value for key, value in said.items() if value is not None}
    for key, value in given.items():
        if value is None:
            continue
        if key in OPTIONS and key in known and known[key] != value:
            raise ExchangeError(f"{path} says {key} = {known[key]}; that contradicts {_option(key)} {value}")
        known[key] = value
    for key in ("unit", "frequency_unit"):
        if not isinstance(known.get(key, ""), str):
            raise ExchangeError(f"{path}: {key} is {known[key]!r}; needed: a text ({OPTIONS[key]})")
    for key, words in WORDS.items():
        if key in known and known[key] not in words:
            raise ExchangeError(f"{path}: {key} is {known[key]!r}; needed: {' or '.join(words)} ({OPTIONS[key]})")
    for key in ("f1_hz", "rated_voltage_v", "rated_power_va"):
        if key in known and not (isinstance(known[key], int | float) and known[key] > 0.0 and isfinite(known[key])):
            raise ExchangeError(f"{path}: {key} is {known[key]!r}; needed: a number above 0 ({OPTIONS[key]})")
    return known


def need(facts: Facts, key: str, path: str | Path) -> Any:
    """A fact that something depends on; the error names the option that gives it."""
    if key not in facts:
        raise ExchangeError(f"{path} does not say its {key}: give {OPTIONS[key]}")
    return facts[key]


def need_all(facts: Facts, keys: Collection[str], path: str | Path) -> None:
    """Facts that something depends on, all at once: the error names every option that is missing."""
    missing = [key for key in OPTIONS if key in keys and key not in facts]
    if missing:
        options = ", ".join(OPTIONS[key] for key in missing)
        raise ExchangeError(f"{path} does not say its {', '.join(missing)}: give {options}")


def facts_of(comments: Sequence[str]) -> dict[str, Any]:
    """Facts in ``key: JSON`` comments; any other comment is for people."""
    facts: dict[str, Any] = {}
    for comment in comments:
        key, colon, value = comment.partition(":")
        try:
            parsed = json.loads(value) if colon else None
        except (ValueError, RecursionError):
            continue
        if parsed is not None and re.fullmatch(r"\w+", key):
            facts[key] = parsed
    return facts


def points_of(facts: Facts) -> list[dict[str, Any]]:
    """Operating points among such facts."""
    points = facts.get("operating_points")
    return [point for point in points if isinstance(point, dict)] if isinstance(points, list) else []


def _option(key: str) -> str:
    return OPTIONS[key].partition(" ")[0]


def frequency_factor(unit: str, path: str | Path) -> float:
    """Hz per unit of frequency."""
    if unit not in FREQUENCY_UNITS:
        raise ExchangeError(f"{path}: frequency unit {unit!r}; known are {', '.join(FREQUENCY_UNITS)}")
    return FREQUENCY_UNITS[unit]


def unit_factor(unit: str, facts: Facts, path: str | Path) -> float:
    """S or ohm per unit; which of the two follows from the file's quantity."""
    quantity = need(facts, "quantity", path)
    if unit == "pu":
        base_s = need(facts, "rated_power_va", path) / need(facts, "rated_voltage_v", path) ** 2
        return float(base_s if quantity == "admittance" else 1.0 / base_s)
    if unit not in UNITS[quantity]:
        known = ", ".join([*UNITS[quantity], "pu"])
        raise ExchangeError(f"{path}: unit {unit!r} of an {quantity}; known are {known}")
    return UNITS[quantity][unit]


# Files


def check_file(path: str | Path) -> Path:
    """A readable file of bearable size.

    Raises
    ------
    ExchangeError
        If there is none, or it is larger than `MAX_BYTES`.
    """
    path = Path(path)
    if not path.exists():
        raise ExchangeError(f"{path}: no such file")
    if not path.is_file():
        raise ExchangeError(f"{path}: not a file")
    if (size := path.stat().st_size) > MAX_BYTES:
        raise ExchangeError(f"{path} has {size / 2**20:.0f} MiB; at most {MAX_BYTES / 2**20:.0f} MiB are read")
    if size == 0:
        raise ExchangeError(f"{path} is empty")
    return path


def extra(module: str, distribution: str) -> Any:
    """A module of the extra "exchange", imported when it is needed."""
    try:
        return import_module(module)
    except ImportError:
        raise ExchangeError(f"{distribution} is not installed: pip install 'seqsweep[exchange]'") from None


def texts(values: Sequence[str], path: str | Path) -> np.ndarray:
    """Texts (n,) of a file, none longer than `MAX_TEXT`."""
    if any(len(value) > MAX_TEXT for value in values):
        raise ExchangeError(f"{path}: a text of more than {MAX_TEXT} characters in a cell")
    return np.array(values, dtype=str)


def file_digest(path: str | Path) -> str:
    """sha256 (hexadecimal) of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
