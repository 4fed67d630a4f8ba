"""Who takes part in a mode: devices, buses and branches, and how surely the mode is where it is.

At a closed-loop pole the nodal matrix M = Y + Z^-1 of the ports has null vectors, l M = 0 and M r = 0. With D = l M' r
the pole moves by -l dM r / D when M changes by dM: a device's admittance, a conductance at a bus, a branch's impedance.
They come from the sparse matrix K = s E - A - B Y C of the whole network, w K = 0 and K x = 0, by l = w B and r = C x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...identify.fit.rational import evaluate
from ..network.assembly import branch_slopes
from .system import System
from .units import Unit

_ITERATIONS = 3  # of the inverse iteration; at a pole known to nine digits two would do


@dataclass(frozen=True, slots=True)
class ModeParts:
    """What moves one closed-loop pole.

    Attributes
    ----------
    pole : complex
        In rad/s, dq.
    devices : (n,) complex
        d(pole)/d(ln Y_i) of every device (rad/s): by how much it moves when that device grows by a hundred per cent.
    buses : (p,) complex
        d(pole)/dG of a conductance at every port (rad/s per S).
    branches : (b,) complex
        d(pole)/d(ln z_b) of every branch (rad/s).
    covariance : (2, 2) float
        Of real and imaginary part ((rad/s)^2); errors of units that share a table are one and the same error.
    """

    pole: complex
    devices: np.ndarray
    buses: np.ndarray
    branches: np.ndarray
    covariance: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """(n,) |d(pole)/d(ln Y_i)| of every device as a part of their sum."""
        size = np.abs(self.devices)
        return size / max(float(size.sum()), 1e-300)

    @property
    def std(self) -> complex:
        """Standard errors, real part + 1j imaginary part (rad/s)."""
        return complex(np.sqrt(self.covariance[0, 0]), np.sqrt(self.covariance[1, 1]))


def parts_of(system: System, pole: complex) -> ModeParts:
    """Participation of every device, port and branch in one closed-loop pole, and the pole's covariance."""
    shape = null_vectors(system, pole)
    left, right, slope = shape.left, shape.right, shape.slope
    devices = moved_by(system, shape, [own_admittance(unit, pole) for unit in system.units])
    buses = [-left[2 * k : 2 * k + 2] @ right[2 * k : 2 * k + 2] / slope for k in range(len(system.ports))]
    return ModeParts(
        pole=pole,
        devices=devices,
        buses=np.array(buses),
        branches=_branches(system, pole, shape),
        covariance=_covariance(system, pole, shape),
    )


class Shape(NamedTuple):
    """Null vectors at a pole.

    Attributes
    ----------
    left, right : (2p,) complex
        Of the nodal matrix of the ports, l M = 0 and M r = 0.
    slope : complex
        l M' r.
    adjoint, direct : (2n,) complex
        Of the matrix of all unknowns of the network.
    """

    left: np.ndarray
    right: np.ndarray
    slope: complex
    adjoint: np.ndarray
    direct: np.ndarray


def null_vectors(system: System, pole: complex) -> Shape:
    """The shape of a closed-loop pole, by inverse iteration; l M' r = -w K' x."""
    from scipy.sparse.linalg import splu

    matrix, slope = system.closed(pole)
    solved = splu(matrix)
    direct = _iterated(solved.solve, np.exp(1j * np.arange(matrix.shape[0])))
    adjoint = _iterated(lambda x: solved.solve(x, "T"), np.conj(slope @ direct))
    behind = system.descriptor
    return Shape(adjoint @ behind.b, behind.c @ direct, complex(-adjoint @ (slope @ direct)), adjoint, direct)


def _iterated(solve: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    x = start
    for _ in range(_ITERATIONS):
        x = solve(x / np.linalg.norm(x))
    return x / np.linalg.norm(x)


def moved_by(system: System, shape: Shape, change: Sequence[np.ndarray]) -> np.ndarray:
    """What a pole (rad/s) moves by when Y of each of the first n units changes by ``change`` (2, 2), alone: (n,)."""
    places = [system.place(unit) for unit in system.units[: len(change)]]
    moved = [-shape.left[at] @ dy @ shape.right[at] / shape.slope for at, dy in zip(places, change, strict=True)]
    return np.array(moved)


def own_admittance(unit: Unit, s: complex) -> np.ndarray:
    """Ydq (2, 2) in S of a unit in the common frame."""
    return unit.factor * (unit.turn @ evaluate(unit.model, np.array([s]))[0] @ unit.turn.T)


def _branches(system: System, pole: complex, shape: Shape) -> np.ndarray:
    """d(pole)/d(ln z) of every branch, -w dK x / (w K' x) by a relative change of its impedance.

    The network is one matrix of the phase frame at s + j w1 for v_d + j v_q and at s - j w1 for v_d - j v_q:
    w dK x = (w_d - j w_q) dK1 (x_d + j x_q) / 2 + (w_d + j w_q) dK2 (x_d - j x_q) / 2.
    """
    total = np.zeros(len(system.network.branches), dtype=complex)
    for sign in (1.0, -1.0):
        adjoint = shape.adjoint[0::2] - sign * 1j * shape.adjoint[1::2]
        direct = shape.direct[0::2] + sign * 1j * shape.direct[1::2]
        total += branch_slopes(system.network, pole + sign * 1j * system.w1_rad_s, adjoint, direct) / 2.0
    return total / shape.slope


def table_weights(system: System, pole: complex, shape: Shape) -> dict[str, np.ndarray]:
    """What the pole moves by when the admittance of a table changes by dY, as sum_ij weight_ij dY_ij, by table.

    Units with one table share its error, turned into each one's frame: their weights add before anything is squared.
    """
    weights: dict[str, np.ndarray] = {}
    for unit in system.units:
        at = system.place(unit)
        weight = -unit.factor * np.outer(unit.turn.T @ shape.left[at], unit.turn.T @ shape.right[at]) / shape.slope
        weights[unit.key] = weights.get(unit.key, np.zeros((2, 2))) + weight
    return weights


def _covariance(system: System, pole: complex, shape: Shape) -> np.ndarray:
    weights = {key: weight[None] for key, weight in table_weights(system, pole, shape).items()}
    errors = system.errors(np.array([pole]), weights)[0]
    effect = np.stack([errors.real, errors.imag])
    return np.asarray(effect @ effect.T)


def ranked(shares: Sequence[float]) -> list[int]:
    """Indices by falling share."""
    return sorted(range(len(shares)), key=lambda i: -shares[i])
