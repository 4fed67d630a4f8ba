"""`grid.toml`: elements of a grid as a planner has them, from the PCC to the source.

A list of ``[[element]]`` is a ladder: each series element leads one node further from the PCC, each shunt element
stands where the ladder has come to; the last series element ends at the ideal source. With ``from`` and ``to`` the
elements make any small network between "pcc" and "source".
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, pi
from typing import Any, NamedTuple

from ..network.assembly import GROUND, Branch, Line, Network
from ..network.equipment import (
    high_pass,
    pi_line,
    series,
    series_capacitor,
    shunt_capacitor,
    shunt_reactor,
    shunt_resistor,
    single_tuned,
    transformer,
)
from .errors import GridError, check_in_service
from .voltages import check_sides, levels_of

PCC, SOURCE = "pcc", "source"
_LEAST_PU, _MOST_PU = 0.5, 1.5  # a source voltage beyond is in another unit

TOP_KEYS = ("f1_hz", "voltage_kv", "rated_power_mw", "source_voltage_pu", "name", "element")
COMMON_KEYS = ("kind", "name", "from", "to", "at", "in_service")


class Place(NamedTuple):
    """Where an element stands: its two nodes, the voltage there (V, None if unknown), w1, and X of the lines (ohm)."""

    a: str
    b: str
    voltage_v: float | None
    w1_rad_s: float
    x_lines_ohm: float


@dataclass(frozen=True, slots=True)
class Element:
    """One element of the document.

    Attributes
    ----------
    name : str
        As given, or the kind and its number.
    kind : str
        One of `KINDS`.
    values : mapping
        Its numbers by key.
    a, b : str
        Nodes, b the one nearer to the source; ground for a shunt element.
    """

    name: str
    kind: str
    values: Mapping[str, Any]
    a: str
    b: str


def network_of(document: Mapping[str, Any], f1_hz: float) -> Network:
    """Nodes, branches and lines of a document.

    Raises
    ------
    GridError
        If an element, a key or a number is not what is needed; every message names the element.
    """
    parts = parts_of(document, f1_hz)
    branches = tuple(part for part in parts if isinstance(part, Branch))
    return Network(branches, tuple(part for part in parts if isinstance(part, Line)))


def parts_of(document: Mapping[str, Any], f1_hz: float, ideal_source: str = GROUND) -> list[Branch | Line]:
    """Branches and lines of a document, in its order; the ideal source is a node of that name."""
    elements = elements_of(document, f1_hz)
    places = _places(document, elements, f1_hz, ideal_source)
    parts = [part for element in elements for part in KINDS[element.kind].build(element, places[element.name])]
    if not any(PCC in (part.ends if isinstance(part, Branch) else (part.a, part.b)) for part in parts):
        raise GridError("no element is connected to the node 'pcc'")
    return parts


def _places(
    document: Mapping[str, Any], elements: Sequence[Element], f1_hz: float, ideal_source: str
) -> dict[str, Place]:
    """Where each element stands, by its name."""
    w1 = 2.0 * pi * f1_hz
    levels = levels_of(elements, document.get("voltage_kv"), PCC, SOURCE)
    x_lines = {level: _x_of_lines(elements, levels, level, w1) for level in {None, *levels.values()}}
    places = {}
    for element in elements:
        level = levels.get(element.a, levels.get(element.b))
        a, b = (ideal_source if node == SOURCE else node for node in (element.a, element.b))
        places[element.name] = Place(a, b, level, w1, x_lines.get(level, 0.0))
    return places


def reactance_compensated(document: Mapping[str, Any], k: int, f1_hz: float) -> float:
    """What a percentage of compensation of entry ``k`` refers to (ohm), whether it is in service or not."""
    entries = [dict(entry) for entry in document["element"]]
    entries[k] = {**entries[k], "in_service": True}
    whole = {**document, "element": entries}
    elements = elements_of(whole, f1_hz)
    at = sum(any(entry is each for each in in_service(whole)) for entry in entries[:k])
    return _places(whole, elements, f1_hz, GROUND)[elements[at].name].x_lines_ohm


def elements_of(document: Mapping[str, Any], f1_hz: float) -> tuple[Element, ...]:
    """The elements in service, with names and nodes."""
    _check_top(document, f1_hz)
    for k, entry in enumerate(document["element"]):
        check_in_service(entry, str(entry.get("name", f"element {k + 1}")))
    given = in_service(document)
    if not given:
        raise GridError("every element is out of service: there is no grid left")
    counts: dict[str, int] = {}
    elements, node = [], PCC
    kinds = [_kind(entry, k) for k, entry in enumerate(given)]
    series_ones = [k for k, kind in enumerate(kinds) if kind.is_series]
    for k, (entry, kind) in enumerate(zip(given, kinds, strict=True)):
        counts[entry["kind"]] = counts.get(entry["kind"], 0) + 1
        name = str(entry.get("name", f"{entry['kind']}{counts[entry['kind']]}"))
        last = not series_ones or k >= series_ones[-1]
        a, b, node = _nodes(entry, kind, node, k, last)
        values = _numbers(entry, kind, name)
        if "scr" in values and "rated_power_mw" in document:
            values["rated_power_mw"] = document["rated_power_mw"]
        elements.append(Element(name, entry["kind"], values, a, b))
    _check_names(elements)
    return tuple(elements)


def in_service(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The entries that count: not those out of service, nor a series capacitor that compensates nothing."""
    entries: Sequence[Mapping[str, Any]] = document["element"]
    return [e for e in entries if e.get("in_service", True) and e.get("compensation_percent", 1.0) != 0.0]


