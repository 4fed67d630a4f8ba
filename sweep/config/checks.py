"""From plain values to a campaign, or to everything that is wrong with it, field by field and one against another."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from ...plant.errors import closest
from .elements import with_elements
from .file import Keys, shown
from .sections import (
    MIN_ADAPTIVE_POINTS,
    CampaignSection,
    Config,
    GridSection,
    InjectionSection,
    OperatingPointSection,
    OperatingPointsSection,
    PlantSection,
    SourceSection,
    SweepSection,
    ToleranceSection,
)


class Problem(NamedTuple):
    keys: Keys
    text: str


def checked(data: Mapping[str, Any], folder: Path) -> tuple[Config | None, list[Problem]]:
    """The campaign and no problems, or no campaign and all problems in the order of the sections.

    Files of elements are named relative to ``folder``.
    """
    full, misread = with_elements(_beside(data, folder), folder)
    if misread:
        return None, [Problem(*each) for each in misread]
    named = _with_ids(full)
    problems = list(_contradictions(named))
    try:
        config = Config.model_validate(named)
    except ValidationError as error:
        problems = [*_field_problems(error), *problems]
    if not problems:
        return config, []
    order = list(Config.model_fields)
    return None, sorted(problems, key=lambda p: order.index(str(p.keys[0])) if p.keys[0] in order else len(order))


def _beside(data: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """The campaign with the grid of a tolerance named as it is reached from here, where it lies beside the campaign."""
    region = _section(_section(data, "sweep"), "operating_points")
    tolerance = _section(region, "tolerance")
    grid = tolerance.get("grid")
    if not isinstance(grid, str) or not (folder / grid).exists():
        return data
    named = {**region, "tolerance": {**tolerance, "grid": (folder / grid).as_posix()}}
    return {**data, "sweep": {**data["sweep"], "operating_points": named}}


def _with_ids(data: Mapping[str, Any]) -> dict[str, Any]:
    """A copy in which operating points without an id are called after their values."""
    points = data.get("operating_point")
    if not isinstance(points, list | tuple):
        return dict(data)
    named = [_with_id(point) if isinstance(point, Mapping) else point for point in points]
    return {**data, "operating_point": named}


def _with_id(point: Mapping[str, Any]) -> dict[str, Any]:
    grid = point.get("grid")
    parts = [("p", point.get("active_power_mw")), ("v", point.get("terminal_voltage_pu"))]
    if isinstance(grid, Mapping):
        parts += [("r", grid.get("r_ohm")), ("x", grid.get("x_ohm"))]
        parts += [("e", grid.get("voltage_pu", 1.0)), ("s", grid.get("scale", 1.0))]
    values = [f"{letter}{number:.15g}" for letter, value in parts if (number := _number(value)) is not None]
    if isinstance(grid, Mapping) and isinstance(grid.get("elements"), Mapping):
        values.append(f"g{re.sub(r'[^A-Za-z0-9_.-]', '_', str(grid['elements'].get('name', 'elements')))}")
    made = "-".join(values).replace("+", "") or "unnamed"
    return {"id": made, **point}


def _number(value: Any) -> float | None:
    """``value`` as a finite number, or None where it is not one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def _field_problems(error: ValidationError) -> list[Problem]:
    """What single fields have against their values; "missing" gives way to "did you mean"."""
    found = list(dict.fromkeys(_field_problem(each) for each in error.errors(include_url=False)))
    suggested = {(*problem.keys[:-1], suggestion) for problem, suggestion in found if suggestion}
    return [problem for problem, _ in found if not (problem.keys in suggested and problem.text.startswith("missing"))]


_BRANCHES = ("constrained-float", "literal['auto']", "float", "tuple[float, float]", "number", "table")
"""What pydantic adds to the place of a value that may be of two kinds."""


def _field_problem(error: Any) -> tuple[Problem, str | None]:
    """One problem, and the key that may have been meant."""
    keys: Keys = tuple(part for part in error["loc"] if part not in _BRANCHES)
    if error["type"] == "extra_forbidden":
        text, suggestion = _unknown(keys)
        return Problem(keys, text), suggestion
    needed = _needed(keys)
    if error["type"] == "missing":
        return Problem(keys, f"missing; needed: {needed}"), None
    given = error["input"]
    if keys == ("operating_point",) and isinstance(given, Mapping):
        return Problem(keys, "a section in single brackets; write [[operating_point]], there may be several"), None
    return Problem(keys, f"given {shown(given)}; needed: {needed}"), None


