"""A step function as a plant: against closed forms, on an ideal source and behind a grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seqsweep.plant.boxes.step_function import StepError, plant_from_step
from seqsweep.plant.check import check_plant
from seqsweep.plant.protocol import Injection, Job, NotSettled, OperatingPoint, Source, Tone

from ..support import step_plants
from ..support.commands import campaign, command
from ..support.step_plants import DT_S, KEEP, admittance
from ..support.sweeps import planned, rows_of, swept

RATED = OperatingPoint(0.0, 690.0)
GRID = Source("thevenin", r_ohm=0.012, l_h=0.8e-3, angle_rad=0.3)
WEAK = Source("thevenin", r_ohm=0.05, l_h=10e-3)  # ten times the device's own inductance


def failed(plant, source=None):
    return [finding for finding in check_plant(plant, source=source) if not finding.passed]


@pytest.mark.parametrize(
    ("make", "source"),
    [
        *(
            pytest.param(step_plants.branch, source, id=f"plain, {name}")
            for source, name in ((None, "ideal"), (GRID, "grid"))
        ),
        pytest.param(step_plants.branch, WEAK, id="plain, weak", marks=pytest.mark.evidence),
        pytest.param(step_plants.compiled_branch, None, id="compiled, ideal"),
        pytest.param(step_plants.compiled_branch, GRID, id="compiled, grid"),
        pytest.param(step_plants.compiled_branch, WEAK, id="compiled, weak"),
    ],
)
def test_a_step_function_becomes_a_plant_that_keeps_its_promise(make, source):
    assert failed(make(), source) == []


@pytest.mark.parametrize(
    ("make", "source"),
    [
        (step_plants.three_phase, None),
        pytest.param(step_plants.three_phase, GRID, marks=pytest.mark.evidence),
        (step_plants.generator, GRID),
        (step_plants.unbalanced, GRID),
    ],
)
def test_so_does_one_with_phases_one_with_power_and_one_without_balance(make, source):
    assert failed(make(), source) == []


@pytest.mark.parametrize("section", [{"kind": "ideal"}, {"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25}])
def test_the_sweep_finds_the_closed_form_of_the_step_whatever_feeds_it(section):
    f_hz = [10.0, 75.0, 120.0, 900.0]
    y = swept(step_plants.compiled_branch(), f_hz, source=section)
    f = np.array(f_hz)
    exact = np.zeros((len(f), 2, 2), complex)
    exact[:, 0, 0], exact[:, 1, 1] = admittance(f), admittance(100.0 - f).conj()
    assert np.max(np.abs(y - exact)) <= 1e-5 * np.max(np.abs(exact))  # windows agree to 1e-5, the default


def test_a_shunt_current_into_the_grid_finds_it_too():
    sections = {"injection": {"kind": "shunt_current"}, "source": {"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25}}
    y = swept(step_plants.branch(), [30.0], **sections)
    assert y[0, 0, 0] == pytest.approx(complex(admittance(30.0)), rel=1e-5)


@pytest.mark.parametrize("make", [step_plants.branch, step_plants.compiled_branch])
def test_the_loop_of_grid_and_device_is_solved_without_delay(make):
    """The fundamental of the coupled, stepped circuit in closed form; a delay between the two would show."""
    plant = make()
    fixed = Source("thevenin", WEAK.r_ohm, WEAK.l_h, voltage_v=690.0, angle_rad=0.3)
    ((_, record),) = plant.run([Job(plant.settle(OperatingPoint(0.0, None), fixed), None)], 400)
    turn = np.exp(2j * np.pi * 50.0 * DT_S)
    mean, slope = (1.0 + turn) / 2.0, (turn - 1.0) / DT_S
    e = np.sqrt(2.0 / 3.0) * 690.0 * np.exp(0.3j)
    loop = 1.0 + admittance(50.0) * (WEAK.r_ohm * mean + WEAK.l_h * slope)
    v = e * mean / loop * np.exp(2j * np.pi * 50.0 * record.time_s)
    assert np.max(np.abs(record.v - v)) <= 1e-6 * abs(e)  # settled to 1e-8 a period, with modes of 0.07 s
    assert np.max(np.abs(record.i - admittance(50.0) * v)) <= 1e-6 * abs(e * admittance(50.0))


def test_the_grid_is_that_of_an_independent_integrator():
    """Device and grid in series as one continuous circuit under a tone, by scipy; the step is all that differs."""
    plant, n = plant_from_step(step_plants.branch_step, 0j, **KEEP), 800
    fixed = Source("thevenin", 0.012, 0.8e-3, voltage_v=690.0)
    state = plant.settle(OperatingPoint(0.0, None), fixed)
    tone = Injection("series_voltage", (Tone(130.0, 20.0, 0.4),))
    ((_, record),) = plant.run([Job(state, tone)], n)
    e1, l_h, r_ohm = np.sqrt(2.0 / 3.0) * 690.0, 1.8e-3, 0.112

    def slope(t, i):
        e = e1 * np.exp(2j * np.pi * 50.0 * t) + 20.0 * np.exp(1j * (2 * np.pi * 130.0 * t + 0.4))
        return (e - r_ohm * i) / l_h

    t = record.time_s
    wanted = solve_ivp(slope, (t[0], t[-1]), [record.i[0]], t_eval=t, rtol=1e-9, atol=1e-6).y[0]
    # the device holds its voltage for a step: half a step of delay, 50e-6 / 2 * 2 pi 50, in a part of the loop
    assert np.max(np.abs(record.i - wanted)) <= 0.01 * np.max(np.abs(wanted))


@pytest.mark.parametrize(("f_max_hz", "warned"), [(51.0, False), (900.0, True)])
def test_a_plan_warns_where_half_a_step_of_delay_shows(f_max_hz, warned):
    """50 us held from their start are 25 us late: 8.1 degrees at 900 Hz, half a degree at 51 Hz."""
    warnings = planned(step_plants.branch(), f_hz=[10.0, f_max_hz]).warnings
    assert any("which turns Y by -8.1 degrees at 900 Hz" in warning for warning in warnings) == warned


def test_a_compiled_and_a_plain_step_are_one_device():
    plain, compiled = step_plants.branch(), step_plants.compiled_branch()
    assert compiled.releases_gil
    assert not plain.releases_gil
    for source in (Source(), GRID):
        tone = Injection("series_voltage", (Tone(-70.0, 5.0),))
        records = [plant.run([Job(plant.settle(RATED, source), tone)], 300)[0][1] for plant in (plain, compiled)]
        assert np.max(np.abs(records[0].i - records[1].i)) <= 1e-9 * np.max(np.abs(records[0].i))


@pytest.mark.parametrize("make", [step_plants.lanes, step_plants.compiled_lanes])
def test_a_step_function_may_take_many_experiments_at_once(make):
    assert failed(make()) == []
    with pytest.raises(ValueError, match="plant_from_step stands on a grid"):
        make().settle(RATED, GRID)


def test_the_lanes_find_the_closed_form():
    f = np.array([20.0, 130.0])
    y = swept(step_plants.compiled_lanes(), f.tolist())
    assert np.max(np.abs(y[:, 0, 0] / admittance(f) - 1.0)) <= 1e-4
    z = np.exp(2j * np.pi * f * DT_S) - 1.0  # Euler's step: i_k+1 = i_k + h/L (v_k - R i_k)
    wanted = sum(DT_S / l_h / (z + DT_S * r_ohm / l_h) for r_ohm, l_h in ((0.1, 1e-3), (0.5, 5e-3)))
    assert np.max(np.abs(swept(step_plants.lanes(), f.tolist())[:, 0, 0] / wanted - 1.0)) <= 1e-4


def test_power_reaches_the_step_function_by_way_of_its_initial_state():
    plant = step_plants.generator()
    ((_, record),) = plant.run([Job(plant.settle(OperatingPoint(0.4e6, 690.0), Source()), None)], 400)
    power_w = 1.5 * np.mean((record.v * record.i.conj()).real)
    lag = 1.0 / (1.0 + 2j * np.pi * 50.0 * 5e-3)
    assert power_w == pytest.approx(-0.4e6 * abs(lag) ** 2, rel=0.02)  # Euler's step bends the lag a little


def test_a_device_that_does_not_come_to_rest_is_not_settled_and_says_by_how_much():
    with pytest.raises(NotSettled, match=r"still change by .* after 0\.5 s; 1e-08 is asked") as refusal:
        step_plants.restless().settle(RATED, Source())
    assert refusal.value.status == "not_settled"
    with pytest.raises(NotSettled, match="leave all bounds") as refusal:
        step_plants.explosive().settle(RATED, Source())
    assert refusal.value.status == "diverged"


def test_a_refusal_is_not_waited_for_twice(monkeypatch):
    plant, told, driven = step_plants.restless(), [], []
    run = plant.run
    monkeypatch.setattr(plant, "run", lambda *given: driven.append(given) or run(*given))
    for _ in range(2):
        with pytest.raises(NotSettled) as refusal:
            plant.settle(RATED, Source())
        told.append((str(refusal.value), len(driven)))
    assert told[0] == told[1]
    assert driven


def test_a_state_that_changes_its_type_is_refused_by_name():
    with pytest.raises(StepError, match=r"mistyped_step cannot be compiled: step must return a state of the type"):
        step_plants.mistyped().settle(RATED, Source())


def test_a_device_too_rough_for_the_grid_says_so():
    """A current that jumps with the least voltage: no voltage solves the loop."""
    plant = plant_from_step(lambda s, v, dt: (s, 1e4 * np.sign(v.real - 100.0) + 0j), 0.0, **KEEP)
    with pytest.raises(ArithmeticError, match="find no common voltage in step"):
        plant.settle(OperatingPoint(0.0, None), Source("thevenin", 0.012, 0.8e-3, voltage_v=690.0))


@pytest.mark.parametrize(
    ("change", "words"), [({"dt_s": 0.0}, "dt_s is 0"), ({"dt_s": 3e-3}, "a tenth of a period, 0.002 s")]
)
def test_a_step_or_rating_that_cannot_be_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        plant_from_step(step_plants.branch_step, 0j, **{**KEEP, **change})


def test_a_step_function_is_swept_from_the_command_line(tmp_path):
    path, table = campaign(tmp_path, plant="python:step_plants:unbalanced", n=4), tmp_path / "y.parquet"
    done = command("run", path, "-o", table)
    assert done.returncode == 0, done.stderr
    assert "4 ok" in done.stderr


def test_mean_of_the_voltage_takes_half_a_step_of_delay_away():
    """An exact R-L step under held voltage: the phase error of its swept admittance falls from w h / 2 to nothing."""
    r, l_h, dt_s = 0.5, 2e-3, 1e-4
    decay = np.exp(-r / l_h * dt_s)

    def step(i, v, dt):
        i = decay * i + (1.0 - decay) / r * v
        return i, i

    f_hz = 400.0
    exact = 1.0 / (r + 2j * np.pi * f_hz * l_h)
    errors = {}
    for hold in ("start", "mean"):
        plant = plant_from_step(step, 0j, dt_s=dt_s, voltage_v=400.0, power_va=10e3, hold=hold)
        assert plant.contents["held_late_s"] == (0.5 * dt_s if hold == "start" else 0.0)
        rows = rows_of(plant, planned(plant, f_hz=[f_hz], point={"active_power_mw": 0.0, "terminal_voltage_pu": 1.0}))
        errors[hold] = abs(rows[0].admittance[0, 0] / exact - 1.0)
    assert errors["start"] == pytest.approx(np.pi * f_hz * dt_s, rel=0.05)
    assert errors["mean"] < 0.05 * errors["start"]
    with pytest.raises(ValueError, match="hold is 'middle'; needed: start, mean"):
        plant_from_step(step, 0j, dt_s=dt_s, voltage_v=400.0, power_va=10e3, hold="middle")
    with pytest.raises(ValueError, match="known on an ideal source alone"):
        plant.settle(OperatingPoint(0.0, 400.0), Source("thevenin", 0.1, 1e-3))


def test_an_error_in_the_users_function_names_its_file_and_line():
    def step(i, v, dt):
        gains = {"k": 1.0}
        return i, gains["K"] * v

    plant = plant_from_step(step, 0j, dt_s=1e-4, voltage_v=400.0, power_va=10e3)
    words = r"KeyError: 'K' \(.*test_step\.py, line \d+: return i, gains\[\"K\"\] \* v\)"
    with pytest.raises(StepError, match=words):
        plant.settle(OperatingPoint(0.0, 400.0), Source())
