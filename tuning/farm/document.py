"""`farm.toml`: buses, the equipment between them, one source, and the devices.

Equipment has the keys of a grid's elements (`tuning.grids.document`), with ``from`` and ``to`` naming buses; what a
section is called is the kind of the element. Cables become as many pi sections as a length of `SECTION_KM` asks for, so
that poles and locus are those of one finite system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil, isfinite, pi
from typing import Any

from ...plant.errors import nearest
from ..grids.document import KINDS, Element, Place
from ..grids.errors import check_in_service
from ..network.assembly import GROUND, Branch, Line, Network
from ..network.equipment import pi_line
from .entries import DamperEntry, DampingEntry, DeviceEntry, FarmEntry, FarmError
from .plausible import check_size, check_transformer

SECTION_KM = 5.0
"""Longest pi section (km)."""

SECTIONS = ("bus", "line", "cable", "series", "transformer", "shunt", "series_capacitor", "source", "device", "damper")
TOP_KEYS = ("name", "f1_hz", "damping", "state", *SECTIONS)
WORDS = ("model", "type")
"""Keys of equipment that are words, not numbers."""

OTHERS = {
    ("campaign", "plant", "sweep", "injection", "operating_point"): "a campaign (seqsweep run sweeps it)",
    ("element", "grid"): "a grid (seqsweep tune takes it with --grid)",
    ("duration_s", "event"): "a scenario (seqsweep verify takes it with --scenario)",
}
"""What other files begin with, and what they are."""

DAMPER_KEYS = ("name", "bus", "share", "size_s", "washout_hz", "in_service")
DAMPING_KEYS = ("r_ohm", "x_ohm", "resonance_hz", "k_max")
SOURCE_KEYS = ("name", "bus", "voltage_pu", "r_ohm", "x_ohm", "s_sc_mva", "r_over_x")
DEVICE_KEYS = (
    "name",
    "bus",
    "table",
    "op",
    "active_power_mw",
    "reactive_power_mvar",
    "count",
    "rating",
    "in_service",
)
_LISTED = 20  # buses that an error names
_SHUNTS = ("shunt_capacitor", "shunt_reactor", "filter", "load")


def farm_of(document: Mapping[str, Any], out_of_service: Sequence[str] = ()) -> FarmEntry:
    """Check a document and make the farm that it describes.

    Parameters
    ----------
    document : mapping
        What TOML gives.
    out_of_service : sequence of str
        Names of devices and equipment to leave out besides those that say ``in_service = false``.

    Raises
    ------
    FarmError
        With the entry, what was given and what is needed.
    """
    farm = _as_written(document, out_of_service)
    reached = reached_from_source(farm)
    for device in farm.devices:
        if device.bus not in reached:
            raise FarmError(
                f"{device.name}: bus {device.bus!r} is an island, no equipment in service connects it to the source at "
                f"{farm.source_bus!r}"
            )
    return farm


def farm_without_islands(document: Mapping[str, Any], out_of_service: Sequence[str] = ()) -> FarmEntry:
    """As `farm_of`, but devices that nothing in service connects to the source are out of service."""
    farm = _as_written(document, out_of_service)
    reached = reached_from_source(farm)
    devices = tuple(device for device in farm.devices if device.bus in reached)
    if not devices:
        raise FarmError("no [[device]] is connected to the source: there is nothing to judge")
    return replace(farm, devices=devices)


def _as_written(document: Mapping[str, Any], out_of_service: Sequence[str]) -> FarmEntry:
    """The farm with devices on islands still in it."""
    _check_kind(document)
    known_keys(document, TOP_KEYS, "the farm")
    f1_hz = float(document.get("f1_hz", 50.0))
    voltages = _buses(document)
    _check_names(document, out_of_service)
    for section in SECTIONS:
        for k, entry in enumerate(entries_of(document, section), start=1):
            check_in_service(entry, str(entry.get("name", f"{section}{k}")), FarmError)
    elements = [
        _element(entry, section, k, voltages)
        for section in ("line", "cable", "series", "transformer", "series_capacitor", "shunt")
        for k, entry in enumerate(entries_of(document, section), start=1)
        if _in_service(entry, out_of_service)
    ]
    source = _source(document, voltages, f1_hz)
    network = Network((*_branches(elements, voltages, f1_hz), source[0]))
    devices = tuple(
        _device(entry, k, voltages)
        for k, entry in enumerate(entries_of(document, "device"), start=1)
        if _in_service(entry, out_of_service)
    )
    dampers = tuple(
        _damper(entry, k, voltages)
        for k, entry in enumerate(entries_of(document, "damper"), start=1)
        if _in_service(entry, out_of_service)
    )
    if not devices:
        raise FarmError("no [[device]] is in service: there is nothing to judge")
    farm = FarmEntry(
        str(document.get("name", "farm")), f1_hz, network, voltages, *source[1:], devices, _damping(document), dampers
    )
    return replace(farm, network=_reached(farm))


def _reached(farm: FarmEntry) -> Network:
    """The branches that equipment in service connects to the source; others have no voltage."""
    reached = reached_from_source(farm)
    return Network(tuple(branch for branch in farm.network.branches if set(branch.ends) & reached))


# Entries -------------------------------------------------------------------------------------------------------------


def entries_of(document: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    """The entries of a section that may be there several times."""
    entries = document.get(section, [])
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise FarmError(f"[{section}]: write [[{section}]] in double brackets, there may be several")
    return entries


def known_keys(entry: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    """Refuse a key that is not known, with the one that may be meant."""
    for key in entry:
        if key not in keys:
            raise FarmError(f"{where}: unknown key {key!r}{nearest(key, keys)}; known are {', '.join(keys)}")


def _check_kind(document: Mapping[str, Any]) -> None:
    """Say what a file is that is no farm."""
    for keys, text in OTHERS.items():
        if "bus" not in document and "device" not in document and any(key in document for key in keys):
            raise FarmError(f"this is {text}, not a farm: a farm file has [[bus]], [[source]] and [[device]]")


def _in_service(entry: Mapping[str, Any], out_of_service: Sequence[str]) -> bool:
    return bool(entry.get("in_service", True)) and entry.get("name") not in out_of_service


def _check_names(document: Mapping[str, Any], out_of_service: Sequence[str]) -> None:
    names = [entry["name"] for section in SECTIONS for entry in entries_of(document, section) if "name" in entry]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise FarmError(f"the name {twice[0]!r} is there twice; every entry needs its own")
    for name in out_of_service:
        if name not in names:
            raise FarmError(f"nothing in the farm is called {name!r}{nearest(name, names)}; it has {', '.join(names)}")


def _buses(document: Mapping[str, Any]) -> dict[str, float]:
    voltages: dict[str, float] = {}
    for k, entry in enumerate(entries_of(document, "bus"), start=1):
        known_keys(entry, ("name", "voltage_kv"), f"bus {k}")
        name, kv = entry.get("name"), entry.get("voltage_kv", 0.0)
        if not isinstance(name, str) or not _positive(kv):
            raise FarmError(f"bus {k}: needed are a name and voltage_kv, line to line, above 0")
        check_size(name, "voltage_kv", kv)
        voltages[name] = float(kv) * 1e3
    if not voltages:
        raise FarmError("no [[bus]]: a farm needs buses with a name and voltage_kv")
    return voltages


def _bus(entry: Mapping[str, Any], key: str, where: str, voltages: Mapping[str, float]) -> str:
    name = entry.get(key)
    if name not in voltages:
        known = ", ".join(list(voltages)[:_LISTED]) + (", ..." if len(voltages) > _LISTED else "")
        meant = nearest(str(name), list(voltages))
        raise FarmError(f"{where}: {key} = {name!r} is no bus{meant}; the farm's are {known}")
    return str(name)


def _element(entry: Mapping[str, Any], section: str, k: int, voltages: Mapping[str, float]) -> Element:
    """One piece of equipment with the keys of a grid's element."""
    name = str(entry.get("name", f"{section}{k}"))
    kind = section
    if section == "shunt":
        kind = str(entry.get("kind", "shunt_capacitor"))
        if kind not in _SHUNTS:
            raise FarmError(f"{name}: kind = {kind!r}{nearest(kind, _SHUNTS)}; known are {', '.join(_SHUNTS)}")
    ends = ("bus",) if section == "shunt" else ("from", "to")
    of_kind = (*KINDS[kind].needed, *KINDS[kind].optional)
    known_keys(entry, ("name", "in_service", "parallel", "kind", *ends, *of_kind), name)
    if missing := [key for key in KINDS[kind].needed if key not in entry]:
        raise FarmError(f"{name}: a {kind} needs {', '.join(missing)}")
    for key in of_kind:
        if key in entry and not isinstance(entry[key], str if key in WORDS else int | float):
            raise FarmError(f"{name}: {key} = {entry[key]!r}; needed is a {'word' if key in WORDS else 'number'}")
        check_size(name, key, entry.get(key))
    nodes = [_bus(entry, end, name, voltages) for end in ends]
    if section == "transformer":
        nodes = _low_first(entry, name, nodes, voltages)
        check_transformer(name, float(entry["sn_mva"]), float(entry["vn_lv_kv"]))
    elif section != "shunt":
        _same_level(name, nodes, voltages)
    values = {key: entry[key] for key in of_kind if key in entry}
    return Element(name, kind, _parallel(values, entry, name), nodes[0], nodes[1] if len(nodes) > 1 else GROUND)


