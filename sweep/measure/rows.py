"""What a batch gives: rows of the table without their operating point, and what was seen on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np

from ...identify.table.format import N_COV, pack_covariance
from ..excitation.frequencies import Frequency
from ..plan import Batch

N_Y = 8
"""Numbers of ``y``."""

UNKNOWN = (nan,) * N_COV

Values = tuple[tuple[float, ...], tuple[float, ...]]
"""``y`` and ``cov`` of a row."""


class Row(NamedTuple):
    """One row of the table, but for its operating point.

    Attributes
    ----------
    f_hz : float
        Frequency (Hz).
    y : tuple of 8 float
        Re, im of pp, pn, np, nn (S); NaN where there is nothing to show.
    cov : tuple of 36 float
        Upper triangle of their covariance (S^2); NaN where unknown.
    status, reason : str
        As in the table.
    amplitude_pu, n_periods, window_s, cond_v, linearity, residual : float
        As in the table.
    growth_bound_per_s, disturbed_s : float
        Fastest growth (1/s) of a mode that the row's shots would not have shown, and for how long (s) they were
        perturbed; NaN where they prove nothing.
    """

    f_hz: float
    y: tuple[float, ...]
    cov: tuple[float, ...]
    status: str
    reason: str
    amplitude_pu: float
    n_periods: float
    window_s: float
    cond_v: float
    linearity: float
    residual: float
    growth_bound_per_s: float = nan
    disturbed_s: float = nan

    @property
    def admittance(self) -> np.ndarray:
        """``y`` as (2, 2) complex (S)."""
        parts = np.array(self.y)
        return (parts[0::2] + 1j * parts[1::2]).reshape(2, 2)


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Rows of a batch and what was seen of its operating point: how still it stood, and its fundamental."""

    rows: tuple[Row, ...]
    condition: dict[str, float]


def blank_row(batch: Batch, point: Frequency, status: str, reason: str) -> Row:
    """A row without a result: what was asked stands, what was measured is NaN."""
    return Row(
        f_hz=point.f_hz,
        y=(nan,) * N_Y,
        cov=UNKNOWN,
        status=status,
        reason=reason,
        amplitude_pu=batch.amplitude_pu,
        n_periods=float(point.n_periods),
        window_s=point.window_blocks * batch.block.duration_s,
        cond_v=nan,
        linearity=nan,
        residual=nan,
    )


def values_of(y: np.ndarray, covariance: np.ndarray) -> Iterator[Values]:
    """``y`` and ``cov`` of rows from admittances (n, 2, 2) in S and covariances (n, 8, 8) in S^2."""
    elements = np.stack([y.real, y.imag], axis=-1).reshape(len(y), 8)
    return zip(map(tuple, elements.tolist()), map(tuple, pack_covariance(covariance).tolist()), strict=True)


def failed_batch(batch: Batch, status: str, reason: str) -> BatchResult:
    """Every point of ``batch`` as a row of ``status`` with the same reason."""
    return BatchResult(tuple(blank_row(batch, point, status, reason) for point in batch.points), {})
