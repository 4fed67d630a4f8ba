"""The proof in time: what `seqsweep verify` reads from a tuning, and what it says of both runs."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.damping.events import Fault, GridStep, PowerStep, TurbineStep, WindStep
from seqsweep.sweep.cli import main as cli
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import campaign
from seqsweep.sweep.verify.figure import plot, resonance_current, verification_figure
from seqsweep.sweep.verify.report import SCHEMA_FILE, format_report, to_json
from seqsweep.sweep.verify.runs import cause_gone_of, compare, has_equilibrium, verify
from seqsweep.sweep.verify.scenario import ScenarioError, Story, read_story
from seqsweep.sweep.verify.tuned import VerifyError, read_tuning, scenario_of, settings_of, tuned_of
from seqsweep.tuning.result import schema, write_json
from seqsweep.tuning.result import to_json as tuning_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune

from ..support.commands import unfolded

CAMPAIGN = {
    "campaign": {"name": "verify"},
    "plant": {"id": "dpmsg-v1"},
    "operating_point": [
        {"id": "weak", "active_power_mw": 0.60, "grid": {"r_ohm": 0.012, "x_ohm": 0.25, "scale": 1.4}},
        {"id": "held", "active_power_mw": 0.60, "terminal_voltage_pu": 1.0},
    ],
    "sweep": {"f_min_hz": 2.0, "f_max_hz": 1000.0, "points": 60},
}
GRID = SeriesRL(1.4 * 0.012, 1.4 * 0.25, 50.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """y.parquet and tuning.json of a real sweep, the gain set to the paper's 0.5."""
    from seqsweep.plant.registry import make_plant

    folder = tmp_path_factory.mktemp("verify")
    config = Config.from_dict(CAMPAIGN)
    plant = make_plant(config.plant.id, {})
    campaign.run(make_plan(config, plant), plant, folder / "y.parquet", jobs=2)
    write_json(tune(read_table(folder / "y.parquet"), GRID), folder / "tuning.json")
    content = json.loads((folder / "tuning.json").read_text())
    for point in content["operating_points"]:
        point["k"] = 0.5
    (folder / "tuning.json").write_text(json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def weak(folder):
    return tuned_of(read_tuning(folder / "tuning.json"), "weak")


@pytest.fixture(scope="module")
def result(weak):
    return verify(weak)


def called(monkeypatch, capsys, *arguments) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["seqsweep", *map(str, arguments)])
    status = cli._status()
    return (status, *map(unfolded, capsys.readouterr()))


# ---------------------------------------------------------------- both runs


def test_default_story_is_the_paper_s(weak):
    """1.2 Z to 1.4 Z at 0.1 s, 0.60 MW and 690 V."""
    scenario = scenario_of(weak, Story())
    assert scenario.scale * scenario.r_ohm == pytest.approx(1.2 * 0.012)
    assert scenario.events == (GridStep(0.1, 1.0),)
    assert (scenario.active_power_w, scenario.source_voltage_v) == (0.60e6, 690.0)
    assert settings_of(weak).resonance_hz == pytest.approx(76.74, abs=0.05)


def test_without_it_synchronism_is_lost_and_with_it_the_resonance_dies(result):
    without, damped = result.reports
    assert without.lost_s == pytest.approx(0.69, abs=0.02)
    assert without.started_s == ()
    assert damped.lost_s is None
    assert damped.started_s == (pytest.approx(0.28, abs=0.01),)  # 150 ms after r has passed the threshold
    assert damped.calm_s < 0.55
    assert damped.last_ratio < 1e-3


def test_a_resonance_that_grows_below_the_threshold_is_not_called_calm(weak):
    """A step so small that r stays below 3 % for the whole run, on a grid on which the turbine is unstable."""
    without, _ = verify(weak, Story(scale=0.9985, duration_s=0.7)).reports
    assert without.above_s is None
    assert without.rate_per_s > 1.0
    assert without.outcome == "below the threshold, and growing"


def test_rates_are_those_of_linear_theory(result):
    """+3.3 and -8.4 rad/s; without damping the amplitudes are no longer small."""
    without, damped = result.reports
    assert without.rate_per_s == pytest.approx(3.3, abs=0.8)
    assert damped.rate_per_s == pytest.approx(-8.4, abs=0.2)


def test_windows_name_both_frequencies_and_end_where_synchronism_does(result):
    without, damped = result.reports
    assert len(without.windows) == len(damped.windows) == 7
    second = without.windows[1]
    assert (second.f_hz, second.f_mirror_hz) == (pytest.approx(76.6, abs=0.3), pytest.approx(23.4, abs=0.3))
    assert second.amplitude_a > second.mirror_a > 0.0
    assert second.power_mw == pytest.approx(0.60, abs=0.02)
    assert np.isnan([w.ratio for w in without.windows if w.to_s > without.lost_s]).all()


