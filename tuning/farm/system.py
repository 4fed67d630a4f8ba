"""Devices and network as one linear system in the common dq frame: poles from a pencil, a locus from determinants.

A unit's admittance stands in the frame of its own terminal voltage; in the common frame it is R(d) Y R(-d), d the angle
by which that voltage leads. The network is one real phase-frame descriptor, seen from the buses that carry devices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...identify.fit.rational import RationalModel, derivative, evaluate, joint, spread
from ..network.assembly import GROUND, Network, assemble, port_impedance
from ..network.descriptor import Descriptor, J, rotating
from ..poles import states
from .entries import FarmError
from .pairs import Pair, from_dq, plus, turned
from .tree import Tree, factors, tree_of
from .units import Unit

if TYPE_CHECKING:
    from scipy.sparse import csc_array

UNDAMPED = 1e-9
"""Network modes with a smaller damping ratio lie on the axis."""

PASSED_RAD_S = 0.2
"""Radius of the half circles that lead the contour past the network's modes on the axis."""

_INFINITE = 1e8  # rad/s; eigenvalues of the pencil beyond are its infinite ones


@dataclass(frozen=True)
class System:
    """A farm ready to be judged.

    Attributes
    ----------
    units : tuple of Unit
        The devices.
    network : Network
        Equipment, the source as ground.
    ports : tuple of str
        Buses whose voltages and currents are looked at; every device's bus is one of them.
    f1_hz : float
        Fundamental (Hz).
    """

    units: tuple[Unit, ...]
    network: Network
    ports: tuple[str, ...]
    f1_hz: float

    @property
    def w1_rad_s(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * np.pi * self.f1_hz

    @property
    def end_hz(self) -> float:
        """The highest |f - f1| that every device was swept to (Hz)."""
        return float(min(unit.model.nu_hz[-1] for unit in self.units))

    def place(self, unit: Unit) -> slice:
        """Rows of a unit's bus among the ports' (d, q) pairs."""
        k = self.ports.index(unit.bus)
        return slice(2 * k, 2 * k + 2)

    @cached_property
    def _phase(self) -> Descriptor:
        return assemble(self.network, self.ports)

    @cached_property
    def descriptor(self) -> Descriptor:
        """The network in the common dq frame, currents drawn at the ports in, their voltages out."""
        return rotating(self._phase, self.w1_rad_s)

    @cached_property
    def network_modes(self) -> np.ndarray:
        """Own modes of the network in dq (rad/s), conjugates included."""
        poles = _finite_eigenvalues(self._phase.a, self._phase.e, 0.7 * self.w1_rad_s)
        return np.concatenate([poles - 1j * self.w1_rad_s, poles + 1j * self.w1_rad_s])

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """Zdq (n, 2p, 2p) in ohm of the ports at complex ``s`` (n,) in rad/s."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        z1 = port_impedance(self.network, self.ports, s + 1j * self.w1_rad_s)
        z2 = port_impedance(self.network, self.ports, s - 1j * self.w1_rad_s)
        own, turned = (z1 + z2) / 2.0, (z1 - z2) / 2j
        return _kron(own, np.eye(2)) + _kron(turned, J)

    def admittance(self, s: np.ndarray) -> np.ndarray:
        """Ydq (n, 2p, 2p) in S of all devices at the ports, block-diagonal, in the common frame."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        total = np.zeros((len(s), 2 * len(self.ports), 2 * len(self.ports)), dtype=complex)
        of_model = {id(unit.model): evaluate(unit.model, s) for unit in self.units}
        for unit in self.units:
            at = self.place(unit)
            total[:, at, at] += unit.factor * (unit.turn @ of_model[id(unit.model)] @ unit.turn.T)
        return total

    @cached_property
    def models(self) -> dict[str, RationalModel]:
        """The fit of every table, by `Unit.key`."""
        return {unit.key: unit.model for unit in self.units}

    def errors(self, s: np.ndarray, weights: Mapping[str, np.ndarray]) -> np.ndarray:
        """What the errors of all tables, each of unit variance, do to sum_ij weight_ij Ydq_ij(s): (n, k) complex.

        ``s`` (n,) in rad/s, and by table the weights (n, 2, 2). Errors add over tables, not over devices.
        """
        models = [self.models[key] for key in weights]
        return joint(models, [spread(model, s, w) for model, w in zip(models, weights.values(), strict=True)])

    def closed(self, s: complex) -> tuple[csc_array, csc_array]:
        """K = s E - A - B Y C of network and devices at a complex ``s`` (rad/s), singular at a mode; and dK/ds."""
        from scipy.sparse import block_diag, csc_array

        behind, at = self._sparse, np.array([s])
        y, slope = (np.zeros((len(self.ports), 2, 2), dtype=complex) for _ in range(2))
        values = {id(unit.model): (evaluate(unit.model, at)[0], derivative(unit.model, s)) for unit in self.units}
        for unit in self.units:
            own, by_s = values[id(unit.model)]
            k, turn = self.ports.index(unit.bus), unit.turn
            y[k] += unit.factor * (turn @ own @ turn.T)
            slope[k] += unit.factor * (turn @ by_s @ turn.T)
        e, a, b, c = behind
        closed = s * e - a - b @ block_diag(list(y), "csc") @ c
        return csc_array(closed), csc_array(e - b @ block_diag(list(slope), "csc") @ c)

    @cached_property
    def _sparse(self) -> tuple[csc_array, ...]:
        from scipy.sparse import csc_array

        return tuple(csc_array(matrix.astype(complex)) for matrix in self.descriptor)

    def loop(self, nu_hz: np.ndarray) -> np.ndarray:
        """1 + Y Z (n, 2p, 2p) over all ports on the `contour` for |f - f1| in Hz, inside the band."""
        s = self.contour(nu_hz)
        return np.eye(2 * len(self.ports)) + self.admittance(s) @ self.impedance(s)

    def by_bus(self, s: np.ndarray) -> dict[str, Pair]:
        """Admittances, each of (n,) in S, of the units by bus in the common frame; each model evaluated once."""
        values = {id(unit.model): from_dq(evaluate(unit.model, s)) for unit in self.units}
        found: dict[str, Pair] = {}
        for unit in self.units:
            y = turned(values[id(unit.model)], unit.angle_rad, unit.factor)
            found[unit.bus] = plus(found[unit.bus], y) if unit.bus in found else y
        return found

    @cached_property
    def tree(self) -> Tree | None:
        """The network as a tree; None if it has a loop."""
        root = next(name for name in self.network.branches[-1].ends if name != GROUND)
        try:
            return tree_of(self.network, root, None, self.w1_rad_s)
        except FarmError:
            return None

    def tree_factors(self, nu_hz: np.ndarray) -> np.ndarray:
        """(n, k, 6) on the `contour`: four elements of each 2x2 matrix with the devices, and the two without them.

        The product of the determinants with the devices over that without them is det(1 + Y Z).
        """
        assert self.tree is not None
        s = self.contour(nu_hz)
        with_devices, without = factors(self.tree, s, self.by_bus(s)), factors(self.tree, s, {})
        pairs = zip(with_devices, without, strict=True)
        return np.stack([np.stack([*full, alone.pp, alone.nn], -1) for full, alone in pairs], axis=1)

    @cached_property
    def axis_rad_s(self) -> np.ndarray:
        """Angular frequencies (k,) from zero on, in dq, at which the network has a mode on the axis."""
        modes = self.network_modes
        undamped = np.abs(modes.real) <= UNDAMPED * np.maximum(np.abs(modes), self.w1_rad_s)
        return np.unique(np.round(np.abs(modes.imag[undamped]), 6))

    def contour(self, nu_hz: np.ndarray) -> np.ndarray:
        """s (n,) of the half axis, led past the network's modes on it in half circles on the right.

        There Z is infinite, such as at f = 0 behind a series capacitor. Passed on the right they count as stable.
        """
        w = 2.0 * np.pi * np.asarray(nu_hz, dtype=float)
        if len(self.axis_rad_s) == 0:
            return 1j * w
        nearest = np.abs(w[:, None] - self.axis_rad_s).min(axis=1)
        return 1j * w + np.sqrt(np.maximum(PASSED_RAD_S**2 - nearest**2, 0.0))

    def poles(self) -> np.ndarray:
        """Closed-loop poles (m,) in rad/s, dq, conjugates included: finite eigenvalues of one pencil.

        x_i' = A_i x_i + B_i R(-d_i) v,  u = sum_i R(d_i) (C_i x_i + D_i R(-d_i) v + E_i R(-d_i) v'),
        Eg xg' = Ag xg + Bg u,  v = Cg xg.
        """
        behind = self.descriptor
        spaces = [_real_states(unit.model) for unit in self.units]
        counts = np.cumsum([0, *(len(a) for a, _, _ in spaces)])
        n, p = int(counts[-1]), 2 * len(self.ports)
        size = n + p + len(behind.a)
        m, e = np.zeros((size, size)), np.zeros((size, size))
        current, network = slice(n, n + p), slice(n + p, None)
        m[current, current], m[network, current] = np.eye(p), behind.b
        m[network, network], e[network, network] = behind.a, behind.e
        e[:n, :n] = np.eye(n)
        for unit, (a, b, c), start in zip(self.units, spaces, counts, strict=False):
            state, at, turn = slice(start, start + len(a)), self.place(unit), unit.turn
            rows, seen = slice(n + at.start, n + at.stop), turn.T @ behind.c[at]
            m[state, state], m[state, network] = a, b @ seen
            m[rows, state] = -unit.factor * turn @ c
            m[rows, network] -= unit.factor * turn @ unit.model.d @ seen
            e[rows, network] += unit.factor * turn @ unit.model.e @ seen
        return _finite_eigenvalues(m, e, 0.7 * self.w1_rad_s)


def system_of(units: Sequence[Unit], network: Network, f1_hz: float, more_ports: Sequence[str] = ()) -> System:
    """Devices and network joined; ``more_ports`` are buses without a device that are looked at as well."""
    ports = tuple(dict.fromkeys([*(unit.bus for unit in units), *more_ports]))
    return System(tuple(units), network, ports, f1_hz)


def _kron(blocks: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Kronecker product of a stack (n, p, p) with (2, 2)."""
    n, p, _ = blocks.shape
    return np.einsum("nij,kl->nikjl", blocks, small).reshape(n, 2 * p, 2 * p)


def _real_states(model: RationalModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, n), B (n, 2), C (2, n), all real: x' = A x + B u, y = C x, the two states of a pair beside each other."""
    a, b, c = states(model)
    real, upper = np.flatnonzero(a.imag == 0.0), np.flatnonzero(a.imag > 0.0)
    n = len(real) + 2 * len(upper)
    first = len(real) + 2 * np.arange(len(upper))
    own, inputs, outputs = np.zeros((n, n)), np.zeros((n, 2)), np.zeros((2, n))
    own[np.arange(len(real)), np.arange(len(real))] = a[real].real
    inputs[: len(real)], outputs[:, : len(real)] = b[real].real, c[:, real].real
    own[first, first] = own[first + 1, first + 1] = a[upper].real
    own[first, first + 1], own[first + 1, first] = -a[upper].imag, a[upper].imag
    inputs[first], inputs[first + 1] = b[upper].real, b[upper].imag
    outputs[:, first], outputs[:, first + 1] = 2.0 * c[:, upper].real, -2.0 * c[:, upper].imag
    return own, inputs, outputs


def _finite_eigenvalues(a: np.ndarray, e: np.ndarray, about: float) -> np.ndarray:
    """Eigenvalues s of real (A, E), inverted about a point in the right half-plane, the infinite ones left out.

    With M = (A - about E)^-1 E they are about + 1 / eig(M). Unknowns without a derivative are zero columns of E and of
    M: what is left is as large as the system has states. The pencil of a network is sparse, and so is its inverse's LU.
    """
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    size = 1.0 / np.maximum(np.abs(a).max(axis=1), np.abs(e).max(axis=1) * about)[:, None]
    dynamic = np.flatnonzero(np.any(e, axis=0))
    inverted = splu(csc_array((a - about * e) * size)).solve((e * size)[:, dynamic])[dynamic]
    inverse = np.linalg.eigvals(inverted)
    poles = about + 1.0 / inverse[np.abs(inverse) > 1.0 / _INFINITE]
    real = np.abs(poles.imag) < 1e-9 * np.abs(poles)
    poles[real] = poles[real].real
    return np.asarray(poles, dtype=complex)
