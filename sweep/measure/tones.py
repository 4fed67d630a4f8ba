"""Driving tones: every shot runs until its response is at rest, listened to in coherent windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np

from ...identify.fourier import block_phasors, periodic_window
from ...identify.settling import NOISY_WINDOWS, Settled, first_agreement, steady_mean, windows
from ...plant.protocol import Job, PhasorPlant, Phasors, Plant, Window
from ..plan import Batch, Shot
from .baseline import Baseline, PlantFault, run

QUIET_WINDOWS = 2
"""Windows of a quiet shot before any two are compared."""

RUN_BLOCKS = 15
"""Blocks of one `run_phasors`: all shots are cut at the same places, whatever their neighbours need,
so that not even their rounding depends on the neighbours."""


def drive(plant: Plant, batch: Batch, baseline: Baseline, shots: Sequence[Shot]) -> list[Settled]:
    """Run every shot until it is at rest and known well enough, or its time is over.

    Parameters
    ----------
    plant : Plant
        The device; `PhasorPlant` is used where it is one.
    batch : Batch
        What is asked of them.
    baseline : Baseline
        The unperturbed branch: whether it is noisy decides how a shot is judged.
    shots : sequence of Shot
        Tones, all from the baseline's state.
    """
    states = [baseline.state] * len(shots)
    heard: list[list[Phasors]] = [[] for _ in shots]
    results: dict[int, Settled] = {}
    unperturbed, done = baseline.state, 0
    while pending := [k for k in range(len(shots)) if k not in results]:
        longest = max(_blocks_to_go(baseline, shots[k], done) for k in pending)
        n_blocks = min(longest, max(1, max(_limit_blocks(batch, baseline, shots[k]) for k in pending) - done))
        if isinstance(plant, PhasorPlant):
            n_blocks += -n_blocks % RUN_BLOCKS
        jobs = [Job(states[k], shots[k].injection) for k in pending]
        listening = [shots[k].window._replace(first_block=done) for k in pending]
        if isinstance(plant, PhasorPlant):
            answers = _listen_phasors(plant, batch, baseline, jobs, listening, n_blocks)
        elif baseline.noisy:
            answers = _listen_noisy_records(plant, batch, baseline, jobs, listening, n_blocks)
        else:
            unperturbed, answers = _listen_records(plant, batch, unperturbed, jobs, listening, n_blocks)
        done += n_blocks
        for k, (state, phasors) in zip(pending, answers, strict=True):
            states[k] = state
            heard[k].append(phasors)
            over = done >= _limit_blocks(batch, baseline, shots[k])
            result = _settled(batch, baseline, shots[k], heard[k], over)
            if result is not None and (over or result.agreed or not isfinite(result.residual)):
                results[k] = result
    return [results[k] for k in range(len(shots))]


def _first_windows(baseline: Baseline) -> int:
    return NOISY_WINDOWS + 1 if baseline.noisy else QUIET_WINDOWS


def _blocks_to_go(baseline: Baseline, shot: Shot, done: int) -> int:
    """Blocks until the next window that can be judged is complete."""
    windows_due = max(_first_windows(baseline), done // shot.window.n_blocks + 1)
    return windows_due * shot.window.n_blocks - done


def _limit_blocks(batch: Batch, baseline: Baseline, shot: Shot) -> int:
    """Blocks of a shot's longest run: whole windows, at least those of the first judgement."""
    whole = int(batch.limits.max_simulated_s / (shot.window.n_blocks * batch.block.duration_s))
    return max(_first_windows(baseline), whole) * shot.window.n_blocks


def _settled(batch: Batch, baseline: Baseline, shot: Shot, heard: list[Phasors], over: bool) -> Settled | None:
    """The judgement of the windows heard so far, at most those the limit allows.

    A shot of a quiet device that found no agreement in all its time may have been noisy: the perturbation itself can
    set a limit cycle going.
    """
    most = _limit_blocks(batch, baseline, shot)
    joined = Phasors(np.concatenate([p.v for p in heard])[:most], np.concatenate([p.i for p in heard])[:most])
    v, i = windows(joined, shot.window.n_blocks)
    if len(v) < _first_windows(baseline):
        return None
    if baseline.noisy:
        return steady_mean(v, i, batch.limits.uncertainty)
    found = first_agreement(v, i, batch.limits.tolerance)
    if found.agreed or not over or len(v) <= NOISY_WINDOWS or not isfinite(found.residual):
        return found
    noisy = steady_mean(v, i, batch.limits.uncertainty)
    return noisy if noisy.at_rest else found


