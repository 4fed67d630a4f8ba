"""Campaigns and verification on grids of elements: what the files say, what is refused, what comes out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config, load_config
from seqsweep.sweep.plan import PlanError
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import campaign
from seqsweep.sweep.verify.report import format_report, to_json
from seqsweep.sweep.verify.runs import cause_gone_of, verify
from seqsweep.sweep.verify.scenario import ScenarioError, story_of
from seqsweep.sweep.verify.tuned import VerifyError, scenario_of, tuned_of
from seqsweep.tuning.result import to_json as tuning_json
from seqsweep.tuning.tune import tune

GRID = """
name = "weak"
voltage_kv = 0.69

[[element]]
kind = "filter"
name = "filter"
tuned_hz = 350.0
c_uf = 60.0

[[element]]
kind = "series"
name = "line"
r_ohm = 0.0125
x_ohm = 0.25

[[element]]
kind = "series_capacitor"
name = "comp"
compensation_percent = 10.0
in_service = true

[[element]]
kind = "series"
r_ohm = 0.003
x_ohm = 0.05
"""


def document(at_point: object, **source: object) -> dict:
    return {
        "campaign": {"name": "elements"},
        "plant": {"id": "dpmsg-v1"},
        "operating_point": [{"id": "p", "active_power_mw": 0.6, "grid": at_point}],
        "sweep": {"f_hz": [12.0, 30.0, 43.0, 60.0, 77.0, 90.0, 140.0, 400.0]},
        "source": {"kind": "ideal", **source},
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("elements")
    (folder / "grid.toml").write_text(GRID)
    (folder / "scan.csv").write_text("f,R,X\n1,0.1,0.2\n")
    (folder / "region.toml").write_text("[[region]]\norder = 5\n")
    return folder


def config_of(folder, content: dict) -> Config:
    from seqsweep.sweep.config.checks import checked

    config, problems = checked(content, folder)
    assert not problems, problems
    assert config is not None
    return config


def problems_of(folder, content: dict) -> str:
    from seqsweep.sweep.config.checks import checked

    config, problems = checked(content, folder)
    assert config is None
    return "; ".join(f"{'.'.join(map(str, p.keys))}: {p.text}" for p in problems)


def table_of(folder, name: str, content: dict):
    config = config_of(folder, content)
    plant = make_plant(config.plant.id, {})
    campaign.run(make_plan(config, plant), plant, folder / name, jobs=1)
    return read_table(folder / name)


@pytest.fixture(scope="module")
def swept(folder):
    return table_of(folder, "y.parquet", document("grid.toml", kind="thevenin"))


def test_a_file_is_kept_in_full_and_a_campaign_needs_it_no_more(folder, tmp_path):
    config = config_of(folder, document("grid.toml"))
    again = Config.from_dict(json.loads(json.dumps(config.to_dict())))
    assert again == config
    assert config.operating_point[0].grid.elements["name"] == "weak"


def test_a_file_is_named_relative_to_the_campaign(folder):
    text = 'campaign = {name="x"}\nplant = {id="dpmsg-v1"}\n[[operating_point]]\nactive_power_mw = 0.6\n'
    (folder / "campaign.toml").write_text(f'{text}grid = "grid.toml"\n[sweep]\nf_hz = [10.0]\n')
    config = load_config(folder / "campaign.toml")
    assert config.operating_point[0].id.endswith("gweak")


def test_elements_may_stand_in_the_campaign_itself(folder):
    grid = {"voltage_pu": 1.02, "scale": 0.9, "element": [{"kind": "series", "r_ohm": 0.01, "x_ohm": 0.2}]}
    plan = make_plan(config_of(folder, document(grid)), make_plant("dpmsg-v1", {}))
    found = plan.conditions[0].grid
    assert (found.r_ohm, found.l_h * 100.0 * np.pi, found.voltage_v) == pytest.approx((0.009, 0.18, 1.02 * 690.0))


def test_a_device_behind_elements_shows_the_admittance_it_has_on_an_ideal_source(folder, swept):
    """Two ways to one Y: tones through the network, and tones at the terminals at the voltage of its load flow.

    Behind the network the loop's own mode at 77 Hz is still dying out where windows agree to 1e-5.
    """
    y = swept.response("p")
    other = table_of(folder, "ideal.parquet", document("grid.toml")).response("p")
    assert y.meta["terminal_voltage_pu"] == pytest.approx(other.meta["terminal_voltage_pu"], rel=1e-9)
    size = np.linalg.norm(other.y, axis=(1, 2))
    assert np.max(np.linalg.norm(y.y - other.y, axis=(1, 2)) / size) < 3e-4


def test_the_table_says_on_which_elements_the_device_was_stable(swept):
    place = swept.response("p").meta["stable_on"]["grid"]
    assert place["elements"]["name"] == "weak"
    own = tune(swept, "own").points[0]
    assert own.grid.at_f1 == pytest.approx(complex(place["r_ohm"], place["x_ohm"]))
    assert own.verdict != "unstable"  # eight rows do not decide it


def test_a_source_of_elements_feeds_every_operating_point(folder):
    content = document(None, kind="thevenin", grid="grid.toml")
    del content["operating_point"][0]["grid"]
    content["operating_point"][0]["terminal_voltage_pu"] = 1.0
    plan = make_plan(config_of(folder, content), make_plant("dpmsg-v1", {}))
    assert plan.source.kind == "network"


WRONG = {
    "a table": ("scan.csv", "scan.csv is no file of elements; .* a table of Z.f. has no time domain"),
    "no file": ("nowhere.toml", "nowhere.toml: no such file"),
    "a region": ("region.toml", r"has no \[\[element\]\]; regions and families have no time domain"),
    "half a line": ({"r_ohm": 0.1}, "grid.x_ohm: missing; needed: a number above 0"),
    "both": ({"r_ohm": 0.1, "elements": "grid.toml"}, "grid.r_ohm: given beside elements; needed: only one of them"),
}


@pytest.mark.parametrize(("grid", "words"), WRONG.values(), ids=WRONG)
def test_what_is_no_grid_in_time_is_refused(folder, grid, words):
    import re

    assert re.search(words, problems_of(folder, document(grid)))


def test_elements_behind_an_ideal_source_are_refused(folder):
    content = document({"r_ohm": 0.01, "x_ohm": 0.2}, grid="grid.toml")
    assert 'source.grid: given, but on an ideal source; needed: kind = "thevenin"' in problems_of(folder, content)


def test_an_element_that_is_none_is_refused_with_its_point(folder):
    grid = {"element": [{"kind": "serie", "x_ohm": 0.2}]}
    with pytest.raises(PlanError, match=r"operating point 'p': .*did you mean 'series'"):
        make_plan(config_of(folder, document(grid)), make_plant("dpmsg-v1", {}))


# ---------------------------------------------------------------- verify


@pytest.fixture(scope="module")
def tuning(swept):
    content = json.loads(json.dumps(tuning_json(tune(swept, "own"))))
    content["operating_points"][0].update(k=0.5, f_r_hz=77.0)
    return content


STORY = {
    "duration_s": 0.7,
    "event": [
        {"kind": "element_step", "element": "line", "x_ohm": 0.31, "time_s": 0.1},
        {"kind": "switch", "element": "filter", "in_service": False, "time_s": 0.1},
    ],
}


def test_line_and_filter_are_switched_in_time(tuning, swept):
    """The longer line is too weak for the turbine: it resonates until damping control starts."""
    tuned = tuned_of(tuning)
    result = verify(tuned, story_of(STORY), cause_gone_of(swept.response("p")))
    report = format_report(result)
    assert "line with x_ohm = 0.31 at 0.1 s; filter out at 0.1 s" in " ".join(report.split())
    without, damped = result.reports
    assert without.largest_ratio > 2.0 * damped.last_ratio
    assert damped.started_s
    assert to_json(result)["scenario"]["events"][0]["what"] == "line with x_ohm = 0.31"


def test_behind_a_capacitive_grid_the_device_is_driven_without_damping_control(tuning):
    """Set to 3 Hz, where the series capacitor outweighs the line: the gain has no R and L to multiply."""
    tuned = replace(tuned_of(tuning), f_r_hz=3.0)
    result = verify(tuned, story_of({**STORY, "duration_s": 0.3}))
    assert result.damped is None
    assert any("without damping control alone: at 3 Hz the grid" in text for text in result.remarks)


def test_after_the_last_switch_the_grid_is_what_is_left(tuning):
    """Percent refers to the X of all lines: 0.3 ohm, whatever is in service."""
    tuned = tuned_of(tuning)
    half = {"kind": "element_step", "element": "comp", "compensation_percent": 50.0, "time_s": 0.2}
    scenario = scenario_of(tuned, story_of({"duration_s": 1.0, "event": [half]}))
    z, _ = scenario.events[0].circuit.seen_at(100j * np.pi)
    w, c = 2.0 * np.pi * 350.0, 60e-6
    line = 0.0155 + 0.3j - 0.15j
    y_filter = 1.0 / (1.0 / (w * c * 50.0) + 100j * np.pi / (w**2 * c) + 1.0 / (100j * np.pi * c))
    assert z == pytest.approx(1.0 / (1.0 / line + y_filter))


def test_a_number_that_is_switched_takes_the_place_of_what_said_the_same_before(tuning):
    """The line is given by x_ohm; 1 mH is 0.314 ohm at 50 Hz, whichever of the two names the step uses."""
    found = []
    for key, value in (("l_mh", 1.0), ("x_ohm", 0.1 * np.pi)):
        step = {"kind": "element_step", "element": "line", key: value, "time_s": 0.2}
        scenario = scenario_of(tuned_of(tuning), story_of({"duration_s": 1.0, "event": [step]}))
        found.append(scenario.events[0].circuit.seen_at(100j * np.pi)[0])
    assert found[0] == pytest.approx(found[1])


def test_an_unknown_element_is_refused_by_its_name(tuning):
    story = story_of({"event": [{"kind": "switch", "element": "filtr", "in_service": True, "time_s": 0.1}]})
    with pytest.raises(ValueError, match=r"no element .* called 'filtr' .did you mean 'filter'"):
        scenario_of(tuned_of(tuning), story)


def test_a_tuning_on_a_spectrum_is_refused(tuning):
    content = json.loads(json.dumps(tuning))
    content["operating_points"][0]["grid"] = {"kind": "table", "name": "scan"}
    with pytest.raises(VerifyError, match="no time domain"):
        tuned_of(content)


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ({"kind": "switch", "time_s": 0.1, "element": "filter"}, "in_service is None"),
        ({"kind": "element_step", "time_s": 0.1, "element": "comp"}, "no number of the element"),
        ({"kind": "switch", "time_s": 0.1, "in_service": True}, "element is None; needed is the name"),
    ],
)
def test_half_an_event_is_refused(event, words):
    with pytest.raises(ScenarioError, match=words):
        story_of({"event": [event]})