def _nodes(entry: Mapping[str, Any], kind: Kind, node: str, k: int, last: bool) -> tuple[str, str, str]:
    """The element's two nodes, and where the ladder stands after it."""
    if not kind.is_series:
        at = str(entry.get("at", entry.get("from", node)))
        if at == SOURCE:
            raise GridError(
                f"element {k + 1} ({entry['kind']}): a shunt element at the ideal source has no effect; put it before "
                "the last series element"
            )
        return at, GROUND, node
    a = str(entry.get("from", node))
    b = str(entry.get("to", SOURCE if last else f"n{k + 1}"))
    if a == b:
        raise GridError(f"element {k + 1} ({entry['kind']}): it begins and ends at {a!r}")
    return a, b, b


# Checks --------------------------------------------------------------------------------------------------------------


def _check_top(document: Mapping[str, Any], f1_hz: float) -> None:
    for key in document:
        if key not in TOP_KEYS:
            raise GridError(f"unknown key {key!r}{_nearest(key, TOP_KEYS)}; a grid has {', '.join(TOP_KEYS)}")
    given = document.get("f1_hz", f1_hz)
    if given != f1_hz:
        raise GridError(f"the grid is given at f1_hz = {given!r}, the table's fundamental is {f1_hz:g} Hz")
    entries = document.get("element")
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        raise GridError("no [[element]]: a grid needs at least one, such as kind = 'series', r_ohm, x_ohm")
    if not all(isinstance(entry, Mapping) for entry in entries):
        raise GridError("every [[element]] is a table of keys and values")
    voltage = document.get("voltage_kv")
    power = document.get("rated_power_mw")
    if power is not None and not _is_positive(power):
        raise GridError(f"rated_power_mw = {power!r}: needed is the device's rating in MW, above 0")
    source = document.get("source_voltage_pu")
    if source is not None:
        check_source_voltage(source, f"source_voltage_pu = {source!r}")
    if voltage is not None and not _is_positive(voltage):
        raise GridError(f"voltage_kv = {voltage!r}: needed is the line-to-line voltage at the PCC in kV, above 0")


def check_source_voltage(source_pu: Any, given: str) -> None:
    """Refuse what is no voltage behind a grid; the message begins with what was ``given``."""
    if not (_is_positive(source_pu) and _LEAST_PU < source_pu < _MOST_PU):
        raise GridError(
            f"{given}: needed is the voltage behind the grid in per unit of the device's rated voltage, between "
            f"{_LEAST_PU:g} and {_MOST_PU:g}"
        )


def _kind(entry: Mapping[str, Any], k: int) -> Kind:
    kind = entry.get("kind")
    if kind is None:
        raise GridError(f"element {k + 1} has no kind; known are {', '.join(KINDS)}")
    if kind not in KINDS:
        raise GridError(f"element kind {kind!r}{_nearest(str(kind), KINDS)}; known are {', '.join(KINDS)}")
    return KINDS[kind]


