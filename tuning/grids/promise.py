"""What a grid promises: its impedance at any complex frequency, its own modes, its states, its doubts.

Signs: the current i flows out of the grid into the device, v = v_source - Z i. A symmetric passive grid is one real
scalar z(s) of the phase frame; a component at s of the dq frame sees it at s + j w1, its mirror image at s - j w1.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from ...identify.frames import dq_to_pn
from ...plant.errors import SeqsweepError
from ..network.descriptor import Descriptor, J


class Impedance(Protocol):
    """Whatever a device is connected to, as long as its impedance is all that is asked."""

    def impedance_dq(self, s: np.ndarray) -> np.ndarray:
        """Zdq (n, 2, 2) in ohm at complex ``s`` (n,) in rad/s, dq frame."""
        ...


@runtime_checkable
class Grid(Protocol):
    """A linear grid behind the PCC.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    label : str
        The grid in one line, for people.
    at_f1 : complex
        Impedance of the positive sequence at the fundamental (ohm).
    size_ohm : float
        Its magnitude.
    couples : bool
        Whether positive sequence and mirror image act on each other, as in another converter; a passive symmetric
        grid does not couple them.
    modes : (m,) complex
        Its own modes on open circuit, the poles of Zdq (rad/s, dq), conjugates included.
    axis_poles : (k,) float
        Which of them lie on the imaginary axis: their angular frequency (rad/s, dq), not negative.
    rows_hz : (r,) float or None
        Frequencies above zero at which the grid was measured (Hz); None if it is known everywhere.
    shadows : (q,) complex
        Where a mode of device and grid may stand that is none (rad/s, dq): it is not seen from the PCC.
    """

    @property
    def f1_hz(self) -> float: ...
    @property
    def label(self) -> str: ...
    @property
    def at_f1(self) -> complex: ...
    @property
    def size_ohm(self) -> float: ...
    @property
    def couples(self) -> bool: ...
    @property
    def modes(self) -> np.ndarray: ...
    @property
    def axis_poles(self) -> np.ndarray: ...
    @property
    def rows_hz(self) -> np.ndarray | None: ...
    @property
    def shadows(self) -> np.ndarray: ...

    def impedance_dq(self, s: np.ndarray) -> np.ndarray:
        """Zdq (n, 2, 2) in ohm at complex ``s`` (n,) in rad/s, dq frame."""
        ...

    def slope_dq(self, s: np.ndarray) -> np.ndarray:
        """dZdq/ds (n, 2, 2) in ohm s."""
        ...

    def descriptor(self) -> Descriptor:
        """Real E x' = A x + B i, v = C x in the dq frame: i (2,) into the device, v (2,) at the PCC."""
        ...

    def clearing(self, s: np.ndarray) -> np.ndarray:
        """By what (n,) det(1 + Y Z) is multiplied before its turns are counted: the grid then adds no pole to count.

        The product has no pole of the grid in the right half-plane or on the axis.
        """
        ...

    def clearing_angle(self, s: complex) -> float:
        """Angle (rad) from one to ``clearing`` at the end of a band, the way that a passive grid takes."""
        ...

    def spread_dq(self, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """What the grid's own errors, each of unit variance, do to sum_ij weight_ij Zdq_ij(s): (n, k) complex."""
        ...

    def missing_rows(self, nu_hz: float, width_hz: float) -> tuple[float, float] | None:
        """Band of f (Hz) in which the grid was to be measured for a mode at |f - f1|, so wide; None if nothing is."""
        ...

    def scaled(self, scale: float) -> Grid:
        """The same grid with its impedance multiplied by ``scale``."""
        ...

    def described(self) -> dict[str, Any]:
        """The grid as plain JSON values."""
        ...


UNDAMPED = 1e-9
"""Modes with a smaller damping ratio lie on the imaginary axis."""


BESIDE = 1e-8
"""How far beside an undamped mode Z is evaluated, as a part of w1."""


class OnePort:
    """What every passive symmetric grid has in common: one scalar z(s) of the phase frame does it all.

    A grid of this kind says its ``f1_hz``, `impedance`, `slope`, `phase_modes` and `phase_descriptor`.
    """

    __slots__ = ()

    couples = False
    rows_hz: np.ndarray | None = None
    shadows: np.ndarray = np.zeros(0, dtype=complex)

    f1_hz: float

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """z (n,) in ohm at complex ``s`` (n,) in rad/s of the phase frame."""
        raise NotImplementedError

    def slope(self, s: np.ndarray) -> np.ndarray:
        """dz/ds (n,) in ohm s."""
        raise NotImplementedError

    @property
    def phase_modes(self) -> np.ndarray:
        """Poles of z (m,) in rad/s, phase frame, conjugates included."""
        raise NotImplementedError

    def phase_descriptor(self) -> Descriptor:
        """The grid's states in the phase frame, one port."""
        raise NotImplementedError

    @property
    def w1_rad_s(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * np.pi * self.f1_hz

    @property
    def at_f1(self) -> complex:
        """z at the fundamental (ohm)."""
        return complex(self.impedance(np.array([1j * self.w1_rad_s]))[0])

    @property
    def size_ohm(self) -> float:
        """|z| at the fundamental (ohm)."""
        return abs(self.at_f1)

    @property
    def modes(self) -> np.ndarray:
        """Poles of Zdq: those of z, turned by w1 either way."""
        own = self.phase_modes
        return np.concatenate([own - 1j * self.w1_rad_s, own + 1j * self.w1_rad_s])

    @property
    def axis_poles(self) -> np.ndarray:
        """Angular frequencies in dq, not negative, of the modes without damping; one that both see stands twice."""
        w = self._undamped.imag
        return np.sort(w[w >= 0.0])

    @property
    def _undamped(self) -> np.ndarray:
        """Modes in dq on the imaginary axis, conjugates included."""
        own = self.phase_modes
        w = own.imag[np.abs(own.real) <= UNDAMPED * np.maximum(np.abs(own), self.w1_rad_s)]
        return 1j * np.concatenate([w - self.w1_rad_s, w + self.w1_rad_s]) if len(w) else np.zeros(0, dtype=complex)

    def _beside(self, s: np.ndarray) -> np.ndarray:
        """``s`` (n,), what stands on an undamped mode moved a little to the right of it: Z is infinite there."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        undamped = self._undamped
        if not len(undamped):
            return s
        tiny = BESIDE * self.w1_rad_s
        return np.where(np.abs(s[:, None] - undamped).min(axis=1) < tiny, s + tiny, s)

    def impedance_dq(self, s: np.ndarray) -> np.ndarray:
        """Z = (z1 + z2)/2 1 + (z1 - z2)/2j J with z1 = z(s + j w1), z2 = z(s - j w1)."""
        return self._folded(self.impedance, s)

    def slope_dq(self, s: np.ndarray) -> np.ndarray:
        """dZdq/ds."""
        return self._folded(self.slope, s)

    def _folded(self, function: Any, s: np.ndarray) -> np.ndarray:
        s = self._beside(s)
        z1, z2 = function(s + 1j * self.w1_rad_s), function(s - 1j * self.w1_rad_s)
        return ((z1 + z2) / 2.0)[:, None, None] * np.eye(2) + ((z1 - z2) / 2j)[:, None, None] * J

    def impedance_pn(self, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Zg1 = z(s) and Zg2 = z(s - 2j w1) in ohm at signed frequencies (n,) in Hz; paper eq. 2."""
        s = self._beside(2j * np.pi * np.asarray(f_hz, dtype=float) - 1j * self.w1_rad_s) + 1j * self.w1_rad_s
        return self.impedance(s), self.impedance(s - 2j * self.w1_rad_s)

    def descriptor(self) -> Descriptor:
        """The phase frame's states, twice, turning with w1."""
        from ..network.descriptor import rotating

        return rotating(self.phase_descriptor(), self.w1_rad_s)

    def clearing(self, s: np.ndarray) -> np.ndarray:
        """Product of (s - j w)/(s + w1) over the poles j w on the axis: they are passed on the right."""
        s = self._beside(s)
        return np.prod((s[:, None] - self._undamped) / (s[:, None] + self.w1_rad_s), axis=1)

    def missing_rows(self, nu_hz: float, width_hz: float) -> tuple[float, float] | None:
        """None: known everywhere."""
        return None

    def clearing_angle(self, s: complex) -> float:
        """Sum of the angles of the factors."""
        return float(np.sum(np.angle((s - self._undamped) / (s + self.w1_rad_s))))

    def spread_dq(self, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """No errors: (n, 0)."""
        return np.zeros((len(weight), 0), dtype=complex)


def impedance_dq(grid: Grid, s: np.ndarray) -> np.ndarray:
    """Zdq (n, 2, 2) in ohm at complex frequencies ``s`` (n,) in rad/s of the dq frame."""
    return grid.impedance_dq(s)


def impedance_pn(grid: Grid, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zg1 and Zg2 (n,) in ohm at signed frequencies (n,) in Hz; paper eq. 2.

    Of a grid that couples the two they are the reciprocals of its admittances Ygpp and Ygnn.
    """
    if isinstance(grid, OnePort):
        return grid.impedance_pn(f_hz)
    s = 2j * np.pi * (np.asarray(f_hz, dtype=float) - grid.f1_hz)
    y = dq_to_pn(np.linalg.inv(grid.impedance_dq(s)))
    return 1.0 / y[:, 0, 0], 1.0 / y[:, 1, 1]


def own_impedance(grid: Grid, f_hz: float) -> complex:
    """Impedance (ohm) that the grid shows a component at signed frequency ``f_hz`` (Hz), its mirror image aside."""
    z = grid.impedance_dq(np.array([2j * np.pi * (f_hz - grid.f1_hz)]))
    return complex((z[0, 0, 0] + z[0, 1, 1]) / 2.0 + (z[0, 1, 0] - z[0, 0, 1]) / 2.0 * 1j)


def check_fundamental(f1_hz: float, grid: Grid) -> None:
    """Refuse a grid whose reactance is given at another fundamental than the table's."""
    if f1_hz != grid.f1_hz:
        raise SeqsweepError(
            f"the table's fundamental is {f1_hz:g} Hz, the grid's {grid.f1_hz:g} Hz: give the grid at the table's f1"
        )
