"""A process that holds a plant, and the pipe to it: foreign code never runs in the runner.

A question is a function of the plant, named at module level so that it can be sent; its answer comes
back over the pipe. A child that dies, overruns its time or sends rubbish raises `ChildFailed`.
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import NamedTuple, TypeVar

from ...plant.errors import is_without_room, reason_of
from ...plant.protocol import Plant
from ...plant.registry import PlantCard, PlantError, PlantSpec, card_of
from ...plant.states.processes import adopting_orphans, bury, die_with_parent, how_it_ended, most_memory_mb
from .heartbeat import Beat, Waiting, beating

T = TypeVar("T")

START_S = 60.0
"""Wall time (s) that a child may take to import and build its plant, once."""

SAID_BYTES = 1 << 20
"""What a plant prints is kept for its last words, and forgotten above this size."""

DEFAULT_MEMORY_MB = 4096.0
"""Memory (MB) that a process of a plant may use, where the campaign does not say."""

LOOK_S = 0.2
"""Wall time (s) after which a child that has not answered is looked after."""

_SCRATCH = "seqsweep-run-"
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""A child is one worker; and a process that forks must have no other thread."""


class ChildFailed(Exception):
    """A child died, overran its time or could not answer; the message is the reason of the rows.

    Attributes
    ----------
    killed : bool
        Whether somebody else killed it (SIGKILL): no plant does that to itself, a machine without memory does.
    """

    def __init__(self, reason: str, killed: bool = False):
        super().__init__(reason)
        self.killed = killed


class _Trouble(NamedTuple):
    """What a child says where it has no answer; ``errno`` where the machine failed it."""

    words: str
    errno: int | None = None

    def error(self, of_the_plant: type[Exception]) -> Exception:
        """What is to be raised: a failure of the machine, or one of the plant."""
        return of_the_plant(self.words) if self.errno is None else OSError(self.errno, self.words)