def _numbers(entry: Mapping[str, Any], kind: Kind, name: str) -> dict[str, Any]:
    """The element's own numbers, checked."""
    known = (*kind.needed, *kind.optional)
    for key, value in entry.items():
        if key in COMMON_KEYS:
            continue
        if key not in known:
            at_top = ", and it stands at the top of the document, not in an element" if key in TOP_KEYS else ""
            near = at_top or _nearest(key, known)
            raise GridError(f"{name}: unknown key {key!r}{near}; {entry['kind']} has {', '.join(known)}")
        if key in _WORDS:
            if value not in _WORDS[key]:
                raise GridError(f"{name}: {key} = {value!r}; known are {', '.join(_WORDS[key])}")
        elif key not in _SIGNED and not _is_number(value):
            raise GridError(f"{name}: {key} = {value!r}; needed is a finite number, not negative")
        elif key in _SIGNED and not (isinstance(value, int | float) and isfinite(value)):
            raise GridError(f"{name}: {key} = {value!r}; needed is a finite number")
    for pair in SAID_TWICE:
        if all(key in entry for key in pair):
            raise GridError(f"{name}: {pair[0]} and {pair[1]} say the same quantity: give one of them")
    missing = [key for key in kind.needed if key not in entry]
    if missing:
        raise GridError(f"{name}: {entry['kind']} needs {', '.join(missing)}")
    return {key: value for key, value in entry.items() if key in known}


_WORDS = {"model": ("distributed", "pi"), "type": ("single_tuned", "high_pass")}
_SIGNED = ("tap_percent",)
SAID_TWICE = (("x_ohm", "l_mh"), ("x_ohm_per_km", "l_mh_per_km"), ("r_over_x", "x_over_r"))
"""Pairs of keys of one quantity: an element has one of them."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and value >= 0.0


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0.0


def _nearest(key: str, known: Any) -> str:
    near = difflib.get_close_matches(key, list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def _check_names(elements: Sequence[Element]) -> None:
    names = [element.name for element in elements]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise GridError(f"two elements are called {twice!r}: give them different names")


# Reactances -----------------------------------------------------------------------------------------------------------


def _x_of_lines(elements: Sequence[Element], levels: Mapping[str, float], level: float | None, w1: float) -> float:
    """Reactance (ohm at f1) of the lines and series reactors of one voltage level; the source's where there is none."""
    here = [e for e in elements if levels.get(e.a, levels.get(e.b)) == level]
    lines = [e for e in here if e.kind in ("series", "line", "cable")]
    return sum(_x_ohm(e, level, w1) for e in lines or [e for e in here if e.kind == "source"])


def _x_ohm(element: Element, level: float | None, w1: float) -> float:
    values = element.values
    if element.kind == "source":
        return _source_impedance(element, level)[1]
    if "length_km" in values:
        return w1 * _per_km(element, "l", w1) * values["length_km"]
    return _series_x(element, w1)


# The kinds -----------------------------------------------------------------------------------------------------------


def _series_x(element: Element, w1: float) -> float:
    values = element.values
    x = values.get("x_ohm", values.get("l_mh", 0.0) * 1e-3 * w1)
    if not x > 0.0 and not values.get("r_ohm", 0.0) > 0.0:
        raise GridError(f"{element.name}: needed is x_ohm or l_mh (at the fundamental), or r_ohm, above 0")
    return float(x)


def _series(element: Element, at: Place) -> list[Branch]:
    x = _series_x(element, at.w1_rad_s)
    return [series(element.name, at.a, at.b, element.values.get("r_ohm", 0.0), x / at.w1_rad_s)]


def _source(element: Element, at: Place) -> list[Branch]:
    r, x = _source_impedance(element, at.voltage_v)
    return [series(element.name, at.a, at.b, r, x / at.w1_rad_s)]


def _source_impedance(element: Element, level: float | None) -> tuple[float, float]:
    """R and X (ohm) from the short-circuit power and R/X."""
    values = element.values
    _exactly_one(element, ("s_sc_mva", "scr"))
    if "scr" in values and "rated_power_mw" not in values:
        raise GridError(f"{element.name}: scr needs rated_power_mw beside voltage_kv at the top of the document")
    power_mw = values["s_sc_mva"] if "s_sc_mva" in values else values["scr"] * values["rated_power_mw"]
    if not power_mw > 0.0:
        raise GridError(f"{element.name}: a short-circuit power of {power_mw:g} MVA; needed is a number above 0")
    z = _volts(element, level) ** 2 / (power_mw * 1e6)
    rx = 1.0 / _positive(element, "x_over_r") if "x_over_r" in values else values.get("r_over_x", 0.1)
    x = z / (1.0 + rx**2) ** 0.5
    return rx * x, x


