"""A network's own motion: its finite states, free of the algebra between them, and what is kept when it is switched.

The descriptor E x' = A x + B u has as many states as its pencil has finite eigenvalues: xi' = F xi + G u, and
x = V xi + D u + K u'. Currents of inductors and voltages of capacitors are the *memory*: at a switching E x is kept, so
that flux and charge go on where they can, and what a switch has made impossible (two inductors in one cut set, two
currents) is settled at once.

Two frames: ``"dq"``, where a symmetric network is one complex copy of its phase and an operating point stands still;
``"stationary"``, where alpha and beta are coupled by an unsymmetric fault and the states are real pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np

from ..errors import SeqsweepError
from .branches import GROUND, Branch
from .circuit import SOURCE, Descriptor, descriptor_of

Frame = Literal["dq", "stationary"]

Conductance = tuple[float, float, float]
"""Alpha-alpha, alpha-beta, beta-beta (S)."""

SOUND: Conductance = (0.0, 0.0, 0.0)
"""No fault."""

_RANK = 1e-11  # what is smaller beside the largest is a zero of the network's topology


@dataclass(frozen=True, slots=True)
class Fault:
    """A short circuit at a node, as a conductance on (alpha, beta)."""

    node: str
    conductance: Conductance

    @property
    def symmetric(self) -> bool:
        """Whether alpha and beta see the same and do not see each other."""
        aa, ab, bb = self.conductance
        return ab == 0.0 and abs(aa - bb) <= 1e-12 * abs(aa)


class Finite(NamedTuple):
    """xi' = F xi + G u and x = V xi + D u + K u'; ``enter`` takes E x to xi."""

    f: np.ndarray
    g: np.ndarray
    v: np.ndarray
    d: np.ndarray
    k: np.ndarray
    enter: np.ndarray


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A network ready to be stepped.

    Attributes
    ----------
    branches : tuple of Branch
        Its branches, in the order of its memory.
    ports : tuple of str
        Nodes into which currents are fed.
    frame : "dq" or "stationary"
        In which its states stand.
    w1_rad_s : float
        Fundamental angular frequency (rad/s).
    system : Descriptor
        One phase of it, the fault left out.
    finite : Finite
        In the frame's coordinates: one phase, or alpha and beta in pairs.
    pairs : tuple of (2 n, 2 n) float
        E and A of alpha and beta with the fault; empty in the dq frame.
    """

    branches: tuple[Branch, ...]
    ports: tuple[str, ...]
    frame: Frame
    w1_rad_s: float
    system: Descriptor
    finite: Finite
    pairs: tuple[np.ndarray, np.ndarray]

    # ------------------------------------------------------------------ memory

    @cached_property
    def content(self) -> np.ndarray:
        """(n, 2 b): E x of one phase from the memory, branch by branch a current (A) and a voltage (V)."""
        at = self.system.at
        found = np.zeros((at.n, 2 * len(self.branches)))
        for k, branch in enumerate(self.branches):
            if k in at.current:
                found[at.current[k], 2 * k] = branch.l_h
            if k in at.capacitor:
                found[at.capacitor[k], 2 * k + 1] = branch.c_f
            if branch.is_capacitor:
                for node, ratio in self._ends(branch):
                    found[node, 2 * k + 1] += ratio * branch.c_f
        return found

    @cached_property
    def readout(self) -> tuple[np.ndarray, np.ndarray]:
        """(2 b, n) and (2 b,): the memory of one phase from x and the source voltage."""
        at = self.system.at
        found, by_source = np.zeros((2 * len(self.branches), at.n)), np.zeros(2 * len(self.branches))
        for k, branch in enumerate(self.branches):
            if k in at.current:
                found[2 * k, at.current[k]] = 1.0
            if k in at.capacitor:
                found[2 * k + 1, at.capacitor[k]] = 1.0
            if branch.is_capacitor:
                by_source[2 * k + 1] = branch.ends.get(SOURCE, 0.0)
                for node, ratio in self._ends(branch):
                    found[2 * k + 1, node] = ratio
        return found, by_source

    def _ends(self, branch: Branch) -> list[tuple[int, float]]:
        place = self.system.at.node
        return [(place[name], ratio) for name, ratio in branch.ends.items() if name in place]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the branches."""
        return tuple(branch.name for branch in self.branches)

    def remembered(self, x: np.ndarray, v_source: complex = 0j) -> np.ndarray:
        """The memory (b, 2) that x (n,) of one phase stands for."""
        of_x, of_source = self.readout
        return (of_x @ x + of_source * v_source).reshape(-1, 2)

    # ------------------------------------------------------------------ forced by sources

    def by_source(self, v_source: complex) -> tuple[Turning, ...]:
        """What the ideal source alone holds for ever, ``v_source`` its voltage in the dq frame."""
        s = 1j * self.w1_rad_s
        return self._forced(s, (self.system.by_source + s * self.system.by_slope) * v_source)

    def by_current(self, currents: np.ndarray) -> tuple[Turning, ...]:
        """What steady port currents (p,) alone hold for ever, in the dq frame."""
        return self._forced(1j * self.w1_rad_s, self.system.b @ currents)

    def by_tone(self, f_rad_s: float, right: np.ndarray) -> Turning:
        """What a tone at ``f_rad_s`` of the phase frame holds, (s E - A) x = ``right``; of a symmetric network.

        Raises
        ------
        SeqsweepError
            If the network lets no such tone through.
        """
        s = 1j * f_rad_s
        try:
            held = np.linalg.solve(s * self.system.e - self.system.a, right)
        except np.linalg.LinAlgError:
            raise SeqsweepError(
                f"the grid's elements let no tone at {f_rad_s / (2.0 * np.pi):g} Hz through (a series capacitor passes "
                "no direct current): leave the row at 2 f1 out, or sweep on an ideal source"
            ) from None
        return Turning(f_rad_s - self.w1_rad_s, held)

    def _forced(self, s: complex, right: np.ndarray) -> tuple[Turning, ...]:
        """Both sequences of a space vector exp(s t) that enters at ``right`` (n,), in the dq frame."""
        if self.frame == "dq":
            return (Turning(0.0, np.linalg.solve(s * self.system.e - self.system.a, right)),)
        e, a = self.pairs
        pair = np.linalg.solve(s * e - a, np.stack([right, -1j * right], axis=1).ravel()).reshape(-1, 2)
        forward, backward = pair[:, 0] + 1j * pair[:, 1], pair[:, 0].conj() + 1j * pair[:, 1].conj()
        return Turning(0.0, 0.5 * forward), Turning(-2.0 * self.w1_rad_s, 0.5 * backward)

    # ------------------------------------------------------------------ coordinates

    def entered(self, memory: np.ndarray, time_s: float) -> np.ndarray:
        """States (m,), real, of a memory (b, 2) in the dq frame: d, q pairs, or alpha, beta pairs mixed."""
        content = self.content @ memory.ravel()
        if self.frame == "dq":
            return as_pairs(self.finite.enter @ content)
        turned = content * np.exp(1j * self.w1_rad_s * time_s)
        return np.asarray(self.finite.enter @ as_pairs(turned))

    def left(self, states: np.ndarray, currents: np.ndarray, time_s: float) -> np.ndarray:
        """x (n,) in the dq frame from states (m,) and port currents (p,) in the dq frame."""
        if self.frame == "dq":
            found: np.ndarray = self.finite.v @ from_pairs(states) + self.finite.d @ currents
            return found
        turn = np.exp(1j * self.w1_rad_s * time_s)
        return from_pairs(self.finite.v @ states + self.finite.d @ as_pairs(currents * turn)) / turn


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What a network keeps, in the dq frame at w1, power-invariant or whatever its voltages are.

    Attributes
    ----------
    names : tuple of str
        Its branches.
    values : (b, 2) complex
        Current (A) and voltage of the capacitor (V) of each; zero where a branch has none.
    """

    names: tuple[str, ...]
    values: np.ndarray

    def of(self, names: tuple[str, ...]) -> np.ndarray:
        """(b, 2) of other branches: what is new begins without current and charge."""
        if names == self.names:
            return self.values
        known = dict(zip(self.names, self.values, strict=True))
        return np.array([known.get(name, np.zeros(2, dtype=complex)) for name in names]).reshape(-1, 2)


