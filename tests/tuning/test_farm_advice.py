"""Slopes, gains and curtailments of a farm against the explicit linearisation of damped turbines and their network."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from seqsweep.identify.operating_state import fundamental_facts
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.farm import restore
from seqsweep.tuning.farm.choices import fewest, least_norm, uniform
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.doubt import doubt_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.farm import judged
from seqsweep.tuning.farm.levers import GainLever, PowerLever, check_power_lever
from seqsweep.tuning.farm.margin import crossing_at_source, margin_at_source
from seqsweep.tuning.farm.restore import Damping, SourceMargin, advise, demanded
from seqsweep.tuning.farm.system import System
from seqsweep.tuning.farm.units import Library

from ..support import oracle
from ..support.damped_oracle import damped_admittance, damped_system
from ..support.farm_oracle import Star, closed_loop
from ..support.farms import F_HZ, RATED, document, table_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.1j)
POWERS_W = [0.8e6, 0.55e6, 0.4e6]
LINE = (0.012, 0.25 / (100.0 * np.pi))
W_R = 2.0 * np.pi * 77.0


def truth(gains: np.ndarray, powers_w: list[float] = POWERS_W, near: complex = -7.5 + 171j) -> complex:
    """The critical mode of the exact farm."""
    systems = lambda k, p, v: damped_system(p, v, float(gains[k]), W_R, LINE)  # noqa: E731
    poles, _ = closed_loop(STAR, powers_w, systems)
    upper = poles[(poles.imag > 120.0) & (poles.imag < 230.0)]
    return complex(upper[np.argmax(upper.real)])


def swept(unit, k: float) -> FrequencyResponse:
    p, _, v = unit.setpoint
    y = damped_admittance(F_HZ, p * 1e6, v * 690.0, k, W_R, LINE)
    return FrequencyResponse(F_HZ, y, 50.0, meta={"stable_on": {"grid": "ideal", "basis": "shots"}})


@pytest.fixture(scope="module")
def gains():
    _, v = closed_loop(STAR, POWERS_W)
    tables = {f"t{k}": table_of(p, abs(v[k])) for k, p in enumerate(POWERS_W)}
    farm = judged(farm_of(document(STAR, 3)), tables.__getitem__)
    return advise(GainLever(farm, swept), Damping(0.10, 0.95))


def test_slopes_of_gains_are_those_of_the_exact_farm(gains):
    critical = max(range(len(gains.slopes)), key=lambda k: gains.base.judgement.modes[k].pole.real)
    for k in range(3):
        step = 0.01 * np.eye(3)[k]
        exact = (truth(2.0 * step) - truth(0.0 * step)) / 0.02
        assert abs(gains.slopes[critical][k] - exact) < 0.01 * abs(exact)


@pytest.mark.parametrize("way", ["least norm", "fewest", "uniform"])
def test_gains_of_each_norm_just_reach_the_damping_in_the_exact_farm(gains, way):
    """Enough, and three per cent less of every gain is not."""
    (choice,) = [choice for choice in gains.choices if choice.way == way]
    assert choice.holds
    assert _damping(truth(choice.changes)) >= 0.0999
    assert _damping(truth(0.97 * choice.changes)) < 0.10


def test_each_norm_is_the_least_in_its_own_measure(gains):
    least, few, same = (choice.changes for choice in gains.choices)
    assert np.linalg.norm(least) <= min(np.linalg.norm(few), np.linalg.norm(same))
    assert np.count_nonzero(few) == 1
    assert np.ptp(same) < 1e-9


def _damping(pole: complex) -> float:
    return -pole.real / abs(pole)


@pytest.fixture(scope="module")
def region() -> SimpleNamespace:
    """Exact rows over powers and voltages, as a table."""
    responses = tuple(_response(p, v) for p in (0.3, 0.45, 0.6, 0.75, 0.9) for v in (0.96, 1.0, 1.04, 1.08))
    return SimpleNamespace(meta={"f1_hz": 50.0, "bases": RATED}, responses=responses, op_ids=("many",))


def _response(p_mw: float, v_pu: float) -> FrequencyResponse:
    m = oracle.linearise(p_mw * 1e6, v_pu * 690.0)
    scale = np.sqrt(2.0 / 3.0)
    facts = fundamental_facts(complex(scale * v_pu * 690.0), complex(*oracle.current(m.x, m.v_pcc)) * scale)
    meta = {
        "op_id": f"p{p_mw:g}v{v_pu:g}",
        "active_power_mw": p_mw,
        "terminal_voltage_pu": v_pu,
        "stable_on": {"grid": "ideal", "basis": "shots"},
        "fundamental": facts,
    }
    y = oracle.admittance_pn(F_HZ, p_mw * 1e6, v_pu * 690.0)
    size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
    return FrequencyResponse(F_HZ, y, 50.0, covariance=1e-14 * size**2 * np.eye(8), meta=meta)


@pytest.fixture(scope="module")
def power_lever(region) -> PowerLever:
    devices = [
        {"name": f"wt{k}", "bus": f"t{k}", "table": "r", "active_power_mw": p / 1e6} for k, p in enumerate(POWERS_W)
    ]
    return PowerLever(farm_of({**document(STAR, 3), "device": devices}), Library(lambda name: region))


def test_less_power_moves_the_mode_and_restores_it_as_in_the_exact_farm(power_lever):
    """Slopes within one per cent: they count that voltages and angles of all devices move as well."""
    advice = advise(power_lever, Damping(0.08, 0.95))
    critical = int(np.argmax([mode.pole.real for mode in advice.base.judgement.modes]))
    none = np.zeros(3)
    for k in range(3):
        step = 2e3 * np.eye(3)[k]
        exact = (truth(none, list(POWERS_W - step)) - truth(none, list(POWERS_W + step))) / 4e-3
        assert abs(advice.slopes[critical][k] - exact) < 0.01 * abs(exact)
    for choice in advice.choices:
        assert choice.holds
        assert _damping(truth(none, list(POWERS_W - 1e6 * choice.changes))) == pytest.approx(0.08, abs=5e-4)


def test_less_power_that_restores_the_margin_holds_it_where_the_farm_then_stands(power_lever, monkeypatch):
    """m of the explicit farm's admittance is not at hand; that the farm at 1.25 times Z is just stable is."""
    monkeypatch.setattr(restore, "WAYS", {way: restore.WAYS[way] for way in ("fewest", "uniform")})
    (few, same) = advise(power_lever, SourceMargin(1.25)).choices
    for choice in (few, same):
        assert choice.holds
        assert crossing_at_source(choice.farm).m == pytest.approx(1.25, abs=5e-3)
    assert few.changes.sum() <= same.changes.sum() + 1e-6


