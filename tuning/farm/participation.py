"""Who takes part in a mode: devices, buses and branches, and how surely the mode is where it is.

At a closed-loop pole the nodal matrix M = Y + Z^-1 of the ports has null vectors, l M = 0 and M r = 0. With D = l M' r
the pole moves by -l dM r / D when M changes by dM: a device's admittance, a conductance at a bus, a branch's impedance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...identify.fit.rational import evaluate, spread
from ..network.assembly import branch_slopes
from .system import System
from .units import Unit

_STEP = 1e-6  # relative step of the differences; their error is of its square


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
    left, right, slope = shape = null_vectors(system, pole)
    devices = moved_by(system, shape, [own_admittance(unit, pole) for unit in system.units])
    buses = [-left[2 * k : 2 * k + 2] @ right[2 * k : 2 * k + 2] / slope for k in range(len(system.ports))]
    return ModeParts(
        pole=pole,
        devices=devices,
        buses=np.array(buses),
        branches=_branches(system, pole, left, right, slope),
        covariance=_covariance(system, pole, shape),
    )


class Shape(NamedTuple):
    """Null vectors of the nodal matrix at a pole, l M = 0 and M r = 0, and l M' r."""

    left: np.ndarray
    right: np.ndarray
    slope: complex


def null_vectors(system: System, pole: complex) -> Shape:
    """The shape of a closed-loop pole; M' by a difference in the complex plane."""
    u, _, vh = np.linalg.svd(_nodal(system, np.array([pole]))[0])
    left, right = u[:, -1].conj(), vh[-1].conj()
    h = _STEP * abs(pole)
    ahead, behind = _nodal(system, np.array([pole + h, pole - h]))
    return Shape(left, right, complex(left @ ((ahead - behind) / (2.0 * h)) @ right))


def moved_by(system: System, shape: Shape, change: Sequence[np.ndarray]) -> np.ndarray:
    """What a pole (rad/s) moves by when Y of each of the first n units changes by ``change`` (2, 2), alone: (n,)."""
    places = [system.place(unit) for unit in system.units[: len(change)]]
    moved = [-shape.left[at] @ dy @ shape.right[at] / shape.slope for at, dy in zip(places, change, strict=True)]
    return np.array(moved)


def own_admittance(unit: Unit, s: complex) -> np.ndarray:
    """Ydq (2, 2) in S of a unit in the common frame."""
    return unit.factor * (unit.turn @ evaluate(unit.model, np.array([s]))[0] @ unit.turn.T)


def _nodal(system: System, s: np.ndarray) -> np.ndarray:
    return system.admittance(s) + np.linalg.inv(system.impedance(s))


def _branches(system: System, pole: complex, left: np.ndarray, right: np.ndarray, slope: complex) -> np.ndarray:
    """d(pole)/d(ln z) of every branch: dM = -Z^-1 dZ Z^-1 by a relative change of its impedance.

    Z is one scalar of the phase frame at s + j w1 for v_d + j v_q and at s - j w1 for v_d - j v_q, so that
    l dZ r = (l_d - j l_q) dZ1 (r_d + j r_q) / 2 + (l_d + j l_q) dZ2 (r_d - j r_q) / 2.
    """
    z_inverse = np.linalg.inv(system.impedance(np.array([pole]))[0])
    left_z, right_z = left @ z_inverse, z_inverse @ right
    total = np.zeros(len(system.network.branches), dtype=complex)
    for sign in (1.0, -1.0):
        l_k = left_z[0::2] - sign * 1j * left_z[1::2]
        r_k = right_z[0::2] + sign * 1j * right_z[1::2]
        total += branch_slopes(system.network, system.ports, pole + sign * 1j * system.w1_rad_s, l_k, r_k) / 2.0
    return total / slope


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
    """Errors add over tables, not over devices."""
    models = {unit.key: unit.model for unit in system.units}
    total = np.zeros((2, 2))
    for key, weight in table_weights(system, pole, shape).items():
        errors = spread(models[key], np.array([pole]), weight[None])[0]
        effect = np.stack([errors.real, errors.imag])
        total += effect @ effect.T
    return total


def ranked(shares: Sequence[float]) -> list[int]:
    """Indices by falling share."""
    return sorted(range(len(shares)), key=lambda i: -shares[i])
