"""Reports of many: a bank of operating points and grids, a farm, a surrogate; worst first, the rest folded."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from seqsweep.sweep.report.handover.bank import Bank, read_bank, sentence_of
from seqsweep.sweep.report.handover.inputs import read_inputs
from seqsweep.sweep.report.handover.page import MOST, page

from ..support.commands import without_pictures

TOP = Path(__file__).parents[2]


def benchmark():
    """The module that makes tables and banks of any size."""
    spec = importlib.util.spec_from_file_location("report_benchmark", TOP / "benchmarks" / "report.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, make = tmp_path_factory.mktemp("many"), benchmark()
    make.table(folder / "y.parquet", 60, 12)
    make.bank(folder / "j.parquet", 60, 30)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _words_alone():
    with without_pictures():
        yield


@pytest.fixture(scope="module")
def text(folder):
    return page(read_inputs([folder / "y.parquet", folder / "j.parquet"]))


def rows_of(text, region):
    table = text[text.index(f'aria-label="{region}"') :]
    return re.findall(r"<tr><th scope=\"row\">(.*?)</tr>", table[: table.index("</table>")], re.DOTALL)


def test_the_worst_pairs_come_first_and_the_rest_is_folded(folder, text):
    bank = read_bank(folder / "j.parquet", {})
    shown = rows_of(text, "The worst pairs")
    assert len(shown) == MOST
    growth = bank.columns["re_rad_s"]
    worst = int(np.argmax(growth))
    assert bank.columns["grid_id"][worst] in shown[0]
    assert bank.columns["op_id"][worst] in shown[0]
    assert len(rows_of(text, "By operating point")) == 60
    assert len(rows_of(text, "By grid")) == 30
    assert text.count("<details") >= 4


def test_counts_by_operating_point_add_up(folder):
    bank = read_bank(folder / "j.parquet", {})
    for column, n in (("op_id", 30), ("grid_id", 60)):
        rows = bank.by(column)
        assert all(sum(row["counts"]) == n for row in rows)
        assert sum(row["counts"][0] for row in rows) == bank.counts["unstable"]
        unstable = [row["counts"][0] > 0 for row in rows]
        assert unstable == sorted(unstable, reverse=True)


def test_the_bank_in_a_sentence():
    columns = {
        name: np.array(["a", "a", "b"] if name == "grid_id" else ["p", "q", "p"])
        for name in ("grid_id", "op_id", "status")
    }
    numbers = {name: np.zeros(3) for name in ("probability", "margin_m", "mode_lower_hz", "mode_upper_hz", "damping")}
    bank = Bank({}, {**columns, **numbers, "verdict": np.array(["stable", "undecided", "unstable"]),
                     "re_rad_s": np.array([-1.0, np.nan, 2.0]), "critical_scale": np.ones(3)})  # fmt: skip
    assert sentence_of(bank) == (
        "On the bank of grids: stable on 1 of 3 pairs of grid and operating point, 1 unstable and 1 undecided; the "
        "weakest is grid b at p."
    )


def test_many_operating_points_are_folded(text):
    assert len(rows_of(text, "Operating points")) == MOST
    assert len(rows_of(text, "Further operating points")) == 60 - MOST


def test_farm_and_surrogate_have_their_sections(tmp_path, folder):
    farm = {
        "format": "seqsweep-farm", "warnings": ["wt2: its voltage is off"],
        "devices": [{"name": "wt1", "bus": "t1", "active_power_out_w": 8.5e5, "reactive_power_out_var": 8e4,
                     "terminal_voltage_v": 725.9}],
        "verdict": "unstable", "reason": "a mode grows",
        "modes": [{"seen_at_hz": [22.0, 78.0], "sigma_per_s": 3.0, "sigma_half_95_per_s": 0.1, "damping": -0.02,
                   "devices": {"wt1": {"share": 0.7}, "wt2": {"share": 0.3}}}],
    }  # fmt: skip
    (tmp_path / "f.json").write_text(json.dumps(farm))
    found = page(read_inputs([folder / "y.parquet", tmp_path / "f.json"]))
    assert "The farm is unstable: a mode grows." in found
    assert "wt1 70 %, wt2 30 %" in found
    assert "<td>0.85</td><td>0.08</td><td>725.9</td>" in found
    assert "wt2: its voltage is off" in found
    assert 'class="answer unstable"' in found


def test_a_surrogate_is_table_and_surrogate_at_once(tmp_path, folder):
    from seqsweep.identify.surrogate.store import write_surrogate
    from seqsweep.identify.surrogate.surrogate import build_surrogate
    from seqsweep.identify.table.read import read_table

    content = read_table(folder / "y.parquet")
    write_surrogate(tmp_path / "s.parquet", build_surrogate(content.responses[:12]), content)
    inputs = read_inputs([tmp_path / "s.parquet"])
    assert [file.kind for file in inputs.files] == ["table and surrogate"]
    found = page(inputs)
    assert "Any operating point" in found
    assert "95 % radius" in found
    both = read_inputs([folder / "y.parquet", tmp_path / "s.parquet"])
    assert [file.kind for file in both.files] == ["table", "surrogate"]


@pytest.mark.evidence
def test_the_papers_case_takes_less_than_5_s_and_a_thousand_points_on_four_hundred_grids_less_than_30_s():
    """Seconds of CPU, start of Python included: on a quiet machine they are those of the clock, printed beside them."""
    done = subprocess.run(
        [sys.executable, TOP / "benchmarks" / "report.py"], capture_output=True, text=True, check=True
    )
    print(done.stdout)
    found = re.findall(r"^report of .*, ([\d.]+) s of CPU, ([\d.]+) MB$", done.stdout, re.MULTILINE)
    (case_s, case_mb), (many_s, many_mb) = [(float(s), float(mb)) for s, mb in found]
    assert case_s < 5.0
    assert many_s < 30.0
    assert max(case_mb, many_mb) < 3.0
