"""`seqsweep identify`: files in, the table out, from the command line; and the same numbers as the sweep's own path."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.recorded.points import Experiment, _loud_enough, points_of
from seqsweep.identify.recorded.tones import hear
from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.plant.protocol import Job
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure.baseline import baseline
from seqsweep.sweep.measure.measure import measure
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.recorded.identify import identify, request_of

from ..identify.test_hear import F1, branch, branch_y, noisy, relative_norms
from ..support import by_hand
from ..support import recording_files as files
from ..support.by_hand import Stretch
from ..support.commands import command
from ..support.recorded_device import Device, joined, tones

DATA = Path(__file__).parents[2] / "data"

POINTS = (31.0, 77.0, 153.0)
BASES = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}


def both(f_hz):
    """The two frequencies of a point."""
    return f_hz, 2.0 * F1 - f_hz


def write(folder, points=POINTS, *, length_s=3.0, negate=False, noise=0.0):
    """COMTRADE recordings shot_000.cfg, ... of both experiments of every point; what a manifest says of them."""
    told, rng = [], np.random.default_rng(0)
    for f in points:
        for at in both(f):
            stretch = branch((at,), length_s=length_s, background=((-F1, 0.01),))
            stretch = noisy(stretch, noise, rng) if noise else stretch
            samples = files.six(Stretch(stretch.v, -stretch.i if negate else stretch.i))
            files.comtrade(folder / f"shot_{len(told):03d}", samples, form="FLOAT32")
            shot = {"f_hz": f, "injected_hz": at, "amplitude": 2.815, "phase_rad": 0.0}
            told.append(
                {
                    "file": f"shot_{len(told):03d}.csv",
                    "shots": [shot],
                    "start_s": 0.0,
                    "settle_s": 0.0,
                    "duration_s": length_s,
                }
            )
    return told


def manifest(path, told, **more):
    """Write a manifest; its path."""
    content = {
        "format": "seqsweep-manifest",
        "version": "1.0.0",
        "f1_hz": F1,
        "sample_rate_hz": 10_000.0,
        "kind": "series_voltage",
        "amplitude_unit": "V",
        "bases": BASES,
        "operating_point": {"op_id": "p1", "active_power_mw": 0.6, "terminal_voltage_pu": 1.0},
        "experiments": told,
        "configuration": {},
        **more,
    }
    path.write_text(json.dumps(content))
    return path


def identified(tmp_path, *arguments, status=0):
    """Run the command; its table's only response and what it said."""
    output = tmp_path / "y.parquet"
    jobs = () if "--jobs" in arguments else ("--jobs", 1)
    done = command("identify", *arguments, *jobs, "-o", output, "--force")
    assert done.returncode == status, done.stderr
    if status in (0, 1):
        assert validate_table(output) == []
        return read_table(output).responses[0], done.stderr
    assert not output.exists()
    return None, done.stderr


def branch_matrix(f_hz):
    """Y of the branch at one point."""
    return np.diag([branch_y(f_hz), np.conj(branch_y(2.0 * F1 - f_hz))])


def test_a_folder_of_recordings_without_a_manifest_becomes_a_table(tmp_path):
    (tmp_path / "records").mkdir()
    write(tmp_path / "records")
    response, said = identified(tmp_path, tmp_path / "records", "--direction", "load")
    assert response.f_hz == pytest.approx(sorted([31.0, 2 * F1 - 31.0, 77.0, 2 * F1 - 77.0, 153.0]), abs=1e-4)
    for f, y in zip(response.f_hz, response.y, strict=True):
        assert np.linalg.norm(y - branch_matrix(f)) < 1e-5 * np.linalg.norm(y)  # single precision
    assert "shot_000.cfg: voltage: Va [V], Vb [V], Vc [V] (phases)" in said
    assert "the file says 50 Hz, its data 49.97 Hz: the data is believed" in said
    assert "no rating given" in said


