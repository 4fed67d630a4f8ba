"""Batches to workers: threads that share a host, processes (joblib), or other machines; what is lost is begun anew."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from itertools import islice
from math import ceil
from typing import Any, NamedTuple, TypeVar

from ...plant.errors import SeqsweepError
from ...plant.protocol import LanePlant, PhasorPlant, Plant
from ...plant.registry import PlantCard, releases_gil
from ...plant.states.processes import die_with_parent
from ..measure.rows import BatchResult
from ..plan import EXPECTED_WINDOWS, Batch, Hosting, Plan
from .asked import Batches
from .host import Say, host_at_hand, host_of, silent
from .spare import end_spares

RESTARTS = 3
"""How often a pool that lost a worker is started anew before the batch is given up."""


TOGETHER, MOST_TOGETHER = 4, 16
"""Fewest and most batches of a compiled plant that a thread measures together, if it does: the longest pairs of shots
of the fewest fill its lanes."""

FEW = 4
"""A thread is to find so many tasks at least, or the last one keeps the others waiting."""

MOST_STEPS = 1e7
"""Steps of all shots that a thread takes at once where batches are few: about 0.15 s of the reference turbine. Who is
interrupted, or loses a worker, loses no more."""

LAST_LANES = 4
"""Lanes that the longest shots of a batch leave idle on an average of their time, when all others are over."""

T = TypeVar("T")
R = TypeVar("R")


class RunError(SeqsweepError):
    """A run that cannot begin as it was called."""


Work = Callable[[Sequence[Batch]], list[tuple[str, BatchResult]]]
"""What a worker does with some batches: their keys, for what comes back out of order, and their results."""

WORKERS_S = 30.0
"""How long (s) a scheduler without a worker is waited for."""


class Workers(NamedTuple):
    """How many work at once, and as what (None: as suits the plant); ``say`` takes lines on what is waited for."""

    jobs: int
    backend: str | None
    scheduler: str | None
    say: Say = silent

    def backend_for(self, plan: Plan, plant: Plant | PlantCard) -> str:
        """The backend that was asked for, else threads for plants that release the lock or run isolated."""
        return self.backend or ("threading" if plan.hosting.isolate or releases_gil(plant) else "loky")


Pool = Callable[[Batches], Generator[tuple[Batch, BatchResult], None, None]]
"""Brings the results of batches as they come; a lost worker costs what it was at.

