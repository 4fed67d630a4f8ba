"""Nodes and elements to one descriptor system, by modified nodal analysis.

Unknowns are the node voltages, the current of every branch that has an inductance or a series capacitor, and the
voltages of those capacitors; whatever is only a conductance or a capacitance is stamped between its nodes:

    C v' + G v + sum_b a_b i_b + u = 0        L i_b' = a_b^T v - R i_b - v_c        C_b v_c' = i_b

``u`` is what a port draws out of the network. An ideal source is ground: it does not answer a disturbance. A
distributed line is a two-port of closed form, which no finite system holds: `port_impedance` knows it exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

import numpy as np

from .descriptor import Descriptor

GROUND = "ground"
"""The reference; every ideal source, too."""


@dataclass(frozen=True, slots=True)
class Branch:
    """R, L and C in series between nodes.

    Attributes
    ----------
    name : str
        For messages and participation.
    ends : mapping of str to float
        The branch's voltage is the sum of these multiples of node voltages, and it draws these multiples of its
        current from them: {"a": 1, "b": -1} from a to b; a transformer of ratio n is {"lv": 1, "hv": -n}.
    r_ohm, l_h : float
        Resistance (ohm) and inductance (H), zero allowed.
    c_f : float
        Series capacitance (F); infinite if there is none.
    """

    name: str
    ends: Mapping[str, float]
    r_ohm: float = 0.0
    l_h: float = 0.0
    c_f: float = inf

    @property
    def has_current(self) -> bool:
        """Whether the current is an unknown of its own: not so for a plain resistor or capacitor."""
        pure_c = self.c_f < inf and self.r_ohm == 0.0 and self.l_h == 0.0
        pure_r = self.c_f == inf and self.l_h == 0.0 and self.r_ohm > 0.0
        return not (pure_c or pure_r)


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


class _Places(NamedTuple):
    """Where the unknowns stand: nodes first, then branch currents, then capacitor voltages."""

    node: dict[str, int]
    current: dict[int, int]
    capacitor: dict[int, int]
    n: int


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
    e, a = np.zeros((at.n, at.n)), np.zeros((at.n, at.n))
    for k, branch in enumerate(network.branches):
        _stamp(e, a, at, k, branch)
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


def _places(network: Network) -> _Places:
    n = len(network.nodes)
    node = {name: k for k, name in enumerate(network.nodes)}
    with_current = [k for k, branch in enumerate(network.branches) if branch.has_current]
    current = {k: n + j for j, k in enumerate(with_current)}
    charged = [k for k in with_current if network.branches[k].c_f < inf]
    capacitor = {k: n + len(current) + j for j, k in enumerate(charged)}
    return _Places(node, current, capacitor, n + len(current) + len(capacitor))


def _stamp(e: np.ndarray, a: np.ndarray, at: _Places, k: int, branch: Branch) -> None:
    """Add one branch to E and A."""
    ends = [(at.node[name], ratio) for name, ratio in branch.ends.items() if name != GROUND]
    if not branch.has_current:
        target, value = (e, branch.c_f) if branch.c_f < inf else (a, -1.0 / branch.r_ohm)
        for row, p in ends:
            for column, q in ends:
                target[row, column] += p * q * value
        return
    i = at.current[k]
    e[i, i], a[i, i] = branch.l_h, -branch.r_ohm
    for row, ratio in ends:
        a[i, row], a[row, i] = ratio, -ratio
    if k in at.capacitor:
        v_c = at.capacitor[k]
        e[v_c, v_c], a[v_c, i], a[i, v_c] = branch.c_f, 1.0, -1.0


def _add_line(matrix: np.ndarray, at: _Places, line: Line, s: np.ndarray) -> None:
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
