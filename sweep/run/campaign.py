"""The campaign runner: batches through workers, results kept on the way, the table at the end.

The worker is one pure function, `measure`; everything that is kept is written by the runner, so that workers may be
threads, processes or other machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...identify.fit.adaptive import Decision, decide
from ...identify.response import FrequencyResponse
from ...identify.table.write import write_table
from ...plant.protocol import Plant
from ...plant.registry import PlantCard
from ..excitation.adaptive_rounds import certificate, next_round
from ..excitation.frequencies import Frequency
from ..plan import Plan
from . import shards
from .asked import Asked, Missing, work_of
from .pilots import chosen, parts, pilots
from .store import Folder, Memory, Store
from .swept import Swept, response_of, rows_of
from .workers import Pool, RunError, Workers, pool

__all__ = ["Interrupted", "Outcome", "RunError", "Runner", "response_of", "run", "sweep_in_memory"]

Report = Callable[[int, int, float], None]
"""Called with (points done, points in all, share of the work done) whenever a batch is kept."""

MANY = 10_000
"""So many batches take some seconds to be looked for among what an earlier run left."""

BatchesOf = Callable[[Sequence[Frequency]], Asked]
"""The batches of some points, at the amplitude that is theirs."""


def _quiet(done: int, total: int, share: float) -> None:
    """Progress that nobody looks at."""


def _silent(text: str) -> None:
    """A line that nobody reads."""


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
    report: Report = _quiet,
    say: Callable[[str], None] = _silent,
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
        Called with a line of text where an earlier run left something to go on with, and where a device takes long.

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
        store = Folder(folder)
        if not discard:
            _refuse_strangers(plan, store)
        runner = Runner(plan, plant, store, Workers(jobs, backend, scheduler, say), report, say)
        statuses: dict[str, int] = {}
        swept = runner.measure()
        write_table(output, _counted(swept.responses(), statuses), swept.header())
        shards.remove(folder)
    return Outcome(statuses, swept.remarks)


def sweep_in_memory(
    plan: Plan,
    plant: Plant | PlantCard,
    *,
    jobs: int,
    backend: str | None = None,
    report: Report = _quiet,
    say: Callable[[str], None] = _silent,
) -> Swept:
    """`run` without a file: results are kept in memory, and nothing is left on the disk.

    Raises
    ------
    Interrupted
        If it is interrupted; with what was measured until then.
    """
    store = Memory()
    try:
        return Runner(plan, plant, store, Workers(jobs, backend, None, say), report).measure()
    except KeyboardInterrupt:
        raise Interrupted(Swept(plan, plant, store, store.measured(plan.amplitude_pu), {})) from None


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


@dataclass(slots=True)
class _Resumption:
    """Points of an earlier run that were found so far, and whether they have been spoken of."""

    kept: int = 0
    over: bool = False


@dataclass(frozen=True, slots=True)
class Runner:
    """One campaign on its way: what is asked, of whom, where results are kept, who works, and who is told.

    Results that are in the store already are not asked for again: that is all there is to going on where an earlier
    run was ended. Pilots and rounds follow from the rows alone, so that a run that goes on asks the same questions.

    Attributes
    ----------
    plan, plant
        What is asked, and of whom; a card is enough where the plan is isolated.
    store : Store
        Where results are kept.
    workers : Workers
        How many work at once, and as what.
    report : callable
        Progress.
    say : callable
        Called once, with a line of text, where an earlier run left something to go on with.
    """

    plan: Plan
    plant: Plant | PlantCard
    store: Store
    workers: Workers
    report: Report = _quiet
    say: Callable[[str], None] = _silent
    _told: _Resumption = field(default_factory=_Resumption)

    def measure(self) -> Swept:
        """Every batch measured, or found in the store: pilots first where they are asked for, then all points."""
        with pool(self.plan, self.plant, self.workers) as results:
            return self._measure(results)

    def _measure(self, results: Pool) -> Swept:
        plan = self.plan
        batches_of = self._at_balanced_amplitudes(results) if plan.automatic else _at_one_amplitude(plan)
        if plan.adaptive is not None:
            return self._measure_in_rounds(results, batches_of)
        asked = batches_of(plan.points)
        self._bring(results, asked, self.report)
        return Swept(plan, self.plant, self.store, asked.at, {})

    def _bring(self, results: Pool, asked: Asked, report: Report) -> None:
        """Bring the result of every batch into the store."""
        total, work = asked.n_points, asked.work
        missing = Missing(asked, self._yet_to_do(asked))
        done = total - sum(len(batch.points) for batch in missing)
        left = sum(work_of(batch.points) for batch in missing)
        self._tell(done, total - done)
        report(done, total, 1.0 - left / work)
        with closing(results(missing)) as coming:
            for batch, result in coming:
                self.store.write(batch, result)
                done += len(batch.points)
                left -= work_of(batch.points)
                report(done, total, 1.0 - left / work)

    def _yet_to_do(self, asked: Asked) -> Iterable[bool]:
        """Of each batch whether an earlier run left it; that of many batches is found in seconds, and said before."""
        if self.store.is_empty:
            return repeat(True, len(asked))
        if len(asked) >= MANY:
            self.say(f"looking for what is measured already of {asked.n_points} points")
        return (not self.store.holds(batch) for batch in asked)

    def _measure_in_rounds(self, results: Pool, batches_of: BatchesOf) -> Swept:
        """The rounds of an adaptive grid, until its interpolation is certified, or its points are used up."""
        plan = self.plan
        assert plan.adaptive is not None
        asked, band_hz, n_conditions = plan.adaptive, plan.adaptive.band_hz(plan.f1_hz), len(plan.conditions)
        points, fresh, n_rounds = list[Frequency](), list(plan.points), 0
        asked_for = Asked(())
        decision: Decision | None = None
        while fresh:
            of_round, n_rounds = batches_of(fresh), n_rounds + 1
            further = _further(self.report, len(points) * n_conditions, asked.most_points * n_conditions)
            self._bring(results, of_round, further)
            asked_for += of_round
            points += fresh
            responses = list(Swept(plan, self.plant, self.store, asked_for.at, {}).responses())
            decision = decide(responses, decision, band_hz, asked.tolerance)
            fresh = next_round(decision.nu_hz, points, asked, plan.f1_hz, plan.block)
        self.report(len(points) * n_conditions, len(points) * n_conditions, 1.0)
        assert decision is not None
        certificates = {v.op_id: certificate(v, asked, plan.f1_hz, n_rounds) for v in decision.verdicts}
        return Swept(plan, self.plant, self.store, asked_for.at, certificates)

    def _at_balanced_amplitudes(self, results: Pool) -> BatchesOf:
        """Sweep the pilots, and let them speak for every point."""
        plan, asked = self.plan, pilots(self.plan)
        self._bring(results, Asked(asked.plans), _quiet)
        steps = [Asked((part,)) for part in asked.plans]
        ladder = [{point.op_id: rows_of(self.store, step.at(point)) for point in plan.conditions} for step in steps]
        levels = chosen(asked, ladder)
        return lambda points: Asked(parts(plan, points, asked, levels))

    def _tell(self, found: int, missing: int) -> None:
        """Say once what an earlier run left, before anything is measured.

        Pilots and rounds are brought one after the other: how many points follow is known only where there are none.
        """
        at_once = self.plan.adaptive is None and not self.plan.automatic
        self._told.kept += found
        if self._told.over or not (missing or at_once):
            return
        self._told.over = True
        if self._told.kept and at_once:
            kept = self._told.kept
            self.say(f"going on: {kept}/{kept + missing} points are measured already, {missing} left")
        elif self._told.kept:
            self.say(f"going on: {self._told.kept} points are measured already")


def _counted(responses: Iterable[FrequencyResponse], statuses: dict[str, int]) -> Iterator[FrequencyResponse]:
    """Pass the responses on, and count their rows by status."""
    for response in responses:
        for status in np.asarray(response.status).tolist():
            statuses[status] = statuses.get(status, 0) + 1
        yield response


def _refuse_strangers(plan: Plan, store: Folder) -> None:
    """Work of another campaign is not thrown away unasked: a forgotten ``--set`` would cost it."""
    strangers = store.keys()
    n_kept = len(strangers)
    if not n_kept:
        return
    for batch in Asked(pilots(plan).plans if plan.automatic else (plan,)):
        strangers.discard(batch.key)
        if not strangers:
            return
    if (plan.adaptive is not None or plan.automatic) and len(strangers) < n_kept:
        return  # shards of the first round are ours: so may be those of further rounds
    if strangers:
        raise RunError(
            f"{store} holds {len(strangers)} batches of another campaign, or of this one with other settings: run "
            "that one again to finish it, or give --force to discard them"
        )


def _at_one_amplitude(plan: Plan) -> BatchesOf:
    return lambda points: Asked((replace(plan, points=tuple(points)),))


def _further(report: Report, before: int, most: int) -> Report:
    """Progress of one round as that of the whole, which is as much as ``most`` points."""
    return lambda done, total, share: report(before + done, most, (before + done) / most)
