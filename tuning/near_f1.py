"""Slow modes nearer to f1 than every row: what the rows leave open, and whether it could carry them across the axis.

What the rows may not see there are slow modes of the device's own. One that decays with p and leaves no more than d of
the lowest row unexplained, at |f - f1| = nu, moves Y at s by no more than d 2 pi nu / |s + p|, and a closed-loop mode
at s by its sensitivity times that. What decays more slowly than `SLOWEST` takes a minute to come to rest, and is no
matter of a frequency sweep.
"""

from __future__ import annotations

import numpy as np

from ..identify.fit.dq_data import DqData
from ..identify.fit.order import SLOWEST
from ..identify.fit.rational import RationalModel, evaluate
from .poles import mode_weight
from .siso import Grid

NEAREST_HZ = 1.0
"""Rows that begin further away from f1 leave room for more than slow modes."""

EXACT = 1e-6
"""No row is taken to be known better than to this part of itself."""

_LOWEST_ROWS = 4
_MARGIN = 3.0  # a mode keeps its side of the axis if all that may move it is so many times smaller than its distance


def held(model: RationalModel, data: DqData, grid: Grid, pole: complex) -> bool:
    """Whether a closed-loop mode (rad/s, dq) nearer to f1 than every row is known to be on its side of the axis."""
    lowest = float(model.nu_hz[0])
    if lowest > NEAREST_HZ:
        return False
    moved = np.linalg.norm(mode_weight(model, grid, np.array([pole]))[0])
    reach = 2.0 * np.pi * lowest / (max(pole.real, 0.0) + SLOWEST)
    return bool(moved * _unexplained(model, data) * reach * _MARGIN < abs(pole.real))


def placed(model: RationalModel, k: int) -> bool:
    """Whether the rows know the place of the device's own pole ``k`` as well as matters so near to f1."""
    return bool(model.nu_hz[0] <= NEAREST_HZ and abs(model.pole_std[k]) < SLOWEST)


def _unexplained(model: RationalModel, data: DqData) -> float:
    """What the lowest rows leave open of Y (S)."""
    y, std = data.y[:_LOWEST_ROWS], data.std
    left = np.linalg.norm(evaluate(model, 2j * np.pi * data.nu_hz[:_LOWEST_ROWS]) - y, axis=(1, 2))
    stated = np.zeros_like(left) if std is None else np.linalg.norm(std[:_LOWEST_ROWS], axis=(1, 2))
    return float(np.max([left, stated, EXACT * np.linalg.norm(y, axis=(1, 2))]))
