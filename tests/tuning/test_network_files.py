"""Networks of pandapower and MATPOWER: read, written, and held against other code's load flow and admittances."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.loadflow import load_flow
from seqsweep.tuning.farm.network_files import exported, imported
from seqsweep.tuning.farm.network_parts import farm_text
from seqsweep.tuning.network.assembly import port_impedance

W1 = 100.0 * np.pi
SMALL = Path(__file__).parents[1] / "support" / "networks_of_others" / "pandapower_small.json"

FARM = {
    "name": "everything",
    "f1_hz": 50.0,
    "bus": [
        {"name": "grid", "voltage_kv": 110.0},
        {"name": "main", "voltage_kv": 35.0},
        {"name": "row", "voltage_kv": 35.0},
        {"name": "far", "voltage_kv": 35.0},
        {"name": "t1", "voltage_kv": 0.69},
        {"name": "t2", "voltage_kv": 0.69},
    ],
    "source": [{"name": "s", "bus": "grid", "voltage_pu": 1.02, "s_sc_mva": 300.0, "r_over_x": 0.08}],
    "transformer": [
        {"name": "main trafo", "from": "main", "to": "grid", "sn_mva": 40.0, "vn_hv_kv": 112.0, "vn_lv_kv": 35.5,
         "vk_percent": 12.0, "vkr_percent": 0.4, "tap_percent": -2.5},
        {"name": "u1", "from": "t1", "to": "row", "sn_mva": 2.5, "vn_hv_kv": 35.0, "vn_lv_kv": 0.69, "vk_percent": 6.0,
         "vkr_percent": 0.8, "parallel": 2},
        {"name": "u2", "from": "t2", "to": "far", "sn_mva": 2.5, "vn_hv_kv": 35.0, "vn_lv_kv": 0.69, "vk_percent": 6.0},
    ],
    "cable": [{"name": "c", "from": "main", "to": "row", "length_km": 3.0, "r_ohm_per_km": 0.13, "x_ohm_per_km": 0.119,
               "c_nf_per_km": 190.0, "parallel": 2}],
    "line": [{"name": "l", "from": "row", "to": "far", "length_km": 2.0, "r_ohm_per_km": 0.2, "l_mh_per_km": 1.1}],
    "series": [{"name": "reactor", "from": "main", "to": "far", "r_ohm": 0.05, "x_ohm": 2.0}],
    "shunt": [
        {"name": "bank", "bus": "main", "kind": "shunt_capacitor", "q_mvar": 1.5},
        {"name": "choke", "bus": "row", "kind": "shunt_reactor", "q_mvar": 0.8},
        {"name": "load", "bus": "main", "kind": "load", "p_mw": 3.0, "q_mvar": 1.0},
    ],
    "device": [
        {"name": "wt1", "bus": "t1", "table": "t", "active_power_mw": 1.8},
        {"name": "wt2", "bus": "t2", "table": "t", "active_power_mw": 2.0},
    ],
}  # fmt: skip
POWERS = {"wt1": 1.8 + 0.1j, "wt2": 2.0 - 0.2j}


def back(suffix: str) -> dict:
    return imported(exported(FARM, POWERS, suffix), "t").document()


@pytest.mark.parametrize(("suffix", "order"), [(".json", 1.0), (".json", 7.0), (".m", 1.0)])
def test_what_is_written_and_read_again_is_the_same_network(suffix, order):
    """Impedances of all terminals, at f1 and above; a case file adds up the shunts of a bus, and is of f1 alone."""
    again = farm_of(back(suffix))
    s = np.array([1j * order * W1])
    before = port_impedance(farm_of(FARM).network, ["t1", "t2"], s)
    after = port_impedance(again.network, [device.bus for device in again.devices], s)
    np.testing.assert_allclose(after, before, rtol=1e-9)


@pytest.mark.parametrize("suffix", [".json", ".m"])
def test_what_is_written_and_read_again_has_the_same_load_flow(suffix):
    drawn = -1e6 * np.array(list(POWERS.values()))
    before, after = (load_flow(farm_of(document), lambda v: drawn).voltage_v for document in (FARM, back(suffix)))
    np.testing.assert_allclose(after, before, rtol=1e-9)


def test_a_farm_file_that_was_imported_is_toml_that_says_the_same():
    document = back(".json")
    assert tomllib.loads(farm_text(document, ("a remark",))) == document


def test_load_flow_of_a_network_of_pandapower_is_pandapower_s_own():
    """Switches, taps, parallel circuits, scaled generators; voltages as pandapower 3.5.6 gives them, frozen."""
    found = imported(SMALL.read_text("utf-8"), "t")
    farm = farm_of(found.document())
    powers = {"wt1": 1.8 + 0.1j, "wt2": 0.9 * (2.0 - 0.2j)}
    drawn = -1e6 * np.array([powers[device.name] for device in farm.devices])
    v = dict(zip((device.name for device in farm.devices), load_flow(farm, lambda v: drawn).voltage_v, strict=True))
    for name, size, angle in (("wt1", 1.0789082717, 2.175124218), ("wt2", 1.0727036827, 2.23197829)):
        assert abs(v[name]) / 690.0 == pytest.approx(size, rel=1e-8)
        assert np.degrees(np.angle(v[name])) == pytest.approx(angle, abs=1e-6)
    found.keep_reactive()
    assert found.document()["device"][0]["reactive_power_mvar"] == 0.1


CASE = """\
function mpc = case_small
mpc.version = '2';
mpc.baseMVA = 100;   % MVA
%% bus data
mpc.bus = [
\t1\t3\t0\t0\t0\t0\t1\t1\t0\t110\t1\t1.1\t0.9;
\t2\t1\t12\t4\t0\t5\t1\t1\t0\t35\t1\t1.1\t0.9;
\t3\t1\t0\t0\t0\t0\t1\t1\t0\t35\t1\t1.1\t0.9;
\t7\t2\t0\t0\t0\t0\t1\t1\t0\t0.69\t1\t1.1\t0.9;
];
mpc.gen = [ 1 0 0 99 -99 1.02 100 1 99 0; 7 2.1 0.3 9 -9 1 100 1 9 0; 3 5 0 9 -9 1 100 0 9 0 ];
mpc.branch = [
\t1\t2\t0.01\t0.25\t0\t0\t0\t0\t0.98\t0\t1\t-360\t360;
\t2\t3\t0.03\t0.06\t0.002\t0\t0\t0\t0\t0\t1\t-360\t360;
\t2\t3\t0.04\t0.08\t0\t0\t0\t0\t0\t0\t1\t-360\t360;
\t7\t3\t0.05\t2.4\t0\t0\t0\t0\t1.03\t0\t1\t-360\t360;
\t1\t3\t0.01\t0.1\t0\t0\t0\t0\t0\t0\t0\t-360\t360;
];
"""


def ybus() -> np.ndarray:
    """MATPOWER's own formula, per unit of 100 MVA; the tap is at the "from" end, the source behind 300 MVA, R/X 0.1."""
    y = np.zeros((4, 4), dtype=complex)
    for a, b, r, x, charging, ratio in (
        (0, 1, 0.01, 0.25, 0, 0.98),
        (1, 2, 0.03, 0.06, 0.002, 1),
        (1, 2, 0.04, 0.08, 0, 1),
        (3, 2, 0.05, 2.4, 0, 1.03),
    ):
        series = 1.0 / complex(r, x)
        y[a, a] += (series + 0.5j * charging) / ratio**2
        y[b, b] += series + 0.5j * charging
        y[a, b] -= series / ratio
        y[b, a] -= series / ratio
    y[1, 1] += (12.0 - 4.0j) / 100.0 + 5.0j / 100.0
    x = 100.0 / 300.0 / np.hypot(1.0, 0.1)
    y[0, 0] += 1.0 / complex(0.1 * x, x)
    return y