def test_the_margin_s_error_is_that_of_noisy_tables():
    """Pairs of noisy tables: their m scatters by what one of them states."""
    found = []
    for seed in range(10):
        rough = {f"t{k}": _noisy(table_of(0.6e6, 690.0), 1e-3, 100 * seed + k) for k in range(2)}
        found.append(margin_at_source(judged(farm_of(document(STAR, 2)), rough.__getitem__)))
    scatter = np.std([margin.crossing.m for margin in found], ddof=1)
    assert scatter == pytest.approx(np.median([margin.std for margin in found]), rel=0.4)


def test_a_demand_that_holds_asks_for_nothing(power_lever):
    advice = advise(power_lever, Damping(0.01, 0.95))
    assert all(choice.holds and not np.any(choice.changes) for choice in advice.choices)


def test_a_demand_beyond_reach_is_said_to_be_missed(power_lever, monkeypatch):
    """By the first of the ways, as by each."""
    monkeypatch.setattr(restore, "WAYS", {"least norm": restore.WAYS["least norm"]})
    (least,) = advise(power_lever, Damping(0.6, 0.95)).choices
    assert not least.holds
    assert least.excess > 0.0


def test_without_a_table_over_powers_curtailment_is_refused():
    lever = PowerLever(farm_of(document(STAR, 2)), Library(lambda name: table_of(0.5e6, 690.0)))
    with pytest.raises(FarmError, match=r"no device of the farm has a table over several powers"):
        check_power_lever(lever)


