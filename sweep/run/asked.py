"""The batches of a campaign, made when they are needed: of 100,000 operating points none is kept in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import compress
from typing import Protocol

from ..excitation.frequencies import Frequency
from ..plan import Batch, Condition, Plan


class Batches(Protocol):
    """Some batches, whose number is known before they are made."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Batch]: ...


class Asked:
    """All batches of some plans, one plan after the other.

    Parameters
    ----------
    plans : sequence of Plan
        A campaign as a whole, its rounds, or its operating points at their own amplitudes.
    """

    def __init__(self, plans: Sequence[Plan]):
        self.plans = tuple(plans)
        self._of_all = [plan for plan in self.plans if len(plan.conditions) > 1]
        self._of_one: dict[str, list[Plan]] = {}
        for plan in self.plans:
            if len(plan.conditions) == 1:
                self._of_one.setdefault(plan.conditions[0].op_id, []).append(plan)

    def __len__(self) -> int:
        return sum(len(plan.groups()) * len(plan.conditions) for plan in self.plans)

    def __iter__(self) -> Iterator[Batch]:
        return (make() for make in self.makers())

    def makers(self) -> Iterator[Callable[[], Batch]]:
        """What makes each batch."""
        return (make for plan in self.plans for make in plan.makers())

    def __add__(self, others: Asked) -> Asked:
        return Asked((*self.plans, *others.plans))

    def at(self, condition: Condition) -> list[Batch]:
        """The batches of one operating point, of all plans that have it."""
        own = (*self._of_all, *self._of_one.get(condition.op_id, ()))
        return [batch for plan in own for batch in plan.batches_at(condition)]

    @property
    def n_points(self) -> int:
        """Points in all."""
        return sum(len(plan.points) * len(plan.conditions) for plan in self.plans)

    @property
    def work(self) -> int:
        """Work in all, as `work_of` counts it."""
        return sum(work_of(plan.points) * len(plan.conditions) for plan in self.plans)


class Missing:
    """Those of some batches that are yet to be measured, by a flag for each; a byte is kept of it."""

    def __init__(self, asked: Asked, flags: Iterable[bool]):
        self._asked, self._flags = asked, bytes(flags)

    def __len__(self) -> int:
        return sum(self._flags)

    def __iter__(self) -> Iterator[Batch]:
        return (make() for make in compress(self._asked.makers(), self._flags))


def work_of(points: Sequence[Frequency]) -> int:
    """Work of some points: long windows come first, so points alone would promise too long a wait."""
    return sum(point.window_blocks for point in points)
