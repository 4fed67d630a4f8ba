"""`seqsweep farm` from the command line: tables that were really swept, in the shipped example's network."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import jsonschema
import pytest

import seqsweep as ss
from seqsweep.identify.table.read import validate_table
from seqsweep.tuning.farm.result import schema

from ..support.commands import command

EXAMPLE = Path(__file__).parents[2] / "examples" / "farm"
QUICK = ["--set", "sweep.points=24", "--set", "sweep.probes=0", "--set", "sweep.operating_points.tolerance=5e-3"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("farm")
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    done = command("run", folder / "turbine.toml", "-o", folder / "turbine.parquet", "--jobs", 1, *QUICK)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_example_is_judged_and_written(folder):
    outputs = ["-o", folder / "f.json", "--plot", folder / "f.svg", "--table", folder / "pcc.parquet"]
    done = command("farm", folder / "farm.toml", *outputs)
    assert done.returncode == 0, done.stderr
    content = json.loads((folder / "f.json").read_text())
    assert content["verdict"] == "stable"
    assert content["n_unstable_locus"] == content["n_unstable_poles"] == 0
    assert validate_table(folder / "pcc.parquet") == []
    assert "Share in the mode" in (folder / "f.svg").read_text()
    assert all(len(line) <= 80 or str(folder) in line for line in done.shown.splitlines())


def test_a_turbine_less_lets_the_others_stand_at_smaller_angles(folder):
    for name, arguments in (("all", []), ("less", ["--out", "wt1"])):
        assert command("farm", folder / "farm.toml", *arguments, "-o", folder / f"{name}.json").returncode == 0
    whole, less = (json.loads((folder / f"{name}.json").read_text())["devices"] for name in ("all", "less"))
    assert [device["name"] for device in less] == ["wt2", "wt3"]
    assert less[0]["angle_deg"] < whole[1]["angle_deg"]


def test_a_bank_of_grids_is_judged_each_with_its_own_load_flow(folder):
    """Source impedances of the farm's voltage, some too weak for it; the JSON has what the Parquet file has."""
    family = '[family]\n[[element]]\nkind = "series"\nr_ohm = 6.4\nx_ohm = [80.0, 150.0, 900.0]\n'
    (folder / "family.toml").write_text(family)
    outputs = ["-o", folder / "judge.parquet", "--plot", folder / "map.svg", "--jobs", 1, "--json"]
    done = command("farm", folder / "farm.toml", "--grids", folder / "family.toml", *outputs)
    assert done.returncode == 0, done.stderr
    pairs = {pair["grid_id"]: pair for pair in json.loads(done.stdout)}
    assert [pairs[f"0000{k}"]["verdict"] for k in (1, 2, 3)] == ["stable", "stable", "undecided"]
    assert "the load flow has no solution" in pairs["00003"]["reason"]
    assert (folder / "judge.parquet").exists()
    found = ss.judge(folder / "farm.toml", folder / "family.toml", jobs=1)
    assert {v.grid_id: v.verdict for v in found} == {name: pair["verdict"] for name, pair in pairs.items()}
    assert [v.re_rad_s for v in found] == [pairs[v.grid_id]["re_rad_s"] for v in found]
    assert "three turbines" in (folder / "map.svg").read_text()


@pytest.mark.parametrize(
    ("many", "one"),
    [
        (["--grids", "."], ["--states"]),
        (["--grids", "."], ["--damping", 5]),
        (["--grids", "."], ["--margin", 0]),
        (["--states"], ["--by", "power"]),
        (["--states"], ["--diagram", "d.svg"]),
    ],
)
def test_what_asks_about_one_source_is_refused_where_many_are_judged(folder, many, one):
    done = command("farm", folder / "farm.toml", *many, *one)
    assert done.returncode == 2
    assert f"and {one[0]} asks about one farm on one source" in done.stderr


def weak(folder: Path) -> Path:
    """The example on a weaker source."""
    text = (EXAMPLE / "farm.toml").read_text("utf-8").replace("s_sc_mva = 9.5", "s_sc_mva = 5.2")
    (folder / "weak.toml").write_text(text, "utf-8")
    return folder / "weak.toml"


@pytest.fixture(scope="module")
def advised(folder):
    """Less power asked for on a weaker source, in `r.json`; the file has a switching state as well. What was said."""
    states = '[[state]]\nname = "one out"\neach_out = ["wt1"]\n'
    (folder / "states of weak.toml").write_text(weak(folder).read_text("utf-8") + states, "utf-8")
    asked = ["--by", "power", "--damping", "6", "-o", folder / "r.json", "--diagram", folder / "d.svg"]
    return command("farm", folder / "states of weak.toml", *asked)