def test_with_a_manifest_the_rows_are_those_it_asks_for_in_its_bases(tmp_path):
    told = write(tmp_path, negate=True)
    path = manifest(tmp_path / "manifest.json", told, direction="generator")
    response, _ = identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--manifest", path)
    meta = read_table(tmp_path / "y.parquet").meta
    assert response.f_hz == pytest.approx(POINTS, abs=1e-6)
    for f, y in zip(response.f_hz, response.y, strict=True):
        assert np.linalg.norm(y - branch_matrix(f)) < 1e-5 * np.linalg.norm(y)
    assert response.quality["amplitude_pu"] == pytest.approx(2.815 / (690.0 * (2 / 3) ** 0.5))
    assert meta["bases"]["rated_power_va"] == BASES["rated_power_va"]
    assert meta["operating_points"][0]["op_id"] == "p1"
    assert "recordings" in meta["configuration"]
    assert meta["plant"]["source_direction"] == "generator"


def test_steady_records_prove_the_device_stable_on_the_grid_they_were_taken_on(tmp_path):
    (tmp_path / "records").mkdir()
    write(tmp_path / "records", length_s=3.0)
    response, _ = identified(tmp_path, tmp_path / "records", "--direction", "load", "--stable-on", "0.02+0.1j")
    fact = response.meta["stable_on"]
    assert (fact["grid"], fact["basis"]) == ({"r_ohm": 0.02, "x_ohm": 0.1}, "recordings")
    assert 0.0 < fact["growth_bound_per_s"] < 15.0  # of records of 3 s
    assert 1.0 < fact["disturbed_s"] <= 3.0
    found = response.meta["fundamental"]
    expected = -1e6 * response.meta["active_power_mw"]
    assert found["active_power_into_device_w"] == pytest.approx(expected, rel=1e-6)
    assert found["voltage_v"] == pytest.approx(
        response.meta["terminal_voltage_pu"] * read_table(tmp_path / "y.parquet").meta["bases"]["rated_voltage_v"]
    )
    response, _ = identified(tmp_path, tmp_path / "records", "--direction", "load")
    assert "stable_on" not in response.meta  # which grid it was nobody said


def test_recordings_are_matched_by_name_then_by_order(tmp_path):
    told = write(tmp_path, POINTS[:1])
    (tmp_path / "scope.cfg").write_bytes((tmp_path / "shot_001.cfg").read_bytes())
    (tmp_path / "shot_001.dat").rename(tmp_path / "scope.dat")
    (tmp_path / "shot_001.cfg").unlink()
    named = [told[0], {**told[1], "recording": "scope.cfg"}]
    path = manifest(tmp_path / "m.json", named, direction="load")
    recordings = [tmp_path / "shot_000.cfg", tmp_path / "scope.cfg"]
    assert len(identified(tmp_path, *recordings, "--manifest", path)[0]) == 1
    others = [{**each, "file": f"x{k}.csv"} for k, each in enumerate(told)]
    path = manifest(tmp_path / "m.json", others, direction="load")
    response, said = identified(tmp_path, *recordings, "--manifest", path)
    assert "matched with experiments by order" in said
    assert np.linalg.norm(response.y[0] - branch_matrix(31.0)) < 1e-5 * np.linalg.norm(response.y[0])


def test_several_experiments_may_follow_one_another_in_one_recording(tmp_path):
    told, parts = [], []
    for k, at in enumerate(both(77.0)):
        parts.append(branch((at,), length_s=3.0, background=()))
        shot = {"f_hz": 77.0, "injected_hz": at, "amplitude": 2.815, "phase_rad": 0.0}
        told.append({"file": "all.csv", "shots": [shot], "start_s": 3.0 * k, "settle_s": 0.5, "duration_s": 2.5})
    whole = Stretch(np.concatenate([p.v for p in parts]), np.concatenate([p.i for p in parts]))
    files.comtrade(tmp_path / "all", files.six(whole), form="FLOAT32")
    path = manifest(tmp_path / "m.json", told, direction="load")
    response, _ = identified(tmp_path, tmp_path / "all.cfg", "--manifest", path)
    assert list(response.f_hz) == [77.0]
    assert np.linalg.norm(response.y[0] - branch_matrix(77.0)) < 1e-5 * np.linalg.norm(response.y[0])


