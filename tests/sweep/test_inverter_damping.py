"""Damping control on the inverters: sign and size found by sweeping again, held against exact poles and a trace."""

from __future__ import annotations

from math import inf, pi

import jsonschema
import numpy as np
import pytest

from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.events import GridStep, Scenario, resonance_between, simulate
from seqsweep.plant.protocol import OperatingPoint, Source
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.confirm import confirm
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import sweep_in_memory
from seqsweep.tuning.gain import search_signed
from seqsweep.tuning.result import schema, to_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune

DROOP = {"k_d": 0.0, "t_a_s": 1.0 / (0.05 * 2.0 * pi * 5.0)}
STIFF = {**DROOP, "l_g_pu": 0.1, "r_g_pu": 0.005, "l_v_pu": 0.0}
BAND = {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 60}


def grid_of(plant, scr: float) -> SeriesRL:
    """X/R = 10."""
    x = plant.base_impedance_ohm / scr / np.hypot(1.0, 0.1)
    return SeriesRL(0.1 * x, x, 50.0)


def tuned(plant_id: str, parameters: dict, power_pu: float, source: SeriesRL | None, scr: float, margin: float = 1.02):
    """(result, configuration) of a sweep on an ideal source or behind ``source``, judged at ``scr``."""
    plant = make_plant(plant_id, parameters)
    behind = {"kind": "ideal"}
    if source is not None:
        behind = {"kind": "thevenin", "r_ohm": source.r_ohm, "x_ohm": source.x_ohm}
    config = Config.from_dict(
        {
            "campaign": {"name": "damping"},
            "plant": {"id": plant_id, "parameters": parameters},
            "operating_point": [
                {"id": "p", "active_power_mw": power_pu * plant.rating.power_va / 1e6, "terminal_voltage_pu": 1.0}
            ],
            "sweep": BAND,
            "source": behind,
        }
    )
    plan = make_plan(config, plant)
    responses = list(sweep_in_memory(plan, plant, jobs=1, backend="threading").responses())
    return tune(responses, grid_of(plant, scr), margin=margin), plan.configuration


@pytest.mark.parametrize(
    ("scr", "f_r_hz", "growths"),
    [
        (1.6, 75.7, {0.0: 0.26, 0.3: -1.58, 0.5: -1.21, 0.7: -0.98, 0.9: -0.82, 1.1: -0.71, 1.5: -0.56, 2.0: 1.05}),
        (1.4, 75.7, {0.0: 7.78, 0.3: 4.52, 0.5: 1.41, 0.7: -0.70, 0.9: -0.58, 1.1: -0.49, 1.5: -0.38}),
        (1.25, 75.7, {0.0: 16.4, 0.3: 12.5, 0.5: 8.3, 0.7: 3.3, 0.9: -0.35, 1.1: -0.30, 1.5: -0.23}),
    ],
)
def test_worst_pole_with_damping_is_that_of_a_model_nobody_wrote_here(scr, f_r_hz, growths):
    """Worst pole (rad/s) of the grid-following device at 1 pu over k, from a prototype in another form (linear)."""
    for k, expected in growths.items():
        grid = grid_of(make_plant("gfl-v1"), scr)
        plant = make_plant(
            "gfl-v1",
            {
                "damping_gain": k,
                "damping_r_ohm": grid.r_ohm,
                "damping_l_h": grid.l_h,
                "damping_resonance_hz": f_r_hz,
            },
        )
        point = OperatingPoint(plant.rating.power_va, plant.rating.voltage_v)
        state = plant.equilibrium(point, Source("thevenin", grid.r_ohm, grid.l_h))
        assert plant.linearise(state)[0].real == pytest.approx(expected, abs=0.06), k


