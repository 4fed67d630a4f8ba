"""The turbine's poles by differences of its own flow: what the stepper does, not what the equations say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..lanes import Chart
from ..protocol import Job

_N_STEPS = 10

Run = Callable[[Sequence[Job], int], list[tuple[Any, Any]]]


def poles_of(run: Run, chart: Chart, step_s: float) -> np.ndarray:
    """Poles (rad/s, dq), worst first, by central differences of the flow over ten steps."""
    middle = chart.of(chart.state)
    scale = 1e-5 * np.maximum(np.abs(middle), 1.0)
    moved = [middle + sign * step for step in np.diag(scale) for sign in (1, -1)]
    ends = np.array([chart.of(end) for end, _ in run([Job(chart.at(x), None) for x in moved], _N_STEPS)])
    flow = ((ends[0::2] - ends[1::2]) / (2.0 * scale[:, None])).T
    poles = np.log(np.linalg.eigvals(flow).astype(complex)) / (_N_STEPS * step_s)
    return poles[np.argsort(-poles.real)]
