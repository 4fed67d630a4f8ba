"""A plant in a process of its own: a crash or a hang costs the points that caused it, nothing else.

The runner's threads lend each other a few children. A child serves batch after batch over a pipe; one
that dies or overruns its time is replaced, and its batch is measured again point by point, so that
the reason lands on the right rows.
"""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection, Pipe
from typing import IO

from .measure import measure
from .plan import Batch, Plan
from .rows import BatchResult, failed_batch

DEFAULT_TIMEOUT_S = 60.0
"""Wall time (s) that one shot may take, where the campaign does not say."""

START_S = 60.0
"""Wall time (s) that a child may take to import and build its plant, once."""


class ChildFailed(Exception):
    """A child died or overran its time; the message is the reason of the rows."""


class Children:
    """As many children as there are workers; `measure` may be called from any thread.

    Parameters
    ----------
    plan : Plan
        What is measured.
    n_children : int
        How many at once; they are started when first needed.
    """

    def __init__(self, plan: Plan, n_children: int):
        self._plan = plan
        self._idle: queue.SimpleQueue[_Child | None] = queue.SimpleQueue()
        for _ in range(n_children):
            self._idle.put(None)
        self._timeout_s = plan.timeout_s or DEFAULT_TIMEOUT_S

    def measure(self, batch: Batch) -> BatchResult:
        """`measure` in a child; rows whose plant crashed or hung are "failed" with the reason."""
        try:
            return self._ask(batch)
        except ChildFailed as failure:
            if len(batch.points) == 1:
                return failed_batch(self._plan.at(batch.amplitude_pu), batch, "failed", str(failure))
        parts = [self.measure(replace(batch, points=(point,))) for point in batch.points]
        condition = next((part.condition for part in parts if part.condition), {})
        return BatchResult(tuple(row for part in parts for row in part.rows), condition)

    def close(self) -> None:
        """End every idle child."""
        while True:
            try:
                child = self._idle.get_nowait()
            except queue.Empty:
                return
            if child is not None:
                child.kill()

    def _ask(self, batch: Batch) -> BatchResult:
        child = self._idle.get()
        try:
            child = child or _Child(self._plan)
            return child.ask(batch, self._timeout_s * 2 * len(batch.points))
        except ChildFailed:
            if child is not None:
                child.kill()
            child = None
            raise
        finally:
            self._idle.put(child)


@contextmanager
def children(plan: Plan, n_children: int) -> Iterator[Children]:
    """Children for a campaign; none of them outlives the block."""
    lent = Children(plan, n_children)
    try:
        yield lent
    finally:
        lent.close()


class _Child:
    """One process and the pipe to it."""

    def __init__(self, plan: Plan):
        self._pipe, theirs = Pipe()
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", "seqsweep.sweep.isolate", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=self._said,
        )
        theirs.close()
        self._exchange(plan, START_S, "building the plant")

    def ask(self, batch: Batch, timeout_s: float) -> BatchResult:
        answer = self._exchange(batch, timeout_s, "the shot")
        assert isinstance(answer, BatchResult)
        return answer

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._pipe.close()
        self._said.close()

    def _exchange(self, question: object, timeout_s: float, what: str) -> object:
        try:
            self._pipe.send(question)
            if not self._pipe.poll(timeout_s):
                raise ChildFailed(f"{what} took longer than {timeout_s:g} s of wall time (plant.timeout_s a shot)")
            answer = self._pipe.recv()
        except (EOFError, ConnectionError):
            raise ChildFailed(f"the plant's process died: {self._death()}") from None
        if isinstance(answer, str):
            raise ChildFailed(answer)
        return answer

    def _death(self) -> str:
        code = self._process.wait()
        how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        self._said.seek(0)
        words = self._said.read().decode(errors="replace").strip().splitlines()
        return f"{how}, last words {words[-1][:200]!r}" if words else how


def _serve(pipe: Connection) -> None:
    """The child: build the plant, then answer batch after batch until the pipe closes."""
    die_with_parent()
    plan: Plan = pipe.recv()
    try:
        plant = plan.spec.make()
    except Exception as error:
        pipe.send(f"{type(error).__name__}: {error}")
        return
    pipe.send(None)
    while True:
        try:
            batch = pipe.recv()
        except EOFError:
            return
        pipe.send(measure(plant, plan, batch))


def die_with_parent() -> None:
    """Ask Linux to end this process with the runner, even while it is deep in a plant."""
    if sys.platform == "linux":
        import ctypes

        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