def test_a_case_of_matpower_has_matpower_s_admittance_matrix():
    farm = farm_of(imported(CASE, "t", s_sc_mva=300.0).document())
    assert [(device.name, device.bus, device.active_power_mw) for device in farm.devices] == [("gen2", "bus7", 2.1)]
    assert farm.source_voltage_v == pytest.approx(1.02 * 110e3)
    ports, kv = ["bus1", "bus2", "bus3", "bus7"], np.array([110.0, 35.0, 35.0, 0.69])
    found = port_impedance(farm.network, ports, np.array([1j * W1]))[0]
    np.testing.assert_allclose(found, np.linalg.inv(ybus()) * np.outer(kv, kv) / 100.0, rtol=1e-9)


def without(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def pandapower_with(table: str, columns: list[str], row: list) -> str:
    content = json.loads(SMALL.read_text("utf-8"))
    data = json.dumps({"columns": columns, "index": [0], "data": [row]})
    content["_object"][table] = {"_module": "pandas.core.frame", "_class": "DataFrame", "_object": data}
    return json.dumps(content)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "neither a network of pandapower"),
        ("function mpc = a\nmpc.bus = [1 3];", "does not set mpc.baseMVA"),
        (CASE, "give it, --s-sc-mva"),
        (without(CASE, ("\t1\t3\t0\t0", "\t1\t1\t0\t0")), "0 reference buses"),
        (without(CASE, ("\t2\t3\t0.03", "\t2\t9\t0.03")), "branch 2 ends at bus 9"),
        (without(CASE, ("0.69", "0")), "no rated voltage"),
        (without(CASE, ("0.03", "x03")), "no row of numbers"),
        (without(CASE, ("\t12\t4", "\t-12\t4")), "make it a generator"),
        (pandapower_with("trafo3w", ["name", "in_service"], ["t", True]), "1 of trafo3w, which a farm file cannot say"),
        (pandapower_with("ext_grid", ["bus", "vm_pu", "in_service"], [0, 1.0, True]), "give it, --s-sc-mva"),
        (pandapower_with("ext_grid", ["bus", "vm_pu", "in_service"], [0, 1.0, False]), "0 external grids"),
        ('{"_class": "pandapowerNet", "_object": ', "this is no network of pandapower"),
        ('{"_class": "pandapowerNet", "_object": {}}', "no table of buses"),
    ],
)  # fmt: skip
def test_what_a_farm_file_cannot_say_is_refused(text, words):
    with pytest.raises(FarmError, match=words):
        imported(text, "t")


