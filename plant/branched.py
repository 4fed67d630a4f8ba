"""A plant whose state is not all in its hands: its states are branches of processes, or replayed.

`Branched` takes any plant that answers rightly as long as it goes forwards, such as a controller with
hidden statics, and keeps its states as ways: the settling and everything done since. How a way is gone is
the business of its `Branches` (`forked.Forks`, `branches.Replays`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .driven import Branches
from .forked import Way
from .protocol import Injection, Job, OperatingPoint, PhasorPlant, Phasors, Plant, Record, Source, Window


class Forwards:
    """A plant and the state it is in: what stands at a position.

    Parameters
    ----------
    plant : Plant
        Driven from the state it returned last, and from no other.
    """

    def __init__(self, plant: PhasorPlant):
        self.plant = plant
        self.state: Any = None


@dataclass(frozen=True)
class Settle:
    """Settle a cold plant."""

    operating_point: OperatingPoint
    source: Source

    def __call__(self, box: Forwards) -> float:
        box.state = box.plant.settle(self.operating_point, self.source)
        return float(box.state.time_s)


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


@dataclass(frozen=True, slots=True)
class BranchedState:
    """The way to a state, and its time."""

    time_s: float
    way: Way


class Branched:
    """States of a plant that can only go forwards, kept by ``branches``; see `Plant` for what its methods promise."""

    def __init__(self, branches: Branches):
        self._branches = branches

    def settle(self, operating_point: OperatingPoint, source: Source) -> BranchedState:
        """The steady state, found in a cold plant."""
        action = Settle(operating_point, source)
        return BranchedState(self._branches.act((), action), (action,))

    def go_on(self, state: BranchedState, action: Run | Listen) -> tuple[BranchedState, Any]:
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
