"""Batches through joblib: threads that share a host, processes, or other machines; what is lost is begun anew.

Only this module knows joblib, with the one that identifies recordings.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import NamedTuple

from ...plant.errors import SeqsweepError
from ...plant.protocol import Plant
from ...plant.registry import PlantCard, releases_gil
from ...plant.states.processes import die_with_parent
from ..measure.rows import BatchResult
from ..plan import Batch, Hosting, Plan
from .host import host_at_hand, host_of

RESTARTS = 3
"""How often a pool that lost a worker is started anew before the batch is given up."""


class RunError(SeqsweepError):
    """A run that cannot begin as it was called."""


class Workers(NamedTuple):
    """How many work at once, and as what; None: as suits the plant."""

    jobs: int
    backend: str | None
    scheduler: str | None

    def backend_for(self, plan: Plan, plant: Plant | PlantCard) -> str:
        """The backend that was asked for, else threads for plants that release the lock or run isolated."""
        return self.backend or ("threading" if plan.hosting.isolate or releases_gil(plant) else "loky")


def results(
    plan: Plan, plant: Plant | PlantCard, batches: Sequence[Batch], workers: Workers
) -> Iterator[tuple[Batch, BatchResult]]:
    """Results of batches as they come; a lost worker costs what it was at.

    Raises
    ------
    OSError
        If workers die again and again.
    RunError
        If the backend is not to be had.
    """
    left = {batch.key: batch for batch in batches}
    for _ in range(1 + RESTARTS):
        if not left:
            return
        try:
            for key, result in _parallel(plan, plant, list(left.values()), workers):
                yield left.pop(key), result
        except _lost_workers(workers.backend_for(plan, plant)):
            continue
    if left:
        raise OSError(f"workers died {1 + RESTARTS} times in a row; {len(left)} batches are left")


def _lost_workers(backend: str) -> tuple[type[BaseException], ...]:
    """What a pool raises when a worker is gone; resolved late, these imports are slow."""
    if backend == "loky":
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        return (TerminatedWorkerError,)
    if backend == "dask":
        from distributed.scheduler import KilledWorker

        return (KilledWorker,)
    return ()


def _parallel(
    plan: Plan, plant: Plant | PlantCard, batches: Sequence[Batch], workers: Workers
) -> Iterator[tuple[str, BatchResult]]:
    from joblib import Parallel, delayed, parallel_config

    jobs, backend = workers.jobs, workers.backend_for(plan, plant)
    cluster = _dask_client(jobs, workers.scheduler) if backend == "dask" else nullcontext()
    with cluster, _worker(plan, plant, jobs, backend) as work, parallel_config(backend=backend, n_jobs=jobs):
        pool = Parallel(return_as="generator_unordered", pre_dispatch="3*n_jobs", batch_size=1)
        yield from pool(delayed(work)(batch) for batch in batches)


@contextmanager
def _dask_client(jobs: int, scheduler: str | None) -> Iterator[None]:
    """A client of the scheduler, or of a cluster of our own with ``jobs`` processes."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise RunError("backend dask needs the extra: pip install 'seqsweep[dask]'") from None
    if scheduler is not None:
        try:
            with Client(scheduler, timeout="10s", set_as_default=True):
                yield
        except (OSError, TimeoutError) as error:
            raise RunError(f"no dask scheduler answers at {scheduler}: {error}") from None
        return
    with (
        LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster,
        Client(cluster, set_as_default=True),
    ):
        yield


@contextmanager
def _worker(
    plan: Plan, plant: Plant | PlantCard, jobs: int, backend: str
) -> Iterator[Callable[[Batch], tuple[str, BatchResult]]]:
    """The task of a batch: threads share a host, processes make their own."""
    if backend == "loky":
        yield partial(_in_child, plan.hosting)
    elif backend == "dask":
        yield partial(_in_process, plan.hosting)
    else:
        with host_at_hand(plant, plan.hosting).measuring(jobs) as measure:
            yield lambda batch: (batch.key, measure(batch))


def _in_child(hosting: Hosting, batch: Batch) -> tuple[str, BatchResult]:
    """A process of our own would wait minutes for a runner that was killed: it goes with it."""
    die_with_parent(os.getppid())
    return _in_process(hosting, batch)


def _in_process(hosting: Hosting, batch: Batch) -> tuple[str, BatchResult]:
    with host_of(hosting).measuring(1) as measure:
        return batch.key, measure(batch)
