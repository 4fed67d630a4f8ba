"""A campaign that chooses its operating points, and what is asked of its surrogate, from the command line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from seqsweep.identify.surrogate.store import read_surrogate
from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.region.figure import map_figure
from seqsweep.sweep.region.pace import Pace
from seqsweep.tuning.region.scan import scan
from seqsweep.tuning.region.worst import worst_point
from seqsweep.tuning.siso import parse_grid

from ..support import oracle
from ..support.commands import command

REGION = """
[campaign]
name = "region"
[plant]
id = "dpmsg-v1"
[sweep]
f_min_hz = 3.0
f_max_hz = 500.0
points = 24
probes = 0
[sweep.operating_points]
active_power_mw = [0.3, 1.0]
terminal_voltage_pu = [0.95, 1.05]
tolerance = 5e-3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("region")
    (folder / "region.toml").write_text(REGION)
    done = command("run", folder / "region.toml", "-o", folder / "y.parquet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    assert "Y is certified to 0.005 over the region" in done.stderr
    return folder


def test_a_certified_region_is_right_where_nothing_was_swept(folder):
    surrogate = read_surrogate(folder / "y.parquet")
    random = np.random.default_rng(8)
    points = np.column_stack([random.uniform(0.3, 1.0, 20), np.zeros(20), random.uniform(0.95, 1.05, 20)])
    f_hz = surrogate.f1_hz + surrogate.nu_hz
    for point in points:
        truth = oracle.admittance_pn(f_hz, point[0] * 1e6, point[2] * 690.0)
        off = np.linalg.norm(surrogate.response(point).y - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
        assert off.max() < 5e-3


def test_the_table_conforms_and_holds_the_certificate(folder):
    assert validate_table(folder / "y.parquet") == []
    table = read_table(folder / "y.parquet")
    assert table.meta["region"]["certified"]
    assert table.meta["region"]["largest_bar"] <= 5e-3
    assert not (folder / "y.parquet.rounds").exists()


def test_an_interrupted_region_goes_on_to_the_same_bytes(folder):
    """A folder in the way ends the second sweep; without it, the rounds that are there are read."""
    out = folder / "again.parquet"
    rounds = folder / "again.parquet.rounds"
    (rounds / "0002.parquet").mkdir(parents=True)
    assert command("run", folder / "region.toml", "-o", out, "--jobs", 1).returncode != 0
    assert (rounds / "0001.parquet").exists()
    (rounds / "0002.parquet").rmdir()
    assert command("run", folder / "region.toml", "-o", out, "--jobs", 2).returncode == 0
    assert out.read_bytes() == (folder / "y.parquet").read_bytes()


def test_the_worst_point_is_no_better_than_any_of_many(folder):
    surrogate = read_surrogate(folder / "y.parquet")
    grid = parse_grid("0.012+0.25j", 50.0)
    worst = worst_point(surrogate, grid)
    random = np.random.default_rng(2)
    points = surrogate.region.low + random.random((300, 3)) * (surrogate.region.high - surrogate.region.low)
    assert worst.tuning.stability.critical.m <= scan(surrogate, grid, points).margin_m.min() * 1.005


def test_load_flow_of_the_worst_point_is_that_of_the_exact_device(folder):
    surrogate = read_surrogate(folder / "y.parquet")
    worst = worst_point(surrogate, parse_grid("0.012+0.2j", 50.0), 1.0, 690.0)
    p, _, v = worst.point
    x_ohm, w1 = 0.2, 2.0 * np.pi * 50.0
    assert v * 690.0 == pytest.approx(oracle.terminal_voltage(p * 1e6, 0.012, x_ohm / w1, 690.0), rel=2e-4)


def test_predictions_are_a_table_that_tune_reads(folder):
    done = command("surrogate", folder / "y.parquet", "--at", "0.65,0,1.0", "-o", folder / "p.parquet")
    assert done.returncode == 0, done.stderr
    assert validate_table(folder / "p.parquet") == []
    done = command("tune", folder / "p.parquet", "--grid", "0.012+0.25j")
    assert done.returncode == 0, done.stderr
    assert "p0.65_q0_v1" in done.stdout
    assert re.search(r"\b1\.(29|30)\d\b", done.stdout), done.stdout  # the exact turbine has m = 1.298 here


def test_reactive_power_is_an_axis_of_a_device_that_has_it(tmp_path):
    """Three axes, by the grid-following inverter: every asked Q stands in the table and is met by the measured one."""
    text = REGION.replace("dpmsg-v1", "gfl-v1").replace("tolerance = 5e-3", "tolerance = 3e-2\nmost = 9")
    region = "[sweep.operating_points]\nreactive_power_mvar = [-0.3, 0.3]"
    (tmp_path / "gfl.toml").write_text(text.replace("[sweep.operating_points]", region))
    command("run", tmp_path / "gfl.toml", "-o", tmp_path / "y.parquet", "--jobs", 1)
    surrogate = read_surrogate(tmp_path / "y.parquet")
    assert surrogate.region.varies.all()
    for response in read_table(tmp_path / "y.parquet").responses:
        measured = -response.meta["fundamental"]["reactive_power_into_device_var"] / 1e6
        assert measured == pytest.approx(response.meta.get("reactive_power_mvar", 0.0), abs=2e-3)


REFUSED = {
    "no numbers": (["--at", "0.65,0"], "needed are three numbers P,Q,V"),
    "outside": (["--at", "3,0,1"], "outside the swept region"),
    "voltage without grid": (["--source-voltage", "1.0"], "give --grid R+jX as well"),
}


@pytest.mark.parametrize(("options", "words"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_call_is_refused(folder, options, words):
    done = command("surrogate", folder / "y.parquet", *options)
    assert done.returncode == 2
    assert words in done.stderr


def test_a_map_is_drawn(folder):
    done = command("surrogate", folder / "y.parquet", "--grid", "0.012+0.25j", "--plot", folder / "map.svg")
    assert done.returncode == 0, done.stderr
    assert "Magnitude margin m" in (folder / "map.svg").read_text()


def test_the_border_of_stability_is_on_the_map_with_its_doubt(folder):
    """On a grid whose border runs through the region the line is where the exact device's mode has no real part."""
    surrogate = read_surrogate(folder / "y.parquet")
    worst = worst_point(surrogate, parse_grid("0.01+0.29j", 50.0))
    figure = map_figure(surrogate, worst)
    axes = figure.axes[0]
    assert "border of stability; band: open at 95 %" in axes.get_legend_handles_labels()[1]
    line = [c for c in axes.collections if list(getattr(c, "levels", [])) == [0.0]][-1]
    at = np.concatenate([path.vertices for path in line.get_paths()])[::40]
    grid = parse_grid("0.01+0.29j", 50.0)
    for p, v in at:
        poles = oracle.closed_loop_poles(p * 1e6, grid.r_ohm, grid.l_h, terminal_voltage_v=v * 690.0)
        assert abs(oracle.resonance_pole(poles).real) < 0.5


def test_the_doubt_over_the_number_of_sweeps_is_drawn(folder, tmp_path):
    done = command("surrogate", folder / "y.parquet", "--progress", tmp_path / "p.svg")
    assert done.returncode == 0, done.stderr
    assert "Operating points swept" in (tmp_path / "p.svg").read_text()
    history = read_table(folder / "y.parquet").meta["region"]["history"]
    assert [each["operating_points"] for each in history] == list(range(6, 6 + len(history)))
    assert history[-1]["doubt"] <= 2.5e-3


WRONG = {
    "both": ({"operating_point": [{"active_power_mw": 0.5, "terminal_voltage_pu": 1.0}]}, {}, "needed: only one"),
    "falling": ({}, {"active_power_mw": [1.0, 0.3]}, r"needed: a range \[low, high\] with low < high"),
    "no range": ({}, {"active_power_mw": 0.5, "terminal_voltage_pu": 1.0}, "no range in it"),
    "unknown": ({}, {"activ_power_mw": [0.3, 1.0]}, "did you mean active_power_mw"),
}


@pytest.mark.parametrize(("top", "region", "words"), WRONG.values(), ids=WRONG)
def test_a_wrong_region_is_refused(top, region, words):
    asked = {"active_power_mw": [0.3, 1.0], **region}
    sweep = {"f_hz": [10.0, 20.0], "operating_points": asked}
    with pytest.raises(ValueError, match=words):
        Config.from_dict({"campaign": {"name": "x"}, "plant": {"id": "dpmsg-v1"}, "sweep": sweep, **top})


def test_the_pace_tells_what_is_left_only_while_the_bar_falls():
    now = iter([0.0, 10.0, 20.0, 30.0, 90.0])
    pace = Pace(clock=lambda: next(now))
    pace.mark(6, 1e-1)
    pace.mark(7, 1e-2)
    assert pace.left(1.1e-4) == "; at this pace some 2 more, 20 s"
    pace.mark(8, 3e-1)
    assert "the doubt does not fall" in pace.left(1e-4)
    assert pace.is_over(1.0)
    assert not Pace().is_over(None)
