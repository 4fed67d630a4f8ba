"""Any devices on any network of R, L, C between capacitive nodes, linearised as one explicit set of equations.

Every node has a capacitor, so that its voltage is a state; every branch has its current as states and, with a series
capacitor, that one's voltage. Power-invariant dq pairs in the frame of the source. Nothing is shared with the product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root

W1 = 100.0 * np.pi
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Branch:
    """R (ohm) and X at f1 (ohm) between two nodes, the source being -1; ``x_c`` (ohm) of a series capacitor or zero."""

    a: int
    b: int
    r: float
    x: float
    x_c: float = 0.0


@dataclass(frozen=True)
class Device:
    """x' = A x + B v, i = C x + D v drawn at a node, in the frame of its own voltage; ``drawn`` |v| to S in VA."""

    node: int
    drawn: Callable[[complex], complex]
    system: Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def voltages(branches: list[Branch], c_f: np.ndarray, devices: list[Device], source_v: float) -> np.ndarray:
    """Node voltages (n,) complex (V) at rest."""
    n = len(c_f)
    y, injected = np.diag(1j * W1 * c_f).astype(complex), np.zeros(n, dtype=complex)
    for branch in branches:
        series = 1.0 / complex(branch.r, branch.x - branch.x_c)
        for end, other in ((branch.a, branch.b), (branch.b, branch.a)):
            if end >= 0:
                y[end, end] += series
                if other >= 0:
                    y[end, other] -= series
                else:
                    injected[end] += series * source_v

    def excess(z: np.ndarray) -> np.ndarray:
        v = z[:n] + 1j * z[n:]
        current = y @ v - injected
        for device in devices:
            current[device.node] += np.conj(device.drawn(v[device.node]) / v[device.node])
        return np.concatenate([current.real, current.imag])

    start = np.linalg.solve(y, injected)
    found = root(excess, np.concatenate([start.real, start.imag]), method="hybr", tol=1e-14)
    v = found.x[:n] + 1j * found.x[n:]
    if np.abs(excess(found.x)).max() > 1e-5 or np.abs(v).min() < 0.6 * source_v:
        raise ValueError("no operating point")
    return v


def poles(
    branches: list[Branch], c_f: np.ndarray, devices: list[Device], source_v: float
) -> tuple[np.ndarray, np.ndarray]:
    """Closed-loop poles (rad/s, dq) and the node voltages (V)."""
    v = voltages(branches, c_f, devices, source_v)
    systems = [device.system(abs(v[device.node])) for device in devices]
    series = [k for k, branch in enumerate(branches) if branch.x_c > 0.0]
    n_x = sum(len(system[0]) for system in systems)
    at_v, at_i = n_x, n_x + 2 * len(c_f)
    at_c = at_i + 2 * len(branches)
    a = np.zeros((at_c + 2 * len(series),) * 2)
    _nodes_and_branches(a, branches, c_f, series, (at_v, at_i, at_c))
    start = 0
    for device, (own, b, c, d) in zip(devices, systems, strict=True):
        angle = np.angle(v[device.node])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        x, node = slice(start, start + len(own)), slice(at_v + 2 * device.node, at_v + 2 * device.node + 2)
        a[x, x], a[x, node] = own, b @ turn.T
        a[node, x] -= turn @ c / c_f[device.node]
        a[node, node] -= turn @ d @ turn.T / c_f[device.node]
        start += len(own)
    return np.linalg.eigvals(a), v


def _nodes_and_branches(
    a: np.ndarray, branches: list[Branch], c_f: np.ndarray, series: list[int], at: tuple[int, int, int]
) -> None:
    at_v, at_i, at_c = at
    for n in range(len(c_f)):
        v = slice(at_v + 2 * n, at_v + 2 * n + 2)
        a[v, v] -= W1 * J
    for k, branch in enumerate(branches):
        i, l_h = slice(at_i + 2 * k, at_i + 2 * k + 2), branch.x / W1
        a[i, i] += -branch.r / l_h * np.eye(2) - W1 * J
        for end, sign in ((branch.a, 1.0), (branch.b, -1.0)):
            if end >= 0:
                v = slice(at_v + 2 * end, at_v + 2 * end + 2)
                a[i, v] += sign * np.eye(2) / l_h
                a[v, i] -= sign * np.eye(2) / c_f[end]
        if k in series:
            u = slice(at_c + 2 * series.index(k), at_c + 2 * series.index(k) + 2)
            a[i, u] -= np.eye(2) / l_h
            a[u, i] += W1 * branch.x_c * np.eye(2)
            a[u, u] -= W1 * J
