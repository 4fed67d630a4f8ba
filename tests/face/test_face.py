"""The front door: `import seqsweep` costs nothing, and the ten lines of a notebook do the whole job."""

from __future__ import annotations

import hashlib
import json
import pickle
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import seqsweep as ss
from seqsweep.sweep.cli import main as command

matplotlib.use("agg")


def step(i, v, dt):
    """One step of an R-L load, as a colleague writes it."""
    i = i + dt / 5e-3 * (v - 2.0 * i)
    return i, i


def load():
    return ss.plant_from_step(step, 0j, dt_s=50e-6, voltage_v=400.0, power_va=10e3)


def closed_form(f_hz, dt_s=50e-6, r_ohm=2.0, l_h=5e-3):
    """Y of that step, i[k+1] = i[k] + dt/L (v[k] - R i[k]), whose voltage is held from its start."""
    z = np.exp(2j * np.pi * np.asarray(f_hz) * dt_s)
    return dt_s / l_h / (z - 1.0 + r_ohm * dt_s / l_h)


@pytest.fixture(scope="module")
def y():
    """The turbine at a handful of points: enough for a fit, cheap enough for every test here."""
    return ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(4.0, 400.0, 24), jobs=2, progress=False)


@pytest.fixture(scope="module")
def tuning(y):
    return ss.tune(y, grid="0.012+0.25j", scale=1.4)


# The import


def test_the_import_takes_no_longer_than_numpy_and_20_ms():
    """In a process of its own, after numpy, the best of ten: nothing of ours is imported but the face itself."""
    program = (
        "import time, numpy, sys; begin = time.process_time(); import seqsweep; used = time.process_time() - begin\n"
        "ours = [name for name in sys.modules if name.startswith('seqsweep.')]\n"
        "print(used); print(*ours)"
    )
    for _ in range(10):  # a busy machine makes any one of them slow
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        used, *ours = done.stdout.split("\n")
        if float(used) < 0.02:
            break
    assert float(used) < 0.02
    assert "".join(ours).strip() == ""


def test_every_name_of_the_face_is_there_and_listed():
    assert set(ss.__all__) <= set(dir(ss))
    for name in ss.__all__:
        assert getattr(ss, name) is not None
    assert ss.__version__ == __import__("importlib.metadata").metadata.version("seqsweep")


def test_a_misspelt_name_is_told_the_nearest_one():
    with pytest.raises(AttributeError, match=r"no attribute 'log_gird' \(did you mean 'log_grid'\?\)"):
        _ = ss.log_gird


def test_a_folder_that_shares_its_name_with_a_function_is_both():
    import seqsweep.sweep.plan as plan

    assert callable(ss.sweep)
    assert plan.Plan is sys.modules["seqsweep.sweep.plan"].Plan
    assert ss.sweep.plan is plan
    assert "active_power_mw" in __import__("inspect").signature(ss.sweep).parameters


# The ten lines


def test_a_sweep_is_a_response_that_shows_itself(y):
    assert repr(y) == "<FrequencyResponse p065: 24 rows, 4 to 400 Hz, 24 ok, error <= 5.8e-06>"
    assert y._repr_html_().count("<tr>") == 12  # the head, five rows of either end, and what is left out
    assert y.z @ y.y == pytest.approx(np.broadcast_to(np.eye(2), (24, 2, 2)), abs=1e-12)
    frame = y.to_dataframe()
    assert frame.index.name == "f_hz"
    assert np.array_equal(frame["y_pn"].to_numpy(), y.y[:, 0, 1])


def test_rows_are_chosen_as_numpy_does_it(y):
    low = y[y.f_hz < 50.0]
    assert np.array_equal(low.y, y.y[y.f_hz < 50.0])
    assert np.array_equal(low.quality["residual"], y.quality["residual"][y.f_hz < 50.0])
    assert len(y[3]) == 1
    assert y[3].f_hz[0] == y.f_hz[3]
    assert low.meta == y.meta


def test_frames_come_back_to_themselves(y):
    there = y.to_frame("dq")
    assert np.allclose(there.f_hz, y.f_hz - 50.0)
    assert np.allclose(there.to_frame("pn").y, y.y, rtol=1e-12)


