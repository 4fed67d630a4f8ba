"""What one device of a farm is connected to: the network with all other devices, as an impedance at its terminals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...identify.fit.rational import evaluate
from .pairs import Pair, from_dq, inverse, plus, scaled, to_dq, turned
from .system import System
from .tree import seen_at_nodes
from .units import Unit


@dataclass(frozen=True)
class Whole:
    """The farm as a further device at any bus would see it; what was computed is kept, as all devices ask for it."""

    system: System
    _kept: dict[bytes, dict[str, Pair]] = field(default_factory=dict)

    def at(self, nu_hz: np.ndarray) -> dict[str, Pair]:
        """Admittance (n,) in S at every bus with a device, in the common frame, at |f - f1| (n,) in Hz."""
        key = nu_hz.tobytes()
        if key not in self._kept:
            self._kept[key] = self._seen(self.system.contour(nu_hz))
        return self._kept[key]

    def _seen(self, s: np.ndarray) -> dict[str, Pair]:
        system = self.system
        if system.tree is not None:
            return seen_at_nodes(system.tree, s, system.by_bus(s))
        z, found = system.impedance(s), {}
        seen = np.linalg.solve(np.eye(z.shape[1]) + z @ system.admittance(s), z)
        for k, bus in enumerate(system.ports):
            at = slice(2 * k, 2 * k + 2)
            found[bus] = inverse(from_dq(seen[:, at, at]))
        return found


@dataclass(frozen=True)
class Rest:
    """What a device sees: an `Impedance` in its own frame, for one of as many equal devices as it stands for."""

    whole: Whole
    unit: Unit

    def impedance_dq(self, s: np.ndarray) -> np.ndarray:
        """Zdq (n, 2, 2) in ohm at ``s`` (n,) on the imaginary axis (rad/s)."""
        unit, nu_hz = self.unit, np.asarray(s).imag / (2.0 * np.pi)
        y = evaluate(unit.model, self.whole.system.contour(nu_hz))
        own = turned(from_dq(y), unit.angle_rad, unit.factor)
        rest = plus(self.whole.at(nu_hz)[unit.bus], scaled(-1.0, own))
        return to_dq(turned(inverse(rest), -unit.angle_rad, unit.factor))
