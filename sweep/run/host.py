"""Where a plant lives: here, or in a child process that is asked. Whoever has a question need not know which.

A question is a function of the plant, named at module level so that it can be sent. Of foreign code a crash
or a hang costs what caused it, nothing else: a campaign's threads lend each other a few children, one that dies
or overruns its time is replaced, and its batch is measured again point by point, so that the reason lands on
the right rows.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from ...plant.protocol import Plant
from ...plant.registry import PlantCard, PlantError, PlantSpec, make_plant, refuse_unknown_id, runs_isolated
from ..config.sections import Config
from ..measure.measure import measure, measure_together
from ..measure.rows import BatchResult, failed_batch
from ..plan import Batch, Hosting
from .child import DEFAULT_MEMORY_MB, Child, ChildFailed, scratch
from .heartbeat import Waiting
from .spare import any_child, card_by_child, taken

T = TypeVar("T")

Measure = Callable[[Sequence[Batch]], list[BatchResult]]
"""`measure_together` with its plant at hand; may be called from any thread."""

DEFAULT_TIMEOUT_S = 60.0
"""Wall time (s) that one shot may take, where the campaign does not say."""


Say = Callable[[str], None]
"""Takes a line of text; from any thread."""


def silent(text: str) -> None:
    """A line that nobody reads."""


class Limits(NamedTuple):
    """Wall time (s) that one shot may take, and memory (MB) that a process of the plant may use."""

    timeout_s: float
    memory_mb: float


class Host(Protocol):
    """Who answers questions about one plant."""

    def ask(self, question: Callable[[Plant], T], timeout_s: float, late: str) -> T:
        """``question(plant)``, answered within ``timeout_s`` (s) of wall time; ``late`` is the reason where it is not.

        Raises
        ------
        ChildFailed
            If the plant lives elsewhere and there is no answer.
        PlantError
            If the plant cannot be made.
        """

    def measuring(self, n_workers: int, say: Say = silent) -> AbstractContextManager[Measure]:
        """For a ``with`` block: `measure_together`, for so many threads at once; ``say`` takes lines on what waits."""


@dataclass(frozen=True, slots=True)
class LocalHost:
    """The plant is here. What it raises is raised; nobody watches the clock."""

    plant: Plant

    def ask(self, question: Callable[[Plant], T], timeout_s: float, late: str) -> T:
        return question(self.plant)

    @contextmanager
    def measuring(self, n_workers: int, say: Say = silent) -> Iterator[Measure]:
        yield partial(measure_together, self.plant)


@dataclass(frozen=True, slots=True)
class ChildHost:
    """The plant lives in child processes: one for a question, several for batches."""

    spec: PlantSpec
    timeout_s: float | None = None
    memory_mb: float | None = None

    def ask(self, question: Callable[[Plant], T], timeout_s: float, late: str) -> T:
        return _again_if_killed(partial(self._ask, question, timeout_s, late))

    def _ask(self, question: Callable[[Plant], T], timeout_s: float, late: str) -> T:
        with any_child(self.spec, self._memory_mb) as asked:
            return asked.ask(question, timeout_s, late)

    @contextmanager
    def measuring(self, n_workers: int, say: Say = silent) -> Iterator[Measure]:
        with scratch() as folder:
            limits = Limits(self.timeout_s or DEFAULT_TIMEOUT_S, self._memory_mb)
            lent = Children(self.spec, limits, n_workers, folder, say, taken(self.spec, self._memory_mb))
            try:
                yield lambda batches: [lent.measure(batch) for batch in batches]
            finally:
                lent.close()

    @property
    def _memory_mb(self) -> float:
        return self.memory_mb or DEFAULT_MEMORY_MB


def host_of(hosting: Hosting) -> Host:
    """The host of a plan's plant, which is made anew where it is to live here."""
    if hosting.isolate:
        return ChildHost(hosting.spec, hosting.timeout_s, hosting.memory_mb)
    return LocalHost(hosting.spec.make())


