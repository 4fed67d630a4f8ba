"""What every plant that is stepped in lanes does with its flat array: complex slots, tones, sums as phasors."""

from __future__ import annotations

import numpy as np

from .protocol import Injection, Phasors


def n_tones_of(injection: Injection | None) -> int:
    """Tones of a job."""
    return len(injection.tones) if injection else 0


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
