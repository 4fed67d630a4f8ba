"""Jobs on their way together: their columns stay between two stretches, and lanes are filled with whoever is left.

What a stretch costs in Python is a few array operations for all jobs, not some for each of them: with a thousand
experiments side by side that would be as much as their simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .injection import turns
from .lanes import aligned_zeros, phasor_array
from .protocol import Window

Advance = Callable[[np.ndarray, np.ndarray], None]
"""Steps flat arrays (n, n_slots LANES) by as many blocks as their sums, (n, n_blocks, 8, LANES), have room for."""


class Places(NamedTuple):
    """Slots of a lane's column: its first ``n_states`` are states, the others begin where these numbers say.

    ``line`` and ``taper`` are the phasors that listen; ``tones`` the first of the tones' phasors, which stand
    ``tone_slots`` apart.
    """

    n_states: int
    line: int
    taper: int
    tones: int
    tone_slots: int


class Rider(NamedTuple):
    """One job: its column (n_slots,), where its clock stands, and what turns with it, in the plant's own frame.

    ``tones`` are frequencies (Hz) and phasors at time zero, in the units of the column.
    """

    column: np.ndarray
    kind: int
    step: int
    window: Window
    line_hz: float
    tones: Sequence[tuple[float, complex]]


class LanesUnderWay:
    """Jobs of a plant that is stepped in lanes; see `PhasorRun`.

    Parameters
    ----------
    riders : sequence of Rider
        The jobs.
    advance : sequence of callable
        What steps the jobs of each kind.
    places : Places
        Where things stand in a column.
    units : (float, float)
        V and A of one unit of the kernel's sums; see `phasor_array`.
    block_steps, dt_s : int, float
        Steps of a block; step (s).
    """

    def __init__(
        self,
        riders: Sequence[Rider],
        advance: Sequence[Advance],
        places: Places,
        units: tuple[float, float],
        block_steps: int,
        dt_s: float,
    ):
        self._advance, self._places, self._units = advance, places, units
        self._block_steps, self._dt_s = block_steps, dt_s
        self._columns = np.stack([rider.column for rider in riders], axis=1)
        self._kind = np.array([rider.kind for rider in riders])
        self._step = np.array([rider.step for rider in riders])
        self._block = np.array([rider.window.first_block for rider in riders])
        self._n_blocks = np.array([rider.window.n_blocks for rider in riders])
        self._line_hz = np.array([rider.line_hz for rider in riders])
        most = max(len(rider.tones) for rider in riders)
        tones = [[*rider.tones, *[(0.0, 0j)] * (most - len(rider.tones))] for rider in riders]
        self._tone_hz = np.array([[f_hz for f_hz, _ in of_rider] for of_rider in tones])
        self._tone = np.array([[phasor for _, phasor in of_rider] for of_rider in tones], complex)

    def go_on(self, who: np.ndarray, n_blocks: int) -> np.ndarray:
        """`PhasorRun.go_on`."""
        heard = np.empty((len(who), 2, n_blocks, 2), complex)
        for kind, advance in enumerate(self._advance):
            of_kind = np.flatnonzero(self._kind[who] == kind)
            if len(of_kind):
                heard[of_kind] = self._stretch(advance, who[of_kind], n_blocks)
        return heard

    def _stretch(self, advance: Advance, who: np.ndarray, n_blocks: int) -> np.ndarray:
        lanes, n_states = self._filled(who), self._places.n_states
        sums = np.empty((len(lanes), n_blocks, 8, lanes.shape[2]))
        advance(lanes.reshape(len(lanes), -1), sums)
        self._columns[:n_states, who] = lanes[:, :n_states].transpose(1, 0, 2).reshape(n_states, -1)[:, : len(who)]
        self._step[who] += n_blocks * self._block_steps
        self._block[who] += n_blocks
        return phasor_array(sums, *self._units)[: len(who)]

    def _filled(self, who: np.ndarray) -> np.ndarray:
        """Flat arrays (n, n_slots, LANES) of some jobs; idle lanes follow the first of their array."""
        from .kernels.lanes import LANES

        self._set_clocks(who)
        n, n_slots = -(-len(who) // LANES), len(self._columns)
        lanes = aligned_zeros(n * n_slots, LANES).reshape(n, n_slots, LANES)
        filled = np.append(who, np.full(n * LANES - len(who), who[(n - 1) * LANES]))
        lanes[:] = self._columns[:, filled].reshape(n_slots, n, LANES).transpose(1, 0, 2)
        return lanes

    def _set_clocks(self, who: np.ndarray) -> None:
        """What turns, as it stands at the jobs' own time: computed from the number of the step, not carried along."""
        places, step = self._places, self._step[who]
        line = _turned(self._line_hz[who] * step * self._dt_s)
        self._set(places.line, who, line.real, line.imag)
        n_blocks = self._n_blocks[who]
        taper = _turned((self._block[who] % n_blocks) / n_blocks)
        self._set(places.taper, who, taper.real, taper.imag)
        for number, (f_hz, tone) in enumerate(zip(self._tone_hz.T, self._tone.T, strict=True)):
            turned, at = _turned(f_hz[who] * step * self._dt_s), tone[who]
            # by parts: numpy's product of complex arrays may round otherwise than that of two numbers
            re = at.real * turned.real - at.imag * turned.imag
            im = at.real * turned.imag + at.imag * turned.real
            self._set(places.tones + places.tone_slots * number, who, re, im)

    def _set(self, slot: int, who: np.ndarray, re: np.ndarray, im: np.ndarray) -> None:
        self._columns[slot, who], self._columns[slot + 1, who] = re, im


def _turned(cycles: np.ndarray) -> np.ndarray:
    """`turns` of every number; not by numpy, whose sine rounds otherwise."""
    return np.array([turns(x) for x in cycles.tolist()], complex)
