"""The campaign runner: batches through joblib, shards on the way, the table at the end.

The only module that knows joblib, with `identify_run`. The worker is one pure function, `measure`; everything that is
kept is written by the runner, so that workers may be threads, processes or other machines.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.fit.adaptive import Decision, decide
from ...identify.response import FrequencyResponse
from ...identify.table.format import QUALITY, unpack_covariance
from ...identify.table.write import write_table
from ...plant.errors import SeqsweepError
from ...plant.protocol import Plant
from ...plant.registry import PlantCard, releases_gil
from ...plant.states.processes import die_with_parent
from ..excitation.adaptive_rounds import certificate, certificate_text, next_round
from ..excitation.frequencies import Frequency
from ..measure.linearity import judged
from ..measure.proof import stable_on
from ..measure.rows import BatchResult, Row
from ..plan import Batch, Condition, Hosting, Plan
from . import shards
from .host import host_at_hand, host_of
from .pilots import chosen, parts, pilots

Report = Callable[[int, int, float], None]
"""Called with (points done, points in all, share of the work done) whenever a batch is kept."""

RESTARTS = 3
"""How often a pool that lost a worker is started anew before the batch is given up."""


class RunError(SeqsweepError):
    """A run that cannot begin as it was called."""


class Outcome(NamedTuple):
    """What a run left behind: rows by status, and what an adaptive grid has to say of each operating point."""

    statuses: dict[str, int]
    remarks: tuple[str, ...] = ()

    @property
    def all_ok(self) -> bool:
        return set(self.statuses) <= {"ok"}


def run(
    plan: Plan,
    plant: Plant | PlantCard,
    output: Path,
    *,
    jobs: int,
    backend: str | None = None,
    scheduler: str | None = None,
    discard: bool = False,
    report: Report = lambda done, total, share: None,
    say: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Measure every point of ``plan`` and write the table to ``output``; go on where a run was ended.

    Parameters
    ----------
    plan, plant
        What is asked, and of whom; a card is enough where the plan is isolated.
    output : path
        The Parquet table; shards are kept in ``OUTPUT.parts`` until it is written.
    jobs : int
        Workers.
    backend : "threading", "loky", "dask" or None
        None: threads for plants that release the interpreter lock or run isolated, processes for others.
    scheduler : str or None
        Address of a dask scheduler; None starts a local cluster.
    discard : bool
        Whether unfinished work of another campaign on this output may go.
    report : callable
        Progress.
    say : callable
        Called once, with a line of text, where an earlier run left something to go on with.

    Raises
    ------
    RunError
        If the shards beside the output are another campaign's, and are not to be discarded.
    OutputInUse
        If another run writes this output.
    OSError
        If the machine refuses; what was measured stays in the shards.
    """
    folder = shards.folder_of(output)
    with shards.locked(folder):
        if not discard:
            _refuse_strangers(plan, folder)
        swept = _swept(plan, plant, shards.Folder(folder), Workers(jobs, backend, scheduler), report, say)
        statuses: dict[str, int] = {}
        write_table(output, _counted(swept.responses(), statuses), swept.metadata())
        shards.remove(folder)
    return Outcome(statuses, swept.remarks)


def sweep_in_memory(
    plan: Plan,
    plant: Plant | PlantCard,
    *,
    jobs: int,
    backend: str | None = None,
    report: Report = lambda done, total, share: None,
) -> Swept:
    """`run` without a file: results are kept in memory, and nothing is left on the disk.

    Raises
    ------
    Interrupted
        If it is interrupted; with what was measured until then.
    """
    store = shards.Memory()
    try:
        return _swept(plan, plant, store, Workers(jobs, backend, None), report, lambda text: None)
    except KeyboardInterrupt:
        known = [batch for batch, result in store.kept.values() if batch.amplitude_pu == plan.amplitude_pu]
        raise Interrupted(Swept(plan, plant, store, known, {})) from None


class Interrupted(KeyboardInterrupt):
    """A sweep in memory that was interrupted.

    Attributes
    ----------
    swept : Swept
        What was measured until then.
    """

    def __init__(self, swept: Swept):
        super().__init__("interrupted")
        self.swept = swept


class Workers(NamedTuple):
    """How many work at once, and as what; None: as suits the plant."""

    jobs: int
    backend: str | None
    scheduler: str | None

    def backend_for(self, plan: Plan, plant: Plant | PlantCard) -> str:
        """The backend that was asked for, else threads for plants that release the lock or run isolated."""
        return self.backend or ("threading" if plan.hosting.isolate or releases_gil(plant) else "loky")


def _swept(
    plan: Plan,
    plant: Plant | PlantCard,
    store: shards.Store,
    workers: Workers,
    report: Report,
    say: Callable[[str], None],
) -> Swept:
    """Every batch of the plan measured, or found in the store."""
    bring = partial(_measure_missing, plant=plant, store=store, workers=workers, tell=_resumption(plan, say))
    batches, certificates = _measure_all(plan, store, bring, report)
    return Swept(plan, plant, store, batches, certificates)


