"""What every plant that is stepped in lanes does with its flat array: complex slots, tones, sums as phasors."""

from __future__ import annotations

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
    """Block sums (n_blocks, 8, n_lanes) as phasors at line and mirror, lane by lane, in units of V and A.

    ``i_unit`` is negative where the kernel counts the current out of the device.
    """
    v, i = v_unit * _line_and_mirror(sums[:, :4]), i_unit * _line_and_mirror(sums[:, 4:])
    return [Phasors(v_lane, i_lane) for v_lane, i_lane in zip(v, i, strict=True)]


def _line_and_mirror(sums: np.ndarray) -> np.ndarray:
    """Phasors (n_lanes, n_blocks, 2) of the four sums of products (n_blocks, 4, n_lanes)."""
    re_re, im_im, im_re, re_im = sums.transpose(1, 2, 0)
    line = (re_re + im_im) + 1j * (im_re - re_im)
    mirror = (re_re - im_im) + 1j * (im_re + re_im)
    return np.stack([line, mirror], axis=2)
