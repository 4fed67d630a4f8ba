"""The grid as seen by the device, and the two SISO equivalents of the 2x2 admittance (paper eqs. 2-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..identify.frames import dq_to_pn
from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError
from .grids.promise import Grid, Impedance, check_fundamental, impedance_dq, impedance_pn, own_impedance
from .grids.series import SeriesRL
from .grids.series import parse_series as parse_grid

__all__ = [
    "Grid",
    "Impedance",
    "SeriesRL",
    "Siso",
    "check_fundamental",
    "impedance_dq",
    "impedance_pn",
    "own_impedance",
    "parse_grid",
    "siso",
    "siso_of_response",
]


class Siso(NamedTuple):
    """The two SISO equivalents and the grid admittances they are compared with, all (n,) complex in S."""

    f_hz: np.ndarray
    y1: np.ndarray
    y2: np.ndarray
    yg1: np.ndarray
    yg2: np.ndarray


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
    impedances, so that a vanishing Zg is no exception. A grid that couples the two has a matrix Yg: its elements off
    the diagonal then join those of the device.
    """
    if grid.couples:
        return _siso_of_matrix(f_hz, y_pn, grid)
    z1, z2 = impedance_pn(grid, f_hz)
    coupling = y_pn[:, 0, 1] * y_pn[:, 1, 0]
    with np.errstate(invalid="ignore"):  # rows that failed are NaN
        y1 = y_pn[:, 0, 0] - coupling * z2 / (1.0 + y_pn[:, 1, 1] * z2)
        y2 = y_pn[:, 1, 1] - coupling * z1 / (1.0 + y_pn[:, 0, 0] * z1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Siso(np.asarray(f_hz, dtype=float), y1, y2, 1.0 / z1, 1.0 / z2)


def _siso_of_matrix(f_hz: np.ndarray, y_pn: np.ndarray, grid: Grid) -> Siso:
    """As `siso`, of a grid whose admittance is a matrix: Y1 = Ypp - (Ypn + Ygpn)(Ynp + Ygnp)/(Ynn + Ygnn)."""
    s = 2j * np.pi * (np.asarray(f_hz, dtype=float) - grid.f1_hz)
    y_grid = dq_to_pn(np.linalg.inv(grid.impedance_dq(s)))
    both = y_pn + y_grid
    coupling = both[:, 0, 1] * both[:, 1, 0]
    return Siso(
        np.asarray(f_hz, dtype=float),
        y_pn[:, 0, 0] - coupling / both[:, 1, 1],
        y_pn[:, 1, 1] - coupling / both[:, 0, 0],
        y_grid[:, 0, 0],
        y_grid[:, 1, 1],
    )


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
