"""The other judge: the turns of det(1 + Y Z) from the rows themselves, no fit and no pole in between.

Between the rows Y is interpolated locally (`identify.fit.local_rational`). Where the device was proved stable on an
ideal source, unstable modes = - turns; behind a grid Z0, unstable modes = - (turns on Z - turns on Z0): the device's
own unstable poles, whatever they are, turn both alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..identify.fit.dq_data import DqData
from ..identify.fit.local_rational import LocalRational, between_rows, local_rational, sharpness
from ..identify.fit.rational import RationalModel, evaluate
from .feeding import Hole
from .siso import Grid
from .winding import Band, Winding, closed_locus, wound

_PER_INTERVAL = np.array([0.25, 0.5, 0.75])  # where the locus is looked at first between two rows
_SAME = 1e-12  # relative difference of frequencies that are one
_NOISE = 4.0  # loci that differ by less than so many standard errors of the rows do not contradict each other


class Rows(NamedTuple):
    """The rows of one operating point: folded to positive frequency, the way between them, and those left out."""

    data: DqData
    local: LocalRational
    left_out: DqData | None = None


class Difference(NamedTuple):
    """Where the rows' locus and the fit's are the furthest apart, relative to the fit's.

    Attributes
    ----------
    nu_hz : float
        |f - f1| (Hz).
    relative : float
        |difference| / |locus of the fit|.
    in_noise : bool
        Whether noise of the rows explains it.
    """

    nu_hz: float
    relative: float
    in_noise: bool


def rows_of(data: DqData) -> Rows:
    """Rows ready to be judged."""
    return Rows(data, local_rational(data))


def misfits(data: DqData, model: RationalModel) -> np.ndarray:
    """||Yfit - Y||_F / ||Y||_F (n,) of the rows."""
    error = np.linalg.norm(evaluate(model, 2j * np.pi * data.nu_hz) - data.y, axis=(1, 2))
    return np.asarray(error / np.linalg.norm(data.y, axis=(1, 2)))


def believed(rows: Rows, model: RationalModel) -> Rows:
    """The rows without those that the fit left out for disagreeing with their neighbours."""
    data = rows.data
    if len(data.nu_hz) == len(model.nu_hz):
        return rows
    kept = _kept(data, model)
    return rows_of(_some(data, kept))._replace(left_out=_some(data, ~kept))


def _kept(data: DqData, model: RationalModel) -> np.ndarray:
    """(n,) bool: the rows of the fit, of several at one place those that it meets best."""
    tolerance = _SAME * data.nu_hz
    fitted = np.sum(np.abs(data.nu_hz[:, None] - model.nu_hz) < tolerance[:, None], axis=1)
    alike = np.abs(data.nu_hz[:, None] - data.nu_hz) < tolerance[:, None]
    kept = np.ones(len(data.nu_hz), dtype=bool)
    for row in np.argsort(-misfits(data, model)):
        kept[row] = np.count_nonzero(kept & alike[row]) <= fitted[row]
    return kept


def _some(data: DqData, chosen: np.ndarray) -> DqData:
    std = None if data.std is None else data.std[chosen]
    covariance = None if data.covariance is None else data.covariance[chosen]
    return DqData(data.nu_hz[chosen], data.y[chosen], std, covariance)


def wind_rows(rows: Rows, grid: Grid, around_f1: RationalModel | None = None, hole: Hole | None = None) -> Winding:
    """Winding of det(1 + Y Z) from row to row.

    Between f1 and the lowest |f - f1| there are no rows to follow: there the way is that of ``around_f1``, which has
    an error of its own, or the straight one between the mirror images. In a ``hole`` that feeds nothing the gain falls
    off.
    """
    band = _band(rows, 0.0 if hole is None else hole.start_hz)
    return wound(lambda at: _followed(rows, around_f1, at), grid, band, _places(rows.local.nu_hz))


def _band(rows: Rows, start_hz: float) -> Band:
    return Band(start_hz, float(rows.local.nu_hz[0]), float(rows.local.nu_hz[-1]))


def _followed(rows: Rows, around_f1: RationalModel | None, nu_hz: np.ndarray) -> np.ndarray:
    """Ydq (n, 2, 2) from row to row."""
    y = between_rows(rows.local, nu_hz)
    gap = nu_hz < rows.local.nu_hz[0]
    if around_f1 is not None and np.any(gap):
        y[gap] = evaluate(around_f1, 2j * np.pi * nu_hz[gap])
    return y


def _places(nu_hz: np.ndarray) -> np.ndarray:
    """Rows, and places between them (Hz)."""
    edges = np.append(0.0, nu_hz)
    between = edges[:-1, None] + np.diff(edges)[:, None] * _PER_INTERVAL
    return np.unique(np.concatenate([nu_hz, between.ravel()]))


def difference(rows: Rows, model: RationalModel, grid: Grid) -> Difference:
    """The place where rows and fit disagree most about det(1 + Y Z), from the first row to the last."""
    nu = rows.local.nu_hz
    at = _places(nu)
    at = at[at >= nu[0]]
    band = _band(rows, 0.0)
    by_rows = closed_locus(lambda f: between_rows(rows.local, f), grid, band)(at)
    by_fit = closed_locus(lambda f: evaluate(model, 2j * np.pi * f), grid, band)(at)
    apart = np.abs(by_rows - by_fit)
    noise = _noise_of_locus(rows.data, model, grid, at) * sharpness(rows.local, at)
    excess = np.where(apart > _NOISE * noise, apart / np.abs(by_fit), 0.0)
    relative = apart / np.abs(by_fit)
    k = int(np.argmax(excess if np.any(excess > 0.5) else relative))
    return Difference(float(at[k]), float(relative[k]), bool(apart[k] <= _NOISE * noise[k]))


def _noise_of_locus(data: DqData, model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> np.ndarray:
    """Standard error (n,) of det(1 + Y Z) at ``nu_hz`` if Y is known as well as the nearest rows know it."""
    s = 2j * np.pi * nu_hz
    z = grid.impedance_dq(s)
    loop = np.eye(2) + evaluate(model, s) @ z
    adjugate = np.stack([loop[:, 1, 1], -loop[:, 0, 1], -loop[:, 1, 0], loop[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    weight = np.swapaxes(z @ adjugate, 1, 2).reshape(-1, 4)
    std = row_std(data, model)
    nearest = np.array([np.interp(nu_hz, data.nu_hz, column) for column in std.T]).T
    clearing = np.abs(grid.clearing(s))
    return np.sqrt(2.0) * np.linalg.norm(weight * nearest, axis=1) * clearing


def row_std(data: DqData, model: RationalModel) -> np.ndarray:
    """Standard deviations (n, 4) of the rows' numbers: as stated, or what the fit leaves of them."""
    left = np.abs(data.y - evaluate(model, 2j * np.pi * data.nu_hz)).reshape(-1, 4) / np.sqrt(2.0)
    left = np.sqrt(np.apply_along_axis(_smoothed, 0, left**2))
    return left if data.std is None else np.maximum(left, data.std.reshape(-1, 4))


def _smoothed(variance: np.ndarray) -> np.ndarray:
    """Mean over the nine rows around each."""
    window = np.ones(min(9, len(variance)))
    return np.convolve(variance, window, "same") / np.convolve(np.ones(len(variance)), window, "same")