def test_less_power_that_restores_the_damping_is_found(folder, advised):
    assert advised.returncode == 0, advised.stderr
    assert all(len(line) <= 80 or str(folder) in line for line in advised.shown.splitlines())
    content = json.loads((folder / "r.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema())
    jsonschema.validate(content, schema())
    (advice,) = content["advice"]
    assert [choice["way"] for choice in advice["choices"]] == ["least norm", "fewest", "uniform"]
    assert all(choice["holds"] for choice in advice["choices"])
    assert advice["choices"][0]["norm"] <= min(choice["norm"] for choice in advice["choices"]) + 1e-9


def test_slopes_by_gain_come_from_real_sweeps(folder):
    """A turbine at more power takes more part, and so does its gain."""
    done = command("farm", weak(folder), "--by", "gain", "-o", folder / "g.json", "--force")
    assert done.returncode == 0, done.stderr
    (advice,) = json.loads((folder / "g.json").read_text())["advice"]
    assert advice["choices"] == []
    slopes = [value["re_per_s"] for value in advice["slopes"][0]["by_device"].values()]
    assert slopes[0] < slopes[1] < slopes[2] < 0.0


def test_damping_without_a_lever_is_refused(folder):
    done = command("farm", folder / "farm.toml", "--damping", "5")
    assert done.returncode == 2
    assert "--by gain, --by power" in done.stderr


def test_a_binary_file_or_a_folder_is_no_farm(folder):
    for given, words in ((folder / "turbine.parquet", "is a table of admittances"), (folder, "is a folder")):
        done = command("farm", given)
        assert done.returncode == 2
        assert words in done.stderr


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('table = "turbine.parquet"', 'table = "turbin.parquet"'), "turbin.parquet"),
        (("active_power_mw = 0.85", "active_power_mw = 8.5"), "outside the swept region"),
        (('bus = "t1"', 'bus = "t11"'), "bad.toml: "),
        (('bus = "t1"', 'bus = "t11"'), "'t11' is no bus"),
        (("vn_lv_kv = 0.69", "vn_lv_kv = 690.0"), "kV and V mixed up"),
        (("[[source]]", "[[sauce]]"), "did you mean 'source'"),
        (("voltage_kv = 35.0", "voltage_kv ="), "not TOML"),
    ],
)
def test_a_wrong_farm_file_is_refused_in_one_line(folder, change, words):
    text = (EXAMPLE / "farm.toml").read_text("utf-8")
    (folder / "bad.toml").write_text(text.replace(*change), "utf-8")
    done = command("farm", folder / "bad.toml")
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_states_and_diagram_are_drawn(folder):
    more = (
        '\n[[state]]\nname = "weaker"\nsource_scale = [1.0, 1.8]\n\n[[state]]\nname = "out"\neach_out = ["collector"]\n'
    )
    (folder / "states.toml").write_text((EXAMPLE / "farm.toml").read_text("utf-8") + more, "utf-8")
    done = command("farm", folder / "states.toml", "--states", "-o", folder / "s.json", "--plot", folder / "s.svg")
    assert done.returncode == 0, done.stderr
    content = json.loads((folder / "s.json").read_text())
    jsonschema.validate(content, schema(of_states=True))
    states = content["states"]
    assert [len(state["devices"]) for state in states] == [3, 3, 3, 1]
    assert "weaker, 1.8 Z" in (folder / "s.svg").read_text()
    done = command("farm", folder / "farm.toml", "--diagram", folder / "d.svg")
    assert done.returncode == 0, done.stderr
    assert all(name in (folder / "d.svg").read_text() for name in ("wt1", "row, 35 kV", "source"))


def voltages(folder, farm):
    """Terminal voltages of the devices (V) that the command writes for a farm's file."""
    assert command("farm", folder / farm, "-o", folder / "v.json", "--force").returncode == 0
    return [device["terminal_voltage_v"] for device in json.loads((folder / "v.json").read_text())["devices"]]


@pytest.fixture(scope="module")
def own_voltages(folder):
    return voltages(folder, "farm.toml")


@pytest.mark.parametrize("name", ["network.json", "case.m"])
def test_a_farm_goes_to_other_tools_and_comes_back(folder, own_voltages, name):
    assert command("convert", folder / "farm.toml", "-o", folder / name).returncode == 0
    back = ["-o", folder / f"{name}.toml", "--table", "turbine.parquet"]
    done = command("convert", folder / name, *back)
    assert done.returncode == 0, done.stderr
    assert "reactive powers of generators are left out" in done.stderr
    # the set-point is the machine's power, the network has the PCC's
    assert voltages(folder, f"{name}.toml") == pytest.approx(own_voltages, rel=1e-3)


def test_a_network_that_is_none_is_refused(folder):
    (folder / "no.json").write_text("{}", "utf-8")
    done = command("convert", folder / "no.json", "-o", folder / "no.toml")
    assert done.returncode == 2
    assert "neither a network of pandapower" in done.stderr


def test_a_report_of_the_farm_alone_holds_diagram_advice_and_states(folder, advised):
    """No table beside it: the JSON of the farm has everything, that of its states is taken as well."""
    assert (
        command("farm", folder / "states of weak.toml", "--states", "-o", folder / "s.json", "--force").returncode == 0
    )
    (folder / "s.json").rename(folder / "all states.json")
    done = command("report", folder / "r.json", folder / "all states.json", "-o", folder / "r.html", "--force")
    assert done.returncode == 0, done.stderr
    page = (folder / "r.html").read_text("utf-8")
    content = json.loads((folder / "r.json").read_text())
    jsonschema.validate(content, schema())
    assert [branch["name"] for branch in content["network"]["branches"]][-1] == "source"
    for words in ("One-line diagram", "wt2", "Least norm", "one out, without wt1", "Of 2 switching states", "sha256"):
        assert words in page
    assert "6 % of damping with probability 0.95 holds" in page
    assert "seqsweep report r.json &#39;all states.json&#39; -o report.html" in page
    assert 'src="' not in page


def test_a_report_of_nothing_but_a_tuning_still_asks_for_its_table(tmp_path):
    (tmp_path / "t.json").write_text('{"format": "seqsweep-tuning"}')
    done = command("report", tmp_path / "t.json", "-o", tmp_path / "r.html")
    assert done.returncode == 2
    assert "needed is exactly one TABLE.parquet" in done.stderr
