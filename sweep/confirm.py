"""The truth behind k: sweep the device again with damping control in place, until the margin holds.

The formula of the paper (eq. 13) treats the whole device as seeing the reshaped voltage, and promises
too much. Here every trial k is a real sweep of the campaign the table came from, with the damping
parameters added to the plant's own; see docs/damping.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError
from ..tuning import gain
from ..tuning.gain import GainSearch, search_gain, search_signed
from ..tuning.result import PointTuning, TuningResult, confirmed, confirmed_signed, defeated
from ..tuning.siso import Grid, SeriesRL
from ..tuning.tune import tune_point
from .config.sections import Config
from .planning import make_plan
from .run.campaign import sweep_in_memory
from .run.host import plant_or_card
from .run.spare import spare_children

Report = Callable[[str], None]
Resweep = Callable[..., PointTuning]
"""(operating point, k[, impedance of its own]) to the device re-swept with damping, judged on its grid."""

OWN_REACTANCE_PU = 0.05
"""What a signed gain of one multiplies, at the resonance."""


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
    todo = [point for point in result.points if point.f_r_hz is not None]
    if not todo:
        raise ConfirmError("nothing to confirm: no operating point has a resonance to set the damping control to")
    swept = _resweeps(config, result.margin_required, jobs, report)
    by_formula = [point for point in todo if _is_the_formulas(point)]
    searches = _common_gain(by_formula, result.margin_required, lambda point, k: measured_margin(swept(point, k)))
    for point in by_formula:
        search = searches[_key(point)]
        if not any(np.isfinite(m) for _, m in search.trials):
            result = defeated(result, point, f"with every k tried {swept(point, search.k).reason}")
        else:
            result = confirmed(result, point, search, swept(point, search.k))
    for point in todo:
        if _needs_a_sign(point):
            result = _signed(result, point, config, swept)
    return result


def _is_the_formulas(point: PointTuning) -> bool:
    """Whether there is a k to begin with, and the grid has an R and an L that it multiplies."""
    return point.k is not None and not _capacitive(point)


def _needs_a_sign(point: PointTuning) -> bool:
    """Whether something is to be damped and the formula says nothing of it."""
    return point.k is None and (point.verdict != "stable" or bool(point.no_k))


def _capacitive(point: PointTuning) -> bool:
    """Whether an entry's grid is capacitive at the frequency that damping control is set to."""
    assert point.grid is not None
    assert point.f_r_hz is not None
    return bool(gain.why_capacitive(point.grid, point.f_r_hz))


def _signed(result: TuningResult, point: PointTuning, config: Config, swept: Resweep) -> TuningResult:
    """The result with a gain of either sign on an impedance of its own, where the paper's formula says nothing."""
    own, refusals = _own_impedance(config, point), []

    def growth_at(k: float) -> float:
        try:
            return growth_of(swept(point, k, own))
        except ConfirmError as refusal:  # of a gain that the device does not take, such as a negative one
            refusals.append(str(refusal))
            return float("inf")

    search = search_signed(growth_at)
    if refusals and not np.isfinite(search.growth_per_s):
        return defeated(result, point, refusals[0])
    return confirmed_signed(result, point, search, own, swept(point, search.k, own))


def growth_of(point: PointTuning) -> float:
    """Largest growth rate (1/s) of a judged loop's mode that decides; infinite where it could not be judged."""
    if point.stability is None or point.verdict == "undecided":
        return float("inf")
    loop = point.stability.closed_loop
    if point.verdict == "unstable":
        return max(float(np.max(loop.poles.real)), 1e-9)
    rates = loop.poles.real if loop.critical is None else loop.poles.real[loop.critical]
    return min(float(np.max(rates)), -1e-9)


def _own_impedance(config: Config, point: PointTuning) -> SeriesRL:
    """A reactance of `OWN_REACTANCE_PU` at the frequency that the damping control is set to."""
    rating = plant_or_card(config).rating
    assert point.f_r_hz is not None
    assert point.grid is not None
    f1_hz = point.grid.f1_hz
    x_ohm = OWN_REACTANCE_PU * rating.voltage_v**2 / rating.power_va
    return SeriesRL(0.0, x_ohm * f1_hz / abs(point.f_r_hz), f1_hz)


def _key(point: PointTuning) -> tuple[str, float]:
    return point.op_id, point.scale


MarginOf = Callable[[PointTuning, float], float]
"""m of an operating point re-swept with a gain."""


def _common_gain(todo: list[PointTuning], required: float, margin_of: MarginOf) -> dict[tuple[str, float], GainSearch]:
    """One k that holds at every point of ``todo``, the neediest first, and each point's margin with it."""
    k = 0.0
    searches: dict[tuple[str, float], GainSearch] = {}
    for point in sorted(todo, key=_need):
        margin = margin_of(point, k) if searches else np.nan
        if not margin >= required:
            start = max(k, point.k or 0.0)
            search = search_gain(lambda gain, point=point: margin_of(point, gain), required, start)  # type: ignore[misc]
            k = max(k, search.k)
            searches[_key(point)] = search
        else:
            searches[_key(point)] = GainSearch(k, margin, True, ((k, margin),))
    return {_key(point): _at(searches[_key(point)], k, point, margin_of, required) for point in todo}


