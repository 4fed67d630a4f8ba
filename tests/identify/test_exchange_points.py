"""Operating points of files: P, Q and |v| go out and come back, and stand beside the rows of other people's text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.exchange.convert import to_table
from seqsweep.identify.surrogate.region import points_of
from seqsweep.identify.table.read import read_table
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.cli.exchange import export_table, import_file, read_file

from ..support.regions import BASES, TURBINE

F_HZ = np.array([10.0, 20.0, 80.0])
POINTS = np.array([[0.4, -0.2, 0.95], [0.4, 0.2, 0.95], [1.1, 0.1, 1.05], [0.8, 0.0, 1.0]])
GIVEN = {"frame": "pn", "direction": "load", "f1_hz": 50.0, **BASES}


@pytest.fixture(scope="module")
def swept():
    return [replace(TURBINE, facts=None).swept(point, f_hz=F_HZ) for point in POINTS]


def table_of(responses, path, **more):
    facts = ("op_id", "active_power_mw", "reactive_power_mvar", "terminal_voltage_pu")
    points = [{**{key: response.meta[key] for key in facts}, **more} for response in responses]
    meta = {"f1_hz": 50.0, "bases": BASES, "power_meaning": "out of the device", "plant": {"id": "x-v1"}}
    write_table(path, responses, {**meta, "operating_points": points, "configuration": {}})
    return path


@pytest.mark.parametrize(("suffix", "kind"), [(".csv", "csv"), (".mat", "mat"), (".s2p", "touchstone")])
def test_a_reactive_power_comes_back(swept, tmp_path, suffix, kind):
    table, file = table_of(swept[:1], tmp_path / "y.parquet"), tmp_path / f"y{suffix}"
    export_table(table, file, kind)
    import_file(file, tmp_path / "back.parquet", kind, {})
    assert read_table(tmp_path / "back.parquet").meta["operating_points"][0]["reactive_power_mvar"] == -0.2


def test_all_operating_points_of_our_text_come_back_with_their_parameters(swept, tmp_path):
    table = table_of(swept, tmp_path / "y.parquet", parameters={"k_pp": 0.08})
    export_table(table, tmp_path / "y.csv", "csv")
    import_file(tmp_path / "y.csv", tmp_path / "back.parquet", "csv", {})
    back = read_table(tmp_path / "back.parquet")
    assert np.array_equal(points_of(back.responses, ["k_pp"]), np.column_stack([POINTS, np.full(4, 0.08)]))


def text_of(responses, path, columns, values):
    """Rows of other people's text: columns beside frequency and elements; ``values`` are theirs for each row."""
    header = [*columns, "f [Hz]", *(f"{part}(Y{e}) [S]" for e in ("pp", "pn", "np", "nn") for part in ("re", "im"))]
    lines = [",".join(header)]
    for response, of in zip(responses, values, strict=True):
        for f, y, own in zip(response.f_hz, response.y, of, strict=True):
            parts = [number for e in y.ravel() for number in (e.real, e.imag)]
            lines.append(",".join(map(repr, map(float, (*own, f, *parts)))))
    path.write_text("\n".join(lines), "utf-8")
    return path


def imported(path, **more):
    return to_table(read_file(path, "csv", {**GIVEN, **more}), path)


HEADERS = {
    "brackets": (("P [MW]", "Q [Mvar]", "V [pu]"), (1.0, 1.0, 1.0)),
    "underscores": (("P_kW", "Q_kvar", "V_pu"), (1e3, 1e3, 1.0)),
    "ours": (("active_power_mw", "reactive_power_mvar", "terminal_voltage_pu"), (1.0, 1.0, 1.0)),
    "var": (("P (W)", "Q (VAr)", "|U| (pu)"), (1e6, 1e6, 1.0)),
}


@pytest.mark.parametrize(("columns", "factors"), HEADERS.values(), ids=HEADERS)
def test_powers_and_voltage_beside_the_rows_are_the_operating_points(swept, tmp_path, columns, factors):
    values = [[point * factors] * len(F_HZ) for point in POINTS]
    responses, meta = imported(text_of(swept, tmp_path / "y.csv", columns, values))
    axes = ("active_power_mw", "reactive_power_mvar", "terminal_voltage_pu")
    found = [[point[axis] for axis in axes] for point in meta["operating_points"]]
    assert np.allclose(found, POINTS, rtol=1e-12)
    assert [response.meta["op_id"] for response in responses] == [f"imported{k}" for k in range(4)]
    assert all(np.array_equal(own.y, response.y) for own, response in zip(swept, responses, strict=True))


def test_powers_that_were_measured_beside_every_row_are_of_one_operating_point(swept, tmp_path):
    values = [[POINTS[0] + 1e-4 * k for k in range(len(F_HZ))]]
    responses, meta = imported(text_of(swept[:1], tmp_path / "y.csv", ("P_MW", "Q_Mvar", "V_pu"), values))
    assert len(responses) == 1
    assert meta["operating_points"][0]["active_power_mw"] is None


def test_a_reactive_power_is_given_for_a_file_that_holds_none(swept, tmp_path):
    path = text_of(swept[:1], tmp_path / "y.csv", (), [[()] * len(F_HZ)])
    _, meta = imported(path, active_power_mw=0.4, reactive_power_mvar=-0.2, terminal_voltage_pu=0.95)
    assert points_of_meta(meta) == {"active_power_mw": 0.4, "reactive_power_mvar": -0.2, "terminal_voltage_pu": 0.95}


def points_of_meta(meta):
    return {key: value for key, value in meta["operating_points"][0].items() if key != "op_id"}
