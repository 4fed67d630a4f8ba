"""How long a campaign will take, from a stopwatch held to a few of its shots.

The last batch of the first operating point, which has the shortest windows, is measured as the campaign will: that says
how long the device takes to come to rest, from which follow the windows of all other shots, and what a batch costs
beside its stepping.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, isfinite
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ...plant.protocol import Job, NotSettled, PhasorPlant, Plant, Window
from ...plant.registry import PlantCard, releases_gil
from ..measure.loadflow import reached
from ..measure.measure import measure, measure_together
from ..measure.rows import Row
from ..measure.tones import RUN_BLOCKS
from ..plan import EXPECTED_WINDOWS, SETTLE_S, Batch, Plan
from .host import DEFAULT_TIMEOUT_S, host_at_hand
from .workers import FEW, TOGETHER, Workers, together

PROBE_JOBS = 8
PROBE_BLOCKS = 4

QUICK_S, LONGER = 0.01, 64
"""A call that takes no more is made again, so many times as long: what a call costs besides its blocks is taken off."""

CALLS = 3
"""Calls of a signal: until it has settled, and two periods."""

WHOLE = 1e-6
"""Part of a window by which a time may be more than whole windows."""

PATIENCE_S = 4.0
"""A batch that promises to take longer is not tried."""

START_S = 0.45
"""Starting the command and its workers."""

START_PROCESSES_S = 1.4
"""The same where workers are processes."""

TABLE_S, BATCH_S, ROW_S = 0.05, 1e-3, 2.5e-5
"""Opening and closing the table; keeping a batch and putting it into the table, and each of its rows."""

TURNS = 0.1
"""What each further thread costs: it waits for its turn in Python."""


class Cost(NamedTuple):
    """What was found of a plant.

    Attributes
    ----------
    block_s : float
        Time (s) of a block of one run.
    lanes : int
        Shots that share a run.
    round_s : float
        Time (s) that each further round of a batch takes, however many shots are left.
    beside_s : float
        Time (s) that a batch takes beside that: settling, judging, solving.
    rest_s : mapping of float to float
        Simulated time (s) after which the shots of a point repeat, by its frequency (Hz), as far as tried.
    """

    block_s: float
    lanes: int
    round_s: float
    beside_s: float
    rest_s: Mapping[float, float]


def wall_time_s(plan: Plan, plant: Plant | PlantCard, jobs: int) -> float:
    """Expected wall time (s) of ``plan`` with ``jobs`` workers on this machine.

    The plant is settled at the first operating point and run for a few blocks, and then for a batch, in a child where
    only its card is here.

    Raises
    ------
    NotSettled
        If the first operating point has no steady state.
    ChildFailed
        If a plant in a child crashes, hangs or raises.
    """
    cost, of_first = _cost(plan, plant), plan.batches_at(plan.conditions[0])
    n_batches = len(of_first) * len(plan.conditions)
    threads = Workers(jobs, None, None).backend_for(plan, plant) == "threading"
    n_together = together(n_batches, jobs) if threads and cost.lanes > 1 and releases_gil(plant) else 1
    work_s = [n_together * _work_s(plan, batch, cost, n_together) for batch in of_first]
    all_s = sum(work_s) / n_together * len(plan.conditions)
    shared_s = all_s / jobs * (1.0 + TURNS * (jobs - 1) * threads)
    start_s = START_S if threads else START_PROCESSES_S
    table_s = TABLE_S + BATCH_S * n_batches + ROW_S * len(plan.points) * len(plan.conditions)
    return start_s + table_s + max(max(work_s), shared_s)


def _work_s(plan: Plan, batch: Batch, cost: Cost, n_together: int) -> float:
    """Time (s) of one of ``n_together`` such batches that are measured together."""
    if plan.signal is not None:
        blocks = (SETTLE_S + 2.0 * plan.signal.period_s) / plan.block.duration_s
        return cost.block_s * blocks + cost.beside_s
    blocks_of = _blocks(batch, cost.rest_s)
    if cost.lanes == 1:
        return cost.block_s * sum(blocks_of) + cost.beside_s
    runs = RUN_BLOCKS * _runs(blocks_of, cost.lanes, n_together) / n_together
    return cost.block_s * runs + cost.round_s * _rounds(blocks_of) / n_together + cost.beside_s


def _rounds(blocks_of: Sequence[int]) -> int:
    return ceil(max(blocks_of) / RUN_BLOCKS)


def _blocks(batch: Batch, rest_s: Mapping[float, float]) -> list[int]:
    """Blocks that every shot will last: until it repeats, and two windows more that agree."""
    shots = [shot for of_point in batch.shots for shot in of_point]
    if not rest_s:
        return [round(EXPECTED_WINDOWS) * shot.window.n_blocks for shot in shots]
    usual, block_s = median(rest_s.values()), batch.block.duration_s
    waited = [rest_s.get(shot.f_hz, usual) / (shot.window.n_blocks * block_s) for shot in shots]
    return [(ceil(n - WHOLE) + 2) * shot.window.n_blocks for n, shot in zip(waited, shots, strict=True)]


def _runs(blocks_of: Sequence[int], lanes: int, n_together: int) -> int:
    """Runs of `RUN_BLOCKS` of ``n_together`` such batches, whose shots share lanes until they are over."""
    rounds = np.ceil(np.array(blocks_of) / RUN_BLOCKS)
    return sum(ceil(n_together * int(np.sum(rounds > done)) / lanes) for done in range(int(rounds.max())))


def _cost(plan: Plan, plant: Plant | PlantCard) -> Cost:
    timeout_s = plan.hosting.timeout_s or DEFAULT_TIMEOUT_S
    late = f"settling and a few periods took longer than {timeout_s:g} s of wall time (plant.timeout_s)"
    cost = host_at_hand(plant, plan.hosting).ask(partial(_cost_or_refusal, plan), timeout_s, late)
    if isinstance(cost, NotSettled):
        raise cost
    return cost


def _cost_or_refusal(plan: Plan, plant: Plant) -> Cost | NotSettled:
    try:
        return _found(plan, plant)
    except NotSettled as refusal:
        return NotSettled(str(refusal), refusal.status)


def _found(plan: Plan, plant: Plant) -> Cost:
    begin = time.perf_counter()
    source, point = reached(plant, plan.source, plan.conditions[0])
    state = plant.settle(point, source)
    settled_s = time.perf_counter() - begin
    lanes = PROBE_JOBS if isinstance(plant, PhasorPlant) and plan.signal is None else 1
    block_s, call_s = (_block_s(plan, plant, state), 0.0) if plan.signal is None else _of_plays(plan, plant, state)
    untried = Cost(block_s, lanes, 0.0, settled_s + CALLS * call_s, {})
    of_first = plan.batches_at(plan.conditions[0])
    asked = list({batch.key: batch for batch in (of_first[-1], of_first[0])}.values())
    for n in (len(asked), 1):
        promised_s = [_work_s(plan, batch, untried, 1) for batch in asked[:n]]
        if sum(promised_s) <= PATIENCE_S:
            taken = [_taken(plant, *each) for each in zip(asked[:n], promised_s, strict=True)]
            cost = _tried(plan, asked[:n], taken, untried)
            together = TOGETHER * promised_s[0] <= PATIENCE_S and _has_company(plan, of_first, cost)
            return _in_company(plan, plant, of_first[0], cost) if together else cost
    return untried


def _has_company(plan: Plan, of_first: Sequence[Batch], cost: Cost) -> bool:
    """Whether batches of several operating points are measured together, of which all are alike."""
    return cost.lanes > 1 and len(of_first) == 1 and len(plan.conditions) >= TOGETHER * FEW


def _in_company(plan: Plan, plant: Plant, batch: Batch, alone: Cost) -> Cost:
    """The cost after a few such batches were measured together: their rounds are the same, and cost once.

    What a batch by itself takes beside stepping holds all its rounds.
    """
    blocks_of = _blocks(batch, alone.rest_s)
    stepping_s = alone.block_s * RUN_BLOCKS * _runs(blocks_of, alone.lanes, TOGETHER)
    begin = time.perf_counter()
    measure_together(plant, [_elsewhere(batch, k) for k in range(TOGETHER)])
    beside_s = time.perf_counter() - begin - stepping_s
    each_s = min(max(0.0, (beside_s - alone.beside_s) / (TOGETHER - 1)), alone.beside_s)
    return alone._replace(round_s=(alone.beside_s - each_s) / _rounds(blocks_of), beside_s=each_s)


def _elsewhere(batch: Batch, k: int) -> Batch:
    """The batch as that of another operating point, which happens to be the same."""
    return replace(batch, condition=replace(batch.condition, op_id=f"{batch.condition.op_id} {k}"))


def _tried(plan: Plan, batches: Sequence[Batch], taken: Sequence[tuple[float, Sequence[Row]]], untried: Cost) -> Cost:
    """The cost after one or two batches were measured: what each took beside stepping grows with its rounds."""
    if plan.signal is not None:
        return untried._replace(block_s=0.0, beside_s=taken[0][0])
    rest_s = {f_hz: s for (_, rows), batch in zip(taken, batches, strict=True) for f_hz, s in _rest_s(rows, batch)}
    known = untried._replace(beside_s=0.0, rest_s=rest_s)
    beside_s = [of_batch - _work_s(plan, batch, known, 1) for (of_batch, _), batch in zip(taken, batches, strict=True)]
    rounds = [_rounds(_blocks(batch, rest_s)) for batch in batches]
    steeper = (beside_s[-1] - beside_s[0]) / (rounds[-1] - rounds[0]) if rounds[-1] > rounds[0] else 0.0
    round_s = max(0.0, steeper) if known.lanes > 1 else 0.0
    return known._replace(round_s=round_s, beside_s=max(0.0, beside_s[0] - round_s * rounds[0]))


def _taken(plant: Plant, batch: Batch, promised_s: float) -> tuple[float, Sequence[Row]]:
    """Time (s) of a batch, and its rows; where it promises to be quick, of the second: the first may compile."""
    taken_s = float("inf")
    for _ in range(2 if promised_s <= 0.1 * PATIENCE_S else 1):
        begin = time.perf_counter()
        rows = measure(plant, batch).rows
        taken_s = min(taken_s, time.perf_counter() - begin)
    return taken_s, rows


def _rest_s(rows: Sequence[Row], batch: Batch) -> Iterator[tuple[float, float]]:
    """Simulated time (s) before the last two windows of every point that came to rest, by its frequency (Hz)."""
    windows_s = {point.f_hz: point.window_blocks * batch.block.duration_s for point in batch.points}
    for row in rows:
        if isfinite(row.disturbed_s):
            yield row.f_hz, max(0.0, row.disturbed_s - 2.0 * windows_s[row.f_hz])


def _block_s(plan: Plan, plant: Plant, state: Any) -> float:
    """Seconds for one block of one run, the unperturbed device's."""
    job, steps = Job(state, None), plan.block.steps

    def drive(n_blocks: int) -> None:
        if isinstance(plant, PhasorPlant):
            plant.run_phasors([job] * PROBE_JOBS, [Window(0.0, 1)] * PROBE_JOBS, steps, n_blocks)
        else:
            plant.run([job], steps * n_blocks)

    drive(1)  # it may compile
    return _slope_s(drive, PROBE_BLOCKS)


