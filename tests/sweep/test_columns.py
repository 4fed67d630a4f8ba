"""Every command in a pipe or on a terminal of 80 columns: no line is wider, and no column is lost in silence."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.cli.commands import COMMANDS
from seqsweep.sweep.cli.main import _status
from seqsweep.tuning.layout import folded, labelled

from ..support import oracle
from ..support.commands import TOP, campaign, without_pictures

WIDTH = 80
F1_HZ = 50.0
NU = np.geomspace(0.4, 1950.0, 60)
EXAMPLES, DATA = TOP / "examples", TOP / "data"
REGION = """
[campaign]
name = "region"
[plant]
id = "branch-v1"
[sweep]
f_min_hz = 3.0
f_max_hz = 500.0
points = 8
probes = 0
[sweep.operating_points]
active_power_mw = [0.1, 0.3]
terminal_voltage_pu = [0.95, 1.05]
tolerance = 5e-3
"""

FOR_PROGRAMS = {"completion", "man"}
"""Commands whose output no terminal shows: a shell reads it, or man."""

CALLS = {
    "init": ["init", "-o", "new.toml"],
    "plan": ["plan", EXAMPLES / "table1.toml", "--jobs", "1"],
    "plan of many points": ["plan", EXAMPLES / "grids" / "powers.toml", "--jobs", "1"],
    "run": ["run", "campaign.toml", "-o", "run.parquet", "--jobs", "1", "--set", "sweep.points=4"],
    "run a region": ["run", "region.toml", "-o", "r.parquet", "--jobs", "1", "--force"],
    "show": ["show", "turbine.parquet"],
    "validate": ["validate", "turbine.parquet"],
    "validate something else": ["validate", "campaign.toml"],
    "tune": ["tune", "turbine.parquet", "--grid", "0.012+0.25j", "-o", "tuning.json", "--force"],
    "tune at several scales": ["tune", "turbine.parquet", "--grid", "0.012+0.25j", "--scale", "0.5,1,2.5"],
    "tune a strange unit": ["tune", "turbine.parquet", "--grid", "12+250j"],
    "judge": ["judge", "turbine.parquet", "--grids", "bank", "--jobs", "1", "--elements", "3"],
    "judge one": ["judge", "turbine.parquet", "--grids", "loci.toml", "--jobs", "1"],
    "verify": ["verify", "tuning.json", "--op", "a_turbine_with_a_rather_long_name"],
    "grid": ["grid", EXAMPLES / "grid.toml", "--op", "table1", "--duration-s", "0.4"],
    "surrogate": ["surrogate", "farm/turbine.parquet", "--at", "0.5,0,1.0", "--grid", "0.012+0.25j", "-o", "s.parquet"],
    "surrogate outside": ["surrogate", "farm/turbine.parquet", "--at", "3,0,1.0"],
    "farm without its table": ["farm", EXAMPLES / "farm" / "farm.toml"],
    "farm": ["farm", "farm/farm.toml"],
    "farm states": ["farm", "farm/farm.toml", "--states"],
    "farm powers": ["farm", "farm/farm.toml", "--by", "power", "--damping", "10"],
    "convert": ["convert", "farm/farm.toml", "-o", "case.m", "--force"],
    "report": ["report", "turbine.parquet", "tuning.json", "-o", "report.html", "--force"],
    "merge": ["merge", "turbine.parquet", "turbine.parquet", "-o", "merged.parquet", "--force"],
    "compare": ["compare", "turbine.parquet", "turbine.parquet"],
    "metrics": ["metrics", "turbine.parquet"],
    "metrics behind a grid": ["metrics", "turbine.parquet", "--behind", "0.012+0.25j"],
    "check": ["check", "branch-v1"],
    "check a module": ["check", EXAMPLES / "step_plant.py"],
    "check nothing": ["check", "dpmsg-v7"],
    "identify": ["identify", DATA / "csv", "--direction", "load", "-o", "recorded.parquet", "--jobs", "1", "--force"],
    "inject": ["inject", "campaign.toml", "-o", "played", "--op", "p0"],
    "export": ["export", "turbine.parquet", "-o", "turbine.csv", "--force"],
    "import": ["import", EXAMPLES / "grids" / "scan.csv", "-o", "imported.parquet"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of two operating points of the turbine, of a region, of a farm; campaigns and a bank."""
    folder = tmp_path_factory.mktemp("c")
    campaign(folder, plant="branch-v1", powers=(0.0,), n=8)
    (folder / "region.toml").write_text(REGION)
    write_turbine(folder / "turbine.parquet")
    (folder / "bank").mkdir()
    shutil.copy(EXAMPLES / "grids" / "scan.csv", folder / "bank")
    family = (EXAMPLES / "grids" / "family.toml").read_text("utf-8")
    family = family.replace("steps = 10", "steps = 3").replace("[5, 10, 20, 30, 40]", "20")
    (folder / "bank" / "family.toml").write_text(family, "utf-8")
    (folder / "bank" / "a_file_with_a_long_name_that_is_no_grid_at_all.csv").write_text("f,R\n1,2\n")
    regions = (EXAMPLES / "grids" / "loci.toml").read_text("utf-8").split("[[region]]")
    (folder / "loci.toml").write_text("[[region]]".join(regions[:5]), "utf-8")
    shutil.copytree(EXAMPLES / "farm", folder / "farm")
    return folder


