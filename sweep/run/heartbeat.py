"""Signs of life of a device that takes long, or hangs: which shot it is at, for how long, and when it is given up.

A child that measures sends a `Beat` before every shot that it drives; the runner, which waits, says a line at times.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from ...plant.boxes.box import DrivenPlant
from ...plant.protocol import Job, Plant
from ..plan import Batch

FIRST_S = 10.0
"""A batch that is waited for so long gets a line; the next ones come after twice the time each."""

BETWEEN_S = 0.1
"""Least time between two beats of a child."""


class Beat(NamedTuple):
    """A device is at this one of so many shots, at these frequencies (Hz); none where it only goes on."""

    shot: int
    shots: int
    f_hz: tuple[float, ...]


def beating(plant: Plant, send: Callable[[Beat], None]) -> None:
    """Let ``plant`` send a beat before every shot, or before all of them where it drives them together."""
    run, last = plant.run, 0.0

    def told(shot: int, jobs: Sequence[Job], n_jobs: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= BETWEEN_S:
            last = now
            send(Beat(shot, n_jobs, _frequencies(jobs)))

    def run_one_by_one(jobs: Sequence[Job], n_steps: int) -> list[Any]:
        ended = []
        for k, job in enumerate(jobs):
            told(k + 1, [job], len(jobs))
            ended += run([job], n_steps)
        return ended

    def run_together(jobs: Sequence[Job], n_steps: int) -> list[Any]:
        told(1, jobs, len(jobs))
        return run(jobs, n_steps)

    def run_phasors_together(jobs: Sequence[Job], *given: Any) -> Any:
        told(1, jobs, len(jobs))
        return phasors(jobs, *given)

    phasors: Any = getattr(plant, "run_phasors", None)
    alone = isinstance(plant, DrivenPlant)  # what can only go forwards drives its shots one after the other anyway
    with suppress(AttributeError):  # an object that takes no attribute has no beats
        plant.run = run_one_by_one if alone else run_together  # type: ignore[method-assign]
        if phasors is not None:
            plant.run_phasors = run_phasors_together  # type: ignore[attr-defined]


def _frequencies(jobs: Sequence[Job]) -> tuple[float, ...]:
    tones = [job.injection.tones for job in jobs if job.injection is not None]
    return tuple(sorted({float(tone.f_hz) for each in tones for tone in each}))


class Waiting:
    """Says how a batch that is waited for is doing.

    Parameters
    ----------
    batch : Batch
        What is waited for.
    timeout_s : float
        Wall time (s) after which it is given up.
    say : callable
        Takes a line; called from the thread that waits.
    """

    def __init__(self, batch: Batch, timeout_s: float, say: Callable[[str], None]):
        self._batch, self._timeout_s, self._say = batch, timeout_s, say
        self._begin = time.monotonic()
        self._next_s = FIRST_S
        self._beat: Beat | None = None
        self._since = self._begin

    def beat(self, beat: Beat) -> None:
        """The device is at another shot."""
        self._beat, self._since = beat, time.monotonic()

    def look(self) -> None:
        """Say a line where it is time for one."""
        now = time.monotonic()
        if now - self._begin >= self._next_s:
            self._next_s *= 2.0
            self._say(self._text(now))

    def _text(self, now: float) -> str:
        op_id = self._batch.condition.op_id
        left = max(0.0, self._timeout_s - (now - self._begin))
        return (
            f"{op_id}: {self._where()} for {now - self._since:.0f} s, the batch for {now - self._begin:.0f} s; it is "
            f"given up in {left:.0f} s (plant.timeout_s for each of its {self._batch.n_shots} shots)"
        )

    def _where(self) -> str:
        if self._beat is None:
            return "not yet at a shot, starting or settling"
        shot, shots, f_hz = self._beat
        if not f_hz:
            return "unperturbed"
        at = f"{f_hz[0]:.4g} Hz" if len(f_hz) == 1 else f"{f_hz[0]:.4g} to {f_hz[-1]:.4g} Hz"
        return f"at shot {shot} of {shots}, {at}," if len(f_hz) <= 2 else f"at {shots} shots together, {at},"
