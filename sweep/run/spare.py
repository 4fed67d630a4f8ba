"""A child that has said what its plant is stays for the sweep that follows: starting one takes longer than many sweeps.

Only within `spare_children`, whose end is the end of every child that nobody took.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar

from ...plant.registry import PlantCard, PlantSpec
from .child import Child, child, scratch

_spares: ContextVar[Spares | None] = ContextVar("spares", default=None)


class Spares:
    """Children at rest, by what they hold."""

    def __init__(self, room: ExitStack):
        self._room = room
        self._idle: list[tuple[PlantSpec, Child]] = []

    def card(self, spec: PlantSpec) -> PlantCard:
        """The card of a new child, which stays."""
        one = Child(spec, self._room.enter_context(scratch()))
        self._idle.append((spec, one))
        return one.card

    def take(self, spec: PlantSpec) -> Child | None:
        """A child that holds that plant, if one is left and alive; it is the taker's."""
        for k, (held, one) in enumerate(self._idle):
            if held == spec:
                del self._idle[k]
                if one.is_alive:
                    return one
                one.kill()
                return None
        return None

    def end(self) -> None:
        """End those that nobody took."""
        while self._idle:
            self._idle.pop()[1].kill()


@contextmanager
def spare_children() -> Iterator[None]:
    """While in the block, children that answered for a card wait for whoever needs their plant next."""
    with ExitStack() as room:
        spares = Spares(room)
        before = _spares.set(spares)
        try:
            yield
        finally:
            _spares.reset(before)
            spares.end()


def card_by_child(spec: PlantSpec) -> PlantCard:
    """What a plant says of itself, asked in a child."""
    spares = _spares.get()
    if spares is not None:
        return spares.card(spec)
    with child(spec) as asked:
        return asked.card


def taken(spec: PlantSpec, memory_mb: float) -> Child | None:
    """A spare child that holds that plant, if there is one; it may use so much memory (MB) from now on."""
    spares = _spares.get()
    one = spares.take(spec) if spares else None
    if one is not None:
        one.memory_mb = memory_mb
    return one


@contextmanager
def any_child(spec: PlantSpec, memory_mb: float) -> Iterator[Child]:
    """A spare child that holds that plant, or a new one; it ends with the block."""
    spare = taken(spec, memory_mb)
    if spare is None:
        with child(spec, memory_mb) as one:
            yield one
        return
    try:
        yield spare
    finally:
        spare.kill()


def end_spares() -> None:
    """End the spare children, where they are not needed."""
    spares = _spares.get()
    if spares:
        spares.end()
