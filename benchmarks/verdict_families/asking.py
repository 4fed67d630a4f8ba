"""The product is asked, by its public door: `tune`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from seqsweep.identify.response import FrequencyResponse


@dataclass(frozen=True)
class Said:
    """What came out; NaN and None where nothing was said.

    Attributes
    ----------
    verdict : "stable", "unstable", "undecided" or "crash"
        The last where an exception came instead.
    probability : float
        Of being stable.
    reason : str
        Its words, or the exception's.
    n_unstable : int
        Closed-loop poles it counts on the right; -1: no count.
    own_unstable : int
        Poles of the device's own it counts there; -1: no count.
    resonance : complex
        The pole it names as the resonance (rad/s, Im > 0).
    covariance : (2, 2) float
        Of its real and imaginary part.
    critical_scale : float
        Multiplier of the grid at the edge.
    seconds : float
        CPU time.
    """

    verdict: str
    probability: float
    reason: str
    n_unstable: int
    own_unstable: int
    resonance: complex
    covariance: np.ndarray
    critical_scale: float
    seconds: float


NOTHING = Said(
    "undecided", float("nan"), "", -1, -1, complex(np.nan, np.nan), np.full((2, 2), np.nan), float("nan"), 0.0
)
"""Before anything was asked."""


def ask(response: FrequencyResponse, grid: tuple[float, float]) -> Said:
    """The verdict on a grid R, X (ohm at f1)."""
    from seqsweep.tuning.tune import tune

    begin = time.process_time()
    try:
        (point,) = tune([response], _series_rl(grid, response.f1_hz)).points
    except Exception as error:
        return _crash(error, time.process_time() - begin)
    return _said(point, time.process_time() - begin)


def _series_rl(grid: tuple[float, float], f1_hz: float) -> Any:
    from seqsweep.tuning import siso

    return getattr(siso, "SeriesRL", siso.Grid)(*grid, f1_hz)


def _crash(error: Exception, seconds: float) -> Said:
    nothing = np.full((2, 2), np.nan)
    text = f"{type(error).__name__}: {error}"
    return Said("crash", float("nan"), text, -1, -1, complex(np.nan, np.nan), nothing, float("nan"), seconds)


def _said(point: Any, seconds: float) -> Said:
    stability, edge = point.stability, point.critical_scale
    pole, covariance = complex(np.nan, np.nan), np.full((2, 2), np.nan)
    n_unstable = own = -1
    if stability is not None:
        loop = stability.closed_loop
        n_unstable, own = loop.n_unstable, stability.n_open_loop_unstable
        if loop.critical is not None:
            pole, covariance = complex(loop.poles[loop.critical]), np.asarray(loop.covariance[loop.critical])
    return Said(
        verdict=point.verdict,
        probability=float("nan") if point.probability is None else float(point.probability),
        reason=point.reason,
        n_unstable=n_unstable,
        own_unstable=own,
        resonance=pole,
        covariance=covariance,
        critical_scale=float("nan") if edge is None else float(edge),
        seconds=seconds,
    )
