"""A scenario as the user writes it: TOML in, `plant.events.Scenario` out.

Impedances count in multiples of the tuned grid, so that one file serves every tuning::

    duration_s = 1.2
    scale = 0.85                # at the beginning
    active_power_mw = 0.6       # else the operating point's
    source_voltage_pu = 1.0     # else what the operating point says

    [[event]]
    kind = "grid_step"          # or turbine_step, fault, wind_step, power_step; of elements switch, element_step
    time_s = 0.1
    scale = 1.0
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...plant.damping.events import Event, Fault, GridStep, PowerStep, TurbineStep, WindStep
from ...plant.errors import nearest
from ...plant.foreign.toml_file import read_toml
from .whose_story import DEVICE, FARM, ScenarioError, refuse_the_other_s

DURATION_S = 1.2
STEP_S = 0.1
BEFORE_STEP = 1.2 / 1.4
"""Impedance before the default grid step, in parts of the tuned one: the paper steps from 1.2 Z to 1.4 Z."""


@dataclass(frozen=True, slots=True)
class Switch:
    """From ``time_s`` on an element of the tuned grid is in service, or not."""

    time_s: float
    element: str
    in_service: bool


@dataclass(frozen=True, slots=True)
class ElementStep:
    """From ``time_s`` on numbers of an element of the tuned grid are others."""

    time_s: float
    element: str
    values: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Story:
    """What happens, wherever it happens; what is None the operating point decides.

    Attributes
    ----------
    duration_s : float
        Simulated time (s).
    scale : float
        Impedance at the beginning, in multiples of the tuned grid.
    events : tuple of Event
        Scales are multiples of the tuned grid.
    turbines : float
        Equal turbines on the grid at the beginning.
    active_power_w, source_voltage_pu : float or None
        Power (W), and voltage behind the grid (per unit of rated).
    """

    duration_s: float = DURATION_S
    scale: float = BEFORE_STEP
    events: tuple[Event | Switch | ElementStep, ...] = (GridStep(STEP_S, 1.0),)
    turbines: float = 1.0
    active_power_w: float | None = None
    source_voltage_pu: float | None = None


def read_story(path: str | Path) -> Story:
    """Read a scenario file.

    Raises
    ------
    ScenarioError
        If it is not TOML, or a key is unknown, missing or of the wrong kind.
    OSError
        If it cannot be read.
    """
    data = read_toml(Path(path), ScenarioError)
    try:
        return story_of(data)
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None


def story_of(data: Mapping[str, Any]) -> Story:
    """The story that the content of a scenario file tells; `ScenarioError` where it makes no sense."""
    refuse_the_other_s(data, DEVICE, FARM)
    refuse_unknown(data, (*DEVICE.keys, "event"), "the scenario")
    values = {key: number_of(data, key, "the scenario") for key in DEVICE.keys if key in data}
    if "active_power_mw" in values:
        values["active_power_w"] = values.pop("active_power_mw") * 1e6
    entries = data.get("event", [])
    if not (isinstance(entries, list) and all(isinstance(entry, Mapping) for entry in entries)):
        raise ScenarioError("event must be tables in double brackets, [[event]]")
    events = tuple(_event(entry, f"event {n}") for n, entry in enumerate(entries, start=1))
    check_times(events, values.get("duration_s", DURATION_S))
    return Story(**{"scale": 1.0, **values}, events=events)


def check_times(events: Sequence[Any], duration_s: float) -> None:
    """Refuse an event, anything with a ``time_s``, that the run ends before."""
    for n, event in enumerate(events, start=1):
        if event.time_s >= duration_s:
            raise ScenarioError(
                f"event {n}: time_s is {event.time_s:g}, but the run ends at {duration_s:g} s: nothing would happen; "
                "give an earlier time_s, or a longer duration_s"
            )


def _event(entry: Mapping[str, Any], where: str) -> Event | Switch | ElementStep:
    kind: Any = entry.get("kind")
    if kind == "element_step":
        return _element_step(entry, where)
    if kind not in DEVICE.kinds:
        raise ScenarioError(f"{where}: kind is {kind!r}; known are {', '.join(DEVICE.kinds)}")
    refuse_unknown(entry, ("kind", "time_s", *DEVICE.kinds[kind]), f"{where} ({kind})")
    time_s = number_of(entry, "time_s", where)
    if kind == "grid_step":
        return GridStep(time_s, number_of(entry, "scale", where))
    if kind == "turbine_step":
        return TurbineStep(time_s, number_of(entry, "count", where))
    if kind == "wind_step":
        return WindStep(time_s, number_of(entry, "wind_m_s", where))
    if kind == "power_step":
        return PowerStep(time_s, 1e6 * number_of(entry, "active_power_mw", where))
    if kind == "switch":
        return Switch(time_s, _element(entry, where), _in_service(entry, where))
    r_ohm = number_of(entry, "r_ohm", where) if "r_ohm" in entry else 0.01
    return Fault(time_s, number_of(entry, "duration_s", where), entry.get("fault", "a-b-c"), r_ohm)


def _element_step(entry: Mapping[str, Any], where: str) -> ElementStep:
    values = tuple((key, number_of(entry, key, where)) for key in entry if key not in ("kind", "time_s", "element"))
    if not values:
        raise ScenarioError(f"{where}: no number of the element; needed is one or more, as compensation_percent = 40")
    return ElementStep(number_of(entry, "time_s", where), _element(entry, where), values)


def _element(entry: Mapping[str, Any], where: str) -> str:
    if not isinstance(entry.get("element"), str):
        raise ScenarioError(f"{where}: element is {entry.get('element')!r}; needed is the name of one, in quotes")
    return str(entry["element"])


def _in_service(entry: Mapping[str, Any], where: str) -> bool:
    if not isinstance(entry.get("in_service"), bool):
        raise ScenarioError(f"{where}: in_service is {entry.get('in_service')!r}; needed is true or false")
    return bool(entry["in_service"])


def number_of(data: Mapping[str, Any], key: str, where: str) -> float:
    """The number under a key; `ScenarioError` where there is none."""
    if key not in data:
        raise ScenarioError(f"{where}: {key} is missing")
    value = data[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScenarioError(f"{where}: {key} is {value!r}; a number is needed")
    return float(value)


def refuse_unknown(data: Iterable[str], known: tuple[str, ...], where: str) -> None:
    """Refuse a key that is not known, with the one that may be meant."""
    for key in data:
        if key not in known:
            hint = nearest(key, known) or f"; known are {', '.join(known)}"
            raise ScenarioError(f"{where} has no {key!r}{hint}")
