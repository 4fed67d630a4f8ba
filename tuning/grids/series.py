"""The grid everybody starts with: one resistance and one inductance in series."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...plant.errors import SeqsweepError
from ..network.descriptor import Descriptor
from .promise import OnePort

SMALLEST_OHM, LARGEST_OHM = 1e-12, 1e12
"""|R + jX| (ohm at f1) that a typed grid may have: beyond it is a slip, and squares of it leave the numbers."""


@dataclass(frozen=True, slots=True)
class SeriesRL(OnePort):
    """A series R-L grid behind the PCC.

    Attributes
    ----------
    r_ohm : float
        Resistance (ohm), zero allowed.
    x_ohm : float
        Reactance at the fundamental (ohm), positive.
    f1_hz : float
        Fundamental frequency (Hz).

    Raises
    ------
    SeqsweepError
        If R is negative, or X or f1 is not positive.
    """

    r_ohm: float
    x_ohm: float
    f1_hz: float

    def __post_init__(self) -> None:
        finite = np.isfinite([self.r_ohm, self.x_ohm, self.f1_hz]).all()
        if not finite or self.r_ohm < 0.0 or self.x_ohm <= 0.0 or self.f1_hz <= 0.0:
            raise SeqsweepError(
                f"grid {self.r_ohm:g}{self.x_ohm:+g}j ohm at {self.f1_hz:g} Hz: need R >= 0, X > 0 and f1 > 0; "
                "give R + jX in ohm at the fundamental, e.g. 0.012+0.25j"
            )

    @property
    def l_h(self) -> float:
        """Inductance (H)."""
        return self.x_ohm / self.w1_rad_s

    @property
    def label(self) -> str:
        """R + jX."""
        return f"{self.r_ohm:.6g} + j{self.x_ohm:.6g} ohm at {self.f1_hz:g} Hz"

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """R + s L in ohm."""
        return self.r_ohm + np.asarray(s) * self.l_h

    def slope(self, s: np.ndarray) -> np.ndarray:
        """L (ohm s)."""
        return np.full(np.shape(s), self.l_h, dtype=complex)

    @property
    def phase_modes(self) -> np.ndarray:
        """None: an impedance R + s L has no poles."""
        return np.zeros(0, dtype=complex)

    def phase_descriptor(self) -> Descriptor:
        """States (i, v): L i' = -v - R i, and i is the port's current."""
        return Descriptor(
            np.array([[self.l_h, 0.0], [0.0, 0.0]]),
            np.array([[-self.r_ohm, -1.0], [-1.0, 0.0]]),
            np.array([[0.0], [1.0]]),
            np.array([[0.0, 1.0]]),
        )

    def scaled(self, scale: float) -> SeriesRL:
        """The same grid with R and X multiplied by ``scale``."""
        return replace(self, r_ohm=self.r_ohm * scale, x_ohm=self.x_ohm * scale)

    def described(self) -> dict[str, Any]:
        """R, X and f1."""
        return {"kind": "series_rl", "r_ohm": self.r_ohm, "x_ohm": self.x_ohm, "f1_hz": self.f1_hz}


def parse_series(text: str, f1_hz: float, scale: float = 1.0) -> SeriesRL:
    """Grid from text such as ``0.012+0.25j`` or ``0.012 + j0.25`` (ohm at f1), multiplied by ``scale``."""
    plain = text.replace(" ", "").replace("i", "j")
    try:
        z = complex(re.sub(r"j([\d.]+(?:e[+-]?\d+)?)$", r"\1j", plain, flags=re.IGNORECASE))
    except ValueError:
        raise SeqsweepError(f"grid {text!r} is not R+jX in ohm at f1; write it as 0.012+0.25j") from None
    check_scale(scale)
    grid = SeriesRL(z.real * scale, z.imag * scale, f1_hz)
    size_ohm = np.hypot(grid.r_ohm, grid.x_ohm)
    if not SMALLEST_OHM <= size_ohm <= LARGEST_OHM:
        raise SeqsweepError(
            f"grid {text!r}: no grid is so {'large' if size_ohm > LARGEST_OHM else 'small'}; needed is "
            f"|R+jX| from {SMALLEST_OHM:g} to {LARGEST_OHM:g} ohm at f1, such as 0.012+0.25j"
        )
    return grid


def check_scale(scale: float) -> None:
    """Refuse a multiplier that is not positive."""
    if not (np.isfinite(scale) and scale > 0.0):
        raise SeqsweepError(f"scale {scale:g} must be positive: it multiplies the grid impedance")
