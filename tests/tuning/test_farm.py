"""Farms of reference turbines against one explicit linearisation of all turbines and their network."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.farm.choices import fewest, least_norm, uniform
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.farm import judged, seen_from_source
from seqsweep.tuning.farm.participation import parts_of
from seqsweep.tuning.farm.system import System
from seqsweep.tuning.poles import closed_loop_poles
from seqsweep.tuning.siso import SeriesRL

from ..support.farm_oracle import Star, closed_loop
from ..support.farms import F_HZ, document, table_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)


def farm_and_truth(star: Star, powers_w: list[float]):
    truth, v = closed_loop(star, powers_w)
    tables = {f"t{k}": table_of(p, abs(v[k])) for k, p in enumerate(powers_w)}
    return judged(farm_of(document(star, len(powers_w))), tables.__getitem__), truth, v


@pytest.fixture(scope="module")
def three():
    return farm_and_truth(STAR, [0.45e6, 0.6e6, 0.8e6])


def nearest(pole: complex, truth: np.ndarray) -> float:
    return float(np.abs(truth - pole).min())


def test_load_flow_is_that_of_the_exact_turbines(three):
    farm, _, v = three
    found = np.array([unit.voltage_v * np.exp(1j * unit.angle_rad) for unit in farm.units])
    np.testing.assert_allclose(found, v, rtol=1e-7)
    assert max(abs(unit.off) for unit in farm.units) < 1e-6


def test_critical_mode_is_the_exact_one(three):
    farm, truth, _ = three
    assert nearest(farm.judgement.critical.pole, truth) < 5e-5


def test_every_mode_in_the_band_is_an_exact_one(three):
    farm, truth, _ = three
    assert len(farm.judgement.modes) >= 3
    assert max(nearest(mode.pole, truth) for mode in farm.judgement.modes) < 2e-3


@pytest.mark.parametrize("x_source", [0.05, 0.14, 0.16, 0.18])
def test_locus_poles_and_truth_count_alike(x_source):
    farm, truth, _ = farm_and_truth(Star(STAR.z_t, STAR.c_f, complex(0.004, x_source)), [0.5e6, 0.7e6])
    n = int(np.sum(truth.real > 0.0))
    assert (farm.judgement.n_unstable_locus, farm.judgement.n_unstable_poles) == (n, n)
    assert farm.judgement.verdict == ("unstable" if n else "stable")


def test_participation_of_a_device_is_the_difference_of_two_farms(three):
    """Against poles of the same system with one device made larger and smaller."""
    farm, _, _ = three
    mode = farm.judgement.critical
    for k, unit in enumerate(farm.units):
        ends = []
        for factor in (1.0 + 1e-5, 1.0 - 1e-5):
            units = list(farm.units)
            units[k] = type(unit)(**{**{f: getattr(unit, f) for f in unit.__slots__}, "factor": factor})
            system = System(tuple(units), farm.entry.network, farm.system.ports, 50.0)
            poles = system.poles()
            ends.append(poles[np.abs(poles - mode.pole).argmin()])
        moved = (ends[0] - ends[1]) / 2e-5
        assert abs(mode.devices[k] - moved) < 1e-4 * abs(moved)


def test_a_table_that_two_devices_share_has_one_error():
    """Two equal devices with one table: the mode's error is that of one device twice as large, not less by a root."""
    star = Star(1e-6 + 1e-5j, STAR.c_f, STAR.z_s)
    table = table_of(0.6e6, 690.0)
    noisy = np.random.default_rng(1)
    r = table.responses[0]
    size = np.linalg.norm(r.y, axis=(1, 2))[:, None, None]
    y = r.y + 1e-3 * size * (noisy.normal(size=r.y.shape) + 1j * noisy.normal(size=r.y.shape)) / np.sqrt(8.0)
    covariance = 1e-6 * size**2 / 8.0 * np.eye(8)
    rough = FrequencyResponse(F_HZ, y, 50.0, covariance=covariance, meta=r.meta)
    shared = SimpleNamespace(meta=table.meta, op_ids=("p",), response=lambda op: rough, responses=(rough,))
    two = judged(farm_of({**document(star, 2), "device": _twice("t0", "t0")}), lambda name: shared)
    one = judged(farm_of({**document(star, 2), "device": [_device("a", "t0", 2)]}), lambda name: shared)
    assert two.judgement.critical.std.real == pytest.approx(one.judgement.critical.std.real, rel=0.02)


def _device(name: str, bus: str, count: int = 1) -> dict:
    return {"name": name, "bus": bus, "table": "t", "count": count}


def _twice(*buses: str) -> list[dict]:
    return [_device(f"wt{k}", bus) for k, bus in enumerate(buses)]


def test_farm_s_own_table_behaves_as_the_farm(three):
    """Y at the source's bus and the source's impedance give the farm's own modes as roots of det(1 + Y Z)."""
    farm, _, _ = three
    response = seen_from_source(farm, F_HZ)
    poles = closed_loop_poles(fit_response(response), SeriesRL(STAR.z_s.real, STAR.z_s.imag, 50.0))
    assert nearest(farm.judgement.critical.pole, poles) < 1e-3
    assert response.meta["stable_on"]["grid"] == {"r_ohm": STAR.z_s.real, "x_ohm": STAR.z_s.imag}


