"""A plan as people read it: the shots of every point, the totals, the time it will take."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from ...plant.protocol import NotSettled, Plant
from ...plant.registry import PlantCard
from ..excitation.signals import Signal
from ..plan import PROBE_AMPLITUDE, Plan
from ..run.child import ChildFailed
from ..run.wall_time import wall_time_s

CONDITIONS_SHOWN = 12


def plan_text(plan: Plan, plant: Plant | PlantCard, jobs: int) -> str:
    """Every shot of ``plan``, simulated seconds and the wall time expected with ``jobs`` workers."""
    return "\n".join(
        [*_shots(plan), *_further_rounds(plan), "", *_conditions(plan, plant), "", *_totals(plan, plant, jobs)]
    )


def plan_values(plan: Plan, plant: Plant | PlantCard, jobs: int) -> dict[str, Any]:
    """The same as plain values for other programs; the wall time is None where the plant cannot say."""
    wall: float | None
    try:
        wall = wall_time_s(plan, plant, jobs)
    except (NotSettled, ChildFailed):
        wall = None
    return {
        "points": [
            {
                "f_hz": point.f_hz,
                "injected_hz": [point.f_hz, 2.0 * plan.f1_hz - point.f_hz],
                "periods": point.n_periods,
                "window_s": point.window_blocks * plan.block.duration_s,
            }
            for point in plan.points
        ],
        "operating_points": [asdict(condition) for condition in plan.conditions],
        "shots": plan.n_shots,
        "amplitude_pu": plan.amplitude_pu,
        "simulated_s": plan.simulated_s,
        "workers": jobs,
        "wall_s": wall,
    }


def _shots(plan: Plan) -> Iterator[str]:
    if plan.signal is not None:
        yield from _plays(plan, plan.signal)
        return
    yield "every operating point gets these shots, two a point:"
    yield f"{'f (Hz)':>12} {'injected at (Hz)':>28} {'periods':>8} {'window (s)':>11}"
    for point in plan.points:
        injected = ", ".join(f"{shot.injected_hz:+.6g}" for shot in plan.shots_of(plan.conditions[0], point)[:2])
        window_s = point.window_blocks * plan.block.duration_s
        probed = "  and at half" if point.f_hz in plan.probes else ""
        yield f"{point.f_hz:>12.6f} {injected:>28} {point.n_periods:>8} {window_s:>11.3g}{probed}"


def _plays(plan: Plan, signal: Signal) -> Iterator[str]:
    head = (
        f"every operating point gets a {signal.kind} of {signal.period_s:g} s, {len(signal.cycles)} lines, "
        f"crest factor {signal.crest:.2f}, four times: along d and along q, with both signs. Its points:"
    )
    yield from textwrap.wrap(head, 78)
    yield from textwrap.wrap(", ".join(f"{point.f_hz:.6g}" for point in plan.points) + " Hz", 78, initial_indent="  ")


def _further_rounds(plan: Plan) -> Iterator[str]:
    if plan.adaptive is not None:
        yield (
            f"this is the first round of an adaptive grid; further ones follow where the interpolation is unsure, "
            f"until it is certified to {plan.adaptive.tolerance:g} or there are {plan.adaptive.most_points} points; "
            "what follows below is said of the first round"
        )


def _conditions(plan: Plan, plant: Plant | PlantCard) -> Iterator[str]:
    yield f"{len(plan.conditions)} operating point{'s' if len(plan.conditions) > 1 else ''}, source {plan.source.kind}:"
    for condition in plan.conditions[:CONDITIONS_SHOWN]:
        voltage = condition.terminal_voltage_v
        where = f"{voltage / plant.rating.voltage_v:.4g} pu" if voltage else "|v_pcc| from the grid"
        reactive = f"{condition.reactive_power_var / 1e6:.4g} Mvar, " if condition.reactive_power_var else ""
        yield f"  {condition.op_id}: {condition.active_power_w / 1e6:.4g} MW, {reactive}{where}"
    if len(plan.conditions) > CONDITIONS_SHOWN:
        yield f"  ... and {len(plan.conditions) - CONDITIONS_SHOWN} more"


def _totals(plan: Plan, plant: Plant | PlantCard, jobs: int) -> Iterator[str]:
    unit = "V" if plan.kind == "series_voltage" else "A"
    yield f"{plan.n_shots} shots of {plan.amplitude:.4g} {unit} peak ({plan.amplitude_pu:g} pu), {plan.kind}"
    if plan.automatic:
        yield "the amplitude is a limit: a few pilot shots, which are not counted here, find the one below it per band"
    if plan.probes:
        yield f"of these, {2 * len(plan.probes) * len(plan.conditions)} at {PROBE_AMPLITUDE:g} of that, for linearity"
    yield f"about {plan.simulated_s:.4g} simulated s, step {plan.dt_s * 1e6:.4g} us"
    try:
        yield f"about {wall_time_s(plan, plant, jobs):.2g} s with {jobs} worker{'s' if jobs > 1 else ''}"
    except NotSettled as refusal:
        yield f"wall time unknown: the first operating point does not settle: {refusal}"
    except ChildFailed as failure:
        yield f"wall time unknown: {failure}"
