"""Random farms, equal and unequal, with series capacitors, and droop units whose differential modes the PCC hides.

Truth is one explicit linearisation of all devices and their network (`tests/support/tree_oracle.py`).
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.inverters.parameters import FormingParameters
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.farm import Farm, judged, seen_from_source
from seqsweep.tuning.farm.locus import follow, unstable_behind
from seqsweep.tuning.poles import closed_loop_poles
from seqsweep.tuning.siso import SeriesRL

from ..support import inverter_oracle, oracle
from ..support.farms import F_HZ, RATED, table_of
from ..support.tree_oracle import Branch, Device, poles

OWN_RAD_S = 9.0
"""Modes nearer to a device's own pole than this are that device's, on any network."""

Y_SHUNT = 1.0 / (oracle.TABLE_I.r_f_ohm + 1.0 / (100j * np.pi * oracle.TABLE_I.c_f_f))


def turbine(node: int, power_w: float) -> Device:
    def system(voltage_v: float):
        m = oracle.linearise(power_w, voltage_v)
        return m.A, m.B, m.C, m.D

    return Device(node, lambda v: -power_w + abs(v) ** 2 * np.conj(Y_SHUNT), system)


def document(branches: list[Branch], c_f: np.ndarray, devices: list[Device]) -> dict:
    """The same farm as a file, all on 690 V; the source's branch is the first."""
    source, *others = branches
    name = lambda node: f"n{node}"  # noqa: E731
    farm: dict = {
        "bus": [{"name": name(k), "voltage_kv": 0.69} for k in range(len(c_f))],
        "source": [{"name": "s", "bus": name(max(source.a, source.b)), "r_ohm": source.r, "x_ohm": source.x}],
        "series": [],
        "series_capacitor": [],
        "shunt": [
            {"name": f"c{k}", "bus": name(k), "kind": "shunt_capacitor", "c_uf": c * 1e6} for k, c in enumerate(c_f)
        ],
        "device": [{"name": f"d{k}", "bus": name(d.node), "table": f"t{k}"} for k, d in enumerate(devices)],
    }
    for k, branch in enumerate(others):
        middle = name(branch.b)
        if branch.x_c:
            middle = f"x{k}"
            farm["bus"].append({"name": middle, "voltage_kv": 0.69})
            farm["series_capacitor"].append(
                {"name": f"sc{k}", "from": middle, "to": name(branch.b), "x_ohm": branch.x_c}
            )
        farm["series"].append(
            {"name": f"z{k}", "from": name(branch.a), "to": middle, "r_ohm": branch.r, "x_ohm": branch.x}
        )
    return farm


def random_farm(rng: np.random.Generator) -> tuple[list[Branch], np.ndarray, list[Device]]:
    """Two to four strings of one to three turbines, equal or not, a series capacitor in every other farm."""
    equal, with_c = rng.random() < 0.5, rng.random() < 0.5
    n_strings = int(rng.integers(2, 5))
    p = rng.uniform(0.3e6, 0.8e6)
    branches, devices, node = [], [], 1
    n_all = 0
    for _ in range(n_strings):
        before = 0
        for _ in range(int(rng.integers(1, 4))):
            x = 0.004 if equal else rng.uniform(0.002, 0.01)
            branches.append(Branch(node, before, 0.3 * x, x))
            z_t = 0.0175 if equal else rng.uniform(0.012, 0.025)
            branches.append(Branch(node + 1, node, 0.1 * z_t, z_t))
            devices.append(turbine(node + 1, p if equal else rng.uniform(0.3e6, 0.85e6)))
            before, node, n_all = node, node + 2, n_all + 1
    x_s = rng.uniform(0.12, 0.33) / n_all * 0.55e6 / np.mean([0.55e6, p])
    x_c = x_s * rng.uniform(0.1, 0.5) if with_c else 0.0
    c_f = np.where(np.arange(node) % 2 == 0, 60e-6, 150e-6).astype(float)
    if not with_c:
        return [Branch(-1, 0, 0.05 * x_s, x_s), *branches], c_f, devices
    c_f = np.append(c_f, 200e-6)  # the source's bus, the series capacitor between it and the farm
    source = Branch(-1, node, 0.03 * x_s, 0.5 * x_s)
    return [source, Branch(node, 0, 0.03 * x_s, 0.5 * x_s, x_c), *branches], c_f, devices


