"""Y between the rows of a surrogate: a local rational function from row to row, and how far it may be off.

What the interpolation itself is worth is asked of the rows: each of the two beside a frequency is left out, and told by
the others. That is an interpolation over twice the distance; its error stands for the smaller one, on the safe side.
"""

from __future__ import annotations

import numpy as np

from ..fit.dq_data import DqData
from ..fit.local_rational import between_rows, local_rational
from .region import SurrogateError

LEAST_ROWS = 12
"""Fewest rows that are interpolated between."""


def between(nu_hz: np.ndarray, y: np.ndarray, radius: np.ndarray, at_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Y at frequencies between the rows of one operating point.

    Parameters
    ----------
    nu_hz : (f,) float
        Rows, |f - f1| (Hz), ascending.
    y : (f, 2, 2) complex
        Admittance there (S), dq frame.
    radius : (f,) float
        Radius of its 95 % region (S).
    at_hz : (n,) float
        Where it is asked, |f - f1| (Hz).

    Returns
    -------
    (n, 2, 2) complex, (n,) float
        Y and the radius of its 95 % region: the larger of the two rows', and the interpolation's own error.

    Raises
    ------
    SurrogateError
        If there are too few rows, or a frequency lies outside of them or nearer to f1 than all of them.
    """
    if len(nu_hz) < LEAST_ROWS:
        raise SurrogateError(
            f"{len(nu_hz)} frequencies are too few to interpolate between; needed are {LEAST_ROWS}: ask at those swept"
        )
    outside = (at_hz < nu_hz[0]) | (at_hz > nu_hz[-1])
    if np.any(outside):
        raise SurrogateError(
            f"|f - f1| = {at_hz[outside][0]:g} Hz lies outside of the swept rows, {nu_hz[0]:.4g} to {nu_hz[-1]:.4g} Hz "
            "from f1: nothing is extrapolated"
        )
    right = np.clip(np.searchsorted(nu_hz, at_hz), 1, len(nu_hz) - 1)
    found = between_rows(local_rational(DqData(nu_hz, y, None)), at_hz)
    missed = {int(row): _left_out(nu_hz, y, int(row)) for row in np.unique([right - 1, right])}
    own = np.array([max(missed[int(k) - 1], missed[int(k)]) for k in right]) * np.linalg.norm(found, axis=(1, 2))
    return found, np.hypot(np.maximum(radius[right - 1], radius[right]), own)


def _left_out(nu_hz: np.ndarray, y: np.ndarray, row: int) -> float:
    """How far a row is missed, relatively, by what the others say; at an end its neighbour's error stands for it."""
    row = min(max(row, 1), len(nu_hz) - 2)
    others = np.arange(len(nu_hz)) != row
    told = between_rows(local_rational(DqData(nu_hz[others], y[others], None)), nu_hz[[row]])[0]
    return float(np.linalg.norm(told - y[row]) / np.linalg.norm(y[row]))
