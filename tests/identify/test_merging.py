"""Tables of one device as one, and what does not belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.merging import MergeError, merged
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.identify.table.write import write_table

META = {
    "f1_hz": 50.0,
    "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1e6},
    "power_meaning": "at the terminals",
    "plant": {"id": "d", "parameters": {"r": 1.0}},
    "configuration": {"plant": {"id": "d"}, "operating_point": [{"id": "p", "active_power_mw": 0.1}]},
}


def table(path, f_hz, op_id="p", power=0.1, **changed):
    f = np.asarray(f_hz, dtype=float)
    y = (1.0 / (1.0 + 0.01j * f))[:, None, None] * np.array([[1.0, 0.1], [0.2, 1.0]])
    point = {"op_id": op_id, "active_power_mw": power, "terminal_voltage_pu": 1.0}
    response = FrequencyResponse(f, y, changed.get("f1_hz", 50.0), covariance=np.full((len(f), 8, 8), 0.0), meta=point)
    configuration = {**META["configuration"], "operating_point": [{"id": op_id, "active_power_mw": power}]}
    write_table(path, [response], {**META, "configuration": configuration, "operating_points": [point], **changed})
    return read_table(path)


def join(*tables):
    return merged(tables, [f"t{k}" for k in range(len(tables))])


def test_operating_points_stand_side_by_side(tmp_path):
    a, b = table(tmp_path / "a.parquet", [10, 20]), table(tmp_path / "b.parquet", [10, 30], "q", 0.2)
    responses, meta = join(a, b)
    write_table(tmp_path / "m.parquet", responses, meta)
    assert validate_table(tmp_path / "m.parquet") == []
    whole = read_table(tmp_path / "m.parquet")
    assert whole.op_ids == ("p", "q")
    assert np.array_equal(whole.response("q").y, b.responses[0].y)
    assert [point["id"] for point in whole.meta["configuration"]["operating_point"]] == ["p", "q"]
    assert [each["sha256"] for each in whole.meta["merged_from"]] == [a.meta["sha256"], b.meta["sha256"]]


def test_bands_of_one_operating_point_stand_end_to_end(tmp_path):
    high, low = table(tmp_path / "h.parquet", [60, 80]), table(tmp_path / "l.parquet", [10, 70, 90])
    (response,), meta = join(high, low)
    assert response.f_hz.tolist() == [10.0, 60.0, 70.0, 80.0, 90.0]
    whole = table(tmp_path / "w.parquet", response.f_hz).responses[0]
    assert np.array_equal(response.y, whole.y)
    write_table(tmp_path / "m.parquet", [response], meta)
    assert validate_table(tmp_path / "m.parquet") == []


def test_a_measured_fundamental_is_the_nominal_one_up_to_a_part_in_ten_thousand(tmp_path):
    """Two recordings of one device never find the same f1 to the last digit; the merged table has one for all rows."""
    a = table(tmp_path / "a.parquet", [10, 20])
    b = table(tmp_path / "b.parquet", [10, 30], "q", 0.2, f1_hz=50.0000001)
    responses, meta = join(a, b)
    assert meta["f1_hz"] == 50.0
    assert [response.f1_hz for response in responses] == [50.0, 50.0]
    write_table(tmp_path / "m.parquet", responses, meta)
    assert read_table(tmp_path / "m.parquet").response("q").f_hz.tolist() == [10.0, 30.0]
    with pytest.raises(MergeError, match="f1_hz is 50"):
        join(a, table(tmp_path / "c.parquet", [10, 30], "q", 0.2, f1_hz=50.01))


def test_the_proof_of_stability_that_says_most_is_kept(tmp_path):
    a, b = table(tmp_path / "a.parquet", [10, 20]), table(tmp_path / "b.parquet", [30, 40])

    def proved(part, bound):
        fact = {"grid": "ideal", "basis": "shots", "growth_bound_per_s": bound}
        return replace(part, responses=(replace(r, meta={**r.meta, "stable_on": fact}) for r in part.responses))

    parts = [replace(t, responses=tuple(t.responses)) for t in (proved(a, 2.0), proved(b, 0.5))]
    (response,), _ = join(*parts)
    assert response.meta["stable_on"]["growth_bound_per_s"] == 0.5


REFUSED = {
    "another device": (
        {"plant": {"id": "e", "parameters": {}}},
        "not of one device: plant id is .* in the one and e in the other",
    ),
    "a null that the other lacks": (
        {"plant": {"id": "d", "parameters": {"r": 1.0}, "card": None}},
        "plant card is not told in the one and None in the other",
    ),
    "another base": ({"bases": {"rated_voltage_v": 400.0, "rated_power_va": 1e6}}, "rated_voltage_v is 690"),
    "another fundamental": ({"f1_hz": 60.0}, "f1_hz is 50"),
}


@pytest.mark.parametrize(("changed", "words"), REFUSED.values(), ids=REFUSED)
def test_tables_of_two_devices_are_refused(tmp_path, changed, words):
    with pytest.raises(MergeError, match=words):
        join(table(tmp_path / "a.parquet", [10, 20]), table(tmp_path / "b.parquet", [30, 40], **changed))


def test_what_says_two_things_of_one_point_is_refused(tmp_path):
    a = table(tmp_path / "a.parquet", [10, 20])
    with pytest.raises(MergeError, match=r"20 Hz in more than one of t0 and t1.*compare"):
        join(a, table(tmp_path / "b.parquet", [20, 30]))
    with pytest.raises(MergeError, match=r"is two operating points: active_power_mw is 0\.1 in t0 and 0\.3 in t1"):
        join(a, table(tmp_path / "c.parquet", [30, 40], power=0.3))
    with pytest.raises(MergeError, match="equally many rows"):
        join(a, table(tmp_path / "d.parquet", [10, 20, 30], "q"))
    with pytest.raises(MergeError, match="at least two"):
        join(a)
