"""The grid as seen by the device, and the two SISO equivalents of the 2x2 admittance (paper eqs. 2-4)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError

_J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Grid:
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
    def w1_rad_s(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * np.pi * self.f1_hz

    @property
    def size_ohm(self) -> float:
        """|Z| at the fundamental (ohm)."""
        return float(np.hypot(self.r_ohm, self.x_ohm))

    def scaled(self, scale: float) -> Grid:
        """The same grid with R and X multiplied by ``scale``."""
        return replace(self, r_ohm=self.r_ohm * scale, x_ohm=self.x_ohm * scale)


class Siso(NamedTuple):
    """The two SISO equivalents and the grid admittances they are compared with, all (n,) complex in S."""

    f_hz: np.ndarray
    y1: np.ndarray
    y2: np.ndarray
    yg1: np.ndarray
    yg2: np.ndarray


def parse_grid(text: str, f1_hz: float, scale: float = 1.0) -> Grid:
    """Grid from text such as ``0.012+0.25j`` or ``0.012 + j0.25`` (ohm at f1), multiplied by ``scale``."""
    plain = text.replace(" ", "").replace("i", "j")
    try:
        z = complex(re.sub(r"j([\d.]+(?:e[+-]?\d+)?)$", r"\1j", plain, flags=re.IGNORECASE))
    except ValueError:
        raise SeqsweepError(f"grid {text!r} is not R+jX in ohm at f1; write it as 0.012+0.25j") from None
    if not (np.isfinite(scale) and scale > 0.0):
        raise SeqsweepError(f"scale {scale:g} must be positive: it multiplies the grid impedance")
    return Grid(z.real * scale, z.imag * scale, f1_hz)


def impedance_pn(grid: Grid, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zg1 = R + s L and Zg2 = R + (s - 2j w1) L in ohm at frequencies (n,) in Hz; paper eq. 2."""
    w = 2.0 * np.pi * np.asarray(f_hz, dtype=float)
    return grid.r_ohm + 1j * w * grid.l_h, grid.r_ohm + 1j * (w - 2.0 * grid.w1_rad_s) * grid.l_h


def impedance_dq(grid: Grid, s: np.ndarray) -> np.ndarray:
    """Z = (R + s L) 1 + w1 L J in ohm, (n, 2, 2), at complex frequencies (n,) in rad/s of the dq frame."""
    s = np.atleast_1d(np.asarray(s, dtype=complex))
    return (grid.r_ohm + s * grid.l_h)[:, None, None] * np.eye(2) + grid.x_ohm * _J


def siso(f_hz: np.ndarray, y_pn: np.ndarray, grid: Grid) -> Siso:
    """SISO equivalents Y1 and Y2 of a 2x2 admittance on a grid.

    Parameters
    ----------
    f_hz : (n,) float
        Signed frequency of the first component (Hz).
    y_pn : (n, 2, 2) complex
        Sequence admittance (S).
    grid : Grid
        The grid.

    Returns
    -------
    Siso
        Admittances in S; infinite where a lossless grid impedance vanishes (0 and 2 f1).

    Notes
    -----
    Y1 = Ypp - Ypn Ynp / (Ynn + Yg2), paper eq. 3; Y2 = Ynn - Ypn Ynp / (Ypp + Yg1), paper eq. 4. Written with
    impedances, so that a vanishing Zg is no exception.
    """
    z1, z2 = impedance_pn(grid, f_hz)
    coupling = y_pn[:, 0, 1] * y_pn[:, 1, 0]
    with np.errstate(invalid="ignore"):  # rows that failed are NaN
        y1 = y_pn[:, 0, 0] - coupling * z2 / (1.0 + y_pn[:, 1, 1] * z2)
        y2 = y_pn[:, 1, 1] - coupling * z1 / (1.0 + y_pn[:, 0, 0] * z1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Siso(np.asarray(f_hz, dtype=float), y1, y2, 1.0 / z1, 1.0 / z2)


def siso_of_response(response: FrequencyResponse, grid: Grid) -> Siso:
    """SISO equivalents at the table's own frequencies; rows that are not "ok" are NaN.

    Raises
    ------
    SeqsweepError
        If the response is not in the pn frame, or its fundamental is not the grid's.
    """
    if response.frame != "pn":
        raise SeqsweepError(f"SISO equivalents need the pn frame, but the response is in {response.frame!r}")
    check_fundamental(response.f1_hz, grid)
    y = np.where(response.ok[:, None, None], response.y, np.nan)
    return siso(response.f_hz, y, grid)


def check_fundamental(f1_hz: float, grid: Grid) -> None:
    """Refuse a grid whose reactance is given at another fundamental than the table's."""
    if f1_hz != grid.f1_hz:
        raise SeqsweepError(
            f"the table's fundamental is {f1_hz:g} Hz, the grid's {grid.f1_hz:g} Hz: give R + jX at the table's f1"
        )
