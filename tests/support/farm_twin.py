"""A farm in time, slow and obvious: each turbine's equations from `oracle`, the network by its dense matrices.

Exponential Runge-Kutta (Krogstad) for the network, the classical one for the turbines, in numpy. Nothing of the
product's kernels is used, nor of the way in which it splits the network; limits and damping control are left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seqsweep.plant.circuits.dynamics import as_pairs
from seqsweep.plant.circuits.stepping import Outputs, weights_of

from . import oracle

_SHUNT = [2, 3]
"""Of the oracle's states those that belong to the network here."""


def advanced(farm: Any, state: Any, conditions: Any, n_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """States (n, 13) at the end, and terminal voltages (n_steps, n) complex (V, power-invariant, dq)."""
    stepped = farm._stepped(conditions)
    n, factors = len(stepped.factors), np.array(stepped.factors)
    dynamics, outputs = stepped.dynamics, Outputs(stepped.outputs.of_x[:n], stepped.outputs.of_u[:n])
    w = weights_of(dynamics, outputs, farm.dt_s)
    (source,) = stepped.forced(state.v_source)
    steady = dynamics.remembered(source.x, state.v_source)
    xi = dynamics.entered(state.memory.of(dynamics.names) - steady, 0.0)
    forced = as_pairs(outputs.of_x @ source.x)
    x = np.array([turbine.values[:13] for turbine in state.turbines])
    wind = [turbine.wind_m_s for turbine in state.turbines]
    h, seen = farm.dt_s, np.empty((n_steps, n), dtype=complex)

    def fed(x: np.ndarray) -> np.ndarray:
        return (x[:, :2] * factors[:, None]).ravel()

    def slopes(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        whole = np.insert(x, 2, np.zeros((2, n)), axis=1)
        of_all = [oracle.rhs(whole[k], v[2 * k : 2 * k + 2], wind[k]) for k in range(n)]
        return np.delete(np.array(of_all), _SHUNT, axis=1)

    for step in range(n_steps):
        u_0 = fed(x)
        v_0 = forced + w.seen[0] @ xi + w.direct @ u_0
        seen[step] = v_0[0::2] + 1j * v_0[1::2]
        k_1 = slopes(x, v_0)
        x_1 = x + 0.5 * h * k_1
        u_1, held = fed(x_1), forced + w.seen[1] @ xi + w.by_start @ u_0
        k_2 = slopes(x_1, held + w.direct @ u_1)
        x_2 = x + 0.5 * h * k_2
        u_2 = fed(x_2)
        k_3 = slopes(x_2, held + w.by_first @ (u_1 - u_0) + w.direct @ u_2)
        x_3 = x + h * k_3
        u_3 = fed(x_3)
        v_3 = forced + w.seen[2] @ xi + w.by_whole @ u_0 + w.by_second @ (u_2 - u_0) + w.direct @ u_3
        k_4 = slopes(x_3, v_3)
        x = x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        xi = w.keep @ xi + w.start @ u_0 + w.middle @ (0.5 * (u_1 + u_2)) + w.end @ u_3
    return x, seen
