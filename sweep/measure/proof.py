"""What the shots of a sweep prove about the device itself: on its source, nothing that was excited grows.

Every shot disturbs the device and is listened to until it is periodic again. A mode of the device that grew faster than
`identify.settling.growth_bound` would have shown at the end of the shot. That is a fact of the measurement, stored per
operating point as ``stable_on``, from which every verdict starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan, pi
from typing import Any

from ...identify.settling import Settled, growth_bound, shown_by
from ..excitation.frequencies import Frequency
from ..plan import SETTLE_S, Batch, Condition, Plan
from .loadflow import feeding
from .rows import Row


def proven(batch: Batch, point: Frequency, pair: Sequence[Settled]) -> tuple[float, float]:
    """Growth bound (1/s) of a point, the stricter one of its two shots, and how long (s) that shot lasted.

    NaN, NaN unless both shots came to rest.
    """
    window_s = point.window_blocks * batch.block.duration_s
    before_s = SETTLE_S if batch.plays else 0.0
    farthest_rad_s = 2.0 * pi * (batch.limits.highest_hz + point.f_hz + 2.0 * batch.f1_hz)
    lasted = [before_s + (shot.window + 1) * window_s for shot in pair]
    if not all(shot.at_rest for shot in pair):
        return nan, nan
    found = min(
        (growth_bound(*shown_by(shot, window_s), s, farthest_rad_s), s) for shot, s in zip(pair, lasted, strict=True)
    )
    return found if isfinite(found[0]) else (nan, nan)


def stable_on(plan: Plan, condition: Condition, rows: Sequence[Row]) -> dict[str, Any] | None:
    """The fact ``stable_on`` of an operating point: the strictest bound that any of its rows gives.

    None where no shot came to rest, or where one ran away: then the device contradicts itself.
    """
    found = [(row.growth_bound_per_s, row.disturbed_s) for row in rows if isfinite(row.growth_bound_per_s)]
    if not found or any(row.status == "diverged" for row in rows):
        return None
    bound, lasted_s = min(found)
    return {
        "grid": _grid(plan, condition),
        "growth_bound_per_s": bound,
        "disturbed_s": lasted_s,
        "basis": "shots",
    }


def _grid(plan: Plan, condition: Condition) -> str | dict[str, Any]:
    source = feeding(plan.source, condition)
    if source.kind == "ideal":
        return "ideal"
    if source.circuit is None:
        return {"r_ohm": source.r_ohm, "x_ohm": 2.0 * pi * plan.f1_hz * source.l_h}
    z = source.circuit.seen_at(2j * pi * plan.f1_hz)[0]
    return {"r_ohm": z.real, "x_ohm": z.imag, **_elements(plan, condition)}


def _elements(plan: Plan, condition: Condition) -> dict[str, Any]:
    """The document behind a circuit, and what its impedance was multiplied with."""
    if condition.grid is not None:
        return {"elements": condition.grid.document, "scale": condition.grid.scale}
    section = plan.configuration["source"]["grid"]
    return {"elements": section["elements"], "scale": section["scale"]}
