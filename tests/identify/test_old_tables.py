"""Tables that earlier versions wrote are read for ever: the files in `old_tables` are theirs and are never made anew.

All were written by `seqsweep run` of the same campaign on the R-L branch, by the state of this repository in which the
format had the version in the file's name; ``1.0.0-first`` is from the day when the format was laid down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.registry import make_plant
from seqsweep.plant.rl_branch import admittance

from ..support.commands import command

TABLES = sorted((Path(__file__).parent / "old_tables").glob("*.parquet"))


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


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
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
