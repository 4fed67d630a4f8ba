"""The campaign as the user writes it: TOML in, frozen and checked configuration out, every problem at once.

Units are in the keys. What needs the plant to be judged (f1, Nyquist, the operating range, its own
parameters) is judged where the plant is known. This module imports pydantic: import it where it is used.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

Keys = tuple[str | int, ...]
"""Where a value stands: ("operating_point", 0, "active_power_mw")."""

MAX_POINTS = 1_000_000
MAX_AMPLITUDE_PU = 0.2
AUTO_LIMIT_PU = 0.02
PERIOD_S = 1.0
PROBLEMS_SHOWN = 20

# The description of a field says what is needed; messages print it.
Text = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]


class ConfigError(ValueError):
    """A campaign that cannot be run as written.

    Attributes
    ----------
    problems : tuple of str
        All of them, each ``file:line: key: what was given; what is needed``.
    """

    def __init__(self, problems: Sequence[str]):
        self.problems = tuple(problems)
        shown = self.problems[:PROBLEMS_SHOWN]
        more = [f"... and {len(self.problems) - len(shown)} more"] if len(shown) < len(self.problems) else []
        super().__init__("\n".join([*shown, *more]))


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class CampaignSection(_Section):
    """What the campaign is called."""

    name: Text = Field(description='a name in quotes, such as "table1"')


class PlantSection(_Section):
    """What is driven, and how carefully. ``isolate`` None: the plant's own default."""

    id: Text = Field(description='the id of a plant in quotes, such as "dpmsg-v1"')
    parameters: dict[str, Any] = Field(default={}, description="a table [plant.parameters]")
    isolate: bool | None = Field(default=None, description="true or false")
    timeout_s: Positive | None = Field(default=None, description="a number above 0, in s")


class GridSection(_Section):
    """A Thevenin grid of one operating point; its impedance counts ``scale`` times."""

    r_ohm: NotNegative = Field(description="a number of at least 0, in ohm")
    x_ohm: Positive = Field(description="a number above 0, in ohm at f1")
    voltage_pu: Positive = Field(default=1.0, description="a number above 0, in pu")
    scale: Positive = Field(default=1.0, description="a number above 0, multiplies r_ohm and x_ohm")