def test_an_unstable_farm_s_table_claims_nothing():
    farm, _, _ = farm_and_truth(Star(STAR.z_t, STAR.c_f, 0.004 + 0.17j), [0.5e6, 0.7e6])
    assert farm.judgement.verdict == "unstable"
    assert "stable_on" not in seen_from_source(farm, F_HZ).meta


@pytest.mark.parametrize("powers", [[0.5e6] * 6, [0.25e6, 0.3e6, 0.35e6, 0.4e6, 0.5e6, 0.6e6]])
def test_many_devices_with_modes_on_top_of_each_other_are_counted_right(powers):
    """Equal devices turn the determinant many times at once; a locus of the product alone loses whole turns there."""
    farm, truth, _ = farm_and_truth(Star(STAR.z_t, STAR.c_f, 0.002 + 0.04j), powers)
    n = int(np.sum(truth.real > 0.0))
    assert (farm.judgement.n_unstable_locus, farm.judgement.n_unstable_poles) == (n, n)


def test_gains_of_each_norm_reach_what_is_asked():
    slopes = np.array([-3.0, -1.0, -2.0])
    for choose in (least_norm, fewest, uniform):
        k = choose(slopes, -4.0, 2.0)
        assert slopes @ k == pytest.approx(-4.0)
        assert k.min() >= 0.0
    assert np.count_nonzero(fewest(slopes, -4.0, 2.0)) == 1
    assert np.linalg.norm(least_norm(slopes, -4.0, 2.0)) < np.linalg.norm(uniform(slopes, -4.0, 2.0))
    assert least_norm(slopes, -11.0, 2.0).max() <= 2.0


def _without(key: str) -> dict:
    bad = document(STAR, 2)
    bad.pop(key)
    return bad


def _with(key: str, change) -> dict:
    bad = document(STAR, 2)
    bad[key] = change(bad[key])
    return bad


BAD = {
    "no source": (_without("source"), r"0 \[\[source\]\]; needed is exactly one"),
    "two sources": (_with("source", lambda s: s * 2), r"2 \[\[source\]\]"),
    "no bus": (_without("bus"), r"no \[\[bus\]\]"),
    "island": (_with("series", lambda s: s[:1]), "bus 't1' is an island"),
    "wrong bus": (_with("device", lambda d: [{**d[0], "bus": "t00"}]), "no bus; did you mean|is no bus"),
    "unknown key": (_with("device", lambda d: [{**d[0], "cuont": 3}]), "did you mean"),
    "volts for kilovolts": (
        _with("bus", lambda b: [{**b[0], "voltage_kv": 690.0}, *b[1:]]),
        "between voltage levels stands a transformer",
    ),
    "same name": (_with("device", lambda d: [d[0], {**d[1], "name": "wt0"}]), "'wt0' is there twice"),
    "all out": (_with("device", lambda d: [{**x, "in_service": False} for x in d]), "nothing to judge"),
}


@pytest.mark.parametrize(("bad", "words"), BAD.values(), ids=BAD)
def test_a_farm_that_makes_no_sense_is_refused_by_its_entry(bad, words):
    with pytest.raises(FarmError, match=words):
        farm_of(bad)


def test_more_power_than_the_network_carries_is_said_with_what_it_could():
    weak = Star(STAR.z_t, STAR.c_f, 0.02 + 0.4j)
    entry = farm_of(document(weak, 3))
    with pytest.raises(FarmError, match=r"no solution.* \d+ % of it has one"):
        judged(entry, lambda name: table_of(0.8e6, 690.0))


def test_a_device_out_of_service_is_left_out():
    entry = farm_of(document(STAR, 3), ["wt1"])
    assert [device.name for device in entry.devices] == ["wt0", "wt2"]
    with pytest.raises(FarmError, match=r"nothing in the farm is called 'wt9'.* it has .*wt0, wt1, wt2"):
        farm_of(document(STAR, 3), ["wt9"])


def test_unproved_devices_leave_the_verdict_open():
    table = table_of(0.5e6, 690.0)
    bare = FrequencyResponse(F_HZ, table.responses[0].y, 50.0, meta={**table.responses[0].meta, "stable_on": None})
    unproved = SimpleNamespace(meta=table.meta, op_ids=("p",), response=lambda op: bare, responses=(bare,))
    farm = judged(farm_of(document(STAR, 2)), lambda name: unproved)
    assert farm.judgement.verdict == "undecided"
    assert "--stable-on" in farm.judgement.reason


def test_a_mode_has_the_same_place_for_every_order_of_the_devices(three):
    farm, _, _ = three
    turned = System(farm.units[::-1], farm.entry.network, farm.system.ports[::-1], 50.0)
    mode = parts_of(turned, farm.judgement.critical.pole)
    np.testing.assert_allclose(mode.devices[::-1], farm.judgement.critical.devices, rtol=1e-5)