def test_a_clipped_stretch_of_a_long_recording_costs_no_other(tmp_path):
    parts = [branch((at,), length_s=6.0, background=()) for f in (31.0, 77.0) for at in both(f)]
    samples = files.six(Stretch(np.concatenate([p.v for p in parts]), np.concatenate([p.i for p in parts])))
    samples[62_000:118_000, 3] = np.clip(samples[62_000:118_000, 3], -500.0, 500.0)
    files.comtrade(tmp_path / "all", samples, form="FLOAT32")
    response, said = identified(tmp_path, tmp_path / "all.cfg", "--direction", "load", status=1)
    assert [(round(f), status) for f, status in zip(response.f_hz, response.status, strict=True)] == [
        (23, "ok"),
        (31, "failed"),
        (69, "failed"),
        (77, "ok"),
    ]
    assert "all.cfg: left out: Ia clipped (6." in said


def test_a_recording_that_cannot_be_used_costs_its_points_and_no_others(tmp_path):
    told = write(tmp_path)
    samples = files.six(branch((77.0,), length_s=3.0))
    samples[:, 3] = np.clip(samples[:, 3], -500.0, 500.0)
    files.comtrade(tmp_path / "shot_002", samples, form="FLOAT32")
    path = manifest(tmp_path / "m.json", told, direction="load")
    response, said = identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--manifest", path, status=1)
    assert list(response.status) == ["ok", "failed", "ok"]
    assert "the mirror experiment at 77 Hz is missing" in response.reason[1]
    assert "shot_002.cfg: left out: Ia clipped" in said


def test_a_point_of_the_manifest_without_any_recording_is_a_failed_row(tmp_path):
    told = write(tmp_path)
    for stem in ("shot_002", "shot_003"):
        (tmp_path / f"{stem}.cfg").unlink()
    path = manifest(tmp_path / "m.json", told, direction="load")
    response, said = identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--manifest", path, status=1)
    assert list(response.status) == ["ok", "failed", "ok"]
    assert "no recording of shot_002.csv" in said


def test_the_table_does_not_depend_on_the_number_of_workers(tmp_path):
    write(tmp_path, (31.0, 77.0), noise=1e-3)
    tables = []
    for jobs in (1, 2):
        identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--direction", "load", "--jobs", jobs)
        tables.append((tmp_path / "y.parquet").read_bytes())
    assert tables[0] == tables[1]


def test_recordings_cannot_be_confirmed_and_are_refused_by_name(tmp_path):
    write(tmp_path, (20.0, 31.0, 77.0, 115.0, 153.0, 203.0, 250.3, 330.3, 400.3, 560.3), length_s=2.0)
    identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--direction", "load")
    done = command("tune", tmp_path / "y.parquet", "--grid", "0.012+0.25j", "--confirm")
    assert done.returncode == 2
    assert "recordings and imports cannot be confirmed" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "in which direction was the current recorded"),
        (["--direction", "up"], "--direction 'up': it is load"),
        (["--direction", "load", "--f1", "fast"], "--f1 'fast': it is auto, or a frequency"),
        (["--direction", "load", "--f1", "60"], "said to be 60 Hz, and the strongest line of the voltage is at 49.97"),
        (["--direction", "load", "--channels", "vx=Va"], "is not ROLE=NAME"),
        (["--direction", "load", "--channels", "va=None"], "no channel is called 'None'"),
        (["--direction", "load", "--manifest", "none.json"], "none.json: no such file"),
        (["--direction", "load", "--rated-voltage-v", "690"], "go together"),
        (["--direction", "load", "nowhere.cfg"], "nowhere.cfg: no such file"),
    ],
)
def test_wrong_calls_are_refused_in_one_message_and_nothing_is_written(tmp_path, arguments, words):
    files.comtrade(tmp_path / "a", files.six(branch((77.0,), length_s=0.3)))
    _, said = identified(tmp_path, tmp_path / "a.cfg", *arguments, status=2)
    assert words in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": "2.0.0"}, "version"),
        ({"format": "other"}, "format"),
        ({"experiments": []}, "experiments"),
        ({"bases": {}}, "rated_voltage_v"),
        ({"experiments": [{"file": "x", "shots": [{"f_hz": -1, "injected_hz": 1, "amplitude": 1}]}]}, "experiments[0]"),
        ({"f1_hz": 60.0}, "is neither 31 Hz nor its mirror 89 Hz"),
    ],
)
def test_a_manifest_of_another_form_is_refused_with_the_place(tmp_path, change, words):
    told = write(tmp_path, POINTS[:1], length_s=0.3)
    path = manifest(tmp_path / "m.json", told, **change)
    _, said = identified(tmp_path, tmp_path / "shot_000.cfg", "--manifest", path, "--direction", "load", status=2)
    assert words in said


