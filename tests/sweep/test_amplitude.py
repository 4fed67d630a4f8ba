"""``amplitude_pu = "auto"``: the largest amplitude whose distortion its own noise covers, within the limit."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.registry import make_plant
from seqsweep.plant.rl_branch import admittance
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import run
from seqsweep.sweep.run.pilots import RATIO, STEPS

from ..support.oracle import admittance_pn
from ..support.plants import NoisyBentBranch

TURBINE = {"f_min_hz": 5.0, "f_max_hz": 500.0, "points": 24}


def swept(tmp_path, plant, sweep, backend=None, **injection):
    """The response of a campaign with an automatic amplitude."""
    content = {
        "campaign": {"name": "auto"},
        "plant": {"id": plant.id},
        "operating_point": [{"id": "p", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
        "sweep": sweep,
        "injection": {"amplitude_pu": "auto", **injection},
    }
    path = tmp_path / "y.parquet"
    run(make_plan(Config.from_dict(content), plant), plant, path, jobs=2, backend=backend or "threading", discard=True)
    return path


@pytest.mark.parametrize("signal", ["tone", "multisine"])
def test_a_quiet_device_gets_the_largest_amplitude_that_is_linear_enough(tmp_path, signal):
    response = read_table(swept(tmp_path, ReferenceTurbine(), TURBINE, signal=signal)).response("p")
    exact = admittance_pn(response.f_hz, 0.65e6, 690.0)
    error = np.linalg.norm(response.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    amplitude = response.quality["amplitude_pu"]
    assert np.all(response.ok)
    # Windows agree to 1e-5: more distortion than that is not taken, and not much less either.
    assert np.median(error) <= 1e-5
    assert error.max() <= 1e-4
    assert np.all(amplitude <= 0.02)
    assert np.median(amplitude) > 0.0005


def test_noise_and_distortion_are_balanced(tmp_path):
    plant = NoisyBentBranch()
    response = read_table(
        swept(tmp_path, plant, {"f_hz": [20.0, 70.0, 130.0, 300.0], "uncertainty": 0.9, "probes": 0})
    ).response("p")
    linear = admittance(plant, response.f_hz) + 5.0 * np.eye(2)  # what is bent is a conductance of 5 S
    error = np.linalg.norm(response.y - linear, axis=(1, 2)) / np.linalg.norm(linear, axis=(1, 2))
    # The knee is at 0.004 pu: a tone of 0.02 pu would be off by most of 5 S, one of 0.0002 pu lost in the noise.
    assert set(np.round(response.quality["amplitude_pu"], 6)) <= {0.00128, 0.0032}
    assert error.max() <= 0.1


def test_the_limit_is_the_users(tmp_path):
    response = read_table(swept(tmp_path, ReferenceTurbine(), TURBINE, amplitude_max_pu=0.001)).response("p")
    steps = 0.001 / RATIO ** np.arange(STEPS)
    assert all(np.any(np.isclose(steps, amplitude)) for amplitude in response.quality["amplitude_pu"])


def test_pilots_leave_no_trace_of_how_they_were_run(tmp_path):
    plant = make_plant("dpmsg-v1")
    tables = []
    for backend in ("threading", "loky"):
        folder = tmp_path / backend
        folder.mkdir()
        tables.append(swept(folder, plant, {**TURBINE, "points": 12}, backend).read_bytes())
    assert tables[0] == tables[1]
