"""Do two tables of one device agree within their uncertainty: row by row, band by band.

For rows that both have, the difference d of the eight real numbers of Y is held against the sum C of both covariances:
d^T C^-1 d is chi-squared with eight degrees of freedom if the two differ by noise alone. Rows that only the first table
has are compared with the second one's interpolation, whose own misfit counts as an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..plant.errors import SeqsweepError
from .fit.adaptive import MIN_ROWS, interpolate
from .response import FrequencyResponse

SURE = 0.01
"""Probability of a chi-squared as large by noise alone, below which a band differs."""

SAME = 1e-6
"""Frequencies closer than this, relatively, are one."""

ONE_FUNDAMENTAL = 1e-4
"""Fundamentals closer than this, relatively, are one: that of a recording is measured, and a grid's wanders."""

_QUANTILE = 15.507313
"""95 % quantile of chi-squared with eight degrees of freedom."""

_BANDS_HZ = (0.0, 1.0, 10.0, 50.0, 100.0, 1000.0, np.inf)


class Band(NamedTuple):
    """One band of frequencies.

    Attributes
    ----------
    low_hz, high_hz : float
        The rows found in it, first and last (Hz).
    n_rows : int
        Rows that were compared.
    largest, median : float
        ||dY||_F / ||Y||_F.
    largest_db, largest_deg : float
        Largest difference of an element that counts (a tenth of the largest or more), in dB and in degrees.
    chi_squared_per_degree : float
        About one where noise alone makes the difference; NaN where a table does not say how noisy it is.
    probability : float
        Of a chi-squared as large by noise alone; NaN likewise.
    agrees : bool
        Within the tolerance everywhere, or within the uncertainty.
    """

    low_hz: float
    high_hz: float
    n_rows: int
    largest: float
    median: float
    largest_db: float
    largest_deg: float
    chi_squared_per_degree: float
    probability: float
    agrees: bool


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two operating points compared.

    Attributes
    ----------
    op_a, op_b : str
        Their names.
    f_hz : (n,) float
        Rows that were compared (Hz).
    relative : (n,) float
        ||dY||_F / ||Y||_F.
    interpolated : (n,) bool
        Rows that the second table does not have.
    region : (n,) float
        Radius of the 95 % region of the difference, relative to ||Y||_F, as both tables state their errors; NaN where
        one does not.
    y_a, y_b : (n, 2, 2) complex
        What was compared (S).
    bands : tuple of Band
        By frequency.
    tolerance : float
        Relative difference up to which two rows are the same.
    """

    op_a: str
    op_b: str
    f_hz: np.ndarray
    relative: np.ndarray
    interpolated: np.ndarray
    region: np.ndarray
    y_a: np.ndarray
    y_b: np.ndarray
    bands: tuple[Band, ...]
    tolerance: float

    @property
    def agrees(self) -> bool:
        """Whether every band agrees."""
        return all(band.agrees for band in self.bands)

    def worst(self, n: int = 3) -> list[tuple[float, float]]:
        """Frequency (Hz) and relative difference of the ``n`` worst rows."""
        at = np.argsort(-self.relative)[:n]
        return [(float(self.f_hz[k]), float(self.relative[k])) for k in at]


def compare(a: FrequencyResponse, b: FrequencyResponse, tolerance: float = 1e-4) -> Comparison:
    """Compare two responses at the usable rows of the first.

    Parameters
    ----------
    a, b : FrequencyResponse
        pn frame, one fundamental.
    tolerance : float
        Relative difference up to which two rows are the same whatever their covariances say.

    Raises
    ------
    SeqsweepError
        If the fundamentals differ or no row of the first lies in the band of the second.
    """
    if not one_fundamental(a.f1_hz, b.f1_hz):
        raise SeqsweepError(
            f"the fundamentals are {a.f1_hz:.7g} and {b.f1_hz:.7g} Hz: these are not one device, or not on one grid"
        )
    usable_b = b.f_hz[b.usable]
    if len(usable_b) == 0:
        raise SeqsweepError(f"{b.meta.get('op_id')}: no usable row to compare with")
    rows = a.usable & (a.f_hz >= usable_b[0] * (1.0 - SAME)) & (a.f_hz <= usable_b[-1] * (1.0 + SAME))
    if not np.any(rows):
        raise SeqsweepError("the two tables have no frequencies in common")
    f = a.f_hz[rows]
    y_b, cov_b, interpolated = _at(b, f)
    difference = a.y[rows] - y_b
    size = np.linalg.norm(y_b, axis=(1, 2))
    relative = np.linalg.norm(difference, axis=(1, 2)) / size
    covariance = np.asarray(a.covariance)[rows] + cov_b
    chi = _chi_squared(difference, covariance)
    bands = tuple(
        _band(f[at], a.y[rows][at], y_b[at], relative[at], chi[at], tolerance) for at in _in_bands(f) if np.any(at)
    )
    return Comparison(
        op_a=str(a.meta.get("op_id")),
        op_b=str(b.meta.get("op_id")),
        f_hz=f,
        relative=relative,
        interpolated=interpolated,
        region=np.sqrt(_QUANTILE * np.trace(covariance, axis1=1, axis2=2) / 8.0) / size,
        y_a=a.y[rows],
        y_b=y_b,
        bands=bands,
        tolerance=tolerance,
    )


def one_fundamental(a_hz: float, b_hz: float) -> bool:
    """Whether two fundamentals are one (`ONE_FUNDAMENTAL`)."""
    return abs(a_hz - b_hz) <= ONE_FUNDAMENTAL * a_hz


def _at(b: FrequencyResponse, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Y (n, 2, 2) and covariance (n, 8, 8) of the second table at ``f_hz``, and which rows were interpolated."""
    usable = np.flatnonzero(b.usable)
    nearest = usable[np.abs(b.f_hz[usable][None] - f_hz[:, None]).argmin(axis=1)]
    apart = np.abs(b.f_hz[nearest] - f_hz) > SAME * f_hz
    y, covariance = b.y[nearest].copy(), np.asarray(b.covariance)[nearest].copy()
    if np.any(apart):
        if len(usable) < MIN_ROWS:
            raise SeqsweepError(
                f"the second table has {len(usable)} usable rows, and {MIN_ROWS} are needed to interpolate it at the "
                "frequencies of the first: name the table with more rows second"
            )
        y[apart] = interpolate(b, f_hz[apart])
        own = interpolate(b, b.f_hz[usable])
        misfit = np.linalg.norm(own - b.y[usable], axis=(1, 2)) / np.linalg.norm(b.y[usable], axis=(1, 2))
        size = np.linalg.norm(y[apart], axis=(1, 2))
        extra = (float(np.max(misfit)) * size) ** 2 / 8.0
        covariance[apart] += extra[:, None, None] * np.eye(8)
    return y, covariance, apart