class Turning(NamedTuple):
    """x(t) = x exp(j w t) in the dq frame."""

    w_rad_s: float
    x: np.ndarray

    def at(self, time_s: float) -> np.ndarray:
        """x at a time (s)."""
        found: np.ndarray = self.x * np.exp(1j * self.w_rad_s * time_s)
        return found


def as_pairs(x: np.ndarray) -> np.ndarray:
    """(2 n,) real and imaginary parts in turn."""
    return np.stack([x.real, x.imag], axis=-1).reshape(*x.shape[:-1], -1)


def from_pairs(x: np.ndarray) -> np.ndarray:
    """(n,) complex of pairs (2 n,)."""
    pairs = x.reshape(-1, 2)
    found: np.ndarray = pairs[:, 0] + 1j * pairs[:, 1]
    return found


@lru_cache(maxsize=64)
def dynamics_of(
    branches: tuple[Branch, ...], ports: tuple[str, ...], w1_rad_s: float, fault: Fault | None = None
) -> Dynamics:
    """The motion of a network with currents fed in at ``ports``.

    Raises
    ------
    SeqsweepError
        If a node has no path to the source or to ground.
    """
    if fault is not None and fault.symmetric:
        short = Branch(f"fault at {fault.node}", {fault.node: 1.0, GROUND: -1.0}, 1.0 / fault.conductance[0])
        return dynamics_of((*branches, short), ports, w1_rad_s)
    system = descriptor_of(branches, ports)
    if fault is None:
        finite = finite_part(system.e, system.a, system.b)
        return Dynamics(branches, ports, "dq", w1_rad_s, system, finite, (np.zeros((0, 0)),) * 2)
    e, a, b = (np.kron(matrix, np.eye(2)) for matrix in (system.e, system.a, system.b))
    aa, ab, bb = fault.conductance
    node = 2 * system.at.node[fault.node]
    a[node : node + 2, node : node + 2] -= np.array([[aa, ab], [ab, bb]])
    return Dynamics(branches, ports, "stationary", w1_rad_s, system, finite_part(e, a, b), (e, a))


