"""A tuning result as plain text: one line per operating point and scale, then what the reader should know or do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import floor, log10

from ..identify.uncertainty import NORMAL_95
from ..identify.views.html import MOST, html_table
from .intervals import Interval
from .layout import fitted_table, left_out, wrapped
from .result import PointTuning, TuningResult, mode_with_k, need, why_no_resonance

CERTAIN = 0.999
"""A verdict with this probability, or as improbable as the rest, is called certain."""

NAMED = 4
"""Operating points that a note names before it counts the others."""

_DROPPED_FIRST = ("SCR crit", "m predicted", "damping", "Z crit", "m with k", "resonance Hz")


def format_table(result: TuningResult, width: int = 80) -> str:
    """The result as plain text no wider than ``width``.

    Columns that do not fit are left out in the order of `_DROPPED_FIRST`, and a line says which.
    """
    rows = [_row(point, result) for point in result.points]
    table = fitted_table(rows, width, _DROPPED_FIRST)
    remarks = (
        *_legend(rows, table.names, result),
        *left_out(table.dropped, "-o TUNING.json"),
        *grouped(_remarks(result)),
    )
    lines = [*wrapped(_head(result), width), "", *table.lines, ""]
    for remark in remarks:
        lines += wrapped(remark, width)
    return "\n".join(lines)


def format_short(result: TuningResult, width: int = 80) -> str:
    """`format_table` of the entries in greatest need, where there are many."""
    left = len(result.points) - MOST
    if left <= 0:
        return format_table(result, width)
    return f"{format_table(_neediest(result), width)}\n... and {left} more entries that are in less need"


def as_html(result: TuningResult) -> str:
    """The entries in greatest need as a small HTML table, for a notebook."""
    shown = _neediest(result).points if len(result.points) > MOST else result.points
    rows = [_row(point, result) for point in shown]
    heads = [name for name in (rows[0] if rows else {}) if any(row[name].strip("- ") for row in rows)]
    return html_table(_head(result), heads, [[row[name] for name in heads] for row in rows], len(result.points))


def _neediest(result: TuningResult) -> TuningResult:
    return replace(result, points=tuple(sorted(result.points, key=need)[:MOST]))


def _head(result: TuningResult) -> str:
    if result.grid is None:
        where = "each operating point on the grid it was swept for"
    elif result.scales == (1.0,):
        where = f"Z = {result.grid.label}"
    else:
        factors = ", ".join(f"{scale:g}" for scale in result.scales)
        where = f"Z = {factors} times {result.grid.label}"
    return f"{where}, required m = {result.margin_required:g}"


def _row(point: PointTuning, result: TuningResult) -> dict[str, str]:
    loop = None if point.stability is None else point.stability.closed_loop
    damping = None if loop is None or loop.critical is None else 100.0 * float(loop.damping[loop.critical])
    pair = point.resonance_hz
    return {
        "op": point.op_id,
        "scale": f"{point.scale:g}" if len(result.scales) > 1 else "",
        "verdict": point.verdict,
        "P stable": _probability(point.probability),
        "m": with_doubt(point.margin_m, point.margin_interval),
        f"m >= {result.margin_required:g}": _met(point.margin_m, result.margin_required),
        "resonance Hz": "-" if pair is None else _pair_text(*pair),
        "damping": "-" if damping is None else f"{damping:.1f} %",
        "Z crit": _edges(point),
        "SCR crit": _number(point.critical_scr, ".3f"),
        "k": _number(point.k, ".3f") + ("*" if _is_first_value(point) else ""),
        "m predicted": "" if point.margin_m_predicted is None else f"{point.margin_m_predicted:.3f}",
        "m with k": _number(point.margin_m_with_k, ".3f") if point.reached is not None else "",
        "with k": "" if point.with_k is None else point.with_k.verdict,
    }


def _pair_text(below_hz: float, above_hz: float) -> str:
    """Both components of a mode; one that rounds to zero has no sign."""
    below = f"{below_hz:.2f}"
    return f"{'0.00' if below == '-0.00' else below}/{above_hz:.2f}"


def _edges(point: PointTuning) -> str:
    """Multiples of the grid at the edge: the upper end, ``>`` and the lower one, or both; the nearest with doubt."""
    if point.critical_scale is None:
        return "-"
    nearest = f"x{with_doubt(point.critical_scale, point.scale_interval)}"
    if point.stable_range is None or point.stable_range.low is None:
        return nearest
    low, high = point.stable_range
    if high is None:
        return f"> {nearest}"
    return f"{nearest} to x{high:.3f}" if point.stable_range.averse else f"x{low:.3f} to {nearest}"


def _probability(probability: float | None) -> str:
    """The probability of being stable where it is not certain; a blank says that it is."""
    if probability is None:
        return "-"
    return "" if not 1.0 - CERTAIN < probability < CERTAIN else f"{probability:.3g}"


def _met(margin_m: float | None, required: float) -> str:
    if margin_m is None:
        return "-"
    return "yes" if margin_m >= required else "no"


def _is_first_value(point: PointTuning) -> bool:
    return bool(point.k) and point.reached is None


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


# Below the table -----------------------------------------------------------------------------------------------------


def _legend(rows: Sequence[dict[str, str]], names: Sequence[str], result: TuningResult) -> Iterable[str]:
    """What the signs in the table mean, as far as they are there."""
    if any("+-" in row[name] for row in rows for name in names):
        yield "+-: 95 % intervals, from the noise of the table's rows"
    if any(row["P stable"] not in ("", "-") for row in rows):
        yield f"P stable: probability of being stable; a blank is a certain verdict (beyond {CERTAIN:g})"
    if any(_is_first_value(point) for point in result.points):
        yield "*: first value by the formula; --confirm sweeps the device again with damping control and settles it"
    if any(row["Z crit"].startswith(">") or " to " in row["Z crit"] for row in rows) and "Z crit" in names:
        yield "Z crit: > x is a lower end, the loop is stable on larger multiples of the grid, not on smaller ones"
    if len(result.points) > 1:
        worst = result.worst
        at = f" at scale {worst.scale:g}" if len(result.scales) > 1 else ""
        yield f"worst operating point: {worst.op_id}{at}"


def _remarks(result: TuningResult) -> Iterable[tuple[str, str]]:
    """Every remark with the name of its entry."""
    several = len(result.scales) > 1
    for point in result.points:
        name = f"{point.op_id} x{point.scale:g}" if several else point.op_id
        reason = "" if point.verdict == "stable" else f"{point.verdict}, {point.reason}"
        note = "" if point.stability is None else point.stability.bode_note
        for text in (reason, note, *point.warnings, *_dashes(point), *_with_k(point)):
            if text:
                yield name, text


def _dashes(point: PointTuning) -> Iterable[str]:
    """Why there is no resonance and no k; what was not fitted has its reason already."""
    if point.stability is not None and point.resonance_hz is None:
        yield f"no resonance: {why_no_resonance(point.stability)} (k: -)"


def _with_k(point: PointTuning) -> Iterable[str]:
    """What becomes of the resonance with damping control in place."""
    mode = mode_with_k(point)
    if point.with_k is None:
        return
    if mode is None or point.with_k.stability is None:
        yield f"with k = {point.k:.3f} in place: {point.with_k.verdict}, {point.with_k.reason}"
        return
    loop = point.with_k.stability.closed_loop
    below, above = loop.f1_hz - loop.f_hz[mode], loop.f1_hz + loop.f_hz[mode]
    yield (
        f"with k = {point.k:.3f} in place: {point.with_k.verdict}; the resonance is at {below:.2f}/{above:.2f} Hz, "
        f"{loop.poles[mode].real:+.3g} rad/s, damping {100.0 * loop.damping[mode]:.1f} %"
    )


def grouped(remarks: Iterable[tuple[str, str]]) -> list[str]:
    """Remarks that differ in their numbers alone become one: it names their entries, and shows the first one's text."""
    groups: dict[str, tuple[str, list[str], set[str]]] = {}
    for name, text in remarks:
        _, names, texts = groups.setdefault(re.sub(r"\d+(\.\d+)?(e[+-]?\d+)?", "#", text), (text, [], set()))
        names += [] if name in names else [name]
        texts.add(text)
    return [f"{_names(names)}: {text}{_of_the_first(names, texts)}" for text, names, texts in groups.values()]


def _names(names: Sequence[str]) -> str:
    more = len(names) - NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:NAMED])} and {more} more"


def _of_the_first(names: Sequence[str], texts: set[str]) -> str:
    return f" (numbers of {names[0]})" if len(texts) > 1 else ""
