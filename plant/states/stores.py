"""Two stores within this process: snapshots that the box takes itself, or going the way again; see `store`.

The third, by fork, is `forks.Forks`.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Protocol

from .store import BRANCHED_FROM, Action, BoxLost, Room, Way, outdated

ROOM = Room(branches=128)
"""Positions kept as snapshots: branches for each shot of the largest batch, and some to spare."""

BOXES_KEPT = 4
"""Boxes that stand at different places; a shot and its reference go on without being replayed."""


class SnapshotBox(Protocol):
    """A box that can be put back to where it was."""

    def save(self) -> Any:
        """A snapshot of everything it needs to go on."""
        ...

    def load(self, snapshot: Any) -> None:
        """Be as it was when ``snapshot`` was taken; it may be loaded again later."""
        ...

    def drop(self, snapshot: Any) -> None:
        """The snapshot is not needed any more."""
        ...


class Snapshots:
    """Positions of one box, kept as its own snapshots.

    A branch that goes on leaves its position behind; one that is asked for again is reached again, and stays.

    Parameters
    ----------
    build : callable
        Makes the box, when it is first needed and whenever it is lost.
    room : Room
        How many positions are kept at once; see `outdated`.
    """

    def __init__(self, build: Callable[[], SnapshotBox], room: Room = ROOM):
        self._build, self._room = build, room
        self._box: SnapshotBox | None = None
        self._kept: OrderedDict[Way, Any] = OrderedDict()
        self._stay: set[Way] = set()

    def act(self, way: Way, action: Action) -> Any:
        """The answer of ``action`` at the end of ``way``; the position behind it is kept."""
        try:
            return self._act(way, action)
        except BoxLost:
            self._box = None
            self._kept.clear()
            self._stay.clear()
            raise

    def _act(self, way: Way, action: Action) -> Any:
        self._box = box = self._box or self._build()
        nearest = next(n for n in range(len(way), -1, -1) if n == 0 or way[:n] in self._kept)
        if nearest:
            self._kept.move_to_end(way[:nearest])
            box.load(self._kept[way[:nearest]])
        for n in range(nearest, len(way)):  # an action at the start begins with a start
            way[n](box)
        if nearest < len(way):
            self._stay.add(way)
            self._keep(way, box)
        answer = action(box)
        if len(way) > BRANCHED_FROM and way not in self._stay:
            self._let_go(way, box)
        self._keep((*way, action), box)
        return answer

    def _keep(self, way: Way, box: SnapshotBox) -> None:
        if way in self._kept:
            return
        self._kept[way] = box.save()
        if (gone := outdated(self._kept, self._room, way)) is not None:
            self._let_go(gone, box)

    def _let_go(self, way: Way, box: SnapshotBox) -> None:
        box.drop(self._kept.pop(way))
        self._stay.discard(way)


class Replays:
    """Positions of a few boxes that can only go forwards; any other is reached from cold.

    Parameters
    ----------
    build : callable
        Makes another box. The first action on a way must start it anew.
    """

    def __init__(self, build: Callable[[], Any]):
        self._build = build
        self._boxes: OrderedDict[Way, Any] = OrderedDict()

    def act(self, way: Way, action: Action) -> Any:
        """The answer of ``action`` at the end of ``way``, where a box then stands."""
        box = self._boxes.pop(way) if way in self._boxes else self._replayed(way)
        answer = action(box)
        self._boxes[(*way, action)] = box
        return answer

    def _replayed(self, way: Way) -> Any:
        box = self._boxes.popitem(last=False)[1] if len(self._boxes) == BOXES_KEPT else self._build()
        for action in way:
            action(box)
        return box
