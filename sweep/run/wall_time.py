"""How long a campaign will take, from a stopwatch held to the unperturbed plant for a moment."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from ...plant.protocol import Job, NotSettled, PhasorPlant, Plant, Window
from ...plant.registry import PlantCard
from ..measure.loadflow import reached
from ..plan import EXPECTED_WINDOWS, Batch, Plan
from .host import DEFAULT_TIMEOUT_S, host_at_hand

PROBE_JOBS = 8
PROBE_BLOCKS = 4
BATCH_OVERHEAD_S = 2e-3
"""Settling, solving and storing of a batch of the reference turbine."""

START_S = 0.3
"""Starting workers and writing the table."""


def wall_time_s(plan: Plan, plant: Plant | PlantCard, jobs: int) -> float:
    """Expected wall time (s) of ``plan`` with ``jobs`` workers on this machine.

    The plant is settled at the first operating point and run for a few blocks, unperturbed where a shot is a tone, in
    a child where only its card is here. Windows are as many as the plan expects.

    Raises
    ------
    NotSettled
        If the first operating point has no steady state.
    ChildFailed
        If a plant in a child crashes, hangs or raises.
    """
    per_block_s, together = _cost(plan, plant)
    batches = list(plan.batches())
    if plan.signal is not None:
        blocks = [plan.simulated_s / plan.n_shots / plan.block.duration_s] * len(batches)
    else:
        blocks = [EXPECTED_WINDOWS * _blocks(batch, together) for batch in batches]
    work_s = [per_block_s * n + BATCH_OVERHEAD_S for n in blocks]
    return START_S + max(max(work_s), sum(work_s) / jobs)


def _blocks(batch: Batch, together: int) -> float:
    """Blocks of a window of every shot, ``together`` of them for the price of one; at least those of the longest."""
    windows = [shot.window.n_blocks for of_point in batch.shots for shot in of_point]
    return max(max(windows), sum(windows) / together)


def _cost(plan: Plan, plant: Plant | PlantCard) -> tuple[float, int]:
    timeout_s = plan.hosting.timeout_s or DEFAULT_TIMEOUT_S
    late = f"settling and a few periods took longer than {timeout_s:g} s of wall time (plant.timeout_s)"
    cost = host_at_hand(plant, plan.hosting).ask(partial(_cost_or_refusal, plan), timeout_s, late)
    if isinstance(cost, NotSettled):
        raise cost
    return cost


def _cost_or_refusal(plan: Plan, plant: Plant) -> tuple[float, int] | NotSettled:
    try:
        return _cost_of_a_block(plan, plant)
    except NotSettled as refusal:
        return NotSettled(str(refusal), refusal.status)


def _cost_of_a_block(plan: Plan, plant: Plant) -> tuple[float, int]:
    """Seconds for one block of one run, and how many shots share a run."""
    source, point = reached(plant, plan.source, plan.conditions[0])
    state = plant.settle(point, source)
    if plan.signal is not None:
        return _cost_of_plays(plan, plant, state), 1
    job = Job(state, None)
    best = float("inf")
    for _ in range(3):
        begin = time.perf_counter()
        if isinstance(plant, PhasorPlant):
            plant.run_phasors([job] * PROBE_JOBS, [Window(0.0, 1)] * PROBE_JOBS, plan.block.steps, PROBE_BLOCKS)
        else:
            plant.run([job], plan.block.steps * PROBE_BLOCKS)
        best = min(best, (time.perf_counter() - begin) / PROBE_BLOCKS)
        if best > 1.0:
            break
    return best, PROBE_JOBS if isinstance(plant, PhasorPlant) else 1


def _cost_of_plays(plan: Plan, plant: Plant, state: Any) -> float:
    """Seconds for one block of the four plays together: their many tones cost more than the device."""
    jobs = [Job(state, play.injection(0.0)) for play in plan.plays_of(plan.conditions[0])]
    plant.run(jobs, plan.block.steps)
    begin = time.perf_counter()
    plant.run(jobs, plan.block.steps)
    return time.perf_counter() - begin
