"""A campaign whose plant runs elsewhere: a crash or a hang costs the points that caused it, nothing else.

The runner's threads lend each other a few children. A child serves batch after batch; one that dies or
overruns its time is replaced, and its batch is measured again point by point, so that the reason lands
on the right rows.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from ...plant.protocol import Plant
from ...plant.registry import PlantCard, PlantError, PlantSpec, make_plant, refuse_unknown_id, runs_isolated
from ..config.sections import Config
from ..measure.measure import measure
from ..measure.rows import BatchResult, failed_batch
from ..plan import Batch, Plan
from .child import Child, ChildFailed, child, scratch

DEFAULT_TIMEOUT_S = 60.0
"""Wall time (s) that one shot may take, where the campaign does not say."""


def plant_or_card(config: Config) -> Plant | PlantCard:
    """The plant of a campaign; only its card, answered by a child, where it runs isolated.

    Raises
    ------
    PlantError
        If there is no such plant, it cannot be made, or it cannot even say what it is.
    """
    spec = PlantSpec(config.plant.id, config.plant.parameters)
    refuse_unknown_id(spec.id)
    if not runs_isolated(spec.id, config.plant.isolate):
        return make_plant(spec.id, spec.parameters)
    try:
        with child(spec) as asked:
            return asked.card
    except ChildFailed as failure:
        raise PlantError(f"{spec.id} cannot be made: {failure}") from None


class Children:
    """As many children as there are workers; `measure` may be called from any thread.

    Parameters
    ----------
    plan : Plan
        What is measured.
    n_children : int
        How many at once; they are started when first needed.
    folder : path
        For their temporary files.
    """

    def __init__(self, plan: Plan, n_children: int, folder: Path):
        self._plan, self._folder = plan, folder
        self._idle: queue.SimpleQueue[Child | None] = queue.SimpleQueue()
        for _ in range(n_children):
            self._idle.put(None)
        self._timeout_s = plan.timeout_s or DEFAULT_TIMEOUT_S

    def measure(self, batch: Batch) -> BatchResult:
        """`measure` in a child; rows whose plant crashed or hung are "failed" with the reason."""
        try:
            return self._ask(batch)
        except (ChildFailed, PlantError) as failure:
            if len(batch.points) == 1 or self._plan.signal is not None:  # one signal serves all points
                return failed_batch(self._plan.at(batch.amplitude_pu), batch, "failed", str(failure))
        parts = [self.measure(replace(batch, points=(point,))) for point in batch.points]
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
        n_shots = len(self._plan.shots_in(batch))
        timeout_s = self._timeout_s * n_shots
        late = f"{n_shots} shots took longer than {timeout_s:g} s of wall time, plant.timeout_s for each"
        try:
            lent = lent or Child(self._plan.spec, self._folder)
            return lent.ask(partial(_measured, self._plan, batch), timeout_s, late)
        except ChildFailed:
            if lent is not None:
                lent.kill()
            lent = None
            raise
        finally:
            self._idle.put(lent)


def _measured(plan: Plan, batch: Batch, plant: Plant) -> BatchResult:
    return measure(plant, plan, batch)


@contextmanager
def children(plan: Plan, n_children: int) -> Iterator[Children]:
    """Children for a campaign; none of them, and no temporary file of theirs, outlives the block."""
    with scratch() as folder:
        lent = Children(plan, n_children, folder)
        try:
            yield lent
        finally:
            lent.close()