Raises ``OSError`` if workers die again and again, `RunError` if the backend is not to be had.
"""

Asking = Callable[[Batches], Iterator[tuple[str, BatchResult]]]
"""Batches to workers that may be lost: keys and results as they come."""


@contextmanager
def pool(plan: Plan, plant: Plant | PlantCard, workers: Workers) -> Iterator[Pool]:
    """One `Pool` for all rounds of a campaign; its workers begin with the first batch, and go with the block."""
    backend = workers.backend_for(plan, plant)
    begun: list[Asking] = []
    with ExitStack() as stack:

        def results(batches: Batches) -> Generator[tuple[Batch, BatchResult], None, None]:
            left = _Left(batches)
            if len(left) and not begun:
                begun.append(stack.enter_context(_asking(plan, plant, workers, backend)))
            for _ in range(1 + RESTARTS):
                if not len(left):
                    return
                try:
                    for key, result in begun[0](left):
                        yield left.taken(key), result
                except _lost_workers(backend):
                    continue
            if len(left):
                raise OSError(f"workers died {1 + RESTARTS} times in a row; {len(left)} batches are left")

        yield results


class _Left:
    """Batches without a result: first those that workers had when they were lost, then all that nobody asked for yet.

    Only what workers have at this moment is kept.
    """

    def __init__(self, batches: Batches):
        self._coming, self._n = iter(batches), len(batches)
        self._under_way: dict[str, Batch] = {}

    def __len__(self) -> int:
        return self._n

    def __iter__(self) -> Iterator[Batch]:
        yield from list(self._under_way.values())
        for batch in self._coming:
            self._under_way[batch.key] = batch
            yield batch

    def taken(self, key: str) -> Batch:
        """The batch whose result is there."""
        self._n -= 1
        return self._under_way.pop(key)


def _lost_workers(backend: str) -> tuple[type[BaseException], ...]:
    """What a pool raises when a worker is gone; resolved late, these imports are slow."""
    if backend == "loky":
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        return (TerminatedWorkerError,)
    if backend == "dask":
        from distributed.scheduler import KilledWorker

        return (KilledWorker,)
    return ()


@contextmanager
def _asking(plan: Plan, plant: Plant | PlantCard, workers: Workers, backend: str) -> Iterator[Asking]:
    """The workers of a backend, for as long as they are needed."""
    if backend in ("dask", "loky"):
        end_spares()
    bundles = partial(_bundles, workers.jobs, plant)
    if backend == "dask":
        with _dask_client(workers.jobs, workers.scheduler) as client:
            work = partial(_on_worker, plan.hosting)
            yield lambda batches: _on_cluster(client, work, workers.jobs, _for_cluster(client, plant, batches))
    elif backend == "loky":
        work = partial(_in_process, plan.hosting)
        yield lambda batches: _in_processes(work, workers.jobs, bundles(batches))
    else:
        with host_at_hand(plant, plan.hosting).measuring(workers.jobs, workers.say) as measure:
            yield lambda batches: _one_after_other(
                _in_threads(lambda bundle: _named(bundle, measure(bundle)), bundles(batches), workers.jobs)
            )


def _one_after_other(coming: Generator[Sequence[T], None, None]) -> Iterator[T]:
    """What is in the bundles, as they come; who stops listening stops them at once."""
    with closing(coming):
        for bundle in coming:
            yield from bundle


def _named(batches: Sequence[Batch], results: Sequence[BatchResult]) -> list[tuple[str, BatchResult]]:
    return [(batch.key, result) for batch, result in zip(batches, results, strict=True)]


def _bundles(jobs: int, plant: Plant | PlantCard, batches: Batches) -> Iterator[list[Batch]]:
    """What a worker takes at once: of a compiled plant several batches, where enough are left for all workers.

    The last shots of an operating point leave lanes idle; those of several fill them. Where there are too few for
    that, each worker gets some of about the same work, if the plant is as quick as one that is stepped in lanes.
    """
    compiled = isinstance(plant, PhasorPlant) and releases_gil(plant)
    if compiled and isinstance(plant, LanePlant) and len(batches) < TOGETHER * FEW * jobs:
        yield from _shared_out(jobs, list(batches))
        return
    n, coming = together(len(batches), jobs) if compiled else 1, iter(batches)
    while bundle := list(islice(coming, n)):
        yield bundle


def _shared_out(jobs: int, batches: Sequence[Batch]) -> list[list[Batch]]:
    """As many bundles as there are workers, or a multiple of it, of about the same work, each in the batches' order."""
    steps = [_steps(batch) for batch in batches]
    n_bundles = min(jobs * ceil(sum(steps) / (jobs * MOST_STEPS)), len(batches))
    taken, work = [0] * len(batches), [0.0] * n_bundles
    for k in sorted(range(len(batches)), key=lambda k: -steps[k]):
        taken[k] = work.index(min(work))
        work[taken[k]] += steps[k]
    return [[batch for batch, into in zip(batches, taken, strict=True) if into == n] for n in range(n_bundles)]


def _steps(batch: Batch) -> float:
    """Steps to expect of all shots of a batch, those of lanes that its longest ones leave idle among them."""
    blocks = [window.n_blocks for of_point in batch.aims for _, window in of_point]
    blocks = blocks or [batch.points[0].window_blocks] * len(batch.plays)
    return EXPECTED_WINDOWS * (sum(blocks) + LAST_LANES * max(blocks)) * batch.block.steps


def _for_cluster(client: Any, plant: Plant | PlantCard, batches: Batches) -> Iterator[list[Batch]]:
    """Bundles for the workers that the cluster has at that moment: a named one may have more than ``jobs``."""
    yield from _bundles(max(1, sum(client.nthreads().values())), plant, batches)


