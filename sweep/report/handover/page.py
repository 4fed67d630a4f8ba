"""The page: what the inputs say, in the order in which an engineer's chief reads it."""

from __future__ import annotations

import base64
import hashlib
import json
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.response import FrequencyResponse
from . import bank, pictures
from .checklist import checked, read_profiles
from .farm import FarmInputs, alone_content, farm_content
from .inputs import Inputs
from .loop import loop_pictures
from .repeat import commands
from .words import RANK, sentences, worst_verdict

if TYPE_CHECKING:
    from ....identify.surrogate.surrogate import Surrogate

MOST = 40
"""Rows of a table that are shown at once; the rest is folded."""

FOLDED = 1000
"""Rows that are folded; beyond, the file that the report rests on has them."""

_Z95 = 1.959963984540054


def page(
    inputs: Inputs,
    stamp: str = "",
    profiles: Sequence[str] = (),
    printing: bool = False,
) -> str:
    """The whole report as one HTML text; the same inputs give the same bytes.

    Parameters
    ----------
    inputs : Inputs
        The table and the results about it.
    stamp : str
        Date, user and host where they are wanted.
    profiles : sequence of str
        Requirement profiles by name or file; see `read_profiles`.
    printing : bool
        Whether the page goes to a printer at once: what is folded for its length alone is unfolded.
    """
    return _rendered("report.html.j2", {**_content(inputs, profiles), "stamp": stamp, "printing": printing})


def farm_page(inputs: FarmInputs, stamp: str = "") -> str:
    """The report of a farm alone; see `page`."""
    return _rendered("farm_alone.html.j2", {**alone_content(inputs), **_looks(), "stamp": stamp})


def _rendered(template: str, content: Mapping[str, Any]) -> str:
    from jinja2 import Environment, FunctionLoader

    environment = Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, loader=FunctionLoader(_data)
    )
    environment.filters["num"] = number
    environment.filters["percent"] = percent
    return environment.get_template(template).render(content).lstrip()


def _looks() -> dict[str, Any]:
    """Style, script, version: what every page has."""
    script = _data("hover.js")
    return {
        "style": _data("report.css"),
        "script": script,
        "script_hash": "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "version": version("seqsweep"),
        "most": MOST,
    }


