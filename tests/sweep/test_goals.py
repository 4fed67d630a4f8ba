"""Regions that are swept for the critical mode or for the verdict on grids, against the exact turbine."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.surrogate.store import surrogate_of
from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.sweep.config.sections import Config, load_config
from seqsweep.sweep.region.adaptive import sweep_region
from seqsweep.sweep.region.goals import is_open
from seqsweep.tuning.region.scan import scan
from seqsweep.tuning.siso import parse_grid

from ..support import oracle
from ..support.regions import PV, U_V, unseen
from ..support.rounds import exact_round

GRID = "0.012+0.25j"


def campaign(tolerance, **region):
    asked = {"active_power_mw": [0.2, 1.3], "terminal_voltage_pu": [0.9, 1.1], "tolerance": tolerance, **region}
    sweep = {"f_hz": [10.0, 20.0], "operating_points": asked}
    return {"campaign": {"name": "goal"}, "plant": {"id": "dpmsg-v1"}, "sweep": sweep}


def swept_for(tolerance, path):
    said: list[str] = []
    outcome = sweep_region(Config.from_dict(campaign(tolerance)), path, exact_round, said.append)
    print("\n  ", *said, sep="\n  ")
    assert outcome.certified, said[-1]
    assert validate_table(path) == []
    return outcome, surrogate_of(read_table(path))


def true_modes(points):
    """Of each point all exact modes on the grid."""
    grid = parse_grid(GRID, 50.0)
    return [oracle.closed_loop_poles(p * 1e6, grid.r_ohm, grid.l_h, terminal_voltage_v=v * U_V) for p, _, v in points]


def test_a_mode_that_is_certified_is_that_of_the_exact_device(tmp_path):
    outcome, surrogate = swept_for({"mode_rad_s": 0.05, "grid": GRID}, tmp_path / "y.parquet")
    assert outcome.n_points <= 12
    assert "the critical mode is certified to 0.05 rad/s" in outcome.promise
    points = unseen(PV, 40, 3)
    found = scan(surrogate, parse_grid(GRID, 50.0), points).mode
    off = [np.abs(own - mode).min() for own, mode in zip(true_modes(points), found, strict=True) if np.isfinite(mode)]
    assert len(off) > 30
    assert max(off) < 0.05
    facts = read_table(tmp_path / "y.parquet").meta["region"]
    assert facts["on_grids"] == {"mode_rad_s": 0.05, "grid": GRID}
    assert facts["doubt"] <= 0.025


def test_a_verdict_that_is_told_is_that_of_the_exact_device(tmp_path):
    """The border of stability runs through the region on this grid."""
    _, surrogate = swept_for({"verdict": 0.05, "grid": "0.01+0.29j"}, tmp_path / "y.parquet")
    grid = parse_grid("0.01+0.29j", 50.0)
    points = unseen(PV, 60, 5)
    scanned = scan(surrogate, grid, points)
    told = ~is_open(scanned)
    stable = [
        oracle.closed_loop_poles(p * 1e6, grid.r_ohm, grid.l_h, terminal_voltage_v=v * U_V).real.max() < 0.0
        for p, _, v in points
    ]
    assert 0.1 < np.mean(stable) < 0.9
    assert np.mean(told) > 0.9
    assert np.array_equal((scanned.sure > 0.0)[told], np.array(stable)[told])


def test_a_bank_beside_the_campaign_is_found_and_its_load_flow_followed(tmp_path, monkeypatch):
    (tmp_path / "grids").mkdir()
    for name, scr in (("strong", 8.0), ("weak", 4.0)):
        element = f"[[element]]\nkind = 'source'\nscr = {scr}\nx_over_r = 10\n"
        (tmp_path / "grids" / f"{name}.toml").write_text(f"rated_power_mw = 1.632\nvoltage_kv = 0.69\n{element}")
    tolerance = 'tolerance = { mode_rad_s = 0.2, grid = "grids", source_voltage_pu = 1.0 }'
    (tmp_path / "c.toml").write_text(
        "[campaign]\nname = 'x'\n[plant]\nid = 'dpmsg-v1'\n[sweep]\nf_hz = [10.0, 20.0]\n[sweep.operating_points]\n"
        f"active_power_mw = [0.2, 1.0]\nterminal_voltage_pu = [0.9, 1.1]\n{tolerance}\n"
    )
    said: list[str] = []
    outcome = sweep_region(load_config(tmp_path / "c.toml"), tmp_path / "y.parquet", exact_round, said.append)
    assert outcome.certified, said[-1]
    assert outcome.promise.endswith("over the region, on 2 grids")


WRONG = {
    "both": ({"mode_rad_s": 1.0, "verdict": 0.1, "grid": GRID}, "needed: mode_rad_s or verdict, one of them"),
    "none": ({"grid": GRID}, "needed: mode_rad_s or verdict, one of them"),
    "no grid": ({"mode_rad_s": 1.0}, "tolerance.grid: missing"),
    "unknown": ({"mode": 1.0, "grid": GRID}, "tolerance.mode: unknown key"),
    "share": ({"verdict": 2, "grid": GRID}, "tolerance.verdict: given 2; needed: a number between 0 and 1"),
    "number": (2.0, "tolerance: given 2.0; needed: a number between 0 and 1"),
}


@pytest.mark.parametrize(("tolerance", "words"), WRONG.values(), ids=WRONG)
def test_wrong_tolerances_are_refused(tolerance, words):
    with pytest.raises(ValueError, match=words):
        Config.from_dict(campaign(tolerance))


def test_a_grid_that_is_none_is_refused_before_anything_is_swept(tmp_path):
    config = Config.from_dict(campaign({"mode_rad_s": 1.0, "grid": "gridd.toml"}))

    def never(config, path):
        raise AssertionError("swept")

    with pytest.raises(ValueError, match="no such file"):
        sweep_region(config, tmp_path / "y.parquet", never, print)
    assert not (tmp_path / "y.parquet.rounds").exists()