_PER_CIRCUIT = {
    "r_ohm_per_km": -1, "x_ohm_per_km": -1, "l_mh_per_km": -1, "c_nf_per_km": 1, "g_us_per_km": 1,
    "r_ohm": -1, "x_ohm": -1, "l_mh": -1, "sn_mva": 1,
}  # fmt: skip
"""What ``parallel`` equal circuits do to a number: divide it (-1) or multiply it (1)."""


def _parallel(values: Mapping[str, Any], entry: Mapping[str, Any], name: str) -> dict[str, Any]:
    n = entry.get("parallel", 1)
    if not isinstance(n, int) or n < 1:
        raise FarmError(f"{name}: parallel = {n!r}; needed is a whole number of equal circuits, at least 1")
    return {key: value * float(n) ** _PER_CIRCUIT.get(key, 0) if key in _PER_CIRCUIT else value
            for key, value in values.items()}  # fmt: skip


def _low_first(entry: Mapping[str, Any], name: str, nodes: list[str], voltages: Mapping[str, float]) -> list[str]:
    """The low-voltage bus first; the windings must be made for the buses that they connect."""
    low, high = sorted(nodes, key=lambda node: voltages[node])
    for bus, key in ((low, "vn_lv_kv"), (high, "vn_hv_kv")):
        ratio = float(entry[key]) * 1e3 / voltages[bus]
        if not 0.7 < ratio < 1.4:
            raise FarmError(
                f"{name}: {key} = {entry[key]:g} kV, but bus {bus!r} has {voltages[bus] / 1e3:g} kV: kV and V mixed up?"
            )
    return [low, high]


