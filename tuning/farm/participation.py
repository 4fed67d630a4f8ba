"""Who takes part in a mode: devices, buses and branches, and how surely the mode is where it is.

At a closed-loop pole the nodal matrix M = Y + Z^-1 of the ports has null vectors, l M = 0 and M r = 0. With D = l M' r
the pole moves by -l dM r / D when M changes by dM: a device's admittance, a conductance at a bus, a branch's impedance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...identify.fit.rational import evaluate, spread
from ..network.assembly import Branch, Network
from .system import System

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
    left, right, slope = _null_vectors(system, pole)
    y = [u.factor * (u.turn @ evaluate(u.model, np.array([pole]))[0] @ u.turn.T) for u in system.units]
    places = [system.place(unit) for unit in system.units]
    devices = [-left[at] @ y_i @ right[at] / slope for at, y_i in zip(places, y, strict=True)]
    buses = [-left[2 * k : 2 * k + 2] @ right[2 * k : 2 * k + 2] / slope for k in range(len(system.ports))]
    return ModeParts(
        pole=pole,
        devices=np.array(devices),
        buses=np.array(buses),
        branches=_branches(system, pole, left, right, slope),
        covariance=_covariance(system, pole, left, right, slope),
    )


def _null_vectors(system: System, pole: complex) -> tuple[np.ndarray, np.ndarray, complex]:
    """l, r and l M' r of the nodal matrix at a pole; M' by a difference in the complex plane."""
    u, _, vh = np.linalg.svd(_nodal(system, np.array([pole]))[0])
    left, right = u[:, -1].conj(), vh[-1].conj()
    h = _STEP * abs(pole)
    ahead, behind = _nodal(system, np.array([pole + h, pole - h]))
    return left, right, complex(left @ ((ahead - behind) / (2.0 * h)) @ right)


def _nodal(system: System, s: np.ndarray) -> np.ndarray:
    return system.admittance(s) + np.linalg.inv(system.impedance(s))


def _branches(system: System, pole: complex, left: np.ndarray, right: np.ndarray, slope: complex) -> np.ndarray:
    """d(pole)/d(ln z) of every branch: dM = -Z^-1 dZ Z^-1 by a relative change of its impedance."""
    s = np.array([pole])
    z_inverse = np.linalg.inv(system.impedance(s)[0])
    left_z, right_z = left @ z_inverse, z_inverse @ right
    found = []
    for k in range(len(system.network.branches)):
        more, less = (replace(system, network=_scaled(system.network, k, 1.0 + d)) for d in (_STEP, -_STEP))
        change = (more.impedance(s)[0] - less.impedance(s)[0]) / (2.0 * _STEP)
        found.append(left_z @ change @ right_z / slope)
    return np.array(found)


def _scaled(network: Network, k: int, factor: float) -> Network:
    branches: list[Branch] = list(network.branches)
    b = branches[k]
    branches[k] = replace(b, r_ohm=b.r_ohm * factor, l_h=b.l_h * factor, c_f=b.c_f / factor)
    return Network(tuple(branches), network.lines)


def _covariance(system: System, pole: complex, left: np.ndarray, right: np.ndarray, slope: complex) -> np.ndarray:
    """Errors add over tables, not over devices: units with one table share its error, turned into each one's frame."""
    weights: dict[str, np.ndarray] = {}
    models = {unit.key: unit.model for unit in system.units}
    for unit in system.units:
        at = system.place(unit)
        weight = -unit.factor * np.outer(unit.turn.T @ left[at], unit.turn.T @ right[at]) / slope
        weights[unit.key] = weights.get(unit.key, np.zeros((2, 2))) + weight
    total = np.zeros((2, 2))
    for key, weight in weights.items():
        errors = spread(models[key], np.array([pole]), weight[None])[0]
        effect = np.stack([errors.real, errors.imag])
        total += effect @ effect.T
    return total


def least_norm(slopes: np.ndarray, wanted: float, most: float) -> np.ndarray:
    """The gains (n,) of least sum of squares that move a real part by ``wanted`` (rad/s, negative), to first order.

    Parameters
    ----------
    slopes : (n,) float
        Re d(pole)/dk_i (rad/s).
    wanted : float
        Asked change of the real part.
    most : float
        Largest gain of a device.

    Notes
    -----
    k = mu g with g the slopes; what would pass ``most`` is held there and the others take the rest.
    """
    k, free = np.zeros(len(slopes)), np.ones(len(slopes), dtype=bool)
    for _ in range(len(slopes)):
        rest = wanted - float(slopes[~free] @ k[~free])
        size = float(slopes[free] @ slopes[free])
        k[free] = slopes[free] * rest / size if size > 0.0 else 0.0
        over = free & (k > most)
        if not np.any(over):
            break
        k[over], free = most, free & ~over
    return np.clip(k, 0.0, most)


def fewest(slopes: np.ndarray, wanted: float, most: float) -> np.ndarray:
    """Gains (n,) of as few devices as possible: the most effective one first, up to ``most`` each."""
    k, rest = np.zeros(len(slopes)), wanted
    for i in np.argsort(slopes):
        if rest >= 0.0 or slopes[i] >= 0.0:
            break
        k[i] = min(most, rest / slopes[i])
        rest -= k[i] * slopes[i]
    return k


def uniform(slopes: np.ndarray, wanted: float, most: float) -> np.ndarray:
    """The same gain (n,) for every device."""
    total = float(np.sum(slopes))
    return np.full(len(slopes), min(most, max(0.0, wanted / total)) if total < 0.0 else most)


def ranked(shares: Sequence[float]) -> list[int]:
    """Indices by falling share."""
    return sorted(range(len(shares)), key=lambda i: -shares[i])