def _chi_squared(difference: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n,) d^T C^-1 d over (re, im) of pp, pn, np, nn; NaN where a covariance is not known."""
    d = np.stack([difference.reshape(-1, 4).real, difference.reshape(-1, 4).imag], axis=2).reshape(-1, 8)
    known = np.isfinite(covariance).all(axis=(1, 2))
    found = np.full(len(d), np.nan)
    for k in np.flatnonzero(known):
        found[k] = d[k] @ np.linalg.pinv(covariance[k], hermitian=True) @ d[k]
    return found


def _in_bands(f_hz: np.ndarray) -> list[np.ndarray]:
    edges = np.array(_BANDS_HZ)
    number = np.searchsorted(edges, f_hz, side="right")
    return [number == k for k in range(1, len(edges))]


def _band(
    f: np.ndarray, y_a: np.ndarray, y_b: np.ndarray, relative: np.ndarray, chi: np.ndarray, tolerance: float
) -> Band:
    from scipy.special import chdtrc

    known = chi[np.isfinite(chi)]
    degrees = 8 * len(known)
    probability = float(chdtrc(degrees, known.sum())) if degrees else float("nan")
    weighty = np.abs(y_b) >= 0.1 * np.abs(y_b).max(axis=(1, 2), keepdims=True)
    ratio = np.where(weighty, y_a / np.where(weighty, y_b, 1.0), 1.0)
    largest = float(relative.max())
    return Band(
        low_hz=float(f[0]),
        high_hz=float(f[-1]),
        n_rows=len(f),
        largest=largest,
        median=float(np.median(relative)),
        largest_db=float(np.abs(20.0 * np.log10(np.abs(ratio))).max()),
        largest_deg=float(np.abs(np.degrees(np.angle(ratio))).max()),
        chi_squared_per_degree=float(known.sum() / degrees) if degrees else float("nan"),
        probability=probability,
        agrees=bool(largest <= tolerance or probability >= SURE),
    )
