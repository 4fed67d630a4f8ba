"""What the shots of a sweep prove about the device reaches the table; what they do not prove does not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.plant.rl_branch import RLBranch
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.measure.measure import measure
from seqsweep.sweep.measure.proof import stable_on
from seqsweep.sweep.run.campaign import run
from seqsweep.tuning.grid_check import source_voltage_v
from seqsweep.tuning.siso import SeriesRL

from ..support import oracle, plants
from ..support.commands import command
from ..support.sweeps import planned, rows_of

F_HZ = [20.0, 70.0, 130.0, 300.0]
THEVENIN = {"source": {"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25}}
GRID_POINT = {"active_power_mw": 0.65, "grid": {"r_ohm": 0.01, "x_ohm": 0.1, "voltage_pu": 1.0, "scale": 1.4}}


def fact_of(plant, **sections):
    plan = planned(plant, **{"f_hz": F_HZ, **sections})
    return stable_on(plan, plan.conditions[0], rows_of(plant, plan))


@pytest.mark.parametrize(
    ("sections", "grid"),
    [
        ({}, "ideal"),
        (THEVENIN, {"r_ohm": 0.012, "x_ohm": pytest.approx(0.25)}),
        (
            {"source": {"kind": "thevenin"}, "point": GRID_POINT},
            {"r_ohm": pytest.approx(0.014), "x_ohm": pytest.approx(0.14)},
        ),
        ({"point": GRID_POINT}, "ideal"),  # the grid sets |v_pcc|, the source stays ideal
    ],
)
def test_a_sweep_proves_the_device_stable_on_the_source_it_was_swept_on(sections, grid):
    fact = fact_of(ReferenceTurbine(), **sections)
    assert (fact["grid"], fact["basis"]) == (grid, "shots")
    assert 0.0 < fact["growth_bound_per_s"] < 15.0
    assert fact["disturbed_s"] >= 0.6


def test_broadband_plays_and_noisy_windows_prove_it_too():
    multisine = {"injection": {"kind": "series_voltage", "signal": "multisine", "amplitude_pu": 0.05}}
    sweep = {"f_min_hz": 20.0, "f_max_hz": 200.0, "points": 12, "tolerance": 1e-4}
    assert fact_of(RLBranch(), f_hz=None, sweep=sweep, **multisine)["growth_bound_per_s"] < 15.0
    noisy = fact_of(plants.NoisyBranch(1e-4), f_hz=[20.0, 130.0], injection={"amplitude_pu": 0.01})
    quiet = fact_of(plants.NoisyBranch(0.0), f_hz=[20.0, 130.0], injection={"amplitude_pu": 0.01})
    assert 0.0 < quiet["growth_bound_per_s"] < noisy["growth_bound_per_s"] * 3.0


def test_a_device_that_runs_away_proves_nothing():
    """The reference turbine on a grid beyond its edge: its equilibrium is solved for, its shots grow."""
    weak = {"kind": "thevenin", "r_ohm": 0.05, "x_ohm": 1.0}
    assert fact_of(ReferenceTurbine(), source=weak, sweep={"max_simulated_s": 2.0}) is None


def test_one_row_that_diverged_is_enough_to_say_nothing():
    plan = planned(RLBranch(), f_hz=F_HZ)
    rows = rows_of(RLBranch(), plan)
    assert stable_on(plan, plan.conditions[0], rows) is not None
    assert stable_on(plan, plan.conditions[0], [rows[0]._replace(status="diverged"), *rows[1:]]) is None
    assert stable_on(plan, plan.conditions[0], []) is None


def test_the_fundamental_of_the_table_is_that_of_the_closed_form(tmp_path):
    plant = RLBranch()
    plan = planned(plant, f_hz=F_HZ)
    run(plan, plant, tmp_path / "y.parquet", jobs=1)
    assert validate_table(tmp_path / "y.parquet") == []
    (response,) = read_table(tmp_path / "y.parquet").responses
    found, z = response.meta["fundamental"], plant.impedance(50.0)
    power_va = plant.rating.voltage_v**2 / np.conj(z)
    assert found["active_power_into_device_w"] == pytest.approx(power_va.real, rel=1e-9)
    assert found["reactive_power_into_device_var"] == pytest.approx(power_va.imag, rel=1e-9)
    assert found["current_angle_rad"] == pytest.approx(-np.angle(z), rel=1e-9)
    assert response.meta["stable_on"]["grid"] == "ideal"


def test_the_strictest_batch_speaks_for_the_operating_point():
    plant = RLBranch()
    plan = replace(planned(plant, f_hz=[2.0, 20.0, 70.0, 130.0, 300.0, 501.5]), batch_pairs=2)
    batches = list(plan.batches())
    assert len(batches) > 1
    rows = [row for batch in batches for row in measure(plant, batch).rows]
    fact = stable_on(plan, plan.conditions[0], rows)
    assert fact["growth_bound_per_s"] == min(row.growth_bound_per_s for row in rows)


@pytest.mark.parametrize("power_w", [0.2e6, 0.65e6, 1.3e6])
def test_measured_p_and_q_give_the_source_voltage_of_the_load_flow(power_w):
    """Outside truth: the exact equilibrium's source voltage, the shunt's reactive power included."""
    plant = ReferenceTurbine()
    plan = planned(plant, f_hz=[130.0], point={"active_power_mw": power_w / 1e6, "terminal_voltage_pu": 1.0})
    seen = measure(plant, next(iter(plan.batches()))).condition
    into = complex(seen["active_power_into_device_w"], seen["reactive_power_into_device_var"])
    grid = SeriesRL(0.012, 0.25, 50.0)
    exact = oracle.source_voltage(power_w, 690.0, grid.r_ohm, grid.l_h)
    assert source_voltage_v(-into, seen["voltage_v"], grid) == pytest.approx(abs(exact), rel=1e-4)


# Statements


def test_what_a_file_does_not_say_may_be_stated(tmp_path):
    text = tmp_path / "y.csv"
    rows = [f"{f},{1 / (1 + 0.01 * f)},0,0,0,0,0,1,0" for f in range(5, 48)]
    text.write_text("f_hz,y_pp_re,y_pp_im,y_pn_re,y_pn_im,y_np_re,y_np_im,y_nn_re,y_nn_im\n" + "\n".join(rows))
    given = ("--frame", "pn", "--direction", "load", "--f1", 50, "--quantity", "admittance", "--unit", "S")
    given = (*given, "--rated-voltage-v", 400, "--rated-power-va", 1e4)
    output = tmp_path / "y.parquet"
    done = command("import", text, "-o", output, *given, "--stable-on", "0.01+j0.1")
    assert done.returncode == 0, done.stderr
    assert validate_table(output) == []
    expected = {"grid": {"r_ohm": 0.01, "x_ohm": 0.1}, "basis": "stated"}
    assert read_table(output).responses[0].meta["stable_on"] == expected
    again = tmp_path / "again.csv"
    command("export", output, "-o", again)
    command("import", again, "-o", tmp_path / "again.parquet")
    assert read_table(tmp_path / "again.parquet").responses[0].meta["stable_on"] == expected  # it travels as text
    refused = command("import", text, "-o", output, *given, "--force", "--stable-on", "strong")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--stable-on 'strong'" in refused.stderr


def test_tune_takes_a_statement_for_a_table_without_one(tmp_path):
    plant = RLBranch()
    run(planned(plant, f_hz=list(np.geomspace(2, 900, 30))), plant, tmp_path / "y.parquet", jobs=1)
    arguments = ("tune", tmp_path / "y.parquet", "--grid", "0.01+0.1j", "-o", tmp_path / "t.json")
    assert command(*arguments, "--stable-on", "ideal").returncode == 0
    assert json.loads((tmp_path / "t.json").read_text())["operating_points"][0]["verdict"] == "stable"
    refused = command(*arguments, "--force", "--stable-on", "0.1-0.2j")
    assert refused.returncode == 2
    assert "Traceback" not in refused.stderr