def _counted(responses: Iterable[FrequencyResponse], statuses: dict[str, int]) -> Iterator[FrequencyResponse]:
    """Pass the responses on, and count their rows by status."""
    for response in responses:
        for status in np.asarray(response.status).tolist():
            statuses[status] = statuses.get(status, 0) + 1
        yield response


def _refuse_strangers(plan: Plan, folder: Path) -> None:
    """Work of another campaign is not thrown away unasked: a forgotten ``--set`` would cost it."""
    first = pilots(plan).plans if plan.automatic else (plan,)
    ours = {batch.key for part in first for batch in part.batches()}
    strangers = shards.keys(folder) - ours
    if (plan.adaptive is not None or plan.automatic) and len(strangers) < len(shards.keys(folder)):
        return  # shards of the first round are ours: so may be those of further rounds
    if strangers:
        raise RunError(
            f"{folder} holds {len(strangers)} batches of another campaign, or of this one with other settings: run "
            "that one again to finish it, or give --force to discard them"
        )


def _measure_all(
    plan: Plan, store: shards.Store, bring: Callable[..., None], report: Report
) -> tuple[list[Batch], dict[str, dict[str, Any]]]:
    """Bring every batch, those of an adaptive grid round after round; and what its last round certifies, by op_id.

    Rounds follow from the rows alone, so that a run that goes on where another was ended asks the same questions.
    """
    batches_of = _at_one_amplitude(plan) if not plan.automatic else _at_balanced_amplitudes(plan, store, bring)
    if plan.adaptive is None:
        batches = batches_of(plan.points)
        bring(plan, batches, report=report)
        return batches, {}
    asked, band_hz = plan.adaptive, plan.adaptive.band_hz(plan.f1_hz)
    points, fresh, n_rounds = list[Frequency](), list(plan.points), 0
    batches = []
    decision: Decision | None = None
    most = asked.most_points * len(plan.conditions)
    while fresh:
        of_round, n_rounds = batches_of(fresh), n_rounds + 1
        bring(plan, of_round, report=_further(report, len(points) * len(plan.conditions), most))
        batches += of_round
        points += fresh
        responses = list(_responses(plan, batches, store))
        decision = decide(responses, decision, band_hz, asked.tolerance)
        fresh = next_round(decision.nu_hz, points, asked, plan.f1_hz, plan.block)
    report(len(points) * len(plan.conditions), len(points) * len(plan.conditions), 1.0)
    assert decision is not None
    return batches, {v.op_id: certificate(v, asked, plan.f1_hz, n_rounds) for v in decision.verdicts}


BatchesOf = Callable[[Sequence[Frequency]], list[Batch]]
"""The batches of some points, at the amplitude that is theirs."""


def _at_one_amplitude(plan: Plan) -> BatchesOf:
    return lambda points: list(replace(plan, points=tuple(points)).batches())


def _at_balanced_amplitudes(plan: Plan, store: shards.Store, bring: Callable[..., None]) -> BatchesOf:
    """Sweep the pilots, and let them speak for every point."""
    asked = pilots(plan)
    steps = [list(part.batches()) for part in asked.plans]
    bring(plan, [batch for step in steps for batch in step], report=lambda done, total, share: None)
    ladder = [
        {op_id: _rows(store, batches) for op_id, batches in _batches_by_condition(plan, step).items()} for step in steps
    ]
    levels = chosen(asked, ladder)
    return lambda points: [batch for part in parts(plan, points, asked, levels) for batch in part.batches()]


def _further(report: Report, before: int, most: int) -> Report:
    """Progress of one round as that of the whole, which is as much as ``most`` points."""
    return lambda done, total, share: report(before + done, most, (before + done) / most)


def _resumption(plan: Plan, say: Callable[[str], None]) -> Callable[[int, int], None]:
    """A function to call with (points found, points missing) of each portion; it speaks before the first is measured.

    Pilots and rounds are portions: how many points follow them is known only where there is but one.
    """
    one_portion = plan.adaptive is None and not plan.automatic
    kept, over = 0, False

    def tell(found: int, missing: int) -> None:
        nonlocal kept, over
        kept += found
        if over or not (missing or one_portion):
            return
        over = True
        if kept and one_portion:
            say(f"going on: {kept}/{kept + missing} points are measured already, {missing} left")
        elif kept:
            say(f"going on: {kept} points are measured already")

    return tell


def _measure_missing(
    plan: Plan,
    batches: Sequence[Batch],
    plant: Plant | PlantCard,
    store: shards.Store,
    workers: Workers,
    tell: Callable[[int, int], None],
    report: Report,
) -> None:
    """Bring the result of every batch into the store."""
    total, work = sum(len(batch.points) for batch in batches), sum(_work(batch.points) for batch in batches)
    missing = [batch for batch in batches if store.read(batch) is None]
    done = total - sum(len(batch.points) for batch in missing)
    left = sum(_work(batch.points) for batch in missing)
    tell(done, total - done)
    report(done, total, 1.0 - left / work)
    for batch, result in _results(plan, plant, missing, workers):
        store.write(batch, result)
        done += len(batch.points)
        left -= _work(batch.points)
        report(done, total, 1.0 - left / work)