def test_a_table_that_is_out_of_service_does_no_harm():
    assert imported(pandapower_with("trafo3w", ["name", "in_service"], ["t", False]), "t").document()["device"]


@pytest.mark.parametrize(
    ("change", "suffix", "words"),
    [
        ({}, ".xml", "written as .json"),
        ({"shunt": [{"bus": "main", "kind": "filter", "tuned_hz": 250.0, "q_mvar": 1.0}]}, ".m", "no counterpart"),
        ({"series_capacitor": [{"from": "row", "to": "far", "compensation_percent": 40.0}]}, ".json", "give x_ohm"),
    ],
)  # fmt: skip
def test_what_other_tools_cannot_hold_is_refused(change, suffix, words):
    with pytest.raises(FarmError, match=words):
        exported({**FARM, **change}, POWERS, suffix)


# The real pandapower -------------------------------------------------------------------------------------------------

RUN = """
import json, sys, warnings
warnings.simplefilter("ignore")
import pandapower as pp
found = []
for path in sys.argv[1:]:
    net = pp.from_json(path)
    pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, max_iteration=50, trafo_model="pi", numba=False)
    kv = net.bus.vn_kv * net.res_bus.vm_pu
    found.append({name: (v * 1e3, a) for name, v, a in zip(net.bus.name, kv, net.res_bus.va_degree)})
print(json.dumps(found))
"""


@pytest.mark.evidence
def test_load_flows_of_random_farms_are_those_of_pandapower(tmp_path):
    """Twenty farms of random cables, taps and powers; in an environment of its own, as it needs another pandas."""
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    installed = subprocess.run([python, "-m", "pip", "install", "-q", "pandapower==3.5.6"], capture_output=True)
    if installed.returncode:
        print("pandapower 3.5.6 cannot be installed here: its load flow is not compared")
        pytest.skip("pandapower cannot be installed here")
    seed = int(np.random.SeedSequence().entropy % 10**6)
    rng = np.random.default_rng(seed)
    farms, flows = [], []
    for k in range(20):
        document, powers = _random_farm(rng)
        (tmp_path / f"{k}.json").write_text(exported(document, powers, ".json"), "utf-8")
        farms.append(farm_of(document))
        flows.append(load_flow(farms[-1], lambda v, p=powers: -1e6 * np.array(list(p.values()))).voltage_v)
    paths = [str(tmp_path / f"{k}.json") for k in range(20)]
    done = subprocess.run([python, "-c", RUN, *paths], capture_output=True, text=True, check=True)
    worst = 0.0
    for farm, flow, theirs in zip(farms, flows, json.loads(done.stdout.splitlines()[-1]), strict=True):
        for device, ours in zip(farm.devices, flow, strict=True):
            size, angle = theirs[device.bus]
            worst = max(worst, abs(ours - size * np.exp(1j * np.radians(angle))) / size)
    print(f"seed {seed}: 20 random farms, largest difference of a terminal voltage to pandapower's {worst:.1e}")
    assert worst < 1e-5


def _random_farm(rng: np.random.Generator) -> tuple[dict, dict[str, complex]]:
    n = int(rng.integers(2, 14))
    buses = [{"name": "grid", "voltage_kv": 35.0}]
    farm: dict = {"bus": buses, "source": [{"bus": "grid", "s_sc_mva": rng.uniform(4.0, 9.0) * n, "r_over_x": 0.1}]}
    farm |= {"cable": [], "transformer": [], "device": []}
    powers = {}
    for k in range(n):
        buses += [{"name": f"m{k}", "voltage_kv": 35.0}, {"name": f"t{k}", "voltage_kv": 0.69}]
        before = "grid" if k % 4 == 0 else f"m{k - 1}"
        cable = {"from": before, "to": f"m{k}", "length_km": rng.uniform(0.3, 4.5), "c_nf_per_km": 190.0}
        farm["cable"].append({"name": f"c{k}", **cable, "r_ohm_per_km": 0.13, "x_ohm_per_km": 0.119})
        trafo = {"sn_mva": 2.1, "vn_hv_kv": 35.0, "vn_lv_kv": 0.69, "vk_percent": 6.0, "vkr_percent": 0.8}
        tap = {"tap_percent": float(rng.choice([-2.5, 0.0, 2.5]))}
        farm["transformer"].append({"name": f"u{k}", "from": f"t{k}", "to": f"m{k}", **trafo, **tap})
        farm["device"].append({"name": f"wt{k}", "bus": f"t{k}", "table": "t", "active_power_mw": 1.0})
        powers[f"wt{k}"] = complex(rng.uniform(0.2, 1.2), rng.uniform(-0.2, 0.2))
    return farm, powers