def _at(search: GainSearch, k: float, point: PointTuning, margin_of: MarginOf, required: float) -> GainSearch:
    """The search as it ends at the common k."""
    if search.k == k:
        return search
    margin = margin_of(point, k)
    return GainSearch(k, margin, bool(margin >= required), (*search.trials, (k, margin)))


def _need(point: PointTuning) -> tuple[int, float]:
    order = ("unstable", "undecided", "stable")
    return order.index(point.verdict), np.inf if point.margin_m is None else point.margin_m


def _campaign(configuration: Mapping[str, Any]) -> Config:
    if "plant" not in configuration:
        raise ConfirmError("the table holds no campaign to sweep again: recordings and imports cannot be confirmed")
    return Config.from_dict(configuration)


def _resweeps(config: Config, required: float, jobs: int, report: Report) -> Resweep:
    """An operating point swept with damping gain k and judged on its grid; kept, for a sweep is not asked twice.

    k multiplies the impedance of the grid, or one of its own.
    """
    known: dict[tuple[str, float, float, SeriesRL | None], PointTuning] = {}

    def swept(point: PointTuning, k: float, own: SeriesRL | None = None) -> PointTuning:
        key = (point.op_id, point.scale, k, own)
        if key not in known:
            assert point.grid is not None
            known[key] = judged_with(config, point.op_id, point.grid, k, point.f_r_hz, jobs, required, own)
            at = f" x{point.scale:g}" if point.scale != 1.0 else ""
            gives = f"m = {measured_margin(known[key]):.4f}"
            if own is not None:
                gives = f"{known[key].verdict}, growth {growth_of(known[key]):+.3g} rad/s"
            report(f"{point.op_id}{at}: k = {k:.4f} gives {gives}")
        return known[key]

    return swept


def margin_with(config: Config, op_id: str, grid: Grid, k: float, f_r_hz: float | None, jobs: int) -> float:
    """m of the reshaped device on ``grid``: infinite without a crossing, NaN where it cannot be swept."""
    return measured_margin(judged_with(config, op_id, grid, k, f_r_hz, jobs))


def measured_margin(point: PointTuning) -> float:
    """m of a judged device: infinite without a crossing, NaN where there was nothing to judge."""
    if point.stability is None:
        return float("nan")
    return float("inf") if point.margin_m is None else point.margin_m


def judged_with(
    config: Config,
    op_id: str,
    grid: Grid,
    k: float,
    f_r_hz: float | None,
    jobs: int,
    margin: float = 1.4,
    own: SeriesRL | None = None,
) -> PointTuning:
    """The device swept with damping gain ``k``, judged on ``grid``; "undecided" where half of its rows are not ok.

    ``k`` multiplies ``own``, or the grid if there is none.
    """
    response = sweep_with_damping(config, op_id, own or virtual_impedance(grid, f_r_hz), k, f_r_hz, jobs)
    if np.count_nonzero(response.ok) < len(response) // 2:
        first = next((str(reason) for reason in np.asarray(response.reason) if reason), "")
        reason = f"only {np.count_nonzero(response.ok)} of {len(response)} rows are ok with k = {k:.3g} ({first})"
        return PointTuning(op_id, "undecided", reason, grid=grid)
    return tune_point(response, grid, margin=margin)


def virtual_impedance(grid: Grid | None, f_r_hz: float | None) -> SeriesRL:
    """`gain.virtual_impedance` of a point that has a grid and a resonance; `ConfirmError` where there is none."""
    assert grid is not None
    assert f_r_hz is not None
    try:
        return gain.virtual_impedance(grid, f_r_hz)
    except SeqsweepError as error:
        raise ConfirmError(str(error)) from None


def sweep_with_damping(
    config: Config, op_id: str, grid: SeriesRL, k: float, f_r_hz: float | None, jobs: int
) -> FrequencyResponse:
    """The device of ``config`` at ``op_id``, swept with damping gain ``k`` for ``grid`` (ohm, H) at ``f_r_hz``."""
    data = config.to_dict()
    data["operating_point"] = [point for point in data["operating_point"] if point["id"] == op_id]
    return swept_damped(data, grid, k, f_r_hz, jobs)


def swept_damped(data: dict[str, Any], grid: SeriesRL, k: float, f_r_hz: float | None, jobs: int) -> FrequencyResponse:
    """The campaign ``data`` of one operating point, swept with damping gain ``k`` for ``grid`` at ``f_r_hz``."""
    damping = {
        "damping_gain": k,
        "damping_r_ohm": grid.r_ohm,
        "damping_l_h": grid.l_h,
        "damping_resonance_hz": f_r_hz,
    }
    data["plant"]["parameters"] = {**data["plant"].get("parameters", {}), **damping}
    if data["injection"]["amplitude_pu"] == "auto":  # devices with a measurement port are quiet: the default will do
        data["injection"] = {key: value for key, value in data["injection"].items() if not key.startswith("amplitude")}
    damped = Config.from_dict(data)
    with spare_children():
        try:
            plant = plant_or_card(damped)
        except ValueError as error:
            raise ConfirmError(
                f"{damped.plant.id} cannot be swept with damping control: it offers no measurement port ({error})"
            ) from None
        plan = replace(make_plan(damped, plant), adaptive=None)  # the first round of an adaptive grid will do
        (response,) = sweep_in_memory(plan, plant, jobs=jobs, backend="threading").responses()
    return response