def judged_and_truth(rng: np.random.Generator) -> tuple[Farm, np.ndarray]:
    while True:
        branches, c_f, devices = random_farm(rng)
        try:
            truth, v = poles(branches, c_f, devices, 690.0)
        except ValueError:
            continue
        if np.any(np.abs(truth.real[np.abs(truth) < 3e4]) < 0.05):
            continue  # on the edge to a hair: no table has the digits
        powers = [-(device.drawn(1.0).real - np.real(np.conj(Y_SHUNT))) for device in devices]
        keys = [(round(p), round(abs(v[d.node]), 9)) for p, d in zip(powers, devices, strict=True)]
        made = {key: table_of(key[0], key[1]) for key in set(keys)}
        tables = {f"t{k}": made[key] for k, key in enumerate(keys)}
        content = document(branches, c_f, devices)
        shared = {key: f"t{keys.index(key)}" for key in set(keys)}
        content["device"] = [
            {**entry, "table": shared[key]} for entry, key in zip(content["device"], keys, strict=True)
        ]
        return judged(farm_of(content), tables.__getitem__), truth


def agrees(farm: Farm, truth: np.ndarray) -> bool:
    believed = truth[np.abs(truth) < 1.5 * 2.0 * np.pi * F_HZ[-1]]
    n = int(np.sum(believed.real > 0.0))
    return farm.judgement.n_unstable_locus == farm.judgement.n_unstable_poles == n


@pytest.mark.parametrize("seed", range(3))
def test_random_farms_are_counted_right(seed):
    farm, truth = judged_and_truth(np.random.default_rng(seed))
    assert agrees(farm, truth)


@pytest.mark.evidence
def test_a_hundred_random_farms_are_counted_right():
    seed = int(np.random.SeedSequence().entropy % 10**6)
    rng = np.random.default_rng(seed)
    found = [judged_and_truth(rng) for _ in range(100)]
    right = sum(agrees(*pair) for pair in found)
    unstable = sum(bool(farm.judgement.n_unstable_poles) for farm, _ in found)
    largest = max(np.abs(truth - f.judgement.critical.pole).min() for f, truth in found if f.judgement.critical)
    print(f"seed {seed}: {right} of 100 random farms counted right, {unstable} of them unstable; ", end="")
    print(f"largest error of a critical mode {largest:.1e} rad/s")
    assert right == 100


def on_cables(n: int, rng: np.random.Generator) -> tuple[list[Branch], np.ndarray, list[Device]]:
    """n turbines at different powers in strings of four on cables of 0.8 km, everything seen from 690 V."""
    per_ohm = (0.69 / 35.0) ** 2
    r, x, c = 0.8 * 0.13 * per_ohm, 0.8 * 0.119 * per_ohm, 0.8 * 190e-9 / per_ohm
    z_t = 0.06 * 0.69**2 / 2.0
    branches, devices = [Branch(-1, 0, 0.05 * 0.27 / n, 0.27 / n)], []
    c_f = np.full(2 * n + 1, 1e-6)
    for k in range(n):
        here, before = 2 * k + 1, 0 if k % 4 == 0 else 2 * k - 1
        branches += [Branch(here, before, r, x), Branch(here + 1, here, 0.1 * z_t, z_t)]
        c_f[[here, before]] += c / 2.0
        devices.append(turbine(here + 1, rng.uniform(0.35e6, 0.8e6)))
    return branches, c_f, devices


SETTLED = 1e-8
"""How nearly a shot comes to rest: at a sweep's own 1e-6 what is left of transients carries the modes' error."""


@pytest.mark.evidence
@pytest.mark.parametrize("n", [2, 8, 13])
def test_really_swept_turbines_on_cables_have_the_modes_of_the_exact_farm(n):
    """Every turbine swept at its own power and the voltage of the load flow, 100 rows."""
    import seqsweep as ss

    seed = int(np.random.SeedSequence().entropy % 10**6)
    branches, c_f, devices = on_cables(n, np.random.default_rng(seed))
    truth, v = poles(branches, c_f, devices, 690.0)
    tables = {}
    for k, device in enumerate(devices):
        power_mw = -(device.drawn(1.0).real - np.real(np.conj(Y_SHUNT))) / 1e6
        f_hz = ss.log_grid(1, 1000, 100)
        at = {"active_power_mw": power_mw, "terminal_voltage_pu": abs(v[device.node]) / 690.0}
        y = ss.sweep("dpmsg-v1", **at, f_hz=f_hz, tolerance=SETTLED)
        tables[f"t{k}"] = SimpleNamespace(
            meta={"f1_hz": 50.0, "bases": RATED}, op_ids=("p",), response=lambda op, y=y: y, responses=(y,)
        )
    farm = judged(farm_of(document(branches, c_f, devices)), tables.__getitem__)
    critical = np.abs(truth - farm.judgement.critical.pole).min()
    own = np.concatenate([unit.model.poles for unit in farm.units])
    band = [mode.pole for mode in farm.judgement.modes if abs(mode.pole) < 2.0 * np.pi * 500.0]
    moved = [pole for pole in band if np.abs(own - pole).min() > OWN_RAD_S]  # others are a device's own, on any network
    largest = max(np.abs(truth - pole).min() for pole in moved)
    print(f"seed {seed}: {n} swept turbines, critical mode {farm.judgement.critical.pole:.2f} within {critical:.1e},")
    print(f"    {len(moved)} modes of network and devices below 500 Hz within {largest:.1e} rad/s")
    assert agrees(farm, truth)
    assert critical < 5e-5
    assert largest < 2e-3