def _unknown(keys: Keys) -> tuple[str, str | None]:
    name, section = str(keys[-1]), _model(keys[:-1])
    what, dressed = ("key", "{}") if len(keys) > 1 else ("section", "[{}]")
    assert section is not None
    known = list(section.model_fields)
    if close := closest(name, known):
        return f"unknown {what}; did you mean {dressed.format(close)}?", close
    for other in Config.model_fields:
        model = _model((other, 0) if other == "operating_point" else (other,))
        if model is not None and name in model.model_fields:
            return f"unknown {what} here; it belongs in [{other}]", None
    return f"unknown {what}; known: {', '.join(dressed.format(key) for key in known)}", None


def _needed(keys: Keys) -> str:
    """The description of the field at ``keys``, or of the nearest field around it that has one."""
    for end in range(len(keys), 0, -1):
        model = _model(keys[: end - 1])
        if model is not None and keys[end - 1] in model.model_fields:
            return str(model.model_fields[str(keys[end - 1])].description)
        if end == 2 and keys[0] == "operating_point":
            return "a section [[operating_point]]"
    return "a campaign"


def _model(keys: Keys) -> type[BaseModel] | None:
    """The section at ``keys``; None where there is a plain value."""
    models: dict[Keys, type[BaseModel]] = {
        (): Config,
        ("campaign",): CampaignSection,
        ("plant",): PlantSection,
        ("operating_point", "*"): OperatingPointSection,
        ("operating_point", "*", "grid"): GridSection,
        ("sweep",): SweepSection,
        ("sweep", "operating_points"): OperatingPointsSection,
        ("sweep", "operating_points", "tolerance"): ToleranceSection,
        ("injection",): InjectionSection,
        ("source",): SourceSection,
        ("source", "grid"): GridSection,
    }
    return models.get(tuple("*" if isinstance(key, int) else key for key in keys))


# What one value says about another. These read plain values: they must speak even where a field is wrong.


def _contradictions(data: Mapping[str, Any]) -> Iterator[Problem]:
    points = data.get("operating_point")
    yield from _region(_section(data, "sweep").get("operating_points"), data)
    if points == []:
        yield Problem(("operating_point",), f"given []; needed: {_needed(('operating_point',))}")
    points = points if isinstance(points, list) else []
    yield from _parameters(("plant", "parameters"), _section(data, "plant").get("parameters", {}))
    yield from _points(points)
    if isinstance(data.get("sweep"), Mapping):
        yield from _frequencies(_section(data, "sweep"))
        yield from _signal(_section(data, "sweep"), _section(data, "injection"))
    yield from _source(_section(data, "source"), _section(data, "injection"), points)


def _region(region: Any, data: Mapping[str, Any]) -> Iterator[Problem]:
    """Operating points are listed, or are a region of which the sweep chooses; ranges ascend."""
    if region is None:
        if "operating_point" not in data and not any(closest(str(key), ["operating_point"]) for key in data):
            yield Problem(("operating_point",), f"missing; needed: {_needed(('operating_point',))}")
        return
    if "operating_point" in data:
        text = "given beside [sweep.operating_points]; needed: only one, a list of points or a region of them"
        yield Problem(("operating_point",), text)
    if not isinstance(region, Mapping):
        return
    yield from _tolerance(region.get("tolerance"))
    parameters = _section(region, "parameters")
    ranges = {**_ranges(region, ()), **_ranges(parameters, ("parameters",))}
    for keys, (low, high) in ranges.items():
        if _number(low) is not None and _number(high) is not None and not low < high:
            text = f"given {shown([low, high])}; needed: a range [low, high] with low < high, or one number"
            yield Problem(("sweep", "operating_points", *keys), text)
    if not ranges:
        text = "no range in it; needed: [low, high] for at least one of active_power_mw, reactive_power_mvar, "
        yield Problem(("sweep", "operating_points"), text + "terminal_voltage_pu and parameters")
    for name in sorted(set(parameters) & set(_section(_section(data, "plant"), "parameters"))):
        text = "given in [plant.parameters] as well; needed: only one of them"
        yield Problem(("sweep", "operating_points", "parameters", name), text)


