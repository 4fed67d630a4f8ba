"""A plant whose state is not all in its hands: its states are branches of processes, or replayed.

`Branched` takes any plant that answers rightly as long as it goes forwards, such as a controller with
hidden statics, and keeps its states as ways: the settling and everything done since. How a way is gone is
the business of its `StateStore` (`forks.Forks`, `stores.Replays`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from ..protocol import (
    Conditions,
    Injection,
    Job,
    MeasuredPlant,
    OperatingPoint,
    PhasorPlant,
    Phasors,
    Plant,
    Record,
    Source,
    Trace,
    Window,
)
from ..states.store import StateStore, Way


class Calming(PhasorPlant, MeasuredPlant, Protocol):
    """A plant whose `equilibrium` is near, and comes nearer by waiting."""

    def calmed(self, state: Any) -> Any:
        """Onwards until the waveforms repeat; `NotSettled` where they do not."""
        ...


class Forwards:
    """A plant and the state it is in: what stands at a position.

    Parameters
    ----------
    plant : Calming
        Driven from the state it returned last, and from no other.
    """

    def __init__(self, plant: Calming):
        self.plant = plant
        self.state: Any = None


@dataclass(frozen=True)
class Settle:
    """Settle a cold plant."""

    operating_point: OperatingPoint
    source: Source

    def of(self, plant: Calming) -> Any:
        """The state of ``plant``."""
        return plant.settle(self.operating_point, self.source)

    def __call__(self, box: Forwards) -> float:
        box.state = self.of(box.plant)
        return float(box.state.time_s)


@dataclass(frozen=True)
class Rest:
    """Bring a cold plant to its equilibrium."""

    operating_point: OperatingPoint
    source: Source

    def of(self, plant: Calming) -> Any:
        """The state of ``plant``."""
        return plant.equilibrium(self.operating_point, self.source)

    def __call__(self, box: Forwards) -> float:
        box.state = self.of(box.plant)
        return float(box.state.time_s)


@dataclass(frozen=True)
class Calm:
    """Wait until the waveforms repeat."""

    def __call__(self, box: Forwards) -> tuple[float, None]:
        box.state = box.plant.calmed(box.state)
        return float(box.state.time_s), None


@dataclass(frozen=True)
class Run:
    """Go on, with a record."""

    injection: Injection | None
    n_steps: int

    def __call__(self, box: Forwards) -> tuple[float, Record]:
        ((box.state, record),) = box.plant.run([Job(box.state, self.injection)], self.n_steps)
        return float(box.state.time_s), record


@dataclass(frozen=True)
class Listen:
    """Go on, with phasors."""

    injection: Injection | None
    window: Window
    block_steps: int
    n_blocks: int

    def __call__(self, box: Forwards) -> tuple[float, Phasors]:
        job = Job(box.state, self.injection)
        ((box.state, phasors),) = box.plant.run_phasors([job], [self.window], self.block_steps, self.n_blocks)
        return float(box.state.time_s), phasors


@dataclass(frozen=True)
class Watch:
    """Go on under other surroundings, with a trace; made by `watch`.

    A way of thousands of these is hashed, compared and sent at every one of them: equal ones are the same object.
    """

    conditions: Conditions
    n_steps: int

    def __hash__(self) -> int:
        return self.n_steps

    def __reduce__(self) -> tuple[Any, ...]:
        return watch, (self.conditions, self.n_steps)

    def __call__(self, box: Forwards) -> tuple[float, Trace]:
        box.state, trace = box.plant.trace(box.state, self.conditions, self.n_steps)
        return float(box.state.time_s), trace


@lru_cache(maxsize=1024)
def watch(conditions: Conditions, n_steps: int) -> Watch:
    """The one action that goes on under ``conditions`` for ``n_steps``."""
    return Watch(conditions, n_steps)


@dataclass(frozen=True, slots=True)
class BranchedState:
    """The way to a state, and its time."""

    time_s: float
    way: Way


class Branched:
    """States of a plant that can only go forwards, kept by ``branches``; see `Plant` for what its methods promise."""

    def __init__(self, branches: StateStore):
        self._branches = branches

    def begin(self, action: Settle | Rest) -> BranchedState:
        """The state that ``action`` finds in a cold plant."""
        return BranchedState(self._branches.act((), action), (action,))

    def go_on(self, state: BranchedState, action: Run | Listen | Watch | Calm) -> tuple[BranchedState, Any]:
        """The state after ``action``, and its answer."""
        time_s, answer = self._branches.act(state.way, action)
        return BranchedState(time_s, (*state.way, action)), answer


def is_whole(plant: Plant, state: Any, probe: Callable[[float], Injection]) -> bool:
    """Whether ``state`` holds all that ``plant`` remembers: the same job twice, others in between, the same bytes.

    ``probe(sign)`` is a perturbation strong enough to move everything.
    """
    n_steps = round(2.3 / (plant.f1_hz * plant.dt_s))
    first, _, again = (plant.run([Job(state, probe(sign))], n_steps)[0][1] for sign in (1.0, -1.0, 1.0))
    return first.i.tobytes() == again.i.tobytes()