def test_interpolation_meets_a_point_that_it_has_not_seen(y):
    """Every other row of the sweep is kept, and the one in the middle of the rest is foretold."""
    half = y[::2]
    k = len(y) // 2 | 1
    error = np.linalg.norm(half.interpolate(float(y.f_hz[k])) - y.y[k]) / np.linalg.norm(y.y[k])
    assert error < 0.02  # 12 rows for a turbine; that it is certified is the business of adaptive sweeps
    assert half.interpolate(y.f_hz).shape == (24, 2, 2)


def test_the_verdict_the_gain_and_the_proof_in_time(tuning):
    assert tuning.verdict == "unstable"
    assert tuning.margin_m == pytest.approx(0.953, abs=2e-3)
    assert tuning.k == pytest.approx(0.319, abs=2e-3)
    assert "unstable" in repr(tuning)
    proof = ss.verify(tuning, plant="dpmsg-v1")
    without, damped = proof.reports
    assert without.outcome.startswith("synchronism lost")
    assert damped.outcome.startswith("calm")
    assert "without" in repr(proof)
    assert proof.plot().shape == (4,)


def test_plots_return_axes_and_take_some(y, tuning):
    import matplotlib.pyplot as plt

    axes = y.plot()
    assert axes.shape == (4, 2)
    assert y.plot(ax=axes) is axes
    single = plt.figure().subplots()
    assert y.plot(ax=single) is single
    assert len(single.get_lines()) == 4
    assert tuning.plot().shape == (6,)
    assert tuning.plot(ax=plt.figure().subplots()).get_lines()
    plt.close("all")


def test_a_sweep_and_the_command_line_give_the_same_bytes(y, tmp_path, monkeypatch):
    """One configuration object and one runner stand behind both."""
    (tmp_path / "same.toml").write_text(
        """
        [campaign]
        name = "notebook"
        [plant]
        id = "dpmsg-v1"
        [[operating_point]]
        id = "p065"
        active_power_mw = 0.65
        terminal_voltage_pu = 1.0
        [sweep]
        f_min_hz = 4.0
        f_max_hz = 400.0
        points = 24
        spacing = "log"
        """
    )
    line = ["run", str(tmp_path / "same.toml"), "-o", str(tmp_path / "command.parquet"), "--jobs", "1"]
    monkeypatch.setattr(sys, "argv", ["seqsweep", *line])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 0
    ss.write_table(tmp_path / "face.parquet", y)
    ss.Campaign.from_toml(tmp_path / "same.toml").run(tmp_path / "campaign.parquet", jobs=1, progress=False)
    sums = {hashlib.sha256(path.read_bytes()).hexdigest() for path in tmp_path.glob("*.parquet")}
    assert len(list(tmp_path.glob("*.parquet"))) == 3
    assert len(sums) == 1
    again = ss.read_table(tmp_path / "face.parquet")["p065"]
    assert np.array_equal(again.y, y.y)
    ss.write_table(tmp_path / "again.parquet", again)
    assert (tmp_path / "again.parquet").read_bytes() == (tmp_path / "face.parquet").read_bytes()


def test_several_operating_points_are_a_table():
    table = ss.sweep(
        "branch-v1", active_power_mw=[0.1, 0.2, 0.2], f_hz=[10.0, 80.0], terminal_voltage_pu=[1.0, 1.0, 0.9]
    )
    assert table.op_ids == ("p010", "p020", "p020_2")
    assert table["p020_2"].meta["terminal_voltage_pu"] == pytest.approx(0.9)
    assert repr(table).count("\n") == 3
    assert table.to_dataframe().index.names == ["op_id", "f_hz"]
    with pytest.raises(ss.SeqsweepError, match="no operating point 'p1' in the table; it has p010, p020"):
        table["p1"]


def test_a_linear_load_made_here_is_swept_as_it_is():
    """Unisolated, and no backend is named; against the closed form of its own step."""
    with pytest.warns(UserWarning, match="half a step of delay"):
        y = ss.sweep(load(), active_power_mw=0.0, f_hz=[10.0, 80.0, 400.0], tolerance=1e-8)
    assert y.ok.all()
    assert np.allclose(y.y[:, 0, 0], closed_form(y.f_hz), rtol=1e-6)
    assert y.meta["table"]["plant"]["live"] is True