def _series_capacitor(element: Element, at: Place) -> list[Branch]:
    values = element.values
    _exactly_one(element, ("compensation_percent", "x_ohm", "c_uf"))
    if "compensation_percent" in values:
        if not at.x_lines_ohm > 0.0:
            raise GridError(f"{element.name}: no line at this voltage whose X could be compensated; give x_ohm")
        percent = _positive(element, "compensation_percent")
        if percent > 100.0:
            raise GridError(
                f"{element.name}: compensation_percent = {percent:g}; needed is at most 100, all of the X of the lines "
                "at its voltage; x_ohm says more"
            )
        x = percent / 100.0 * at.x_lines_ohm
    else:
        x = values["x_ohm"] if "x_ohm" in values else 1.0 / (at.w1_rad_s * _positive(element, "c_uf") * 1e-6)
    if not x > 0.0:
        raise GridError(f"{element.name}: x_ohm = {x:g}; needed is a number above 0")
    return [series_capacitor(element.name, at.a, at.b, x, at.w1_rad_s, values.get("r_ohm", 0.0))]


def _shunt_capacitor(element: Element, at: Place) -> list[Branch]:
    return [shunt_capacitor(element.name, at.a, _capacitance(element, at), element.values.get("r_ohm", 0.0))]


def _capacitance(element: Element, at: Place) -> float:
    """C (F) of a phase from c_uf or from q_mvar at the voltage of the place."""
    _exactly_one(element, ("q_mvar", "c_uf"))
    if "c_uf" in element.values:
        return _positive(element, "c_uf") * 1e-6
    return _positive(element, "q_mvar") * 1e6 / (at.w1_rad_s * _volts(element, at.voltage_v) ** 2)


def _shunt_reactor(element: Element, at: Place) -> list[Branch]:
    values = element.values
    _exactly_one(element, ("q_mvar", "x_ohm", "l_mh"))
    if "q_mvar" in values:
        x = _volts(element, at.voltage_v) ** 2 / (_positive(element, "q_mvar") * 1e6)
    else:
        x = _positive(element, "x_ohm") if "x_ohm" in values else _positive(element, "l_mh") * 1e-3 * at.w1_rad_s
    return [shunt_reactor(element.name, at.a, x / at.w1_rad_s, values.get("r_ohm", 0.0))]


def _load(element: Element, at: Place) -> list[Branch]:
    """A passive load: resistor, and reactor or none, in parallel."""
    volts = _volts(element, at.voltage_v)
    parts = [shunt_resistor(f"{element.name}.r", at.a, volts**2 / (_positive(element, "p_mw") * 1e6))]
    if element.values.get("q_mvar", 0.0) > 0.0:
        x = volts**2 / (element.values["q_mvar"] * 1e6)
        parts.append(shunt_reactor(f"{element.name}.x", at.a, x / at.w1_rad_s))
    return parts


def _filter(element: Element, at: Place) -> list[Branch]:
    values = element.values
    build = high_pass if values.get("type") == "high_pass" else single_tuned
    quality = values.get("quality", 50.0) if build is single_tuned else values.get("quality", 2.0)
    tuned_hz, c_f = _positive(element, "tuned_hz"), _capacitance(element, at)
    if "q_mvar" in values:  # the filter's reactive power is that of C and L together
        c_f *= 1.0 - (at.w1_rad_s / (2.0 * pi * tuned_hz)) ** 2
    if not c_f > 0.0:
        raise GridError(f"{element.name}: tuned_hz = {tuned_hz:g} is not above the fundamental")
    return list(build(element.name, at.a, c_f, tuned_hz, quality or inf))


def _cable(element: Element, at: Place) -> Sequence[Branch | Line]:
    values, w1 = element.values, at.w1_rad_s
    line = Line(
        element.name,
        at.a,
        at.b,
        values["r_ohm_per_km"],
        _per_km(element, "l", w1),
        values.get("g_us_per_km", 0.0) * 1e-6,
        values.get("c_nf_per_km", 0.0) * 1e-9,
        _positive(element, "length_km"),
    )
    if values.get("model", "distributed") == "distributed" and "sections" not in values and line.c_f_km > 0.0:
        return [line]
    return pi_line(line, _sections(element))


def _sections(element: Element) -> int:
    sections = element.values.get("sections", 1)
    if not isinstance(sections, int) or not 1 <= sections <= 50:
        raise GridError(f"{element.name}: sections = {sections!r}; needed is a whole number from 1 to 50")
    return sections


