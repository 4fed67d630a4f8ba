"""The truth behind k: sweep the device again with damping control in place, until the margin holds.

The formula of the paper (eq. 13) treats the whole device as seeing the reshaped voltage, and promises
too much. Here every trial k is a real sweep of the campaign the table came from, with the damping
parameters added to the plant's own; see `conventions`, Damping control.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..identify.fit.model import fit_response
from ..identify.fit.rational import evaluate_pn
from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError
from ..plant.protocol import Plant
from ..plant.registry import PlantCard
from ..tuning.crossings import bode_crossings, critical_crossing
from ..tuning.gain import GainSearch, search_gain
from ..tuning.result import PointTuning, TuningResult, confirmed
from ..tuning.siso import SeriesRL
from ..tuning.verdict import swept_band
from .config.sections import Config
from .measure.linearity import judged
from .measure.measure import measure
from .measure.rows import BatchResult
from .plan import Plan, make_plan
from .run.campaign import response_of
from .run.host import children, plant_or_card

Report = Callable[[str], None]


class ConfirmError(SeqsweepError):
    """A table whose device cannot be swept again, with the way out."""


def confirm(
    result: TuningResult, configuration: Mapping[str, Any], *, jobs: int, report: Report = lambda text: None
) -> TuningResult:
    """``result`` with k and m as re-sweeping with damping gives them.

    The search runs at the operating point in greatest need; every other one is then swept with that
    k, and searched itself if the margin does not hold there. What is returned holds one k for all.

    Parameters
    ----------
    result : TuningResult
        Verdicts and starting values.
    configuration : mapping
        The campaign in the table's metadata.
    jobs : int
        Threads.
    report : callable
        Called with a line on every trial.

    Raises
    ------
    ConfirmError
        If the table holds no campaign, or its plant offers no damping control.
    """
    config = _campaign(configuration)
    if not isinstance(result.grid, SeriesRL):
        raise ConfirmError(
            "damping control is set by the R and L of a grid; this one is another network: tune on its R+jX at f1"
        )
    todo = [point for point in result.points if point.f_r_hz is not None]
    if not todo:
        raise ConfirmError("nothing to confirm: no operating point has a resonance to set the damping control to")
    margin_of = _margins(config, result.grid, jobs, report)
    searches = _common_gain(todo, result, margin_of)
    for op_id, search in searches.items():
        result = confirmed(result, op_id, search)
    return result


def _common_gain(
    todo: list[PointTuning], result: TuningResult, margin_of: Callable[[PointTuning, float], float]
) -> dict[str, GainSearch]:
    """One k that holds at every point of ``todo``, the neediest first, and each point's margin with it."""
    required, k = result.margin_required, 0.0
    searches: dict[str, GainSearch] = {}
    for point in sorted(todo, key=_need):
        margin = margin_of(point, k) if searches else np.nan
        if not margin >= required:
            start = max(k, point.k or 0.0)
            search = search_gain(lambda gain, point=point: margin_of(point, gain), required, start)  # type: ignore[misc]
            k = max(k, search.k)
            searches[point.op_id] = search
        else:
            searches[point.op_id] = GainSearch(k, margin, True, ((k, margin),))
    return {op_id: _at(search, k, margin_of, result, op_id) for op_id, search in searches.items()}


def _at(
    search: GainSearch, k: float, margin_of: Callable[[PointTuning, float], float], result: TuningResult, op_id: str
) -> GainSearch:
    """The search as it ends at the common k."""
    if search.k == k:
        return search
    margin = margin_of(result.point(op_id), k)
    return GainSearch(k, margin, bool(margin >= result.margin_required), (*search.trials, (k, margin)))


def _need(point: PointTuning) -> tuple[int, float]:
    order = ("unstable", "undecided", "stable")
    return order.index(point.verdict), np.inf if point.margin_m is None else point.margin_m


def _campaign(configuration: Mapping[str, Any]) -> Config:
    if "plant" not in configuration:
        raise ConfirmError("the table holds no campaign to sweep again: recordings and imports cannot be confirmed")
    return Config.from_dict(configuration)


def _margins(config: Config, grid: SeriesRL, jobs: int, report: Report) -> Callable[[PointTuning, float], float]:
    """m at the critical crossing of the device swept with damping gain k; kept, for a sweep is not asked twice."""
    known: dict[tuple[str, float], float] = {}

    def margin_of(point: PointTuning, k: float) -> float:
        if (point.op_id, k) not in known:
            known[point.op_id, k] = margin_with(config, point.op_id, grid, k, point.f_r_hz, jobs)
            report(f"{point.op_id}: k = {k:.4f} gives m = {known[point.op_id, k]:.4f}")
        return known[point.op_id, k]

    return margin_of


def margin_with(config: Config, op_id: str, grid: SeriesRL, k: float, f_r_hz: float | None, jobs: int) -> float:
    """m of the reshaped device on ``grid``: infinite without a crossing, NaN where it cannot be swept."""
    response = sweep_with_damping(config, op_id, grid, k, f_r_hz, jobs)
    if np.count_nonzero(response.ok) < len(response) // 2:
        return float("nan")
    model = fit_response(response)
    crossings = bode_crossings(lambda f: evaluate_pn(model, f), grid, *swept_band(model))
    critical = critical_crossing(crossings, grid.f1_hz)
    return float("inf") if critical is None else critical.m


def sweep_with_damping(
    config: Config, op_id: str, grid: SeriesRL, k: float, f_r_hz: float | None, jobs: int
) -> FrequencyResponse:
    """The device of ``config`` at ``op_id``, swept with damping gain ``k`` for ``grid`` (ohm, H) at ``f_r_hz``."""
    data = config.to_dict()
    damping = {
        "damping_gain": k,
        "damping_r_ohm": grid.r_ohm,
        "damping_l_h": grid.l_h,
        "damping_resonance_hz": f_r_hz,
    }
    data["plant"]["parameters"] = {**data["plant"].get("parameters", {}), **damping}
    if data["injection"]["amplitude_pu"] == "auto":  # devices with a measurement port are quiet: the default will do
        data["injection"] = {key: value for key, value in data["injection"].items() if not key.startswith("amplitude")}
    data["operating_point"] = [point for point in data["operating_point"] if point["id"] == op_id]
    damped = Config.from_dict(data)
    try:
        plant = plant_or_card(damped)
    except ValueError as error:
        raise ConfirmError(
            f"{damped.plant.id} cannot be swept with damping control: it offers no measurement port ({error})"
        ) from None
    plan = make_plan(damped, plant)
    rows = sorted((row for each in _measured(plan, plant, jobs) for row in each.rows), key=lambda row: row.f_hz)
    return response_of(plan, op_id, judged(rows, plan.nonlinear_above))


def _measured(plan: Plan, plant: Plant | PlantCard, jobs: int) -> list[BatchResult]:
    """Every batch in threads that share the plant, or children that hold it."""
    with ThreadPoolExecutor(jobs) as pool:
        if isinstance(plant, PlantCard):
            with children(plan, jobs) as isolated:
                return list(pool.map(isolated.measure, plan.batches()))
        return list(pool.map(lambda batch: measure(plant, plan, batch), plan.batches()))
