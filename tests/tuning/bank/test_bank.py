"""What a bank holds, and the judgement of one pair: edges against brute force, bad grids in rows of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.bank.edges import element_edges, scale_at_the_edge
from seqsweep.tuning.bank.entries import BankEntry, bank_of
from seqsweep.tuning.bank.judgement import judge_pair
from seqsweep.tuning.grids.elements import elements_grid, varied
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.tune import Device, fitted
from tests.support import oracle
from tests.support.networks import KINDS, impedance_of, near_critical, random_document, rightmost

F1_HZ = 50.0
NU = np.geomspace(0.4, 1950.0, 100)
BASES = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}
FAMILY = """
voltage_kv = 0.69
rated_power_mw = 1.632
[family]
{how}
[[element]]
kind = "shunt_capacitor"
q_mvar = 0.2
in_service = [true, false]
[[element]]
kind = "series_capacitor"
compensation_percent = {{ from = 0, to = 60, steps = 3 }}
[[element]]
kind = "source"
scr = [1.2, 3.0]
x_over_r = 20
"""


@pytest.fixture(scope="module")
def linear() -> oracle.Linear:
    return oracle.linearise(0.65e6, 690.0)


@pytest.fixture(scope="module")
def device() -> Device:
    y = oracle.admittance_pn(F1_HZ + NU, 0.65e6, 690.0)
    meta = {"op_id": "p065", "stable_on": {"grid": "ideal", "basis": "shots"}}
    return fitted(FrequencyResponse(F1_HZ + NU, y, F1_HZ, meta=meta))


@pytest.mark.parametrize("kind", KINDS)
def test_the_critical_scale_and_the_critical_value_of_each_element_put_a_pole_on_the_axis(
    kind: str, device: Device, linear: oracle.Linear
) -> None:
    """The truth at the edge: the tableau's rightmost pole, whose real part there is zero to a few 1e-4 rad/s."""
    case = near_critical(np.random.default_rng(8), linear, kind)
    model = device.model
    assert model is not None
    grid = elements_grid(case.document, F1_HZ).scaled(case.scale)
    scale = scale_at_the_edge(model, grid, int(np.sum(case.poles.real > 0.0)))
    assert scale is not None
    assert (scale > 1.0) == case.stable
    assert rightmost(linear, case.document, case.scale * scale) == pytest.approx(0.0, abs=2e-3)
    edges = element_edges(model, grid, case.stable)
    assert {e.element for e in edges} >= {"series1", "series2"}
    found = 0
    for at, edge in enumerate(edges):
        if edge.critical is not None:
            there = varied(case.document, at, edge.key, edge.critical)
            assert rightmost(linear, there, case.scale) == pytest.approx(0.0, abs=2e-3), edge
            found += 1
    assert found >= 1


def test_a_family_is_every_combination_or_so_many_drawn(tmp_path: Path) -> None:
    (tmp_path / "family.toml").write_text(FAMILY.format(how='combine = "all"'))
    every = bank_of(tmp_path / "family.toml")
    assert len(every) == 2 * 3 * 2
    assert every[0].parameters == {
        "shunt_capacitor1.in_service": True,
        "series_capacitor1.compensation_percent": 0.0,
        "source1.scr": 1.2,
    }
    assert all(entry.open(F1_HZ).at_f1.imag > 0.0 for entry in every[-2:])
    (tmp_path / "family.toml").write_text(FAMILY.format(how='combine = "random"\ncount = 30\nseed = 4'))
    drawn = bank_of(tmp_path / "family.toml")
    assert len(drawn) == 30
    percents = [entry.parameters["series_capacitor1.compensation_percent"] for entry in drawn]
    assert 0.0 <= min(percents) < max(percents) <= 60.0
    assert [e.parameters for e in drawn] == [e.parameters for e in bank_of(tmp_path / "family.toml")]


def test_one_parquet_file_holds_many_tables(tmp_path: Path, device: Device) -> None:
    f = np.geomspace(1.0, 2500.0, 40)
    rows: dict[str, list] = {"grid_id": [], "f_hz": [], "r_ohm": [], "x_ohm": []}
    documents = {name: random_document(np.random.default_rng(k), "filter") for k, name in enumerate("abc")}
    for name, document in documents.items():
        z = impedance_of(document, 2j * np.pi * f)
        rows["grid_id"] += [name] * len(f)
        rows["f_hz"] += f.tolist()
        rows["r_ohm"] += z.real.tolist()
        rows["x_ohm"] += z.imag.tolist()
    pq.write_table(pa.table(rows), tmp_path / "bank.parquet")
    entries = bank_of(tmp_path / "bank.parquet")
    assert [entry.grid_id for entry in entries] == ["a", "b", "c"]
    for entry in entries:
        assert entry.open(F1_HZ).at_f1 == pytest.approx(elements_grid(documents[entry.grid_id], F1_HZ).at_f1, rel=1e-6)
        assert judge_pair(device, entry, BASES).status == "ok"


