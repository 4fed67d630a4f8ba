"""`seqsweep judge` as it is called: report, Parquet file, map, resumption, exit statuses."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.bank import table
from seqsweep.sweep.bank.judge import CHUNK, judge_bank
from seqsweep.sweep.bank.pairs import PairFile, severity
from seqsweep.sweep.bank.report import report_text
from seqsweep.sweep.bank.table import COLUMNS, write_judge
from seqsweep.sweep.run import shards
from seqsweep.tuning.bank.entries import bank_of
from seqsweep.tuning.bank.judgement import PairVerdict
from tests.support import oracle
from tests.support.commands import command

F1_HZ = 50.0
NU = np.geomspace(0.4, 1950.0, 80)
BASES = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}
FAMILY = """
voltage_kv = 0.69
rated_power_mw = 1.632
[family]
[[element]]
kind = "series_capacitor"
compensation_percent = { from = 0, to = 40, steps = 2 }
[[element]]
kind = "source"
scr = { from = 0.6, to = 4.0, steps = 20 }
x_over_r = 20
"""


def metadata(*op_ids: str) -> dict:
    """What a table has to say of itself."""
    points = [{"op_id": op_id, "active_power_mw": float(op_id[1:]), "terminal_voltage_pu": 1.0} for op_id in op_ids]
    return {
        "f1_hz": F1_HZ,
        "bases": BASES,
        "power_meaning": "at the PCC, out of the device",
        "operating_points": points,
        "configuration": {},
        "plant": {"id": "oracle"},
    }


def responses() -> list[FrequencyResponse]:
    found = []
    for power in (0.4, 0.65):
        y = oracle.admittance_pn(F1_HZ + NU, power * 1e6, 690.0)
        meta = {"op_id": f"p{power:g}", "stable_on": {"grid": "ideal", "basis": "stated"}}
        found.append(FrequencyResponse(F1_HZ + NU, y, F1_HZ, meta=meta))
    return found


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bank")
    (folder / "family.toml").write_text(FAMILY)
    return folder


@pytest.fixture(scope="module")
def undisturbed(bank: Path) -> list[PairVerdict]:
    """The verdicts of all pairs; the weakest has its elements varied."""
    return list(judge_bank(responses(), BASES, "digest", bank_of(bank), output=None, jobs=1, elements=2))


def same(verdicts: Iterable[PairVerdict]) -> list[PairVerdict]:
    """Without what the variation of elements adds."""
    return [replace(verdict, elements=()) for verdict in verdicts]


def test_a_run_that_was_ended_goes_on_where_it_was_and_gives_the_same(
    bank: Path, undisturbed: list[PairVerdict], tmp_path: Path
) -> None:
    entries = bank_of(bank)
    assert len(entries) == 40
    output, told = tmp_path / "judge.parquet", []

    def judged(report, **options):
        common = {"output": output, "jobs": 1, "elements": 0, "report": report}
        return judge_bank(responses(), BASES, "digest", entries, **{**common, **options})

    def interrupted(done: int, total: int) -> None:
        if done >= 2 * CHUNK:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        judged(interrupted)
    kept = shards.keys(shards.folder_of(output))
    assert len(kept) >= 1
    resumed = list(judged(lambda done, total: told.append((done, total))))
    assert told[0][0] > 0
    assert told[-1] == (80, 80)
    assert resumed == same(undisturbed)
    assert resumed == sorted(resumed, key=severity)


def test_the_report_says_how_many_and_which_is_the_weakest(undisturbed: list[PairVerdict]) -> None:
    verdicts = undisturbed
    text = report_text(verdicts, F1_HZ, 1000)
    names = {v.grid_id for v in verdicts}
    stable = sum(all(v.verdict == "stable" for v in verdicts if v.grid_id == name) for name in names)
    assert 0 < stable < 40
    assert f"Stable on {stable} of 40 grids at all 2 operating points" in text
    assert f"Weakest: grid {verdicts[0].grid_id} (series_capacitor1" in text
    assert "one element varied at a time" in text


def test_every_verdict_of_a_plain_line_is_that_of_the_linearised_device(undisturbed: list[PairVerdict]) -> None:
    """Members without compensation, by the eigenvalues of turbine and line."""
    plain = [v for v in undisturbed if v.parameters["series_capacitor1.compensation_percent"] == 0.0]
    assert len(plain) == 40
    for v in plain:
        z = 690.0**2 / (v.parameters["source1.scr"] * 1.632e6)
        x_ohm = z / np.sqrt(1.0 + 1.0 / 400.0)
        l_h = x_ohm / (2.0 * np.pi * F1_HZ)
        power_w = 1e6 * float(v.op_id[1:])
        poles = oracle.closed_loop_poles(power_w, x_ohm / 20.0, l_h, terminal_voltage_v=690.0)
        assert v.verdict in ("undecided", "stable" if poles.real.max() < 0.0 else "unstable")
        assert v.n_unstable == int(np.sum(poles.real > 0.0))
    assert sum(v.verdict == "undecided" for v in plain) <= 2


def test_the_command_writes_rows_as_documented_and_a_picture_and_tells_a_bad_grid(bank: Path, tmp_path: Path) -> None:
    table = tmp_path / "y.parquet"
    write_table(table, responses(), metadata("p0.4", "p0.65"))
    for file in bank.iterdir():
        (tmp_path / "grids").mkdir(exist_ok=True)
        (tmp_path / "grids" / file.name).write_text(file.read_text())
    (tmp_path / "grids" / "bad.csv").write_text("f,R\n1,2\n")
    output, picture = tmp_path / "judge.parquet", tmp_path / "map.png"
    said = command("judge", table, "--grids", tmp_path / "grids", "-o", output, "--plot", picture, "--jobs", "1")
    assert said.returncode == 1, said.stderr
    assert "bad.csv" in said.stdout
    rows = pq.read_table(output)
    assert rows.column_names == list(COLUMNS)
    assert rows.num_rows == 2 * 41
    assert json.loads(rows.schema.metadata[b"seqsweep"])["format"] == "seqsweep-judge"
    assert rows.column("status").to_pylist().count("failed") == 2
    assert picture.stat().st_size > 10_000
    assert not shards.folder_of(output).exists()


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("campaign.toml", "is a campaign, and seqsweep judge --grids needs a grid"),
        ("farm.toml", "is the network of a farm"),
        ("negative.toml", "not negative"),
    ],
)
def test_one_file_that_is_no_grid_is_a_wrong_call(file: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text('[plant]\nid = "branch-v1"\n')
    (tmp_path / "farm.toml").write_text('[[bus]]\nname = "a"\n')
    (tmp_path / "negative.toml").write_text('[[element]]\nkind = "series"\nr_ohm = -1.0\nx_ohm = 0.2\n')
    table = tmp_path / "y.parquet"
    write_table(table, responses(), metadata("p0.4", "p0.65"))
    said = command("judge", table, "--grids", tmp_path / file)
    assert said.returncode == 2
    assert words in said.stderr
    assert len(said.stderr.splitlines()) == 1


@pytest.mark.parametrize("what", ["nothing", "empty"])
def test_a_bank_that_is_none_ends_with_status_2(what: str, tmp_path: Path) -> None:
    table = tmp_path / "y.parquet"
    write_table(table, responses(), metadata("p0.4", "p0.65"))
    (tmp_path / "empty").mkdir()
    said = command("judge", table, "--grids", tmp_path / what)
    assert said.returncode == 2
    assert "Traceback" not in said.stderr


def test_pairs_lie_on_the_disk_and_are_read_the_worst_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An index of 29 bytes is what a pair costs in memory; several row groups hold what was put, in order."""
    monkeypatch.setattr(table, "ROW_GROUP", 400)
    rng = np.random.default_rng(3)
    grids, points = [f"grid {k}" for k in range(200)], ["a", "b", "c"]
    kinds = [("ok", "stable"), ("ok", "unstable"), ("ok", "undecided"), ("failed", "undecided")]
    file, expected = PairFile(tmp_path, grids, points), []
    for op in points:
        found = [
            PairVerdict(grid, op, *kinds[rng.integers(4)], reason=300 * "x", re_rad_s=float(rng.integers(5)))
            for grid in grids
        ]
        tracemalloc.start()
        file.add(found)
        assert tracemalloc.get_traced_memory()[0] < 1e4
        tracemalloc.stop()
        expected += found
    pairs = file.worst_first()
    assert list(pairs) == sorted(expected, key=severity)
    assert pairs[-2:] == list(pairs)[-2:]
    replaced = pairs.replacing({1: replace(pairs[1], reason="other")})
    write_judge(replaced, F1_HZ, tmp_path / "judge.parquet", {})
    written = pq.ParquetFile(tmp_path / "judge.parquet")
    assert written.num_row_groups == 2
    rows = written.read(columns=["grid_id", "op_id", "reason"]).to_pylist()
    assert rows == [{name: getattr(v, name) for name in rows[0]} for v in replaced]
