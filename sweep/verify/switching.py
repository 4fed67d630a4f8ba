"""Elements of the tuned grid switched in a scenario: every event's circuit, made of the grid's document."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...plant.circuits.circuit import Circuit
from ...plant.damping.events import CircuitStep, Event
from ...plant.errors import SeqsweepError, nearest
from ...tuning.grids.document import SAID_TWICE
from ...tuning.grids.elements import CableGrid, ElementsGrid
from ...tuning.grids.in_time import circuit_of, circuit_of_grid, compensating, names_of, ready_to_switch
from ...tuning.siso import Grid
from .scenario import ElementStep, Switch

Told = Event | Switch | ElementStep


def circuits_of(grid: Grid, events: Sequence[Told]) -> tuple[Circuit | None, tuple[Event, ...]]:
    """The circuit at the beginning, None of R + jX, and the events with what is switched as steps of circuits.

    Raises
    ------
    SeqsweepError
        If something is switched in a grid that has no elements, or not this one, or leaves none.
    """
    switched = sorted((e for e in events if isinstance(e, Switch | ElementStep)), key=lambda event: event.time_s)
    others = tuple(event for event in events if not isinstance(event, Switch | ElementStep))
    if not switched:
        return circuit_of_grid(grid), others
    if not isinstance(grid, ElementsGrid | CableGrid):
        raise SeqsweepError(
            f"element {switched[0].element!r} is to be switched, but the tuned grid ({grid.label}) has no elements; "
            "tune on a grid.toml"
        )
    original, now = dict(grid.document), ready_to_switch(grid.document, grid.f1_hz)
    start, steps = _circuit(now, grid), []
    for event in switched:
        now = _after(now, original, event, grid.f1_hz)
        steps.append(CircuitStep(event.time_s, _circuit(now, grid), _words(event)))
    return start, (*others, *steps)


def _circuit(document: dict[str, Any], grid: ElementsGrid | CableGrid) -> Circuit:
    return circuit_of(document, grid.f1_hz, grid.name).scaled(grid.scale)


def _after(
    document: dict[str, Any], original: dict[str, Any], event: Switch | ElementStep, f1_hz: float
) -> dict[str, Any]:
    names = names_of(document)
    if event.element not in names:
        raise SeqsweepError(
            f"no element of the tuned grid is called {event.element!r}{nearest(event.element, names)}; it has "
            f"{', '.join(names)}"
        )
    k = names.index(event.element)
    entries = list(document["element"])
    changed = _changed(event, original, k, f1_hz)
    replaced = {other for pair in SAID_TWICE for key, other in (pair, pair[::-1]) if key in changed}
    entries[k] = {**{key: value for key, value in entries[k].items() if key not in replaced}, **changed}
    return {**document, "element": entries}


def _changed(event: Switch | ElementStep, original: dict[str, Any], k: int, f1_hz: float) -> dict[str, Any]:
    """What an event writes into an entry; a compensation becomes ohm, and none is out of service."""
    if isinstance(event, Switch):
        return {"in_service": event.in_service}
    values = dict(event.values)
    percent = values.pop("compensation_percent", None)
    if percent is None:
        return values
    if percent == 0.0:
        return {**values, "in_service": False}
    return {**values, "in_service": True, "x_ohm": compensating(original, k, percent, f1_hz)}


def _words(event: Switch | ElementStep) -> str:
    if isinstance(event, Switch):
        return f"{event.element} {'in' if event.in_service else 'out'}"
    return f"{event.element} with " + ", ".join(f"{key} = {value:g}" for key, value in event.values)
