"""`seqsweep verify FARM.toml`: what a farm's scenario says, what comes out beside the pencil, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.sweep.verify.farm_figure import plot_farm
from seqsweep.sweep.verify.farm_report import format_report, to_json
from seqsweep.sweep.verify.farm_runs import verify_farm
from seqsweep.sweep.verify.farm_story import FarmStory, SourceStep, farm_story_of
from seqsweep.sweep.verify.scenario import ScenarioError, story_of
from seqsweep.sweep.verify.tuned import VerifyError
from seqsweep.tuning.farm.units import Library
from tests.support import farms
from tests.support.commands import command
from tests.support.farm_oracle import Star, closed_loop

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.0052 + 0.1105j)
POWERS_W = [0.4e6, 0.6e6, 0.8e6]
CAMPAIGN = {"plant": {"id": "dpmsg-v1", "parameters": {}}}


def document(**others) -> dict:
    return {**farms.document(STAR, len(POWERS_W)), **others}


@pytest.fixture(scope="module")
def truth():
    """Poles and terminal voltages of the farm as its file has it."""
    return closed_loop(STAR, POWERS_W)


@pytest.fixture(scope="module")
def library(truth):
    tables = {f"t{k}": farms.table_of(p, abs(truth[1][k]), configuration=CAMPAIGN) for k, p in enumerate(POWERS_W)}
    return Library(tables.__getitem__)


KICK = FarmStory(0.9, 0.995, events=(SourceStep(0.1, 1.0),))


@pytest.fixture(scope="module")
def kicked(library):
    return verify_farm(document(), library, KICK)


def test_the_line_resonates_as_the_linearisation_of_all_turbines_says(kicked, truth):
    poles, _ = truth
    upper = poles[(poles.imag > 60.0) & (poles.imag < 300.0)]
    critical = upper[np.argmax(upper.real)]
    line = next(run for run in kicked.runs if run.title == "without damping").line
    assert critical.real > 0.0
    assert line.rate_per_s == pytest.approx(critical.real, rel=0.02)
    pencil = kicked.farm.judgement.critical.pole
    assert pencil == pytest.approx(critical, abs=1e-3)


def test_the_aggregate_stands_beside_and_is_told_what_it_gets_wrong(kicked):
    report = format_report(kicked)
    assert [run.title for run in kicked.runs] == ["without damping", "aggregate without damping"]
    assert "what one aggregated turbine gets wrong" in report
    assert "without damping: the rate of the line's resonance by" in " ".join(report.split())
    one, all_of_them = kicked.runs[1].line.rate_per_s, kicked.runs[0].line.rate_per_s
    assert one == pytest.approx(all_of_them, abs=2.0)
    assert one != pytest.approx(all_of_them, abs=1e-3)


def test_all_runs_side_by_side_fit_80_columns(kicked):
    """Turbines and their aggregate, without and with damping, with a rate of three digits."""
    titles = ("without damping", "with damping", "aggregate without damping", "aggregate with damping")
    runs = tuple(
        replace(run, title=title, line=replace(run.line, rate_per_s=-123.45))
        for run, title in zip([kicked.runs[0]] * 2 + [kicked.runs[1]] * 2, titles, strict=True)
    )
    assert max(map(len, format_report(replace(kicked, runs=runs)).splitlines())) <= 80


def test_damping_of_the_turbines_keeps_the_farm(library, tmp_path):
    """The source steps from 0.9 to 1.06 of the file's impedance; each turbine has a gain and a start of its own."""
    story = farm_story_of(
        {
            "duration_s": 1.0,
            "source_scale": 0.9,
            "k": {"wt0": 0.6, "wt1": 0.6, "wt2": 0.9},
            "aggregate": False,
            "event": [{"kind": "source_step", "time_s": 0.1, "scale": 1.06}],
        }
    )
    result = verify_farm(document(), library, story)
    without, damped = result.runs
    assert without.line.last_ratio > 3.0 * damped.line.last_ratio
    assert all(each.started_s for each in damped.devices)
    assert [each.k for each in result.settings] == [0.6, 0.6, 0.9]
    plot_farm(result, tmp_path / "farm.png")
    assert (tmp_path / "farm.png").stat().st_size > 20_000
    content = to_json(result)
    assert content["runs"][1]["devices"]["wt2"]["started_s"]
    assert content["pencil"]