def test_following_device_on_a_weak_grid_gets_a_positive_gain_that_holds():
    result, configuration = tuned("gfl-v1", {}, 1.0, None, 1.4)
    assert result.verdict == "unstable"
    (point,) = confirm(result, configuration, jobs=1).points
    assert point.reached
    assert 0.6 < point.k < 0.8
    assert point.impedance is None
    assert point.with_k.verdict != "unstable"  # undecided where the notch's own slow mode lies between the rows
    assert point.with_k.probability > 0.99
    grid = grid_of(make_plant("gfl-v1"), 1.4)
    damping = {
        "damping_gain": point.k,
        "damping_r_ohm": grid.r_ohm,
        "damping_l_h": grid.l_h,
        "damping_resonance_hz": point.f_r_hz,
    }
    plant = make_plant("gfl-v1", damping)
    point_of = OperatingPoint(plant.rating.power_va, plant.rating.voltage_v)
    exact = plant.linearise(plant.equilibrium(point_of, Source("thevenin", grid.r_ohm, grid.l_h)))
    assert exact[0].real < 0.0


def test_stiff_forming_device_on_a_strong_grid_gets_a_negative_gain_on_an_impedance_of_its_own():
    plant = make_plant("gfm-v1", STIFF)
    result, configuration = tuned("gfm-v1", STIFF, 0.5, grid_of(plant, 10.0), 100.0)
    assert (result.verdict, result.k) == ("unstable", None)
    assert "tune --confirm finds sign and size" in to_json(result)["operating_points"][0]["missing"]["k"]
    told = []
    confirmed = confirm(result, configuration, jobs=1, report=told.append)
    (point,) = confirmed.points
    assert any("k = 1.0000 gives unstable" in line for line in told)
    assert point.k < 0.0
    assert point.with_k.verdict == "stable"
    loop = point.with_k.stability.closed_loop
    swept = loop.poles[loop.critical]
    document = to_json(confirmed)

    jsonschema.validate(document, schema())
    assert document["operating_points"][0]["damping_impedance"]["x_ohm"] == pytest.approx(point.impedance.x_ohm)

    # exactly: the device with that control on that grid
    grid = grid_of(plant, 100.0)
    damping = {
        "damping_gain": point.k,
        "damping_r_ohm": point.impedance.r_ohm,
        "damping_l_h": point.impedance.l_h,
        "damping_resonance_hz": point.f_r_hz,
    }
    source = Source("thevenin", grid.r_ohm, grid.l_h)
    damped = make_plant("gfm-v1", {**STIFF, **damping})
    poles = damped.linearise(damped.equilibrium(OperatingPoint(0.5 * plant.rating.power_va, 690.0), source))
    assert poles[0].real < 0.0
    assert np.abs(poles - swept).min() < 0.02 * abs(swept)

    # and in time: undamped it grows at the rate of its pole, damped it calms down
    free = plant.linearise(plant.equilibrium(OperatingPoint(0.5 * plant.rating.power_va, 690.0), source))[0].real
    scenario = Scenario(0.5 * plant.rating.power_va, grid.r_ohm, grid.l_h, 690.0, (GridStep(0.02, 1.0),), scale=1.1)
    settings = DampingSettings(point.k, point.impedance.r_ohm, point.impedance.l_h, point.f_r_hz)
    with_k = simulate(plant, scenario, settings, 0.4, on_from_s=0.0)
    without = simulate(plant, scenario, None, 0.4)
    assert resonance_between(without, 0.1, 0.25).growth_per_s == pytest.approx(free, rel=0.05)
    assert resonance_between(with_k, 0.1, 0.25).growth_per_s == pytest.approx(swept.real, rel=0.1)


def test_voltage_feed_forward_defeats_damping_control_and_no_gain_is_offered():
    result, configuration = tuned("gfl-v1", {"k_ff": 1.0}, 1.0, None, 1.4)
    (point,) = confirm(result, configuration, jobs=1).points
    assert point.k is None
    assert point.reached is False
    assert any("damping control is refused" in text and "feed-forward" in text for text in point.warnings)


@pytest.mark.parametrize(
    ("growth", "k", "stable"),
    [
        (lambda k: 5.0 + 10.0 * k, -4.0, True),
        (lambda k: 5.0 - 8.0 * k if k < 1.1 else inf, 1.0, True),
        (lambda k: 3.0 - 8.0 * min(k, 0.4), 0.5, True),
        (lambda k: 1.0 + abs(k), -0.125, False),
        (lambda k: inf, -1.0, False),
    ],
)
def test_signed_search_finds_sign_and_size(growth, k, stable):
    search = search_signed(growth)
    assert (search.k, search.stable) == (k, stable)
    assert len(search.trials) <= 8