def host_at_hand(plant: Plant | PlantCard, hosting: Hosting) -> Host:
    """The host of a plant that is at hand, or of one whose card alone is."""
    return host_of(hosting) if isinstance(plant, PlantCard) else LocalHost(plant)


def host_named(spec: PlantSpec, isolate: bool | None = None) -> Host:
    """The host of a plant by name; ``isolate`` None: as suits the plant.

    Raises
    ------
    PlantError
        If there is no such plant, it cannot be made, or a black box is wished into this process.
    """
    refuse_unknown_id(spec.id)
    return host_of(Hosting(spec, runs_isolated(spec.id, isolate)))


def plant_or_card(config: Config) -> Plant | PlantCard:
    """The plant of a campaign; only its card, answered by a child, where it runs isolated.

    Raises
    ------
    PlantError
        If there is no such plant, it cannot be made, or it cannot even say what it is.
    OSError
        If its process is killed from outside, twice.
    """
    spec = PlantSpec(config.plant.id, config.plant.parameters)
    refuse_unknown_id(spec.id)
    if not runs_isolated(spec.id, config.plant.isolate):
        return make_plant(spec.id, spec.parameters)
    try:
        return _again_if_killed(partial(card_by_child, spec))
    except ChildFailed as failure:
        if failure.killed:
            raise OSError(f"{spec.id}: {failure}, twice; the machine may be out of memory") from None
        raise PlantError(f"{spec.id} cannot be made: {failure}") from None


def _again_if_killed(attempt: Callable[[], T]) -> T:
    """Make an attempt, and once more where the child was killed from outside: that says nothing about its plant."""
    try:
        return attempt()
    except ChildFailed as failure:
        if not failure.killed:
            raise
    return attempt()


class Children:
    """As many children as there are workers; `measure` may be called from any thread.

    Parameters
    ----------
    spec : PlantSpec
        The plant.
    limits : Limits
        Of one shot.
    n_children : int
        How many at once; they are started when first needed.
    folder : path
        For their temporary files.
    say : callable
        Takes a line on a batch that is waited for.
    spare : Child, optional
        The first of them, where there is one already.
    """

    def __init__(
        self,
        spec: PlantSpec,
        limits: Limits,
        n_children: int,
        folder: Path,
        say: Say = silent,
        spare: Child | None = None,
    ):
        self._spec, self._limits, self._folder, self._say = spec, limits, folder, say
        self._idle: queue.SimpleQueue[Child | None] = queue.SimpleQueue()
        for one in (spare, *[None] * (n_children - 1)):
            self._idle.put(one)

    def measure(self, batch: Batch) -> BatchResult:
        """`measure` in a child; rows whose plant crashed or hung are "failed" with the reason."""
        try:
            return _again_if_killed(partial(self._ask, batch))
        except (ChildFailed, PlantError) as failure:
            if len(batch.points) == 1 or batch.plays:  # one signal serves all points
                return failed_batch(batch, "failed", str(failure))
        parts = [self.measure(batch.alone(k)) for k in range(len(batch.points))]
        condition = next((part.condition for part in parts if part.condition), {})
        return BatchResult(tuple(row for part in parts for row in part.rows), condition)

    def close(self) -> None:
        """End every idle child."""
        while True:
            try:
                idle = self._idle.get_nowait()
            except queue.Empty:
                return
            if idle is not None:
                idle.kill()

    def _ask(self, batch: Batch) -> BatchResult:
        lent = self._idle.get()
        timeout_s = self._limits.timeout_s * batch.n_shots
        late = f"{batch.n_shots} shots took longer than {timeout_s:g} s of wall time, plant.timeout_s for each"
        try:
            lent = lent or Child(self._spec, self._folder, self._limits.memory_mb)
            return lent.ask(partial(measure, batch=batch), timeout_s, late, Waiting(batch, timeout_s, self._say))
        except ChildFailed:
            if lent is not None:
                lent.kill()
            lent = None
            raise
        finally:
            self._idle.put(lent)
