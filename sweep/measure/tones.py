"""Driving tones: every shot runs until its response is at rest, listened to in coherent windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from ...identify.fourier import block_phasors, periodic_window
from ...identify.settling import NOISY_WINDOWS, Agreements, Settled, first_agreement, steady_mean, windows
from ...plant.protocol import Job, LanePlant, PhasorPlant, PhasorRun, Phasors, Plant, Window
from ..plan import Batch, Shot
from .baseline import Baseline, PlantFault, run

QUIET_WINDOWS = 2
"""Windows of a quiet shot before any two are compared."""

RUN_BLOCKS = 15
"""Blocks of one `PhasorRun.go_on`: all shots are cut at the same places, whatever their neighbours need,
so that not even their rounding depends on the neighbours."""


class Driven(NamedTuple):
    """What is driven from one baseline: tones, all from its state."""

    batch: Batch
    baseline: Baseline
    shots: Sequence[Shot]


def drive(plant: Plant, asked: Sequence[Driven]) -> list[list[Settled]]:
    """Run every shot until it is at rest and known well enough, or its time is over.

    Parameters
    ----------
    plant : Plant
        The device; what it can do as a `PhasorPlant` or `LanePlant` is used.
    asked : sequence of Driven
        Shots from one baseline or from several.

    Returns
    -------
    list of list of Settled
        Of every baseline, in its order of shots.
    """
    if isinstance(plant, PhasorPlant):
        settled = iter(_drive_by_rounds(plant, asked))
        return [[next(settled) for _ in one.shots] for one in asked]
    return [_drive_by_windows(plant, one) for one in asked]


def _drive_by_rounds(plant: PhasorPlant, asked: Sequence[Driven]) -> list[Settled]:
    """All shots that are not over go on by `RUN_BLOCKS`, again and again.

    A plant that is stepped in lanes fills them with whoever is left, long windows beside short ones, of one operating
    point or of several. A shot is judged whenever another window of its own is complete.
    """
    rounds, run = _Rounds(asked), _under_way(plant, asked)
    done = 0
    while len(pending := rounds.pending):
        rounds.hear(pending, _answer(run, pending), done)
        done += RUN_BLOCKS
    return [rounds.settled(k) for k in range(len(rounds))]


def _under_way(plant: PhasorPlant, asked: Sequence[Driven]) -> PhasorRun:
    """All shots, ready to go on: as the plant does it best, else as jobs that are handed back and forth."""
    block_steps = asked[0].batch.block.steps
    jobs = [Job(one.baseline.state, shot.injection) for one in asked for shot in one.shots]
    listening = [shot.window for one in asked for shot in one.shots]
    best = plant.phasor_run(jobs, listening, block_steps) if isinstance(plant, LanePlant) else None
    return best or _JobByJob(plant, jobs, listening, block_steps)


def _answer(run: PhasorRun, who: np.ndarray) -> np.ndarray:
    """`PhasorRun.go_on`, held to its promise of as many blocks as asked."""
    heard, asked = run.go_on(who, RUN_BLOCKS), (len(who), 2, RUN_BLOCKS, 2)
    if np.shape(heard) != asked:
        raise PlantFault(f"go_on gave phasors of shape {np.shape(heard)}; {asked} is needed")
    return heard


class _Rounds:
    """The shots of some baselines, and what was heard of them less what their baselines let hear."""

    def __init__(self, asked: Sequence[Driven]):
        self._of = [(one.batch, one.baseline, shot) for one in asked for shot in one.shots]
        self._limit_blocks = np.array([_limit_blocks(*of) for of in self._of])
        self._noisy = np.array([baseline.noisy for _, baseline, _ in self._of])
        self._unperturbed = _unperturbed(asked)
        n_blocks = np.array([shot.window.n_blocks for _, _, shot in self._of])
        tolerance = np.array([batch.limits.tolerance for batch, _, _ in self._of])
        self._n_blocks, self._quiet = n_blocks, Agreements(n_blocks, self._limit_blocks, tolerance)
        self._heard: list[tuple[np.ndarray, np.ndarray]] = []
        self._known: dict[int, Settled] = {}
        self._over = np.zeros(len(self), bool)

    def __len__(self) -> int:
        return len(self._of)

    @property
    def pending(self) -> np.ndarray:
        """Numbers of the shots that are not over."""
        return np.flatnonzero(~self._over)

    def hear(self, who: np.ndarray, phasors: np.ndarray, done: int) -> None:
        """The next blocks (n, 2, `RUN_BLOCKS`, 2) of some shots, which heard ``done`` of them before."""
        due = done + RUN_BLOCKS
        heard = (phasors.transpose(2, 1, 3, 0) - np.take(self._unperturbed, who, axis=2)).transpose(3, 1, 0, 2)
        self._heard.append((who, heard))
        quiet = ~self._noisy[who]
        self._quiet.hear(who[quiet], heard if quiet.all() else heard[quiet], done)
        self._over[who[quiet]] = self._quiet.over[who[quiet]]
        another = (due // self._n_blocks[who] > done // self._n_blocks[who]) | (due >= self._limit_blocks[who])
        for k in who[~quiet & another].tolist():
            self._judge(k, due)

    def settled(self, k: int) -> Settled:
        """What is to be said of shot ``k``, which is over."""
        if self._noisy[k]:
            return self._known[k]
        if self._quiet.agreed[k]:
            return self._quiet.settled(k)
        result = self._settled(k, over=True)
        assert result is not None
        return result

    def _judge(self, k: int, due: int) -> None:
        over = due >= self._limit_blocks[k]
        result = self._settled(k, over)
        if result is not None and (over or result.agreed or not isfinite(result.residual)):
            self._known[k], self._over[k] = result, True

    def _settled(self, k: int, over: bool) -> Settled | None:
        """All that was heard of a shot, judged."""
        rounds = [heard[np.searchsorted(who, k)] for who, heard in self._heard if k in who]
        return _settled(*self._of[k], [Phasors(v, i) for v, i in rounds], over)


def _unperturbed(asked: Sequence[Driven]) -> np.ndarray:
    """What every block of every shot hears of its baseline, (2, 2, n); most windows are those of several shots."""
    baselines, batch = [one.baseline for one in asked], asked[0].batch
    windows_of = [[shot.window for shot in one.shots] for one in asked]
    different = list(dict.fromkeys(window for of_one in windows_of for window in of_one))
    number = {window: k for k, window in enumerate(different)}
    heard = _heard_of(baselines, batch, different)
    own = [heard[[number[window] for window in of_one], k] for k, of_one in enumerate(windows_of)]
    return np.ascontiguousarray(np.concatenate(own).transpose(1, 2, 0))


class _JobByJob:
    """Jobs of a plant that are handed back and forth, one by one; see `PhasorRun`."""

    def __init__(self, plant: PhasorPlant, jobs: list[Job], windows: list[Window], block_steps: int):
        self._plant, self._jobs, self._windows, self._block_steps = plant, jobs, windows, block_steps

    def go_on(self, who: np.ndarray, n_blocks: int) -> np.ndarray:
        """`PhasorRun.go_on`."""
        jobs, windows = [self._jobs[k] for k in who], [self._windows[k] for k in who]
        answers = _run_phasors(self._plant, jobs, windows, self._block_steps, n_blocks)
        for k, job, window, (state, _) in zip(who.tolist(), jobs, windows, answers, strict=True):
            self._jobs[k] = Job(state, job.injection)
            self._windows[k] = window._replace(first_block=window.first_block + n_blocks)
        return np.array([[phasors.v, phasors.i] for _, phasors in answers])


class _OnItsWay:
    """One shot of a plant that gives records: where it is, what was heard of it, and its result where it is over."""

    def __init__(self, batch: Batch, baseline: Baseline, shot: Shot):
        self.batch, self.baseline, self.of = batch, baseline, shot
        self.state = baseline.state
        self.limit_blocks = _limit_blocks(batch, baseline, shot)
        self.result: Settled | None = None
        self._heard: list[Phasors] = []

    @property
    def job(self) -> Job:
        return Job(self.state, self.of.injection)

    def window(self, done: int) -> Window:
        return self.of.window._replace(first_block=done)

    def goes_on(self, state: Any, phasors: Phasors) -> None:
        self.state = state
        self._heard.append(phasors)

    def judge(self, done: int) -> None:
        over = done >= self.limit_blocks
        result = _settled(self.batch, self.baseline, self.of, self._heard, over)
        if result is not None and (over or result.agreed or not isfinite(result.residual)):
            self.result = result


def _drive_by_windows(plant: Plant, asked: Driven) -> list[Settled]:
    """All shots of a baseline that are not over go on until each of them has another window that can be judged."""
    batch, baseline = asked.batch, asked.baseline
    shots = [_OnItsWay(batch, baseline, shot) for shot in asked.shots]
    unperturbed, done = baseline.state, 0
    while pending := [shot for shot in shots if shot.result is None]:
        longest = max(_blocks_to_go(baseline, shot.of, done) for shot in pending)
        n_blocks = min(longest, max(1, max(shot.limit_blocks for shot in pending) - done))
        jobs, listening = [shot.job for shot in pending], [shot.window(done) for shot in pending]
        if baseline.noisy:
            answers = _listen_noisy_records(plant, batch, baseline, jobs, listening, n_blocks)
        else:
            unperturbed, answers = _listen_records(plant, batch, unperturbed, jobs, listening, n_blocks)
        done += n_blocks
        for shot, (state, phasors) in zip(pending, answers, strict=True):
            shot.goes_on(state, phasors)
            shot.judge(done)
    return [shot.result for shot in shots if shot.result is not None]


def _blocks_to_go(baseline: Baseline, shot: Shot, done: int) -> int:
    """Blocks until the next window that can be judged is complete."""
    windows_due = max(_first_windows(baseline), done // shot.window.n_blocks + 1)
    return windows_due * shot.window.n_blocks - done


def _first_windows(baseline: Baseline) -> int:
    return NOISY_WINDOWS + 1 if baseline.noisy else QUIET_WINDOWS


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


def _listen_noisy_records(
    plant: Plant, batch: Batch, baseline: Baseline, jobs: list[Job], listening: list[Window], n_blocks: int
) -> list[tuple[Any, Phasors]]:
    """Phasors of records less those of the mean baseline: subtracting another noisy branch would double the noise."""
    answers = run(plant, jobs, n_blocks * batch.block.steps)
    return [
        (state, _less(block_phasors(record, window, batch.block.steps), of_baseline))
        for (state, record), window, (of_baseline,) in zip(
            answers, listening, _heard_of([baseline], batch, listening), strict=True
        )
    ]


def _heard_of(baselines: Sequence[Baseline], batch: Batch, listening: Sequence[Window]) -> np.ndarray:
    """What one block of each window hears of each baseline, v and i at line and mirror, (n_windows, n_baselines, 2, 2):
    an equal share of what the window hears.

    Only whole windows are ever used, so the share of a single block is a matter of bookkeeping.
    """
    n_blocks, f_hz = (np.array(x) for x in zip(*((window.n_blocks, window.f_hz) for window in listening), strict=True))
    window_s = n_blocks * batch.block.duration_s
    lines = np.array([[baseline.v, baseline.i] for baseline in baselines])
    start = np.array([baseline.t0_s for baseline in baselines])[:, None, None] / window_s
    cycles = [np.round(f * window_s).astype(int) for f in (f_hz, 2.0 * batch.f1_hz - f_hz)]
    heard = np.stack([periodic_window(lines, of_line, n_blocks, start) for of_line in cycles], axis=-1)
    return heard.transpose(2, 0, 1, 3) / n_blocks[:, None, None, None]


def _less(phasors: Phasors, unperturbed: np.ndarray) -> Phasors:
    return Phasors(phasors.v - unperturbed[0], phasors.i - unperturbed[1])


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