def test_a_plant_made_by_name_is_remembered_with_its_parameters():
    y = ss.sweep(ss.make_plant("branch-v1", r_ohm=0.02), active_power_mw=0.0, f_hz=[10.0, 80.0])
    assert y.meta["table"]["configuration"]["plant"] == {"id": "branch-v1", "parameters": {"r_ohm": 0.02}}
    assert "live" not in y.meta["table"]["plant"]


def test_a_plant_is_held_against_its_promise():
    findings = ss.check_plant(load())
    assert findings.passed
    assert repr(findings).startswith("pass  attributes")


def test_tables_go_out_and_come_in(y, tmp_path):
    ss.export(y, tmp_path / "y.csv")
    back = ss.import_table(tmp_path / "y.csv")["p065"]
    assert np.allclose(back.y, y.y, rtol=1e-12)


def test_recordings_are_identified(tmp_path):
    """The recordings that come with the project, against the admittance that comes with them."""
    data = Path(__file__).parents[2] / "data"
    with pytest.warns(UserWarning, match=r"\.csv: "):
        found = ss.identify(
            data / "csv", manifest=data / "manifest.json", direction="load", output=tmp_path / "y.parquet"
        )
    truth = json.loads((data / "truth.json").read_text())
    assert found.usable.all()
    exact = {row["f_hz"]: complex(*row["pp"]) for row in truth["y"]}
    assert all(abs(y[0, 0] - exact[f]) < 2e-3 * abs(exact[f]) for f, y in zip(found.f_hz, found.y, strict=True))
    assert np.array_equal(ss.read_table(tmp_path / "y.parquet")[found.meta["op_id"]].y, found.y)


def test_metrics_and_a_bank_of_one_grid(y, tmp_path):
    found = ss.metrics(y)
    assert found.op_id == "p065"
    (tmp_path / "weak.toml").write_text('[[element]]\nkind = "series"\nr_ohm = 0.0168\nx_ohm = 0.35\n', "utf-8")
    (pair,) = ss.judge(y, tmp_path, jobs=1, elements=0)
    assert pair.verdict == "unstable"  # as `tune` says of 1.4 times the grid of the paper
    with pytest.raises(ss.SeqsweepError, match="nowhere"):
        ss.judge(y, tmp_path / "nowhere")


# What is refused


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"f_hz": ss.log_grid(1, 100, 5), "tolerence": 1e-3}, "did you mean tolerance"),
        ({"f_hz": [10.0], "grid": "about 1 ohm"}, "write it as 0.012"),
        ({"f_hz": [10.0], "terminal_voltage_pu": [1.0, 1.0]}, "1 powers but 2 voltages"),
        ({"f_hz": [50.0]}, "50 Hz is the fundamental itself"),
        ({"f_hz": [10.0], "parameters": {"r_omh": 1.0}}, r"did you mean 'r_ohm'\?"),
    ],
)
def test_what_cannot_be_swept_is_refused_in_words(given, words):
    with pytest.raises(ss.SeqsweepError, match=words):
        ss.sweep("branch-v1", active_power_mw=0.1, **given)


def test_parameters_of_an_object_are_refused():
    with pytest.raises(ss.SeqsweepError, match="made with its own already"):
        ss.sweep(load(), active_power_mw=0.0, f_hz=[10.0], parameters={"r_ohm": 1.0})