@pytest.mark.parametrize(
    ("margin", "stopped"), [(1.0, (pytest.approx(0.5),)), pytest.param(3.0, (), marks=pytest.mark.evidence)]
)
def test_damping_stops_where_the_farm_s_topology_says_that_the_cause_is_gone(library, margin, stopped):
    """Resonance at 1.06 of the source's impedance; at 0.6 the farm is stable without damping, with a margin below 3."""
    steps = [
        {"kind": "source_step", "time_s": 0.1, "scale": 1.06},
        {"kind": "source_step", "time_s": 0.5, "scale": 0.6},
    ]
    data = {"duration_s": 0.56, "source_scale": 0.9, "k": 0.8, "aggregate": False, "event": steps}
    damped = verify_farm(document(), library, farm_story_of({**data, "stop_margin": margin})).runs[1]
    assert all(each.started_s and each.started_s[0] > 0.25 for each in damped.devices)
    assert [each.stopped_s for each in damped.devices] == [stopped] * 3


def test_a_turbine_out_and_in_a_fault_and_a_power_step_are_told(library):
    story = farm_story_of(
        {
            "duration_s": 0.5,
            "source_scale": 0.5,
            "out": ["wt1"],
            "event": [
                {"kind": "switch", "name": "wt1", "in_service": True, "time_s": 0.1},
                {"kind": "fault", "bus": "t0", "fault": "b-c", "duration_s": 0.03, "r_ohm": 3.0, "time_s": 0.2},
                {"kind": "power_step", "device": "wt2", "active_power_mw": 0.7, "time_s": 0.3},
            ],
        }
    )
    result = verify_farm(document(), library, story)
    words = " ".join(format_report(result).split())
    assert "wt1 in at 0.1 s; fault b-c at t0 at 0.2 s for 30 ms; wt2 to 0.7 MW at 0.3 s" in words
    of = result.runs[0].trajectory.devices
    assert np.all(of[1].p_w[:1900] == 0.0)
    assert of[1].p_w[-200:].mean() == pytest.approx(0.6e6, rel=0.02)
    assert 0.68e6 < of[2].p_w[-200:].mean() < 0.76e6  # the DC link's own mode is slow
    assert np.ptp(np.abs(of[0].v[4000:4600])) > 3.0 * np.ptp(np.abs(of[0].v[3400:4000]))
    assert result.runs[1].trajectory.line.p_w[-200:].mean() == pytest.approx(
        result.runs[0].trajectory.line.p_w[-200:].mean(), rel=0.02
    )


def test_a_grid_side_damper_of_the_file_acts(library):
    damper = {"name": "gsdc", "bus": "pcc", "share": 0.5}
    story = farm_story_of({"duration_s": 0.7, "source_scale": 0.97, "aggregate": False, "on_from_s": 0.2,
                           "event": [{"kind": "source_step", "time_s": 0.1, "scale": 1.0}]})  # fmt: skip
    result = verify_farm(document(damper=[damper]), library, story)
    without, damped = result.runs
    assert damped.line.started_s == (0.202,) or damped.line.started_s[0] == pytest.approx(0.2, abs=0.004)
    assert damped.line.last_ratio < 0.5 * without.line.last_ratio
    assert "gsdc at pcc: 50 % of the farm's rating" in format_report(result)


# ---------------------------------------------------------------- refusals


