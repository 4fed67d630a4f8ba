"""Whose story a scenario file tells: one device's, for what `tune` wrote, or a farm's, for a farm file.

Some words are of the one alone. A file that has words of the other and none of its own was given to the wrong command
line, and is refused with what would take it and with what is taken here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ...plant.errors import SeqsweepError


class ScenarioError(SeqsweepError):
    """A scenario file that cannot be followed."""


class Teller(NamedTuple):
    """What a kind of story has: keys of the file, kinds of events with their keys, and how it is told."""

    name: str
    goes_with: str
    keys: tuple[str, ...]
    kinds: Mapping[str, tuple[str, ...]]

    @property
    def words(self) -> set[tuple[str, ...]]:
        """Every word of it: keys of the file, kinds of events, and a kind's keys behind the kind."""
        of_events = {(kind, key) for kind, keys in self.kinds.items() for key in ("", *keys)}
        return of_events | {("", key) for key in self.keys}

    def __str__(self) -> str:
        events = ", ".join(f"{kind} ({', '.join(keys)})" for kind, keys in self.kinds.items())
        return f"{self.name} has {', '.join(self.keys)}, and [[event]] of kind {events}"


DEVICE = Teller(
    "the story of one device",
    "what tune wrote (seqsweep verify tuning.json --scenario FILE)",
    ("duration_s", "scale", "turbines", "active_power_mw", "source_voltage_pu"),
    {
        "grid_step": ("scale",),
        "turbine_step": ("count",),
        "fault": ("fault", "duration_s", "r_ohm"),
        "wind_step": ("wind_m_s",),
        "power_step": ("active_power_mw",),
        "switch": ("element", "in_service"),
        "element_step": ("element",),
    },
)

FARM = Teller(
    "the story of a farm",
    "a farm file (seqsweep verify farm.toml --scenario FILE)",
    ("duration_s", "source_scale", "out", "k", "on_from_s", "stop_margin", "aggregate"),
    {
        "source_step": ("scale",),
        "switch": ("name", "in_service"),
        "fault": ("bus", "fault", "duration_s", "r_ohm"),
        "power_step": ("device", "active_power_mw"),
    },
)


def refuse_the_other_s(data: Mapping[str, Any], own: Teller, other: Teller) -> None:
    """Refuse a file that tells the other kind of story."""
    used = _words_of(data)
    foreign = [word for word in used if word in other.words - own.words]
    if foreign and not any(word in own.words - other.words for word in used):
        kind, key = foreign[0]
        raise ScenarioError(
            f"this is {other.name} ({key or kind!r} is a word of it) and goes with {other.goes_with}; {own}"
        )


def _words_of(data: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Of a file, as `Teller.words` has them."""
    entries = data.get("event", [])
    events = [entry for entry in entries if isinstance(entry, Mapping)] if isinstance(entries, list) else []
    of_events = [(str(entry.get("kind")), key) for entry in events for key in ("", *entry)]
    return [*(("", key) for key in data), *of_events]
