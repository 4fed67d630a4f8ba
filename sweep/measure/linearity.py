"""Does Y depend on the amplitude? Some points are swept at half of it as well.

Of a cubic nonlinearity a quarter of the error is left at half the amplitude: the spread between the two is three
quarters of the error at the full one. Between two such points the larger spread counts.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np

from ...identify.settling import norms
from ...identify.table.format import unpack_covariance
from .rows import Row, Values, values_of

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
    return row._replace(linearity=float(np.sqrt(spread) / np.linalg.norm(y)))


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
    probed = [k for k, row in enumerate(rows) if isfinite(row.linearity)]
    known = [k for k, row in enumerate(rows) if isfinite(row.y[0])]
    if not probed or not known:
        return list(rows)
    linearity = [max(_neighbours(rows, probed, k)) for k in known]
    found = list(rows)
    for k, x, values in zip(known, linearity, _with_error([rows[k] for k in known], linearity), strict=True):
        found[k] = _judged(rows[k], x, limit, values)
    return found


def _neighbours(rows: Sequence[Row], probed: Sequence[int], k: int) -> list[float]:
    """Linearity at the nearest probes on both sides of row ``k``, or at the row itself."""
    right = bisect_left(probed, k)
    if right < len(probed) and probed[right] == k:
        return [rows[k].linearity]
    return [rows[p].linearity for p in probed[max(right - 1, 0) : right + 1]]


def _with_error(rows: Sequence[Row], linearity: Sequence[float]) -> Iterator[Values]:
    """Values of rows, the error that their ``linearity`` stands for added to the covariance."""
    parts = np.array([row.y for row in rows])
    y = (parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)
    error = ERROR_PER_SPREAD * np.array(linearity) * norms(y.reshape(-1, 4)) / 2.0  # of each complex element
    # Python's power, as of a single row: numpy's square may round otherwise
    variance = np.array([0.5 * x**2 for x in error.tolist()])
    return values_of(y, unpack_covariance(np.array([row.cov for row in rows])) + variance[:, None, None] * np.eye(8))


def _judged(row: Row, linearity: float, limit: float, values: Values) -> Row:
    y, cov = values
    if row.status != "ok" or linearity <= limit:
        return row._replace(y=y, cov=cov, linearity=linearity)
    reason = (
        f"the device is not linear at {row.amplitude_pu:g} pu: Y depends on the amplitude by {linearity:.2g} of its "
        f"size, {limit:g} is allowed (sweep.nonlinear_above); take another injection.amplitude_pu"
    )
    return row._replace(y=y, cov=cov, linearity=linearity, status="nonlinear", reason=reason)


def covariance_of(row: Row) -> np.ndarray:
    """Covariance (8, 8) of a row (S^2)."""
    return unpack_covariance(np.array(row.cov)[None])[0]
