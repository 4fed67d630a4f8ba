"""From a table and a grid to the decision: verdict, margins, poles and the damping gain, worst case included."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ..identify.exclusion import excluded
from ..identify.fit.dq_data import to_dq
from ..identify.fit.model import MIN_POINTS, fit_rows
from ..identify.fit.rational import RationalModel, evaluate_pn
from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError, place_of
from .anchor import Anchor, anchor_of, recounted
from .basis import basis_of
from .gain import FirstGain, first_gain
from .grid_check import check_belongs, grid_warnings
from .grids.in_time import grid_of_fact
from .intervals import margin_interval, scale_interval
from .margins import StableRange, critical_scr, locus_margins, participation, passivity, stable_range
from .poles import unstable_on
from .result import PointTuning, TuningResult
from .rows import Rows, misfits, rows_of
from .siso import Grid, check_fundamental
from .verdict import Stability, judge, swept_band

if TYPE_CHECKING:
    from ..identify.table.read import Table

_FAR_BETTER = 0.5  # part of the median misfit that is left

MOST_SCALE = 1e6
"""Largest multiple of a grid, and over one the smallest: beyond it is a slip."""


def tune(
    table: Table | Sequence[FrequencyResponse],
    grid: Grid | Literal["own"],
    *,
    margin: float = 1.4,
    op_ids: Iterable[str] | None = None,
    scales: Sequence[float] = (1.0,),
) -> TuningResult:
    """Judge every operating point of a table on a grid, or on multiples of it, and propose the damping gain.

    Parameters
    ----------
    table : Table or sequence of FrequencyResponse
        Responses in the pn frame, load direction, one fundamental.
    grid : Grid or "own"
        The grid at the table's fundamental; "own": each operating point on the grid it was swept for.
    margin : float
        Required magnitude margin m at the critical crossing.
    op_ids : iterable of str or None
        Only these operating points; None: all.
    scales : sequence of float
        What the grid is multiplied by.

    Returns
    -------
    TuningResult
        One entry per operating point and scale, in the table's order. What the table cannot answer is "undecided".

    Raises
    ------
    SeqsweepError
        If there is no operating point, or two fundamentals, or not the grid's; if the margin is not positive.
    """
    responses, meta = _opened(table)
    responses = chosen(responses, op_ids)
    swept = _swept_grids(meta)
    grids = [own_grid(r, swept.get(r.meta.get("op_id"))) if grid == "own" else grid for r in responses]
    _check(responses, grids, margin, scales)
    bases = meta.get("bases", {})
    points = tuple(
        replace(_judged(device, on.scaled(scale), margin, bases, swept.get(device.op_id)), scale=scale)
        for device, on in zip(map(fitted, responses), grids, strict=True)
        for scale in scales
    )
    return TuningResult(None if grid == "own" else grid, margin, points, _provenance(meta), tuple(scales))


def own_grid(response: FrequencyResponse, swept: Mapping[str, Any] | None) -> Grid:
    """The grid an operating point was swept for: its own in the campaign, else the one the device was fed through.

    Raises
    ------
    SeqsweepError
        If the table names none.
    """
    known = (response.meta.get("stable_on") or {}).get("grid")
    if swept is not None:
        return grid_of_fact(swept, response.f1_hz)
    if isinstance(known, Mapping):
        return grid_of_fact(known, response.f1_hz)
    raise SeqsweepError(
        f"operating point {response.meta.get('op_id')!r} was swept on an ideal source for no grid in particular: give "
        "--grid R+jX, or sweep it with grid = { r_ohm, x_ohm, voltage_pu } in the operating point"
    )


def tune_point(
    response: FrequencyResponse,
    grid: Grid,
    *,
    margin: float = 1.4,
    bases: Mapping[str, Any] | None = None,
    swept_grid: Mapping[str, Any] | None = None,
) -> PointTuning:
    """Judge one operating point.

    ``bases`` (rated_voltage_v, rated_power_va) give the short-circuit ratio; ``swept_grid`` (r_ohm, x_ohm, scale) is
    the grid whose load flow set |v_pcc| in the sweep, where there was one.
    """
    return _judged(fitted(response), grid, margin, bases or {}, swept_grid)


class Device(NamedTuple):
    """An operating point as it is judged on any grid; ``problem`` says why it cannot be."""

    response: FrequencyResponse
    rows: Rows | None = None
    anchor: Anchor | None = None
    model: RationalModel | None = None
    problem: str = ""

    @property
    def op_id(self) -> str:
        return str(self.response.meta.get("op_id", ""))


def fitted(response: FrequencyResponse, proved: Anchor | None = None) -> Device:
    """Rows, what was proved of the device, and its rational model: what does not depend on the grid.

    ``proved`` is what is known of it by other ways than the facts of its table.
    """
    usable = int(np.sum(response.usable))
    if usable < MIN_POINTS:
        problem = f"{usable} of {len(response)} rows are usable, at least {MIN_POINTS} are needed"
        problem += f"; {response.why_lost}" if response.why_lost else ""
        return Device(response, problem=problem)
    rows = rows_of(to_dq(response))
    anchor = anchor_of(response.meta, rows, response.f1_hz) if proved is None else proved
    anchor, model = _anchored(rows, anchor, response.f1_hz)
    return Device(response, model=model, **basis_of(response, rows, anchor, model)._asdict())


def _anchored(rows: Rows, anchor: Anchor, f1_hz: float) -> tuple[Anchor, RationalModel]:
    """What was proved of the device, and its fit: where they do not agree, the proof with the fit's way around f1."""
    model = fit_rows(rows.data, f1_hz, n_unstable=anchor.n_unstable)
    if not _contradicts(model, anchor):
        return anchor, model
    again = recounted(anchor, rows, model)
    other = model if again.n_unstable == model.n_unstable else fit_rows(rows.data, f1_hz, n_unstable=again.n_unstable)
    if again != anchor and recounted(again, rows, other).n_unstable == again.n_unstable == other.n_unstable:
        anchor, model = again, other
    return _counted_by_fit(rows, anchor, model)


