"""From a batch of the plan to rows of the table: settle once, branch every shot, solve every point.

`measure` is the worker of a campaign: a pure function of plant and batch. Wrong physics ends as
a status; a plant that raises costs the points that made it raise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from ...identify.admittance import solve_pn
from ...identify.fourier import periodic_window_variance
from ...identify.settling import COND_LIMIT, Settled
from ...identify.uncertainty import propagate, propagate_common, scatter, student_factor
from ...plant.errors import reason_of
from ...plant.protocol import NotSettled, Plant
from ..excitation.frequencies import Frequency
from ..plan import Batch
from .baseline import Baseline, Unsettled, baseline
from .broadband import drive_broadband
from .linearity import compared, covariance_of
from .proof import proven
from .rows import BatchResult, Row, blank_row, failed_batch, with_admittance
from .tones import Driven, drive

DIVERGED_PU = 10.0
"""A response this many times the rated peak has left the small signal for good."""

HEARD_PU = 1e-10
"""Below this part of the rated peak a voltage is what rounding left of the steady state."""

Pair = tuple[Settled, Settled]
"""The two experiments of a point: at f, and at its mirror."""


def measure(plant: Plant, batch: Batch) -> BatchResult:
    """Rows of every point of ``batch``, in its order.

    Parameters
    ----------
    plant : Plant
        The device; `PhasorPlant` is used where it is one.
    batch : Batch
        One operating point, some of its frequencies, and their shots.
    """
    (result,) = measure_together(plant, [batch])
    return result


def measure_together(plant: Plant, batches: Sequence[Batch]) -> list[BatchResult]:
    """`measure` of several batches of one campaign, whose shots fill the lanes of a compiled plant together.

    The result of each is the same to the last bit as that of it alone.
    """
    begun = [_begun(plant, batch) for batch in batches]
    ready = [base for base in begun if isinstance(base, Begun)]
    rows = iter(_rows(plant, ready) if ready else [])
    return [_result(base, next(rows)) if isinstance(base, Begun) else base for base in begun]


class Begun(NamedTuple):
    """A batch whose device stands at its operating point."""

    batch: Batch
    base: Baseline


def _begun(plant: Plant, batch: Batch) -> Begun | BatchResult:
    """The device at the operating point, or the rows that say why it is not there."""
    try:
        return Begun(batch, baseline(plant, batch))
    except NotSettled as refusal:
        return failed_batch(batch, refusal.status, str(refusal))
    except Unsettled as drift:
        return failed_batch(batch, "not_settled", str(drift))
    except Exception as error:
        return failed_batch(batch, "failed", reason_of(error))


def _result(begun: Begun, rows: Sequence[Row]) -> BatchResult:
    return BatchResult(tuple(rows), {"settle_residual": begun.base.change, **begun.base.fundamental})


def _rows(plant: Plant, begun: Sequence[Begun]) -> list[list[Row]]:
    """Rows of every batch: all together, or, where that raises, one by one: a fault costs its own points only."""
    try:
        return _measured(plant, begun)
    except Exception as error:
        if len(begun) > 1:
            return [rows for one in begun for rows in _rows(plant, [one])]
        ((batch, base),) = begun
        if len(batch.points) == 1:
            return [[blank_row(batch, batch.points[0], "failed", reason_of(error))]]
        alone = [Begun(batch.alone(k), base) for k in range(len(batch.points))]
        return [[row for one in alone for rows in _rows(plant, [one]) for row in rows]]


def _measured(plant: Plant, begun: Sequence[Begun]) -> list[list[Row]]:
    if begun[0].batch.plays:
        return [_of_signal(plant, batch, base) for batch, base in begun]
    asked = [Driven(batch, base, [shot for of_point in batch.shots for shot in of_point]) for batch, base in begun]
    return [_of_tones(plant, *one, settled) for one, settled in zip(begun, drive(plant, asked), strict=True)]


def _of_signal(plant: Plant, batch: Batch, base: Baseline) -> list[Row]:
    """Rows of a batch whose points are played together."""
    heard = drive_broadband(plant, batch, base)
    rows = [_row(batch, point, pair, base, plant) for point, pair in zip(batch.points, heard.pairs, strict=True)]
    return [replace(row, linearity=float(x)) for row, x in zip(rows, heard.distortion, strict=True)]


def _of_tones(plant: Plant, batch: Batch, base: Baseline, heard: Sequence[Settled]) -> list[Row]:
    """Rows of a batch from its shots, point after point."""
    settled = iter(heard)
    rows = []
    for point, of_point in zip(batch.points, batch.shots, strict=True):
        pairs = [(next(settled), next(settled)) for _ in of_point[::2]]
        row, *probes = [_row(batch, point, pair, base, plant) for pair in pairs]
        noisy = any(_is_noisy(shot) for pair in pairs for shot in pair)
        for probe in probes:
            row = compared(row, probe, _noise(row, probe) if noisy else 0.0)
        rows.append(row)
    return rows


def _is_noisy(shot: Settled) -> bool:
    """Whether a shot was averaged over windows, and not ended by the agreement of two."""
    return len(shot.v) > 1


def _noise(*rows: Row) -> float:
    """What noise makes of the squared difference between two rows (S^2)."""
    return float(sum(np.trace(covariance_of(row)) for row in rows))


# Solving and judging


def _row(batch: Batch, point: Frequency, pair: Pair, base: Baseline, plant: Plant) -> Row:
    v, i = (np.array([x.mean(axis=0) for x in of]) for of in ([s.v for s in pair], [s.i for s in pair]))
    residual = max(s.residual for s in pair) if _finite(v, i) else nan
    status, reason = _judge_response(batch, point, pair, v, i, plant)
    bound_per_s, lasted_s = proven(batch, point, pair)
    row = replace(
        blank_row(batch, point, status, reason),
        residual=residual if isfinite(residual) else nan,
        growth_bound_per_s=bound_per_s,
        disturbed_s=lasted_s,
    )
    if status not in ("ok", "noisy"):
        return row
    try:
        y, cond_v = solve_pn(v, i, base.phi1)
    except np.linalg.LinAlgError as error:
        return replace(row, status="ill_conditioned", reason=str(error), residual=nan)
    if not cond_v <= COND_LIMIT:
        row = replace(
            row, status="ill_conditioned", reason=f"cond(V) is {cond_v:.2g}: the two experiments are nearly one"
        )
    n_windows = min(len(s.v) for s in pair)
    row = replace(row, cond_v=cond_v, n_periods=row.n_periods * n_windows, window_s=row.window_s * n_windows)
    return with_admittance(row, y, _covariance(batch, point, pair, base, y, v, i))


def _covariance(
    batch: Batch, point: Frequency, pair: Pair, base: Baseline, y: np.ndarray, v: np.ndarray, i: np.ndarray
) -> np.ndarray:
    """Covariance (8, 8) of Y (S^2): of the windows' scatter, or, on a quiet device, of the agreement asked.

    Windows that agree within the tolerance leave an error of that size: a rectangular distribution, whose standard
    deviation is its half-width over sqrt(3), shared by the two components.
    """
    shared = propagate_common(v, _baseline_noise(batch, point, base, y), base.phi1) if base.noisy else 0.0
    if all(_is_noisy(shot) for shot in pair):
        n = min(len(shot.v) for shot in pair)
        noise = _scatter_of_mean(y, np.array([s.v[-n:] for s in pair]), np.array([s.i[-n:] for s in pair]), base)
        return propagate(v, noise, base.phi1) + shared
    each = [
        _scatter_of_mean(y, shot.v[None], shot.i[None], base)
        if _is_noisy(shot)
        else (np.linalg.norm(shot.i) * batch.limits.tolerance) ** 2 / 6.0 * np.eye(2)
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


def _judge_response(
    batch: Batch, point: Frequency, pair: Pair, v: np.ndarray, i: np.ndarray, plant: Plant
) -> tuple[str, str]:
    """Status and reason of what was heard, before it is solved."""
    if not _finite(v, i):
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


def _finite(v: np.ndarray, i: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(v)) and np.all(np.isfinite(i)))
