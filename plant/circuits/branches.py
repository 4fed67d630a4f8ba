"""Branches between named nodes, and their matrices by modified nodal analysis.

Unknowns are the node voltages, the current of every branch that has an inductance or a series capacitor, and the
voltages of those capacitors; whatever is only a conductance or a capacitance is stamped between its nodes:

    C v' + G v + sum_b a_b i_b + u = 0        L i_b' = a_b^T v - R i_b - v_c        C_b v_c' = i_b

``u`` is what a port draws out of the network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

GROUND = "ground"
"""The reference."""


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

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.ends.items()), self.r_ohm, self.l_h, self.c_f))

    @property
    def has_current(self) -> bool:
        """Whether the current is an unknown of its own: not so for a plain resistor or capacitor."""
        pure_r = self.c_f == inf and self.l_h == 0.0 and self.r_ohm > 0.0
        return not (self.is_capacitor or pure_r)

    @property
    def is_capacitor(self) -> bool:
        """Whether it is a capacitor and nothing else."""
        return self.c_f < inf and self.r_ohm == 0.0 and self.l_h == 0.0


class Places(NamedTuple):
    """Where the unknowns stand: nodes first, then branch currents, then capacitor voltages, by branch number."""

    node: dict[str, int]
    current: dict[int, int]
    capacitor: dict[int, int]
    n: int


def nodes_of(branches: Sequence[Branch]) -> tuple[str, ...]:
    """Nodes in the order in which they are met, the ground left out."""
    return tuple(dict.fromkeys(end for branch in branches for end in branch.ends if end != GROUND))


def places_of(branches: Sequence[Branch], nodes: Sequence[str]) -> Places:
    """Numbers of all unknowns."""
    n = len(nodes)
    node = {name: k for k, name in enumerate(nodes)}
    with_current = [k for k, branch in enumerate(branches) if branch.has_current]
    current = {k: n + j for j, k in enumerate(with_current)}
    charged = [k for k in with_current if branches[k].c_f < inf]
    capacitor = {k: n + len(current) + j for j, k in enumerate(charged)}
    return Places(node, current, capacitor, n + len(current) + len(capacitor))


def stamped(branches: Sequence[Branch], at: Places) -> tuple[np.ndarray, np.ndarray]:
    """E and A (n, n) of E x' = A x."""
    e, a = np.zeros((at.n, at.n)), np.zeros((at.n, at.n))
    for k, branch in enumerate(branches):
        _stamp(e, a, at, k, branch)
    return e, a


def _stamp(e: np.ndarray, a: np.ndarray, at: Places, k: int, branch: Branch) -> None:
    """Add one branch to E and A."""
    ends = [(at.node[name], ratio) for name, ratio in branch.ends.items() if name != GROUND]
    if not branch.has_current:
        target, value = (e, branch.c_f) if branch.is_capacitor else (a, -1.0 / branch.r_ohm)
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