def test_a_recording_without_a_tone_says_what_to_do(tmp_path):
    files.comtrade(tmp_path / "a", files.six(branch((), length_s=2.0, background=())), form="FLOAT32")
    _, said = identified(tmp_path, tmp_path / "a.cfg", "--direction", "load", status=2)
    assert "no tone stands above the noise" in said


def test_where_nothing_can_be_used_every_reason_is_said_once(tmp_path):
    told = write(tmp_path, POINTS[:1], length_s=0.3)
    for path in tmp_path.glob("*.dat"):
        path.unlink()
    path = manifest(tmp_path / "m.json", [told[0], {**told[0], "start_s": 0.3}, told[1]], direction="load")
    _, said = identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--manifest", path, status=2)
    assert said.count("no recording could be used") == 1
    assert [said.count(f"shot_00{k}.cfg: its .dat file is missing") for k in (0, 1)] == [1, 1], said


@pytest.mark.parametrize("content", [{"y": [1]}, {"format": "truth"}, [1, 2], "text"])
def test_a_json_that_is_no_manifest_is_refused_in_one_sentence(tmp_path, content):
    files.comtrade(tmp_path / "a", files.six(branch((77.0,), length_s=0.3)))
    (tmp_path / "truth.json").write_text(json.dumps(content))
    arguments = (tmp_path / "a.cfg", "--manifest", tmp_path / "truth.json", "--direction", "load")
    _, said = identified(tmp_path, *arguments, status=2)
    assert "truth.json: no seqsweep manifest" in said
    assert "`seqsweep inject` writes them" in said
    assert "$" not in said


def test_the_spread_of_a_noisy_row_is_seen_to_exceed_the_limit():
    y = np.full((2, 2), 0.5 + 0j)  # of norm 1
    for spread, words in ((0.1004, "is 0.1004 of it, 0.1 is"), (0.3456, "is 0.35 of it"), (np.nan, "is nan of it")):
        status, reason = _loud_enough(y, np.eye(8) * spread**2 / 8.0)
        assert status == "noisy"
        assert words in reason
    assert _loud_enough(y, np.eye(8) * 0.0999**2 / 8.0) == ("ok", "")


def test_a_sampling_rate_that_makes_the_fundamental_absurd_is_said(tmp_path):
    for k, at in enumerate(both(77.0)):
        files.comtrade(tmp_path / f"a{k}", files.six(branch((at,), length_s=3.0)), rate_hz=8000.0)
    _, said = identified(tmp_path, tmp_path / "a0.cfg", tmp_path / "a1.cfg", "--direction", "load")
    assert "a fundamental of 39.976 Hz is unusual; were it 50 Hz, the sampling rate would be 10006 Hz" in said


TRUTH = json.loads((DATA / "truth.json").read_text())
FOLDERS = sorted(path.name for path in DATA.iterdir() if path.is_dir() and not path.name.startswith("__"))


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_recordings_in_data_give_the_truth_beside_them_in_every_format(tmp_path, folder):
    """Written by other code than the readers; 1e-3 is the turbine's own nonlinearity at twelve tones of 0.002 pu."""
    direction = "generator" if folder == "pscad" else "load"
    request = request_of([DATA / folder], DATA / "manifest.json", "", direction, "auto", None, (None, None), None)
    assert identify(request, tmp_path / "y.parquet", jobs=1).all_ok
    response = read_table(tmp_path / "y.parquet").responses[0]
    exact = np.array([[complex(*at[name]) for name in ("pp", "pn", "np", "nn")] for at in TRUTH["y"]]).reshape(-1, 2, 2)
    assert list(response.f_hz) == [at["f_hz"] for at in TRUTH["y"]]
    assert relative_norms(response.y - exact, exact).max() < 1e-3


