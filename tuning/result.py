"""What tuning found: values, JSON in the format ``seqsweep-tuning``, and a table for the terminal."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import floor, log10
from pathlib import Path
from typing import Any

import numpy as np

from ..identify.fit.rational import RationalModel
from ..identify.uncertainty import NORMAL_95
from ..plant.errors import place_of
from .crossings import Crossing
from .gain import GainSearch
from .intervals import Interval
from .margins import LocusMargins, Participation
from .siso import Grid
from .verdict import Decision, Stability

FORMAT = "seqsweep-tuning"
VERSION = "1.1.0"
SCHEMA = "seqsweep-tuning-1.schema.json"


@dataclass(frozen=True, slots=True)
class PointTuning:
    """One operating point on one grid. What could not be found is None.

    Attributes
    ----------
    op_id : str
        Operating point.
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
        Multiplier of the grid impedance at the edge of stability, and the short-circuit ratio there.
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
    margin_m_predicted : float or None
        m with k if the whole device saw the reshaped voltage; a real one gives less.
    margin_m_with_k : float or None
        m of the device re-swept with damping; None until confirmed.
    reached : bool or None
        Whether the required margin holds when re-swept; None until confirmed.
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
    scale_interval: Interval | None = None
    critical_scr: float | None = None
    passivity: tuple[float, float] | None = None
    participation: Participation | None = None
    k: float | None = None
    f_r_hz: float | None = None
    margin_m_predicted: float | None = None
    margin_m_with_k: float | None = None
    reached: bool | None = None
    warnings: tuple[str, ...] = ()

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
    """Every operating point of a table on one grid.

    Attributes
    ----------
    grid : Grid
        The grid, scale included.
    margin_required : float
        The m that k is made for.
    points : tuple of PointTuning
        In the table's order.
    provenance : mapping
        Where the table came from; tool, grid and required margin are added when written.
    """

    grid: Grid
    margin_required: float
    points: tuple[PointTuning, ...]
    provenance: Mapping[str, Any]

    @property
    def worst(self) -> PointTuning:
        """The operating point in greatest need: unstable before undecided before stable, then by the smallest m."""
        return min(self.points, key=_need)

    def point(self, op_id: str) -> PointTuning:
        """The operating point of that name; `SeqsweepError` where there is none."""
        return self.points[place_of(op_id, [point.op_id for point in self.points], "the tuning result")]

    def __repr__(self) -> str:
        return format_table(self)

    def __getitem__(self, op_id: str) -> PointTuning:
        return self.point(op_id)

    @property
    def verdict(self) -> Decision:
        """ "stable", "unstable" or "undecided": that of the operating point in greatest need."""
        return self.worst.verdict

    @property
    def margin_m(self) -> float | None:
        """m at the critical crossing of the operating point in greatest need."""
        return self.worst.margin_m

    @property
    def k(self) -> float | None:
        """Damping gain of the operating point in greatest need."""
        return self.worst.k

    def plot(self, ax: Any = None) -> Any:
        """Bode, locus and poles of the operating point in greatest need, in matplotlib axes (6,), which are returned.

        ``ax`` says where to draw: such axes, or a single one for the locus.
        """
        from .figures import shown

        return shown(self, ax)


def confirmed(result: TuningResult, op_id: str, search: GainSearch) -> TuningResult:
    """The result with the k and m that re-sweeping with damping gave for one operating point."""
    point = result.point(op_id)
    warnings = point.warnings
    if not search.reached:
        warnings = (
            *warnings,
            f"m = {result.margin_required:g} cannot be reached with damping: the best is m = {search.margin_m:.3g} "
            f"at k = {search.k:.3g}",
        )
    margin = search.margin_m if np.isfinite(search.margin_m) else None
    settled = replace(
        point,
        k=search.k,
        margin_m_predicted=None,  # it belonged to the formula's k
        margin_m_with_k=margin,
        reached=search.reached,
        warnings=warnings,
    )
    return replace(result, points=tuple(settled if p is point else p for p in result.points))


def _need(point: PointTuning) -> tuple[int, float]:
    order = ("unstable", "undecided", "stable")
    return order.index(point.verdict), np.inf if point.margin_m is None else point.margin_m


