"""From a batch of the plan to rows of the table: settle once, branch every shot, solve every point.

`measure` is the worker of a campaign: a pure function of plant and batch. Wrong physics ends as
a status; a plant that raises costs the points that made it raise.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from ...plant.errors import reason_of
from ...plant.protocol import NotSettled, Plant
from ..plan import Batch
from .baseline import Baseline, Unsettled, baseline
from .broadband import drive_broadband
from .linearity import compared, covariance_of
from .points import Heard, is_noisy, rows_of
from .rows import BatchResult, Row, blank_row, failed_batch
from .tones import Driven, drive


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
    begun = _begun(plant, batches)
    ready = [base for base in begun if isinstance(base, Begun)]
    rows = iter(_rows(plant, ready) if ready else [])
    return [_result(base, next(rows)) if isinstance(base, Begun) else base for base in begun]


class Begun(NamedTuple):
    """A batch whose device stands at its operating point."""

    batch: Batch
    base: Baseline


class Refused(NamedTuple):
    """Why the device does not stand at an operating point, as rows say it."""

    status: str
    reason: str


def _begun(plant: Plant, batches: Sequence[Batch]) -> list[Begun | BatchResult]:
    """The device at each batch's operating point, or the rows that say why it is not there.

    Batches of one operating point, whose name no other of the campaign bears, begin from one and the same baseline.
    """
    found: dict[str, Baseline | Refused] = {}
    for batch in batches:
        if batch.condition.op_id not in found:
            found[batch.condition.op_id] = _standing(plant, batch)
    each = [(batch, found[batch.condition.op_id]) for batch in batches]
    return [
        Begun(batch, base) if isinstance(base, Baseline) else failed_batch(batch, base.status, base.reason)
        for batch, base in each
    ]


def _standing(plant: Plant, batch: Batch) -> Baseline | Refused:
    try:
        return baseline(plant, batch)
    except NotSettled as refusal:
        return Refused(refusal.status, str(refusal))
    except Unsettled as drift:
        return Refused("not_settled", str(drift))
    except Exception as error:
        return Refused("failed", reason_of(error))


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
    heard = [shot for settled in drive(plant, asked) for shot in settled]
    pairs = iter(zip(heard[::2], heard[1::2], strict=True))
    points = [
        Heard(batch, point, next(pairs), base)
        for batch, base in begun
        for point, of_point in zip(batch.points, batch.aims, strict=True)
        for _ in of_point[::2]
    ]
    solved = iter(zip(points, rows_of(plant, points), strict=True))
    return [[_of_point(list(islice(solved, len(aims) // 2))) for aims in one.batch.aims] for one in begun]


def _of_signal(plant: Plant, batch: Batch, base: Baseline) -> list[Row]:
    """Rows of a batch whose points are played together."""
    heard = drive_broadband(plant, batch, base)
    points = [Heard(batch, point, pair, base) for point, pair in zip(batch.points, heard.pairs, strict=True)]
    rows = rows_of(plant, points)
    return [row._replace(linearity=float(x)) for row, x in zip(rows, heard.distortion, strict=True)]


def _of_point(solved: Sequence[tuple[Heard, Row]]) -> Row:
    """The row of a point, which its probes at another amplitude say something of."""
    (_, row), *probes = solved
    noisy = any(is_noisy(shot) for heard, _ in solved for shot in heard.pair)
    for _, probe in probes:
        row = compared(row, probe, _noise(row, probe) if noisy else 0.0)
    return row


def _noise(*rows: Row) -> float:
    """What noise makes of the squared difference between two rows (S^2)."""
    return float(sum(np.trace(covariance_of(row)) for row in rows))
