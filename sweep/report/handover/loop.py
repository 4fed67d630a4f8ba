"""Bode and locus of the case that decides, drawn anew from the table and the grid that its result names.

A result holds numbers, not the fit; the picture needs the fit. So the worst case is judged again, and shown only where
that gives the verdict of the result: what `--exclude` or `--stable-on` told is not in the table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.fit.rational import evaluate_pn
from ....identify.response import FrequencyResponse
from ....plant.errors import SeqsweepError
from ....tuning.siso import Grid, SeriesRL, siso
from .svg import Picture, drawn, points_under, rows_under

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ....tuning.result import PointTuning
    from .inputs import Inputs
    from .pictures import Hover


def loop_pictures(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> list[Picture]:
    """Bode and locus of the first of ``points`` that can be judged again; none where none can."""
    for point in points[:1]:
        found = _judged_again(inputs, point)
        if found is not None:
            return [_bode(found), _locus(found)]
    return []


def _judged_again(inputs: Inputs, point: Mapping[str, Any]) -> PointTuning | None:
    """The case of a result, judged again; None where that cannot be done, or gives another verdict."""
    from dataclasses import replace

    from ....tuning.tune import tune_point

    response = _response(inputs, point)
    grid = grid_of(point.get("grid") or {})
    if response is None or grid is None:
        return None
    try:
        found = tune_point(response, grid, bases=inputs.table.meta.get("bases", {}))
    except SeqsweepError:
        return None
    if found.stability is None or found.verdict != point["verdict"]:
        return None
    return replace(found, scale=float(point["scale"]))


def _response(inputs: Inputs, point: Mapping[str, Any]) -> FrequencyResponse | None:
    return next((r for r in inputs.table.responses if r.meta.get("op_id") == point["op_id"]), None)


def grid_of(described: Mapping[str, Any]) -> Grid | None:
    """The grid that a result describes; None where only its file would tell it in full."""
    if described.get("kind", "series_rl") == "series_rl" and described.get("f1_hz"):
        return SeriesRL(described["r_ohm"], described["x_ohm"], described["f1_hz"])
    if described.get("document"):
        from ....tuning.grids.elements import elements_grid

        grid = elements_grid(described["document"], described["f1_hz"], str(described.get("name", "")))
        return grid.scaled(described.get("scale", 1.0))
    return None


def _case(point: PointTuning) -> str:
    return f"{point.op_id} at scale {point.scale:g}"


def _bode(point: PointTuning) -> Picture:
    return drawn(
        "loop",
        lambda: _bode_figure(point),
        f"{_case(point)}: magnitude of Y1 and Y2 of the device against the grid's, and the phase between them; circles "
        "mark where they are opposite.",
        f"{_case(point)}: device against grid. Where the phase is 180 degrees (circles) the device's magnitude must "
        "stay below the grid's; m is the ratio there.",
    )


def _bode_figure(point: PointTuning) -> tuple[Figure, Hover]:
    from ....tuning.figures import bode_figure

    assert point.model is not None
    assert point.grid is not None
    figure, model, grid = bode_figure(point), point.model, point.grid

    def hover() -> Mapping[str, Any]:
        low, high = figure.axes[0].get_xlim()
        f = np.geomspace(low, high, 500)
        pair = siso(f, evaluate_pn(model, f), grid)
        columns = [
            np.abs(pair.y1), np.abs(pair.yg1), np.degrees(np.angle(pair.y1 / pair.yg1)) % 360.0,
            np.abs(pair.y2), np.abs(pair.yg2), np.degrees(np.angle(pair.y2 / pair.yg2)) % 360.0,
        ]  # fmt: skip
        heads = [h for n in "12" for h in (f"|Y{n}| (S)", f"|Yg{n}| (S)", f"\N{ANGLE}Y{n}/Yg{n} (\N{DEGREE SIGN})")]
        return rows_under(figure.axes[:4], "f", "Hz", heads, {_case(point): (f, columns)})

    return figure, hover


def _locus(point: PointTuning) -> Picture:
    assert point.stability is not None
    return drawn(
        "locus",
        lambda: _locus_figure(point),
        f"{_case(point)}: locus of det(1 + Y Z) about zero, winding number {point.stability.winding.number}.",
        f"{_case(point)}: the locus of det(1 + Y Z), its modulus in dB along the rays. How often it winds about the "
        "middle is the number of unstable modes that the grid adds.",
    )


def _locus_figure(point: PointTuning) -> tuple[Figure, Hover]:
    from ....tuning.figures import locus_figure, locus_rows

    figure = locus_figure(point)

    def hover() -> Mapping[str, Any]:
        nu, place, value = locus_rows(point)
        texts = [
            f"|f - f1| = {f:.4g} Hz: {20.0 * np.log10(abs(d)):.3g} dB, {np.degrees(np.angle(d)):.1f}\N{DEGREE SIGN}"
            for f, d in zip(nu, value, strict=True)
        ]
        return points_under(figure.axes[0], place.real, place.imag, texts)

    return figure, hover
