"""When a shot is over, and what its point is worth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..plant.protocol import Phasors

COND_LIMIT = 1e6
"""Above this condition number of the voltages two experiments are one (a wrong mirror shows 1e13)."""

SETTLED_LIMIT = 1e-6
"""Largest change of the unperturbed waveforms over one period, relative to their peak."""


class Settled(NamedTuple):
    """The window at which a shot came to rest.

    Attributes
    ----------
    v, i : (2,) complex
        Phasors of that window at f and 2 f1 - f (V, A).
    residual : float
        Its disagreement with the window before, relative.
    window : int
        Its number, from 0.
    agreed : bool
        Whether ``residual`` is within the tolerance asked.
    growth : float
        Factor by which the response grew over the last window.
    """

    v: np.ndarray
    i: np.ndarray
    residual: float
    window: int
    agreed: bool
    growth: float


def windows(phasors: Phasors, n_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Phasors (n_windows, 2) of v and i of all complete windows of ``n_blocks`` blocks."""
    whole = len(phasors.v) // n_blocks * n_blocks
    v, i = (x[:whole].reshape(-1, n_blocks, 2).sum(axis=1) for x in (phasors.v, phasors.i))
    return v, i


def first_agreement(v: np.ndarray, i: np.ndarray, tolerance: float) -> Settled:
    """The first window that agrees with the one before; the last window where none does.

    Parameters
    ----------
    v, i : (n_windows, 2) complex
        Phasors of the perturbation alone (V, A), at least one window.
    tolerance : float
        Relative disagreement accepted, of v and of i.
    """
    residual, k = np.inf, 0
    for k in range(1, len(v)):
        residual = float(np.max([_change(v[k - 1], v[k]), _change(i[k - 1], i[k])]))  # NaN if either is
        if residual <= tolerance or not np.isfinite(residual):
            break
    before = float(np.linalg.norm(i[k - 1]))
    growth = float(np.linalg.norm(i[k])) / before if before else 1.0
    return Settled(v[k], i[k], residual, k, residual <= tolerance, growth)


def _change(before: np.ndarray, after: np.ndarray) -> float:
    size = float(np.linalg.norm(after))
    change = float(np.linalg.norm(after - before))
    if change == 0.0:
        return 0.0  # a device that takes no current at all agrees with itself
    return change / size if size else np.inf


def period_change(x: np.ndarray) -> float:
    """Largest difference between the two halves of ``x``, relative to its peak."""
    half = len(x) // 2
    return float(np.max(np.abs(x[half:] - x[:half])) / np.max(np.abs(x)))
