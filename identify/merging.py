"""Tables of one device as one: operating points side by side, bands of one operating point end to end.

What does not belong together is refused: another device, fundamental or base, one name for two operating points, one
frequency measured twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..plant.errors import SeqsweepError
from .comparison import one_fundamental
from .response import FrequencyResponse
from .table.read import Table

SAME = 1e-6
"""Frequencies closer than this, relatively, are one."""

_ONE_DEVICE = ("f1_hz", "plant", "power_meaning")
_BASES = ("rated_voltage_v", "rated_power_va")
_SET_POINTS = ("active_power_mw", "reactive_power_mvar", "terminal_voltage_pu", "grid")
_SECTIONS = ("plant", "source")


class MergeError(SeqsweepError):
    """Tables that are not of one device, or say two things of one point."""


def merged(tables: Sequence[Table], names: Sequence[str]) -> tuple[list[FrequencyResponse], dict[str, Any]]:
    """Responses and metadata of several tables as those of one.

    Parameters
    ----------
    tables : sequence of Table
        At least two.
    names : sequence of str
        What they are called in messages and in the metadata.

    Returns
    -------
    responses : list of FrequencyResponse
        One per operating point, in the order in which they first occur.
    meta : dict
        For `write_table`; ``merged_from`` names the tables with their hashes.

    Raises
    ------
    MergeError
        If they do not belong together.
    """
    if len(tables) < 2:
        raise MergeError("one table is given; merging takes at least two")
    for table, name in zip(tables[1:], names[1:], strict=True):
        _check_one_device(tables[0].meta, names[0], table.meta, name)
    parts: dict[str, list[tuple[str, FrequencyResponse]]] = {}
    for table, name in zip(tables, names, strict=True):
        for response in table.responses:
            one = replace(response, f1_hz=tables[0].meta["f1_hz"])
            parts.setdefault(str(response.meta["op_id"]), []).append((name, one))
    responses = [_joined(each) for each in parts.values()]
    _check_counts(responses)
    return responses, _meta(tables, names, responses)


def _check_one_device(a: Mapping[str, Any], name_a: str, b: Mapping[str, Any], name_b: str) -> None:
    same_f1 = one_fundamental(a["f1_hz"], b["f1_hz"])
    pairs = [(key, a.get(key), b.get(key)) for key in _ONE_DEVICE if not (key == "f1_hz" and same_f1)]
    pairs += [(key, a["bases"].get(key), b["bases"].get(key)) for key in _BASES]
    pairs += [(f"[{key}] of the campaign", _section(a, key), _section(b, key)) for key in _SECTIONS]
    for key, in_a, in_b in pairs:
        if in_a != in_b:
            raise MergeError(f"{name_a} and {name_b} are not of one device: {_difference(key, in_a, in_b)}")


_ABSENT = "not told"  # of a value that one table has and the other has not, be it null


def _difference(key: str, a: Any, b: Any) -> str:
    """What differs, down to the first value that does; of a plant its id before anything else."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        inner = next(k for k in ("id", *a, *b) if a.get(k, _ABSENT) != b.get(k, _ABSENT))
        return _difference(f"{key} {inner}", a.get(inner, _ABSENT), b.get(inner, _ABSENT))
    return f"{key} is {_short(a)} in the one and {_short(b)} in the other"


def _section(meta: Mapping[str, Any], key: str) -> Any:
    return (meta.get("configuration") or {}).get(key)


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def _joined(parts: Sequence[tuple[str, FrequencyResponse]]) -> FrequencyResponse:
    """The rows of one operating point from all tables that have it, by frequency."""
    name, first = parts[0]
    for other, response in parts[1:]:
        _check_one_point(name, first, other, response)
    if len(parts) == 1:
        return first
    responses = [response for _, response in parts]
    f = np.concatenate([response.f_hz for response in responses])
    order = np.argsort(f, kind="stable")
    twice = np.flatnonzero(np.diff(f[order]) <= SAME * np.abs(f[order][1:]))
    if len(twice):
        tables = " and ".join(name for name, _ in parts)
        raise MergeError(
            f"{first.meta['op_id']} has {f[order][twice[0]]:g} Hz in more than one of {tables}: which row is right is "
            "not for merging to say; seqsweep compare holds them against each other"
        )
    y, covariance, status, reason = (
        np.concatenate([np.asarray(getattr(response, key)) for response in responses])[order]
        for key in ("y", "covariance", "status", "reason")
    )
    known = {key for response in responses for key in response.quality}
    quality = {key: np.concatenate([_quality(r, key) for r in responses])[order] for key in sorted(known)}
    return replace(
        first,
        f_hz=f[order],
        y=y,
        covariance=covariance,
        status=status,
        reason=reason,
        quality=quality,
        meta=_facts(responses),
    )


def _quality(response: FrequencyResponse, key: str) -> np.ndarray:
    return np.asarray(response.quality.get(key, np.full(len(response), np.nan)), dtype=float)


def _check_one_point(name_a: str, a: FrequencyResponse, name_b: str, b: FrequencyResponse) -> None:
    for key in _SET_POINTS:
        if a.meta.get(key) != b.meta.get(key):
            raise MergeError(
                f"{a.meta['op_id']} is two operating points: {key} is {a.meta.get(key)} in {name_a} and "
                f"{b.meta.get(key)} in {name_b}; give one of them another id"
            )


def _facts(responses: Sequence[FrequencyResponse]) -> dict[str, Any]:
    """Facts of the first, with the proof of stability that says most; a certificate of one band says nothing of all."""
    meta = {key: value for key, value in responses[0].meta.items() if key != "interpolation"}
    proofs = [response.meta["stable_on"] for response in responses if response.meta.get("stable_on")]
    alike = [proof for proof in proofs if proof.get("grid") == proofs[0].get("grid")]
    if proofs:
        meta["stable_on"] = min(alike, key=lambda proof: proof.get("growth_bound_per_s") or float("inf"))
    return meta


def _check_counts(responses: Sequence[FrequencyResponse]) -> None:
    counts = {str(response.meta["op_id"]): len(response) for response in responses}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in list(counts.items())[:6])
        raise MergeError(
            f"a table has equally many rows for every operating point, these would have {listed}: sweep them at "
            "equally many frequencies, or merge those that agree"
        )


def _meta(tables: Sequence[Table], names: Sequence[str], responses: Sequence[FrequencyResponse]) -> dict[str, Any]:
    first = tables[0].meta
    keys = ("f1_hz", "bases", "power_meaning", "plant", "seeds")
    kept = {key: first[key] for key in keys if key in first}
    points = {str(point["op_id"]): point for table in reversed(tables) for point in table.meta["operating_points"]}
    sources = [{"table": name, "sha256": t.meta.get("sha256")} for name, t in zip(names, tables, strict=True)]
    return {
        **kept,
        "operating_points": [dict(points[str(response.meta["op_id"])]) for response in responses],
        "configuration": _configuration(tables),
        "merged_from": sources,
    }


def _configuration(tables: Sequence[Table]) -> dict[str, Any]:
    """The first campaign with the operating points of all: what sweeps the device again, such as ``tune --confirm``."""
    configurations = [table.meta.get("configuration") or {} for table in tables]
    merged = dict(configurations[0])
    points = [point for each in configurations for point in each.get("operating_point") or []]
    if points:
        merged["operating_point"] = list({str(point.get("id")): point for point in reversed(points)}.values())[::-1]
    return merged