def _same_level(name: str, nodes: Sequence[str], voltages: Mapping[str, float]) -> None:
    a, b = nodes
    if abs(voltages[a] - voltages[b]) > 0.05 * voltages[a]:
        raise FarmError(
            f"{name}: bus {a!r} has {voltages[a] / 1e3:g} kV and bus {b!r} {voltages[b] / 1e3:g} kV; "
            "between voltage levels stands a transformer"
        )


def _branches(elements: Sequence[Element], voltages: Mapping[str, float], f1_hz: float) -> list[Branch]:
    w1 = 2.0 * pi * f1_hz
    branches: list[Branch] = []
    for element in elements:
        place = Place(element.a, element.b, voltages[element.a], w1, _x_of_lines(elements, voltages, element, w1))
        for part in KINDS[element.kind].build(element, place):
            branches += _lumped(part) if isinstance(part, Line) else [part]
    return branches


def _lumped(line: Line) -> tuple[Branch, ...]:
    return pi_line(line, ceil(line.length_km / SECTION_KM))


def _x_of_lines(elements: Sequence[Element], voltages: Mapping[str, float], element: Element, w1: float) -> float:
    """Reactance (ohm) of all lines at the element's voltage: what a compensation in per cent refers to."""
    if element.kind != "series_capacitor":
        return 0.0
    at_level = [e for e in elements if e.kind in ("line", "cable") and voltages[e.a] == voltages[element.a]]
    return sum(
        (e.values.get("x_ohm_per_km") or w1 * 1e-3 * e.values.get("l_mh_per_km", 0.0)) * e.values["length_km"]
        for e in at_level
    )


def _source(
    document: Mapping[str, Any], voltages: Mapping[str, float], f1_hz: float
) -> tuple[Branch, str, float, complex]:
    """The source's impedance as a branch, its bus, its voltage and its impedance at f1."""
    entries = entries_of(document, "source")
    if len(entries) != 1:
        raise FarmError(
            f"{len(entries)} [[source]]; needed is exactly one Thevenin source, others are devices or loads"
        )
    entry = entries[0]
    name = str(entry.get("name", "source"))
    known_keys(entry, SOURCE_KEYS, name)
    bus = _bus(entry, "bus", name, voltages)
    z = source_impedance(entry, name, voltages[bus])
    voltage = entry.get("voltage_pu", 1.0)
    if not _positive(voltage) or not 0.5 < voltage < 1.5:
        raise FarmError(f"{name}: voltage_pu = {voltage!r}; needed is a number near 1, in pu of the bus")
    branch = Branch(name, {bus: 1.0, GROUND: -1.0}, z.real, z.imag / (2.0 * pi * f1_hz))
    return branch, bus, float(voltage) * voltages[bus], z


