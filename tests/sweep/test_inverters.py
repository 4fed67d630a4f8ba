"""Sweeps of the two inverters against an oracle that shares nothing with them; `pytest -s` prints what was measured."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from seqsweep.plant.registry import make_plant
from seqsweep.sweep.run.campaign import sweep_in_memory
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune_point

from ..support import inverter_oracle as oracle
from ..support.sweeps import errors, planned, rows_of, y_of

KINDS = {"gfl-v1": "following", "gfm-v1": "forming"}
DROOP = {"k_d": 0.0, "t_a_s": 1.0 / (0.05 * 2.0 * pi * 5.0)}
STIFF = {**DROOP, "l_g_pu": 0.1, "r_g_pu": 0.005, "l_v_pu": 0.0}
BAND = {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 40}
BAR = 1e-4
"""RK4 of 25 us turns j w by (w h)^4 / 120 of itself, and more near the filter's resonance."""

CASES = {
    "forming": ("gfm-v1", {}, 0.5, 0.0, 1.0),
    "droop, consuming, with Q": ("gfm-v1", DROOP, -0.4, 0.25, 1.02),
    "following": ("gfl-v1", {}, 0.8, 0.0, 1.0),
    "following, consuming, with Q": ("gfl-v1", {}, -0.6, -0.2, 0.96),
}


def scr_source(plant, scr: float, x_over_r: float = 10.0) -> dict[str, object]:
    """[source] of a campaign: a grid of a short-circuit ratio on the plant's own rating."""
    x = plant.base_impedance_ohm / scr / np.hypot(1.0, 1.0 / x_over_r)
    return {"kind": "thevenin", "r_ohm": x / x_over_r, "x_ohm": x}


def campaign(plant, p: float, q: float, v: float, source: dict[str, object], **sections):
    s = plant.rating.power_va / 1e6
    point = {"active_power_mw": p * s, "reactive_power_mvar": q * s, "terminal_voltage_pu": v}
    return planned(plant, point=point, sweep=BAND, source=source, **sections)


def exact(plant, p: float, q: float, v: float, f_hz: np.ndarray) -> np.ndarray:
    model = oracle.linearise(plant.parameters, KINDS[plant.id], complex(p, q), v)
    return oracle.admittance_pn(model, f_hz) / plant.base_impedance_ohm


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
@pytest.mark.parametrize("scr", [None, 5.0], ids=["ideal", "SCR 5"])
def test_swept_inverter_is_its_exact_linearisation(case, scr):
    plant_id, parameters, p, q, v = case
    plant = make_plant(plant_id, parameters)
    source = {"kind": "ideal"} if scr is None else scr_source(plant, scr)
    rows = rows_of(plant, campaign(plant, p, q, v, source))
    assert {row.status for row in rows} == {"ok"}
    f_hz = np.array([row.f_hz for row in rows])
    error = errors(rows, exact(plant, p, q, v, f_hz))
    print(f"\n  {plant_id} {parameters}: worst {error.max():.2e} at {f_hz[error.argmax()]:.4g} Hz, ", end="")
    print(f"median {np.median(error):.2e} (bar {BAR:g})", end="")
    assert error.max() <= BAR


def test_stiff_grid_forming_device_is_swept_behind_two_grids_to_the_same_admittance():
    """On an ideal source it has +17 rad/s; behind SCR 10 and 30 it is stable, and its Y is the same."""
    plant = make_plant("gfm-v1", STIFF)
    tables = [rows_of(plant, campaign(plant, 0.5, 0.0, 1.0, scr_source(plant, scr))) for scr in (10.0, 30.0)]
    assert {row.status for rows in tables for row in rows} == {"ok"}
    f_hz = np.array([row.f_hz for row in tables[0]])
    truth = exact(plant, 0.5, 0.0, 1.0, f_hz)
    for rows in tables:
        assert errors(rows, truth).max() <= BAR
    apart = np.linalg.norm(y_of(tables[0]) - y_of(tables[1]), axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    print(f"\n  Y behind SCR 10 and 30: apart by {apart.max():.2e} at most", end="")
    assert apart.max() <= BAR


def judged(plant, responses, scr: float):
    """The verdict of a sweep on a grid of X/R = 10."""
    section = scr_source(plant, scr)
    grid = SeriesRL(section["r_ohm"], section["x_ohm"], 50.0)
    bases = {"rated_voltage_v": plant.rating.voltage_v, "rated_power_va": plant.rating.power_va}
    return tune_point(responses[0], grid, bases=bases)


def swept_in_memory(plant, p: float, source: dict[str, object]):
    s = plant.rating.power_va / 1e6
    point = {"active_power_mw": p * s, "terminal_voltage_pu": 1.0}
    plan = planned(plant, point=point, sweep={**BAND, "points": 100}, source=source)
    return list(sweep_in_memory(plan, plant, jobs=1, backend="threading").responses())


@pytest.mark.parametrize("swept_behind", [10.0, 30.0])
def test_edge_of_the_stiff_device_lies_at_a_stronger_grid(swept_behind):
    """|v_pcc| = 1 pu held, P = 0.5 pu: stable below SCR 34.345, unstable above; right at 1 % on both sides."""
    plant = make_plant("gfm-v1", STIFF)
    responses = swept_in_memory(plant, 0.5, scr_source(plant, swept_behind))
    for scr, verdict in ((2.0, "stable"), (34.0, "stable"), (34.69, "unstable"), (100.0, "unstable")):
        found = judged(plant, responses, scr)
        assert found.verdict == verdict, scr
        assert found.model.n_unstable == 2


def test_edge_of_the_following_device_lies_at_a_weaker_grid():
    """|v_pcc| = 1 pu held, P = 1 pu: stable above SCR 1.6090; verdict and critical ratio are right at 1 %."""
    plant = make_plant("gfl-v1")
    responses = swept_in_memory(plant, 1.0, {"kind": "ideal"})
    for scr, verdict in ((3.0, "stable"), (1.625, "stable"), (1.593, "unstable"), (1.4, "unstable")):
        found = judged(plant, responses, scr)
        assert found.verdict == verdict, scr
        assert found.critical_scr == pytest.approx(1.6090, rel=0.002)
        assert found.model.n_unstable == 0


def test_shunt_current_gives_the_same_admittance_as_series_voltage():
    plant = make_plant("gfm-v1", DROOP)
    injection = {"kind": "shunt_current", "amplitude_pu": 5e-4}
    rows = rows_of(plant, campaign(plant, 0.5, 0.1, 1.0, scr_source(plant, 3.0), injection=injection))
    assert {row.status for row in rows} == {"ok"}
    f_hz = np.array([row.f_hz for row in rows])
    assert errors(rows, exact(plant, 0.5, 0.1, 1.0, f_hz)).max() <= BAR


def test_reactive_power_outside_the_range_is_refused_where_it_is_planned():
    with pytest.raises(ValueError, match=r"reactive_power_mvar = 5 Mvar is outside the operating range of dpmsg-v1"):
        planned(
            make_plant("dpmsg-v1"),
            f_hz=[77.0],
            point={"active_power_mw": 0.65, "reactive_power_mvar": 5.0, "terminal_voltage_pu": 1.0},
        )