# Droop units ---------------------------------------------------------------------------------------------------------

FORMING = FormingParameters(k_w=20.0, t_a_s=0.02, k_d=0.0, l_v_pu=0.0)
"""A droop of five per cent without inertia or virtual impedance."""
BASE_OHM = FORMING.u_rated_v**2 / FORMING.s_rated_va


def forming(node: int, p_pu: float) -> Device:
    def system(voltage_v: float):
        m = inverter_oracle.linearise(FORMING, "forming", complex(p_pu, 0.0), voltage_v / FORMING.u_rated_v)
        u, i = FORMING.u_rated_v, FORMING.s_rated_va / FORMING.u_rated_v
        return m.a, m.b / u, -i * m.c, np.zeros((2, 2))

    return Device(node, lambda v: complex(-p_pu * FORMING.s_rated_va, 0.0), system)


def table_of_forming(p_pu: float, voltage_v: float) -> SimpleNamespace:
    m = inverter_oracle.linearise(FORMING, "forming", complex(p_pu, 0.0), voltage_v / FORMING.u_rated_v)
    on = {"r_ohm": 0.02 * BASE_OHM, "x_ohm": 0.2 * BASE_OHM}
    meta = {
        "op_id": "p",
        "terminal_voltage_pu": voltage_v / FORMING.u_rated_v,
        "stable_on": {"grid": on, "basis": "shots"},
        "fundamental": {
            "active_power_into_device_w": -p_pu * FORMING.s_rated_va,
            "reactive_power_into_device_var": 0.0,
        },
    }
    assert np.max(inverter_oracle.behind(FORMING, m, 0.02 + 0.2j).real) < 1e-6
    y = inverter_oracle.admittance_pn(m, F_HZ) / BASE_OHM
    response = FrequencyResponse(F_HZ, y, 50.0, meta=meta)
    return SimpleNamespace(
        meta={"f1_hz": 50.0, "bases": {**RATED, "rated_power_va": FORMING.s_rated_va}},
        op_ids=("p",),
        response=lambda op: response,
        responses=(response,),
    )


def test_differential_modes_of_droop_units_are_counted_although_the_pcc_looks_stable():
    """Four grid-forming units with little between them: the common mode sees the grid four times, the others do not."""
    z_t, z_g = 0.004 * BASE_OHM, 0.125 * BASE_OHM
    branches = [Branch(-1, 0, 0.1 * z_g, z_g), *(Branch(k, 0, 0.1 * z_t, z_t) for k in range(1, 5))]
    c_f = np.full(5, 30e-6)
    devices = [forming(k, 0.5) for k in range(1, 5)]
    truth, v = poles(branches, c_f, devices, 690.0)
    believed = truth[np.abs(truth) < 1.5 * 2.0 * np.pi * F_HZ[-1]]
    n = int(np.sum(believed.real > 0.0))
    assert n == 6
    table = table_of_forming(0.5, abs(v[1]))
    content = document(branches, c_f, devices)
    content["device"] = [{**entry, "table": "t0"} for entry in content["device"]]
    farm = judged(farm_of(content), lambda name: table)
    assert (farm.judgement.n_unstable_locus, farm.judgement.n_unstable_poles) == (n, n)
    assert farm.judgement.verdict == "unstable"
    stiff = [Branch(-1, 0, 1e-4 * z_g, 1e-3 * z_g), *branches[1:]]
    on_ideal, _ = poles(stiff, c_f, devices, 690.0)
    in_band = on_ideal[np.abs(on_ideal) < 2.0 * np.pi * F_HZ[-1]]
    assert unstable_behind(farm.system) == int(np.sum(in_band.real > 0.0)) > 0
    alone = closed_loop_poles(fit_response(seen_from_source(farm, F_HZ)), SeriesRL(0.1 * z_g, z_g, 50.0))
    common = alone[np.abs(alone) < 2.0 * np.pi * F_HZ[-1]]
    assert int(np.sum(common.real > 0.0)) < n  # the connection point alone does not show them


def test_the_locus_is_followed_to_the_end_of_the_band():
    farm, _ = judged_and_truth(np.random.default_rng(11))
    assert follow(farm.system, farm.system.poles()).trusted