def _per_km(element: Element, what: str, w1: float) -> float:
    """L (H/km) from x_ohm_per_km or l_mh_per_km."""
    _exactly_one(element, ("x_ohm_per_km", "l_mh_per_km"))
    values = element.values
    l_h = values["x_ohm_per_km"] / w1 if "x_ohm_per_km" in values else values["l_mh_per_km"] * 1e-3
    if not l_h > 0.0:
        raise GridError(f"{element.name}: the inductance per km is {l_h:g}; needed is a number above 0")
    return float(l_h)


def _transformer(element: Element, at: Place) -> list[Branch]:
    values = element.values
    vk, vkr = values["vk_percent"] / 100.0, values.get("vkr_percent", 0.0) / 100.0
    if not vk > vkr:
        raise GridError(f"{element.name}: vk_percent = {vk * 100:g} must be above vkr_percent = {vkr * 100:g}")
    low_kv, high_kv = _positive(element, "vn_lv_kv"), _positive(element, "vn_hv_kv")
    check_sides(element.name, {"vn_lv_kv": low_kv, "vn_hv_kv": high_kv})
    ratio = low_kv / (high_kv * (1.0 + values.get("tap_percent", 0.0) / 100.0))
    rated_va = _positive(element, "sn_mva") * 1e6
    return [transformer(element.name, at.a, at.b, ratio, rated_va, low_kv * 1e3, vk, vkr, at.w1_rad_s)]


def _volts(element: Element, level: float | None) -> float:
    if level is None:
        raise GridError(f"{element.name}: its voltage is not known; give voltage_kv (line to line, at the PCC)")
    return level


def _positive(element: Element, key: str) -> float:
    value = element.values[key]
    if not value > 0.0:
        raise GridError(f"{element.name}: {key} = {value!r}; needed is a number above 0")
    return float(value)


def _exactly_one(element: Element, keys: Sequence[str]) -> None:
    if sum(key in element.values for key in keys) != 1:
        raise GridError(f"{element.name}: give exactly one of {', '.join(keys)}")


class Kind(NamedTuple):
    """What an element of one kind is made from.

    Attributes
    ----------
    is_series : bool
        Whether it leads from one node to the next; a shunt element stands between a node and ground.
    needed, optional : tuple of str
        Keys of its numbers.
    build : callable
        Element and place to branches and lines.
    strength : tuple of str
        Keys that are varied together, the first that is given, to find how much of the element is critical.
    """

    is_series: bool
    needed: tuple[str, ...]
    optional: tuple[str, ...]
    build: Callable[[Element, Place], Sequence[Branch | Line]]
    strength: tuple[str, ...]


_LINE_KEYS = ("x_ohm_per_km", "l_mh_per_km", "c_nf_per_km", "g_us_per_km", "model", "sections")

KINDS: dict[str, Kind] = {
    "series": Kind(True, (), ("r_ohm", "x_ohm", "l_mh"), _series, ("x_ohm", "l_mh")),
    "source": Kind(True, (), ("s_sc_mva", "scr", "r_over_x", "x_over_r"), _source, ("scr", "s_sc_mva")),
    "series_capacitor": Kind(
        True,
        (),
        ("compensation_percent", "x_ohm", "c_uf", "r_ohm"),
        _series_capacitor,
        ("compensation_percent", "x_ohm"),
    ),
    "line": Kind(True, ("r_ohm_per_km", "length_km"), _LINE_KEYS, _cable, ("length_km",)),
    "cable": Kind(True, ("r_ohm_per_km", "length_km", "c_nf_per_km"), _LINE_KEYS, _cable, ("length_km",)),
    "transformer": Kind(
        True,
        ("sn_mva", "vn_hv_kv", "vn_lv_kv", "vk_percent"),
        ("vkr_percent", "tap_percent"),
        _transformer,
        ("vk_percent",),
    ),
    "shunt_capacitor": Kind(False, (), ("q_mvar", "c_uf", "r_ohm"), _shunt_capacitor, ("q_mvar", "c_uf")),
    "shunt_reactor": Kind(False, (), ("q_mvar", "x_ohm", "l_mh", "r_ohm"), _shunt_reactor, ("q_mvar", "x_ohm", "l_mh")),
    "load": Kind(False, ("p_mw",), ("q_mvar",), _load, ("p_mw",)),
    "filter": Kind(False, ("tuned_hz",), ("q_mvar", "c_uf", "quality", "type"), _filter, ("q_mvar", "c_uf")),
}
"""Every kind of element by its name in the document."""
