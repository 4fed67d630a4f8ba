"""From a batch of the plan to rows of the table: settle once, branch every shot, solve every point.

`measure` is the worker of a campaign: a pure function of plant, plan and batch. Wrong physics ends as
a status; a plant that raises costs the points that made it raise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from ..identify.admittance import solve_pn
from ..identify.fourier import block_phasors, harmonics, line, periodic_window
from ..identify.quality import COND_LIMIT, SETTLED_LIMIT, Settled, first_agreement, period_change, windows
from ..plant.protocol import Job, NotSettled, PhasorPlant, Phasors, Plant, Record, Window
from .grid import Frequency
from .loadflow import reached
from .plan import Batch, Plan, Shot

FIRST_WINDOWS = 2
"""Windows run before any two are compared."""

RUN_BLOCKS = 15
"""Blocks of one `run_phasors`: all shots are cut at the same places, whatever their neighbours need,
so that not even their rounding depends on the neighbours."""

DIVERGED_PU = 10.0
"""A response this many times the rated peak has left the small signal for good."""


HEARD_PU = 1e-10
"""Below this part of the rated peak a voltage is what rounding left of the steady state."""


class PlantFault(Exception):
    """The plant broke its promise; the message says how."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table, but for its operating point.

    Attributes
    ----------
    f_hz : float
        Frequency (Hz).
    y : tuple of 8 float
        Re, im of pp, pn, np, nn (S); NaN where there is nothing to show.
    status, reason : str
        As in the table.
    amplitude_pu, n_periods, window_s, cond_v, linearity, residual : float
        As in the table.
    """

    f_hz: float
    y: tuple[float, ...]
    status: str
    reason: str
    amplitude_pu: float
    n_periods: float
    window_s: float
    cond_v: float
    linearity: float
    residual: float


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Rows of a batch and what was seen of its operating point (`settle_residual`, |v_pcc|)."""

    rows: tuple[Row, ...]
    condition: dict[str, float]


class _Baseline(NamedTuple):
    """The unperturbed branch: one period, as phasors at its harmonics.

    Attributes
    ----------
    state : State
        Where every shot branches from.
    v, i : (n,) complex
        `harmonics` of one block.
    t0_s : float
        Time of that state (s).
    phi1 : float
        Angle of the fundamental voltage at time zero (rad).
    change : float
        Change over one period, relative to the peak.
    terminal_voltage_v : float
        |v_pcc|, line-to-line RMS (V).
    """

    state: Any
    v: np.ndarray
    i: np.ndarray
    t0_s: float
    phi1: float
    change: float
    terminal_voltage_v: float


def measure(plant: Plant, plan: Plan, batch: Batch) -> BatchResult:
    """Rows of every point of ``batch``, in its order.

    Parameters
    ----------
    plant : Plant
        The device; `PhasorPlant` is used where it is one.
    plan : Plan
        What is asked.
    batch : Batch
        One operating point and some of its frequencies.
    """
    try:
        baseline = _baseline(plant, plan, batch)
    except NotSettled as refusal:
        return failed_batch(plan, batch, refusal.status, str(refusal))
    except Exception as error:
        return failed_batch(plan, batch, "failed", _in_words(error))
    if not baseline.change <= SETTLED_LIMIT:
        reason = f"unperturbed waveforms change by {baseline.change:.2g} of their peak over one period; "
        return failed_batch(plan, batch, "not_settled", f"{reason}{SETTLED_LIMIT:g} is needed")
    condition = {"settle_residual": baseline.change, "terminal_voltage_v": baseline.terminal_voltage_v}
    return BatchResult(tuple(_rows(plant, plan, batch, baseline)), condition)


def _rows(plant: Plant, plan: Plan, batch: Batch, baseline: _Baseline) -> list[Row]:
    """All points together, or, where that raises, one by one: a fault costs its own points only."""
    try:
        return _measured(plant, plan, batch, baseline)
    except Exception as error:
        if len(batch.points) == 1:
            return [_failed_row(plan, batch.points[0], "failed", _in_words(error))]
        return [row for point in batch.points for row in _rows(plant, plan, replace(batch, points=(point,)), baseline)]


def _measured(plant: Plant, plan: Plan, batch: Batch, baseline: _Baseline) -> list[Row]:
    pairs = [plan.shots_of(batch.condition, point) for point in batch.points]
    settled = _drive(plant, plan, baseline, [shot for pair in pairs for shot in pair])
    both = zip(settled[0::2], settled[1::2], strict=True)
    return [_row(plan, point, pair, baseline.phi1, plant) for point, pair in zip(batch.points, both, strict=True)]


# Settling


def _baseline(plant: Plant, plan: Plan, batch: Batch) -> _Baseline:
    """Settle, run two unperturbed blocks and keep the first as the branch that is subtracted."""
    source, point = reached(plant, plan.source, batch.condition)
    state = plant.settle(point, source)
    steps = plan.block.steps
    ((_, record),) = _run(plant, [Job(state, None)], 2 * steps)
    v, i = (harmonics(x[:steps], record.t0_s, plan.dt_s) for x in (record.v, record.i))
    fundamental = line(record.v[:steps], plan.f1_hz, record.t0_s, plan.dt_s)
    change = max(period_change(record.v), period_change(record.i))
    return _Baseline(state, v, i, record.t0_s, float(np.angle(fundamental)), change, abs(fundamental) * 1.5**0.5)


