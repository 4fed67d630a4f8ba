"""Does Y depend on the amplitude? Some points are swept at half of it as well.

Of a cubic nonlinearity a quarter of the error is left at half the amplitude: the spread between the two is three
quarters of the error at the full one. Between two such points the larger spread counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from ...identify.table.format import unpack_covariance
from .rows import Row, with_admittance

ERROR_PER_SPREAD = 4.0 / 3.0
"""Error of Y at the full amplitude over the spread, for a cubic nonlinearity."""

SIGNIFICANT = 9.0
"""A squared spread below so many times what noise makes of it says nothing."""


def compared(row: Row, probe: Row, noise: float) -> Row:
    """``row`` with its linearity, ||Y - Y'||_F / ||Y||_F against the same point at another amplitude.

    ``noise`` (S^2) is what noise alone makes of the squared difference. It is taken off; the linearity is 0 where noise
    explains all of it, and unknown where one of the two rows has no value.
    """
    if not isfinite(row.y[0] + probe.y[0]):
        return row
    y = row.admittance
    squared = float(np.linalg.norm(y - probe.admittance) ** 2)
    spread = squared - noise if squared > SIGNIFICANT * noise else 0.0
    return replace(row, linearity=float(np.sqrt(spread) / np.linalg.norm(y)))


def judged(rows: Sequence[Row], limit: float) -> list[Row]:
    """Rows of one operating point, ascending: probes speak for their neighbours, and what is nonlinear says so.

    Parameters
    ----------
    rows : sequence of Row
        NaN in ``linearity`` where there was no probe.
    limit : float
        Linearity beyond which a row is "nonlinear".

    Returns
    -------
    list of Row
        ``linearity`` filled in, its error in the covariance.
    """
    probed = np.array([k for k, row in enumerate(rows) if isfinite(row.linearity)], dtype=int)
    if not len(probed):
        return list(rows)
    return [_judged(row, max(_neighbours(rows, probed, k)), limit) for k, row in enumerate(rows)]


def _neighbours(rows: Sequence[Row], probed: np.ndarray, k: int) -> list[float]:
    """Linearity at the nearest probes on both sides of row ``k``, or at the row itself."""
    right = int(np.searchsorted(probed, k))
    if right < len(probed) and probed[right] == k:
        return [rows[k].linearity]
    return [rows[p].linearity for p in probed[max(right - 1, 0) : right + 1]]


def _judged(row: Row, linearity: float, limit: float) -> Row:
    if not isfinite(row.y[0]):
        return row
    y = row.admittance
    error = ERROR_PER_SPREAD * linearity * np.linalg.norm(y) / 2.0  # of each complex element
    row = with_admittance(row, y, covariance_of(row) + 0.5 * error**2 * np.eye(8))
    if row.status != "ok" or linearity <= limit:
        return replace(row, linearity=linearity)
    reason = (
        f"the device is not linear at {row.amplitude_pu:g} pu: Y depends on the amplitude by {linearity:.2g} of its "
        f"size, {limit:g} is allowed (sweep.nonlinear_above); take another injection.amplitude_pu"
    )
    return replace(row, linearity=linearity, status="nonlinear", reason=reason)


def covariance_of(row: Row) -> np.ndarray:
    """Covariance (8, 8) of a row (S^2)."""
    return unpack_covariance(np.array(row.cov)[None])[0]