WRONG = {
    "kind": ({"event": [{"kind": "grid_steps", "time_s": 0.1}]}, "kind is 'grid_steps'; known are source_step"),
    "one device's": (
        {"scale": 0.9, "event": [{"kind": "grid_step", "time_s": 0.1, "scale": 1.0}]},
        r"this is the story of one device \('scale' is .* goes with what tune wrote .* a farm has .* source_step",
    ),
    "one device's event": (
        {"event": [{"kind": "switch", "element": "c1", "in_service": False, "time_s": 0.1}]},
        "'element' is a word of it",
    ),
    "key": ({"durations_s": 1.0}, "no 'durations_s'; did you mean|no 'durations_s'"),
    "scale": ({"source_scale": 0.0}, "source_scale is 0; needed is a number above 0"),
    "too late": (
        {"duration_s": 0.5, "event": [{"kind": "source_step", "time_s": 0.7, "scale": 1.0}]},
        "event 1: time_s is 0.7, but the run ends at 0.5 s",
    ),
    "names": ({"out": 3}, "out is 3; needed is a name in quotes"),
    "fault": ({"event": [{"kind": "fault", "time_s": 0.1, "bus": "a", "fault": "c-g", "duration_s": 0.1}]}, "'c-g'"),
}


@pytest.mark.parametrize(("data", "words"), WRONG.values(), ids=WRONG)
def test_a_scenario_that_makes_no_sense_is_refused(data, words):
    with pytest.raises(ScenarioError, match=words):
        farm_story_of(data)


def test_a_farm_s_story_given_to_one_device_says_what_it_goes_with_and_what_one_device_has():
    with pytest.raises(ScenarioError) as refusal:
        story_of({"duration_s": 1.0, "source_scale": 1.8, "k": 0.8})
    said = str(refusal.value)
    assert said.startswith("this is the story of a farm ('source_scale' is a word of it) and goes with a farm file")
    assert "the story of one device has duration_s, scale, turbines" in said
    assert "grid_step (scale)" in said


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ({"kind": "power_step", "device": "wt9", "active_power_mw": 0.5, "time_s": 0.1}, "device 'wt9' is not in"),
        ({"kind": "fault", "bus": "t00", "duration_s": 0.1, "time_s": 0.1}, "bus 't00' is not in the farm"),
        ({"kind": "switch", "name": "wt7", "in_service": False, "time_s": 0.1}, "nothing in the farm is called 'wt7'"),
    ],
)
def test_a_name_that_is_none_is_refused(library, event, words):
    with pytest.raises(ValueError, match=words):
        verify_farm(document(), library, farm_story_of({"event": [event]}))


def test_devices_that_cannot_be_simulated_together_are_refused(truth):
    tables = {f"t{k}": farms.table_of(p, abs(truth[1][k]), configuration=CAMPAIGN) for k, p in enumerate(POWERS_W)}
    tables["t1"].meta["configuration"] = {}
    with pytest.raises(VerifyError, match="t1 names no campaign"):
        verify_farm(document(), Library(tables.__getitem__), KICK)
    tables["t1"].meta["configuration"] = {"plant": {"id": "dpmsg-v1", "parameters": {"k_pp": 0.1}}}
    with pytest.raises(VerifyError, match=r"t0: dpmsg-v1, t1: dpmsg-v1.*devices of one plant"):
        verify_farm(document(), Library(tables.__getitem__), KICK)


@pytest.mark.parametrize("name", ["gfl-v1", "gfm-v1"])
def test_inverters_are_refused_in_time_with_what_can_be_driven_and_what_judges_them(truth, name):
    inverter = {"plant": {"id": name, "parameters": {}}}
    tables = {f"t{k}": farms.table_of(p, abs(truth[1][k]), configuration=inverter) for k, p in enumerate(POWERS_W)}
    with pytest.raises(VerifyError) as refusal:
        verify_farm(document(), Library(tables.__getitem__), KICK)
    said = str(refusal.value)
    assert said.startswith(f"{name} (t0, t1, ")
    assert "are simulated of dpmsg-v1" in said
    assert "seqsweep farm FILE judges any devices together" in said


def test_options_of_a_tuning_do_not_go_with_a_farm(tmp_path):
    (tmp_path / "farm.toml").write_text("name = 'x'\n")
    found = command("verify", tmp_path / "farm.toml", "--op", "p")
    assert found.returncode == 2
    assert "a farm file names its tables itself" in found.stderr