def test_source_of_a_held_voltage_is_the_one_that_holds_it_on_the_tuned_grid(folder):
    """|v_pcc| = 1 pu was swept; the source behind the tuned grid follows, and its step leads there."""
    held = tuned_of(read_tuning(folder / "tuning.json"), "held")
    scenario = scenario_of(held, Story(scale=1.0, events=()))
    assert scenario.source_voltage_v > 690.0
    at_rest = compare(held, scenario, settings_of(held), 0.02)
    assert np.abs(at_rest.without.v) * 1.5**0.5 == pytest.approx(690.0, abs=1e-3)


def test_with_the_table_it_stops_where_the_table_says_stable(folder, weak):
    gone = cause_gone_of(read_table(folder / "y.parquet").response("weak"))
    story = Story(events=(GridStep(0.1, 1.0), GridStep(0.5, 0.7)))
    damped = verify(weak, story, gone).reports[1]
    assert damped.stopped_s == (pytest.approx(0.5, abs=0.004),)
    assert damped.last_ratio < 0.01


def test_a_grid_that_cannot_carry_the_power_is_remarked(weak):
    story = Story(0.3, events=(GridStep(0.1, 2.0),))
    assert not has_equilibrium(weak.plant, scenario_of(weak, story), 0.3)
    assert "no operating point" in verify(weak, story).remarks[0]


def test_resonance_current_leaves_the_fundamental_out(result):
    """A trajectory at rest has none; afterwards its size is that of the estimator's two components."""
    t, i = result.damped.time_s, resonance_current(result.damped)
    assert np.abs(i[t < 0.07]).max() < 1.0
    window = result.reports[1].windows[0]
    assert np.abs(i[(t > 0.2) & (t < 0.25)]).max() == pytest.approx(window.amplitude_a + window.mirror_a, rel=0.15)


# ---------------------------------------------------------------- out


def test_report_is_plain_json_and_text(result, tmp_path):
    content = to_json(result)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    jsonschema.validate(content, json.loads(SCHEMA_FILE.read_text()))
    for broken in ({"format": "else"}, {"runs": {"without": content["runs"]["without"]}}, {"damping": {"k": "much"}}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(content | broken, json.loads(SCHEMA_FILE.read_text()))
    assert content["runs"]["without"]["windows"][-1]["ratio"] is None
    text = format_report(result, 80)
    assert "synchronism lost at 0.69 s" in text
    assert max(map(len, text.splitlines())) <= 80
    plot(result, tmp_path / "verify.png")
    assert (tmp_path / "verify.png").stat().st_size > 20_000


def test_the_picture_says_what_happens_and_whether_damping_control_started(result):
    never = replace(result, damped=result.without)
    for shown, label in ((result, "with damping control, k = 0.5"), (never, "damping control, k = 0.5, never started")):
        figure = verification_figure(shown)
        assert figure._suptitle.get_text().splitlines()[1:] == ["grid x 1 at 0.1 s"]
        assert label in figure.axes[0].get_legend_handles_labels()[1]


def test_synchronism_lost_twice_is_once_in_the_legend(result):
    both = replace(result, damped=result.without)
    axes = verification_figure(both).axes[0]
    assert axes.get_legend_handles_labels()[1].count("synchronism lost") == 1
    assert sum(line.get_marker() == "x" for line in axes.get_lines()) == 2


def test_command_line_writes_everything_and_ends_with_zero(folder, tmp_path, monkeypatch, capsys):
    story = tmp_path / "fault.toml"
    story.write_text('duration_s = 0.4\nscale = 0.46\n[[event]]\nkind = "fault"\ntime_s = 0.1\nduration_s = 0.04\n')
    out = tmp_path / "verify.json"
    arguments = ("verify", folder / "tuning.json", "--op", "weak", "--scenario", story, "-o", out)
    status, printed, _ = called(monkeypatch, capsys, *arguments, "--plot", tmp_path / "verify.svg")
    assert status == 0
    assert "fault a-b-c" in " ".join(printed.split())
    assert json.loads(out.read_text())["runs"]["with"]["started_s"] == []
    assert (tmp_path / "verify.svg").exists()


def test_a_tuning_without_a_gain_is_driven_without_damping_control(folder, tmp_path):
    content = read_tuning(folder / "tuning.json")
    content["operating_points"][0].update(k=None, missing={"k": "the grid is too odd"})
    done = verify(tuned_of(content, "weak"), Story(duration_s=0.3))
    printed = " ".join(format_report(done).split())
    assert "damping control: none" in printed
    assert "note: simulated without damping control alone: the grid is too odd" in printed
    as_json = to_json(done)
    jsonschema.validate(as_json, json.loads(SCHEMA_FILE.read_text()))
    assert as_json["damping"] is None
    assert list(as_json["runs"]) == ["without"]
    plot(done, tmp_path / "alone.svg")
    assert "without damping control<" in done._repr_html_()
    assert ">with<" not in done._repr_html_()


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["provenance"]["table"].pop("configuration"), "recordings and imports cannot be verified"),
        (lambda c: c["provenance"]["table"]["configuration"]["plant"].update(id="branch-v1"), "branch-v1 has no mea"),
        (lambda c: c.pop("worst"), "not a tuning result"),
    ],
)
def test_tuning_that_cannot_be_verified_ends_with_two_and_a_reason(
    folder, tmp_path, monkeypatch, capsys, change, words
):
    content = read_tuning(folder / "tuning.json")
    content["worst"] = "weak"
    change(content)
    path = tmp_path / "tuning.json"
    path.write_text(json.dumps(content))
    status, _, error = called(monkeypatch, capsys, "verify", path)
    assert status == 2
    assert words in error


