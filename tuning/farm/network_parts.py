"""What importers of networks have in common: parts of a farm file, collected and written as TOML."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import pi
from typing import Any

from .document import SECTIONS
from .entries import FarmError

LEFT_TO_TABLES = (
    "reactive powers of generators are left out: a device takes what its table says at its power; --reactive keeps them"
)

Part = dict[str, Any]
"""One entry of a farm file."""


class Network:
    """A farm file that grows part by part.

    Attributes
    ----------
    voltages : dict of str to float
        Rated voltage of every bus (kV).
    remarks : list of str
        What a reader should know of the translation, each said once.
    reactive_mvar : dict of str to float
        Reactive powers of generators (Mvar).
    """

    def __init__(self, name: str, f1_hz: float):
        self._head: Part = {"name": name, "f1_hz": f1_hz}
        self._sections: dict[str, list[Part]] = {}
        self.voltages: dict[str, float] = {}
        self.remarks: list[str] = []
        self.reactive_mvar: dict[str, float] = {}

    def bus(self, name: str, kv: float) -> None:
        """Add a bus."""
        self.voltages[name] = kv
        self.add("bus", {"name": name, "voltage_kv": kv})

    def add(self, section: str, part: Part) -> None:
        """Add a part, under a name that no other part has."""
        taken = {entry["name"] for entries in self._sections.values() for entry in entries}
        name, k = part["name"], 2
        while name in taken:
            name, k = f"{part['name']} ({k})", k + 1
        self._sections.setdefault(section, []).append({**part, "name": name})

    def remark(self, text: str) -> None:
        """Say something once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def device(self, name: str, bus: str, table: str, p_mw: float, q_mvar: float) -> None:
        """Add a generator; its reactive power is kept beside it, for most tables have no set-point for it."""
        self.add("device", {"name": name, "bus": bus, "table": table, "active_power_mw": p_mw})
        if q_mvar:
            self.reactive_mvar[name] = q_mvar
            self.remark(LEFT_TO_TABLES)

    def keep_reactive(self) -> None:
        """Make the generators' reactive powers set-points of the devices."""
        self.remarks = [text for text in self.remarks if text != LEFT_TO_TABLES]
        for part in self._sections.get("device", []):
            if part["name"] in self.reactive_mvar:
                part["reactive_power_mvar"] = self.reactive_mvar[part["name"]]

    def source_behind_series(self, bus: str, voltage_pu: float) -> bool:
        """Make a source of a bus that has nothing but one series impedance, as an ideal source behind it has."""
        at_bus = [
            (s, e)
            for s in SECTIONS
            for e in self._sections.get(s, [])
            if bus in (e.get("from"), e.get("to"), e.get("bus"))
        ]
        if len(at_bus) != 1 or at_bus[0][0] != "series":
            return False
        entry = at_bus[0][1]
        self._sections["series"].remove(entry)
        self._sections["bus"] = [e for e in self._sections["bus"] if e["name"] != bus]
        other = entry["to"] if entry["from"] == bus else entry["from"]
        name = entry["name"].removesuffix(".impedance")
        source = {"name": name, "bus": other, "voltage_pu": voltage_pu * self.voltages[bus] / self.voltages[other]}
        self.add("source", {**source, "r_ohm": entry["r_ohm"], "x_ohm": entry["x_ohm"]})
        return True

    def document(self) -> dict[str, Any]:
        """The whole, as TOML would give it."""
        return {**self._head, **{key: self._sections[key] for key in SECTIONS if self._sections.get(key)}}


def shunt_parts(name: str, bus: str, p_mw: float, q_mvar: float) -> list[Part]:
    """A passive shunt that draws P + j Q at the rated voltage of its bus: resistor, reactor or capacitor."""
    parts: list[Part] = []
    if p_mw < 0.0:
        raise FarmError(f"{name}: a shunt that generates {-p_mw:g} MW is no passive one; make it a generator")
    if p_mw > 0.0:
        part = {"name": name, "bus": bus, "kind": "load", "p_mw": p_mw}
        parts.append({**part, "q_mvar": q_mvar} if q_mvar > 0.0 else part)
    if q_mvar < 0.0:
        parts.append(
            {"name": f"{name} capacitor" if p_mw else name, "bus": bus, "kind": "shunt_capacitor", "q_mvar": -q_mvar}
        )
    elif q_mvar > 0.0 and p_mw == 0.0:
        parts.append({"name": name, "bus": bus, "kind": "shunt_reactor", "q_mvar": q_mvar})
    return parts


load_parts = shunt_parts
"""A load is taken as the passive shunt that draws the same at the rated voltage."""


def shunt_power(entry: Mapping[str, Any], kv: float, f1_hz: float) -> tuple[float, float]:
    """P (MW) and Q (Mvar) that a shunt of a farm file draws at its bus's rated voltage, at the fundamental."""
    kind, w1 = entry.get("kind", "shunt_capacitor"), 2.0 * pi * f1_hz
    if kind == "load":
        return float(entry["p_mw"]), float(entry.get("q_mvar", 0.0))
    z = _shunt_impedance(entry, kind, kv, w1)
    power = kv**2 / z.conjugate()
    return power.real, power.imag


def _shunt_impedance(entry: Mapping[str, Any], kind: str, kv: float, w1: float) -> complex:
    r = float(entry.get("r_ohm", 0.0))
    if kind == "shunt_reactor":
        x = (
            kv**2 / float(entry["q_mvar"])
            if "q_mvar" in entry
            else float(entry.get("x_ohm", w1 * 1e-3 * float(entry.get("l_mh", 0.0))))
        )
        return complex(r, x)
    if kind == "shunt_capacitor":
        x = kv**2 / float(entry["q_mvar"]) if "q_mvar" in entry else 1.0 / (w1 * float(entry["c_uf"]) * 1e-6)
        return complex(r, -x)
    raise FarmError(
        f"{entry.get('name', kind)}: a filter has no counterpart in other tools' networks; give it as a capacitor"
    )


def farm_text(document: Mapping[str, Any], remarks: tuple[str, ...] = ()) -> str:
    """A farm document as TOML."""
    lines = [f"# {remark}" for remark in remarks]
    lines += [f"{key} = {_value(value)}" for key, value in document.items() if not isinstance(value, list)]
    for section, entries in document.items():
        for entry in entries if isinstance(entries, list) else []:
            lines += ["", f"[[{section}]]", *(f"{key} = {_value(value)}" for key, value in entry.items())]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_value(one)}" for key, one in value.items()) + " }"
    return json.dumps(value) if isinstance(value, str | bool | list) else repr(value)
