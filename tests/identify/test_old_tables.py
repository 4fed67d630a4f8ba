"""Tables that earlier versions wrote are read for ever: the files in `old_tables` are theirs and are never made anew.

All were written by `seqsweep run` of the same campaign on the R-L branch, by the state of this repository in which the
format had the version in the file's name; ``1.0.0-first`` is from the day when the format was laid down. In the folder
``0.1`` are files of every other kind that version 0.1 of the program wrote: tables merged, imported, recorded (of
``data/csv``) and of a surrogate, and what commands wrote of ``1.1.0.parquet`` and, the farm, of the recorded table.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.registry import make_plant
from seqsweep.plant.rl_branch import admittance

from ..support.commands import command

ARCHIVE = Path(__file__).parent / "old_tables"
TABLES = sorted(ARCHIVE.glob("*.parquet"))
KINDS = ARCHIVE / "0.1"
TRUTH = Path(__file__).parents[2] / "data" / "truth.json"


def test_the_archive_holds_every_version_so_far():
    assert {path.stem.partition("-")[0] for path in TABLES} == {"1.0.0", "1.1.0"}


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_an_old_table_has_the_values_and_errors_that_it_always_had(path):
    table = read_table(path)
    assert table.meta["version"] == path.stem.partition("-")[0]
    assert [response.meta["op_id"] for response in table.responses] == ["p065", "p020"]
    branch = make_plant("branch-v1")
    for response in table.responses:
        exact = admittance(branch, response.f_hz)
        off = np.linalg.norm(response.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
        assert len(response.f_hz) == 6
        assert np.max(off) < 1e-5  # the agreement that its campaign asked of successive windows
        assert set(response.status) == {"ok"}


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.evidence] if path.stem == "1.0.0" else [], id=path.stem) for path in TABLES],
)
def test_the_commands_take_an_old_table(path, tmp_path):
    for words in (
        ("validate", path),
        ("show", path, "--plot", tmp_path / "y.png"),
        ("tune", path, "--grid", "0.012+0.25j", "--op", "p065", "-o", tmp_path / "t.json"),
        ("export", path, "-o", tmp_path / "y.csv"),
    ):
        done = command(*words)
        assert done.returncode in (0, 1), (words, done.stderr)
        assert "Traceback" not in done.stderr


def largest_error(response, exact):
    """Of the rows, relative, over the largest singular value."""
    return np.max(np.linalg.norm(response.y - exact, 2, axis=(1, 2)) / np.linalg.norm(exact, 2, axis=(1, 2)))


@pytest.mark.parametrize(("name", "n_points"), [("merged", 2), ("imported", 1), ("surrogate", 6)])
def test_an_old_table_of_another_kind_has_the_values_that_it_always_had(name, n_points):
    table, branch = read_table(KINDS / f"{name}.parquet"), make_plant("branch-v1")
    assert len(table.responses) == n_points
    for response in table.responses:
        assert largest_error(response, admittance(branch, response.f_hz)) < 1e-5
        assert set(response.status) == {"ok"}


def test_an_old_recorded_table_has_the_values_that_it_always_had():
    (response,) = read_table(KINDS / "recorded.parquet").responses
    truth = sorted(json.loads(TRUTH.read_text("utf-8"))["y"], key=lambda row: row["f_hz"])
    y = [[[complex(*row[element]) for element in line] for line in (("pp", "pn"), ("np", "nn"))] for row in truth]
    np.testing.assert_allclose(response.f_hz, [row["f_hz"] for row in truth], rtol=1e-6)
    assert largest_error(response, np.array(y)) < 1e-3


def test_an_old_surrogate_speaks_for_the_whole_region(tmp_path):
    done = command("surrogate", KINDS / "surrogate.parquet", "--at", "0.5,0,1", "-o", tmp_path / "y.parquet")
    assert done.returncode == 0, done.stderr
    (response,) = read_table(tmp_path / "y.parquet").responses
    assert largest_error(response, admittance(make_plant("branch-v1"), response.f_hz)) < 1e-5


def test_an_old_grid_is_a_grid():
    done = command("tune", KINDS / "recorded.parquet", "--grid", KINDS / "grid.json")
    assert done.returncode == 0, done.stderr
    assert "0.012 + j0.25 ohm at 50 Hz" in done.stdout


@pytest.mark.parametrize(
    "files",
    [
        [TABLES[-1], *(KINDS / name for name in ("tuning.json", "metrics.json", "judged.parquet"))],
        [KINDS / "farm.json"],
    ],
    ids=["of one device", "of a farm"],
)
def test_old_results_make_a_report(files, tmp_path):
    done = command("report", *files, "-o", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