def finite_part(e: np.ndarray, a: np.ndarray, b: np.ndarray) -> Finite:
    """The states of E x' = A x + B u of index two or less, E symmetric and not negative.

    x = U y + N z with U on the range of E and N on its null space. What of N' A N is regular gives a part of z at once;
    what is not leaves constraints K y + k u = 0 and multipliers z_0, which their derivative determines.

    Raises
    ------
    SeqsweepError
        If the pencil is singular.
    """
    inside, outside = _range_of(e)
    a_11, a_12, b_1 = inside.T @ a @ inside, inside.T @ a @ outside, inside.T @ b
    a_21, a_22, b_2 = outside.T @ a @ inside, outside.T @ a @ outside, outside.T @ b
    regular, left_null, right_null = _inverted(a_22)
    by_y, by_u = -regular @ a_21, -regular @ b_2  # z but for the multipliers
    a_y, b_y = a_11 + a_12 @ by_y, b_1 + a_12 @ by_u
    k_y, k_u, f = left_null.T @ a_21, left_null.T @ b_2, a_12 @ right_null
    weight = inside.T @ e @ inside
    inverse = np.linalg.inv(weight)
    among = k_y @ inverse @ f
    if len(among) and not np.linalg.cond(_scaled_rows(among)) < 1e10:
        raise SeqsweepError("a node of the network has no path to the source or to ground")
    solved = np.linalg.inv(among) if len(among) else np.zeros((0, 0))
    held = inverse @ f @ solved  # K H = 1
    p, w = _null_space(k_y), _null_space(f.T)
    states = np.linalg.inv(w.T @ weight @ p)
    y_u = -held @ k_u
    multiplier = -solved @ k_y @ inverse
    v = (inside + outside @ (by_y + right_null @ multiplier @ a_y)) @ p
    d = inside @ y_u + outside @ (by_y @ y_u + by_u + right_null @ multiplier @ (a_y @ y_u + b_y))
    k = -outside @ right_null @ solved @ k_u
    return Finite(states @ w.T @ a_y @ p, states @ w.T @ (b_y + a_y @ y_u), v, d, k, states @ w.T @ inside.T)


def _range_of(e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bases of what E sees and what it does not, columns of about one size."""
    size = np.sqrt(np.diagonal(e))
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(e * scale[:, None] * scale)
    seen = values > _RANK * max(float(values.max(initial=0.0)), 1e-300)
    return scale[:, None] * vectors[:, seen], scale[:, None] * vectors[:, ~seen]


def _inverted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse on what a square matrix sees, and its null spaces to the left and to the right."""
    if not len(matrix):
        return matrix, np.zeros((0, 0)), np.zeros((0, 0))
    rows = _sizes(matrix, 1)
    columns = _sizes(matrix / rows[:, None], 0)
    left, values, right = np.linalg.svd(matrix / rows[:, None] / columns)
    n = int(np.sum(values > _RANK * max(float(values[0]), 1e-300)))
    inverse = (right[:n].T / columns[:, None]) @ ((left[:, :n] / rows[:, None]) / values[:n]).T
    return inverse, left[:, n:] / rows[:, None], right[n:].T / columns[:, None]


def _null_space(matrix: np.ndarray) -> np.ndarray:
    """Basis (n, n - r) of what a matrix (r, n) of full rank takes to zero."""
    if not len(matrix):
        return np.eye(matrix.shape[1])
    found: np.ndarray = np.linalg.svd(_scaled_rows(matrix))[2][len(matrix) :].T
    return found


def _scaled_rows(matrix: np.ndarray) -> np.ndarray:
    scaled: np.ndarray = matrix / _sizes(matrix, 1)[:, None]
    return scaled


def _sizes(matrix: np.ndarray, axis: int) -> np.ndarray:
    size = np.abs(matrix).max(axis=axis, initial=0.0)
    return np.where(size > 0.0, size, 1.0)
