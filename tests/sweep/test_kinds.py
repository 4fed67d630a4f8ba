"""Every command with every kind of file: what it does not take is named for what it is, with the command that does."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.cli import kinds
from seqsweep.sweep.cli.commands import COMMANDS
from seqsweep.sweep.cli.shared import WrongInput

from ..support.commands import TOP, command

EXAMPLES = TOP / "examples"
COPIES = {
    "campaign.toml": EXAMPLES / "table1.toml",
    "region.toml": EXAMPLES / "region.toml",
    "farm.toml": EXAMPLES / "farm" / "farm.toml",
    "story.toml": EXAMPLES / "farm" / "story.toml",
    "grid.toml": EXAMPLES / "grids" / "compensated.toml",
    "loci.toml": EXAMPLES / "grids" / "loci.toml",
    "family.toml": EXAMPLES / "grids" / "family.toml",
    "profile.toml": TOP / "sweep" / "report" / "handover" / "profiles" / "scan.toml",
    "recording.csv": TOP / "data" / "csv" / "direct.csv",
    "manifest.json": TOP / "data" / "manifest.json",
    "picture.png": TOP / "docs" / "figures" / "report.png",
    "plant.py": EXAMPLES / "step_plant.py",
}
FORMATS = {
    "tuning.json": "seqsweep-tuning",
    "verify.json": "seqsweep-verification",
    "metrics.json": "seqsweep-metrics",
    "farm.json": "seqsweep-farm",
    "probed.json": "seqsweep-grid",
}
EXPECTED = {
    "campaign.toml": kinds.CAMPAIGN,
    "region.toml": kinds.CAMPAIGN,
    "farm.toml": kinds.FARM,
    "story.toml": kinds.SCENARIO,
    "grid.toml": kinds.GRID,
    "loci.toml": kinds.GRID,
    "family.toml": kinds.FAMILY,
    "profile.toml": kinds.PROFILE,
    "recording.csv": kinds.TEXT,
    "manifest.json": kinds.MANIFEST,
    "picture.png": kinds.PICTURE,
    "plant.py": kinds.DEVICE,
    "tuning.json": kinds.TUNING,
    "verify.json": kinds.VERIFICATION,
    "metrics.json": kinds.METRICS,
    "farm.json": kinds.FARM_RESULT,
    "probed.json": kinds.PROBED,
    "report.html": kinds.PAGE,
    "y.parquet": kinds.TABLE,
    "surrogate.parquet": kinds.SURROGATE,
    "judge.parquet": kinds.JUDGED,
    "folder": kinds.FOLDER,
    "empty.toml": kinds.EMPTY,
    "empty.parquet": kinds.EMPTY,
}
REST = {
    "tune": ["y.parquet"],
    "judge": ["y.parquet"],
    "metrics": ["y.parquet"],
    "verify": ["tuning.json"],
    "report": ["y.parquet"],
    "identify": ["recording.csv"],
}
"""What stands before an option."""

NEEDED = {
    "tune": ["--grid", "0.01+0.2j"],
    "judge": ["--grids", "grid.toml"],
    "compare": ["y.parquet"],
    "inject": ["--format", "csv", "-o", "new"],
    **{name: ["-o", "new.parquet"] for name in ("run", "merge", "identify", "import")},
    "export": ["-o", "new.csv"],
    "report": ["-o", "new.html"],
    "convert": ["-o", "new.toml"],
}
"""What a command does not do without."""

CASES = [
    pytest.param(name, parameter, id=f"{name} {need.option}".rstrip())
    for name, needs in kinds.NEEDS.items()
    for parameter, need in needs.items()
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of every kind."""
    folder = tmp_path_factory.mktemp("kinds")
    for name, source in COPIES.items():
        shutil.copy(source, folder / name)
    for name, form in FORMATS.items():
        (folder / name).write_text(json.dumps({"format": form, "version": "1.0.0"}))
    (folder / "report.html").write_text("<!DOCTYPE html>\n<title>A report</title>")
    (folder / "folder").mkdir()
    for name in ("empty.toml", "empty.parquet"):
        (folder / name).touch()
    f_hz = np.geomspace(1.0, 1000.0, 8)
    point = {"op_id": "p", "active_power_mw": 0.0, "terminal_voltage_pu": 1.0}
    meta = {
        "f1_hz": 50.0,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1e6},
        "power_meaning": "",
        "operating_points": [point],
        "configuration": {},
        "plant": {"id": "branch"},
    }
    response = FrequencyResponse(f_hz, np.tile(np.eye(2, dtype=complex), (8, 1, 1)), 50.0, meta=point)
    write_table(folder / "y.parquet", [response], meta)
    for name, about in (
        ("surrogate.parquet", {"format": "seqsweep-admittance", "surrogate": {"terms": 3}}),
        ("judge.parquet", {"format": "seqsweep-judge"}),
    ):
        columns = pa.table({"x": [1.0]}).replace_schema_metadata({"seqsweep": json.dumps(about)})
        pq.write_table(columns, folder / name)
    return folder


def test_every_kind_is_told_from_its_content(folder: Path) -> None:
    assert {name: kinds.kind_of(folder / name) for name in EXPECTED} == EXPECTED
    assert kinds.kind_of(folder / "missing.toml") is None


def test_what_cannot_be_told_is_left_to_its_reader(tmp_path: Path) -> None:
    for name, content in (
        ("a.toml", b"[campaign\n"),
        ("b.json", b"[1, 2"),
        ("c.parquet", b"PAR1 and no more"),
        ("d.toml", b"\xff\xfe"),
        ("e", b"whatever it is"),
    ):
        (tmp_path / name).write_bytes(content)
        assert kinds.kind_of(tmp_path / name) is None, name


def test_every_command_that_reads_a_file_says_what_it_takes() -> None:
    assert set(COMMANDS) - set(kinds.NEEDS) == {"init", "completion", "man"}


@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_every_wrong_kind_is_named_with_the_way_out(name: str, parameter: str, folder: Path) -> None:
    need = kinds.NEEDS[name][parameter]
    for file, kind in EXPECTED.items():
        if kind in need.kinds:
            kinds.refuse_others(name, {parameter: folder / file})
            continue
        with pytest.raises(WrongInput) as refused:
            kinds.refuse_others(name, {parameter: folder / file})
        said = str(refused.value)
        assert said.startswith(f"{folder / file} is {kind}, and seqsweep {name}"), said
        assert need.words in said
        known = kind in (kinds.FOLDER, kinds.EMPTY)
        assert known or "no command reads it" in said or "take it" in said or "takes it" in said


@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_the_command_itself_refuses_in_one_line_and_writes_nothing(
    name: str, parameter: str, folder: Path, tmp_path: Path
) -> None:
    need = kinds.NEEDS[name][parameter]
    wrong = "picture.png" if kinds.CAMPAIGN in need.kinds else "campaign.toml"
    fixed = {"new", "new.parquet", "new.csv", "new.html", "new.toml"}
    call = [*REST[name], need.option, wrong] if need.option else [wrong]
    call += [] if need.option in NEEDED.get(name, []) and need.option else NEEDED.get(name, [])
    placed = [tmp_path / word if word in fixed else folder / word if word in EXPECTED else word for word in call]
    done = command(name, *placed)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert f"{wrong} is {EXPECTED[wrong]}" in done.stderr
    assert list(tmp_path.iterdir()) == []
