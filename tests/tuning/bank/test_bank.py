"""What a bank holds, and the judgement of one pair: edges against brute force, bad grids in rows of their own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.bank.edges import element_edges, scale_at_the_edge
from seqsweep.tuning.bank.entries import BankEntry, bank_of, check_single, read_bank
from seqsweep.tuning.bank.judgement import judge_pair
from seqsweep.tuning.grids.elements import elements_grid, varied
from seqsweep.tuning.grids.errors import GridError, NotAGrid
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


def test_a_folder_is_one_bank_and_its_sub_folders_are_named(tmp_path: Path) -> None:
    line = '[[element]]\nkind = "series"\nr_ohm = 0.012\nx_ohm = 0.25\n'
    (tmp_path / "near.toml").write_text(line)
    for name in ("summer", "winter"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "far.toml").write_text(line)
    bank = read_bank(tmp_path)
    assert [entry.grid_id for entry in bank.entries] == ["near.toml"]
    assert any("2 sub-folders (summer, winter)" in remark for remark in bank.remarks)
    (tmp_path / "near.toml").unlink()
    with pytest.raises(GridError, match=r"the bank is empty; left out: 2 sub-folders"):
        read_bank(tmp_path)
    assert [entry.grid_id for entry in bank_of(tmp_path / "summer")] == ["far.toml"]


@pytest.mark.parametrize(
    ("voltage_kv", "refused"), [(0.69, False), (0.6, False), (6.9, True), (690.0, True), (0.00069, True)]
)
def test_a_grid_at_quite_another_voltage_than_the_device_s_is_refused(
    voltage_kv: float, refused: bool, device: Device
) -> None:
    entry = BankEntry("x", document={"voltage_kv": voltage_kv, "element": [LINE]})
    found = judge_pair(device, entry, BASES)
    assert (found.status == "failed") == refused
    assert ("rated 0.69 kV" in found.reason) == refused


def test_a_scan_at_none_of_the_device_s_frequencies_is_refused(tmp_path: Path, device: Device) -> None:
    """As where GHz are read for Hz: the function that fits it says nothing of the band that decides."""
    place = scan(lambda f, z: (f * 1e6, z), tmp_path / "z.csv")
    found = judge_pair(device, bank_of(place)[0], BASES)
    assert found.status == "failed"
    assert "they have no frequency in common" in found.reason


def test_milliohm_taken_for_ohm_is_warned_about(device: Device) -> None:
    entry = BankEntry("x", document={"element": [{"kind": "series", "r_ohm": 12.0, "x_ohm": 250.0}]})
    assert any("is that its unit?" in text for text in judge_pair(device, entry, BASES).warnings)


def test_a_region_across_the_edge_is_undecided_and_one_within_is_decided(device: Device) -> None:
    def box(x_low: float, x_high: float) -> dict:
        edges = np.append(0.0, np.geomspace(2.0, 200.0, 30))
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


def test_files_of_other_kinds_are_named_and_are_no_grids(tmp_path: Path) -> None:
    """A campaign, a farm, a manifest and the device's own table beside one grid; a table of another device is taken."""
    (tmp_path / "line.toml").write_text('[[element]]\nkind = "series"\nr_ohm = 0.012\nx_ohm = 0.25\n')
    (tmp_path / "campaign.toml").write_text('[plant]\nid = "branch-v1"\n[sweep]\npoints = 5\n')
    (tmp_path / "farm.toml").write_text('[[bus]]\nname = "a"\n[[source]]\nbus = "a"\n')
    (tmp_path / "manifest.json").write_text('{"format": "seqsweep-manifest"}')
    for name in ("own", "other"):
        pq.write_table(pa.table({"op_id": ["p"], "y_pp_re": [1.0]}), tmp_path / f"{name}.parquet")
    bank = read_bank(tmp_path, tmp_path / "own.parquet")
    assert [entry.grid_id for entry in bank.entries] == ["line.toml", "other.parquet#p"]
    said = " ".join(bank.remarks)
    for words in (
        "campaign.toml is a campaign, not a grid",
        "farm.toml is the network of a farm",
        "manifest.json is no grid: its format is seqsweep-manifest",
        "own.parquet is the device's own table",
        "other.parquet is a table of seqsweep: its operating point was taken for a measured source",
    ):
        assert words in said
    check_single(bank, F1_HZ)
    for name in ("campaign.toml", "farm.toml", "manifest.json"):
        with pytest.raises(NotAGrid, match=r"not a grid|no grid"):
            check_single(read_bank(tmp_path / name), F1_HZ)


