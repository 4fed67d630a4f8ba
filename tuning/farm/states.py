"""Switching states of a farm: devices in and out by number and location, equipment, the source; each judged.

A state is the farm's document with some of it changed, so that a state is judged exactly as a farm of its own would be.
The deactivation criterion of the damping control (the paper's Section III-D) is one of its answers: damping control may
stop where the farm without it is stable, modes between devices included, and the Bode margin at the source's bus is at
least the one asked for. The admittance there is what the farm's topology makes of its devices' tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from ..crossings import Crossing
from .document import checked_number, entries_of, farm_without_islands, known_keys
from .entries import FarmEntry, FarmError, NoLoadFlow
from .farm import Farm, judged
from .margin import crossing_at_source
from .units import Library

STATE_KEYS = ("name", "out", "only", "devices", "count", "source_scale", "each_out")
MOST_STATES = 2000
"""States that one document may expand to."""

NO_POINT = "no operating point"
"""What stands in place of a verdict where the load flow has no solution."""


@dataclass(frozen=True, slots=True)
class State:
    """One switching state.

    Attributes
    ----------
    name : str
        For tables and pictures.
    out : tuple of str
        Devices and equipment out of service.
    only : tuple of str or None
        The devices in service, all others out; None: no such limit.
    devices : int or None
        The first so many devices of the file are in service; None: all.
    count : mapping of str to int
        Devices in parallel of an entry, in place of its own number.
    source_scale : float
        Multiplies the source's impedance.
    """

    name: str
    out: tuple[str, ...] = ()
    only: tuple[str, ...] | None = None
    devices: int | None = None
    count: Mapping[str, int] | None = None
    source_scale: float = 1.0


@dataclass(frozen=True, slots=True)
class StateVerdict:
    """What one state comes to.

    Attributes
    ----------
    state : State
        What is switched.
    farm : Farm or None
        Judged; None where the load flow has no solution.
    reason : str
        Of the verdict, or why there is none.
    crossing : Crossing or None
        The critical crossing of Bode at the source's bus; None if there is none.
    cause_gone : bool
        Whether damping control may stop in this state.
    """

    state: State
    farm: Farm | None
    reason: str
    crossing: Crossing | None
    cause_gone: bool

    @property
    def verdict(self) -> str:
        """The farm's verdict, or `NO_POINT`."""
        return NO_POINT if self.farm is None else self.farm.judgement.verdict


def states_of(document: Mapping[str, Any]) -> tuple[State, ...]:
    """The states of a document: ``[[state]]`` with lists multiplied out; the farm as it is where there are none.

    Raises
    ------
    FarmError
        If a key is unknown, a number makes no sense, or they are too many.
    """
    states = [state for k, entry in enumerate(entries_of(document, "state"), start=1) for state in _expanded(entry, k)]
    if len(states) > MOST_STATES:
        raise FarmError(f"{len(states)} switching states; at most {MOST_STATES} are judged at once")
    return _named_apart(states) or (State("as it is"),)


def farm_in(document: Mapping[str, Any], state: State, out_of_service: Sequence[str] = ()) -> FarmEntry:
    """The farm of a document in one state; what an outage takes off from the source is out as well."""
    content = {key: value for key, value in document.items() if key != "state"}
    content["device"] = _devices(document, state)
    content["source"] = [_scaled(entry, state.source_scale) for entry in entries_of(document, "source")]
    return farm_without_islands(content, tuple(dict.fromkeys([*out_of_service, *state.out])))