def test_unknown_operating_point_is_refused_with_the_known_ones(folder):
    with pytest.raises(VerifyError, match=r"no operating point 'nope' in the tuning; it has weak, held"):
        tuned_of(read_tuning(folder / "tuning.json"), "nope")


def test_a_tuning_at_several_scales_is_verified_at_the_one_that_is_asked(folder):
    content = tuning_json(tune(read_table(folder / "y.parquet"), GRID, scales=(0.8, 1.0)))
    jsonschema.validate(content, schema())
    tuned = tuned_of(content, "held", scale=0.8)
    assert (tuned.grid.r_ohm, tuned.grid.x_ohm) == pytest.approx((0.8 * GRID.r_ohm, 0.8 * GRID.x_ohm))
    entry = next(p for p in content["operating_points"] if (p["op_id"], p["scale"]) == ("held", 0.8))
    assert tuned.k == entry["k"]
    worst = tuned_of(content)
    assert worst.op_id == content["worst"]
    assert worst.grid.x_ohm == pytest.approx(content["worst_scale"] * GRID.x_ohm)
    other = next(name for name in ("weak", "held") if name != content["worst"])
    with pytest.raises(VerifyError, match=r"at which of its scales\? It was tuned at 0\.8, 1 \(--scale X\)"):
        tuned_of(content, other)
    with pytest.raises(VerifyError, match=r"there is no scale 2\. It was tuned at 0\.8, 1"):
        tuned_of(content, "held", scale=2.0)


def test_a_tuning_of_version_1_1_is_still_read(folder):
    """Before 1.2 the grid stood in the provenance alone, and entries had no scale."""
    content = json.loads((folder / "tuning.json").read_text())
    content["version"] = "1.1.0"
    for point in content["operating_points"]:
        for key in ("scale", "grid", "margin_met", "k_basis", "with_k", "missing"):
            del point[key]
    del content["worst_scale"]
    jsonschema.validate(content, schema())
    assert tuned_of(content, "weak").grid.x_ohm == pytest.approx(GRID.x_ohm)
    content["version"] = "1.2.0"
    with pytest.raises(jsonschema.ValidationError, match="'scale' is a required property"):
        jsonschema.validate(content, schema())


def test_scenario_file_knows_every_event(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        """
        scale = 0.9
        turbines = 8
        active_power_mw = 0.65
        source_voltage_pu = 1.02
        event = [
          { kind = "grid_step", time_s = 0.1, scale = 1 },
          { kind = "turbine_step", time_s = 0.2, count = 11 },
          { kind = "fault", time_s = 0.3, duration_s = 0.04, fault = "b-c-g", r_ohm = 0.1 },
          { kind = "wind_step", time_s = 0.4, wind_m_s = 9.0 },
          { kind = "power_step", time_s = 0.5, active_power_mw = 0.7 },
        ]
        """
    )
    story = read_story(path)
    assert (story.scale, story.turbines, story.active_power_w, story.source_voltage_pu) == (0.9, 8.0, 0.65e6, 1.02)
    assert story.events == (
        GridStep(0.1, 1.0),
        TurbineStep(0.2, 11.0),
        Fault(0.3, 0.04, "b-c-g", 0.1),
        WindStep(0.4, 9.0),
        PowerStep(0.5, 0.7e6),
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scael = 1.0", "the scenario has no 'scael' (did you mean 'scale'"),
        ("scale = true", "scale is True; a number is needed"),
        ("scale =", "not TOML"),
        ("event = 3", "double brackets"),
        ('[[event]]\nkind = "gird_step"', "event 1: kind is 'gird_step'; known are grid_step"),
        ('[[event]]\nkind = "grid_step"\ntime_s = 0.1', "event 1: scale is missing"),
        ('[[event]]\nkind = "fault"\ntime_s = 0.1\nduration = 1', "did you mean 'duration_s'"),
        ('[[event]]\nkind = "grid_step"\ntime_s = 3.0\nscale = 1.2', "time_s is 3, but the run ends at 1.2 s"),
    ],
)
def test_scenario_file_that_cannot_be_followed_is_refused(tmp_path, text, words):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=re.escape(words)):
        read_story(path)
