"""Case files of MATPOWER (``.m``): matrices of numbers, per unit at the fundamental."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import hypot, pi
from typing import Any

from .document import entries_of, source_impedance
from .entries import FarmError
from .network_parts import Network, Part, load_parts, shunt_parts, shunt_power

_MATRIX = r"mpc\.{name}\s*=\s*\[(.*?)\]\s*;?"
_LEAST = {"bus": 10, "gen": 8, "branch": 11}
"""Columns that a row of each matrix must have."""

_USUAL_VK = 0.1  # per unit

Row = list[float]


def is_matpower(text: str) -> bool:
    """Whether a text is a case file of MATPOWER."""
    return re.search(r"mpc\.bus\s*=", text) is not None


def from_matpower(text: str, table: str, s_sc_mva: float | None = None, f1_hz: float = 50.0) -> Network:
    """A MATPOWER case as the parts of a farm file.

    Parameters
    ----------
    text : str
        The case file, version 2.
    table : str
        File of the admittance that every generator gets, but for those of the reference bus.
    s_sc_mva : float, optional
        Short-circuit power of the source at the reference bus, which a case file does not hold.
    f1_hz : float
        Fundamental (Hz), which it does not hold either.

    Raises
    ------
    FarmError
        If it is no case file, or holds what a farm file cannot say.
    """
    code = re.sub(r"%[^\n]*", "", text)
    base = _scalar(code, "baseMVA")
    buses = {int(row[0]): row for row in _matrix(code, "bus")}
    name = re.search(r"function\s+mpc\s*=\s*(\w+)", code)
    parts = Network(name[1] if name else "imported from MATPOWER", f1_hz)
    for number, row in buses.items():
        if not row[9] > 0.0:
            raise FarmError(f"bus {number} has no rated voltage (baseKV = {row[9]:g}); a farm file needs it in kV")
        parts.bus(f"bus{number}", row[9])
    for k, row in enumerate(_matrix(code, "branch"), start=1):
        if row[10] > 0.0:
            parts.add(*_branch(row, k, base, buses, parts, f1_hz))
    for number, row in buses.items():
        _at_bus(row, f"bus{number}", parts)
    slack = _source(buses, _matrix(code, "gen"), parts, s_sc_mva)
    for k, row in enumerate(_matrix(code, "gen"), start=1):
        if row[7] > 0.0 and int(row[0]) != slack:
            parts.device(f"gen{k}", f"bus{int(row[0])}", table, row[1], row[2])
    return parts


def _scalar(code: str, name: str) -> float:
    found = re.search(rf"mpc\.{name}\s*=\s*([-+.\deE]+)", code)
    if not found:
        raise FarmError(f"this is no case file of MATPOWER: it does not set mpc.{name}")
    return float(found[1])


def _matrix(code: str, name: str) -> list[Row]:
    found = re.search(_MATRIX.format(name=name), code, re.DOTALL)
    if not found:
        raise FarmError(f"this is no case file of MATPOWER, version 2: it does not set mpc.{name}")
    rows = []
    for line in re.split(r"[;\n]", found[1].replace("...\n", " ")):
        words = line.replace(",", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise FarmError(f"mpc.{name}: {line.strip()!r} is no row of numbers") from None
        if len(words) < _LEAST[name]:
            raise FarmError(f"mpc.{name}: a row of {len(words)} numbers; needed are at least {_LEAST[name]}")
    return rows


def _branch(row: Row, k: int, base: float, buses: Mapping[int, Row], parts: Network, f1_hz: float) -> tuple[str, Part]:
    a, b = int(row[0]), int(row[1])
    for bus in (a, b):
        if bus not in buses:
            raise FarmError(f"branch {k} ends at bus {bus}, which mpc.bus does not hold")
    r, x, charging, ratio, shift = row[2], row[3], row[4], row[8], row[9]
    if shift:
        parts.remark("phase shifts of transformers are left out: in a radial network they cancel")
    kv_a, kv_b = buses[a][9], buses[b][9]
    ends = {"name": f"branch{k}", "from": f"bus{a}", "to": f"bus{b}"}
    if ratio or abs(kv_a - kv_b) > 0.05 * kv_a:
        if charging:
            parts.remark("the charging of transformers is left out")
        return "transformer", _transformer(ends, r, x, base, kv_a * (ratio or 1.0), kv_b)
    z = kv_a**2 / base
    if x < 0.0:
        return "series_capacitor", {**ends, "x_ohm": -x * z, "r_ohm": r * z}
    if charging == 0.0:
        return "series", {**ends, "r_ohm": r * z, "x_ohm": x * z}
    c_nf = charging / z / (2.0 * pi * f1_hz) * 1e9
    line = {"length_km": 1.0, "r_ohm_per_km": r * z, "x_ohm_per_km": x * z, "c_nf_per_km": c_nf}
    return "line", {**ends, **line}


def _transformer(ends: Part, r: float, x: float, base: float, kv_from: float, kv_to: float) -> Part:
    """The tap is at the "from" end; a case file has no rating, and the one with the usual impedance is taken."""
    if not x > 0.0:
        raise FarmError(f"{ends['name']}: a transformer with x = {x:g}; needed is a number above 0")
    low_first = kv_from <= kv_to
    kv = {"vn_lv_kv": kv_from if low_first else kv_to, "vn_hv_kv": kv_to if low_first else kv_from}
    rating = base * _USUAL_VK / hypot(r, x)
    return {**ends, "sn_mva": rating, **kv, "vk_percent": 100.0 * _USUAL_VK, "vkr_percent": 100.0 * r * rating / base}


def _at_bus(row: Row, bus: str, parts: Network) -> None:
    if row[2] < 0.0:
        raise FarmError(f"{bus}: a load of {row[2]:g} MW generates; make it a generator")
    if row[2] or row[3]:
        parts.remark("loads of constant power have become impedances that draw it at the rated voltage")
    for name, p, q in ((f"load {bus}", row[2], row[3]), (f"shunt {bus}", row[4], -row[5])):
        for part in load_parts(name, bus, p, q) if name.startswith("load") else shunt_parts(name, bus, p, q):
            parts.add("shunt", part)


def _source(buses: Mapping[int, Row], gens: list[Row], parts: Network, s_sc_mva: float | None) -> int:
    """The source at the reference bus; the number of that bus."""
    slack = [number for number, row in buses.items() if int(row[1]) == 3]
    if len(slack) != 1:
        raise FarmError(f"{len(slack)} reference buses (type 3); needed is exactly one")
    number = slack[0]
    voltage = next((row[5] for row in gens if int(row[0]) == number and row[7] > 0.0), buses[number][7])
    if parts.source_behind_series(f"bus{number}", voltage):
        return number
    if s_sc_mva is None:
        raise FarmError("a case file holds no short-circuit power of its source; give it, --s-sc-mva")
    parts.add("source", {"name": "source", "bus": f"bus{number}", "voltage_pu": voltage, "s_sc_mva": s_sc_mva})
    parts.remark("MATPOWER holds the voltage at the reference bus; here it is held behind the source's impedance")
    return number


# Writing -------------------------------------------------------------------------------------------------------------


def to_matpower(document: Mapping[str, Any], powers_mva: Mapping[str, complex]) -> str:
    """A farm as a case file; the source is a reference bus of its own behind the source's impedance.

    Parameters
    ----------
    document : mapping
        The farm, see `document`; cables become one pi section.
    powers_mva : mapping of str to complex
        What every device gives at its terminals, P + j Q.
    """
    powers_mva = {name: complex(power) for name, power in powers_mva.items()}
    base, f1_hz = 100.0, float(document.get("f1_hz", 50.0))
    kv = {str(entry["name"]): float(entry["voltage_kv"]) for entry in entries_of(document, "bus")}
    number = {name: k for k, name in enumerate(kv, start=1)}
    shunts = dict.fromkeys(kv, 0j)
    for entry in _in_service(document, "shunt"):
        shunts[str(entry["bus"])] += complex(*shunt_power(entry, kv[entry["bus"]], f1_hz))
    (source,) = entries_of(document, "source")
    ideal, voltage = len(kv) + 1, float(source.get("voltage_pu", 1.0))
    buses = [[number[n], 1, 0, 0, shunts[n].real, -shunts[n].imag, 1, 1, 0, kv[n], 1, 1.5, 0.5] for n in kv]
    buses.append([ideal, 3, 0, 0, 0, 0, 1, voltage, 0, kv[source["bus"]], 1, 1.5, 0.5])
    z = source_impedance(source, "source", kv[source["bus"]] * 1e3) / kv[source["bus"]] ** 2 * base
    branches = [[ideal, number[source["bus"]], z.real, z.imag, *[0] * 6, 1, -360, 360]]
    branches += [row for section in ("line", "cable", "series", "series_capacitor", "transformer")
                 for entry in _in_service(document, section)
                 for row in [_branch_row(entry, section, number, kv, base, 2.0 * pi * f1_hz)]]  # fmt: skip
    gens = [[ideal, 0, 0, 999, -999, voltage, base, 1, 999, -999]]
    for k, entry in enumerate(entries_of(document, "device"), start=1):
        power = powers_mva.get(str(entry.get("name", f"device{k}")), 0j)
        if entry.get("in_service", True):
            gens.append([number[entry["bus"]], power.real, power.imag, 999, -999, 1, base, 1, 999, -999])
    word = re.sub(r"\W", "_", str(document.get("name", "farm")))
    head = [f"function mpc = {word}", f"% buses: {', '.join(f'{k} {name}' for name, k in number.items())}"]
    head += ["mpc.version = '2';", f"mpc.baseMVA = {base!r};"]
    return "\n".join([*head, *(_written(*pair) for pair in (("bus", buses), ("gen", gens), ("branch", branches)))])


def _in_service(document: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    return [entry for entry in entries_of(document, section) if entry.get("in_service", True)]


def _branch_row(
    entry: Mapping[str, Any], section: str, number: Mapping[str, int], kv: Mapping[str, float], base: float, w1: float
) -> list[Any]:
    a, b, n = str(entry["from"]), str(entry["to"]), int(entry.get("parallel", 1))
    charging, ratio = 0.0, 0.0
    if section == "transformer":
        low, high = sorted((a, b), key=kv.__getitem__)
        share = base / (float(entry["sn_mva"]) * n)
        vk, vkr = float(entry["vk_percent"]) / 100.0, float(entry.get("vkr_percent", 0.0)) / 100.0
        on_low = (float(entry["vn_lv_kv"]) / kv[low]) ** 2 * share
        z = complex(vkr, (vk**2 - vkr**2) ** 0.5) * on_low
        tapped = float(entry["vn_hv_kv"]) * (1.0 + float(entry.get("tap_percent", 0.0)) / 100.0) / kv[high]
        a, b, ratio = high, low, tapped * kv[low] / float(entry["vn_lv_kv"])
    elif section in ("line", "cable"):
        length = float(entry["length_km"])
        x = float(entry["x_ohm_per_km"]) if "x_ohm_per_km" in entry else w1 * 1e-3 * float(entry["l_mh_per_km"])
        z = complex(float(entry["r_ohm_per_km"]), x) * length / n * base / kv[a] ** 2
        charging = w1 * float(entry.get("c_nf_per_km", 0.0)) * 1e-9 * length * n * kv[a] ** 2 / base
    else:
        x = _series_x(entry, section, w1)
        z = complex(float(entry.get("r_ohm", 0.0)), x) / n * base / kv[a] ** 2
    return [number[a], number[b], z.real, z.imag, charging, 0, 0, 0, ratio, 0, 1, -360, 360]


def _series_x(entry: Mapping[str, Any], section: str, w1: float) -> float:
    if section == "series":
        return float(entry.get("x_ohm", w1 * 1e-3 * float(entry.get("l_mh", 0.0))))
    if "compensation_percent" in entry:
        raise FarmError(f"{entry.get('name', section)}: compensation in per cent has no counterpart; give x_ohm")
    return -float(entry["x_ohm"]) if "x_ohm" in entry else -1.0 / (w1 * float(entry["c_uf"]) * 1e-6)


def _written(name: str, rows: list[list[Any]]) -> str:
    lines = [
        "\t" + "\t".join(repr(float(value)) if isinstance(value, float) else str(value) for value in row) + ";"
        for row in rows
    ]
    return "\n".join([f"mpc.{name} = [", *lines, "];"])
