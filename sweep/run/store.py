"""Where the results of batches are kept while a campaign runs: in a folder, which outlives the run, or in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from ..measure.rows import BatchResult
from ..plan import Batch, Condition
from . import packs, shards

LOOSE = 256
"""So many shards are packed into one file: about as many operating points, and half a minute's work."""


class Store(Protocol):
    """Where the results of batches are kept while a campaign runs."""

    @property
    def is_empty(self) -> bool:
        """Whether there is no result yet."""
        ...

    def read(self, batch: Batch) -> BatchResult | None:
        """The result of a batch; None where there is none, or it is damaged."""

    def holds(self, batch: Batch) -> bool:
        """Whether the result of a batch is there, undamaged."""

    def write(self, batch: Batch, result: BatchResult) -> None:
        """Keep the result of a batch."""


class Folder:
    """Results as shards in a folder, which are packed by the hundred.

    A shard goes when the pack that it is in is there for good: at any moment every result is in one of the two, or in
    both.

    Parameters
    ----------
    path : path
        The folder, which is there.
    """

    def __init__(self, path: Path):
        self.path = path
        self._loose = sorted(shards.keys(path))
        self._numbers = packs.numbers(path)
        self._places = _sorted([packs.places(path, number) for number in self._numbers])
        self._fresh: list[np.ndarray] = []

    @property
    def is_empty(self) -> bool:
        return not self._loose and not len(self._places) and not self._fresh

    def read(self, batch: Batch) -> BatchResult | None:
        loose = shards.read(self.path, batch.key)
        if loose is not None:
            return loose
        place = self._place(batch.key)
        return None if place is None else packs.read(self.path, place)

    def holds(self, batch: Batch) -> bool:
        return self.read(batch) is not None

    def write(self, batch: Batch, result: BatchResult) -> None:
        shards.write(self.path, batch.key, result)
        self._loose.append(batch.key)
        if len(self._loose) >= LOOSE:
            self._pack()

    def keys(self) -> set[str]:
        """Names of all shards, whoever wrote them."""
        return {*self._loose, *(key.decode() for key in self._places["key"].tolist())}

    def _pack(self) -> None:
        number = self._numbers[-1] + 1 if self._numbers else 0
        found = ((key, shards.parts_of(self.path, key)) for key in self._loose)
        with shards.there(self.path):
            self._fresh.append(packs.write(self.path, number, ((key, parts) for key, parts in found if parts)))
            for key in self._loose:
                (self.path / key).unlink(missing_ok=True)
        self._numbers.append(number)
        self._loose.clear()

    def _place(self, key: str) -> np.void | None:
        """Where a shard is packed; the places are sorted when they are first asked for."""
        if self._fresh:
            self._places = _sorted([self._places, *self._fresh])
            self._fresh.clear()
        at = int(np.searchsorted(self._places["key"], key.encode()))
        found = at < len(self._places) and self._places["key"][at] == key.encode()
        return self._places[at] if found else None

    def __str__(self) -> str:
        return str(self.path)


def _sorted(places: Sequence[np.ndarray]) -> np.ndarray:
    """All places, by the names of the shards; of a name that is there twice the last."""
    together = np.concatenate([np.empty(0, packs.PLACE), *places])[::-1]
    _, latest = np.unique(together["key"], return_index=True)
    return together[latest]


class Memory:
    """Results in memory, for a run whose table nobody asked for."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[Batch, BatchResult]] = {}

    @property
    def is_empty(self) -> bool:
        return not self._kept

    def read(self, batch: Batch) -> BatchResult | None:
        kept = self._kept.get(batch.key)
        return None if kept is None else kept[1]

    def holds(self, batch: Batch) -> bool:
        return batch.key in self._kept

    def write(self, batch: Batch, result: BatchResult) -> None:
        self._kept[batch.key] = batch, result

    def measured(self, amplitude_pu: float) -> Callable[[Condition], Sequence[Batch]]:
        """The batches of an operating point that were measured at an amplitude (pu)."""
        known: dict[str, list[Batch]] = {}
        for batch, _ in self._kept.values():
            if batch.amplitude_pu == amplitude_pu:
                known.setdefault(batch.condition.op_id, []).append(batch)
        return lambda condition: known.get(condition.op_id, ())