def _of_plays(plan: Plan, plant: Plant, state: Any) -> tuple[float, float]:
    """Seconds for one block of the four plays together, whose many tones cost more than the device, and for a call."""
    jobs = [Job(state, play.injection(0.0)) for play in plan.plays_of(plan.conditions[0])]
    plant.run(jobs, 1)  # it may compile
    once_s, longer_s = (_least_s(partial(plant.run, jobs, n * plan.block.steps)) for n in (1, 1 + PROBE_BLOCKS))
    block_s = max(longer_s - once_s, 0.0) / PROBE_BLOCKS
    return block_s, max(once_s - block_s, 0.0)


def _slope_s(drive: Callable[[int], object], n_blocks: int) -> float:
    """Seconds by which each further block makes a call longer; of a slow plant, its share of a call."""
    once_s = _least_s(partial(drive, n_blocks))
    if once_s > QUICK_S:
        return once_s / n_blocks
    return max(_least_s(partial(drive, LONGER * n_blocks)) - once_s, 0.0) / ((LONGER - 1) * n_blocks)


def _least_s(call: Callable[[], object]) -> float:
    """Least time (s) of three calls; one is enough where it takes long."""
    least_s = float("inf")
    for _ in range(3):
        begin = time.perf_counter()
        call()
        least_s = min(least_s, time.perf_counter() - begin)
        if least_s > 1.0:
            break
    return least_s
