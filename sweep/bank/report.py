"""What `seqsweep judge` says: one sentence on all, the worst pairs, and what would settle the open ones."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from ...tuning.bank.judgement import PairVerdict
from ...tuning.layout import fitted_table, left_out, wrapped
from ...tuning.probability import DECIDED

SHOWN = 12
"""Pairs that the terminal shows."""

_DROPPED_FIRST = ("damping", "Z crit", "m")


def report_text(verdicts: Sequence[PairVerdict], f1_hz: float, width: int) -> str:
    """The report for a terminal so many characters wide."""
    table = fitted_table([_row(v, f1_hz) for v in verdicts[:SHOWN]], width, _DROPPED_FIRST)
    more = [f"... and {len(verdicts) - SHOWN} more: -o judge.parquet holds them all"] if len(verdicts) > SHOWN else []
    remarks = (
        *left_out(table.dropped, "-o judge.parquet"),
        *_regions(verdicts),
        *_settling(verdicts),
        *_edges(verdicts),
        *_warnings(verdicts),
        *_failures(verdicts),
    )
    lines = [*wrapped(summary(verdicts, f1_hz), width), "", *table.lines, *more, ""]
    return "\n".join([*lines, *(line for remark in remarks for line in wrapped(remark, width))])


def summary(verdicts: Sequence[PairVerdict], f1_hz: float) -> str:
    """``Stable on 398 of 400 grids ...``, and the weakest pair."""
    stable_on, points, kinds = Counter[str](), set(), Counter[str]()
    for v in verdicts:
        stable_on[v.grid_id] += v.verdict == "stable"
        points.add(v.op_id)
        kinds[v.verdict if v.status == "ok" else "not readable"] += 1
    stable = sum(count == len(verdicts) // len(stable_on) for count in stable_on.values())
    counts = ", ".join(f"{kinds[name]} {name}" for name in ("unstable", "undecided", "not readable") if kinds[name])
    at = "" if len(points) == 1 else f" at all {len(points)} operating points"
    how_sure = f", each with a probability of {DECIDED:.0%} or more" if stable else ""
    text = f"Stable on {stable} of {len(stable_on)} grids{at}{how_sure}"
    text += f"; of {len(verdicts)} pairs {counts}." if counts else "."
    weakest = next((v for v in verdicts if v.status == "ok" and v.re_rad_s is not None), None)
    if weakest is None:
        return text
    return f"{text} Weakest: grid {weakest.grid_id}{_varied(weakest)} at {weakest.op_id}, {mode(weakest, f1_hz)}."


def _varied(verdict: PairVerdict) -> str:
    """What the family gave a grid, in brackets."""
    parts = [f"{key} = {_number(value)}" for key, value in verdict.parameters.items()]
    return f" ({', '.join(parts)})" if parts else ""


def _number(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) or not isinstance(value, int | float) else f"{value:.4g}"


def mode(verdict: PairVerdict, f1_hz: float) -> str:
    """The deciding mode in words."""
    if verdict.re_rad_s is None or verdict.im_rad_s is None:
        return "no mode"
    nu = abs(verdict.im_rad_s) / (2.0 * np.pi)
    place = "an aperiodic mode" if nu == 0.0 else f"{abs(f1_hz - nu):.4g}/{f1_hz + nu:.4g} Hz"
    return f"{place}, Re {verdict.re_rad_s:+.3g} rad/s"


def _row(v: PairVerdict, f1_hz: float) -> dict[str, str]:
    nu = None if v.im_rad_s is None else abs(v.im_rad_s) / (2.0 * np.pi)
    return {
        "grid": v.grid_id,
        "op": v.op_id,
        "verdict": v.verdict if v.status == "ok" else v.status,
        "P stable": "-" if v.probability is None else f"{v.probability:.3g}",
        "m": "-" if v.margin_m is None else f"{v.margin_m:.3f}",
        "mode Hz": "-" if nu is None else f"{f1_hz - nu:.1f}/{f1_hz + nu:.1f}",
        "Re rad/s": "-" if v.re_rad_s is None else f"{v.re_rad_s:+.3g}",
        "damping": "-" if v.damping is None else f"{100.0 * v.damping:.1f} %",
        "Z crit": "-" if v.critical_scale is None else f"x{v.critical_scale:.3f}",
    }


def _settling(verdicts: Sequence[PairVerdict]) -> Iterator[str]:
    """What would settle the undecided pairs."""
    for v in islice((v for v in verdicts if v.status == "ok" and v.verdict == "undecided"), 3):
        yield f"{v.grid_id} at {v.op_id} is undecided: {v.reason}"


def _regions(verdicts: Sequence[PairVerdict]) -> Iterator[str]:
    """How far the edge is from regions as a whole; m, mode and scale are those of their member."""
    for v in islice((v for v in verdicts if v.region_distance is not None), 3):
        text = _undecided_region(v) if v.verdict == "undecided" else _decided_region(v)
        yield f"{v.grid_id} at {v.op_id}, {text}"


def _decided_region(v: PairVerdict) -> str:
    limit = "without a limit in reach" if v.region_growth is None else f"to {_number(v.region_growth)} of its extent"
    return (
        f"over the whole region: det(1 + Y Z) stays {_number(v.region_distance)} away from zero (1: no grid at all); "
        f"about its member the region may grow {limit}"
    )


def _undecided_region(v: PairVerdict) -> str:
    if not v.region_growth:
        return "no region about its member, however small, is decided"
    return f"the region about its member is decided within {_number(v.region_growth)} of its extent"


def _edges(verdicts: Sequence[PairVerdict]) -> Iterator[str]:
    """The critical value of each element of the worst pair that has any."""
    worst = next((v for v in verdicts if v.elements), None)
    if worst is None:
        return
    parts = [
        f"{e.element} {e.key} {e.value:.4g} -> {'no edge in reach' if e.critical is None else f'{e.critical:.4g}'}"
        for e in worst.elements
    ]
    yield f"Edge of {worst.grid_id} at {worst.op_id}, one element varied at a time: {'; '.join(parts)}"


def _warnings(verdicts: Sequence[PairVerdict]) -> Iterator[str]:
    """What the reader should know, remarks that differ in their numbers alone once, those of most pairs first."""
    alike, first = Counter[str](), dict[str, str]()
    for text in (text for v in verdicts for text in v.warnings):
        kind = re.sub(r"[-+]?[\d.]+(?:e[-+]?\d+)?", "#", text)
        alike[kind] += 1
        first.setdefault(kind, text)
    for kind, count in alike.most_common(3):
        yield f"{count} of {len(verdicts)} pairs, such as: {first[kind]}"


def _failures(verdicts: Sequence[PairVerdict]) -> Iterator[str]:
    failed = list({v.grid_id: v for v in verdicts if v.status != "ok"}.values())
    for v in failed[:5]:
        yield v.reason if v.grid_id in v.reason.partition(": ")[0] else f"{v.grid_id}: {v.reason}"
    if len(failed) > 5:
        yield f"... and {len(failed) - 5} more grids that could not be read"
