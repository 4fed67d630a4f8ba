"""Nodes and elements to one descriptor system; the lumped ones as `plant.circuits.branches` stamps them.

An ideal source is ground: it does not answer a disturbance. A distributed line is a two-port of closed form, which no
finite system holds: `port_impedance` knows it exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...plant.circuits.branches import GROUND, Branch, Places, places_of, stamped
from .descriptor import Descriptor

__all__ = ["GROUND", "Branch", "Line", "Network", "assemble", "branch_slopes", "port_impedance", "two_port"]


@dataclass(frozen=True, slots=True)
class Line:
    """A distributed line or cable between two nodes, data per km.

    Attributes
    ----------
    name, a, b : str
        Name and the two nodes.
    r_ohm_km, l_h_km, g_s_km, c_f_km, length_km : float
        Series R and L, shunt G and C per km; length (km).
    """

    name: str
    a: str
    b: str
    r_ohm_km: float
    l_h_km: float
    g_s_km: float
    c_f_km: float
    length_km: float


@dataclass(frozen=True, slots=True)
class Network:
    """Branches and distributed lines between named nodes."""

    branches: tuple[Branch, ...]
    lines: tuple[Line, ...] = ()
    nodes: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        ends = [end for branch in self.branches for end in branch.ends]
        ends += [end for line in self.lines for end in (line.a, line.b)]
        object.__setattr__(self, "nodes", tuple(dict.fromkeys(end for end in ends if end != GROUND)))


def assemble(network: Network, ports: Sequence[str]) -> Descriptor:
    """The lumped part of a network as E x' = A x + B u, v = C x in the phase frame.

    Parameters
    ----------
    network : Network
        Distributed lines are left out: they are added by `port_impedance`.
    ports : sequence of str
        Nodes at which something outside draws a current ``u`` (A) and sees a voltage ``v`` (V).
    """
    at = _places(network)
    e, a = stamped(network.branches, at)
    c = np.zeros((len(ports), at.n))
    for row, port in enumerate(ports):
        c[row, at.node[port]] = 1.0
    return Descriptor(e, a, -c.T.copy(), c)


def port_impedance(network: Network, ports: Sequence[str], s: np.ndarray) -> np.ndarray:
    """Impedance matrix (k, p, p) in ohm of the ports at complex ``s`` (k,) in rad/s, distributed lines exact.

    Infinite or not a number at a pole of the network.
    """
    system = assemble(network, ports)
    matrix = np.asarray(s, dtype=complex)[:, None, None] * system.e - system.a
    at = _places(network)
    for line in network.lines:
        _add_line(matrix, at, line, np.asarray(s, dtype=complex))
    right = np.broadcast_to(system.b.astype(complex), (len(matrix), *system.b.shape))
    return -system.c @ _solved(matrix, right)


def branch_slopes(network: Network, s: complex, adjoint: np.ndarray, direct: np.ndarray) -> np.ndarray:
    """adjoint dM direct (b,) for a relative change of the impedance of every branch, M = s E - A at ``s`` (rad/s).

    The unknowns are those of `assemble`; distributed lines are left out.
    """
    at = places_of(network.branches, network.nodes)
    return np.array([_branch_slope(at, k, branch, s, adjoint, direct) for k, branch in enumerate(network.branches)])


def _branch_slope(at: Places, k: int, branch: Branch, s: complex, adjoint: np.ndarray, direct: np.ndarray) -> complex:
    """adjoint dM direct for a relative change of one branch's impedance, where `stamped` has put it."""
    if branch.has_current:
        i = at.current[k]
        found = (s * branch.l_h + branch.r_ohm) * adjoint[i] * direct[i]
        if k in at.capacitor:
            v_c = at.capacitor[k]
            found -= s * branch.c_f * adjoint[v_c] * direct[v_c]
        return complex(found)
    ends = [(at.node[name], ratio) for name, ratio in branch.ends.items() if name != GROUND]
    across = [sum(ratio * x[node] for node, ratio in ends) for x in (adjoint, direct)]
    y = s * branch.c_f if branch.is_capacitor else 1.0 / branch.r_ohm
    return complex(-y * across[0] * across[1])


def two_port(line: Line, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Admittances y11 = y22 and y12 = y21 (k,) in S of a distributed line, current into it.

    y11 = (x coth x)/(Z l) and y12 = -(x / sinh x)/(Z l) with x = l sqrt(Z Y), Z = R + s L, Y = G + s C per km:
    even in x, and without a singularity at x = 0.
    """
    z = (line.r_ohm_km + s * line.l_h_km) * line.length_km
    x = np.sqrt(z * (line.g_s_km + s * line.c_f_km) * line.length_km)
    small = np.abs(x) < 1e-4
    safe = np.where(small, 1.0, x)
    grown = np.exp(-2.0 * safe * np.where(safe.real < 0.0, -1.0, 1.0))  # coth and 1/sinh without overflow
    safe = np.where(safe.real < 0.0, -safe, safe)
    coth = np.where(small, 1.0 + x**2 / 3.0, safe * (1.0 + grown) / (1.0 - grown))
    csch = np.where(small, 1.0 - x**2 / 6.0, 2.0 * safe * np.exp(-safe) / (1.0 - grown))
    return coth / z, -csch / z


def _places(network: Network) -> Places:
    return places_of(network.branches, network.nodes)


def _add_line(matrix: np.ndarray, at: Places, line: Line, s: np.ndarray) -> None:
    """Add the two-port of a line to the rows of its nodes."""
    own, across = two_port(line, s)
    ends = [at.node.get(name) for name in (line.a, line.b)]
    for k, row in enumerate(ends):
        for j, column in enumerate(ends):
            if row is not None and column is not None:
                matrix[:, row, column] += own if k == j else across


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """matrix^-1 right for a stack; where one is singular, not a number."""
    size = np.abs(matrix).max(axis=(0, 2), initial=1e-300)
    try:
        return np.linalg.solve(matrix / size[:, None], right / size[:, None])
    except np.linalg.LinAlgError:
        return np.stack([_one_solved(m, r) for m, r in zip(matrix, right, strict=True)])


def _one_solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full(right.shape, np.nan + 0j)
