"""Confirming and verifying a foreign device: the same answers, and never in the runner."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.confirm import sweep_with_damping
from seqsweep.tuning.result import write_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune

from ..support.commands import command

MODULE = """
import os, pathlib
from seqsweep.plant.turbine.reference import ReferenceTurbine
with open(pathlib.Path(__file__).with_name('importers'), 'a') as file:
    print(os.getpid(), file=file)
class Turbine(ReferenceTurbine):
    pass
"""
CAMPAIGN = {
    "campaign": {"name": "foreign"},
    "plant": {"id": "dpmsg-v1"},
    "operating_point": [{"id": "weak", "active_power_mw": 0.60, "grid": {"r_ohm": 0.012, "x_ohm": 0.25, "scale": 1.4}}],
    "sweep": {"f_min_hz": 2.0, "f_max_hz": 1000.0, "points": 40, "probes": 0},
}
GRID = SeriesRL(1.4 * 0.012, 1.4 * 0.25, 50.0)


def foreign(configuration):
    return {**configuration, "plant": {**configuration["plant"], "id": "python:foreign_turbine:Turbine"}}


@pytest.fixture
def module(tmp_path, monkeypatch):
    """The reference turbine under a foreign name, in a module that leaves word of who imports it."""
    (tmp_path / "foreign_turbine.py").write_text(MODULE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


def test_sweeping_again_with_damping_is_done_in_children_and_gives_the_same(module):
    wanted, found = (
        sweep_with_damping(Config.from_dict(configuration), "weak", GRID, 0.5, 77.0, jobs=1)
        for configuration in (CAMPAIGN, foreign(CAMPAIGN))
    )
    assert np.array_equal(found.y, wanted.y)
    assert (module / "importers").exists()
    assert "foreign_turbine" not in sys.modules


def test_verifying_is_done_in_a_child_and_says_the_same(module):
    table = module / "y.parquet"
    campaign = module / "campaign.toml"
    campaign.write_text(
        '[campaign]\nname = "foreign"\n[plant]\nid = "dpmsg-v1"\n[[operating_point]]\nid = "weak"\n'
        "active_power_mw = 0.6\ngrid = { r_ohm = 0.012, x_ohm = 0.25, scale = 1.4 }\n"
        "[sweep]\nf_min_hz = 2.0\nf_max_hz = 1000.0\npoints = 40\n"
    )
    assert command("run", campaign, "-o", table).returncode == 0
    write_json(tune(read_table(table), GRID), module / "tuning.json")
    content = json.loads((module / "tuning.json").read_text())
    content["provenance"]["table"]["configuration"] = foreign(content["provenance"]["table"]["configuration"])
    (module / "foreign.json").write_text(json.dumps(content))
    (module / "short.toml").write_text('duration_s = 0.5\n[[event]]\nkind = "grid_step"\ntime_s = 0.1\nscale = 1.4\n')
    said = [
        command("verify", module / f"{n}.json", "--scenario", module / "short.toml", "-o", module / f"{n}-out.json")
        for n in ("tuning", "foreign")
    ]
    assert [done.returncode for done in said] == [0, 0], said
    assert said[0].stdout == said[1].stdout.replace("python:foreign_turbine:Turbine", "dpmsg-v1")
    assert (module / "foreign-out.json").exists()
    assert (module / "importers").exists()
    wrong = command("verify", module / "foreign.json", "--op", "nowhere")
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("no operating point 'nowhere' in the tuning")


def test_the_grid_is_probed_in_a_child_and_found_the_same(module):
    found = []
    for plant in ("dpmsg-v1", "python:foreign_turbine:Turbine"):
        campaign = module / "grid.toml"
        campaign.write_text(
            f'[campaign]\nname = "grid"\n[plant]\nid = "{plant}"\n[[operating_point]]\nid = "firm"\n'
            "active_power_mw = 0.4\ngrid = { r_ohm = 0.012, x_ohm = 0.25 }\n[sweep]\nf_hz = [20.0]\n"
            '[source]\nkind = "thevenin"\n'
        )
        done = command("grid", campaign)
        assert done.returncode == 0, done.stderr
        found.append(done.stdout)
    assert found[0] == found[1]
    assert (module / "importers").exists()