def source_impedance(entry: Mapping[str, Any], name: str, voltage_v: float) -> complex:
    """Impedance (ohm at f1) of a ``[[source]]`` at a bus of ``voltage_v`` (V)."""
    if "s_sc_mva" in entry:
        if not _positive(entry["s_sc_mva"]):
            raise FarmError(f"{name}: s_sc_mva = {entry['s_sc_mva']!r}; needed is a number above 0, in MVA")
        size = voltage_v**2 / (float(entry["s_sc_mva"]) * 1e6)
        ratio = _number(entry, "r_over_x", 0.1, name, "R over X at f1")
        x = size / (1.0 + ratio**2) ** 0.5
        return complex(ratio * x, x)
    r, x = entry.get("r_ohm", 0.0), entry.get("x_ohm", 0.0)
    if not _positive(x) or not isinstance(r, int | float) or r < 0.0:
        raise FarmError(f"{name}: needed is s_sc_mva (and r_over_x), or x_ohm above 0 and r_ohm, in ohm at f1")
    return complex(float(r), float(x))


def _device(entry: Mapping[str, Any], k: int, voltages: Mapping[str, float]) -> DeviceEntry:
    name = str(entry.get("name", f"device{k}"))
    known_keys(entry, DEVICE_KEYS, name)
    if not isinstance(entry.get("table"), str):
        raise FarmError(f"{name}: table is missing; needed is the file of its admittance")
    count, rating = entry.get("count", 1), entry.get("rating", 1.0)
    if not isinstance(count, int) or count < 1:
        raise FarmError(f"{name}: count = {count!r}; needed is a whole number of at least 1")
    if not _positive(rating):
        raise FarmError(f"{name}: rating = {rating!r}; needed is a number above 0, in multiples of the swept device")
    if not isinstance(entry.get("op", ""), str):
        raise FarmError(f"{name}: op = {entry['op']!r}; needed is an operating point of its table, in quotes")
    if "op" in entry and "active_power_mw" in entry:
        raise FarmError(f"{name}: op and active_power_mw are both given; needed is one of them")
    power = _number(entry, "active_power_mw", 0.0, name, "in MW out of the device")
    return DeviceEntry(
        name=name,
        bus=_bus(entry, "bus", name, voltages),
        table=entry["table"],
        op=entry.get("op"),
        active_power_mw=power if "active_power_mw" in entry else None,
        reactive_power_mvar=_number(entry, "reactive_power_mvar", 0.0, name, "in Mvar out of the device"),
        count=count,
        rating=float(rating),
    )


def _damping(document: Mapping[str, Any]) -> DampingEntry:
    entry = document.get("damping", {})
    if not isinstance(entry, Mapping):
        raise FarmError("[damping] is a section of its own, with " + ", ".join(DAMPING_KEYS))
    known_keys(entry, DAMPING_KEYS, "damping")
    for key, value in entry.items():
        if not isinstance(value, int | float) or isinstance(value, bool) or (key in ("x_ohm", "k_max") and value <= 0):
            raise FarmError(f"damping: {key} = {value!r}; needed is a number" + (" above 0" if key != "r_ohm" else ""))
    return DampingEntry(**{key: float(value) for key, value in entry.items()})


def _damper(entry: Mapping[str, Any], k: int, voltages: Mapping[str, float]) -> DamperEntry:
    name = str(entry.get("name", f"damper{k}"))
    known_keys(entry, DAMPER_KEYS, name)
    share = checked_number(entry.get("share", 0.1), f"{name}: share")
    if share > 10.0:
        raise FarmError(f"{name}: share = {share:g}; needed is a part of the farm's rating, such as 0.1")
    size = checked_number(entry["size_s"], f"{name}: size_s") if "size_s" in entry else None
    washout = _number(entry, "washout_hz", 1.0, name, "0 for no washout, or some Hz")
    if washout < 0.0:
        raise FarmError(f"{name}: washout_hz = {washout:g}; needed is 0, which is none, or a number above")
    return DamperEntry(name, _bus(entry, "bus", name, voltages), share, size, washout)


def checked_number(value: Any, where: str) -> float:
    """A number above zero."""
    if not _positive(value):
        raise FarmError(f"{where} = {value!r}; needed is a number above 0")
    return float(value)


def _number(entry: Mapping[str, Any], key: str, otherwise: float, name: str, meaning: str) -> float:
    """A finite number of an entry, ``otherwise`` where it is not given."""
    value = entry.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise FarmError(f"{name}: {key} = {value!r}; needed is a number, {meaning}")
    return float(value)


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0


def reached_from_source(farm: FarmEntry) -> set[str]:
    """The nodes that equipment in service connects to the source."""
    reached, grown = {farm.source_bus}, True
    while grown:
        near = [set(branch.ends) - {GROUND} for branch in farm.network.branches]
        new = {bus for ends in near if ends & reached for bus in ends} - reached
        reached, grown = reached | new, bool(new)
    return reached


def without(farm: FarmEntry, names: Sequence[str]) -> FarmEntry:
    """The farm without some of its devices."""
    return replace(farm, devices=tuple(device for device in farm.devices if device.name not in names))