def _counted_by_fit(rows: Rows, anchor: Anchor, model: RationalModel) -> tuple[Anchor, RationalModel]:
    """The count of a fit that nothing holds, where it is stable on the swept grid and describes the rows far better.

    Rows too far apart for the device turn the locus on the swept grid wrongly, and the fit that is held to their
    count is bent.
    """
    if anchor.grid is None or not _contradicts(model, anchor):
        return anchor, model
    free = fit_rows(rows.data, model.f1_hz)
    if len(unstable_on(free, anchor.grid)) or not _describes_better(rows, free, model):
        return anchor, model
    return replace(anchor, n_unstable=free.n_unstable), free


def _contradicts(model: RationalModel, anchor: Anchor) -> bool:
    """Whether the fit has another count than was proved, or is unstable where the device was seen to be stable."""
    return model.n_unstable != anchor.n_unstable or (
        anchor.grid is not None and len(unstable_on(model, anchor.grid)) > 0
    )


def _describes_better(rows: Rows, one: RationalModel, other: RationalModel) -> bool:
    return bool(np.median(misfits(rows.data, one)) < _FAR_BETTER * np.median(misfits(rows.data, other)))


def _judged(
    device: Device, grid: Grid, margin: float, bases: Mapping[str, Any], swept_grid: Mapping[str, Any] | None
) -> PointTuning:
    """The operating point on one grid."""
    response, model = device.response, device.model
    check_belongs(response, bases, grid)
    at = {**response.meta, "grid": swept_grid or response.meta.get("grid")}
    warnings = (*_row_warnings(response), *getattr(grid, "notes", ()), *grid_warnings(at, bases, grid))
    if device.problem or model is None:
        return PointTuning(
            device.op_id, "undecided", device.problem, model=model, warnings=warnings, grid=grid, response=response
        )
    stability = judge(model, grid, device.rows, device.anchor)
    loop = stability.closed_loop
    ends = stable_range(model, grid)
    edge = ends.nearest
    part = None if loop.critical is None else participation(model, grid, complex(loop.poles[loop.critical]))
    gain = FirstGain(None, None if part is None else part.f_hz)
    if part is not None and not ends.averse and not _not_the_formulas(device, stability):
        gain = _gain(model, grid, stability, margin, part.f_hz)
    scr = None
    if edge is not None and {"rated_voltage_v", "rated_power_va"} <= set(bases):
        scr = critical_scr(edge, grid, bases["rated_voltage_v"], bases["rated_power_va"])
    return PointTuning(
        op_id=device.op_id,
        verdict=stability.verdict,
        reason=stability.reason,
        probability=stability.probability,
        model=model,
        stability=stability,
        margins=locus_margins(model, grid, stability.winding.nu_hz),
        margin_interval=None if stability.critical is None else margin_interval(model, grid, stability.critical),
        critical_scale=edge,
        stable_range=ends,
        scale_interval=None if edge is None else scale_interval(model, grid, edge),
        critical_scr=scr,
        passivity=_least_passive(model),
        participation=part,
        k=gain.k,
        f_r_hz=gain.f_r_hz,
        margin_m_predicted=gain.margin_m,
        no_k=_no_k(gain),
        warnings=(*warnings, *model.notes, *stability.remarks, *_gain_warnings(stability, ends, gain)),
        grid=grid,
        response=response,
    )


