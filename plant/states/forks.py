"""Snapshots by fork: a box that can only go forwards is settled once and branched many times.

A position is the *way* to it: the actions taken since the box was built. A position that was reached is a
process that waits there. From where branches begin, a fork of it goes on and it stays: hidden statics, files in
memory and heaps branch along, and a crash costs one branch. A branch itself goes on in its own process, which
leaves the position behind: forks are dear, and hardly anybody comes back. Where a position was left or let go, the
way is gone again from the nearest one that is left: slower, the same answer; then it stays.

    this process -- nursery (no threads) -- cold start -- settled box -- one process per branch

Each dies with the one before it, so that none is left behind; a position that is let go takes its branches along.

Linux. A box with threads of its own cannot be forked.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import reduction
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from .processes import adopt_orphans, die_with_parent, has_ended, how_it_ended
from .store import BRANCHED_FROM, Action, Room, Way, outdated

T = TypeVar("T")

ROOM = Room(branches=104)
"""Positions kept as processes: branches for each shot of the largest batch, and some to spare."""

LOOK_S = 0.5
"""Wall time (s) after which a process that has not answered is looked after."""

_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class BoxDied(Exception):
    """The process of a box ended in the midst of an action; the message says how."""


class CannotFork(Exception):
    """This system, or this box, knows no snapshot by fork."""


class Forks:
    """Branches of a box that is built, and acts, in processes of its own.

    Parameters
    ----------
    build : callable
        Makes the box, in the first of these processes; can be pickled.
    prepare : callable, optional
        What is done once before anything is forked, such as compiling kernels; can be pickled.
    room : Room
        How many positions are kept as processes; see `outdated`.
    """

    def __init__(self, build: Callable[[], Any], prepare: Callable[[], object] | None = None, room: Room = ROOM):
        self._setting = (build, prepare, room)
        self._nursery: tuple[subprocess.Popen[bytes], Connection] | None = None

    def act(self, way: Way, action: Action) -> Any:
        """The answer of ``action`` at the end of ``way``; a process then waits behind it.

        Raises
        ------
        BoxDied
            If the box ends its process, on the way or now.
        CannotFork
            If there is no fork on this system, or the box has threads.
        Exception
            What the action raises.
        """
        if sys.platform != "linux":
            raise CannotFork("snapshots by fork need Linux")
        _, pipe = self._nursery = self._nursery or self._start()
        try:
            pipe.send((way, action))
            answer = pickle.loads(pipe.recv_bytes())
        except (EOFError, ConnectionError):
            self.close()
            raise BoxDied("the process that keeps the box's branches is gone") from None
        return answer.value()

    def close(self) -> None:
        """End every process; the next action begins anew."""
        if self._nursery is not None:
            process, pipe = self._nursery
            self._nursery = None
            pipe.close()
            process.kill()
            process.wait()

    def __del__(self) -> None:
        self.close()

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        pipe, theirs = Pipe()
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import main; main()", str(theirs.fileno()), str(os.getpid())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
        )
        theirs.close()
        pipe.send(sys.path)
        pipe.send(self._setting)
        return process, pipe


class _Answer(NamedTuple):
    content: Any

    def value(self) -> Any:
        return self.content


class _Raised(NamedTuple):
    error: Exception

    def value(self) -> Any:
        raise self.error


# The nursery


class _Keeper(NamedTuple):
    """A process that waits at a position; forks go on from one that stays. ``parent`` leads to where it was forked."""

    pid: int
    channel: Connection
    parent: Connection | None
    stays: bool


class _Fork(NamedTuple):
    """What a keeper that stays is asked for: a fork, at the other end of a pipe that follows."""


class _Bury(NamedTuple):
    """What it is asked for when a fork of its has ended: the exit status."""

    pid: int


class _Nursery:
    """All positions by the way to them, the cold start being the empty way."""

    def __init__(self, build: Callable[[], Any], prepare: Callable[[], object] | None, room: Room):
        if prepare is not None:
            prepare()
        self._build, self._room = build, room
        self._kept: OrderedDict[Way, _Keeper] = OrderedDict()

    def act(self, way: Way, action: Action) -> bytes:
        """The pickled answer of ``action`` at the end of ``way``."""
        self._go(way)
        return self._go_on(way, action)

    def _go(self, way: Way) -> None:
        """Have a process wait at the end of ``way``, from the nearest one that is there."""
        nearest = next(n for n in range(len(way), -1, -1) if n == 0 or way[:n] in self._kept)
        if nearest == 0 and () not in self._kept:
            self._begin()
        for n in range(nearest, len(way)):
            pickle.loads(self._go_on(way[:n], way[n])).value()
        if nearest < len(way):  # it is asked for again: somebody branches here
            self._kept[way] = self._kept[way]._replace(stays=True)
        self._kept.move_to_end(way)
        if way[:BRANCHED_FROM] in self._kept:  # needed for as long as its branches are
            self._kept.move_to_end(way[:BRANCHED_FROM])

    def _begin(self) -> None:
        ours, theirs = Pipe()
        gc.freeze()
        if os.fork() == 0:
            ours.close()
            die_with_parent(os.getppid())
            theirs.send(os.getpid())
            _keep(_told(theirs, self._build, lambda box: None), theirs)
        theirs.close()
        pickle.loads(self._hear((), _welcome(ours, None))).value()

    def _go_on(self, way: Way, action: Action) -> bytes:
        goes = self._forked(way) if self._kept[way].stays else self._kept.pop(way)
        with suppress(ConnectionError):  # it is dead: nothing will be heard of it either
            goes.channel.send(action)
        return self._hear((*way, action), goes)

    def _forked(self, way: Way) -> _Keeper:
        keeper = self._kept[way]
        ours, theirs = Pipe()
        try:
            keeper.channel.send(_Fork())
            reduction.send_handle(keeper.channel, theirs.fileno(), keeper.pid)
        except ConnectionError:
            del self._kept[way]
            died = _ending(keeper)
            self._end(way)
            raise BoxDied(f"the box died: {died}") from None
        theirs.close()
        return _welcome(ours, keeper.channel)

    def _hear(self, way: Way, goes: _Keeper) -> bytes:
        """Hear what a process says of its action, and keep it at the end of ``way`` if it has an answer."""
        try:
            _wait(goes)
            answers, said = goes.channel.recv(), goes.channel.recv_bytes()
        except (EOFError, ConnectionError):
            raise BoxDied(f"the box died: {_ending(goes)}") from None
        if answers:
            self._keep(way, goes._replace(stays=len(way) <= BRANCHED_FROM))
        else:
            _buried(goes)
        return said

    def _keep(self, way: Way, keeper: _Keeper) -> None:
        if way in self._kept:
            self._end(way)
        self._kept[way] = keeper
        while (gone := outdated(self._kept, self._room, way)) is not None:
            self._end(gone)

    def _end(self, way: Way) -> None:
        """Let a position go, and the branches that begin there: their processes end with it."""
        for gone in [other for other in self._kept if other[: len(way)] == way]:
            keeper = self._kept.pop(gone)
            os.kill(keeper.pid, signal.SIGKILL)
            _buried(keeper)
            keeper.channel.close()


def _welcome(channel: Connection, parent: Connection | None) -> _Keeper:
    """The process that has just begun at the other end."""
    try:
        return _Keeper(channel.recv(), channel, parent, stays=False)
    except EOFError:
        raise BoxDied("the box could not be forked") from None


def _wait(keeper: _Keeper) -> None:
    """Wait for an answer: a dead process that left others behind, which hold its end of the pipe open, gives none."""
    while not keeper.channel.poll(LOOK_S):
        if has_ended(keeper.pid) and not keeper.channel.poll():
            raise EOFError


def _ending(keeper: _Keeper) -> str:
    """How a process ended, and its last words: it shares standard error with this one."""
    return how_it_ended(os.waitstatus_to_exitcode(_buried(keeper)), Path("/proc/self/fd/2"))


def _buried(keeper: _Keeper) -> int:
    """The exit status of a process that ends; its parent knows, or, where that is gone, this process."""
    if keeper.parent is not None and not keeper.parent.closed:
        with suppress(EOFError, ConnectionError):
            keeper.parent.send(_Bury(keeper.pid))
            return int(keeper.parent.recv())
    return os.waitpid(keeper.pid, 0)[1]


def main() -> None:
    """The nursery's whole life: ``sys.argv`` holds the pipe's descriptor and its parent's process id."""
    die_with_parent(int(sys.argv[2]))
    adopt_orphans()
    pipe = Connection(int(sys.argv[1]))
    sys.path[:] = pipe.recv()
    nursery = _Nursery(*pipe.recv())
    while True:
        try:
            way, action = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send_bytes(nursery.act(way, action))
        except Exception as error:
            pipe.send_bytes(_pickled(_Raised(error)))


