"""Jobs on their way together: their columns stay between two stretches, and lanes are filled with whoever is left.

What a stretch costs in Python is a few array operations for all jobs, not some for each of them: with a thousand
experiments side by side that would be as much as their simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .injection import turns
from .lanes import aligned_zeros, phasor_array
from .protocol import Job, Window

T = TypeVar("T")

Advance = Callable[[np.ndarray, np.ndarray], None]
"""Steps flat arrays (n, n_slots LANES) by as many blocks as their sums, (n, n_blocks, 8, LANES), have room for."""


class Places(NamedTuple):
    """Slots of a lane's column.

    ``line`` and ``taper`` are the phasors that listen, each with its rotation per step behind it, and behind those of
    the taper its gain; ``tones`` the first of the tones' phasors, which stand ``tone_slots`` apart, each with its
    rotation per half step behind it. ``mean_taper`` is the mean of the taper that the kernel knows.
    """

    line: int
    taper: int
    tones: int
    tone_slots: int
    mean_taper: float


class Rider(NamedTuple):
    """What turns in the column of one job, in the plant's own frame, and the step at which it stands.

    ``tones`` are frequencies (Hz) and phasors at time zero, in the units of the column.
    """

    step: int
    window: Window
    line_hz: float
    tones: Sequence[tuple[float, complex]]


class Clockwork:
    """What turns in the columns (n_slots, n) of some jobs: the phasors that listen, and the tones.

    Parameters
    ----------
    riders : sequence of Rider
        The jobs.
    places : Places
        Where things stand in a column.
    n_tones : int
        Tones that a column has room for.
    block_steps, dt_s : int, float
        Steps of a block; step (s).
    """

    def __init__(self, riders: Sequence[Rider], places: Places, n_tones: int, block_steps: int, dt_s: float):
        self._places, self._block_steps, self._dt_s = places, block_steps, dt_s
        self._step = np.array([rider.step for rider in riders])
        self._block = np.array([rider.window.first_block for rider in riders])
        self._n_blocks = np.array([rider.window.n_blocks for rider in riders])
        self._line_hz = np.array([rider.line_hz for rider in riders])
        none = [(0.0, 0j)] * n_tones
        tones = [[*rider.tones, *none][:n_tones] for rider in riders]
        self._tone_hz = np.array([[f_hz for f_hz, _ in of_rider] for of_rider in tones])
        self._tone = np.array([[phasor for _, phasor in of_rider] for of_rider in tones], complex)

    def set_rotations(self, columns: np.ndarray) -> None:
        """What does not change: how far everything turns in a step, and the taper's gain."""
        places, n_blocks, steps = self._places, self._n_blocks, self._block_steps
        _set(columns, places.line + 2, slice(None), _turned(self._line_hz * self._dt_s))
        _set(columns, places.taper + 2, slice(None), _turned(1.0 / (n_blocks * steps)))
        columns[places.taper + 4] = 1.0 / (places.mean_taper * n_blocks * steps)
        for number, f_hz in enumerate(self._tone_hz.T):
            turned = np.where(self._tone[:, number] == 0j, 0j, _turned(f_hz * 0.5 * self._dt_s))
            _set(columns, places.tones + places.tone_slots * number + 2, slice(None), turned)

    def set_phasors(self, columns: np.ndarray, who: np.ndarray) -> None:
        """What turns, as it stands at the jobs' own time: computed from the number of the step, not carried along."""
        places, step, n_blocks = self._places, self._step[who], self._n_blocks[who]
        _set(columns, places.line, who, _turned(self._line_hz[who] * step * self._dt_s))
        _set(columns, places.taper, who, _turned((self._block[who] % n_blocks) / n_blocks))
        for number, (f_hz, tone) in enumerate(zip(self._tone_hz.T, self._tone.T, strict=True)):
            turned, at = _turned(f_hz[who] * step * self._dt_s), tone[who]
            slot = places.tones + places.tone_slots * number
            # by parts: numpy's product of complex arrays may round otherwise than that of two numbers
            columns[slot, who] = at.real * turned.real - at.imag * turned.imag
            columns[slot + 1, who] = at.real * turned.imag + at.imag * turned.real

    def go_on(self, who: np.ndarray, n_blocks: int) -> None:
        """Some jobs are so many blocks further."""
        self._step[who] += n_blocks * self._block_steps
        self._block[who] += n_blocks