def _gain(model: RationalModel, grid: Grid, stability: Stability, margin: float, f_r_hz: float) -> FirstGain:
    """k by the formula, set to the resonance; where that does no good, to the mode of the critical crossing."""
    critical = stability.critical
    if critical is None:
        return FirstGain(0.0, f_r_hz)

    def set_to(f_hz: float) -> FirstGain:
        return first_gain(lambda f: evaluate_pn(model, f), grid, critical.m, margin, f_hz, swept_band(model))

    first, elsewhere = set_to(f_r_hz), _mode_of_crossing(model, grid, stability)
    second = set_to(elsewhere) if first.refused and elsewhere is not None else first
    if second.refused or second is first:
        return first
    where = f"damping control is set to {elsewhere:.4g} Hz, the mode of the critical crossing, and not to the resonance"
    return second._replace(note=f"{where}: {first.refused}")


def _mode_of_crossing(model: RationalModel, grid: Grid, stability: Stability) -> float | None:
    """Stronger component (signed, Hz) of the closed-loop mode nearest to the critical crossing; None if there is none.

    Where the resonance is one of the grid's own, m and k speak of another mode.
    """
    loop, critical = stability.closed_loop, stability.critical
    poles = loop.poles[~loop.beyond & (loop.poles.imag > 0.0)]
    if critical is None or not len(poles):
        return None
    nearest = int(np.argmin(np.abs(poles - 2j * np.pi * abs(critical.f_hz - model.f1_hz))))
    return participation(model, grid, complex(poles[nearest])).f_hz


def _no_k(gain: FirstGain) -> str:
    """Why no k is proposed, in a sentence; empty where there is nothing to say."""
    return f"no k is proposed: {gain.refused}; {_CONFIRM}" if gain.refused else ""


_CONFIRM = "tune --confirm looks for a k on an inductance of its own, by sweeping again"


def _not_the_formulas(device: Device, stability: Stability) -> bool:
    """Whether the formula for k says nothing here: its m must fall through one where the loop becomes unstable."""
    own = 0 if device.anchor is None else device.anchor.n_unstable or 0
    return own > 0 or _is_elsewhere(stability)


def _is_elsewhere(stability: Stability) -> bool:
    """Whether the loop is unstable, and not by its critical crossing."""
    critical = stability.critical
    return stability.verdict == "unstable" and (critical is None or critical.m >= 1.0)


def _gain_warnings(stability: Stability, ends: StableRange, gain: FirstGain) -> tuple[str, ...]:
    """Why no k is proposed."""
    critical = stability.critical
    if ends.averse and ends.low is not None:
        below = critical is not None and critical.m < 1.0 and stability.verdict == "stable"
        direction = " m below one counts the other way here." if below else ""
        return (
            "the nearest edge of stability is on the side of strong grids: the loop is unstable on "
            f"{ends.low:.3g} times this grid and less. The formula's k makes a grid look stronger and would bring the "
            f"edge nearer, so that none is proposed; --confirm looks for its sign and size.{direction}",
        )
    if _is_elsewhere(stability):
        return ("the instability is not at the critical crossing: the formula for k does not see it",)
    return tuple(text for text in (_no_k(gain), gain.note) if text)


