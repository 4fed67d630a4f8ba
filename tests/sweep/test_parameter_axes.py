"""Parameters of the plant as axes of a region: from the campaign to the answers, the exact turbine being the device."""

from __future__ import annotations

import json

import numpy as np
import pytest

from seqsweep.identify.surrogate.surrogate import SurrogateError, build_surrogate
from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.plant.turbine.parameters import TABLE_I
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.region.adaptive import region_of, sweep_region

from ..support import oracle
from ..support.commands import command
from ..support.regions import F_HZ, U_V
from ..support.rounds import exact_round

ASKED = {
    "active_power_mw": [0.3, 1.2],
    "terminal_voltage_pu": 1.0,
    "parameters": {"k_pp": [0.05, 0.12], "k_p": 0.2},
    "tolerance": 1e-2,
}
CAMPAIGN = {
    "campaign": {"name": "pll"},
    "plant": {"id": "dpmsg-v1"},
    "sweep": {"f_hz": [10.0, 20.0], "operating_points": ASKED},
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("pll") / "y.parquet"
    said: list[str] = []
    outcome = sweep_region(Config.from_dict(CAMPAIGN), path, exact_round, said.append)
    assert outcome.certified, said[-1]
    assert "k_p = 0.2, k_pp = 0." in said[-1]
    return path


@pytest.fixture(scope="module")
def surrogate(path):
    return build_surrogate(read_table(path).responses)


def test_every_point_says_its_parameters_and_the_table_conforms(path):
    table = read_table(path)
    assert validate_table(path) == []
    assert table.meta["plant"]["parameters"] == {}
    values = [response.meta["parameters"] for response in table.responses]
    assert {value["k_p"] for value in values} == {0.2}
    assert len({value["k_pp"] for value in values}) >= 6
    assert table.meta["configuration"]["sweep"]["operating_points"]["parameters"]["k_pp"] == [0.05, 0.12]


def test_what_is_certified_is_right_between_the_swept_parameters(surrogate):
    random = np.random.default_rng(4)
    for power, k_pp in zip(random.uniform(0.3, 1.2, 12), random.uniform(0.05, 0.12, 12), strict=True):
        given = TABLE_I._replace(k_p=0.2, k_pp=k_pp)
        truth = oracle.admittance_pn(F_HZ, power * 1e6, U_V, given)
        found = surrogate.fixed(k_pp=k_pp).response([power, 0.0, 1.0]).y
        assert (np.linalg.norm(found - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))).max() < 1e-2


def test_a_parameter_has_to_be_given_and_to_be_known(surrogate):
    with pytest.raises(SurrogateError, match=r"has 5 values, .* say which value k_pp has"):
        surrogate.evaluate(np.array([0.6, 0.0, 1.0]))
    with pytest.raises(SurrogateError, match=r"k_pq is no parameter of this surrogate.* known: k_p, k_pp"):
        surrogate.fixed(k_pq=1.0)
    with pytest.raises(SurrogateError, match=r"k_pp = 0.2 is outside the swept region, 0.05 to 0.12"):
        surrogate.fixed(k_pp=0.2)
    assert surrogate.fixed(k_pp=0.08).response([0.6, 0.0, 1.0]).meta["parameters"] == {"k_p": 0.2, "k_pp": 0.08}


def test_commands_take_values_for_parameters(path, tmp_path):
    written = command("surrogate", path, "-o", tmp_path / "s.parquet")
    assert "k_pp 0.05 to 0.12" in written.stdout, written.stderr
    done = command("surrogate", path, "--at", "0.65,0,1,k_pp=0.08", "-o", tmp_path / "p.parquet")
    assert done.returncode == 0, done.stderr
    assert read_table(tmp_path / "p.parquet").op_ids == ("p0.65_q0_v1_k_p0.2_k_pp0.08",)
    grid = ("--grid", "0.012+0.25j", "--power", "0.65", "--parameter", "k_pp=0.08")
    done = command("tune", tmp_path / "s.parquet", *grid)
    assert done.returncode == 0, done.stderr
    missing = command("tune", tmp_path / "s.parquet", *grid[:4])
    assert missing.returncode == 2
    assert "say which value k_pp has" in " ".join(missing.stderr.split())


def test_the_worst_of_all_parameters_is_no_better_than_that_of_one(path, tmp_path):
    command("surrogate", path, "-o", tmp_path / "s.parquet")
    asked = ("tune", tmp_path / "s.parquet", "--worst", "--sweeps", 0, "--grid", "0.012+0.25j", "--json")
    found, held = command(*asked), command(*asked, "--parameter", "k_pp=0.08")
    assert found.returncode == held.returncode == 0, found.stderr + held.stderr

    def margin(done):
        return json.loads(done.stdout)["operating_points"][0]["margin_m"]

    assert margin(found) < margin(held)


WRONG = {
    "falling": ({"parameters": {"k_pp": [0.12, 0.05]}}, {}, r"parameters.k_pp: given \[0.12, 0.05\]"),
    "text": ({"parameters": {"k_pp": "much"}}, {}, r"parameters.k_pp: given \"much\"; needed: a table"),
    "twice": ({}, {"k_pp": 0.08}, r"parameters.k_pp: given in \[plant.parameters\] as well"),
    "no range": ({"active_power_mw": 0.5, "parameters": {"k_pp": 0.08}}, {}, "no range in it"),
}


@pytest.mark.parametrize(("asked", "parameters", "words"), WRONG.values(), ids=WRONG)
def test_wrong_axes_are_refused(asked, parameters, words):
    sweep = {"f_hz": [10.0, 20.0], "operating_points": {**ASKED, **asked}}
    with pytest.raises(ValueError, match=words):
        Config.from_dict({**CAMPAIGN, "plant": {"id": "dpmsg-v1", "parameters": parameters}, "sweep": sweep})


def test_a_parameter_alone_may_be_the_region():
    asked = {**ASKED, "active_power_mw": 0.5, "parameters": {"k_pp": [0.05, 0.12]}}
    config = Config.from_dict({**CAMPAIGN, "sweep": {"f_hz": [10.0, 20.0], "operating_points": asked}})
    assert config.sweep.operating_points is not None
    assert region_of(config.sweep.operating_points).varies.tolist() == [False, False, False, True]
