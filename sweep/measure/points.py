"""From the shots of points to their rows: judged, solved, and how well they are known; many points at once."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from ...identify.admittance import solve_each
from ...identify.fourier import periodic_window_variance
from ...identify.settling import COND_LIMIT, Settled, norms
from ...identify.uncertainty import propagate, propagate_common, scatter, student_factor
from ...plant.protocol import Plant
from ..excitation.frequencies import Frequency
from ..plan import Batch
from .baseline import Baseline
from .proof import proven
from .rows import Row, Values, blank_row, values_of

DIVERGED_PU = 10.0
"""A response this many times the rated peak has left the small signal for good."""

HEARD_PU = 1e-10
"""Below this part of the rated peak a voltage is what rounding left of the steady state."""

Pair = tuple[Settled, Settled]
"""The two experiments of a point: at f, and at its mirror."""


class Heard(NamedTuple):
    """A point of a batch and what its two experiments showed, from a baseline."""

    batch: Batch
    point: Frequency
    pair: Pair
    base: Baseline


def rows_of(plant: Plant, heard: Sequence[Heard]) -> list[Row]:
    """The rows of some points, in their order."""
    v, i = _means([s.v for of in heard for s in of.pair]), _means([s.i for of in heard for s in of.pair])
    rows = [
        _judged(of, finite, status, reason)
        for of, finite, (status, reason) in zip(heard, _finite(v, i), _judgements(plant, heard, v, i), strict=True)
    ]
    sound = [k for k, row in enumerate(rows) if row.status in ("ok", "noisy")]
    solved = _solved([heard[k] for k in sound], [rows[k] for k in sound], v[sound], i[sound]) if sound else []
    for k, row in zip(sound, solved, strict=True):
        rows[k] = row
    return rows


def _means(windows: Sequence[np.ndarray]) -> np.ndarray:
    """Means (n, 2, 2) of the windows (n_windows, 2) of each experiment, two for a point."""
    single = all(len(x) == 1 for x in windows)
    # divided, as `mean` does: it decides the sign of a part that is zero
    means = np.concatenate(windows) / 1 if single else np.array([x.mean(axis=0) for x in windows])
    return means.reshape(-1, 2, 2)


def _finite(v: np.ndarray, i: np.ndarray) -> list[bool]:
    finite: list[bool] = (np.isfinite(v) & np.isfinite(i)).all(axis=(1, 2)).tolist()
    return finite


def _judged(heard: Heard, finite: bool, status: str, reason: str) -> Row:
    """The row of a point before it is solved."""
    residual = max(s.residual for s in heard.pair) if finite else nan
    bound_per_s, lasted_s = proven(heard.batch, heard.point, heard.pair)
    return blank_row(heard.batch, heard.point, status, reason)._replace(
        residual=residual if isfinite(residual) else nan,
        growth_bound_per_s=bound_per_s,
        disturbed_s=lasted_s,
    )


def _solved(heard: Sequence[Heard], rows: Sequence[Row], v: np.ndarray, i: np.ndarray) -> list[Row]:
    """Rows of points that can be solved: all together, or, where that fails, one by one."""
    try:
        y, cond_v = solve_each(v, i, np.array([of.base.phi1 for of in heard]))
    except np.linalg.LinAlgError as error:
        if len(heard) == 1:
            return [rows[0]._replace(status="ill_conditioned", reason=str(error), residual=nan)]
        one_by_one = [slice(k, k + 1) for k in range(len(heard))]
        return [row for k in one_by_one for row in _solved(heard[k], rows[k], v[k], i[k])]
    values = values_of(y, _covariances(heard, y, v, i))
    return [_filled(*each) for each in zip(heard, rows, cond_v.tolist(), values, strict=True)]


def _filled(heard: Heard, row: Row, cond_v: float, values: Values) -> Row:
    """The row with its result and what it rests on."""
    n_windows = min(len(s.v) for s in heard.pair)
    y, cov = values
    row = row._replace(
        y=y, cov=cov, cond_v=cond_v, n_periods=row.n_periods * n_windows, window_s=row.window_s * n_windows
    )
    if cond_v <= COND_LIMIT:
        return row
    return row._replace(status="ill_conditioned", reason=f"cond(V) is {cond_v:.2g}: the two experiments are nearly one")


# How well they are known


def is_noisy(shot: Settled) -> bool:
    """Whether a shot was averaged over windows, and not ended by the agreement of two."""
    return len(shot.v) > 1


def _covariances(heard: Sequence[Heard], y: np.ndarray, v: np.ndarray, i: np.ndarray) -> np.ndarray:
    """Covariances (n, 8, 8) of admittances (n, 2, 2)."""
    quiet = np.array([not of.base.noisy and not any(map(is_noisy, of.pair)) for of in heard])
    covariances = np.empty((len(heard), 8, 8))
    covariances[quiet] = _of_quiet([of for of, still in zip(heard, quiet, strict=True) if still], v[quiet], i[quiet])
    for k in np.flatnonzero(~quiet).tolist():
        covariances[k] = _covariance(heard[k], y[k], v[k])
    return covariances


def _of_quiet(heard: Sequence[Heard], v: np.ndarray, i: np.ndarray) -> np.ndarray:
    """Covariances (n, 8, 8) of points whose windows agreed."""
    tolerance = np.array([of.batch.limits.tolerance for of in heard])
    noise = _of_agreement(norms(i), tolerance[:, None])[:, :, None, None] * np.eye(2)
    return propagate(v, noise, np.array([of.base.phi1 for of in heard])) + 0.0  # a zero has no sign


def _of_agreement(size: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Variance of each component of a response of that size (A^2), of which windows agree within a tolerance.

    Windows that agree within the tolerance leave an error of that size: a rectangular distribution, whose standard
    deviation is its half-width over sqrt(3), shared by the two components.
    """
    error = size * tolerance
    # Python's power, as of a single point: numpy's square may round otherwise
    return np.array([x**2 for x in error.ravel().tolist()]).reshape(error.shape) / 6.0