class LanesUnderWay:
    """Jobs of a plant that is stepped in lanes; see `PhasorRun`.

    Parameters
    ----------
    columns : (n_slots, n) array
        The jobs' columns.
    clockwork : Clockwork
        What turns in them.
    kinds : (n,) int
        The kind of each job.
    advance : sequence of callable
        What steps the jobs of each kind.
    n_states : int
        States at the head of a column.
    units : (float, float)
        V and A of one unit of the kernel's sums; see `phasor_array`.
    """

    def __init__(
        self,
        columns: np.ndarray,
        clockwork: Clockwork,
        kinds: np.ndarray,
        advance: Sequence[Advance],
        n_states: int,
        units: tuple[float, float],
    ):
        self._columns = np.ascontiguousarray(columns.T).T  # one after the other in memory: so they go into lanes
        self._clockwork, self._kinds = clockwork, kinds
        self._advance, self._n_states, self._units = advance, n_states, units

    def go_on(self, who: np.ndarray, n_blocks: int) -> np.ndarray:
        """`PhasorRun.go_on`."""
        if len(self._advance) == 1:
            return self._stretch(self._advance[0], who, n_blocks)
        heard = np.empty((n_blocks, 2, 2, len(who)), complex).transpose(3, 1, 0, 2)
        for kind, advance in enumerate(self._advance):
            of_kind = np.flatnonzero(self._kinds[who] == kind)
            if len(of_kind):
                heard[of_kind] = self._stretch(advance, who[of_kind], n_blocks)
        return heard

    def _stretch(self, advance: Advance, who: np.ndarray, n_blocks: int) -> np.ndarray:
        self._clockwork.set_phasors(self._columns, who)
        lanes, n_states = in_lanes(self._columns, who), self._n_states
        sums = np.empty((len(lanes), n_blocks, 8, lanes.shape[2]))
        advance(lanes.reshape(len(lanes), -1), sums)
        self._columns[:n_states, who] = lanes[:, :n_states].transpose(1, 0, 2).reshape(n_states, -1)[:, : len(who)]
        self._clockwork.go_on(who, n_blocks)
        return phasor_array(sums, *self._units)[: len(who)]


def in_lanes(columns: np.ndarray, who: np.ndarray) -> np.ndarray:
    """Some columns as flat arrays (n, n_slots, LANES); idle lanes follow the first of theirs."""
    from .kernels.lanes import LANES

    n, n_slots = -(-len(who) // LANES), len(columns)
    lanes = aligned_zeros(n * n_slots, LANES).reshape(n, n_slots, LANES)
    filled = np.append(who, np.full(n * LANES - len(who), who[(n - 1) * LANES]))
    lanes[:] = columns.T[filled].reshape(n, LANES, n_slots).transpose(0, 2, 1)
    return lanes


def standing(states: Sequence[Any], column: Callable[[Any], np.ndarray]) -> np.ndarray:
    """``column`` (n_slots,) of every state as (n_slots, n): of many jobs from one state it is made once."""
    each = {id(state): state for state in states}
    number = {key: k for k, key in enumerate(each)}
    columns = np.stack([column(state) for state in each.values()], axis=1)
    return columns[:, [number[id(state)] for state in states]]


def of_each(jobs: Sequence[Job], found: Callable[[Job], T]) -> list[T]:
    """What is found of every job; once of those that share injection and source."""
    different = {(id(job.injection), id(job.state.source)): job for job in jobs}
    known = {key: found(job) for key, job in different.items()}
    return [known[id(job.injection), id(job.state.source)] for job in jobs]


def _set(columns: np.ndarray, slot: int, who: np.ndarray | slice, values: np.ndarray) -> None:
    columns[slot, who], columns[slot + 1, who] = values.real, values.imag


def _turned(cycles: np.ndarray) -> np.ndarray:
    """`turns` of every number, of equal ones once; not by numpy, whose sine rounds otherwise."""
    asked = np.asarray(cycles).tolist()
    known = {x: turns(x) for x in set(asked)}
    return np.array([known[x] for x in asked], complex)
