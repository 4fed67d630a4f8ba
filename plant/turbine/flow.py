"""The turbine's poles by differences of its own flow: what the stepper does, not what the equations say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..lanes import Chart
from ..protocol import Job
from .parameters import TurbineParameters

_N_STEPS = 10

MACHINE = slice(8, 13)
"""Where the states of machine and rotor stand among a turbine's."""

Run = Callable[[Sequence[Job], int], list[tuple[Any, Any]]]


def poles_of(run: Run, chart: Chart, step_s: float) -> np.ndarray:
    """Poles (rad/s, dq), worst first, by central differences of the flow over ten steps."""

    def flow(moved: np.ndarray) -> np.ndarray:
        return np.array([chart.of(end) for end, _ in run([Job(chart.at(x), None) for x in moved], _N_STEPS)])

    return _worst_first(_poles(flow, chart.of(chart.state), step_s))


def poles_apart(run: Run, chart: Chart, p: TurbineParameters, step_s: float) -> np.ndarray:
    """`poles_of` a turbine whose machine stands still: those of the machine, which nothing reaches, come by themselves.

    The lanes stay calm then, and the kernel that steps the machine is compiled by those alone whose machine moves.
    """
    values, wind_m_s = chart.state.values, chart.state.wind_m_s
    of_machine = _poles(partial(_machine_flow, p, wind_m_s, step_s), values[MACHINE], step_s)
    others = chart._replace(kept=[k for k in chart.kept if k not in range(MACHINE.start, MACHINE.stop)])

    def flow(moved: np.ndarray) -> np.ndarray:
        return np.array([others.of(end) for end, _ in run([Job(others.at(x), None) for x in moved], _N_STEPS)])

    return _worst_first(np.concatenate([_poles(flow, others.of(chart.state), step_s), of_machine]))


def _poles(flow: Callable[[np.ndarray], np.ndarray], middle: np.ndarray, step_s: float) -> np.ndarray:
    """Poles of a flow over ten steps, which takes states (m, n) to their ends, around ``middle`` (n,)."""
    scale = 1e-5 * np.maximum(np.abs(middle), 1.0)
    ends = flow(np.array([middle + sign * step for step in np.diag(scale) for sign in (1, -1)]))
    jacobian = ((ends[0::2] - ends[1::2]) / (2.0 * scale[:, None])).T
    return np.asarray(np.log(np.linalg.eigvals(jacobian).astype(complex)) / (_N_STEPS * step_s))


def _worst_first(poles: np.ndarray) -> np.ndarray:
    return poles[np.argsort(-poles.real)]


def _machine_flow(p: TurbineParameters, wind_m_s: float, step_s: float, moved: np.ndarray) -> np.ndarray:
    """States of machine and rotor (m, 5) ten steps later, as the kernel steps them."""
    from ..kernels import turbine as kernel

    def slopes(x: np.ndarray) -> np.ndarray:
        derivatives, _ = kernel.machine(x, wind_m_s, p)
        return np.array([*np.zeros((MACHINE.start, x.shape[1])), *derivatives])

    x = np.zeros((MACHINE.stop, len(moved)))
    x[MACHINE] = moved.T
    for _ in range(_N_STEPS):
        k1 = slopes(x)
        k2 = slopes(x + 0.5 * step_s * k1)
        k3 = slopes(x + 0.5 * step_s * k2)
        k4 = slopes(x + step_s * k3)
        x = x + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[MACHINE].T