def _tolerance(tolerance: Any) -> Iterator[Problem]:
    """On grids it is of the critical mode or of the verdict."""
    if isinstance(tolerance, Mapping) and ("mode_rad_s" in tolerance) == ("verdict" in tolerance):
        text = "needed: mode_rad_s or verdict, one of them, with the grid or bank that it is for"
        yield Problem(("sweep", "operating_points", "tolerance"), text)


def _ranges(values: Mapping[str, Any], keys: Keys) -> dict[Keys, Any]:
    """What is given as [low, high], by its place below ``keys``."""
    pairs = ((key, value) for key, value in values.items() if isinstance(value, list | tuple) and len(value) == 2)
    return {(*keys, key): value for key, value in pairs}


def _section(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name, {})
    return section if isinstance(section, Mapping) else {}


def _parameters(keys: Keys, value: Any) -> Iterator[Problem]:
    """Parameters are the plant's to judge; here they only have to be numbers, text, or tables of them."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _parameters((*keys, key), inner)
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _parameters((*keys, index), inner)
    elif len(keys) > 2 and not isinstance(value, bool | str) and _number(value) is None:
        yield Problem(keys, f"given {shown(value)}; needed: a finite number, text, true or false")


def _points(points: Sequence[Any]) -> Iterator[Problem]:
    first: dict[str, int] = {}
    for index, point in enumerate(points):
        if not isinstance(point, Mapping):
            continue
        name = point["id"]
        if isinstance(name, str) and first.setdefault(name, index) != index:
            text = f"{shown(name)} is also operating_point.{first[name]}; every operating point needs its own id"
            yield Problem(("operating_point", index, "id"), text)
        yield from _grid(("operating_point", index, "grid"), point.get("grid"))
        given = [key for key in ("terminal_voltage_pu", "grid") if point.get(key) is not None]
        if len(given) == 2:
            yield Problem(
                ("operating_point", index, "grid"),
                "given beside terminal_voltage_pu; needed: only one, the grid decides |v_pcc| or the other way round",
            )
        elif not given:
            text = "missing; needed: a number above 0, in pu (or a table grid)"
            if not any(closest(str(key), ["terminal_voltage_pu"]) for key in point):
                yield Problem(("operating_point", index, "terminal_voltage_pu"), text)


def _grid(keys: Keys, grid: Any) -> Iterator[Problem]:
    """A grid is R and X, or elements."""
    if not isinstance(grid, Mapping):
        return
    elements = grid.get("elements") is not None
    for key in ("r_ohm", "x_ohm"):
        if elements and key in grid:
            yield Problem((*keys, key), "given beside elements; needed: only one of them")
        elif not elements and key not in grid and not closest(key, [str(k) for k in grid if k not in _GRID_KEYS]):
            yield Problem((*keys, key), f"missing; needed: {_needed((*keys, key))}")


_GRID_KEYS = tuple(GridSection.model_fields)

_RANGE = ("f_min_hz", "f_max_hz", "points")


def _frequencies(sweep: Mapping[str, Any]) -> Iterator[Problem]:
    present = [key for key in _RANGE if sweep.get(key) is not None]
    yield from _adaptive(sweep)
    if sweep.get("f_hz") is not None:
        for key in present:
            yield Problem(("sweep", key), "given beside f_hz; needed: either f_hz, or f_min_hz, f_max_hz and points")
        yield from _increasing(sweep["f_hz"])
        return
    unknown = [str(key) for key in sweep if key not in SweepSection.model_fields]
    for key in _RANGE:
        if key not in present and not closest(key, unknown):
            yield Problem(("sweep", key), f"missing; needed: {_needed(('sweep', key))}, or a list f_hz")
    low, high = _number(sweep.get("f_min_hz")), _number(sweep.get("f_max_hz"))
    if low is not None and high is not None and not low < high:
        yield Problem(("sweep", "f_max_hz"), f"given {high:g}; needed: a number above f_min_hz = {low:g}, in Hz")


def _adaptive(sweep: Mapping[str, Any]) -> Iterator[Problem]:
    adaptive, points = sweep.get("spacing") == "adaptive", _number(sweep.get("points"))
    if sweep.get("interpolation_tolerance") is not None and not adaptive:
        yield Problem(("sweep", "interpolation_tolerance"), 'given, but it goes with spacing = "adaptive" alone')
    if adaptive and sweep.get("f_hz") is not None:
        yield Problem(("sweep", "spacing"), 'given "adaptive" beside f_hz; needed: f_min_hz, f_max_hz and points')
    elif adaptive and points is not None and 2 <= points < MIN_ADAPTIVE_POINTS:
        needed = f"at least {MIN_ADAPTIVE_POINTS}, the most points an adaptive grid may take"
        yield Problem(("sweep", "points"), f"given {points:g}; needed: {needed}")


def _signal(sweep: Mapping[str, Any], injection: Mapping[str, Any]) -> Iterator[Problem]:
    """A broadband signal plays all its lines at once: there is nothing to adapt."""
    signal = injection.get("signal", "tone")
    if sweep.get("spacing") == "adaptive" and signal != "tone":
        yield Problem(("sweep", "spacing"), f'given "adaptive" with a {signal}; needed: signal = "tone"')
    if injection.get("period_s") is not None and signal == "tone":
        yield Problem(("injection", "period_s"), "given, but a tone's window follows from its frequency; leave it out")
    if injection.get("amplitude_max_pu") is not None and injection.get("amplitude_pu") != "auto":
        yield Problem(("injection", "amplitude_max_pu"), 'given, but it goes with amplitude_pu = "auto" alone')


def _increasing(f_hz: Any) -> Iterator[Problem]:
    numbers = [_number(f) for f in f_hz] if isinstance(f_hz, list | tuple) else []
    if f_hz in ([], ()):
        yield Problem(("sweep", "f_hz"), f"given []; needed: {_needed(('sweep', 'f_hz'))}")
    for index, (before, here) in enumerate(pairwise(numbers), start=1):
        if before is None or here is None or before < here or here <= 0.0:
            continue  # of one that is not above 0 that is said, and no more
        what = f"{here:.15g} Hz is there twice" if before == here else f"{here:.15g} Hz follows {before:.15g} Hz"
        yield Problem(("sweep", "f_hz", index), f"{what}; needed: frequencies that increase, each once, in Hz")


def _source(source: Mapping[str, Any], injection: Mapping[str, Any], points: Sequence[Any]) -> Iterator[Problem]:
    kind = source.get("kind", "ideal")
    with_grid = [isinstance(point, Mapping) and point.get("grid") is not None for point in points]
    impedance = [key for key in ("r_ohm", "x_ohm") if _number(source.get(key))]
    if kind == "ideal":
        yield from _ideal(injection, impedance)
        for key in ("settle_on", "grid"):
            if source.get(key) is not None:
                yield Problem(("source", key), 'given, but on an ideal source; needed: kind = "thevenin"')
    elif kind == "thevenin" and any(with_grid) and all(with_grid):
        for key in impedance:
            yield Problem(("source", key), "given beside the grid of every operating point; needed: only one of them")
    elif kind == "thevenin" and source.get("grid") is not None:
        yield from _grid(("source", "grid"), source["grid"])
        for key in impedance:
            yield Problem(("source", key), "given beside grid; needed: only one of them")
    elif kind == "thevenin" and source.get("x_ohm", 0) == 0:
        given = "given 0" if "x_ohm" in source else "missing"
        yield Problem(("source", "x_ohm"), f"{given}; needed: {_needed(('source', 'x_ohm'))}")


def _ideal(injection: Mapping[str, Any], impedance: Sequence[str]) -> Iterator[Problem]:
    for key in impedance:
        yield Problem(("source", key), 'given, but an ideal source has no impedance; needed: kind = "thevenin"')
    if injection.get("kind") == "shunt_current":
        held = '"shunt_current" cannot perturb a PCC that an ideal source holds'
        text = f'{held}; needed: "series_voltage", or [source] kind = "thevenin"'
        yield Problem(("injection", "kind"), text)