def test_an_output_that_is_there_is_not_replaced_unasked(tmp_path):
    (tmp_path / "y.parquet").write_text("something else")
    campaign = ss.Campaign.from_dict(
        {
            "campaign": {"name": "x"},
            "plant": {"id": "branch-v1"},
            "operating_point": [{"id": "p", "active_power_mw": 0.1, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_hz": [10.0]},
        }
    )
    assert repr(campaign) == "<Campaign x: branch-v1 at p>"
    assert campaign.plan().n_shots == 4
    with pytest.raises(ss.SeqsweepError, match="exists; force=True replaces it"):
        campaign.run(tmp_path / "y.parquet")
    assert len(campaign.run()["p"]) == 1


def test_an_interrupted_sweep_hands_over_what_it_has():
    """Ctrl-C in the middle: the rows that are done are in the exception, and they are those of a whole sweep."""
    whole = ss.sweep(load(), active_power_mw=0.0, f_hz=ss.log_grid(10, 100, 12))
    plant, calls = load(), []
    run = plant.run

    def interrupted(jobs, n_steps):
        calls.append(n_steps)
        if len(calls) == 20:
            raise KeyboardInterrupt
        return run(jobs, n_steps)

    plant.run = interrupted
    with pytest.raises(ss.SweepInterrupted, match="rows are measured") as stopped:
        ss.sweep(plant, active_power_mw=0.0, f_hz=ss.log_grid(10, 100, 12))
    partial = stopped.value.partial
    assert 0 < len(partial) < len(whole)
    assert np.array_equal(partial.y, whole.y[np.isin(whole.f_hz, partial.f_hz)])


def test_progress_in_a_notebook_is_one_line_that_changes(monkeypatch):
    """Stand-ins for IPython: what is shown first, what replaces it, and that nothing is left."""
    from types import SimpleNamespace

    from seqsweep.sweep.cli import progress

    texts = []
    handle = SimpleNamespace(update=lambda data, raw: texts.append(data["text/plain"]))

    def display(data, raw, display_id):
        texts.append(data["text/plain"])
        return handle

    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=1)))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    monkeypatch.setattr(progress, "QUIET_S", 0.0)
    monkeypatch.setattr(progress, "REDRAWN_S", 0.0)
    with progress.progress() as shown:
        shown.report(0, 10, 0.0)
        shown.report(2, 10, 0.2)
        shown.report(5, 10, 0.5)
        shown.say("p0: at shot 3 of 8")
    assert texts[0] == "0/10 points"
    assert texts[1] == "2/10 points"
    assert texts[2].startswith("5/10 points, about 0.0 s left")
    assert texts[3] == "p0: at shot 3 of 8"
    assert texts[-1] == ""


# The type itself


def response(**changes):
    given = {"f_hz": [1.0, 2.0], "y": np.ones((2, 2, 2)), "f1_hz": 50.0, "meta": {"op_id": "p", "table": {"a": 1}}}
    return ss.FrequencyResponse(**{**given, **changes})


def test_a_response_is_a_key_and_equal_to_itself():
    one, other = response(), response()
    assert one == one
    assert one != other
    assert {one: 1}[one] == 1


def test_a_response_cannot_be_changed_and_travels():
    one = response()
    for facts in (one.meta, one.meta["table"], one.quality):
        with pytest.raises(TypeError, match="cannot be changed"):
            facts["a"] = 2
    with pytest.raises(TypeError, match="cannot be changed"):
        one.meta.update(a=2)
    there = pickle.loads(pickle.dumps(one))
    assert there.meta == one.meta
    assert {**one.meta, "b": 2}["b"] == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"f_hz": [1.0, np.nan]}, "f_hz of row 1 is nan"),
        ({"f_hz": [1.0, np.inf]}, "f_hz of row 1 is inf"),
        ({"frame": "abc"}, "frame is 'abc'; known: 'pn', 'dq'"),
        ({"f_hz": [2.0, 1.0]}, "must increase strictly"),
    ],
)
def test_a_response_that_makes_no_sense_is_refused(changes, words):
    with pytest.raises(ss.SeqsweepError, match=words):
        response(**changes)


def test_z_is_unknown_where_there_is_no_inverse():
    y = np.array([[[1.0, 0.0], [0.0, 2.0]], [[1.0, 1.0], [1.0, 1.0]], [[np.nan, 1.0], [1.0, 1.0]]])
    z = ss.FrequencyResponse([1.0, 2.0, 3.0], y, 50.0).z
    assert np.array_equal(z[0], [[1.0, 0.0], [0.0, 0.5]])
    assert np.isnan(z[1:]).all()


def test_a_campaign_over_a_region_runs_here_as_from_the_command_line(tmp_path):
    campaign = ss.Campaign.from_dict(
        {
            "campaign": {"name": "region"},
            "plant": {"id": "dpmsg-v1"},
            "sweep": {
                "f_hz": [10.0, 23.0, 77.0, 140.0, 300.0],
                "operating_points": {
                    "active_power_mw": [0.4, 0.5],
                    "terminal_voltage_pu": [0.98, 1.02],
                    "tolerance": 0.05,
                    "most": 8,
                },
            },
            "injection": {"amplitude_pu": 0.0005},
        }
    )
    with pytest.raises(ss.SeqsweepError, match="chosen while it runs"):
        campaign.plan()
    table = campaign.run(tmp_path / "y.parquet", progress=False)
    assert 3 <= len(table.responses) <= 8
    assert [path.name for path in tmp_path.iterdir()] == ["y.parquet"]
