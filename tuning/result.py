"""What tuning found: values, and JSON in the format ``seqsweep-tuning``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isclose, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from ..identify.fit.rational import RationalModel
from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError, place_of
from .crossings import Crossing
from .gain import GainSearch, SignedSearch
from .intervals import Interval
from .margins import LocusMargins, Participation, StableRange
from .objections import Decision
from .result_values import fit_json, interval_json, stability_json
from .siso import Grid, SeriesRL
from .verdict import Stability

FORMAT = "seqsweep-tuning"
VERSION = "1.3.0"
SCHEMA = "seqsweep-tuning-1.schema.json"


@dataclass(frozen=True, slots=True)
class PointTuning:
    """One operating point on one grid. What could not be found is None.

    Attributes
    ----------
    op_id : str
        Operating point.
    scale : float
        What the grid was multiplied by.
    grid : Grid or None
        The grid, scale included.
    response : FrequencyResponse or None
        The rows it was judged by.
    verdict, reason : str
        "stable", "unstable" or "undecided", and why.
    probability : float or None
        Probability that the loop is stable.
    model : RationalModel or None
        The fit.
    stability : Stability or None
        Winding, crossings, poles.
    margins : LocusMargins or None
        Gain, phase and vector margin of the winding locus.
    margin_interval : Interval or None
        What is known of the margin m: standard error and 95 % interval.
    critical_scale, critical_scr : float or None
        Multiplier of the grid impedance at the nearest edge of stability, and the short-circuit ratio there.
    stable_range : StableRange or None
        Multipliers between which the loop is stable: both ends.
    scale_interval : Interval or None
        What is known of the critical scale.
    passivity : (float, float) or None
        Smallest passivity index inside the band (S), and the frequency above f1 where it is (Hz).
    participation : Participation or None
        What the resonance mode is made of.
    k : float or None
        Damping gain: by the formula, or the confirmed one.
    f_r_hz : float or None
        Frequency the damping control is set to (Hz).
    no_k : str
        Why the formula's k is not proposed though there is one; empty otherwise.
    margin_m_predicted : float or None
        m with k if the whole device saw the reshaped voltage; a real one gives less.
    margin_m_with_k : float or None
        m of the device re-swept with damping; None until confirmed.
    reached : bool or None
        Whether the required margin holds when re-swept; None until confirmed.
    with_k : PointTuning or None
        The device re-swept with damping, judged on the same grid; None until confirmed.
    impedance : SeriesRL or None
        What k multiplies, where that is an impedance of its own; None: the grid.
    warnings : tuple of str
        What the reader should know.
    """

    op_id: str
    verdict: Decision
    reason: str
    probability: float | None = None
    model: RationalModel | None = None
    stability: Stability | None = None
    margins: LocusMargins | None = None
    margin_interval: Interval | None = None
    critical_scale: float | None = None
    stable_range: StableRange | None = None
    scale_interval: Interval | None = None
    critical_scr: float | None = None
    passivity: tuple[float, float] | None = None
    participation: Participation | None = None
    k: float | None = None
    f_r_hz: float | None = None
    no_k: str = ""
    margin_m_predicted: float | None = None
    margin_m_with_k: float | None = None
    reached: bool | None = None
    with_k: PointTuning | None = None
    impedance: SeriesRL | None = None
    warnings: tuple[str, ...] = ()
    scale: float = 1.0
    grid: Grid | None = None
    response: FrequencyResponse | None = None

    @property
    def margin_m(self) -> float | None:
        """m at the critical crossing; None where there is no crossing or no fit."""
        critical = self.critical_crossing
        return None if critical is None else critical.m

    @property
    def critical_crossing(self) -> Crossing | None:
        """Crossing of Y1 above f1 with the smallest m."""
        return None if self.stability is None else self.stability.critical

    @property
    def resonance_hz(self) -> tuple[float, float] | None:
        """The resonance pair in phase quantities (Hz)."""
        return None if self.stability is None else self.stability.closed_loop.resonance_hz


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class TuningResult:
    """Every operating point of a table on one grid, or on several multiples of it.

    Attributes
    ----------
    grid : Grid or None
        What ``scales`` multiply; None: each operating point's own, the one it was swept for.
    margin_required : float
        The m that k is made for.
    points : tuple of PointTuning
        One per operating point and scale: in the table's order, and within a point in that of ``scales``.
    provenance : mapping
        Where the table came from; tool, grid and required margin are added when written.
    scales : tuple of float
        What the grid was multiplied by.
    """

    grid: Grid | None
    margin_required: float
    points: tuple[PointTuning, ...]
    provenance: Mapping[str, Any]
    scales: tuple[float, ...] = (1.0,)

    @property
    def worst(self) -> PointTuning:
        """The operating point in greatest need: unstable before undecided before stable, then by the smallest m."""
        return min(self.points, key=need)

    @property
    def worst_fitted(self) -> PointTuning | None:
        """The entry in greatest need among those that have a fit, which a picture needs; None where none has."""
        return min((point for point in self.points if point.stability is not None), key=need, default=None)

    def point(self, op_id: str, scale: float | None = None) -> PointTuning:
        """The operating point of that name, at that scale or at its worst; SeqsweepError where there is none."""
        place_of(op_id, list(dict.fromkeys(point.op_id for point in self.points)), "the tuning result")
        named = [point for point in self.points if point.op_id == op_id]
        found = [point for point in named if scale is None or isclose(point.scale, scale, rel_tol=1e-9)]
        if not found:
            known = ", ".join(f"{point.scale:g}" for point in named)
            raise SeqsweepError(f"operating point {op_id!r} was not tuned at scale {scale:g}; its scales are {known}")
        return min(found, key=need)

    def __repr__(self) -> str:
        from .text import format_short

        return format_short(self)

    def _repr_html_(self) -> str:
        from .text import as_html

        return as_html(self)

    def __getitem__(self, op_id: str) -> PointTuning:
        return self.point(op_id)

    @property
    def verdict(self) -> Decision:
        """ "stable", "unstable" or "undecided": that of the entry in greatest need."""
        return self.worst.verdict

    @property
    def margin_m(self) -> float | None:
        """m at the critical crossing of the entry in greatest need."""
        return self.worst.margin_m

    @property
    def k(self) -> float | None:
        """Damping gain of the entry in greatest need."""
        return self.worst.k

    def plot(self, ax: Any = None) -> Any:
        """Bode, locus and poles of the entry in greatest need, in matplotlib axes (6,), which are returned.

        ``ax`` says where to draw: such axes, or a single one for the locus.
        """
        from .figures import shown

        return shown(self, ax)


def confirmed(
    result: TuningResult, point: PointTuning, search: GainSearch, with_k: PointTuning | None = None
) -> TuningResult:
    """The result with what re-sweeping with damping gave for one of its entries: k, m, and the judgement with k."""
    warnings = point.warnings
    if not search.reached:
        warnings = (
            *warnings,
            f"m = {result.margin_required:g} cannot be reached with damping: the best is m = {search.margin_m:.3g} "
            f"at k = {search.k:.3g}",
        )
    settled = replace(
        point,
        k=search.k,
        margin_m_predicted=None,  # it belonged to the formula's k
        margin_m_with_k=search.margin_m if np.isfinite(search.margin_m) else None,
        reached=search.reached,
        with_k=with_k,
        warnings=warnings,
    )
    return replace(result, points=tuple(settled if p is point else p for p in result.points))


def mode_with_k(point: PointTuning) -> int | None:
    """Index of the resonance in the closed loop with damping: the mode nearest to what it was without.

    Its least damped mode need not be it: the notch of the damping control has one of its own at 2 f1.
    """
    if point.with_k is None or point.with_k.stability is None or point.stability is None:
        return None
    before, after = point.stability.closed_loop, point.with_k.stability.closed_loop
    if before.critical is None:
        return after.critical
    apart = np.abs(after.poles - before.poles[before.critical])
    apart = np.where(after.beyond | (after.poles.imag <= 0.0), np.inf, apart)
    return int(np.argmin(apart)) if np.any(np.isfinite(apart)) else None


def confirmed_signed(
    result: TuningResult, point: PointTuning, search: SignedSearch, impedance: SeriesRL, with_k: PointTuning
) -> TuningResult:
    """The result with a signed gain on an impedance of its own, found by re-sweeps, for one of its entries."""
    own = f"{impedance.r_ohm:.4g} + j{impedance.x_ohm:.4g} ohm at f1"
    if search.stable:
        text = f"k = {search.k:g} multiplies an impedance of its own, {own}, and not the grid's"
    else:
        text = f"no gain between -4 and 4 on an impedance of its own, {own}, makes the loop stable"
    settled = replace(
        point,
        k=search.k if search.stable else None,
        impedance=impedance if search.stable else None,
        margin_m_predicted=None,
        margin_m_with_k=with_k.margin_m if search.stable else None,
        reached=search.stable,
        with_k=with_k if search.stable else None,
        warnings=(*point.warnings, text),
    )
    return replace(result, points=tuple(settled if p is point else p for p in result.points))


def defeated(result: TuningResult, point: PointTuning, reason: str) -> TuningResult:
    """The result with no gain for an entry whose device does not bear damping control, and why."""
    settled = replace(
        point,
        k=None,
        margin_m_predicted=None,
        reached=False,
        warnings=(
            *point.warnings,
            f"damping control is refused: {reason}. A controller whose voltage feed-forward passes what it measures "
            "straight to the bridge amplifies the virtual impedance in place of using it",
        ),
    )
    return replace(result, points=tuple(settled if p is point else p for p in result.points))


def need(point: PointTuning) -> tuple[int, float]:
    order = ("unstable", "undecided", "stable")
    return order.index(point.verdict), np.inf if point.margin_m is None else point.margin_m


# JSON --------------------------------------------------------------------------------------------------------------


def to_json(result: TuningResult) -> dict[str, Any]:
    """The result as plain JSON values; the schema is `schema`. Numbers that are not finite are null, with a reason."""
    from importlib.metadata import version

    worst = result.worst
    return {
        "format": FORMAT,
        "version": VERSION,
        "provenance": {
            "tool": {"name": "seqsweep", "version": version("seqsweep")},
            "grid": None if result.points[0].grid is None else result.points[0].grid.described(),
            "scales": list(result.scales),
            "own_grid": result.grid is None,
            "margin_required": result.margin_required,
            "table": dict(result.provenance),
        },
        "worst": worst.op_id,
        "worst_scale": worst.scale,
        "operating_points": [_entry_json(point, result.margin_required) for point in result.points],
    }


def write_json(result: TuningResult, path: str | Path) -> None:
    """Write the result as JSON, atomically."""
    from ..identify.files import write_json as write_whole

    write_whole(path, to_json(result))


def schema() -> dict[str, Any]:
    """JSON schema of the format, major version 1."""
    from importlib.resources import files

    content: dict[str, Any] = json.loads(files(__package__).joinpath("schema", SCHEMA).read_text(encoding="utf-8"))
    return content


def _entry_json(point: PointTuning, required: float) -> dict[str, Any]:
    """One entry: every null has its reason in ``missing``."""
    with_k = None if point.with_k is None else _judgement_json(point.with_k)
    entry = {
        "op_id": point.op_id,
        "scale": point.scale,
        "grid": None if point.grid is None else point.grid.described(),
        **_judgement_json(point),
        "margin_met": None if point.margin_m is None else point.margin_m >= required,
        "critical_scr": point.critical_scr,
        "margins": None if point.margins is None else point.margins._asdict(),
        "passivity": None if point.passivity is None else dict(zip(("index_s", "f_hz"), point.passivity, strict=True)),
        "participation": None if point.participation is None else point.participation._asdict(),
        "k": point.k,
        "k_basis": None if point.k is None else "formula" if point.reached is None else "re-swept",
        "f_r_hz": point.f_r_hz,
        "damping_impedance": None if point.impedance is None else point.impedance.described(),
        "margin_m_predicted": point.margin_m_predicted,
        "margin_m_with_k": point.margin_m_with_k,
        "reached": point.reached,
        "with_k": with_k,
        "fit": fit_json(point.model),
        "warnings": list(point.warnings),
    }
    return {**_finite(entry), "missing": _missing(entry, point)}


def _judgement_json(point: PointTuning) -> dict[str, Any]:
    crossing = point.critical_crossing
    return {
        "verdict": point.verdict,
        "reason": point.reason,
        "probability": point.probability,
        **stability_json(point.stability),
        "margin_m": point.margin_m,
        **interval_json("margin_m", point.margin_interval),
        "critical_crossing_hz": None if crossing is None else crossing.f_hz,
        "resonance_hz": None if point.resonance_hz is None else list(point.resonance_hz),
        "critical_scale": point.critical_scale,
        "stable_scales": None if point.stable_range is None else list(point.stable_range),
        **interval_json("critical_scale", point.scale_interval),
    }


def _finite(value: Any) -> Any:
    """The same values with null for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    if isinstance(value, np.generic):
        return _finite(value.item())
    return None if isinstance(value, float) and not isfinite(value) else value