class Child:
    """One process with one plant.

    Parameters
    ----------
    spec : PlantSpec
        The plant.
    folder : path
        Where the child and its plant may leave temporary files.
    memory_mb : float
        Memory (MB) that a process of it may use; may be changed between two questions.

    Raises
    ------
    ChildFailed
        If the process ends or hangs while it builds the plant.
    PlantError
        If there is no such plant, or it cannot be made from these parameters.
    OSError
        If the machine does not let it be made.
    """

    card: PlantCard

    def __init__(self, spec: PlantSpec, folder: Path, memory_mb: float = DEFAULT_MEMORY_MB):
        self.memory_mb = memory_mb
        self._pipe, theirs = Pipe()
        descriptor, name = tempfile.mkstemp(prefix="said-", dir=folder)
        os.close(descriptor)
        self._said = Path(name)
        with self._said.open("ab") as said:
            self._process = subprocess.Popen(
                [sys.executable, "-c", f"from {__name__} import main; main()", str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                env={**os.environ, **_ONE_THREAD, "TMPDIR": str(folder)},
                process_group=0,
            )
        theirs.close()
        try:
            answer = self._exchange(spec, START_S, f"building the plant took longer than {START_S:g} s of wall time")
            if isinstance(answer, _Trouble):
                raise answer.error(PlantError)
        except BaseException:
            self.kill()
            raise
        assert isinstance(answer, PlantCard)
        self.card = answer

    def ask(self, question: Callable[[Plant], T], timeout_s: float, late: str, waiting: Waiting | None = None) -> T:
        """``question(plant)``, answered within ``timeout_s`` (s); ``late`` is the reason where it is not.

        ``waiting`` is told of the shots that the plant is at, and how long they take.

        Raises
        ------
        ChildFailed
            If there is no answer. The child is of no further use then, but for its last words.
        OSError
            If the disk is full.
        """
        answer = self._exchange(question, timeout_s, late, waiting)
        if isinstance(answer, _Trouble):
            raise answer.error(ChildFailed)
        return answer  # type: ignore[return-value]

    @property
    def is_alive(self) -> bool:
        """Whether its process is there."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End the process and whatever it has started in its process group."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        bury(self._process.pid)
        self._pipe.close()
        self._said.unlink(missing_ok=True)

    def _exchange(self, question: object, timeout_s: float, late: str, waiting: Waiting | None = None) -> object:
        try:
            self._pipe.send(question)
            end = time.monotonic() + timeout_s
            while True:
                self._wait(end, late, waiting)
                _forget_what_was_said(self._said)
                answer = self._pipe.recv()
                if not isinstance(answer, Beat):
                    return answer
                if waiting is not None:
                    waiting.beat(answer)
        except (EOFError, ConnectionError):
            death = self._death()
            raise ChildFailed(
                f"the plant's process died: {death}", self._process.returncode == -signal.SIGKILL
            ) from None
        except (pickle.PickleError, AttributeError, ImportError, IndexError, TypeError, ValueError) as error:
            raise ChildFailed(f"the plant's process sent rubbish: {type(error).__name__}: {error}") from None

    def _wait(self, end: float, late: str, waiting: Waiting | None) -> None:
        """Wait for a message until ``end`` (s, monotonic clock), and look after the child until it comes."""
        while not self._pipe.poll(max(0.0, min(LOOK_S, end - time.monotonic()))):
            if time.monotonic() >= end:
                raise ChildFailed(late)
            if not self.is_alive and not self._pipe.poll():  # others that it started hold its end of the pipe open
                raise EOFError
            if waiting is not None:
                waiting.look()
            _forget_what_was_said(self._said)
            used_mb = most_memory_mb(self._process.pid)
            if used_mb > self.memory_mb:
                raise ChildFailed(
                    f"a process of the plant used {used_mb:.0f} MB of memory; plant.memory_mb allows "
                    f"{self.memory_mb:g} MB"
                )

    def _death(self) -> str:
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        return how_it_ended(code, self._said)


@contextmanager
def child(spec: PlantSpec, memory_mb: float = DEFAULT_MEMORY_MB) -> Iterator[Child]:
    """A child for a moment, with a folder of its own."""
    with scratch() as folder:
        one = Child(spec, folder, memory_mb)
        try:
            yield one
        finally:
            one.kill()


def _forget_what_was_said(said: Path) -> None:
    """Before it fills the disk; whoever prints goes on behind what was forgotten."""
    if said.stat().st_size > SAID_BYTES:
        os.truncate(said, 0)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for the temporary files of one run; what runs that were killed have left is removed first."""
    _sweep_up()
    with (
        tempfile.TemporaryDirectory(prefix=_SCRATCH, ignore_cleanup_errors=True) as name,
        (Path(name) / "lock").open("w") as lock,
        adopting_orphans(),
    ):
        _locked(lock.fileno())
        yield Path(name)


def _sweep_up() -> None:
    """Folders whose owner is gone hold a lock that nobody has."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_SCRATCH}*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > 60.0 and _abandoned(folder / "lock"):
                shutil.rmtree(folder, ignore_errors=True)


def _abandoned(lock: Path) -> bool:
    if not lock.exists():
        return True
    with lock.open("r+") as file:
        return _locked(file.fileno())


def _locked(descriptor: int) -> bool:
    """Lock an open file for as long as it is open; False if somebody else has it."""
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


# In the child


def main() -> None:
    """The child's whole life: ``sys.argv`` holds the pipe's descriptor and the runner's process id."""
    die_with_parent(int(sys.argv[2]))
    _offer_to_the_memory_killer()
    _serve(Connection(int(sys.argv[1])))


def _offer_to_the_memory_killer() -> None:
    """Where memory runs out, a plant that leaks goes before anything else."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _serve(pipe: Connection) -> None:
    """Build the plant, show its card, then answer question after question until the pipe closes."""
    spec: PlantSpec = pipe.recv()
    try:
        plant = spec.make()
        beating(plant, pipe.send)
        pipe.send(card_of(plant, spec))
    except Exception as error:
        pipe.send(_trouble(error))
        return
    while True:
        try:
            question = pipe.recv()
        except EOFError:
            return
        pipe.send(_answer(plant, question))


def _answer(plant: Plant, question: Callable[[Plant], object]) -> object:
    try:
        return question(plant)
    except Exception as error:
        return _trouble(error)


def _trouble(error: Exception) -> _Trouble:
    if isinstance(error, OSError) and is_without_room(error):
        return _Trouble(f"{error.strerror}: {error.filename or 'while the plant was at work'}", error.errno)
    return _Trouble(reason_of(error))