# Listening


def _listen_phasors(
    plant: PhasorPlant,
    batch: Batch,
    baseline: Baseline,
    jobs: list[Job],
    listening: list[Window],
    n_blocks: int,
) -> list[tuple[Any, Phasors]]:
    """Phasors accumulated by the plant, less those of the periodic baseline."""
    heard: list[list[Phasors]] = []
    for first in range(0, n_blocks, RUN_BLOCKS):
        windows_now = [window._replace(first_block=window.first_block + first) for window in listening]
        answers = _run_phasors(plant, jobs, windows_now, batch.block.steps, RUN_BLOCKS)
        jobs = [Job(state, job.injection) for (state, _), job in zip(answers, jobs, strict=True)]
        heard.append([phasors for _, phasors in answers])
    cleaned = []
    for job, window, parts in zip(jobs, listening, zip(*heard, strict=True), strict=True):
        whole = Phasors(np.concatenate([part.v for part in parts]), np.concatenate([part.i for part in parts]))
        cleaned.append((job.state, _without(whole, baseline, batch, window)))
    return cleaned


def _listen_noisy_records(
    plant: Plant, batch: Batch, baseline: Baseline, jobs: list[Job], listening: list[Window], n_blocks: int
) -> list[tuple[Any, Phasors]]:
    """Phasors of records less those of the mean baseline: subtracting another noisy branch would double the noise."""
    answers = run(plant, jobs, n_blocks * batch.block.steps)
    return [
        (state, _without(block_phasors(record, window, batch.block.steps), baseline, batch, window))
        for (state, record), window in zip(answers, listening, strict=True)
    ]


def _without(phasors: Phasors, baseline: Baseline, batch: Batch, window: Window) -> Phasors:
    """Block sums less an equal share of what the window hears of the baseline.

    Only whole windows are ever used, so the share of a single block is a matter of bookkeeping.
    """
    window_s = window.n_blocks * batch.block.duration_s
    pair = (window.f_hz, 2.0 * batch.f1_hz - window.f_hz)
    share = [
        np.array([periodic_window(x, round(f * window_s), window.n_blocks, baseline.t0_s / window_s) for f in pair])
        / window.n_blocks
        for x in (baseline.v, baseline.i)
    ]
    return Phasors(phasors.v - share[0], phasors.i - share[1])


def _listen_records(
    plant: Plant,
    batch: Batch,
    unperturbed: Any,
    jobs: list[Job],
    listening: list[Window],
    n_blocks: int,
) -> tuple[Any, list[tuple[Any, Phasors]]]:
    """Records less the unperturbed branch, sample by sample, then the phasors."""
    steps = n_blocks * batch.block.steps
    (after, reference), *answers = run(plant, [Job(unperturbed, None), *jobs], steps)
    cleaned = []
    for (state, record), window in zip(answers, listening, strict=True):
        deviation = replace(record, v=record.v - reference.v, i=record.i - reference.i)
        cleaned.append((state, block_phasors(deviation, window, batch.block.steps)))
    return after, cleaned


def _run_phasors(
    plant: PhasorPlant, jobs: list[Job], listening: list[Window], block_steps: int, n_blocks: int
) -> list[tuple[Any, Phasors]]:
    """`PhasorPlant.run_phasors`, held to its promise of as many blocks as asked."""
    answers = plant.run_phasors(jobs, listening, block_steps, n_blocks)
    if len(answers) != len(jobs):
        raise PlantFault(f"run_phasors gave {len(answers)} answers to {len(jobs)} jobs")
    for _, phasors in answers:
        shapes = np.shape(phasors.v), np.shape(phasors.i)
        if shapes != ((n_blocks, 2), (n_blocks, 2)):
            raise PlantFault(
                f"run_phasors gave v and i of shapes {shapes[0]} and {shapes[1]}; ({n_blocks}, 2) is needed"
            )
    return answers