def judge_states(
    document: Mapping[str, Any],
    library: Library,
    out_of_service: Sequence[str] = (),
    margin: float = 1.0,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[StateVerdict, ...]:
    """Every state of a document, judged.

    Parameters
    ----------
    document : mapping
        What TOML gives.
    library : Library
        Tables, surrogates and fits, kept from state to state.
    out_of_service : sequence of str
        What is out in every state.
    margin : float
        Magnitude margin m at the source's bus from which on damping control may stop.
    say : callable
        Called with a line on every state.
    """
    found = []
    for state in states_of(document):
        found.append(judge_state(farm_in(document, state, out_of_service), state, library, margin))
        say(f"{state.name}: {found[-1].verdict}")
    return tuple(found)


def judge_state(entry: FarmEntry, state: State, library: Library, margin: float = 1.0) -> StateVerdict:
    """One state, judged."""
    try:
        farm = judged(entry, library)
    except NoLoadFlow as refusal:
        return StateVerdict(state, None, str(refusal), None, False)
    crossing = crossing_at_source(farm)
    gone = farm.judgement.verdict == "stable" and (crossing is None or crossing.m >= margin)
    return StateVerdict(state, farm, farm.judgement.reason, crossing, gone)


# From the document ---------------------------------------------------------------------------------------------------


def _expanded(entry: Mapping[str, Any], k: int) -> Iterator[State]:
    name = str(entry.get("name", f"state {k}"))
    known_keys(entry, STATE_KEYS, name)
    out, only = _names(entry, "out", name), _names(entry, "only", name)
    counts = [(device, _several(value, f"{name}: count of {device}")) for device, value in _table(entry, name).items()]
    devices: list[Any] = _several(entry["devices"], f"{name}: devices") if "devices" in entry else [None]
    scales = _several(entry.get("source_scale", 1.0), f"{name}: source_scale")
    each = [(), *((one,) for one in _names(entry, "each_out", name) or ())] if "each_out" in entry else [()]
    for n, scale, more, *numbers in product(devices, scales, each, *(values for _, values in counts)):
        chosen = {device: int(value) for (device, _), value in zip(counts, numbers, strict=True)}
        parts = [name, *_words(entry, n, scale, more, chosen)]
        yield State(", ".join(parts), (*(out or ()), *more), only, n, chosen or None, float(scale))


def _words(entry: Mapping[str, Any], n: Any, scale: Any, more: tuple[str, ...], chosen: dict[str, int]) -> list[str]:
    """What tells the members of one entry apart."""
    words = [f"{n:g} devices"] if isinstance(entry.get("devices"), list) else []
    words += [f"{scale:g} Z"] if isinstance(entry.get("source_scale"), list) else []
    words += [f"without {', '.join(more)}" if more else "all in"] if "each_out" in entry else []
    table = entry.get("count", {})
    return words + [f"{value} x {device}" for device, value in chosen.items() if isinstance(table[device], list)]


def _named_apart(states: list[State]) -> tuple[State, ...]:
    names = [state.name for state in states]
    return tuple(
        state
        if names.count(state.name) == 1
        else replace(state, name=f"{state.name} ({names[: k + 1].count(state.name)})")
        for k, state in enumerate(states)
    )


def _names(entry: Mapping[str, Any], key: str, name: str) -> tuple[str, ...] | None:
    if key not in entry:
        return None
    names = [entry[key]] if isinstance(entry[key], str) else entry[key]
    if not isinstance(names, list) or not all(isinstance(one, str) for one in names):
        raise FarmError(f"{name}: {key} = {entry[key]!r}; needed is a list of names")
    return tuple(names)


def _table(entry: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = entry.get("count", {})
    if not isinstance(table, Mapping):
        raise FarmError(f"{name}: count = {table!r}; needed is a table of device and number, such as {{ wt = 9 }}")
    return table


def _several(value: Any, where: str) -> list[float]:
    values = value if isinstance(value, list) else [value]
    if not values:
        raise FarmError(f"{where}: an empty list; needed is a number above 0 or several")
    return [checked_number(one, where) for one in values]


def _devices(document: Mapping[str, Any], state: State) -> list[dict[str, Any]]:
    entries = [dict(entry) for entry in entries_of(document, "device")]
    names = [str(entry.get("name", f"device{k}")) for k, entry in enumerate(entries, start=1)]
    for name in (*(state.only or ()), *(state.count or {})):
        if name not in names:
            raise FarmError(f"{state.name}: no device is called {name!r}; the farm has {', '.join(names)}")
    if state.devices is not None and (state.devices != int(state.devices) or state.devices > len(entries)):
        raise FarmError(f"{state.name}: devices = {state.devices:g}; the farm has {len(entries)}")
    for k, (name, entry) in enumerate(zip(names, entries, strict=True)):
        beyond = state.devices is not None and k >= state.devices
        if beyond or (state.only is not None and name not in state.only):
            entry["in_service"] = False
        if state.count and name in state.count:
            entry["count"] = state.count[name]
    return entries


def _scaled(entry: Mapping[str, Any], scale: float) -> dict[str, Any]:
    scaled = dict(entry)
    for key, power in (("s_sc_mva", -1), ("r_ohm", 1), ("x_ohm", 1)):
        if key in scaled and isinstance(scaled[key], int | float):
            scaled[key] = scaled[key] * scale**power
    return scaled
