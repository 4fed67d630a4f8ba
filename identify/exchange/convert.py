"""From what a reader found to a table, and from a table to what a writer takes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..frames import dq_to_pn, pn_to_dq, to_frame
from ..operating_state import stated
from ..response import Frame, FrequencyResponse
from ..table.format import CARRIED, TableError, complete_metadata
from ..table.rules import metadata_violations, row_violations
from ..table.write import rows_of
from .facts import OPTIONS, SET_POINT, TABLE_FACTS, ExchangeError, Facts, Found, Sheet, file_digest, need_all

MIRRORED = 1e-2
"""Part of Y by which a row and that of its mirror may differ."""

NEAR_F1_HZ, ABOUT_F1_HZ, FEWEST = 20.0, 100.0, 6
"""Rows that tell the limit of Ydd at f1: the nearest one, the farthest, their number."""

CONSTANT_POWER = 0.3
"""How near -1 Ydd V^2 / P must be to mean the other direction."""

# In


def to_table(found: Found, path: str | Path) -> tuple[list[FrequencyResponse], dict[str, Any]]:
    """Responses in the pn frame, load direction, and the metadata that `write_table` completes.

    Raises
    ------
    ExchangeError
        If a fact is missing, or the frequencies or values cannot stand in a table.
    """
    facts = found.facts
    need_all(facts, TABLE_FACTS, path)
    f1_hz = float(facts["f1_hz"])
    points = [_point(sheet, facts, number, len(found.sheets)) for number, sheet in enumerate(found.sheets)]
    with np.errstate(all="ignore"):  # what overflows is found when the rows are checked
        responses = [_response(sheet, point, facts, path) for sheet, point in zip(found.sheets, points, strict=True)]
    bases = {key: float(facts[key]) for key in ("rated_voltage_v", "rated_power_va")}
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
    violations = metadata_violations(complete_metadata(meta)) or row_violations(rows_of(responses), meta)
    if violations:
        raise ExchangeError(f"{path}: {violations[0]}")
    return responses, meta


def _point(sheet: Sheet, facts: Facts, number: int, n_sheets: int) -> dict[str, Any]:
    """Metadata of an operating point; what nobody knows is null, and a single one may be named by the user."""
    given = {key: facts.get(key) for key in ("op_id", *SET_POINT)}
    said = {key: sheet.point.get(key) for key in given}
    known = {key: sheet.point[key] for key in (*CARRIED, "parameters") if key in sheet.point}
    if facts.get("stable_on") is not None:
        known["stable_on"] = stated(facts["stable_on"])
    if n_sheets == 1:
        said.update({key: value for key, value in given.items() if value is not None})
    elif any(value is not None for value in given.values()):
        raise ExchangeError(
            "the file holds several operating points; their names and values are its own: leave them out"
        )
    if said["reactive_power_mvar"] is None:  # optional in the metadata, where the others are null
        del said["reactive_power_mvar"]
    return {**said, **known, "op_id": str(said["op_id"] or f"imported{number if n_sheets > 1 else ''}")}


def _response(sheet: Sheet, point: dict[str, Any], facts: Facts, path: str | Path) -> FrequencyResponse:
    where = f"{path}: {point['op_id']}"
    frame: Frame = facts["frame"]
    f1_hz = float(facts["f1_hz"])
    _check_values(sheet, where)
    y = _admittance(sheet.matrix, facts, path, where)
    if facts["direction"] == "generator":
        y = -y
    if frame == "dq" and facts.get("q_axis", "leading") == "lagging":
        y = y * np.array([[1.0, -1.0], [-1.0, 1.0]])
    _check_ascending(sheet.f_hz, where)
    f_hz = sheet.f_hz
    if frame == "dq":
        f_hz, y = f_hz + f1_hz, dq_to_pn(y)
    if sheet.status is None:
        f_hz, y = one_sided(f_hz, y, f1_hz, where)
    _check_frequencies(f_hz, frame, f1_hz, where)
    _check_direction(f_hz, y, point, facts, where)
    try:
        return FrequencyResponse(
            f_hz=f_hz,
            y=y,
            f1_hz=f1_hz,
            frame="pn",
            status=sheet.status,
            reason=sheet.reason,
            quality=sheet.quality,
            meta={"op_id": point["op_id"]},
        )
    except ValueError as error:
        raise ExchangeError(f"{where}: {error}") from None


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
    if facts["quantity"] == "admittance":
        return matrix
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise ExchangeError(f"{where}: an impedance matrix is singular: it has no admittance") from None


def _check_ascending(f_hz: np.ndarray, where: str) -> None:
    steps = np.diff(f_hz)
    if np.any(steps == 0.0):
        raise ExchangeError(f"{where}: {f_hz[1:][steps == 0.0][0]:g} Hz is there twice")
    if np.any(steps < 0.0):
        k = int(np.argmax(steps < 0.0))
        raise ExchangeError(f"{where}: {f_hz[k + 1]:g} Hz follows {f_hz[k]:g} Hz; needed: ascending frequencies")


def one_sided(f_hz: np.ndarray, y: np.ndarray, f1_hz: float, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies above 0 (Hz) and admittances (n, 2, 2) in the pn frame; what lies below 0 stands at its mirror.

    A real device has ``Y(2 f1 - f) = P conj(Y(f)) P`` with ``P = [[0, 1], [1, 0]]``: the second row and column of the
    matrix at f are the first ones at the mirror.

    Raises
    ------
    ExchangeError
        If a row below 0 and one at its mirror contradict each other.
    """
    below = f_hz < 0.0
    if not np.any(below):
        return f_hz, y
    mirrors, turned = 2.0 * f1_hz - f_hz[below], np.conj(y[below])[:, ::-1, ::-1]
    own = f_hz[~below]
    new = np.ones(len(mirrors), dtype=bool)
    for k, mirror in enumerate(mirrors):
        twins = np.flatnonzero(np.abs(own - mirror) <= 1e-9 * mirror)
        for twin in twins:
            new[k] = False
            other = y[~below][twin]
            part = np.linalg.norm(turned[k] - other) / np.linalg.norm(other)
            if not part <= MIRRORED:
                raise ExchangeError(
                    f"{where}: the rows of {f_hz[below][k]:g} Hz and of its mirror {mirror:g} Hz contradict each "
                    f"other, by {part:.2g} of Y: a two-sided table in the pn frame has Y(2 f1 - f) = P conj(Y(f)) P; "
                    "remove the rows below 0 Hz if they mean something else"
                )
    f_all, y_all = np.concatenate([own, mirrors[new]]), np.concatenate([y[~below], turned[new]])
    order = np.argsort(f_all)
    return f_all[order], y_all[order]


