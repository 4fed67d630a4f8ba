"""The promise of a state store: how a device that can only go forwards is branched many times.

A state is not what the device holds, which nobody can see, but the *way* to it: the actions taken since it was
built. A store is asked to act at the end of a way, and may get there as it likes:

    way ()          start            settle, rest            shot A, first part       shot A, second part
    ------ build --------> cold start -------> settled box -----------> *  --------------------> *
                                                    |
                                                    +------- shot B ---> *  ----> ...
                                                    +------- shot C ---> *

    Snapshots   the box itself saves and loads positions; the nearest one that is kept is loaded, the rest is gone again
    Forks       a position is a process that waits there; a fork of it goes on, hidden memory and all
    Replays     nothing is kept but a few boxes where they stand; any other way is gone again from a cold start

Whichever it is, the same way and the same action give the same answer; only the cost differs. Where a kept position was
lost or let go, the store goes the way again from the nearest one that is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

Action = Callable[[Any], Any]
"""Something done with a box: a hashable value that can be pickled, and does the same every time."""

Way = tuple[Action, ...]
"""The actions since the box was built; the first one starts it."""

BRANCHED_FROM = 1
"""Positions up to so many actions stay where they are: the cold start and, after one, the settled box."""


SETTLED_KEPT = 64
"""Settled boxes, one for each operating point, that are kept however many branches were begun since: an adaptive sweep
comes back to all of its operating points in every round."""


class Room(NamedTuple):
    """How many positions are kept: branches, and settled boxes (with the cold start, where that is kept)."""

    branches: int
    settled: int = SETTLED_KEPT


def outdated(kept: Iterable[Way], room: Room, newcomer: Way) -> Way | None:
    """The position to let go when ``newcomer`` was kept, if there is one too many.

    Branches, and the positions that stay where they are, are counted apart: those of shots that are over must not drive
    out a settled box. Of either kind goes the one that was not needed for longest, unless it is on the newcomer's way.

    Parameters
    ----------
    kept : iterable of ways
        In the order in which they were needed.
    room : Room
        How many there may be.
    newcomer : way
        Spared, and all that leads to it.
    """
    ways = list(kept)
    for of_branches, most in ((True, room.branches), (False, room.settled)):
        alike = [way for way in ways if (len(way) > BRANCHED_FROM) == of_branches]
        gone = next((way for way in alike if newcomer[: len(way)] != way), None)
        if len(alike) > most and gone is not None:
            return gone
    return None


class StateStore(Protocol):
    """The positions of a box, by the way to them."""

    def act(self, way: Way, action: Action) -> Any:
        """The answer of ``action`` at the end of ``way``; the position behind it is asked for as ``(*way, action)``.

        What the box raises is raised. A store whose box was lost on the way builds another one when it is next asked.
        """
        ...


class BoxLost(RuntimeError):
    """A box that is of no further use: another one must be built."""