def scan(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], place: Path, n: int = 60) -> Path:
    """A file with Z(f) of a compensated line that has been changed."""
    document = {"element": [LINE, {"kind": "series_capacitor", "x_ohm": 0.05}]}
    f = np.geomspace(1.0, 2500.0, n)
    f, z = change(f, impedance_of(document, 2j * np.pi * f))
    lines = [f"{a:.17g},{b.real:.17g},{b.imag:.17g}" for a, b in zip(f, z, strict=True)]
    place.write_text("f [Hz],R [ohm],X [ohm]\n" + "\n".join(lines))
    return place


LINE = {"kind": "series", "r_ohm": 0.012, "x_ohm": 0.25}
BAD_TABLES = {
    "an angle turned round": (lambda f, z: (f, -z.conj()), "the resistance is negative at"),
    "the conjugate of a line": (lambda f, z: (f, 0.012 - 0.005j * f), "the reactance is negative at all 60 rows"),
    "an active stretch": (lambda f, z: (f, z - 0.1 * np.exp(-((f - 300.0) ** 2) / 5e3)), "negative at"),
    "rows that contradict each other": (lambda f, z: (np.append(f, f[9]), np.append(z, 2.0 * z[9])), "contradict"),
    "noise alone": (
        lambda f, z: (f, z * np.exp(0.3j * np.random.default_rng(1).standard_normal(len(f)))),
        "no rational function",
    ),
    "too few rows": (lambda f, z: (f[:5], z[:5]), "needs at least"),
}


@pytest.mark.parametrize("kind", BAD_TABLES)
def test_a_table_that_is_no_passive_grid_is_refused_in_one_message(kind: str, tmp_path: Path) -> None:
    change, words = BAD_TABLES[kind]
    with pytest.raises(GridError, match=words) as refused:
        bank_of(scan(change, tmp_path / "z.csv"))[0].open(F1_HZ)
    assert "z.csv" in str(refused.value)


def test_rows_that_are_there_twice_count_once(tmp_path: Path, device: Device) -> None:
    once = judge_pair(device, bank_of(scan(lambda f, z: (f, z), tmp_path / "once.csv"))[0], BASES)
    twice = judge_pair(device, bank_of(scan(lambda f, z: (np.tile(f, 2), np.tile(z, 2)), tmp_path / "b.csv"))[0], BASES)
    assert twice.re_rad_s == pytest.approx(once.re_rad_s, abs=1e-6)
    assert any("there twice" in text for text in twice.warnings)


def test_what_a_table_lacks_around_the_mode_is_named_and_nothing_is_decided(tmp_path: Path, device: Device) -> None:
    """The mode of this line is at 25/75 Hz; without rows about 75 Hz, or below 40 Hz, nobody has measured it."""
    whole = judge_pair(device, bank_of(scan(lambda f, z: (f, z), tmp_path / "whole.csv"))[0], BASES)
    assert whole.verdict != "undecided"
    upper = F1_HZ + abs(whole.im_rad_s or 0.0) / (2.0 * np.pi)
    for name, lacks in (
        ("hole", lambda f: (f > 0.6 * upper) & (f < 1.7 * upper)),
        ("start", lambda f: f < 0.9 * F1_HZ),
        ("end", lambda f: f > 1.1 * F1_HZ),
    ):
        place = scan(lambda f, z, lacks=lacks: (f[~lacks(f)], z[~lacks(f)]), tmp_path / f"{name}.csv", 120)
        found = judge_pair(device, bank_of(place)[0], BASES)
        assert found.verdict == "undecided", name
        assert found.missing_hz is not None, name
        low, high = found.missing_hz
        assert low < upper < high or low < 2.0 * F1_HZ - upper < high, name


def test_a_network_of_another_fundamental_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sixty.toml").write_text('f1_hz = 60.0\n[[element]]\nkind = "series"\nx_ohm = 0.25\n')
    with pytest.raises(GridError, match=r"f1_hz = 60.0, the table's fundamental is 50 Hz"):
        check_single(read_bank(tmp_path / "sixty.toml"), F1_HZ)


def test_one_bad_file_in_four_hundred_costs_its_own_row(tmp_path: Path, device: Device) -> None:
    for k in range(399):
        line = f'[[element]]\nkind = "series"\nr_ohm = 0.01\nx_ohm = {0.1 + k / 4e3}\n'
        (tmp_path / f"g{k:03d}.toml").write_text(line)
    (tmp_path / "g200a.toml").write_text("[[element]\n")
    entries = bank_of(tmp_path)
    assert len(entries) == 400
    verdicts = [judge_pair(device, entry, BASES) for entry in entries[195:205]]
    assert [v.grid_id for v in verdicts if v.status != "ok"] == ["g200a.toml"]
    assert all(entry.problem == "" for entry in entries if entry.grid_id != "g200a.toml")


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