def _least_passive(model: RationalModel) -> tuple[float, float]:
    index = passivity(model, model.f1_hz + model.nu_hz)
    lowest = int(np.argmin(index.index_s))
    return float(index.index_s[lowest]), float(index.f_hz[lowest])


def _row_warnings(response: FrequencyResponse) -> tuple[str, ...]:
    status, asked = np.asarray(response.status), excluded(response)
    left_out = Counter(status[~response.usable & ~asked].tolist())
    noisy = int(np.sum(response.usable & ~response.ok))
    remarks = []
    if np.any(asked):
        remarks.append(
            f"{np.sum(asked)} of {len(response)} rows, {_bands(response, asked)}, were left out as asked (--exclude)"
        )
    if left_out:
        text = ", ".join(f"{status} {count}" for status, count in sorted(left_out.items()))
        remarks.append(f"{left_out.total()} of {len(response)} rows are not ok and were left out ({text})")
    if noisy:
        remarks.append(f"{noisy} of {len(response)} rows are noisier than the sweep was to accept; they count for less")
    return tuple(remarks)


def _bands(response: FrequencyResponse, rows: np.ndarray) -> str:
    """Stretches of neighbouring rows (n,) bool in words."""
    edges = np.flatnonzero(np.diff(rows.astype(int), prepend=0, append=0))
    ends = [
        (float(response.f_hz[a]), float(response.f_hz[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return ", ".join(f"{low:g} to {high:g} Hz" if high > low else f"{low:g} Hz" for low, high in ends)


def _opened(table: Table | Sequence[FrequencyResponse]) -> tuple[Sequence[FrequencyResponse], Mapping[str, Any]]:
    if isinstance(table, Sequence):
        return table, {}
    return table.responses, table.meta


def chosen(responses: Sequence[FrequencyResponse], op_ids: Iterable[str] | None) -> Sequence[FrequencyResponse]:
    if op_ids is None:
        return responses
    names = [str(response.meta.get("op_id")) for response in responses]
    return [responses[place_of(op_id, names, "the table")] for op_id in op_ids]


def _check(
    responses: Sequence[FrequencyResponse], grids: Sequence[Grid], margin: float, scales: Sequence[float]
) -> None:
    if not responses:
        raise SeqsweepError("the table holds no operating point")
    if not 0.0 < margin < np.inf:
        raise SeqsweepError(f"the required margin m is {margin:g}; needed is a number above 0, such as 1.4")
    fundamentals = sorted({response.f1_hz for response in responses})
    if len(fundamentals) > 1:
        text = ", ".join(f"{f1:g}" for f1 in fundamentals)
        raise SeqsweepError(f"the table holds {len(fundamentals)} fundamentals ({text} Hz): tune them one by one")
    if not scales or not all(1.0 / MOST_SCALE <= scale <= MOST_SCALE for scale in scales):
        text = ", ".join(f"{scale:g}" for scale in scales) or "none"
        raise SeqsweepError(
            f"scales {text}: needed are numbers above 0, from {1.0 / MOST_SCALE:g} to {MOST_SCALE:g}; they multiply "
            "the grid impedance"
        )
    for grid in grids:
        check_fundamental(fundamentals[0], grid)
    for response in responses:
        if response.frame != "pn":
            raise SeqsweepError(f"{response.meta.get('op_id')}: tuning reads the pn frame, given is {response.frame!r}")


def _swept_grids(meta: Mapping[str, Any]) -> dict[Any, Mapping[str, Any]]:
    """The grids the campaign's configuration gives its operating points, by op_id."""
    points = meta.get("configuration", {}).get("operating_point", [])
    return {point.get("id"): point["grid"] for point in points if isinstance(point, Mapping) and point.get("grid")}


def _provenance(meta: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("format", "version", "sha256", "configuration", "configuration_sha256", "plant", "power_meaning", "tool")
    return {key: meta[key] for key in keys if key in meta}