# Driving


def _drive(plant: Plant, plan: Plan, baseline: _Baseline, shots: Sequence[Shot]) -> list[Settled]:
    """Run every shot until two of its successive windows agree, or its time is over."""
    states = [baseline.state] * len(shots)
    heard: list[list[Phasors]] = [[] for _ in shots]
    results: dict[int, Settled] = {}
    unperturbed, done = baseline.state, 0
    while pending := [k for k in range(len(shots)) if k not in results]:
        longest = max(_blocks_to_go(shots[k], done) for k in pending)
        n_blocks = min(longest, max(1, _most_blocks(plan, [shots[k] for k in pending]) - done))
        if isinstance(plant, PhasorPlant):
            n_blocks += -n_blocks % RUN_BLOCKS
        jobs = [Job(states[k], plan.injection(shots[k])) for k in pending]
        listening = [Window(shots[k].f_hz, shots[k].window_blocks, done) for k in pending]
        if isinstance(plant, PhasorPlant):
            answers = _listen_phasors(plant, plan, baseline, jobs, listening, n_blocks)
        else:
            unperturbed, answers = _listen_records(plant, plan, unperturbed, jobs, listening, n_blocks)
        done += n_blocks
        for k, (state, phasors) in zip(pending, answers, strict=True):
            states[k] = state
            heard[k].append(phasors)
            result = _settled(plan, shots[k], heard[k])
            if result is not None and (result.agreed or not isfinite(result.residual) or _over(plan, shots[k], done)):
                results[k] = result
    return [results[k] for k in range(len(shots))]