def test_the_table_that_leaves_a_mode_in_doubt_is_named_with_its_rows():
    """One of two tables ten times as rough, and of that one the rows about the mode's frequency."""
    rough = {
        f"t{k}": _noisy(table_of(p, 690.0), noise, k) for k, (p, noise) in enumerate([(0.6e6, 1e-4), (0.5e6, 1e-3)])
    }
    farm = judged(farm_of(document(STAR, 2)), rough.__getitem__)
    mode = farm.judgement.critical
    doubt = doubt_of(farm.system, mode.pole)
    assert next(iter(doubt.by_table)) == "t1:p"
    assert doubt.by_table["t1:p"] > 0.9
    assert doubt.std == pytest.approx(mode.std.real)
    nu = mode.pole.imag / (2.0 * np.pi)
    assert any(0.5 * nu < high and low < 2.0 * nu for low, high in doubt.rows_hz)
    assert "of its variance comes from t1:p: measure it again" in doubt.said(50.0)


def _noisy(table: SimpleNamespace, noise: float, seed: int) -> SimpleNamespace:
    r, rng = table.responses[0], np.random.default_rng(seed)
    size = np.linalg.norm(r.y, axis=(1, 2))[:, None, None]
    y = r.y + noise * size * (rng.normal(size=r.y.shape) + 1j * rng.normal(size=r.y.shape)) / np.sqrt(8.0)
    rough = FrequencyResponse(r.f_hz, y, 50.0, covariance=noise**2 * size**2 / 8.0 * np.eye(8), meta=r.meta)
    return SimpleNamespace(meta=table.meta, op_ids=("p",), response=lambda op: rough, responses=(rough,))


def test_participation_is_the_finite_difference_to_a_millionth(gains):
    """Fourth-order differences of the poles of the same system, a device made larger and smaller."""
    farm = gains.base
    mode = farm.judgement.critical
    for k, unit in enumerate(farm.units):
        ends = [_pole(farm, k, unit.factor * (1.0 + h), mode.pole) for h in (-2e-3, -1e-3, 1e-3, 2e-3)]
        moved = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / 12e-3
        assert abs(mode.devices[k] - moved) < 1e-6 * abs(moved)


def _pole(farm, k: int, factor: float, near: complex) -> complex:
    units = list(farm.units)
    units[k] = replace(units[k], factor=factor)
    poles = System(tuple(units), farm.entry.network, farm.system.ports, 50.0).poles()
    return complex(poles[np.abs(poles - near).argmin()])


@pytest.mark.parametrize("seed", range(5))
def test_choices_are_those_of_a_slow_search(seed):
    """Two devices and two demands: a fine grid of all changes."""
    rng = np.random.default_rng(seed)
    a, most = rng.normal(size=(2, 2)) - 1.0, np.array([2.0, 1.5])
    b = a @ (most * rng.uniform(0.3, 0.8, 2)) - 0.01
    x, y = np.meshgrid(np.linspace(0, most[0], 801), np.linspace(0, most[1], 801))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    points = points[np.all(points @ a.T <= b + 1e-12, axis=1)]
    found = least_norm(a, b, most)
    assert np.all(a @ found <= b + 1e-9)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(points, axis=1).min(), abs=5e-3)
    few = fewest(a, b, most)
    assert np.all(a @ few <= b + 1e-6)
    assert np.count_nonzero(few > 1e-9) == min(np.count_nonzero(points > 1e-9, axis=1))
    same = uniform(a, b, most)
    on_line = np.linspace(0.0, most.max(), 100001)[:, None]
    allowed = on_line[np.all(np.minimum(on_line, most) @ a.T <= b + 1e-12, axis=1)]
    if len(allowed):
        assert same.max() == pytest.approx(min(allowed[0, 0], most.max()), abs=1e-3)


@pytest.mark.parametrize("k", [1.0, 2.0, 2.4])
def test_the_farm_s_mode_is_held_to_the_demand_near_a_device_s_own_too(gains, k):
    """The more gain, the less the network moves the mode, and the nearer it comes to the devices' own poles."""
    farm = GainLever(gains.base, swept).changed(np.full(3, k))
    exact = truth(np.full(3, k))
    assert min(abs(mode.pole - exact) for mode in demanded(farm)) < 1e-2
    needed = Damping(_damping(exact) + 0.01, 0.95)
    assert needed.excess(farm) > 0.0