def _data(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


def _content(inputs: Inputs, profiles: Sequence[str]) -> dict[str, Any]:
    tuning = inputs.results.get("tuning")
    points = _worst_first(tuning["operating_points"]) if tuning else []
    swept = [_swept(response) for response in _as_judged(inputs.table.responses, points)]
    return {
        "title": _title(inputs),
        "sentences": sentences(inputs, points),
        "worst": worst_verdict(inputs, points),
        "foreign": inputs.foreign,
        "sections": _sections(inputs, points),
        "tuning": tuning,
        "grid": _grid(points),
        "points": points[:MOST],
        "folded_points": points[MOST : MOST + FOLDED],
        "modes": [_modes_of(point) for point in points[:6]],
        **_pictures(inputs, points),
        "verification": inputs.results.get("verification"),
        "bank": _bank(inputs.results.get("bank")),
        **farm_content(inputs.results),
        "surrogate": _surrogate(inputs.results.get("surrogate")),
        "metrics": _metrics(inputs.results.get("metrics")),
        "device": _device(inputs),
        "how": _how(inputs.table.meta),
        "swept": swept[:MOST],
        "folded_swept": swept[MOST : MOST + FOLDED],
        "n_swept": len(swept),
        "not_ok": _not_ok(inputs.table.responses),
        "open": _undecided(inputs, points),
        "checklists": [checked(inputs, profile) for profile in read_profiles(profiles)],
        "files": inputs.files,
        "commands": [line for command in commands(inputs) for line in _wrapped(command)],
        "meta": inputs.table.meta,
        "campaign": json.dumps(inputs.table.meta.get("configuration", {}), indent=1, sort_keys=True),
        **_looks(),
    }


def _pictures(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    verification = inputs.results.get("verification")
    return {
        "bode": pictures.admittance(_as_judged(inputs.table.responses, points)),
        "loop_pictures": loop_pictures(inputs, points),
        "modes_picture": pictures.modes(points) if points else None,
        "time_picture": pictures.resonance_in_time(verification) if verification else None,
    }


def _as_judged(responses: Sequence[FrequencyResponse], points: Sequence[Mapping[str, Any]]) -> list[FrequencyResponse]:
    """Operating points in the order of their worst case; those without a case keep theirs, behind."""
    place: dict[Any, int] = {}
    for k, point in enumerate(points):
        place.setdefault(point["op_id"], k)
    return sorted(responses, key=lambda response: place.get(response.meta.get("op_id"), len(points)))


def _sections(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Identifiers and names of the sections that this report has."""
    has = inputs.results
    every = [
        ("verdict", "Verdict", bool(points)),
        ("modes", "Closed-loop modes", bool(points)),
        ("in-time", "Confirmation in time", "verification" in has),
        ("bank", "Bank of grids", "bank" in has),
        ("farm", "Farm", "farm" in has),
        ("states", "Switching states", "states" in has),
        ("region", "Any operating point", "surrogate" in has),
        ("metrics", "Metrics", "metrics" in has),
        ("admittance", "Admittance", True),
        ("swept", "What was swept", True),
        ("open", "What the data cannot decide", bool(_undecided(inputs, points))),
        ("checklist", "What operators ask", True),
        ("provenance", "Provenance", True),
    ]
    return [(id_, name) for id_, name, there in every if there]


def _wrapped(command: str) -> list[str]:
    """A command in lines that fit a page, as a shell reads them."""
    lines = textwrap.wrap(command, 88, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    return [*(f"{line} \\" for line in lines[:-1]), lines[-1]]


def number(value: Any, digits: int = 4) -> str:
    """A number for people; a dash where there is none."""
    return "\N{EN DASH}" if value is None or value != value else f"{value:.{digits}g}"


def percent(value: Any) -> str:
    """A part of one in per cent; a dash where there is none."""
    return number(None if value is None else 100.0 * value, 3)


def _title(inputs: Inputs) -> str:
    meta = inputs.table.meta
    name = meta.get("configuration", {}).get("campaign", {}).get("name")
    return " · ".join(str(part) for part in (meta.get("plant", {}).get("id"), name) if part) or "Admittance report"


def _device(inputs: Inputs) -> dict[str, str]:
    meta = inputs.table.meta
    bases = meta.get("bases") or {}
    known = {"rated_voltage_v", "rated_power_va"} <= set(bases)
    rating = f"{bases['rated_voltage_v']:g} V, {bases['rated_power_va'] / 1e6:g} MVA" if known else ""
    return {"id": str((meta.get("plant") or {}).get("id", "without a name")), "rating": rating}


def _how(meta: Mapping[str, Any]) -> str:
    """Grid of frequencies, signal and amplitude, in a sentence; nothing where the table was not swept by us."""
    configuration = meta.get("configuration") or {}
    injection, sweep = configuration.get("injection") or {}, configuration.get("sweep") or {}
    if not injection or not sweep:
        return ""
    amplitude = injection.get("amplitude_pu")
    size = f" of {amplitude:g} pu" if isinstance(amplitude, int | float) else f", amplitude {amplitude}"
    spacing = sweep.get("spacing", "log")
    return (
        f"Perturbed by {str(injection.get('kind', '')).replace('_', ' ')}, {injection.get('signal', 'tone')}{size}; "
        f"{'an' if spacing[:1] in 'aeiou' else 'a'} {spacing} grid of frequencies."
    )


def _bank(found: bank.Bank | None) -> dict[str, Any] | None:
    if found is None:
        return None
    groups = [("operating point", "grid", "op_id"), ("grid", "operating point", "grid_id")]
    rows = [{"name": name, "other": other, "rows": found.by(column)[:FOLDED]} for name, other, column in groups]
    return {
        "n": len(found),
        "counts": found.counts,
        "rows": found.rows(0, MOST),
        "folded": found.rows(MOST, 10 * MOST),
        "groups": rows,
        "picture": bank.picture(found),
    }


def _surrogate(model: Surrogate | None) -> dict[str, Any] | None:
    """Region of a surrogate and its error."""
    if model is None:
        return None
    bar, where = model.worst_bar
    names = ("P (MW)", "Q (Mvar)", "|v| (pu)")
    place = ", ".join(f"{value:.4g}" for value in where)
    return {
        "text": f"A surrogate over {len(model.points)} swept operating points gives the admittance at any point of the "
        f"region below. The 95 % radius of its error is at most {100.0 * bar:.2g} % of |Y|, at "
        f"(P, Q, |v|) = ({place}).",
        "axes": [
            {"name": name, "low": low, "high": high}
            for name, low, high in zip(names, model.region.low, model.region.high, strict=True)
        ],
    }


def _metrics(found: Mapping[str, Any] | None) -> dict[str, Any] | None:
    return None if found is None else {"operating_points": found["operating_points"][: MOST + FOLDED]}


def _worst_first(points: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    def key(point: Mapping[str, Any]) -> tuple[int, float]:
        margin = point.get("margin_m")
        return RANK.get(point["verdict"], 1), float("inf") if margin is None else float(margin)

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
        "stable_on": "not known" if where is None else f"{where} ({_proof(fact)})",
    }


def _proof(fact: Mapping[str, Any]) -> str:
    growth = fact.get("growth_bound_per_s")
    bound = "" if growth is None else f"; no excited mode grows faster than {number(growth, 3)} 1/s"
    return f"{fact.get('basis')}{bound}"


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
    if len(told) > MOST:
        told[MOST:] = [f"{len(told) - MOST} further cases are undecided as well."]
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