class OperatingPointSection(_Section):
    """One stationary condition: active power, and either |v_pcc| or the grid that decides it."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")] = Field(
        description="a name of letters, digits, '_', '.' and '-', in quotes"
    )
    active_power_mw: Number = Field(description="a number, in MW")
    terminal_voltage_pu: Positive | None = Field(default=None, description="a number above 0, in pu")
    grid: GridSection | None = Field(
        default=None, description="a table { r_ohm = 0.012, x_ohm = 0.25, voltage_pu = 1.0, scale = 1.0 }"
    )


class SweepSection(_Section):
    """Which frequencies, how exactly, how long at most: a range with ``points``, or the list ``f_hz``."""

    f_min_hz: Positive | None = Field(default=None, description="a number above 0, in Hz")
    f_max_hz: Positive | None = Field(default=None, description="a number above f_min_hz, in Hz")
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)] | None = Field(
        default=None, description=f"a whole number from 2 to {MAX_POINTS}"
    )
    spacing: Literal["log", "linear", "adaptive"] = Field(
        default="log", description='"log", "linear" or "adaptive" (points is then the most it may take)'
    )
    interpolation_tolerance: Annotated[Positive, Field(lt=1)] | None = Field(
        default=None,
        description='a number between 0 and 1, the interpolation error an "adaptive" grid is to be certified for',
    )
    f_hz: Annotated[tuple[Positive, ...], Field(strict=False)] | None = Field(
        default=None, description="a list of increasing frequencies above 0, in Hz, such as [1.0, 10.0, 75.5]"
    )
    tolerance: Annotated[Positive, Field(lt=1)] = Field(
        default=1e-5, description="a number between 0 and 1, the agreement asked of successive windows"
    )
    uncertainty: Annotated[Positive, Field(lt=1)] = Field(
        default=0.003, description="a number between 0 and 1, the relative standard error asked where a plant is noisy"
    )
    probes: Annotated[int, Field(ge=0, le=MAX_POINTS)] | None = Field(
        default=None, description="a whole number of at least 0, the rows that are swept at half the amplitude as well"
    )
    nonlinear_above: Positive = Field(
        default=0.005, description="a number above 0, the relative change of Y with the amplitude that is accepted"
    )
    max_simulated_s: Positive = Field(default=60.0, description="a number above 0, in s, the limit of one shot")


class InjectionSection(_Section):
    """The perturbation; ``amplitude_pu`` is its peak over the rated peak."""

    kind: Literal["series_voltage", "shunt_current"] = Field(
        default="series_voltage", description='"series_voltage" or "shunt_current"'
    )
    signal: Literal["tone", "multisine", "prbs", "qrb", "chirp"] = Field(
        default="tone", description='"tone", "multisine", "prbs", "qrb" or "chirp"'
    )
    period_s: Positive | None = Field(
        default=None, description="a number above 0, in s, the period of a broadband signal (1 s unless given)"
    )
    amplitude_pu: Annotated[Positive, Field(le=MAX_AMPLITUDE_PU)] | Literal["auto"] = Field(
        default=0.0005,
        description=f'a number above 0 and at most {MAX_AMPLITUDE_PU:g}, in pu (peak over rated peak), or "auto"',
    )
    amplitude_max_pu: Annotated[Positive, Field(le=MAX_AMPLITUDE_PU)] | None = Field(
        default=None,
        description=f'a number above 0 and at most {MAX_AMPLITUDE_PU:g}, in pu, the limit of "auto"',
    )

    @property
    def largest_pu(self) -> float:
        """The amplitude, or the limit of an automatic one (pu)."""
        return (self.amplitude_max_pu or AUTO_LIMIT_PU) if self.amplitude_pu == "auto" else self.amplitude_pu


class SourceSection(_Section):
    """What feeds the PCC; the reactance is that at f1."""

    kind: Literal["ideal", "thevenin"] = Field(default="ideal", description='"ideal" or "thevenin"')
    r_ohm: NotNegative = Field(default=0.0, description="a number of at least 0, in ohm")
    x_ohm: NotNegative = Field(default=0.0, description="a number above 0 for a thevenin source, in ohm at f1")


class Config(_Section):
    """A whole campaign. `load_config` and `Config.from_dict` are the ways in: they also check what
    one section says about another.
    """

    campaign: CampaignSection = Field(description="a section [campaign]")
    plant: PlantSection = Field(description="a section [plant]")
    operating_point: Annotated[tuple[OperatingPointSection, ...], Field(strict=False)] = Field(
        description="at least one section [[operating_point]], in double brackets"
    )
    sweep: SweepSection = Field(description="a section [sweep]")
    injection: InjectionSection = Field(default=InjectionSection(), description="a section [injection]")
    source: SourceSection = Field(default=SourceSection(), description="a section [source]")

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON knows, every default filled in; `from_dict` rebuilds the campaign."""
        return self.model_dump(mode="json", exclude_none=True)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Config:
        """The campaign that `to_dict` gave, or that a TOML file holds.

        Raises
        ------
        ConfigError
            With every problem; without file and line, there being none.
        """
        config, problems = _checked(data)
        if config is None:
            raise ConfigError([f"{_dotted(keys)}: {text}" for keys, text in problems])
        return config


