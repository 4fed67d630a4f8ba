"""The worst operating point of a region over a bank, against brute force with the exact turbine."""

from __future__ import annotations

import json

import numpy as np
import pytest

from seqsweep.identify.surrogate.design import first_points
from seqsweep.identify.table.read import read_table
from seqsweep.sweep.worst import confirmed_worst, sweeping
from seqsweep.tuning.region.scan import Scan
from seqsweep.tuning.region.worst import _cost, worst_of_bank

from ..support.commands import command
from ..support.regions import BASES, PQV, PV, bank_of_27, brute_force, exact_margin, swept
from .test_region import REGION


def searched(region, seed, situations, **options):
    responses = [swept(point) for point in first_points(region, seed)]
    return confirmed_worst(responses, region, lambda s: worst_of_bank(s, situations, **options), swept, bases=BASES)


def test_worst_of_a_bank_is_brute_force_s():
    situations = list(bank_of_27())[18:27:4]
    found = searched(PV, 5, situations)
    # along Q = 0 the lattice has one power: the border of |v| is between its points
    truth = min(brute_force([each], 60, 1, PV) for each in situations)
    assert found.swept
    assert found.sweeps <= 10
    assert found.tuning.margin_m <= truth * 1.005
    assert found.tuning.margin_m == pytest.approx(exact_margin(found.worst.point, found.worst.situation), rel=5e-3)


@pytest.mark.evidence
def test_worst_of_27_grids_is_brute_force_s_in_twenty_random_designs():
    situations = list(bank_of_27())
    truth = brute_force(situations, 24, 33)
    first = int(np.random.default_rng().integers(1 << 30))
    print(f"\n  seed {first}; brute force m = {truth:.4f}")
    for seed in range(first, first + 20):
        found = searched(PQV, seed, situations)
        print(f"  {found.sweeps} sweeps: m = {found.tuning.margin_m:.4f}, predicted {found.predicted_m:.4f}")
        assert found.sweeps <= 12
        assert found.tuning.margin_m == pytest.approx(truth, rel=5e-3)


@pytest.mark.parametrize("least", ["damping", "probability"])
def test_least_damping_and_probability_are_found_on_the_weakest_grid(least):
    situations = list(bank_of_27())[1::3][:9:8]
    found = searched(PV, 2, situations, least=least)
    assert found.swept
    assert found.worst.situation.name.startswith("0.1875 ohm")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("worst")
    (folder / "region.toml").write_text(REGION)
    command("run", folder / "region.toml", "-o", folder / "y.parquet", "--jobs", 1)
    done = command("surrogate", folder / "y.parquet", "-o", folder / "s.parquet")
    assert done.returncode == 0, done.stderr
    return folder


def test_tune_confirms_the_worst_point_by_a_sweep(files):
    options = ("--grid", "0.01+0.12j", "--source-voltage", "1.0", "--jobs", 1)
    done = command("tune", files / "s.parquet", "--worst", *options)
    assert done.returncode == 0, done.stderr
    assert "It was swept; predicted was m = " in done.stdout
    assert "worst operating point by margin: (P, Q, |v|) = (1, 0, " in done.stdout


def test_tune_follows_the_load_flow_of_a_surrogate(files):
    done = command("tune", files / "s.parquet", "--grid", "0.004+0.05j", "--source-voltage", "1.0", "--power", "0.65")
    assert done.returncode == 0, done.stderr
    assert "p0.65_q0" in done.stdout


def test_judge_takes_a_surrogate(files):
    base = "rated_power_mw = 1.632\nvoltage_kv = 0.69\n"
    (files / "one.toml").write_text(base + "[[element]]\nkind = 'source'\nscr = 5.8\nx_over_r = 12\n")
    done = command("judge", files / "s.parquet", "--grids", files / "one.toml", "--source-voltage", 1.0, "--jobs", 1)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "p0.3_q0" in done.stdout


def test_judge_takes_the_source_voltage_that_a_grid_s_file_says(files):
    for name, source in (("low", 0.98), ("high", 1.02)):
        base = f"rated_power_mw = 1.632\nvoltage_kv = 0.69\nsource_voltage_pu = {source}\n"
        (files / "two").mkdir(exist_ok=True)
        (files / "two" / f"{name}.toml").write_text(base + "[[element]]\nkind = 'source'\nscr = 10\nx_over_r = 12\n")
    asked = ("--power", "0.6", "--jobs", 1, "--json")
    done = command("judge", files / "s.parquet", "--grids", files / "two", *asked)
    assert done.returncode == 0, done.stderr + done.stdout
    high, low = sorted(json.loads(done.stdout), key=lambda row: row["grid_id"])
    assert (high["grid_id"], low["grid_id"]) == ("high.toml", "low.toml")
    assert high["margin_m"] > low["margin_m"] * 1.01


def test_the_worst_point_without_a_source_voltage_says_that_the_voltage_was_free(files):
    done = command("tune", files / "s.parquet", "--worst", "--sweeps", 0, "--grid", "0.01+0.12j")
    assert done.returncode == 0, done.stderr
    assert "|v| was searched over its range like the powers" in done.stdout


@pytest.mark.parametrize("least", ["margin", "damping", "probability"])
def test_points_without_a_crossing_are_the_last_of_all_and_no_warning(least):
    none = np.array([np.inf])
    found = Scan(*(np.append(none, value) for value in (0.9, 0.8, 0.1, -1.0 + 2.0j, 0.1, 1.0)))
    cost = _cost(found, least)
    assert cost[0] == np.inf
    assert np.isfinite(cost[1])


REFUSED = {
    "no voltage": (["tune", "s.parquet", "--grid", "0.01+0.1j"], "give --source-voltage"),
    "a table": (["tune", "y.parquet", "--grid", "0.01+0.1j", "--power", "0.5"], "ask a surrogate"),
    "no number": (
        ["tune", "s.parquet", "--grid", "0.01+0.1j", "--power", "much", "--source-voltage", "1"],
        "needed is P or P,Q",
    ),
    "least": (["tune", "s.parquet", "--worst", "--grid", "0.01+0.1j", "--least", "hope"], "margin, damping or"),
    "too weak": (
        ["tune", "s.parquet", "--grid", "0.1+2j", "--source-voltage", "1"],
        "no operating point of the swept region exists on this grid",
    ),
    "no voltage of a source": (
        ["tune", "s.parquet", "--grid", "0.01+0.1j", "--source-voltage", "690"],
        "--source-voltage 690: needed is the voltage behind the grid in per unit",
    ),
    "no source": (["judge", "s.parquet", "--grids", "one.toml", "--source-voltage", "0"], "--source-voltage 0: needed"),
    "not a number": (["surrogate", "s.parquet", "--grid", "0.01+0.1j", "--source-voltage", "nan"], "between 0.5 and"),
    "outside": (
        ["tune", "s.parquet", "--grid", "0.01+0.1j", "--power", "7", "--source-voltage", "1"],
        "active_power_mw = 7 is outside the swept region",
    ),
}


@pytest.mark.parametrize(("asked", "words"), REFUSED.values(), ids=REFUSED)
def test_what_a_surrogate_cannot_answer_is_refused(files, asked, words):
    name, table, *options = asked
    done = command(name, files / table, *options)
    assert done.returncode == 2, done.stdout
    assert words in " ".join(done.stderr.split())


def test_a_table_without_its_campaign_is_a_prediction(files):
    with pytest.raises(ValueError, match="does not say which campaign"):
        sweeping({}, 1)
    assert read_table(files / "y.parquet").meta["configuration"]