def test_the_same_data_give_the_same_admittance_as_the_sweep():
    """Records of the reference turbine, from the sweep's own settled state, heard with nothing known but the tones.

    The sweep stops when two windows agree to the tolerance asked (1e-9); the record begins when all is long at rest.
    """
    config = Config.from_dict(
        {
            "campaign": {"name": "same"},
            "plant": {"id": "dpmsg-v1"},
            "operating_point": [{"id": "p", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_hz": [23.0, 250.0], "tolerance": 1e-9, "probes": 0},
            "injection": {"amplitude_pu": 0.0005},
        }
    )
    plant = make_plant("dpmsg-v1")
    plan = make_plan(config, plant)
    rows = {row.f_hz: row for batch in plan.batches() for row in measure(plant, batch).rows}
    state = baseline(plant, next(plan.batches())).state
    found = []
    for shot in plan.shots():
        settled, _ = plant.run([Job(state, shot.injection)], round(15.0 / plan.dt_s))[0]
        _, record = plant.run([Job(settled, shot.injection)], round(2.0 / plan.dt_s))[0]
        waveforms = by_hand.Heard(Stretch(record.v, record.i, record.dt_s), t0_s=record.t0_s)
        (heard,) = hear(waveforms, 0, waveforms.n_samples, (shot.injected_hz,))
        found.append(Experiment("", heard, shot.f_hz))
    for point in points_of(found, plan.f1_hz):
        row = rows[min(rows, key=lambda f: abs(f - point.f_hz))]
        swept = np.array(row.y[0::2]) + 1j * np.array(row.y[1::2])
        difference = np.linalg.norm(point.y.ravel() - swept) / np.linalg.norm(swept)
        print(f"{point.f_hz:g} Hz: recording and sweep differ by {difference:.1e}")
        assert difference < 1e-8


# Kinds of recordings that misled; `test_recorded_kinds` draws many of each


def written(path, stretch):
    """A stretch as COMTRADE in single precision."""
    return files.comtrade(path, files.six(stretch), form="FLOAT32", rate_hz=1.0 / stretch.dt_s)


def errors(response, device):
    """Relative errors of all rows."""
    truth = np.array([device.y(f) for f in response.f_hz])
    return relative_norms(response.y - truth, truth)


def test_five_tones_at_once_and_their_mirrors_in_another_file_are_all_found_without_a_manifest(tmp_path):
    rng, device, at_once = np.random.default_rng(4), Device(), [17.0, 29.0, 41.0, 66.0, 128.0]
    for name, played in (("a", at_once), ("b", [100.0 - f for f in at_once])):
        lines = tones(rng, played, 1.6)(50.0)
        parts = [device.stretch({}, 0.5, 2.5e-4), device.stretch(lines, 6.0, 2.5e-4, t0_s=0.5)]
        written(tmp_path / name, joined(parts))
    response, said = identified(tmp_path, tmp_path / "a.cfg", tmp_path / "b.cfg", "--direction", "load")
    assert response.f_hz == pytest.approx([17, 29, 34, 41, 59, 66, 71, 83, 128], abs=1e-3)
    assert errors(response, device).max() < 1e-4
    assert "fundamental: 50 Hz, 400 V line to line, 18.72 kW into the device" in said


def test_tones_of_two_seconds_one_after_another_are_found_and_what_is_not_used_is_named(tmp_path):
    rng, device, parts = np.random.default_rng(4), Device(), []
    always = {250.0: 4.0, 178.3: 3.0}
    for at in (3.0, 97.0, 130.0, -30.0):
        played = {**tones(rng, [at], 3.0)(50.0), **always}
        parts.append(device.stretch(played, 2.0, 5e-4, t0_s=2.5 * len(parts) / 2, noise=1e-4, rng=rng))
        parts.append(device.stretch(always, 0.5, 5e-4, t0_s=2.5 * (len(parts) // 2) + 2.0, noise=1e-4, rng=rng))
    written(tmp_path / "long", joined(parts))
    response, said = identified(tmp_path, tmp_path / "long.cfg", "--direction", "load")
    assert response.f_hz == pytest.approx([3.0, 97.0, 130.0], abs=2e-3)
    assert errors(response, device).max() < 2e-3
    assert "not used: lines that are always there, at 178.3, 250 Hz" in said


def test_a_tone_on_a_harmonic_of_the_lead_in_is_right_with_a_manifest(tmp_path):
    rng, device, harmonic, told = np.random.default_rng(4), Device(), {250.0: 8.0 * np.exp(1j)}, []
    for k, at in enumerate((250.0, -150.0)):
        lines = tones(rng, [at], 5.0)(50.0)
        both_lines = {f: lines.get(f, 0.0) + harmonic.get(f, 0.0) for f in {**lines, **harmonic}}
        parts = [device.stretch(harmonic, 0.8, 5e-4), device.stretch(both_lines, 1.2, 5e-4, t0_s=0.8)]
        written(tmp_path / f"shot_{k}", joined(parts))
        shot = {"f_hz": 250.0, "injected_hz": at, "amplitude": 5.0, "phase_rad": 0.0}
        told.append({"file": f"shot_{k}.csv", "shots": [shot], "start_s": 0.8, "settle_s": 0.1, "duration_s": 1.0})
    path = manifest(tmp_path / "m.json", told, direction="load", f1_hz=50.0)
    response, said = identified(tmp_path, *sorted(tmp_path.glob("*.cfg")), "--manifest", path)
    assert list(response.status) == ["ok"]
    assert errors(response, device).max() < 1e-5
    assert "was there before the tone" in said


def test_a_reversed_current_transformer_is_named_and_the_admittance_right(tmp_path):
    rng, device = np.random.default_rng(4), Device()
    for name, at in (("a", 77.0), ("b", 23.0)):
        samples = files.six(device.stretch(tones(rng, [at], 5.0)(50.0), 2.0, 5e-4))
        samples[:, 4] *= -1.0
        files.comtrade(tmp_path / name, samples, form="FLOAT32", rate_hz=2000.0)
    response, said = identified(tmp_path, tmp_path / "a.cfg", tmp_path / "b.cfg", "--direction", "load")
    assert errors(response, device).max() < 1e-5
    assert "a.cfg: Ib is recorded with the opposite sign (a reversed transformer): turned" in said


# Units and direction


def test_power_into_the_device_is_said_with_the_direction_that_would_explain_it(tmp_path):
    """The branch is a load: counted as a generator's its current would deliver power, which is nothing to say."""
    write(tmp_path, (77.0,))
    out = tmp_path / "y.parquet"
    load, generator = (
        command("identify", tmp_path, "-o", out, "--direction", direction, "--force", "--jobs", "1").stderr
        for direction in ("load", "generator")
    )
    assert "MW when its current counts as --direction load says; if it generates" in load
    assert "--direction generator" in load
    assert "takes up" not in generator


def test_units_are_told_where_the_files_do_not(tmp_path):
    for k, at in enumerate(both(77.0)):
        stretch = branch((at,), length_s=2.0)
        samples = files.six(Stretch(stretch.v / 1e3, stretch.i / 1e3))
        files.text(tmp_path / f"{k}.csv", samples, heads=list(files.NAMES))
    arguments = ["identify", tmp_path, "-o", tmp_path / "y.parquet", "--direction", "load", "--jobs", "1"]
    rating = ["--rated-voltage-v", "690", "--rated-power-va", "1.632e6"]
    refused = command(*arguments, *rating)
    assert refused.returncode == 2
    assert "its numbers as kV would be" in refused.stderr
    done = command(*arguments, *rating, "--voltage-unit", "kV", "--current-unit", "kA")
    assert done.returncode == 0, done.stderr
    response = read_table(tmp_path / "y.parquet").responses[0]
    truth = np.array([branch_matrix(f) for f in response.f_hz])
    assert relative_norms(response.y - truth, truth).max() < 1e-4