# JSON --------------------------------------------------------------------------------------------------------------


def to_json(result: TuningResult) -> dict[str, Any]:
    """The result as plain JSON values; the schema is `schema`."""
    from importlib.metadata import version

    grid = result.grid
    return {
        "format": FORMAT,
        "version": VERSION,
        "provenance": {
            "tool": {"name": "seqsweep", "version": version("seqsweep")},
            "grid": grid.described(),
            "margin_required": result.margin_required,
            "table": dict(result.provenance),
        },
        "worst": result.worst.op_id,
        "operating_points": [_point_json(point) for point in result.points],
    }


def write_json(result: TuningResult, path: str | Path) -> None:
    """Write the result as JSON, atomically."""
    from ..identify.files import atomic_file

    text = json.dumps(to_json(result), indent=1, allow_nan=False) + "\n"
    with atomic_file(path) as file:
        file.write(text.encode())


def schema() -> dict[str, Any]:
    """JSON schema of the format, major version 1."""
    from importlib.resources import files

    return json.loads(files(__package__).joinpath("schema", SCHEMA).read_text(encoding="utf-8"))


def _point_json(point: PointTuning) -> dict[str, Any]:
    crossing = point.critical_crossing
    return {
        "op_id": point.op_id,
        "verdict": point.verdict,
        "reason": point.reason,
        "probability": point.probability,
        **_stability_json(point.stability),
        "margin_m": point.margin_m,
        **_interval_json("margin_m", point.margin_interval),
        "critical_crossing_hz": None if crossing is None else crossing.f_hz,
        "resonance_hz": None if point.resonance_hz is None else list(point.resonance_hz),
        "critical_scale": point.critical_scale,
        **_interval_json("critical_scale", point.scale_interval),
        "critical_scr": point.critical_scr,
        "margins": None if point.margins is None else point.margins._asdict(),
        "passivity": None if point.passivity is None else dict(zip(("index_s", "f_hz"), point.passivity, strict=True)),
        "participation": None if point.participation is None else point.participation._asdict(),
        "k": point.k,
        "f_r_hz": point.f_r_hz,
        "margin_m_predicted": point.margin_m_predicted,
        "margin_m_with_k": point.margin_m_with_k,
        "reached": point.reached,
        "fit": _fit_json(point.model),
        "warnings": list(point.warnings),
    }


def _interval_json(name: str, interval: Interval | None) -> dict[str, Any]:
    if interval is None:
        return {f"{name}_std": None, f"{name}_interval": None}
    return {f"{name}_std": interval.std, f"{name}_interval": [interval.low, interval.high]}


def _stability_json(stability: Stability | None) -> dict[str, Any]:
    if stability is None:
        return {"winding": None, "n_open_loop_unstable": None, "poles": [], "bode": None, "extrapolation": None}
    winding = stability.winding
    return {
        "winding": winding.number,
        "n_open_loop_unstable": stability.n_open_loop_unstable,
        "poles": _poles_json(stability),
        "bode": {
            "stable": stability.bode_stable,
            "note": stability.bode_note,
            "crossings": [crossing._asdict() for crossing in stability.crossings],
        },
        "extrapolation": {
            "text": stability.extrapolation,
            "below_deg": winding.inside_deg,
            "above_deg": winding.beyond_deg,
        },
    }


def _poles_json(stability: Stability) -> list[dict[str, Any]]:
    """Upper halves of the pairs, dq frame; "kind" is resonance (the critical one), slow or other."""
    loop = stability.closed_loop
    slow = set(loop.slow.tolist())
    kinds = dict.fromkeys(slow, "slow") | ({loop.critical: "resonance"} if loop.critical is not None else {})
    return [
        {
            "re_rad_s": float(pole.real),
            "im_rad_s": float(pole.imag),
            "re_std_rad_s": float(std.real),
            "im_std_rad_s": float(std.imag),
            "re_im_cov_rad2_s2": float(loop.covariance[k, 0, 1]),
            "f_hz": float(loop.f_hz[k]),
            "damping": float(loop.damping[k]),
            "kind": kinds.get(k, "other"),
        }
        for k, (pole, std) in enumerate(zip(loop.poles, loop.std, strict=True))
    ]


