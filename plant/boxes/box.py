"""A box that takes a voltage and gives a current, and can only go forwards: as a plant.

A state is the *way* to it: the operating point at which the box was settled, and everything injected since.
How the way is gone is the business of its `StateStore`: by a snapshot, by a fork, or from cold.

Behind an ideal source alone. A grid would have to be solved together with the box, step by step, and a box that
cannot go back cannot be asked twice; its admittance is the same on an ideal source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..errors import SeqsweepError
from ..injection import series_tones
from ..protocol import Job, NotSettled, OperatingPoint, OperatingRange, Rating, Record, Source
from ..states.steady_state import HOLDS, Clock, Patience, once, phase_peak, until_periodic, voltage_asked
from ..states.store import StateStore, Way


class Box(Protocol):
    """A device between its terminals."""

    def start(self, operating_point: OperatingPoint) -> None:
        """Begin at time zero, cold."""
        ...

    def advance(self, v: np.ndarray) -> np.ndarray:
        """Currents (n,) at the ends of n steps under voltages (n,), each held for its step; space vectors."""
        ...


class Settled(NamedTuple):
    """Steps it took, current at their end (A), last change over a period."""

    steps: int
    i: complex
    residual: float


@dataclass(frozen=True)
class Settle:
    """Start a box and run it unperturbed until a period repeats."""

    operating_point: OperatingPoint
    v_source: complex
    clock: Clock
    patience: Patience
    peak_a: float
    hold: str

    def __call__(self, box: Box) -> Settled:
        box.start(self.operating_point)
        i_end = 0j

        def run(first_step: int, n_steps: int) -> np.ndarray:
            nonlocal i_end
            v = self.clock.held(self.hold, ((self.clock.f1_hz, self.v_source),), first_step, n_steps)
            i = box.advance(v)
            i_end = complex(i[-1])
            return i[None, :] / self.peak_a

        steps, residual = until_periodic(run, self.clock, self.patience)
        return Settled(steps, i_end, residual)


@dataclass(frozen=True)
class Drive:
    """Go on under rotating voltages, given by their signed frequencies (Hz) and values at time zero (V)."""

    tones: tuple[tuple[float, complex], ...]
    clock: Clock
    first_step: int
    n_steps: int
    hold: str

    def voltage(self) -> np.ndarray:
        """The terminal voltage (n_steps,)."""
        return self.clock.voltage(self.tones, self.first_step, self.n_steps)

    def __call__(self, box: Box) -> np.ndarray:
        return box.advance(self.clock.held(self.hold, self.tones, self.first_step, self.n_steps))


class Identity(NamedTuple):
    """What a box is; as in `Plant`."""

    id: str
    clock: Clock
    rating: Rating
    operating_range: OperatingRange
    power_meaning: str


@dataclass(frozen=True, slots=True)
class DrivenState:
    """The way to a state, and what a record needs of it."""

    step: int
    time_s: float
    i: complex
    way: Way
    v_source: complex


class DrivenPlant:
    """A `Box` as a plant.

    Parameters
    ----------
    identity : Identity
        What it says of itself.
    branches : StateStore
        How its states are reached.
    patience : Patience
        When it counts as settled.
    contents : mapping, optional
        What the table should remember beside its parameters, such as the hash of a file.
    hold : "start" or "mean"
        What the box is told of the source's voltage in a step; see `HOLDS`.

    Raises
    ------
    SeqsweepError
        If ``hold`` is neither.
    """

    ideal_only = "it goes forwards and never back"

    def __init__(
        self,
        identity: Identity,
        branches: StateStore,
        patience: Patience,
        contents: Mapping[str, Any] | None = None,
        hold: str = "start",
    ):
        if hold not in HOLDS:
            raise SeqsweepError(f"hold is {hold!r}; needed: {', '.join(HOLDS)}")
        self._hold = hold
        self.id, (self.f1_hz, self.dt_s), self.rating, self.operating_range, self.power_meaning = identity
        self.contents = {**(contents or {}), "held_late_s": 0.5 * self.dt_s if hold == "start" else 0.0}
        self._clock, self._branches, self._patience = identity.clock, branches, patience
        self._settled: dict[Settle, Settled | NotSettled] = {}

    def settle(self, operating_point: OperatingPoint, source: Source) -> DrivenState:
        """Run from cold until a period repeats; see `Plant.settle`.

        Raises
        ------
        SeqsweepError
            If the operating point is outside the range, or the source is not ideal.
        NotSettled
            If the current does not repeat within the patience.
        """
        voltage_v = voltage_asked(operating_point, source, self.operating_range, self.rating, self.id)
        if source.kind != "ideal":
            raise SeqsweepError(
                f"{self.id} goes forwards only: it stands on an ideal source, where its admittance is the same; "
                'give [source] kind = "ideal"'
            )
        v_source = phase_peak(voltage_v, source.angle_rad)
        action = Settle(operating_point, v_source, self._clock, self._patience, self.rating.peak_current_a, self._hold)
        steps, i, _ = once(self._settled, action, lambda: self._branches.act((), action))
        return DrivenState(steps, steps * self.dt_s, i, (action,), v_source)

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[DrivenState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job: Job, n_steps: int) -> tuple[DrivenState, Record]:
        state: DrivenState = job.state
        tones = series_tones(job.injection, Source(), lambda f_hz: 0j)
        drive = Drive(((self.f1_hz, state.v_source), *tones), self._clock, state.step, n_steps, self._hold)
        i_end = self._branches.act(state.way, drive)
        i = np.concatenate([[state.i], i_end[:-1]])
        step = state.step + n_steps
        end = replace(state, step=step, time_s=step * self.dt_s, i=complex(i_end[-1]), way=(*state.way, drive))
        return end, Record(state.time_s, self.dt_s, drive.voltage(), i, self.f1_hz, "load", self.id)
