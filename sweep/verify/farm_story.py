"""A farm's scenario as the user writes it: what happens to the network and to its devices, by their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...plant.errors import nearest
from ...plant.foreign.toml_file import read_toml
from .scenario import check_times, number_of, refuse_unknown
from .whose_story import DEVICE, FARM, ScenarioError, refuse_the_other_s


@dataclass(frozen=True, slots=True)
class SourceStep:
    """From ``time_s`` on the source's impedance is ``scale`` times that of the file."""

    time_s: float
    scale: float


@dataclass(frozen=True, slots=True)
class FarmSwitch:
    """From ``time_s`` on these devices and pieces of equipment are in service, or not."""

    time_s: float
    names: tuple[str, ...]
    in_service: bool


@dataclass(frozen=True, slots=True)
class FarmFault:
    """A short circuit at a bus."""

    time_s: float
    duration_s: float
    bus: str
    kind: str
    r_ohm: float


@dataclass(frozen=True, slots=True)
class FarmPower:
    """From ``time_s`` on a device has another power (W)."""

    time_s: float
    device: str
    active_power_w: float


Told = SourceStep | FarmSwitch | FarmFault | FarmPower


@dataclass(frozen=True, slots=True)
class FarmStory:
    """What happens to a farm.

    Attributes
    ----------
    duration_s : float
        Simulated time (s).
    source_scale : float
        Source impedance at the beginning, in multiples of the file's.
    out : tuple of str
        Devices and equipment out of service at the beginning, besides those that the file says.
    k : float or mapping
        Damping gain of every device, or by name.
    on_from_s : float or None
        When damping control and grid-side dampers are switched on by hand; None: by their own logic.
    stop_margin : float or None
        All damping stops where the farm without it is stable and the Bode margin at its source's bus is at least this;
        None: what has started stays.
    aggregate : bool
        Whether one turbine for all is simulated beside.
    events : tuple of Told
        In any order.
    """

    duration_s: float = 1.2
    source_scale: float = 1.0
    out: tuple[str, ...] = ()
    k: float | Mapping[str, float] = 0.0
    on_from_s: float | None = None
    stop_margin: float | None = None
    aggregate: bool = True
    events: tuple[Told, ...] = ()

    def k_of(self, name: str) -> float:
        """Gain of a device."""
        return self.k.get(name, 0.0) if isinstance(self.k, Mapping) else self.k


DEFAULT = FarmStory(source_scale=1.2 / 1.4, events=(SourceStep(0.1, 1.0),))
"""The source's impedance steps from 1.2/1.4 of the file's to all of it, as the paper's."""


def read_farm_story(path: Path) -> FarmStory:
    """Read a scenario file.

    Raises
    ------
    ScenarioError
        If it is not TOML, or a key is unknown, missing or of the wrong kind.
    """
    document = read_toml(path, ScenarioError)
    try:
        return farm_story_of(document)
    except ScenarioError as error:
        raise ScenarioError(f"{path}: {error}") from None


def farm_story_of(data: Mapping[str, Any]) -> FarmStory:
    """The story that the content of a scenario file tells."""
    refuse_the_other_s(data, FARM, DEVICE)
    refuse_unknown(data, (*FARM.keys, "event"), "the scenario")
    numbers = ("duration_s", "source_scale", "stop_margin", "on_from_s")
    values: dict[str, Any] = {key: _positive(data, key) for key in numbers if key in data and key != "on_from_s"}
    if "on_from_s" in data:
        values["on_from_s"] = number_of(data, "on_from_s", "the scenario")
    if "on_from_s" in data and "stop_margin" in data:
        raise ScenarioError("on_from_s holds damping on by hand, stop_margin lets it stop by itself; give one of them")
    entries = data.get("event", [])
    if not (isinstance(entries, list) and all(isinstance(entry, Mapping) for entry in entries)):
        raise ScenarioError("event must be tables in double brackets, [[event]]")
    events = tuple(_event(entry, f"event {n}") for n, entry in enumerate(entries, start=1))
    aggregate = data.get("aggregate", True)
    if not isinstance(aggregate, bool):
        raise ScenarioError(f"aggregate is {aggregate!r}; needed is true or false")
    check_times(events, values.get("duration_s", DEFAULT.duration_s))
    return FarmStory(
        **values, out=_names(data.get("out", []), "out"), k=_gains(data), aggregate=aggregate, events=events
    )


def check_name(name: str, known: list[str], what: str) -> None:
    """Refuse a name that is none."""
    if name not in known:
        raise ScenarioError(f"{what} {name!r} is not in the farm{nearest(name, known)}; it has {', '.join(known)}")


def _gains(data: Mapping[str, Any]) -> float | dict[str, float]:
    k = data.get("k", 0.0)
    if isinstance(k, Mapping):
        return {str(name): number_of(k, name, "k") for name in k}
    return number_of({"k": k}, "k", "the scenario")


def _event(entry: Mapping[str, Any], where: str) -> Told:
    kind: Any = entry.get("kind")
    if kind not in FARM.kinds:
        raise ScenarioError(f"{where}: kind is {kind!r}; known are {', '.join(FARM.kinds)}")
    refuse_unknown(entry, ("kind", "time_s", *FARM.kinds[kind]), f"{where} ({kind})")
    time_s = number_of(entry, "time_s", where)
    if not time_s >= 0.0:
        raise ScenarioError(f"{where}: time_s is {time_s:g}; needed is a time from 0 s on")
    if kind == "source_step":
        return SourceStep(time_s, _positive(entry, "scale", where))
    if kind == "power_step":
        return FarmPower(time_s, _text(entry, "device", where), 1e6 * _positive(entry, "active_power_mw", where))
    if kind == "switch":
        if not isinstance(entry.get("in_service"), bool):
            raise ScenarioError(f"{where}: in_service is {entry.get('in_service')!r}; needed is true or false")
        return FarmSwitch(time_s, _names(entry.get("name"), f"{where}: name"), bool(entry["in_service"]))
    r_ohm = _positive(entry, "r_ohm", where) if "r_ohm" in entry else 0.01
    fault = entry.get("fault", "a-b-c")
    if fault not in ("a-b-c", "a-g", "b-c", "b-c-g"):
        raise ScenarioError(f"{where}: fault is {fault!r}; known are 'a-b-c', 'a-g', 'b-c', 'b-c-g'")
    return FarmFault(time_s, _positive(entry, "duration_s", where), _text(entry, "bus", where), fault, r_ohm)


def _positive(data: Mapping[str, Any], key: str, where: str = "the scenario") -> float:
    value = number_of(data, key, where)
    if not value > 0.0:
        raise ScenarioError(f"{where}: {key} is {value:g}; needed is a number above 0")
    return value


def _text(data: Mapping[str, Any], key: str, where: str) -> str:
    if not isinstance(data.get(key), str):
        raise ScenarioError(f"{where}: {key} is {data.get(key)!r}; needed is a name in quotes")
    return str(data[key])


def _names(value: Any, where: str) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ScenarioError(f"{where} is {value!r}; needed is a name in quotes, or a list of them")
    return tuple(names)