def _blocks_to_go(shot: Shot, done: int) -> int:
    """Blocks until the next window that can be compared is complete."""
    windows_due = max(FIRST_WINDOWS, done // shot.window_blocks + 1)
    return windows_due * shot.window_blocks - done


def _most_blocks(plan: Plan, shots: Sequence[Shot]) -> int:
    return max(_limit_blocks(plan, shot) for shot in shots)


def _limit_blocks(plan: Plan, shot: Shot) -> int:
    """Blocks of a shot's longest run: whole windows, at least those of the first comparison."""
    whole = int(plan.max_simulated_s / (shot.window_blocks * plan.block.duration_s))
    return max(FIRST_WINDOWS, whole) * shot.window_blocks


def _over(plan: Plan, shot: Shot, done: int) -> bool:
    return done >= _limit_blocks(plan, shot)


def _settled(plan: Plan, shot: Shot, heard: list[Phasors]) -> Settled | None:
    """The first agreement among the windows heard so far, at most those the limit allows."""
    most = _limit_blocks(plan, shot)
    joined = Phasors(np.concatenate([p.v for p in heard])[:most], np.concatenate([p.i for p in heard])[:most])
    v, i = windows(joined, shot.window_blocks)
    return first_agreement(v, i, plan.tolerance) if len(v) >= FIRST_WINDOWS else None


def _listen_phasors(
    plant: PhasorPlant,
    plan: Plan,
    baseline: _Baseline,
    jobs: list[Job],
    listening: list[Window],
    n_blocks: int,
) -> list[tuple[Any, Phasors]]:
    """Phasors accumulated by the plant, less those of the certified periodic baseline."""
    heard: list[list[Phasors]] = []
    for first in range(0, n_blocks, RUN_BLOCKS):
        windows_now = [window._replace(first_block=window.first_block + first) for window in listening]
        answers = _run_phasors(plant, jobs, windows_now, plan.block.steps, RUN_BLOCKS)
        jobs = [Job(state, job.injection) for (state, _), job in zip(answers, jobs, strict=True)]
        heard.append([phasors for _, phasors in answers])
    cleaned = []
    for job, window, parts in zip(jobs, listening, zip(*heard, strict=True), strict=True):
        v = _without(np.concatenate([part.v for part in parts]), baseline.v, baseline.t0_s, plan, window)
        i = _without(np.concatenate([part.i for part in parts]), baseline.i, baseline.t0_s, plan, window)
        cleaned.append((job.state, Phasors(v, i)))
    return cleaned


def _without(x: np.ndarray, lines: np.ndarray, t0_s: float, plan: Plan, window: Window) -> np.ndarray:
    """Block sums less an equal share of what the window hears of the baseline.

    Only whole windows are ever used, so the share of a single block is a matter of bookkeeping.
    """
    window_s = window.n_blocks * plan.block.duration_s
    pair = (window.f_hz, 2.0 * plan.f1_hz - window.f_hz)
    heard = [periodic_window(lines, round(f * window_s), window.n_blocks, t0_s / window_s) for f in pair]
    return x - np.array(heard) / window.n_blocks


def _listen_records(
    plant: Plant,
    plan: Plan,
    unperturbed: Any,
    jobs: list[Job],
    listening: list[Window],
    n_blocks: int,
) -> tuple[Any, list[tuple[Any, Phasors]]]:
    """Records less the unperturbed branch, sample by sample, then the phasors."""
    steps = n_blocks * plan.block.steps
    (after, reference), *answers = _run(plant, [Job(unperturbed, None), *jobs], steps)
    cleaned = []
    for (state, record), window in zip(answers, listening, strict=True):
        deviation = replace(record, v=record.v - reference.v, i=record.i - reference.i)
        cleaned.append((state, block_phasors(deviation, window, plan.block.steps)))
    return after, cleaned


def _run(plant: Plant, jobs: list[Job], n_steps: int) -> list[tuple[Any, Record]]:
    """`Plant.run`, held to its promise of as many finite samples as asked."""
    answers = plant.run(jobs, n_steps)
    if len(answers) != len(jobs):
        raise PlantFault(f"run gave {len(answers)} answers to {len(jobs)} jobs")
    for _, record in answers:
        if len(record.v) != n_steps or len(record.i) != n_steps:
            raise PlantFault(f"run gave {len(record.v)} and {len(record.i)} samples of v and i; {n_steps} were asked")
        if abs(record.f1_hz - plant.f1_hz) > 1e-9 * plant.f1_hz or abs(record.dt_s - plant.dt_s) > 1e-9 * plant.dt_s:
            raise PlantFault("a record's f1_hz or dt_s is not that of the plant")
    return answers


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


# Solving and judging


def _row(plan: Plan, point: Frequency, pair: tuple[Settled, Settled], phi1: float, plant: Plant) -> Row:
    v, i = np.array([s.v for s in pair]), np.array([s.i for s in pair])
    residual = max(s.residual for s in pair) if _finite(v, i) else nan
    status, reason = _judge_response(plan, point, pair, v, i, plant)
    if status != "ok":
        return replace(_failed_row(plan, point, status, reason), residual=residual if isfinite(residual) else nan)
    try:
        y, cond_v = solve_pn(v, i, phi1)
    except np.linalg.LinAlgError as error:
        return _failed_row(plan, point, "ill_conditioned", str(error))
    if not cond_v <= COND_LIMIT:
        status, reason = "ill_conditioned", f"cond(V) is {cond_v:.2g}: the two experiments are nearly one"
    elements = tuple(part for element in y.ravel() for part in (float(element.real), float(element.imag)))
    blank = _failed_row(plan, point, status, reason)
    return replace(blank, y=elements, cond_v=cond_v, residual=residual)


def _judge_response(
    plan: Plan, point: Frequency, pair: tuple[Settled, Settled], v: np.ndarray, i: np.ndarray, plant: Plant
) -> tuple[str, str]:
    """Status and reason of what was heard, before it is solved."""
    if not _finite(v, i):
        return "diverged", "the response is not finite"
    size = max(np.max(np.abs(i)) / plant.rating.peak_current_a, np.max(np.abs(v)) / plant.rating.peak_voltage_v)
    if size > DIVERGED_PU:
        return "diverged", f"the response reaches {size:.2g} times the rated peak"
    if np.min(np.max(np.abs(v), axis=1)) < HEARD_PU * plant.rating.peak_voltage_v:
        return "ill_conditioned", "the perturbation does not arrive: an experiment shows no voltage at its lines"
    worst = max(pair, key=lambda s: s.residual)
    if worst.agreed:
        return "ok", ""
    if worst.growth > 1.1:
        return "diverged", f"the response grows by a factor {worst.growth:.3g} from window to window"
    simulated = (worst.window + 1) * point.window_blocks * plan.block.duration_s
    return "not_settled", (
        f"successive windows still differ by {worst.residual:.2g} after {simulated:g} s; {plan.tolerance:g} is asked "
        "(raise sweep.max_simulated_s or sweep.tolerance)"
    )


def _finite(v: np.ndarray, i: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(v)) and np.all(np.isfinite(i)))


def failed_batch(plan: Plan, batch: Batch, status: str, reason: str) -> BatchResult:
    """Every point of ``batch`` as a row of ``status`` with the same reason."""
    return BatchResult(tuple(_failed_row(plan, point, status, reason) for point in batch.points), {})


def _failed_row(plan: Plan, point: Frequency, status: str, reason: str) -> Row:
    """A row without a result: what was asked stands, what was measured is NaN."""
    window_s = point.window_blocks * plan.block.duration_s
    return Row(
        f_hz=point.f_hz,
        y=(nan,) * 8,
        status=status,
        reason=reason,
        amplitude_pu=plan.amplitude_pu,
        n_periods=float(point.n_periods),
        window_s=window_s,
        cond_v=nan,
        linearity=nan,
        residual=nan,
    )


def _in_words(error: Exception) -> str:
    text = " ".join(str(error).split()) or "no message"
    return f"{type(error).__name__}: {text}"[:300]
