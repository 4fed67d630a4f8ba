"""The page: what the inputs say, in the order in which an engineer's chief reads it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import numpy as np

from ....identify.response import FrequencyResponse
from . import pictures
from .checklist import checked
from .inputs import Inputs

MOST = 40
"""Rows of a table that are shown at once; the rest is folded."""

_Z95 = 1.959963984540054


def page(inputs: Inputs, stamp: str = "") -> str:
    """The whole report as one HTML text; the same inputs give the same bytes.

    Parameters
    ----------
    inputs : Inputs
        The table and the results about it.
    stamp : str
        Date, user and host where they are wanted.
    """
    from jinja2 import Environment

    template = files(__package__).joinpath("report.html.j2").read_text("utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    environment.filters["num"] = number
    return environment.from_string(template).render(**_content(inputs), stamp=stamp, version=version("seqsweep"))


def _content(inputs: Inputs) -> dict[str, Any]:
    tuning = inputs.results.get("tuning")
    points = _worst_first(tuning["operating_points"]) if tuning else []
    verification = inputs.results.get("verification")
    return {
        "title": _title(inputs),
        "sentence": sentence(inputs, points),
        "foreign": inputs.foreign,
        "tuning": tuning,
        "grid": _grid(points),
        "points": points[:MOST],
        "folded_points": points[MOST:],
        "modes": [_modes_of(point) for point in points[:MOST]],
        "bode": pictures.admittance(inputs.table.responses),
        "modes_picture": pictures.modes(points) if points else "",
        "verification": verification,
        "time_picture": pictures.resonance_in_time(verification["runs"]) if verification else "",
        "bank": _bank(inputs.results.get("bank")),
        "farm": inputs.results.get("farm"),
        "metrics": inputs.results.get("metrics"),
        "swept": [_swept(response) for response in inputs.table.responses[:MOST]],
        "n_swept": len(inputs.table.responses),
        "not_ok": _not_ok(inputs.table.responses),
        "open": _undecided(inputs, points),
        "checklist": checked(inputs),
        "hashes": inputs.hashes,
        "meta": inputs.table.meta,
        "campaign": json.dumps(inputs.table.meta.get("configuration", {}), indent=1, sort_keys=True),
    }


def number(value: Any, digits: int = 4) -> str:
    """A number for people; a dash where there is none."""
    return "–" if value is None or value != value else f"{value:.{digits}g}"  # noqa: RUF001 (a dash is meant)


def sentence(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> str:
    """The whole answer in one sentence that needs no vocabulary."""
    device = inputs.table.meta.get("plant", {}).get("id", "The device")
    if not points:
        return f"{device}: this report holds the measured admittance; no verdict on a grid was asked for."
    counts = Counter(point["verdict"] for point in points)
    if len(points) == 1:
        return _sentence_of(device, points[0])
    parts = ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
    return f"{device}: of {len(points)} cases {parts}. The worst is {_sentence_of('', points[0])}"


def _sentence_of(device: str, point: Mapping[str, Any]) -> str:
    where = f"{device} at {point['op_id']}".strip() if device else str(point["op_id"])
    scale = "" if point["scale"] == 1.0 else f" at {point['scale']:g} times the grid impedance"
    text = f"{where}{scale}: {point['verdict']}"
    low_high = point.get("resonance_hz")
    if low_high:
        text += f", with a resonance at {low_high[0]:.3g} and {low_high[1]:.3g} Hz"
    if point.get("margin_m") is not None:
        met = "reached" if point.get("margin_met") else "not reached"
        text += f" and a margin of {point['margin_m']:.3g} (the required one is {met})"
    return f"{text}.{_with_k(point)}"


def _with_k(point: Mapping[str, Any]) -> str:
    """What `tune --confirm` measured with damping control in place, as a sentence; nothing where it was not asked."""
    confirmed, k, margin = (point.get(key) for key in ("with_k", "k", "margin_m_with_k"))
    if not confirmed or k is None:
        return ""
    reached = "" if margin is None else f", with a margin of {margin:.3g}"
    return f" Swept again with damping gain k = {k:.3g} in place: {confirmed['verdict']}{reached}."


def _title(inputs: Inputs) -> str:
    meta = inputs.table.meta
    name = meta.get("configuration", {}).get("campaign", {}).get("name")
    return " · ".join(str(part) for part in (meta.get("plant", {}).get("id"), name) if part) or "Admittance report"


def _worst_first(points: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    rank = {"unstable": 0, "undecided": 1, "stable": 2}

    def key(point: Mapping[str, Any]) -> tuple[int, float]:
        margin = point.get("margin_m")
        return rank.get(point["verdict"], 1), float("inf") if margin is None else float(margin)

    return sorted(points, key=key)


def _modes_of(point: Mapping[str, Any]) -> dict[str, Any]:
    """Oscillating modes inside the band, least damped first, and the resonance in any case."""
    poles = [p for p in point.get("poles") or [] if p["kind"] != "beyond" and p["im_rad_s"] > 0.0]
    poles.sort(key=lambda p: (p["kind"] != "resonance", p["damping"]))
    shown = [{**p, "half": _Z95 * p["re_std_rad_s"]} for p in poles[:6]]
    return {"op_id": point["op_id"], "scale": point["scale"], "poles": shown}


def _grid(points: Sequence[Mapping[str, Any]]) -> str:
    """The grid that all cases share, in words; nothing where each has its own."""
    places = {_unscaled(point) for point in points}
    if len(places) != 1:
        return "Each case on its own grid. "
    return f"Grid {places.pop()}, times the scale. "


def _unscaled(point: Mapping[str, Any]) -> str:
    grid = point.get("grid") or {}
    if grid.get("r_ohm") is None or grid.get("x_ohm") is None:
        return str(grid.get("name") or grid.get("kind") or "not stated")
    r, x = (grid[key] / point["scale"] for key in ("r_ohm", "x_ohm"))
    return f"{number(r)} + j{number(x)} ohm at {number(grid.get('f1_hz'))} Hz"


def _bank(bank: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if bank is None:
        return None
    rows = bank["rows"]
    rank = {"unstable": 0, "undecided": 1, "stable": 2}
    rows = sorted(rows, key=lambda r: (rank.get(r["verdict"], 1), -(r.get("re_rad_s") or 0.0)))
    return {"rows": rows[:MOST], "n": len(rows), "counts": Counter(r["verdict"] for r in rows)}


def _swept(response: FrequencyResponse) -> dict[str, Any]:
    facts = response.meta.get("fundamental") or {}
    fact = response.meta.get("stable_on") or {}
    place = fact.get("grid")
    where = "an ideal source" if place == "ideal" else None
    if isinstance(place, Mapping):
        where = f"{place['r_ohm']:.4g} + j{place['x_ohm']:.4g} ohm"
    return {
        "op_id": response.meta.get("op_id"),
        "p_mw": -facts["active_power_into_device_w"] / 1e6 if facts else response.meta.get("active_power_mw"),
        "q_mvar": -facts["reactive_power_into_device_var"] / 1e6 if facts else None,
        "voltage_pu": response.meta.get("terminal_voltage_pu"),
        "rows": len(response),
        "ok": int(np.sum(response.ok)),
        "low_hz": float(response.f_hz[0]),
        "high_hz": float(response.f_hz[-1]),
        "stable_on": where,
        "basis": fact.get("basis"),
        "growth": fact.get("growth_bound_per_s"),
    }


def _not_ok(responses: Sequence[FrequencyResponse]) -> list[dict[str, Any]]:
    """Rows that are not ok by status and reason, the most frequent first."""
    found: Counter[tuple[str, str, str]] = Counter()
    for response in responses:
        for status, reason in zip(np.asarray(response.status), np.asarray(response.reason), strict=True):
            if status != "ok":
                found[(str(response.meta.get("op_id")), str(status), str(reason))] += 1
    return [{"op_id": o, "status": s, "reason": r, "n": n} for (o, s, r), n in found.most_common(MOST)]


def _undecided(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the data cannot decide, in sentences."""
    told = [f"{p['op_id']} at scale {p['scale']:g}: {p['reason']}." for p in points if p["verdict"] == "undecided"]
    unproved = [str(r.meta.get("op_id")) for r in inputs.table.responses if not r.meta.get("stable_on")]
    if unproved:
        told.append(
            f"For {', '.join(unproved[:5])}{' and others' if len(unproved) > 5 else ''} the table does not say on "
            "which source the device was seen to be stable; where that decides, the verdict is left open."
        )
    for point in points[:1]:
        text = (point.get("extrapolation") or {}).get("text")
        if text:
            told.append(text)
    return told
