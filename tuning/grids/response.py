"""Another table of ours as the grid: a measured source, another converter, a farm.

Its current into it is i_s = Ys v, and what flows into the device flows out of it: v = -Ys^-1 i. Its rows, unlike a
passive network's, couple positive sequence and mirror image, and have errors; both enter the verdict.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...identify.fit.rational import RationalModel, derivative, evaluate, spread
from ..network.descriptor import Descriptor
from .coverage import around, is_between

_INFINITE = 1e8  # rad/s; eigenvalues beyond are the infinite ones of the pencil


@dataclass(frozen=True, slots=True)
class ResponseGrid:
    """A fitted 2x2 admittance in place of a network.

    Attributes
    ----------
    model : RationalModel
        Ys of the source, load direction, dq frame; fitted to what is known of its own stability.
    name : str
        For people.
    scale : float
        Multiplies the impedance.
    """

    model: RationalModel
    name: str = ""
    scale: float = 1.0
    modes: np.ndarray = field(init=False, repr=False, compare=False)

    couples = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "modes", _open_circuit_modes(self.descriptor(), self.w1_rad_s))

    @property
    def f1_hz(self) -> float:
        """Fundamental frequency (Hz)."""
        return self.model.f1_hz

    @property
    def w1_rad_s(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * np.pi * self.f1_hz

    @property
    def label(self) -> str:
        """Name, rows and order."""
        scale = "" if self.scale == 1.0 else f" times {self.scale:.4g}"
        return f"{self.name or 'a measured source'}: 2x2 table of {len(self.model.nu_hz)} rows{scale}"

    @property
    def at_f1(self) -> complex:
        """Impedance of the positive sequence at the fundamental (ohm), its mirror image aside."""
        z = self.impedance_dq(np.zeros(1))[0]
        return complex((z[0, 0] + z[1, 1]) / 2.0 + 1j * (z[1, 0] - z[0, 1]) / 2.0)

    @property
    def size_ohm(self) -> float:
        """Its magnitude (ohm)."""
        return abs(self.at_f1)

    @property
    def axis_poles(self) -> np.ndarray:
        """None: a measured mode has some damping."""
        return np.zeros(0)

    @property
    def rows_hz(self) -> np.ndarray:
        """f1 + |f - f1| of the rows (Hz)."""
        return self.f1_hz + self.model.nu_hz

    def impedance_dq(self, s: np.ndarray) -> np.ndarray:
        """Ys^-1."""
        return self.scale * np.linalg.inv(evaluate(self.model, s))

    def admittance_dq(self, s: np.ndarray) -> np.ndarray:
        """Ys (n, 2, 2) in S: what was measured, finite where Z is not, as of a line with a series capacitor at 0 Hz."""
        return evaluate(self.model, s) / self.scale

    def spread_admittance(self, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """What the errors of Ys, each of unit variance, do to sum_ij weight_ij Ys_ij(s): (n, k) complex."""
        return spread(self.model, np.atleast_1d(s), weight / self.scale)

    @property
    def shadows(self) -> np.ndarray:
        """Poles of Ys: where its fit has a state more than the source, a mode stands on them that is none."""
        return self.model.poles

    def slope_dq(self, s: np.ndarray) -> np.ndarray:
        """-Ys^-1 Ys' Ys^-1."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        z = np.linalg.inv(evaluate(self.model, s))
        slopes = np.stack([derivative(self.model, complex(each)) for each in s])
        return -self.scale * z @ slopes @ z

    def descriptor(self) -> Descriptor:
        """States of Ys and the PCC's voltage: 0 = C x + D v + E v' + i, complex where poles are."""
        from ..poles import states

        model = self.model
        a, b, c = states(model)
        n = len(a)
        e_all, a_all = np.zeros((n + 2, n + 2), dtype=complex), np.zeros((n + 2, n + 2), dtype=complex)
        e_all[:n, :n], a_all[:n, :n], a_all[:n, n:] = np.eye(n), np.diag(a), b
        a_all[n:, :n], a_all[n:, n:], e_all[n:, n:] = -c, -model.d, model.e
        into = np.zeros((n + 2, 2))
        into[n:] = -np.eye(2)
        return Descriptor(e_all, a_all, into, self.scale * np.abs(into.T))

    def clearing(self, s: np.ndarray) -> np.ndarray:
        """det Ys, its unstable poles mirrored: of Ys, not of Ys^-1, it is known that it is stable."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        y = evaluate(self.model, s) / self.scale
        unstable = self._unstable
        mirrored = np.prod((s[:, None] - unstable) / (s[:, None] + unstable.conj()), axis=1)
        size = np.linalg.norm(self.model.d) + 1.0 / self.size_ohm
        return mirrored * (y[:, 0, 0] * y[:, 1, 1] - y[:, 0, 1] * y[:, 1, 0]) / size**2

    def clearing_angle(self, s: complex) -> float:
        """Sum of the angles of the eigenvalues of Ys, -+90 degrees where it is passive, and of the mirrored poles."""
        own = np.angle(np.linalg.eigvals(evaluate(self.model, np.array([s]))[0]))
        mirrored = np.angle((s - self._unstable) / (s + self._unstable.conj()))
        return float(np.sum(own) + np.sum(mirrored))

    @property
    def _unstable(self) -> np.ndarray:
        """Poles of Ys in the right half-plane, with their ranks."""
        model = self.model
        right = model.poles.real > 0.0
        return np.repeat(model.poles[right], model.ranks[right])

    def spread_dq(self, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Errors of Ys: dZ = -Z dYs Z."""
        z = self.impedance_dq(s)
        turned = np.swapaxes(z, 1, 2)
        return spread(self.model, np.atleast_1d(s), -(turned @ weight @ turned) / self.scale)

    def missing_rows(self, nu_hz: float, width_hz: float) -> tuple[float, float] | None:
        """f1 + nu, where no rows stand on both sides."""
        if is_between(self.model.nu_hz, nu_hz, width_hz):
            return None
        low, high = around(nu_hz, width_hz)
        return self.f1_hz + low, self.f1_hz + high

    def scaled(self, scale: float) -> ResponseGrid:
        """The impedance multiplied, as by fewer of the same in parallel."""
        return ResponseGrid(self.model, self.name, self.scale * scale)

    def described(self) -> dict[str, Any]:
        """Impedance of the positive sequence at the fundamental, order and rows."""
        z = self.at_f1
        return {
            "kind": "response",
            "name": self.name,
            "r_ohm": z.real,
            "x_ohm": z.imag,
            "f1_hz": self.f1_hz,
            "scale": self.scale,
            "order": self.model.order,
            "rows": len(self.model.nu_hz),
        }


def _open_circuit_modes(system: Descriptor, w1_rad_s: float) -> np.ndarray:
    """Finite eigenvalues of the pencil with the PCC open: zeros of det Ys."""
    about = 0.7 * w1_rad_s + 0.1j * w1_rad_s
    inverse = np.linalg.eigvals(np.linalg.solve(system.a - about * system.e, system.e))
    return np.asarray(about + 1.0 / inverse[np.abs(inverse) > 1.0 / _INFINITE])
