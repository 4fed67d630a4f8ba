"""Responses from and for other tools: what a file says, what it leaves open, and the table that follows.

A file seldom says everything that decides a sign. What it does say are its *facts*; what it leaves
open the user gives; nothing is assumed, a fact that neither knows is an error that names the option.
Readers (`exchange_csv`, `exchange_mat`, `exchange_touchstone`) turn a file into `Found`, in SI but
otherwise as it stands; `to_table` is the one place where it becomes ours.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from math import isfinite, pi
from pathlib import Path
from typing import Any

import numpy as np

from .frames import to_frame
from .response import Frame, FrequencyResponse
from .table import TableError, canonical_json, rows_of
from .table_rules import row_violations

MAX_BYTES = 512 * 2**20
"""Largest file, and largest content of a compressed one, that is read."""

OPTIONS = {
    "frame": "--frame pn|dq",
    "direction": "--direction load|generator",
    "f1_hz": "--f1 HZ",
    "quantity": "--quantity admittance|impedance",
    "unit": "--unit S|mS|ohm|pu|...",
    "phase_unit": "--phase-unit deg|rad",
    "frequency_unit": "--frequency-unit Hz|kHz|rad/s",
    "q_axis": "--q-axis leading|lagging",
    "rated_voltage_v": "--rated-voltage V",
    "rated_power_va": "--rated-power VA",
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

Facts = Mapping[str, Any]


class ExchangeError(ValueError):
    """A file that cannot become a table, or a response that a format cannot hold."""


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
        ``op_id``, ``active_power_mw``, ``terminal_voltage_pu`` as far as they are known.
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
            raise ExchangeError(f"{path} says {key} = {known[key]}, {_option(key)} says {value}; leave the option out")
        known[key] = value
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


# From what was found to a table


def to_table(found: Found, path: str | Path) -> tuple[list[FrequencyResponse], dict[str, Any]]:
    """Responses in the pn frame, load direction, and the metadata that `write_table` completes.

    Raises
    ------
    ExchangeError
        If a fact is missing, or the frequencies or values cannot stand in a table.
    """
    facts = found.facts
    f1_hz = float(need(facts, "f1_hz", path))
    points = [_point(sheet, facts, number, len(found.sheets)) for number, sheet in enumerate(found.sheets)]
    responses = [_response(sheet, point, facts, path) for sheet, point in zip(found.sheets, points, strict=True)]
    bases = {key: float(need(facts, key, path)) for key in ("rated_voltage_v", "rated_power_va")}
    digest = file_digest(path)
    read_as = {key: facts[key] for key in OPTIONS if key in facts and key not in bases}
    meta = {
        "f1_hz": f1_hz,
        "bases": bases,
        "power_meaning": str(facts.get("power_meaning") or "not known: imported"),
        "operating_points": points,
        "configuration": {"imported": {"file": Path(path).name, "sha256": digest, "read_as": read_as}},
        "plant": {"id": "imported", "sha256": digest},
    }
    canonical_json(meta)
    if violations := row_violations(rows_of(responses), meta):
        raise ExchangeError(f"{path}: {violations[0]}")
    return responses, meta


def _point(sheet: Sheet, facts: Facts, number: int, n_sheets: int) -> dict[str, Any]:
    """Metadata of an operating point; what nobody knows is null, and a single one may be named by the user."""
    given = {key: facts.get(key) for key in ("op_id", "active_power_mw", "terminal_voltage_pu")}
    said = {key: sheet.point.get(key) for key in given}
    if n_sheets == 1:
        said.update({key: value for key, value in given.items() if value is not None})
    elif any(value is not None for value in given.values()):
        raise ExchangeError(
            "the file holds several operating points; their names and values are its own: leave them out"
        )
    return {**said, "op_id": str(said["op_id"] or f"imported{number if n_sheets > 1 else ''}")}


def _response(sheet: Sheet, point: dict[str, Any], facts: Facts, path: str | Path) -> FrequencyResponse:
    where = f"{path}: {point['op_id']}"
    frame: Frame = need(facts, "frame", path)
    f1_hz = float(facts["f1_hz"])
    _check_values(sheet, where)
    y = _admittance(sheet.matrix, facts, path, where)
    if need(facts, "direction", path) == "generator":
        y = -y
    if frame == "dq" and facts.get("q_axis", "leading") == "lagging":
        y = y * np.array([[1.0, -1.0], [-1.0, 1.0]])
    _check_frequencies(sheet.f_hz, frame, f1_hz, where)
    try:
        response = FrequencyResponse(
            f_hz=sheet.f_hz,
            y=y,
            f1_hz=f1_hz,
            frame=frame,
            status=sheet.status,
            reason=sheet.reason,
            quality=sheet.quality,
            meta={"op_id": point["op_id"]},
        )
    except ValueError as error:
        raise ExchangeError(f"{where}: {error}") from None
    return to_frame(response, "pn")


def _check_values(sheet: Sheet, where: str) -> None:
    """Refuse what is not finite where no status explains it."""
    if not len(sheet.f_hz):
        raise ExchangeError(f"{where}: no rows")
    strange = ~np.isfinite(sheet.f_hz)
    if np.any(strange):
        raise ExchangeError(f"{where}: the frequency of row {np.argmax(strange) + 1} is not a finite number")
    ok = np.full(len(sheet.f_hz), True) if sheet.status is None else sheet.status == "ok"
    bad = ok & ~np.all(np.isfinite(sheet.matrix), axis=(1, 2))
    if np.any(bad):
        raise ExchangeError(
            f"{where}: {np.count_nonzero(bad)} rows hold NaN or infinity, the first at "
            f"{sheet.f_hz[np.argmax(bad)]:g} Hz: remove them, or give them a status and a reason in columns so named"
        )


def _admittance(matrix: np.ndarray, facts: Facts, path: str | Path, where: str) -> np.ndarray:
    if need(facts, "quantity", path) == "admittance":
        return matrix
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise ExchangeError(f"{where}: an impedance matrix is singular: it has no admittance") from None


def _check_frequencies(f_hz: np.ndarray, frame: Frame, f1_hz: float, where: str) -> None:
    """Refuse what the table has no row for."""
    steps = np.diff(f_hz)
    if np.any(steps == 0.0):
        raise ExchangeError(f"{where}: {f_hz[1:][steps == 0.0][0]:g} Hz is there twice")
    if np.any(steps < 0.0):
        k = int(np.argmax(steps < 0.0))
        raise ExchangeError(f"{where}: {f_hz[k + 1]:g} Hz follows {f_hz[k]:g} Hz; needed: ascending frequencies")
    f_pn = f_hz + f1_hz if frame == "dq" else f_hz
    also = f" ({frame} frame: {f_hz[0]:g} Hz)" if frame == "dq" else ""
    if f_pn[0] <= 0.0:
        raise ExchangeError(f"{where}: {f_pn[0]:g} Hz in the pn frame{also}; a table holds frequencies above 0")
    at_f1 = np.abs(f_pn - f1_hz) <= 1e-9 * f1_hz
    if np.any(at_f1):
        row = f"0 Hz in the dq frame is f1 = {f1_hz:g} Hz itself" if frame == "dq" else f"{f1_hz:g} Hz is f1 itself"
        raise ExchangeError(f"{where}: {row}, where there is no admittance: remove the row")


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


def file_digest(path: str | Path) -> str:
    """sha256 (hexadecimal) of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# From a table to a file


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Responses on their way out, all in one frame, and the metadata of their table."""

    responses: tuple[FrequencyResponse, ...]
    meta: Mapping[str, Any]

    @property
    def frame(self) -> Frame:
        """Frame of all of them."""
        return self.responses[0].frame

    @property
    def facts(self) -> dict[str, Any]:
        """What a reader needs to know, under the names of `OPTIONS`."""
        bases = self.meta["bases"]
        facts = {
            "frame": self.frame,
            "direction": "load",
            "f1_hz": self.meta["f1_hz"],
            "quantity": "admittance",
            "unit": "S",
            "frequency_unit": "Hz",
            "rated_voltage_v": bases["rated_voltage_v"],
            "rated_power_va": bases["rated_power_va"],
            "power_meaning": self.meta["power_meaning"],
        }
        return {**facts, "q_axis": "leading"} if self.frame == "dq" else facts

    def point(self, op_id: str) -> dict[str, Any]:
        """What the metadata says of an operating point."""
        return next(dict(point) for point in self.meta["operating_points"] if point["op_id"] == op_id)


def outgoing(responses: Sequence[FrequencyResponse], meta: Mapping[str, Any], frame: Frame) -> Outgoing:
    """Responses of a table in ``frame``."""
    return Outgoing(tuple(to_frame(response, frame) for response in responses), meta)


def the_one(out: Outgoing, kind: str) -> FrequencyResponse:
    """The response, for a format that holds a single one."""
    if len(out.responses) > 1:
        names = ", ".join(str(response.meta["op_id"]) for response in out.responses)
        raise TableError(f"{kind} holds one operating point; choose with --op ID: {names}")
    return out.responses[0]