def load_config(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Read and check a campaign.

    Parameters
    ----------
    path : path
        TOML file, UTF-8.
    overrides : sequence of str
        ``"section.key=value"`` with the value as TOML writes it; entries of a list by number, as in
        ``"operating_point.0.active_power_mw=0.7"``. The last one wins.

    Raises
    ------
    ConfigError
        With every problem, each at its line or its override.
    """
    text = _read(Path(path))
    data = _parse(text, path)
    lines = _line_numbers(text, data)
    settings = _apply(overrides, data)
    config, problems = _checked(data)
    if config is None:
        in_order = sorted(problems, key=lambda problem: _line(problem.keys, lines) or 0)
        raise ConfigError([f"{_place(path, p.keys, lines, settings)}: {_dotted(p.keys)}: {p.text}" for p in in_order])
    return config


# From the file to plain values


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        way_out = f"; `seqsweep init -o {path}` writes a campaign to start from" if path.parent.is_dir() else ""
        raise ConfigError([f"{path}: no such file{way_out}"]) from None
    except IsADirectoryError:
        raise ConfigError([f"{path}: is a folder; name a campaign file in it"]) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise ConfigError([f"{path}:{line}: not UTF-8 (byte 0x{byte:02x}): save the file as UTF-8"]) from None
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read: {error.strerror}"]) from None


def _parse(text: str, path: str | Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"\(at line (\d+), column \d+\)", str(error))
        line = int(found[1]) if found else text.count("\n") + 1
        what = re.sub(r" \(at .*\)$", "", str(error))
        raise ConfigError([f"{path}:{line}: not TOML: {what}"]) from None
    except RecursionError:
        raise ConfigError([f"{path}: not a campaign: nested too deeply"]) from None


_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]=]+?)\s*\]\]?\s*(#.*)?$")
_ASSIGNMENT = re.compile(r"""\s*([\w."' -]+?)\s*=""")


def _line_numbers(text: str, data: Mapping[str, Any]) -> dict[Keys, int]:
    """Line of every section and key; values inside a value are found at the line of the outer one."""
    lines: dict[Keys, int] = {}
    entries: dict[Keys, int] = {}  # arrays of tables: the entry that is being written
    section: Keys = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            keys = _resolved((), header[2], entries)
            if header[1] == "[[":
                parent = keys[:-1] if keys[-1:] and isinstance(keys[-1], int) else keys
                entries[parent] = entries.get(parent, -1) + 1
                lines.setdefault(parent, number)
                keys = (*parent, entries[parent])
            section = keys if _exists(data, keys) else section
        elif assignment := _ASSIGNMENT.match(line):
            keys = _resolved(section, assignment[1], entries)
        else:
            continue
        if _exists(data, keys):
            lines.setdefault(keys, number)
    return lines


def _resolved(section: Keys, dotted: str, entries: Mapping[Keys, int]) -> Keys:
    keys = section
    for part in dotted.split("."):
        keys = (*keys, part.strip(" \t\"'"))
        if keys in entries:
            keys = (*keys, entries[keys])
    return keys


def _exists(data: Any, keys: Keys) -> bool:
    for key in keys:
        inside = key in data if isinstance(data, Mapping) else isinstance(data, list) and key in range(len(data))
        if not inside:
            return False
        data = data[key]
    return True


# Overrides


class _Setting(NamedTuple):
    keys: Keys
    text: str


def _apply(overrides: Sequence[str], data: dict[str, Any]) -> list[_Setting]:
    """Put every override into ``data``, in order."""
    settings, problems = [], []
    for text in overrides:
        try:
            keys, value = _assignment(text)
            _put(data, keys, value)
            settings.append(_Setting(keys, text))
        except ValueError as error:
            problems.append(f"--set {_short(text)}: {error}")
    if problems:
        raise ConfigError(problems)
    return settings


def _assignment(text: str) -> tuple[Keys, Any]:
    dotted, equals, value = text.partition("=")
    parts = [part.strip() for part in dotted.split(".")]
    if not equals or not all(parts):
        raise ValueError("write section.key=value, such as injection.amplitude_pu=0.002")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = {}
    if set(parsed) != {"value"}:
        quoted = value.strip().strip("\"'")
        raise ValueError(f"{value.strip()!r} is not a TOML value; text needs quotes: --set '{dotted}=\"{quoted}\"'")
    return tuple(int(part) if part.isdecimal() else part for part in parts), parsed["value"]


def _put(data: dict[str, Any], keys: Keys, value: Any) -> None:
    inner: Any = data
    for depth, key in enumerate(keys):
        if isinstance(inner, list) and key not in range(len(inner)):
            have = f"0 to {len(inner) - 1}" if inner else "none"
            raise ValueError(f"{_dotted(keys[:depth])} is a list: name its entry by number, it has {have}")
        if not isinstance(inner, list | dict):
            raise ValueError(f"{_dotted(keys[:depth])} is {_shown(inner)}, not a section")
        place: Any = str(key) if isinstance(inner, dict) else key
        if depth == len(keys) - 1:
            inner[place] = value
        elif isinstance(inner, dict):
            inner = inner.setdefault(place, {})
        else:
            inner = inner[place]


# From plain values to a campaign, or to everything that is wrong with it


class _Problem(NamedTuple):
    keys: Keys
    text: str


def _checked(data: Mapping[str, Any]) -> tuple[Config | None, list[_Problem]]:
    """The campaign and no problems, or no campaign and all problems in the order of the sections."""
    named = _with_ids(data)
    problems = list(_contradictions(named))
    try:
        config = Config.model_validate(named)
    except ValidationError as error:
        problems = [*_field_problems(error), *problems]
    if not problems:
        return config, []
    order = list(Config.model_fields)
    return None, sorted(problems, key=lambda p: order.index(str(p.keys[0])) if p.keys[0] in order else len(order))


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


def _field_problems(error: ValidationError) -> list[_Problem]:
    """What single fields have against their values; "missing" gives way to "did you mean"."""
    found = list(dict.fromkeys(_field_problem(each) for each in error.errors(include_url=False)))
    suggested = {(*problem.keys[:-1], suggestion) for problem, suggestion in found if suggestion}
    return [problem for problem, _ in found if not (problem.keys in suggested and problem.text.startswith("missing"))]


_BRANCHES = ("constrained-float", "literal['auto']")
"""What pydantic adds to the place of a value that may be of two kinds."""


def _field_problem(error: Any) -> tuple[_Problem, str | None]:
    """One problem, and the key that may have been meant."""
    keys: Keys = tuple(part for part in error["loc"] if part not in _BRANCHES)
    if error["type"] == "extra_forbidden":
        text, suggestion = _unknown(keys)
        return _Problem(keys, text), suggestion
    needed = _needed(keys)
    if error["type"] == "missing":
        return _Problem(keys, f"missing; needed: {needed}"), None
    given = error["input"]
    if keys == ("operating_point",) and isinstance(given, Mapping):
        return _Problem(keys, "a section in single brackets; write [[operating_point]], there may be several"), None
    return _Problem(keys, f"given {_shown(given)}; needed: {needed}"), None


def _unknown(keys: Keys) -> tuple[str, str | None]:
    name, section = str(keys[-1]), _model(keys[:-1])
    what, dressed = ("key", "{}") if len(keys) > 1 else ("section", "[{}]")
    assert section is not None
    known = list(section.model_fields)
    if close := difflib.get_close_matches(name.lower(), known, n=1):
        return f"unknown {what}; did you mean {dressed.format(close[0])}?", close[0]
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
        ("injection",): InjectionSection,
        ("source",): SourceSection,
    }
    return models.get(tuple("*" if isinstance(key, int) else key for key in keys))


# What one value says about another. These read plain values: they must speak even where a field is wrong.


def _contradictions(data: Mapping[str, Any]) -> Iterator[_Problem]:
    points = data.get("operating_point")
    if points == []:
        yield _Problem(("operating_point",), f"given []; needed: {_needed(('operating_point',))}")
    points = points if isinstance(points, list) else []
    yield from _parameters(("plant", "parameters"), _section(data, "plant").get("parameters", {}))
    yield from _points(points)
    if isinstance(data.get("sweep"), Mapping):
        yield from _frequencies(_section(data, "sweep"))
        yield from _signal(_section(data, "sweep"), _section(data, "injection"))
    yield from _source(_section(data, "source"), _section(data, "injection"), points)


def _section(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name, {})
    return section if isinstance(section, Mapping) else {}


def _parameters(keys: Keys, value: Any) -> Iterator[_Problem]:
    """Parameters are the plant's to judge; here they only have to be numbers, text, or tables of them."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _parameters((*keys, key), inner)
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _parameters((*keys, index), inner)
    elif len(keys) > 2 and not isinstance(value, bool | str) and _number(value) is None:
        yield _Problem(keys, f"given {_shown(value)}; needed: a finite number, text, true or false")


def _points(points: Sequence[Any]) -> Iterator[_Problem]:
    first: dict[str, int] = {}
    for index, point in enumerate(points):
        if not isinstance(point, Mapping):
            continue
        name = point["id"]
        if isinstance(name, str) and first.setdefault(name, index) != index:
            text = f"{_shown(name)} is also operating_point.{first[name]}; every operating point needs its own id"
            yield _Problem(("operating_point", index, "id"), text)
        given = [key for key in ("terminal_voltage_pu", "grid") if point.get(key) is not None]
        if len(given) == 2:
            yield _Problem(
                ("operating_point", index, "grid"),
                "given beside terminal_voltage_pu; needed: only one, the grid decides |v_pcc| or the other way round",
            )
        elif not given:
            text = "missing; needed: a number above 0, in pu (or a table grid)"
            if not any(difflib.get_close_matches(str(key), ["terminal_voltage_pu"]) for key in point):
                yield _Problem(("operating_point", index, "terminal_voltage_pu"), text)


_RANGE = ("f_min_hz", "f_max_hz", "points")

MIN_ADAPTIVE_POINTS = 12
DEFAULT_INTERPOLATION_TOLERANCE = 1e-3


def _frequencies(sweep: Mapping[str, Any]) -> Iterator[_Problem]:
    present = [key for key in _RANGE if sweep.get(key) is not None]
    yield from _adaptive(sweep)
    if sweep.get("f_hz") is not None:
        for key in present:
            yield _Problem(("sweep", key), "given beside f_hz; needed: either f_hz, or f_min_hz, f_max_hz and points")
        yield from _increasing(sweep["f_hz"])
        return
    unknown = [str(key) for key in sweep if key not in SweepSection.model_fields]
    for key in _RANGE:
        if key not in present and not difflib.get_close_matches(key, unknown):
            yield _Problem(("sweep", key), f"missing; needed: {_needed(('sweep', key))}, or a list f_hz")
    low, high = _number(sweep.get("f_min_hz")), _number(sweep.get("f_max_hz"))
    if low is not None and high is not None and not low < high:
        yield _Problem(("sweep", "f_max_hz"), f"given {high:g}; needed: a number above f_min_hz = {low:g}, in Hz")


def _adaptive(sweep: Mapping[str, Any]) -> Iterator[_Problem]:
    adaptive, points = sweep.get("spacing") == "adaptive", _number(sweep.get("points"))
    if sweep.get("interpolation_tolerance") is not None and not adaptive:
        yield _Problem(("sweep", "interpolation_tolerance"), 'given, but it goes with spacing = "adaptive" alone')
    if adaptive and sweep.get("f_hz") is not None:
        yield _Problem(("sweep", "spacing"), 'given "adaptive" beside f_hz; needed: f_min_hz, f_max_hz and points')
    elif adaptive and points is not None and 2 <= points < MIN_ADAPTIVE_POINTS:
        needed = f"at least {MIN_ADAPTIVE_POINTS}, the most points an adaptive grid may take"
        yield _Problem(("sweep", "points"), f"given {points:g}; needed: {needed}")


def _signal(sweep: Mapping[str, Any], injection: Mapping[str, Any]) -> Iterator[_Problem]:
    """A broadband signal plays all its lines at once: there is nothing to adapt."""
    signal = injection.get("signal", "tone")
    if sweep.get("spacing") == "adaptive" and signal != "tone":
        yield _Problem(("sweep", "spacing"), f'given "adaptive" with a {signal}; needed: signal = "tone"')
    if injection.get("period_s") is not None and signal == "tone":
        yield _Problem(("injection", "period_s"), "given, but a tone's window follows from its frequency; leave it out")
    if injection.get("amplitude_max_pu") is not None and injection.get("amplitude_pu") != "auto":
        yield _Problem(("injection", "amplitude_max_pu"), 'given, but it goes with amplitude_pu = "auto" alone')


def _increasing(f_hz: Any) -> Iterator[_Problem]:
    numbers = [_number(f) for f in f_hz] if isinstance(f_hz, list | tuple) else []
    if f_hz in ([], ()):
        yield _Problem(("sweep", "f_hz"), f"given []; needed: {_needed(('sweep', 'f_hz'))}")
    for index, (before, here) in enumerate(pairwise(numbers), start=1):
        if before is None or here is None or before < here:
            continue
        what = f"{here:.15g} Hz is there twice" if before == here else f"{here:.15g} Hz follows {before:.15g} Hz"
        yield _Problem(("sweep", "f_hz", index), f"{what}; needed: frequencies that increase, each once, in Hz")


def _source(source: Mapping[str, Any], injection: Mapping[str, Any], points: Sequence[Any]) -> Iterator[_Problem]:
    kind = source.get("kind", "ideal")
    with_grid = [isinstance(point, Mapping) and point.get("grid") is not None for point in points]
    impedance = [key for key in ("r_ohm", "x_ohm") if _number(source.get(key))]
    if kind == "ideal":
        yield from _ideal(injection, impedance)
    elif kind == "thevenin" and any(with_grid) and all(with_grid):
        for key in impedance:
            yield _Problem(("source", key), "given beside the grid of every operating point; needed: only one of them")
    elif kind == "thevenin" and source.get("x_ohm", 0) == 0:
        given = "given 0" if "x_ohm" in source else "missing"
        yield _Problem(("source", "x_ohm"), f"{given}; needed: {_needed(('source', 'x_ohm'))}")


def _ideal(injection: Mapping[str, Any], impedance: Sequence[str]) -> Iterator[_Problem]:
    for key in impedance:
        yield _Problem(("source", key), 'given, but an ideal source has no impedance; needed: kind = "thevenin"')
    if injection.get("kind") == "shunt_current":
        held = '"shunt_current" cannot perturb a PCC that an ideal source holds'
        text = f'{held}; needed: "series_voltage", or [source] kind = "thevenin"'
        yield _Problem(("injection", "kind"), text)


# Words


def _place(path: str | Path, keys: Keys, lines: Mapping[Keys, int], settings: Sequence[_Setting]) -> str:
    """``--set ...`` where an override is to blame, else file and line."""
    for setting in reversed(settings):
        if keys[: len(setting.keys)] == setting.keys:
            return f"--set {_short(setting.text)}"
    line = _line(keys, lines)
    return str(path) if line is None else f"{path}:{line}"


def _line(keys: Keys, lines: Mapping[Keys, int]) -> int | None:
    """Line of the value at ``keys``, or of the nearest one around it that has a line."""
    return next((lines[keys[:end]] for end in range(len(keys), 0, -1) if keys[:end] in lines), None)


def _dotted(keys: Keys) -> str:
    return ".".join(str(key) for key in keys)


def _shown(value: Any) -> str:
    """``value`` about as TOML writes it, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _short(json.dumps(value, ensure_ascii=False))
    return "a table" if isinstance(value, Mapping) else _short(str(value))


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