def test_a_bad_grid_gets_a_row_with_the_reason_and_the_rest_goes_on(tmp_path: Path, device: Device) -> None:
    (tmp_path / "good.toml").write_text('[[element]]\nkind = "series"\nr_ohm = 0.012\nx_ohm = 0.25\n')
    (tmp_path / "bad.toml").write_text('[[element]]\nkind = "series"\nr_ohm = -0.012\nx_ohm = 0.25\n')
    (tmp_path / "worse.csv").write_text("nothing at all\n")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1")
    (tmp_path / "read.me").write_text("no grid")
    verdicts = {e.grid_id: judge_pair(device, e, BASES) for e in bank_of(tmp_path)}
    assert set(verdicts) == {"good.toml", "bad.toml", "worse.csv", "broken.parquet"}
    assert verdicts["good.toml"].verdict == "stable"
    assert {name for name, v in verdicts.items() if v.status == "failed"} == set(verdicts) - {"good.toml"}
    assert "not negative" in verdicts["bad.toml"].reason


def test_milliohm_taken_for_ohm_is_warned_about(device: Device) -> None:
    entry = BankEntry("x", document={"element": [{"kind": "series", "r_ohm": 12.0, "x_ohm": 250.0}]})
    assert any("is that its unit?" in text for text in judge_pair(device, entry, BASES).warnings)


def test_a_region_across_the_edge_is_undecided_and_one_within_is_decided(device: Device) -> None:
    def box(x_low: float, x_high: float) -> dict:
        edges = np.append(0.0, np.geomspace(2.0, 200.0, 60))
        bands = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        return {
            "region": [
                {"f_min_hz": a, "f_max_hz": b, "r_ohm": [0.005, 0.03], "x_ohm": [x_low * a / 50.0, x_high * b / 50.0]}
                for a, b in bands
            ]
        }

    inside = judge_pair(device, BankEntry("in", document=box(0.08, 0.12)), BASES)
    across = judge_pair(device, BankEntry("across", document=box(0.2, 0.45)), BASES)
    assert inside.verdict == "stable"
    assert across.verdict == "undecided"
    assert "some members of the region" in across.reason


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[family]\n[[element]]\nkind = "series"\nx_ohm = 0.2\n', "nothing is varied"),
        ('[family]\ncombine = "some"\n[[element]]\nkind = "series"\nx_ohm = [0.2]\n', "known are"),
        ('[family]\ncolour = 1\n[[element]]\nkind = "series"\nx_ohm = [0.2]\n', "is not known"),
        ('[family]\n[[element]]\nkind = "series"\nx_ohm = { start = 1 }\n', "a range has from"),
        ('[family]\n[[element]]\nkind = "series"\nx_ohm = { from = 0, to = 1, spacing = "log" }\n', "begins above 0"),
    ],
)
def test_families_that_are_none_are_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "family.toml").write_text(text)
    with pytest.raises(GridError, match=words):
        bank_of(tmp_path / "family.toml")


def test_an_empty_bank_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GridError, match="is empty"):
        bank_of(tmp_path)
    with pytest.raises(GridError, match="no such file"):
        bank_of(tmp_path / "nothing")


SPOILT = {
    "text.toml": 'kind = "series"\nr_ohm = "a"\nx_ohm = 1',
    "infinite.toml": 'kind = "series"\nr_ohm = inf\nx_ohm = 1',
    "number.toml": "kind = 3",
    "loop.toml": 'kind = "series"\nx_ohm = 1\nfrom = "pcc"\nto = "pcc"',
    "sections.toml": 'kind = "line"\nsections = 2.5\nlength_km = 5\nr_ohm_per_km = 0.1\nx_ohm_per_km = 0.1',
    "transformer.toml": 'kind = "transformer"\nsn_mva = 0\nvn_hv_kv = 1\nvn_lv_kv = 1\nvk_percent = 0',
}


def test_no_spoilt_file_raises_anything_but_a_refusal_in_its_own_row(tmp_path: Path, device: Device) -> None:
    junk = np.random.default_rng(0).integers(0, 256, 2000, dtype=np.uint8).tobytes()
    for suffix in ("csv", "mat", "s1p", "parquet", "json", "toml"):
        (tmp_path / f"junk.{suffix}").write_bytes(junk)
        (tmp_path / f"empty.{suffix}").write_bytes(b"")
    for name, text in SPOILT.items():
        (tmp_path / name).write_text(f"[[element]]\n{text}\n")
    (tmp_path / "region.toml").write_text('[[region]]\norder = 1\npoints = [[0, 1]]\n[member]\nr_ohm = "x"\n')
    (tmp_path / "family.toml").write_text('[family]\ncount = "x"\ncombine = "random"\n[[element]]\nx_ohm = [1]\n')
    verdicts = [judge_pair(device, entry, BASES) for entry in bank_of(tmp_path)]
    assert len(verdicts) == 12 + len(SPOILT) + 2
    assert {v.status for v in verdicts} == {"failed"}
    assert all(v.reason for v in verdicts)
