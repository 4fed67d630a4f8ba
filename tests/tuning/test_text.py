"""What `tune` prints: no column goes missing in silence, notes are said once, every sign has its legend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.exclusion import Band, parse_bands, without_bands
from seqsweep.plant.errors import SeqsweepError
from seqsweep.tuning.intervals import Interval
from seqsweep.tuning.layout import wrapped
from seqsweep.tuning.result import TuningResult, to_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.text import format_table, grouped
from seqsweep.tuning.tune import tune

from .test_tuning import F1_HZ, F_HZ, on_grid, turbine

LINE = SeriesRL(0.012, 0.25, F1_HZ)


@pytest.fixture(scope="module")
def result() -> TuningResult:
    return tune([on_grid(0.3e6), on_grid(0.65e6)], LINE, scales=(1.0, 1.4))


def test_one_entry_per_operating_point_and_scale(result: TuningResult) -> None:
    entries = to_json(result)["operating_points"]
    assert [(entry["op_id"], entry["scale"]) for entry in entries] == [
        *(("p300", 1.0), ("p300", 1.4)),
        *(("p650", 1.0), ("p650", 1.4)),
    ]
    assert [entry["grid"]["x_ohm"] for entry in entries] == pytest.approx([0.25, 0.35] * 2)
    alone = tune([on_grid(0.65e6)], LINE.scaled(1.4)).points[0]
    assert result.point("p650", 1.4).margin_m == alone.margin_m  # each as if it had been asked for alone
    assert result.point("p650").scale == 1.4  # the worst of its scales
    with pytest.raises(SeqsweepError, match=r"not tuned at scale 2; its scales are 1, 1\.4"):
        result.point("p650", 2.0)


@pytest.mark.parametrize("width", [60, 70, 80, 100, 200])
def test_no_column_is_dropped_without_saying_so(result: TuningResult, width: int) -> None:
    text = format_table(result, width)
    assert max(map(len, text.splitlines())) <= width
    head = next(line for line in text.splitlines() if line.startswith("op "))
    said = " ".join(text.split())
    for column in ("verdict", "m", "m >= 1.4", "resonance Hz", "damping", "Z crit", "k", "m predicted"):
        left_out = said.partition("left out, the lines being too long: ")[2].partition("(a wider")[0]
        assert column in head or column in left_out, column
    assert "left out, the lines" not in format_table(result, 200)


def test_the_required_margin_is_met_or_not_and_a_first_value_is_marked(result: TuningResult) -> None:
    lines = {line.split()[0] + line.split()[1]: line for line in format_table(result, 200).splitlines() if "p" in line}
    assert lines["p3001"].split()[4] == "yes"
    assert lines["p6501.4"].split()[4] == "no"
    assert "*" in lines["p6501.4"]
    assert "*: first value by the formula; --confirm" in format_table(result, 200)
    settled = replace(result, points=tuple(replace(p, reached=True, margin_m_with_k=1.4) for p in result.points))
    assert "first value" not in format_table(settled, 200)


def test_a_probability_stands_beside_every_verdict_that_is_not_certain(result: TuningResult) -> None:
    doubtful = replace(result, points=(replace(result.points[0], probability=0.93), *result.points[1:]))
    lines = format_table(doubtful, 60).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("op "))
    head, _, first, second = lines[start : start + 4]
    assert "P stable" in head
    assert "0.93" in first
    assert "0.93" not in second
    assert "a blank is a certain verdict" in format_table(doubtful, 200)


def test_notes_are_said_once_for_all_they_belong_to() -> None:
    notes = [(f"p{n}", f"it takes {n / 7:.3g} pu of source") for n in range(6)] + [("p1", "another thing")]
    assert grouped(notes) == [
        "p0, p1, p2, p3 and 2 more: it takes 0 pu of source (numbers of p0)",
        "p1: another thing",
    ]


def test_every_null_has_its_reason_and_no_number_is_infinite(result: TuningResult) -> None:
    """An interval without an upper end, and one that noise has blown up altogether."""
    import json

    point = result.points[0]
    for interval in (Interval(np.inf, -np.inf, None), Interval(float("nan"), 0.9, np.inf)):
        blown = replace(result, points=(replace(point, scale_interval=interval), *result.points[1:]))
        entry = json.loads(json.dumps(to_json(blown), allow_nan=False))["operating_points"][0]
        nulls = {key for key, value in entry.items() if value is None}
        assert nulls <= set(entry["missing"])
        assert {"critical_scale_std", "critical_scale_interval"} <= set(entry["missing"])
        assert all(entry["missing"].values())


def test_each_point_stands_on_the_grid_it_was_swept_for() -> None:
    proof = {"grid": {"r_ohm": 0.012, "x_ohm": 0.3}, "basis": "shots", "growth_bound_per_s": 1.0, "disturbed_s": 9.0}
    response = on_grid(0.65e6)
    own = replace(response, meta={**response.meta, "stable_on": proof})
    result = tune([own], "own", scales=(1.0, 1.1))
    assert [point.grid.x_ohm for point in result.points] == pytest.approx([0.3, 0.33])
    assert "each operating point on the grid it was swept for" in format_table(result, 200)
    with pytest.raises(SeqsweepError, match="swept on an ideal source for no grid in particular"):
        tune([response], "own")


def test_rows_are_left_out_in_sight() -> None:
    response = turbine()
    cut = without_bands(response, parse_bands(["50-70", "150,200-300"]))
    assert len(cut) == len(response)
    expected = ((F_HZ >= 50) & (F_HZ <= 70)) | ((F_HZ >= 200) & (F_HZ <= 300))
    np.testing.assert_array_equal(~cut.usable, expected | (F_HZ == 150.0))
    text = " ".join(format_table(tune([cut], LINE), 200).split())
    assert f"{expected.sum()} of {len(response)} rows" in text
    assert "Hz, were left out as asked (--exclude)" in text
    bands = text.partition(f"{np.sum(~cut.usable)} of {len(response)} rows, ")[2].partition(" Hz, were")[0]
    assert len(bands.split(", ")) == 2  # two stretches, each named: none of the rows is at 150 Hz
    assert parse_bands(["150"]) == (Band(150.0, 150.0),)


@pytest.mark.parametrize("text", ["", "a-b", "70-50", "-5", "50-", "inf"])
def test_a_band_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SeqsweepError, match="needed is a frequency or a band in Hz, such as 150 or 50-70"):
        parse_bands([text])


@pytest.mark.parametrize("floor", ["identify", "tuning"])
def test_every_property_of_the_schema_has_a_description(floor: str) -> None:
    import json
    from importlib.resources import files

    name = {"identify": "admittance", "tuning": "tuning"}[floor]
    schema = json.loads(files(f"seqsweep.{floor}").joinpath("schema", f"seqsweep-{name}-1.schema.json").read_text())

    def bare(node, path):
        if isinstance(node, dict):
            for name, entry in node.get("properties", {}).items():
                if not path.startswith("$.allOf") and "description" not in entry:
                    yield f"{path}.{name}"
            for key, value in node.items():
                yield from bare(value, f"{path}.{key}")
        elif isinstance(node, list):
            for k, value in enumerate(node):
                yield from bare(value, f"{path}.{k}")

    assert list(bare(schema, "$")) == []


def test_a_picture_shows_the_worst_entry_that_has_a_fit() -> None:
    from seqsweep.tuning.figures import result_figure

    nothing = without_bands(turbine(), parse_bands(["0-2000"]))
    nothing = replace(nothing, meta={"op_id": "empty"})
    result = tune([nothing, on_grid(0.3e6)], LINE)
    assert result.worst.op_id == "empty"
    assert result.worst_fitted is result.points[1]
    assert result_figure(result)._suptitle.get_text().startswith("p300 (the worst with a fit of 2)")
    assert tune([nothing], LINE).worst_fitted is None


def test_no_line_begins_with_a_percent_sign():
    text = "the mode grows, damping -2.7 %, and again 13.5 % of it"
    for width in range(20, 60):
        lines = wrapped(text, width)
        assert " ".join(line.strip() for line in lines) == text
        assert not any(line.strip().startswith("%") for line in lines)
