"""A radial farm reduced from its leaves to the source's bus: 2x2 matrices alone, vectorised over s, linear in size.

With Y_c the admittance of all that stands behind a branch, its impedance z and the multiples a, b with which it is
connected to the nearer and the farther node, the nearer node sees a^2 Y_c (z Y_c + b^2)^-1. A change dY of a device is
seen at the source's bus as L dY T, with T the product of -a b (z Y_c + b^2)^-1 along its way and L that of
-a b (Y_c z + b^2)^-1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf, pi
from typing import NamedTuple

import numpy as np

from ..network.assembly import GROUND, Branch, Network
from .entries import FarmEntry, FarmError
from .pairs import Pair, diagonal, everywhere, inverse, plus, product, scaled

Sequences = tuple[np.ndarray, np.ndarray]
"""Of v_d + j v_q and of v_d - j v_q."""

_SHORT_OHM = 1e-9  # as good as a short circuit: the devices' and the network's own determinant both hold it


class Step(NamedTuple):
    """One branch of the tree, from the node nearer to the source to the farther one."""

    near: str
    far: str
    a: float
    b: float
    branch: Branch


class Tree(NamedTuple):
    """A radial network seen from its root.

    Attributes
    ----------
    root : str
        The source's bus.
    steps : tuple of Step
        Branches between nodes, every farther node after the nearer one.
    shunts : mapping of str to tuple of Branch
        Branches to ground by node, the source's own impedance left out.
    w1_rad_s : float
        Fundamental angular frequency (rad/s).
    """

    root: str
    steps: tuple[Step, ...]
    shunts: Mapping[str, tuple[Branch, ...]]
    w1_rad_s: float


class Reduced(NamedTuple):
    """What the root sees at s (n,), and what it sees of each node.

    Attributes
    ----------
    y : Pair of (n,) complex
        Admittance of the whole (S).
    left, right : mapping of str to Pair of (n,) complex
        A change dY at a node is left dY right at the root.
    """

    y: Pair
    left: Mapping[str, Pair]
    right: Mapping[str, Pair]


def tree_behind_source(entry: FarmEntry) -> Tree:
    """The tree of a radial farm without its source, from the source's bus.

    Raises
    ------
    FarmError
        If the network has a loop.
    """
    return tree_of(entry.network, entry.source_bus, entry.network.branches[-1], 2.0 * pi * entry.f1_hz)


def tree_of(network: Network, root: str, source: Branch | None, w1_rad_s: float) -> Tree:
    """The tree of a radial network, the branch ``source`` to ground left out if there is one.

    Raises
    ------
    FarmError
        If the network has a loop.
    """
    shunts: dict[str, list[Branch]] = {}
    at_node: dict[str, list[Branch]] = {}
    for branch in network.branches:
        nodes = [name for name in branch.ends if name != GROUND]
        if len(nodes) == 1 and branch is not source:
            shunts.setdefault(nodes[0], []).append(branch)
        for name in nodes if len(nodes) == 2 else []:
            at_node.setdefault(name, []).append(branch)
    steps: list[Step] = []
    seen, used, queue = {root}, set(), [root]
    while queue:
        near = queue.pop()
        for branch in at_node.get(near, []):
            if id(branch) in used:
                continue
            used.add(id(branch))
            far = next(name for name in branch.ends if name not in (near, GROUND))
            if far in seen:
                raise FarmError(f"the network has a loop at {branch.name}: it is not radial")
            steps.append(Step(near, far, branch.ends[near], branch.ends[far], branch))
            seen.add(far)
            queue.append(far)
    return Tree(root, tuple(steps), {node: tuple(found) for node, found in shunts.items()}, w1_rad_s)


def reduced(tree: Tree, s: np.ndarray, devices: Mapping[str, Pair], with_ways: bool = False) -> Reduced:
    """The tree at complex s (n,) in rad/s, dq.

    Parameters
    ----------
    tree : Tree
        The network.
    s : (n,) complex
        Where.
    devices : mapping of str to Pair of (n,) complex
        Admittance (S) of the devices of a node, in the common frame.
    with_ways : bool
        Whether ``left`` and ``right`` are wanted.
    """
    y = _at_nodes(tree, s, devices)
    ways: dict[str, tuple[Pair, Pair]] = {}
    for step in reversed(tree.steps):
        behind, z = y[step.far], _sequences(tree, step.branch, s, _impedance)
        seen = inverse(_factor(z, behind, step.b))
        y[step.near] = plus(y[step.near], scaled(step.a**2, product(behind, seen)))
        if with_ways:
            back = inverse(_factor_from_left(behind, z, step.b))
            ways[step.far] = scaled(-step.a * step.b, back), scaled(-step.a * step.b, seen)
    whole = everywhere(1.0, len(s))
    left, right = {tree.root: whole}, {tree.root: whole}
    for step in tree.steps if with_ways else ():
        back, forth = ways[step.far]
        left[step.far], right[step.far] = product(left[step.near], back), product(forth, right[step.near])
    return Reduced(y[tree.root], left, right)


def seen_at_nodes(tree: Tree, s: np.ndarray, devices: Mapping[str, Pair]) -> dict[str, Pair]:
    """Admittance (S) of the whole at every node, its own devices included, as a further one there would see it.

    What a farther node sees through a branch of the rest Y_r is b^2 Y_r (z Y_r + a^2)^-1.
    """
    y = _at_nodes(tree, s, devices)
    impedances = {step.far: _sequences(tree, step.branch, s, _impedance) for step in tree.steps}
    parts: dict[str, Pair] = {}
    for step in reversed(tree.steps):
        behind = y[step.far]
        parts[step.far] = _through(impedances[step.far], behind, step.b, step.a)
        y[step.near] = plus(y[step.near], parts[step.far])
    for step in tree.steps:
        rest = plus(y[step.near], scaled(-1.0, parts[step.far]))
        y[step.far] = plus(y[step.far], _through(impedances[step.far], rest, step.a, step.b))
    return y


def _through(z: Sequences, y: Pair, own: float, other: float) -> Pair:
    """What the other end of a branch sees of ``y`` at an end that is connected to it with the multiple ``own``."""
    return scaled(other**2, product(y, inverse(_factor(z, y, own))))


def factors(tree: Tree, s: np.ndarray, devices: Mapping[str, Pair]) -> list[Pair]:
    """z Y + b^2 of every branch, and what stands at the root, each of (n,).

    The product of their determinants is that of the nodal matrix of the whole, but for a factor of the branches alone.
    """
    y = _at_nodes(tree, s, devices)
    found = []
    for step in reversed(tree.steps):
        factor = _factor(_sequences(tree, step.branch, s, _impedance), y[step.far], step.b)
        y[step.near] = plus(y[step.near], scaled(step.a**2, product(y[step.far], inverse(factor))))
        found.append(factor)
    return [*found, y[tree.root]]


def _factor(z: Sequences, y: Pair, b: float) -> Pair:
    """z Y + b^2."""
    return Pair(z[0] * y.pp + b**2, z[0] * y.pn, z[1] * y.np, z[1] * y.nn + b**2)


def _factor_from_left(y: Pair, z: Sequences, b: float) -> Pair:
    """Y z + b^2."""
    return Pair(y.pp * z[0] + b**2, y.pn * z[1], y.np * z[0], y.nn * z[1] + b**2)


def _at_nodes(tree: Tree, s: np.ndarray, devices: Mapping[str, Pair]) -> dict[str, Pair]:
    """What stands at every node itself: devices and shunts."""
    nothing = everywhere(0.0, len(s))
    y = dict.fromkeys((tree.root, *(step.far for step in tree.steps)), nothing)
    for node, found in devices.items():
        y[node] = plus(y[node], found)
    for node, branches in tree.shunts.items():
        for branch in branches:
            if node in y:
                own = diagonal(*_sequences(tree, branch, s, _admittance))
                y[node] = plus(y[node], scaled(branch.ends[node] ** 2, own))
    return y


def _series(branch: Branch, s: np.ndarray) -> np.ndarray:
    """R + s L, but for a lossless inductance at f = 0, which nothing can be divided by."""
    z = branch.r_ohm + s * branch.l_h
    return np.where(z == 0.0, _SHORT_OHM, z)


def _impedance(branch: Branch, s: np.ndarray) -> np.ndarray:
    z = _series(branch, s)
    return np.asarray(z + 1.0 / (s * branch.c_f)) if branch.c_f < inf else np.asarray(z)


def _admittance(branch: Branch, s: np.ndarray) -> np.ndarray:
    z = _series(branch, s)
    return np.asarray(s * branch.c_f / (1.0 + s * branch.c_f * z)) if branch.c_f < inf else np.asarray(1.0 / z)


def _sequences(tree: Tree, branch: Branch, s: np.ndarray, of: Callable[[Branch, np.ndarray], np.ndarray]) -> Sequences:
    """What a branch is for v_d + j v_q and v_d - j v_q: one scalar of the phase frame at s + j w1 and at s - j w1."""
    return of(branch, s + 1j * tree.w1_rad_s), of(branch, s - 1j * tree.w1_rad_s)
