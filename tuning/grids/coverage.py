"""What rows of a grid hold a mode, and which are missing."""

from __future__ import annotations

import numpy as np

GAP = 1.6
"""Neighbouring rows further apart than this ratio leave a gap, unless the mode is wider than their distance."""

EDGE = 1.05
"""A mode this far beyond the first or the last row still counts as measured."""


def is_between(rows_hz: np.ndarray, f_hz: float, width_hz: float) -> bool:
    """Whether rows stand on both sides of a frequency, as near as their ratio or a mode's half width (Hz) asks."""
    if f_hz < rows_hz[0] / EDGE:
        return bool(rows_hz[0] - f_hz <= width_hz)
    if f_hz > rows_hz[-1] * EDGE:
        return False
    above = int(np.clip(np.searchsorted(rows_hz, f_hz), 1, len(rows_hz) - 1))
    gap = rows_hz[above] - rows_hz[above - 1]
    return bool(rows_hz[above] <= GAP * rows_hz[above - 1] or gap <= 2.0 * width_hz)


def around(f_hz: float, width_hz: float) -> tuple[float, float]:
    """The band (Hz) worth measuring around a frequency."""
    half = max(0.1 * f_hz, 2.0 * width_hz, 1.0)
    return max(f_hz - half, 0.1), f_hz + half