def _work(points: Sequence[Frequency]) -> int:
    """Work of some points: long windows come first, so points alone would promise too long a wait."""
    return sum(point.window_blocks for point in points)


# Workers


def _results(
    plan: Plan, plant: Plant | PlantCard, batches: Sequence[Batch], workers: Workers
) -> Iterator[tuple[Batch, BatchResult]]:
    """Results as they come; a lost worker costs what it was at."""
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


# The table


class Swept(NamedTuple):
    """A campaign that was measured: what its table is made of, one operating point in memory at a time.

    Attributes
    ----------
    plan, plant
        What was asked, and of whom.
    store : Store
        Where the results of the batches are.
    batches : list of Batch
        All of them.
    certificates : mapping
        What the last round of an adaptive grid certifies, by op_id.
    """

    plan: Plan
    plant: Plant | PlantCard
    store: shards.Store
    batches: list[Batch]
    certificates: Mapping[str, dict[str, Any]]

    def responses(self) -> Iterator[FrequencyResponse]:
        """One for every operating point that has rows, in campaign order."""
        return _responses(self.plan, self.batches, self.store)

    def metadata(self) -> dict[str, Any]:
        """Metadata of the table, as `write_table` takes it."""
        by_condition = _batches_by_condition(self.plan, self.batches)
        meta = _metadata(self.plan, self.plant, by_condition, self.store)
        for entry in meta["operating_points"]:
            if entry["op_id"] in self.certificates:
                entry["interpolation"] = self.certificates[entry["op_id"]]
        return meta

    @property
    def remarks(self) -> tuple[str, ...]:
        """What an adaptive grid has to say of each operating point."""
        return tuple(f"{name}: {certificate_text(c, self.plan.f1_hz)}" for name, c in self.certificates.items())


def _responses(plan: Plan, batches: Sequence[Batch], store: shards.Store) -> Iterator[FrequencyResponse]:
    for op_id, own in _batches_by_condition(plan, batches).items():
        if own:
            yield response_of(plan, op_id, judged(_rows(store, own), plan.nonlinear_above))


def _batches_by_condition(plan: Plan, batches: Sequence[Batch]) -> dict[str, list[Batch]]:
    found: dict[str, list[Batch]] = {condition.op_id: [] for condition in plan.conditions}
    for batch in batches:
        found[batch.condition.op_id].append(batch)
    return found


def _rows(store: shards.Store, batches: Sequence[Batch]) -> list[Row]:
    """Rows of some batches, ascending in frequency."""
    return sorted((row for batch in batches for row in _kept(store, batch).rows), key=lambda row: row.f_hz)


def _kept(store: shards.Store, batch: Batch) -> BatchResult:
    result = store.read(batch)
    if result is None:
        raise OSError(f"{store}: a shard was damaged or removed after it was written; run again to measure it anew")
    return result


def response_of(plan: Plan, op_id: str, rows: Sequence[Row]) -> FrequencyResponse:
    """Rows of one operating point, ascending, as a response, with what its shots prove."""
    proof = stable_on(plan, next(condition for condition in plan.conditions if condition.op_id == op_id), rows)
    parts = np.array([row.y for row in rows])
    return FrequencyResponse(
        f_hz=np.array([row.f_hz for row in rows]),
        y=(parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2),
        f1_hz=plan.f1_hz,
        covariance=unpack_covariance(np.array([row.cov for row in rows])),
        status=np.array([row.status for row in rows]),
        reason=np.array([row.reason for row in rows]),
        quality={name: np.array([getattr(row, name) for row in rows]) for name in QUALITY},
        meta={"op_id": op_id} if proof is None else {"op_id": op_id, "stable_on": proof},
    )


def _metadata(
    plan: Plan, plant: Plant | PlantCard, by_condition: dict[str, list[Batch]], store: shards.Store
) -> dict[str, Any]:
    return {
        "f1_hz": plan.f1_hz,
        "bases": {"rated_voltage_v": plant.rating.voltage_v, "rated_power_va": plant.rating.power_va},
        "power_meaning": plant.power_meaning,
        "operating_points": [
            _condition_metadata(condition, plant, _kept(store, by_condition[condition.op_id][0]).condition)
            for condition in plan.conditions
            if by_condition[condition.op_id]
        ],
        "configuration": dict(plan.configuration),
        "plant": dict(plan.plant_fingerprint),
    }


def _condition_metadata(condition: Condition, plant: Plant | PlantCard, seen: dict[str, float]) -> dict[str, Any]:
    """An operating point as the table tells of it; |v_pcc| is what was asked, else what was found."""
    fundamental = {key: value for key, value in seen.items() if key != "settle_residual"}
    voltage_v = condition.terminal_voltage_v or fundamental.get("voltage_v")
    entry: dict[str, Any] = {
        "op_id": condition.op_id,
        "active_power_mw": condition.active_power_w / 1e6,
        "terminal_voltage_pu": voltage_v / plant.rating.voltage_v if voltage_v else None,
    }
    if "settle_residual" in seen:
        entry["settle_residual"] = seen["settle_residual"]
    if fundamental:
        entry["fundamental"] = fundamental
    return entry