def together(n_batches: int, jobs: int) -> int:
    """How many of so many batches of a compiled plant a thread takes at once."""
    n = min(n_batches // (FEW * jobs), MOST_TOGETHER)
    return n if n >= TOGETHER else 1


def _in_threads(work: Callable[[T], R], tasks: Iterable[T], jobs: int) -> Generator[R, None, None]:
    """Results as they come; a few tasks wait for each thread, and who stops listening stops the rest."""
    if jobs == 1:
        yield from map(work, tasks)
        return
    coming, pool = iter(tasks), ThreadPoolExecutor(jobs)
    waiting: set[Future[R]] = set()
    try:
        while True:
            waiting |= {pool.submit(work, task) for task in islice(coming, 3 * jobs - len(waiting))}
            if not waiting:
                return
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _in_processes(work: Work, jobs: int, bundles: Iterable[list[Batch]]) -> Iterator[tuple[str, BatchResult]]:
    """Batches to processes of our own: such a one would wait minutes for a runner that was killed, and goes with it."""
    from joblib import delayed, parallel_config
    from joblib.externals.loky.backend import resource_tracker

    _begin(resource_tracker)
    with parallel_config(backend="loky", n_jobs=jobs, initializer=die_with_parent, initargs=(os.getpid(),)):
        with _deaf():
            coming = _joblib()(delayed(work)(bundle) for bundle in bundles)
        yield from _one_after_other(coming)


@contextmanager
def _deaf() -> Iterator[None]:
    """Processes begun in the block do not hear Ctrl-C, which a terminal sends to them too: their runner ends them.

    Nor do those that its threads begin later. Python itself would print where it was, also while it starts.
    """
    from multiprocessing import resource_tracker

    _begin(resource_tracker)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(tracker: Any) -> None:
    """Begin the process that removes locks and folders of processes that are gone; it is to do so without a word.

    Begun later, within `_deaf`, it would make its parent hear again.
    """
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = "ignore"
    try:
        tracker.ensure_running()
    finally:
        os.environ.pop("PYTHONWARNINGS") if before is None else os.environ.update(PYTHONWARNINGS=before)


def _joblib() -> Any:
    from joblib import Parallel

    return Parallel(return_as="generator_unordered", pre_dispatch="3*n_jobs", batch_size=1)


def _on_cluster(
    client: Any, work: Work, jobs: int, bundles: Iterable[list[Batch]]
) -> Iterator[tuple[str, BatchResult]]:
    """Batches on a dask cluster; a scheduler that goes is a failure of the machine, and what was measured is kept.

    joblib takes a cluster of one slot for no cluster at all and would work in this process: such a one is asked
    without joblib.
    """
    from asyncio import CancelledError as Cancelled
    from concurrent.futures import CancelledError

    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError
    from joblib import delayed, parallel_config

    try:
        if sum(client.nthreads().values()) == 1:
            yield from _one_after_other(_one_by_one(client, work, bundles))
        else:
            with parallel_config(backend="dask", n_jobs=jobs):
                yield from _one_after_other(_joblib()(delayed(work)(bundle) for bundle in bundles))
    except (CommClosedError, FutureCancelledError, CancelledError, Cancelled) as error:
        raise OSError(f"the dask scheduler at {client.scheduler.address} is gone: {error or 'no answer'}") from None


def _one_by_one(
    client: Any, work: Work, bundles: Iterable[list[Batch]]
) -> Generator[list[tuple[str, BatchResult]], None, None]:
    """A few bundles wait at the scheduler, and each that is done lets another follow."""
    from distributed import as_completed

    coming = (client.submit(work, bundle, pure=False) for bundle in bundles)
    waiting = as_completed(list(islice(coming, 3)))
    for future in waiting:
        waiting.update(list(islice(coming, 1)))
        yield future.result()


@contextmanager
def _dask_client(jobs: int, scheduler: str | None) -> Iterator[Any]:
    """A client of the scheduler, or of a cluster of our own with ``jobs`` processes."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise RunError("backend dask needs the extra: pip install 'seqsweep[dask]'") from None
    logging.disable(logging.CRITICAL)  # a cluster that goes logs tracebacks from its own threads; here it is one line
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s", set_as_default=True)
        except (OSError, TimeoutError, ValueError) as error:
            raise RunError(f"no dask scheduler answers at {scheduler}: {error}") from None
        with client:
            try:
                client.wait_for_workers(1, timeout=WORKERS_S)
            except TimeoutError:
                raise RunError(
                    f"the dask scheduler at {scheduler} has no worker after {WORKERS_S:g} s: start one, or name another"
                ) from None
            yield client
        return
    with _begun(LocalCluster, jobs) as cluster, Client(cluster, set_as_default=True) as client:
        yield client


def _begun(local_cluster: Any, jobs: int) -> Any:
    """A cluster of our own; where one of its processes is killed while it starts, it is started anew."""
    any_port = {"dashboard_address": ":0"}  # without a dashboard the scheduler takes its port all the same
    settings = {"dashboard_address": None, "scheduler_kwargs": any_port, "silence_logs": 50}
    said = ""
    for _ in range(1 + RESTARTS):
        try:
            with _deaf():
                return local_cluster(n_workers=jobs, threads_per_worker=1, **settings)
        except RuntimeError as error:
            said = str(error)
    raise OSError(f"dask could not start its workers {1 + RESTARTS} times in a row: {said}")


def _in_process(hosting: Hosting, batches: Sequence[Batch]) -> list[tuple[str, BatchResult]]:
    with host_of(hosting).measuring(1) as measure:
        return _named(batches, measure(batches))


def _on_worker(hosting: Hosting, batches: Sequence[Batch]) -> list[tuple[str, BatchResult]]:
    """In a worker of dask: whose scheduler goes may find its own client's loop closed, and is to say nothing of it."""
    sys.unraisablehook = _nothing
    return _in_process(hosting, batches)


def _nothing(what: object) -> None:
    """For `sys.unraisablehook`."""