def _missing(entry: Mapping[str, Any], point: PointTuning) -> dict[str, str]:
    """Why an entry holds nulls, by key: what could not be found, and what has no finite value."""
    absent = {key: _why_none(key, point) for key, value in entry.items() if value is None}
    unbounded = {key: _UNBOUNDED for key, value in entry.items() if not _is_finite(value)}
    open_ended = {
        key: _OPEN_ENDED for key in ("margin_m_interval", "critical_scale_interval") if (entry[key] or [0])[-1] is None
    }
    return {**absent, **unbounded, **open_ended}


def _is_finite(value: Any) -> bool:
    """Whether every number in it is finite."""
    if isinstance(value, Mapping):
        return all(_is_finite(each) for each in value.values())
    if isinstance(value, list | tuple):
        return all(_is_finite(each) for each in value)
    return not isinstance(value, float | np.floating) or isfinite(value)


_UNBOUNDED = "it has no finite value: the noise of the table leaves it without a bound"
_OPEN_ENDED = "no upper end: within the noise the crossing may not exist"
_NO_CROSSING = "Y1 has no 180-degree crossing above f1 inside the swept band"
_NO_RESONANCE = (
    "no oscillating mode inside the swept band is carried by the data, so that there is nothing to set damping control "
    "to"
)
_OF_RESONANCE = ("resonance_hz", "participation", "k", "k_basis", "f_r_hz")
_GAIN = ("k", "k_basis", "margin_m_predicted")
_AVERSE = (
    "the nearest edge is on the side of strong grids, and damping control by the formula makes a grid look stronger: "
    "tune --confirm finds sign and size of k by sweeping again"
)
_NO_EDGE = "no multiple of this grid that was looked at brings the loop to the edge of stability"
_UNCONFIRMED = dict.fromkeys(
    ("margin_m_with_k", "reached", "with_k"), "not confirmed: tune --confirm sweeps the device again with damping"
)
_NO_FORMULA = (
    "the formula does not see an instability that is not at the critical crossing, nor a device with unstable modes of "
    "its own: tune --confirm finds sign and size of k by sweeping again"
)
_NO_GAIN = "no gain that was tried by sweeping again keeps the loop stable: see warnings"
_WHY = {
    **dict.fromkeys(("margin_m", "margin_m_std", "margin_m_interval", "margin_met"), _NO_CROSSING),
    "critical_crossing_hz": _NO_CROSSING,
    **dict.fromkeys(("critical_scale", "critical_scale_std", "critical_scale_interval"), _NO_EDGE),
    "critical_scr": f"{_NO_EDGE}, or the rated values of the table are not known",
    "damping_impedance": "k multiplies the impedance of the grid",
    "margin_m_predicted": "there is no k by the formula, or no crossing is left with it",
}


def _why_none(key: str, point: PointTuning) -> str:
    """The reason for a quantity that is not there."""
    if key in _UNCONFIRMED and point.reached is None:
        return _UNCONFIRMED[key]
    if point.stability is None:
        return point.reason
    if key in _GAIN and point.reached is None and point.stable_range is not None and point.stable_range.averse:
        return _AVERSE
    if key in _GAIN and point.reached is None and point.no_k:
        return point.no_k
    if key in ("k", "k_basis") and point.f_r_hz is not None:
        return _NO_FORMULA if point.reached is None else _NO_GAIN
    if key in _OF_RESONANCE:
        return why_no_resonance(point.stability)
    return _WHY.get(key, "not known for this device and grid")


def why_no_resonance(stability: Stability) -> str:
    """Why no resonance is named."""
    loop = stability.closed_loop
    if loop.withheld is None:
        return _NO_RESONANCE
    below, above = loop.pair_hz(loop.withheld)
    return (
        f"the fit has a mode at {below:.4g}/{above:.4g} Hz, damped by {100.0 * loop.damping[loop.withheld]:.0f} %, but "
        f"beside {stability.verdict!r} it is not sure enough to be named: there is nothing to set damping control to"
    )