def _covariance(heard: Heard, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Covariance (8, 8) of Y (S^2) where there is noise: of the windows' scatter, or of the agreement asked."""
    batch, point, pair, base = heard
    shared = propagate_common(v, _baseline_noise(batch, point, base, y), base.phi1) if base.noisy else 0.0
    if all(map(is_noisy, pair)):
        n = min(len(shot.v) for shot in pair)
        noise = _scatter_of_mean(y, np.array([s.v[-n:] for s in pair]), np.array([s.i[-n:] for s in pair]), base)
        return propagate(v, noise, base.phi1) + shared
    each = [
        _scatter_of_mean(y, shot.v[None], shot.i[None], base)
        if is_noisy(shot)
        else _of_agreement(norms(shot.i), np.array([batch.limits.tolerance])) * np.eye(2)
        for shot in pair
    ]
    return propagate(v, np.array(each), base.phi1) + shared


def _scatter_of_mean(y: np.ndarray, v: np.ndarray, i: np.ndarray, base: Baseline) -> np.ndarray:
    """E[e e^H] (2, 2) of the mean of windows (experiments, windows, 2), widened (A^2)."""
    noise, freedom = scatter(y, v, i, base.phi1)
    return student_factor(freedom) * noise / v.shape[1]


def _baseline_noise(batch: Batch, point: Frequency, base: Baseline, y: np.ndarray) -> np.ndarray:
    """E[e e^H] (2, 2) of what both experiments of a point owe to the baseline (A^2): nothing off f1's harmonics."""
    window_s = point.window_blocks * batch.block.duration_s
    cycles = [round(f * window_s) for f in (point.f_hz, 2.0 * batch.f1_hz - point.f_hz)]
    of_v, of_i = (
        np.diag([periodic_window_variance(x, n, point.window_blocks) for n in cycles])
        for x in (base.v_variance, base.i_variance)
    )
    return of_i + y @ of_v @ y.conj().T


# What was heard


def _judgements(plant: Plant, heard: Sequence[Heard], v: np.ndarray, i: np.ndarray) -> list[tuple[str, str]]:
    """Status and reason of every point, before it is solved."""
    peak_v, peak_i = plant.rating.peak_voltage_v, plant.rating.peak_current_a
    size_v, size_i = np.abs(v).max(axis=2), np.abs(i).max(axis=(1, 2))
    small = np.maximum(size_i / peak_i, size_v.max(axis=1) / peak_v) <= DIVERGED_PU
    arrived = size_v.min(axis=1) >= HEARD_PU * peak_v
    agreed = np.array([first.agreed and second.agreed for _, _, (first, second), _ in heard])
    return [
        ("ok", "") if fine else _judgement(plant, of, v_of, i_of)
        for fine, of, v_of, i_of in zip(small & arrived & agreed, heard, v, i, strict=True)
    ]


def _judgement(plant: Plant, heard: Heard, v: np.ndarray, i: np.ndarray) -> tuple[str, str]:
    """Status and reason of one point, from what it heard, (2, 2) each."""
    batch, point, pair, _ = heard
    if not (np.isfinite(v).all() and np.isfinite(i).all()):
        return "diverged", "the response is not finite"
    size = max(np.max(np.abs(i)) / plant.rating.peak_current_a, np.max(np.abs(v)) / plant.rating.peak_voltage_v)
    if size > DIVERGED_PU:
        return "diverged", f"the response reaches {size:.2g} times the rated peak"
    if np.min(np.max(np.abs(v), axis=1)) < HEARD_PU * plant.rating.peak_voltage_v:
        return "ill_conditioned", "the perturbation does not arrive: an experiment shows no voltage at its lines"
    worst = max(pair, key=lambda s: (not s.at_rest, s.residual))
    if worst.agreed:
        return "ok", ""
    simulated = (worst.window + 1) * point.window_blocks * batch.block.duration_s
    if worst.at_rest:
        return "noisy", (
            f"the standard error is {worst.residual:.2g} after {simulated:g} s; {batch.limits.uncertainty:g} is asked "
            "(raise injection.amplitude_pu, sweep.max_simulated_s or sweep.uncertainty)"
        )
    if worst.growth > 1.1:
        return "diverged", f"the response grows by a factor {worst.growth:.3g} from window to window"
    return "not_settled", (
        f"successive windows still differ by {worst.residual:.2g} after {simulated:g} s; "
        f"{batch.limits.tolerance:g} is asked (raise sweep.max_simulated_s or sweep.tolerance)"
    )