# A box in its process


def _keep(box: Any, channel: Connection) -> None:
    """Wait at a position; go on from it, or let a fork begin there."""
    while True:
        try:
            asked = channel.recv()
            if isinstance(asked, _Fork):
                channel = _forked(channel, Connection(reduction.recv_handle(channel)))
            elif isinstance(asked, _Bury):
                channel.send(os.waitpid(asked.pid, 0)[1])
            else:
                _told(channel, lambda: asked(box), lambda answer: answer)  # noqa: B023 - called at once
        except EOFError:
            os._exit(0)


def _forked(channel: Connection, theirs: Connection) -> Connection:
    """Fork; the channel that each of the two goes on with."""
    gc.freeze()  # collecting what is there already would copy its pages
    parent = os.getpid()
    if os.fork():
        theirs.close()
        return channel
    die_with_parent(parent)
    channel.close()
    theirs.send(os.getpid())
    return theirs


def _told(channel: Connection, what: Callable[[], T], tell: Callable[[T], Any]) -> T:
    """Do it and tell whether this process stays, and the answer; one that raises tells that and ends."""
    try:
        answer = what()
        threads = len(os.listdir("/proc/self/task"))
        if threads > 1:
            raise CannotFork(f"the box runs {threads - 1} threads of its own: it cannot be forked")
    except Exception as error:
        channel.send(False)
        channel.send_bytes(_pickled(_Raised(error)))
        os._exit(0)
    channel.send(True)
    channel.send_bytes(_pickled(_Answer(tell(answer))))
    return answer


def _pickled(answer: _Answer | _Raised) -> bytes:
    try:
        return pickle.dumps(answer)
    except Exception as error:
        return pickle.dumps(_Raised(RuntimeError(f"an answer that cannot be sent: {error}")))