def _fit_json(model: RationalModel | None) -> dict[str, Any] | None:
    if model is None:
        return None
    upper = model.poles.imag >= 0.0
    return {
        "order": model.order,
        "bic": model.bic,
        "residual": model.residual,
        "weighting": model.weighting,
        "poles": [[float(p.real), float(p.imag)] for p in model.poles[upper]],
        "ranks": model.ranks[upper].tolist(),
    }


# The terminal ------------------------------------------------------------------------------------------------------


def format_table(result: TuningResult, width: int = 80) -> str:
    """The result as plain text no wider than ``width``: one line per operating point, then the remarks.

    Columns that do not fit are left out from the right; op, verdict, m and k always stay.
    """
    rows = [_row(point) for point in result.points]
    names = list(rows[0])
    for name in ("P stable", "SCR crit", "m predicted", "damping", "Z crit", "m with k", "resonance Hz"):
        if _table_width(rows, names) > width:
            names.remove(name)
    grid = result.grid
    head = f"Z = {grid.label}, required m = {result.margin_required:g}"
    lines = [*_wrapped(head, width), "", *_aligned(rows, names), ""]
    if any("+-" in row[name] for row in rows for name in names):
        lines += _wrapped("+-: 95 % intervals, from the noise of the table's rows", width)
    lines += _wrapped(f"worst operating point: {result.worst.op_id}", width)
    for point in result.points:
        for remark in _remarks(point):
            lines += _wrapped(f"{point.op_id}: {remark}", width)
    return "\n".join(lines)


def _row(point: PointTuning) -> dict[str, str]:
    loop = None if point.stability is None else point.stability.closed_loop
    damping = None if loop is None or loop.critical is None else 100.0 * float(loop.damping[loop.critical])
    pair = point.resonance_hz
    return {
        "op": point.op_id,
        "verdict": point.verdict,
        "P stable": "-" if point.probability is None else f"{point.probability:.3g}",
        "m": with_doubt(point.margin_m, point.margin_interval),
        "resonance Hz": "-" if pair is None else f"{pair[0]:.2f}/{pair[1]:.2f}",
        "damping": "-" if damping is None else f"{damping:.1f} %",
        "Z crit": "-" if point.critical_scale is None else f"x{with_doubt(point.critical_scale, point.scale_interval)}",
        "SCR crit": _number(point.critical_scr, ".3f"),
        "k": _number(point.k, ".3f"),
        "m predicted": _number(point.margin_m_predicted, ".3f"),
        "m with k": _number(point.margin_m_with_k, ".3f"),
    }


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def with_doubt(value: float | None, interval: Interval | None, digits: int = 3) -> str:
    """``0.98 +- 0.02``: a number and half its 95 % interval, where that shows in so many digits."""
    if value is None or interval is None or NORMAL_95 * interval.std < 0.5 * 10.0**-digits:
        return _number(value, f".{digits}f")
    if interval.high is None:
        return f"{value:.{digits}f} (> {interval.low:.2g})"
    half = (interval.high - interval.low) / 2.0
    digits = min(digits, max(1, -floor(log10(half))))
    return f"{value:.{digits}f} +- {half:.{digits}f}"


def _remarks(point: PointTuning) -> list[str]:
    note = "" if point.stability is None else point.stability.bode_note
    reason = "" if point.verdict == "stable" else f"{point.verdict}, {point.reason}"
    return [text for text in (reason, note, *point.warnings) if text]


def _aligned(rows: list[dict[str, str]], names: list[str]) -> list[str]:
    widths = {name: max(len(name), *(len(row[name]) for row in rows)) for name in names}
    text = ("op", "verdict")
    lines = [{name: name for name in names}, {name: "-" * widths[name] for name in names}, *rows]
    return [
        "  ".join(
            line[name].ljust(widths[name]) if name in text else line[name].rjust(widths[name]) for name in names
        ).rstrip()
        for line in lines
    ]


def _table_width(rows: list[dict[str, str]], names: list[str]) -> int:
    return max(len(line) for line in _aligned(rows, names))


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(width, 20), subsequent_indent="  ")
