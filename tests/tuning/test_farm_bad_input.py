"""What is wrong with a farm is said by its entry, with what was meant or what would work."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from seqsweep.plant.errors import SeqsweepError
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError, NoLoadFlow
from seqsweep.tuning.farm.farm import judged

from ..support.farms import table_of
from .test_farm_advice import region  # noqa: F401 (a fixture)
from .test_network_files import FARM


def changed(section: str, k: int, **keys) -> dict:
    entries = [dict(entry) for entry in FARM[section]]
    entries[k] = {key: value for key, value in {**entries[k], **keys}.items() if value is not None}
    return {**FARM, section: entries}


BAD = {
    "an island": (changed("line", 0, in_service=False, name="l") | {"series": []}, "wt2: bus 't2' is an island"),
    "two sources": (
        {**FARM, "source": [FARM["source"][0], {**FARM["source"][0], "name": "other"}]},
        r"2 \[\[source\]\]; needed is exactly one",
    ),
    "a misspelt bus of a device": (changed("device", 0, bus="t11"), "is no bus .did you mean 't1'"),
    "a misspelt bus of a cable": (changed("cable", 0, to="rwo"), "c: to = 'rwo' is no bus .did you mean 'row'"),
    "a bus of nothing like it": (
        changed("source", 0, bus="xyzzy"),
        "bus = 'xyzzy' is no bus; the farm's are grid, main",
    ),
    "a campaign": ({"campaign": {"name": "x"}, "plant": {"id": "dpmsg-v1"}}, "this is a campaign .* not a farm"),
    "a grid": ({"voltage_kv": 35.0, "element": []}, "this is a grid .* not a farm"),
    "a scenario": ({"duration_s": 1.0, "event": []}, "this is a scenario .* not a farm"),
    "volts": (changed("bus", 1, voltage_kv=35000.0), "equipment has 0.05 to 1500 kV: V for kV"),
    "metres": (changed("cable", 0, length_km=3000.0), "length_km = 3000; .*m for km"),
    "ohm per metre": (changed("cable", 0, x_ohm_per_km=1.19e-4), "ohm/m for ohm/km"),
    "milliohm": (changed("cable", 0, x_ohm_per_km=119.0), "mohm/km for ohm/km"),
    "microfarad": (changed("cable", 0, c_nf_per_km=0.19), "uF/km for nF/km"),
    "picofarad": (changed("cable", 0, c_nf_per_km=1.9e5), "pF/km for nF/km"),
    "henry": (changed("line", 0, l_mh_per_km=1.1e-3), "H/km for mH/km"),
    "kilovoltampere": (changed("transformer", 1, sn_mva=2500.0), "kVA for MVA"),
    "per unit": (changed("transformer", 1, vk_percent=0.06), "per unit for per cent"),
    "a word": (changed("cable", 0, length_km="three"), "length_km = 'three'; needed is a number"),
    "nothing": (changed("cable", 0, length_km=None), "a cable needs length_km"),
    "a table that is a number": (changed("device", 0, table=3), "table is missing"),
    "a range": (
        changed("device", 0, active_power_mw=[0.8, 0.9]),
        r"active_power_mw = \[0.8, 0.9\]; needed is a number",
    ),
    "no number": (
        changed("device", 0, active_power_mw=float("nan")),
        "active_power_mw = nan; needed is a number, in MW",
    ),
    "Mvar in words": (changed("device", 0, reactive_power_mvar="none"), "reactive_power_mvar = 'none'; .* in Mvar"),
    "a ratio in words": (changed("source", 0, s_sc_mva=9.5, r_over_x="low"), "r_over_x = 'low'; needed is a number"),
    "a point that is a number": (changed("device", 0, op=5), "op = 5; needed is an operating point of its table"),
    "both ways": (changed("device", 0, op="p"), "op and active_power_mw are both given"),
}


@pytest.mark.parametrize(("bad", "words"), BAD.values(), ids=BAD)
def test_it_is_refused_with_what_was_meant(bad, words):
    with pytest.raises(SeqsweepError, match=words):
        farm_of(bad)


def one_turbine(**device) -> dict:
    bus = [{"name": "g", "voltage_kv": 0.69}]
    return {
        "bus": bus,
        "source": [{"bus": "g", "x_ohm": 0.05}],
        "device": [{"name": "wt", "bus": "g", "table": "t", **device}],
    }


def test_a_turbine_beyond_its_range_is_refused_with_the_range(region):  # noqa: F811
    with pytest.raises(SeqsweepError, match=r"wt: active_power_mw = 1.3 is outside the swept region, 0.3 to 0.9"):
        judged(farm_of(one_turbine(active_power_mw=1.3)), lambda name: region)


def test_a_voltage_beyond_the_table_is_refused(region):  # noqa: F811
    high = one_turbine(active_power_mw=0.6) | {"source": [{"bus": "g", "x_ohm": 0.05, "voltage_pu": 1.3}]}
    with pytest.raises(SeqsweepError, match="outside the swept region"):
        judged(farm_of(high), lambda name: region)


def test_kilowatts_are_told_from_megawatts(region):  # noqa: F811
    with pytest.raises(FarmError, match=r"active_power_mw = 600; its table ends at 0.9 MW: kW for MW\?"):
        judged(farm_of(one_turbine(active_power_mw=600.0)), lambda name: region)


def test_a_table_of_another_fundamental_is_refused():
    table = table_of(0.6e6, 690.0)
    other = SimpleNamespace(**{**vars(table), "meta": {**table.meta, "f1_hz": 60.0}})
    with pytest.raises(FarmError, match=r"wt: the table's fundamental is 60 Hz, the farm's 50 Hz"):
        judged(farm_of(one_turbine()), lambda name: other)


def test_a_device_on_the_wrong_voltage_level_is_refused():
    high = one_turbine() | {"bus": [{"name": "g", "voltage_kv": 35.0}]}
    with pytest.raises(FarmError, match=r"its table is of a device of 690 V, bus 'g' has 35000 V"):
        judged(farm_of(high), lambda name: table_of(0.6e6, 690.0))


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("source", "source1: in_service = 'no'; needed is true or false"),
        ("device", "wt: in_service = 'no'; needed is true or false"),
        ("bus", "unknown key 'in_service'"),
    ],
)
def test_what_is_neither_in_nor_out_of_service_is_refused(section, words):
    farm = one_turbine()
    farm[section] = [{**farm[section][0], "in_service": "no"}]
    with pytest.raises(FarmError, match=words):
        farm_of(farm)


def test_the_power_that_still_has_a_load_flow_is_said_and_has_one():
    """A turbine alone on 0.9 ohm: the part that is said has a solution, a quarter more has none."""
    weak = one_turbine() | {"source": [{"bus": "g", "x_ohm": 0.9}]}
    with pytest.raises(NoLoadFlow, match=r"(\d+) % of it has one") as refusal:
        judged(farm_of(weak), lambda name: table_of(0.6e6, 690.0))
    part = int(str(refusal.value).split(";")[1].split("%")[0]) / 100.0
    assert judged(farm_of(weak), lambda name: table_of(0.98 * part * 0.6e6, 690.0)).units
    with pytest.raises(NoLoadFlow):
        judged(farm_of(weak), lambda name: table_of(1.25 * part * 0.6e6, 690.0))