def _check_frequencies(f_hz: np.ndarray, frame: Frame, f1_hz: float, where: str) -> None:
    """Refuse what the table has no row for; ``f_hz`` in the pn frame."""
    also = f" ({frame} frame: {f_hz[0] - f1_hz:g} Hz)" if frame == "dq" else ""
    if f_hz[0] <= 0.0:
        raise ExchangeError(f"{where}: {f_hz[0]:g} Hz in the pn frame{also}; a table holds frequencies above 0")
    at_f1 = np.abs(f_hz - f1_hz) <= 1e-9 * f1_hz
    if np.any(at_f1):
        row = f"0 Hz in the dq frame is f1 = {f1_hz:g} Hz itself" if frame == "dq" else f"{f1_hz:g} Hz is f1 itself"
        raise ExchangeError(f"{where}: {row}, where there is no admittance: remove the row")


def _check_direction(f_hz: np.ndarray, y: np.ndarray, point: Mapping[str, Any], facts: Facts, where: str) -> None:
    """Refuse a direction that the known power contradicts.

    A generator that holds its power has Ydd = P / V^2 where f goes to f1 (dq frame, into the device): more voltage,
    less current. The negative of that is a generator with the current counted the other way.
    """
    power_w, voltage_pu = (_known(point.get(key)) for key in ("active_power_mw", "terminal_voltage_pu"))
    power_w *= 1e6
    limit = _dc_limit(f_hz - float(facts["f1_hz"]), pn_to_dq(y)[:, 0, 0]) if power_w > 0.0 else None
    if limit is None:
        return
    voltage_v = float(facts["rated_voltage_v"]) * (voltage_pu or 1.0)
    seen = limit * voltage_v**2 / power_w
    if abs(seen + 1.0) < CONSTANT_POWER:
        other = {"load": "generator", "generator": "load"}[facts["direction"]]
        raise ExchangeError(
            f"{where}: towards f1 Ydd goes to {seen.real:.3g} P / V^2 when the current counts as --direction "
            f"{facts['direction']} says; a generator of {power_w / 1e6:g} MW that holds its power has +1: --direction "
            f"{other}, most likely (or leave --active-power-mw out)"
        )


def _dc_limit(f_hz: np.ndarray, ydd: np.ndarray) -> complex | None:
    """Ydd at 0 Hz (dq frame) by rational functions of two tolerances that agree; None where they do not.

    A real device has Ydd(-f) = conj(Ydd(f)): 0 Hz lies within the data, not outside.
    """
    from scipy.interpolate import AAA

    near = (np.abs(f_hz) <= ABOUT_F1_HZ) & np.isfinite(ydd)
    if np.count_nonzero(near) < FEWEST or np.min(np.abs(f_hz)) > NEAR_F1_HZ:
        return None
    f_all = np.concatenate([f_hz[near], -f_hz[near]])
    y_all = np.concatenate([ydd[near], np.conj(ydd[near])])
    f_all, first = np.unique(np.round(f_all, 9), return_index=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [complex(AAA(1j * f_all, y_all[first], rtol=rtol)(0.0)) for rtol in (1e-2, 1e-4)]
    agree = abs(found[0] - found[1]) < 0.5 * CONSTANT_POWER * abs(found[1])
    return found[1] if agree else None


def _known(value: Any) -> float:
    """A number of the metadata; 0 where it is not known, or is none."""
    return float(value) if isinstance(value, int | float) else 0.0


# Out


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
