"""What every plant that is stepped in lanes does with its flat array: complex slots, tones, sums as phasors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from .protocol import Injection, Phasors

_CACHE_LINE = 64


def n_tones_of(injection: Injection | None) -> int:
    """Tones of a job."""
    return len(injection.tones) if injection else 0


def aligned_zeros(n_slots: int, n_lanes: int) -> np.ndarray:
    """Zeros (n_slots, n_lanes) that begin where a cache line does: vectors that straddle two cost a tenth more."""
    n_bytes = 8 * n_slots * n_lanes
    memory = np.zeros(n_bytes + _CACHE_LINE, np.uint8)
    first = -memory.ctypes.data % _CACHE_LINE
    return memory[first : first + n_bytes].view(float).reshape(n_slots, n_lanes)


def set_complex(x: np.ndarray, slot: int, value: complex) -> None:
    """``value`` into two slots of one lane's column."""
    x[slot], x[slot + 1] = value.real, value.imag


def phasors_of(sums: np.ndarray, v_unit: float, i_unit: float) -> list[Phasors]:
    """Block sums (n_blocks, 8, n_lanes) as phasors at line and mirror, lane by lane; see `phasor_array`."""
    return [Phasors(v, i) for v, i in phasor_array(sums[None], v_unit, i_unit)]


def phasor_array(sums: np.ndarray, v_unit: float, i_unit: float) -> np.ndarray:
    """Block sums (n, n_blocks, 8, n_lanes) as (n n_lanes, 2, n_blocks, 2) phasors of v and i at line and mirror.

    In units of V and A; ``i_unit`` is negative where the kernel counts the current out of the device. The four sums of
    products of a quantity with the line's phasor, re re, im im, im re and re im, give the line and, with other signs,
    the mirror.
    """
    n, n_blocks, _, n_lanes = sums.shape
    re_re, im_im, im_re, re_im = sums.reshape(n, n_blocks, 2, 4, n_lanes).transpose(3, 1, 2, 0, 4)
    phasors = np.empty((n_blocks, 2, 2, n, n_lanes), complex)  # in memory as they are heard: block by block, all jobs
    np.add(re_re, im_im, out=phasors.real[:, :, 0])
    np.subtract(im_re, re_im, out=phasors.imag[:, :, 0])
    np.subtract(re_re, im_im, out=phasors.real[:, :, 1])
    np.add(im_re, re_im, out=phasors.imag[:, :, 1])
    phasors[:, 0].view(float)[...] *= v_unit
    phasors[:, 1].view(float)[...] *= i_unit
    return phasors.reshape(n_blocks, 2, 2, n * n_lanes).transpose(3, 1, 0, 2)


class AroundDevice(Protocol):
    """A network around a device: its states out of the device's, and into them."""

    def states(self, state: Any) -> np.ndarray:
        """(m,) of what a device's state remembers of its network."""
        ...

    def after(self, state: Any, states: np.ndarray) -> Any:
        """The device's state with a network in ``states`` (m,)."""
        ...


class Chart(NamedTuple):
    """Independent coordinates near a state: some of its values, and the states of its network.

    ``kept`` are places among the values; ``around`` is None where there is no network.
    """

    state: Any
    kept: list[int]
    around: AroundDevice | None

    def of(self, state: Any) -> np.ndarray:
        """(n,) of a state."""
        values = state.values[self.kept]
        return values if self.around is None else np.concatenate([values, self.around.states(state)])

    def at(self, x: np.ndarray) -> Any:
        """The state with coordinates ``x`` (n,)."""
        values = self.state.values.copy()
        values[self.kept] = x[: len(self.kept)]
        values.setflags(write=False)
        moved = replace(self.state, values=values)
        return moved if self.around is None else self.around.after(moved, x[len(self.kept) :])
