"""A process in which foreign files are opened and parsed: a crash, a hang or a bomb in one costs that file alone.

The host asks functions by name; the process answers over a pipe, large arrays through memory that both see. It may
use a bounded amount of memory and time, and it ends with its host, whatever the host dies of.
"""

from __future__ import annotations

import atexit
import importlib
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import SeqsweepError
from ..states.processes import die_with_parent, how_it_ended

SHARED_BYTES = 16 << 20
"""Memory that both sides see: arrays come back through it, a piece at a time."""

MEMORY_BYTES = 3 << 30
MEMORY_PER_BYTE = 24
"""Address space for a file: for the libraries, and per byte of the file, never more than the machine has."""

TIME_S = 40.0
BYTES_PER_S = 1e6
"""Wall time for one question about a file: so much, and a second more for each of so many bytes."""

MOST_FILES = 100
"""A process that has served so many files is replaced: libraries leak."""

MOST_IDLE = 2
MOST_CHARACTERS = 160
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ForeignFileError(SeqsweepError):
    """A file on which its reader crashed, hung, outgrew its memory or gave up with an error of its own."""


class _Escaped(NamedTuple):
    """An exception that no reader foresaw, in words."""

    words: str


class Sandbox:
    """One process for foreign files. Use `sandbox`, which lends out idle ones."""

    def __init__(self) -> None:
        self._pipe, theirs = Pipe()
        self._shared = tempfile.TemporaryFile()  # noqa: SIM115  it has no name: nothing is left behind
        self._shared.truncate(SHARED_BYTES)
        self.shared = mmap.mmap(self._shared.fileno(), SHARED_BYTES)
        descriptors = [theirs.fileno(), self._shared.fileno()]
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import main; main()", *map(str, descriptors), str(os.getpid())],
            pass_fds=descriptors,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
            process_group=0,  # Ctrl-C is for the host
        )
        theirs.close()
        self._files, self.healthy = 0, True

    @property
    def fit(self) -> bool:
        """Whether another file may be given to it."""
        return self.healthy and self._files < MOST_FILES and self._process.poll() is None

    def count(self) -> None:
        """One more file is served."""
        self._files += 1

    def ask(self, path: Path, target: str, *arguments: Any) -> Any:
        """What the function ``target`` ("module:function") answers about the file ``path``.

        Raises
        ------
        SeqsweepError
            What the function raised of this kind; `ForeignFileError` where it did not end in order.
        """
        size = _size(path)
        timeout_s = TIME_S + size / BYTES_PER_S
        self.healthy = False  # until the answer is here
        try:
            self._pipe.send((target, arguments, size))
            if not self._pipe.poll(timeout_s):
                raise ForeignFileError(
                    f"{path}: not read within {timeout_s:.0f} s: damaged, or not what its suffix says"
                )
            answer = self._pipe.recv()
        except (EOFError, ConnectionError):
            raise ForeignFileError(f"{path}: the reader crashed on it ({self._death()}): the file is damaged") from None
        if isinstance(answer, _Escaped):
            raise ForeignFileError(f"{path}: {answer.words}")
        self.healthy = True
        try:
            if isinstance(answer, SeqsweepError):
                raise answer
            return answer
        finally:
            del answer  # its traceback holds this frame: a circle would keep the recording, and so this process, alive

    def end(self) -> None:
        """End the process."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._pipe.close()
        with suppress(BufferError):  # somebody still looks at a piece: it goes with the last look
            self.shared.close()
        self._shared.close()

    def _death(self) -> str:
        try:
            return how_it_ended(self._process.wait(1.0))
        except subprocess.TimeoutExpired:
            return "it closed its pipe"


_idle: list[Sandbox] = []
_lock = threading.RLock()
"""Reentrant: a recording that is thrown away gives its process back at any moment, even within `borrow`."""


def borrow() -> Sandbox:
    """A process that nobody uses, an idle one if there is one."""
    one = _fit_one() or Sandbox()
    one.count()
    return one


def _fit_one() -> Sandbox | None:
    """An idle process that may be given another file; those that may not are ended."""
    while True:
        with _lock:
            idle = _idle.pop() if _idle else None
        if idle is None or idle.fit:
            return idle
        idle.end()


def give_back(used: Sandbox) -> None:
    """Return a process; one that is not fit for another file is ended."""
    with _lock:
        keep = used.fit and len(_idle) < MOST_IDLE
        if keep:
            _idle.append(used)
    if not keep:
        used.end()


@contextmanager
def sandbox() -> Iterator[Sandbox]:
    """A process for a moment."""
    one = borrow()
    try:
        yield one
    finally:
        give_back(one)


def apart(path: Path, target: str, *arguments: Any) -> Any:
    """`Sandbox.ask` in a process for this one question; paths among ``arguments`` should be absolute."""
    with sandbox() as one:
        return one.ask(path, target, *arguments)


@atexit.register
def _end_all() -> None:
    while _idle:
        _idle.pop().end()


def _after_fork() -> None:
    """A forked process owns none of its parent's."""
    _idle.clear()


os.register_at_fork(after_in_child=_after_fork)


def _size(path: Path) -> int:
    """Bytes of a file and its companions of the same name (.cfg and .dat)."""
    with suppress(OSError):
        return sum(
            each.stat().st_size for each in {path, path.with_suffix(".dat"), path.with_suffix(".DAT")} if each.is_file()
        )
    return 0


# In the process

shared: mmap.mmap
"""The memory that both sides see."""


def main() -> None:
    """The whole life of the process: ``sys.argv`` holds the pipe, the shared file and the host's process id."""
    global shared
    pipe_at, shared_at, parent = (int(word) for word in sys.argv[1:4])
    die_with_parent(parent)
    _no_core_dumps()
    shared = mmap.mmap(shared_at, SHARED_BYTES)
    pipe = Connection(pipe_at)
    grown_from = _address_space()
    while True:
        try:
            target, arguments, size = pipe.recv()
        except EOFError:
            return
        _limit_memory(grown_from + MEMORY_BYTES + MEMORY_PER_BYTE * size)
        pipe.send(_answer(target, arguments))


def _answer(target: str, arguments: tuple[Any, ...]) -> Any:
    module, name = target.split(":")
    try:
        return getattr(importlib.import_module(module), name)(*arguments)
    except SeqsweepError as error:
        return error
    except MemoryError:
        return _Escaped("does not fit into the memory that a file may use: damaged, or cut it into several files")
    except BaseException as error:  # whatever foreign bytes provoke in the libraries, SystemExit included
        return _Escaped(_in_words(error))


def _in_words(error: BaseException) -> str:
    """Type, message and place of an error, on one line."""
    frames = traceback.extract_tb(error.__traceback__)
    where = Path(frames[-1].filename).stem if frames else "?"
    text = " ".join(str(error).split())[:MOST_CHARACTERS]
    return f"damaged, or not what its suffix says ({type(error).__name__} in {where}{': ' + text if text else ''})"


def _limit_memory(n_bytes: int) -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource

        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = max(MEMORY_BYTES, min(n_bytes, machine))
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard < 0 else min(limit, hard), hard))


def _no_core_dumps() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _address_space() -> int:
    with suppress(OSError):
        return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    return 1 << 30