def write_turbine(path: Path) -> None:
    """Two operating points by the exact linearisation, one with a long name."""
    names = {"a_turbine_with_a_rather_long_name": 0.65, "b": 0.4}
    responses, points = [], []
    for op_id, power in names.items():
        meta = {"op_id": op_id, "stable_on": {"grid": "ideal", "basis": "stated"}}
        y = oracle.admittance_pn(F1_HZ + NU, power * 1e6, 690.0)
        covariance = np.tile(np.eye(8) * (1e-3 * np.abs(y).max()) ** 2, (len(NU), 1, 1))
        responses.append(FrequencyResponse(F1_HZ + NU, y, F1_HZ, covariance=covariance, meta=meta))
        points.append({"op_id": op_id, "active_power_mw": power, "terminal_voltage_pu": 1.0})
    text = {
        "campaign": {"name": "turbine"},
        "plant": {"id": "dpmsg-v1"},
        "operating_point": [{"id": n, "active_power_mw": p, "terminal_voltage_pu": 1.0} for n, p in names.items()],
    }
    meta = {
        "f1_hz": F1_HZ,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6},
        "power_meaning": "at the PCC, out of the device",
        "operating_points": points,
        "configuration": text,
        "plant": {"id": "dpmsg-v1"},
    }
    write_table(path, responses, meta)


@pytest.fixture(scope="module")
def made(folder: Path) -> Callable[[str], None]:
    """Makes, once, what a command reads that another command writes."""
    region = ["run", "farm/turbine.toml", "-o", "farm/turbine.parquet", "--jobs", "1"]
    quick = ["--set", "sweep.points=16", "--set", "sweep.probes=0", "--set", "sweep.operating_points.tolerance=5e-2"]
    needs = {
        **dict.fromkeys(("verify", "report"), ("tuning.json", CALLS["tune"])),
        **dict.fromkeys(
            ("surrogate", "surrogate outside", "farm", "farm states", "farm powers", "convert"),
            ("farm/turbine.parquet", [*region, *quick]),
        ),
    }

    def make(name: str) -> None:
        if name in needs and not (folder / needs[name][0]).exists():
            _run(needs[name][1], pytest.MonkeyPatch())

    return make


def _run(arguments: list, patch: pytest.MonkeyPatch) -> int:
    with patch.context() as within:
        within.setattr(sys, "argv", ["seqsweep", *map(str, arguments)])
        return _status()


def too_wide(text: str) -> list[str]:
    """Lines that have more than one word beyond the edge: a word, such as a path, is never broken."""
    return [line for line in text.splitlines() if len(line) > WIDTH and len(line.split()) > 1]


def test_every_command_is_called_here() -> None:
    assert {call[0] for call in CALLS.values()} == set(COMMANDS) - FOR_PROGRAMS


@pytest.mark.parametrize("name", CALLS)
def test_no_line_is_wider_than_the_terminal(
    name: str, folder: Path, made: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(folder)
    made(name)
    capsys.readouterr()
    with without_pictures():
        status = _run(CALLS[name], monkeypatch)
    said = capsys.readouterr()
    assert status in (0, 1, 2), said.err
    assert said.out or said.err
    assert too_wide(said.out) == []
    assert too_wide(said.err) == []


ALONE = [(name, []) for name in sorted(set(COMMANDS) - FOR_PROGRAMS)]
ASKED_FOR_HELP = [(name, ["--help"]) for name in sorted(COMMANDS)]
MISCALLED = [(name, ["--no-such-option-in-all-the-world-and-beyond=1"]) for name in sorted(COMMANDS)]


@pytest.mark.parametrize(("name", "arguments"), [*ASKED_FOR_HELP, *MISCALLED, *ALONE])
def test_no_help_and_no_complaint_is_wider(
    name: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _run([name, *arguments], monkeypatch) in (0, 2)
    said = capsys.readouterr()
    assert too_wide(said.out + said.err) == []


def test_a_fold_breaks_no_word_and_loses_none() -> None:
    path = "/a/very/long/path/" + "x" * 90
    text = f"  {path}: no such file, and a sentence that is longer than any terminal is wide, by 12.5 % or more"
    lines = folded(text, WIDTH).split("\n")
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
    assert path in lines[0]
    assert all(line.startswith("    ") for line in lines[1:])
    assert not any(line.strip().startswith("%") for line in lines)


def test_labels_keep_their_texts_apart() -> None:
    text = labelled([("short", "word " * 30), ("a longer one", "x")], WIDTH)
    lines = text.split("\n")
    assert all(len(line) <= WIDTH for line in lines)
    assert all(line.startswith(" " * 14) for line in lines[1:-1])
    assert lines[-1] == "a longer one  x"
