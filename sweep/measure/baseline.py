"""The unperturbed device: settled, certified periodic, and, where it is noisy, how noisy.

A device is quiet if its waveforms repeat to 1e-6 of their peak. One that does not may drift, and then there is nothing
to branch from, or it may be noisy: measurement noise, a ripple that is not synchronous, a limit cycle. The two are told
apart by the fundamental, block after block: noise scatters about a mean, a drift has a trend.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...identify.fourier import harmonics, line, taper
from ...identify.operating_state import fundamental_facts
from ...identify.settling import SETTLED_LIMIT, period_change, trend
from ...plant.protocol import Job, Plant, Record
from ..excitation.frequencies import Block
from ..plan import Batch
from .loadflow import reached

QUIET_BLOCKS = 2
"""Blocks of a quiet baseline: one to keep, one to compare it with."""

NOISY_BLOCKS = 48
"""Blocks over which the waveform of a noisy device is averaged."""

TREND_LIMIT = 6.0
"""A trend of so many standard errors is a drift: noise shows one in 1e8 cases."""

LEAST_CURRENT_PU = 0.01
"""A smaller current is judged as if it had this peak (pu): an idle device has none but rounding."""

NOISE_LIMIT = 0.5
"""Beyond this scatter, relative to the peak, there is no waveform left to speak of."""


class PlantFault(Exception):
    """The plant broke its promise; the message says how."""


class Baseline(NamedTuple):
    """The unperturbed branch: one block, as phasors at its harmonics.

    Attributes
    ----------
    state : State
        Where every shot branches from.
    v, i : (n,) complex
        `harmonics` of one block, the mean of all blocks heard.
    v_variance, i_variance : (n,) float
        Variance of those means (V^2, A^2); zero where the device is quiet.
    t0_s : float
        Time of that state (s).
    phi1 : float
        Angle of the fundamental voltage at time zero (rad).
    change : float
        Change over one block, relative to the peak.
    noisy : bool
        Whether it changes by more than a quiet device does.
    fundamental : mapping of str to float
        `fundamental_facts` of it.
    """

    state: Any
    v: np.ndarray
    i: np.ndarray
    v_variance: np.ndarray
    i_variance: np.ndarray
    t0_s: float
    phi1: float
    change: float
    noisy: bool
    fundamental: dict[str, float]


class Unsettled(Exception):
    """The device drifts; the message is the reason of its rows."""


def baseline(plant: Plant, batch: Batch) -> Baseline:
    """Settle the operating point of ``batch`` and listen to it unperturbed.

    Raises
    ------
    NotSettled
        If the plant finds no steady state.
    Unsettled
        If what it calls steady drifts.
    """
    source, point = reached(plant, batch.source, batch.condition)
    state = plant.settle(point, source)
    steps = batch.block.steps
    ((_, record),) = run(plant, [Job(state, None)], QUIET_BLOCKS * steps)
    least_a = LEAST_CURRENT_PU * plant.rating.peak_current_a
    change = max(period_change(record.v), period_change(record.i, least_a))
    noisy = not change <= SETTLED_LIMIT
    if noisy:
        ((_, record),) = run(plant, [Job(state, None)], NOISY_BLOCKS * steps)
        _refuse_drift(record, batch.block, change, least_a)
    v, i = (_mean_block(x, steps) if noisy else x[:steps] for x in (record.v, record.i))
    v1, i1 = (line(x, batch.f1_hz, record.t0_s, batch.dt_s) for x in (v, i))
    return Baseline(
        state=state,
        v=harmonics(v, record.t0_s, batch.dt_s),
        i=harmonics(i, record.t0_s, batch.dt_s),
        v_variance=_variance(record.v, steps) if noisy else np.zeros(steps),
        i_variance=_variance(record.i, steps) if noisy else np.zeros(steps),
        t0_s=record.t0_s,
        phi1=float(np.angle(v1)),
        change=change,
        noisy=noisy,
        fundamental=fundamental_facts(v1, i1),
    )


def _refuse_drift(record: Record, block: Block, change: float, least_a: float) -> None:
    for x, least in ((record.v, 0.0), (record.i, least_a)):
        blocks = x.reshape(-1, block.steps)
        scatter = np.sqrt(np.mean(np.abs(blocks - blocks.mean(axis=0)) ** 2))
        fundamental = np.fft.fft(blocks, axis=1)[:, block.periods]
        moved, in_errors = trend(fundamental)
        drifts = moved > SETTLED_LIMIT * max(np.abs(fundamental.mean()), least) and in_errors > TREND_LIMIT
        if drifts or not scatter <= NOISE_LIMIT * max(np.max(np.abs(x)), least):
            raise Unsettled(
                f"unperturbed waveforms change by {change:.2g} of their peak over one period; {SETTLED_LIMIT:g} is "
                "needed, or noise about a steady mean"
            )


def _mean_block(x: np.ndarray, steps: int) -> np.ndarray:
    """Mean (steps,) of the blocks of ``x``, tapered: what is not synchronous with them hardly leaks in."""
    return (taper(len(x)) * x).reshape(-1, steps).mean(axis=0)


def _variance(x: np.ndarray, steps: int) -> np.ndarray:
    """Variance (steps,) of the harmonics of `_mean_block`, from the scatter of the blocks."""
    blocks = np.fft.fft(x.reshape(-1, steps), axis=1) / steps
    return np.var(blocks, axis=0, ddof=1) * np.mean(taper(len(x)) ** 2) / len(blocks)


def run(plant: Plant, jobs: list[Job], n_steps: int) -> list[tuple[Any, Record]]:
    """`Plant.run`, held to its promise of as many samples as asked."""
    answers = plant.run(jobs, n_steps)
    if len(answers) != len(jobs):
        raise PlantFault(f"run gave {len(answers)} answers to {len(jobs)} jobs")
    for _, record in answers:
        if len(record.v) != n_steps or len(record.i) != n_steps:
            raise PlantFault(f"run gave {len(record.v)} and {len(record.i)} samples of v and i; {n_steps} were asked")
        if abs(record.f1_hz - plant.f1_hz) > 1e-9 * plant.f1_hz or abs(record.dt_s - plant.dt_s) > 1e-9 * plant.dt_s:
            raise PlantFault("a record's f1_hz or dt_s is not that of the plant")
    return answers
