"""Networks of pandapower, read and written as JSON with the ``json`` module alone.

A pandapower file is one JSON object whose tables are texts of JSON again, in the orientation "split" of pandas. Read
are buses, lines, two-winding transformers, shunts, impedances, loads, static generators, generators, one external grid
and switches; anything else that is in service is refused by name, for the network would be another one without it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import pi
from typing import Any

from .document import entries_of
from .entries import FarmError
from .network_parts import Network, Part, load_parts, shunt_parts

REFUSED = (
    "trafo3w", "dcline", "ward", "xward", "motor", "storage", "asymmetric_load", "asymmetric_sgen", "tcsc", "svc",
    "ssc", "vsc", "line_dc", "bus_dc", "vsc_stacked", "vsc_bipolar",
)  # fmt: skip
"""Tables that are no part of a farm file; empty ones, and what is out of service, do no harm."""

Row = Mapping[str, Any]


def is_pandapower(text: str) -> bool:
    """Whether a text is a network of pandapower."""
    return '"pandapowerNet"' in text[:4000] or '"pandapowerNet"' in text[-4000:]


def from_pandapower(text: str, table: str, s_sc_mva: float | None = None) -> Network:
    """A pandapower network as the parts of a farm file.

    Parameters
    ----------
    text : str
        The JSON file.
    table : str
        File of the admittance that every generator gets.
    s_sc_mva : float, optional
        Short-circuit power of the external grid where the file has none.

    Raises
    ------
    FarmError
        If it is no network, or holds what a farm file cannot say.
    """
    net = _tables(text)
    _refuse_others(net)
    net = _switched(net)
    parts = Network(str(net.get("name") or "imported from pandapower"), float(net.get("f_hz") or 50.0))
    names = _bus_names(net)
    for index, row in _rows(net, "bus"):
        if names[index] not in parts.voltages:
            parts.bus(names[index], float(row["vn_kv"]))
    for index, row in _rows(net, "line"):
        parts.add("line", _line(row, _name(row, "line", index), names))
    for index, row in _rows(net, "trafo"):
        parts.add("transformer", _transformer(row, _name(row, "trafo", index), names, parts))
    for index, row in _rows(net, "impedance"):
        parts.add(*_impedance(row, _name(row, "impedance", index), names, parts))
    _shunts_and_loads(net, parts, names)
    _source(net, parts, names, s_sc_mva)
    _generators(net, parts, names, table)
    return parts


# Reading the tables --------------------------------------------------------------------------------------------------


def _tables(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
        objects = content["_object"] if isinstance(content, dict) else None
        net = json.loads(objects) if isinstance(objects, str) else objects
    except (ValueError, KeyError) as error:
        raise FarmError(f"this is no network of pandapower: {error}") from None
    if not isinstance(net, dict) or "bus" not in net:
        raise FarmError("this is no network of pandapower: there is no table of buses; write one with pp.to_json")
    return {key: _table(value) for key, value in net.items()}


def _table(value: Any) -> Any:
    """A pandas table as rows by index; anything else as it is."""
    if not isinstance(value, Mapping) or value.get("_class") != "DataFrame":
        return value
    content = value["_object"]
    frame = json.loads(content) if isinstance(content, str) else content
    if not {"columns", "index", "data"} <= set(frame):
        raise FarmError("a table of this network is not in the orientation 'split'; write it again with pp.to_json")
    rows = (dict(zip(frame["columns"], row, strict=True)) for row in frame["data"])
    return dict(zip(frame["index"], rows, strict=True))


def _rows(net: Mapping[str, Any], name: str) -> Iterator[tuple[Any, Row]]:
    """Rows in service of a table, with their index."""
    table = net.get(name)
    if isinstance(table, dict):
        yield from ((index, row) for index, row in table.items() if row.get("in_service") in (True, None, 1))


def _refuse_others(net: Mapping[str, Any]) -> None:
    for name in REFUSED:
        if rows := list(_rows(net, name)):
            raise FarmError(
                f"the network holds {len(rows)} of {name}, which a farm file cannot say: replace them by lines, "
                "transformers, shunts and generators, or take them out of service"
            )


def _switched(net: dict[str, Any]) -> dict[str, Any]:
    """Closed switches between buses join them; an open one takes a transformer out, and opens a line at its end."""
    switches = list(_rows(net, "switch"))
    joined: dict[Any, Any] = {}
    for _, row in switches:
        if row["et"] == "b" and row.get("closed", True):
            a, b = _root(joined, row["bus"]), _root(joined, row["element"])
            joined[max(a, b)] = min(a, b) if a != b else joined.get(a, a)
        elif row["et"] == "t" and not row.get("closed", True):
            net["trafo"][row["element"]]["in_service"] = False
    _open_ends(net, [row for _, row in switches if row["et"] == "l" and not row.get("closed", True)])
    return {**net, "joined": joined}


def _open_ends(net: dict[str, Any], switches: Sequence[Row]) -> None:
    """A line that is open at one end hangs at the other and charges it; open at both it is out of service."""
    for row in switches:
        line = net["line"][row["element"]]
        if line.get("opened"):
            line["in_service"] = False
            continue
        end = "from_bus" if line["from_bus"] == row["bus"] else "to_bus"
        bus = max(net["bus"]) + 1
        net["bus"][bus] = {
            "name": f"{_name(line, 'line', row['element'])}.open",
            "vn_kv": net["bus"][row["bus"]]["vn_kv"],
        }
        line |= {end: bus, "opened": True}


def _root(joined: Mapping[Any, Any], bus: Any) -> Any:
    while joined.get(bus, bus) != bus:
        bus = joined[bus]
    return bus


def _bus_names(net: Mapping[str, Any]) -> dict[Any, str]:
    """A name of its own for every bus; joined buses share one."""
    given = {index: str(row.get("name") or f"bus{index}") for index, row in net["bus"].items()}
    twice = {name for name in given.values() if list(given.values()).count(name) > 1}
    own = {index: f"{name}_{index}" if name in twice else name for index, name in given.items()}
    return {index: own[_root(net["joined"], index)] for index in own}


def _name(row: Row, kind: str, index: Any) -> str:
    return str(row.get("name") or f"{kind}{index}")


def _number(row: Row, key: str, otherwise: float = 0.0) -> float:
    value = row.get(key)
    return otherwise if value is None or value != value else float(value)


# The parts -----------------------------------------------------------------------------------------------------------


def _line(row: Row, name: str, names: Mapping[Any, str]) -> Part:
    part: Part = {
        "name": name,
        "from": names[row["from_bus"]],
        "to": names[row["to_bus"]],
        "length_km": float(row["length_km"]),
        "r_ohm_per_km": float(row["r_ohm_per_km"]),
        "x_ohm_per_km": float(row["x_ohm_per_km"]),
        "c_nf_per_km": _number(row, "c_nf_per_km"),
    }
    if _number(row, "g_us_per_km"):
        part["g_us_per_km"] = _number(row, "g_us_per_km")
    return _with_parallel(part, row)


def _with_parallel(part: Part, row: Row) -> Part:
    n = int(_number(row, "parallel", 1.0))
    return {**part, "parallel": n} if n > 1 else part


def _transformer(row: Row, name: str, names: Mapping[Any, str], parts: Network) -> Part:
    if _number(row, "i0_percent") or _number(row, "pfe_kw"):
        parts.remark("the magnetising current and the iron loss of transformers are left out")
    if _number(row, "tap_step_degree") and _number(row, "tap_pos") != _number(row, "tap_neutral"):
        raise FarmError(f"{name}: a tap that shifts the phase; a farm file knows taps of the ratio")
    part: Part = {
        "name": name,
        "from": names[row["lv_bus"]],
        "to": names[row["hv_bus"]],
        **{key: float(row[key]) for key in ("sn_mva", "vn_hv_kv", "vn_lv_kv", "vk_percent")},
        "vkr_percent": _number(row, "vkr_percent"),
    }
    tap = (_number(row, "tap_pos") - _number(row, "tap_neutral")) * _number(row, "tap_step_percent")
    if tap and row.get("tap_side") == "lv":
        part["vn_lv_kv"] *= 1.0 + tap / 100.0
    elif tap:
        part["tap_percent"] = tap
    return _with_parallel(part, row)


def _impedance(row: Row, name: str, names: Mapping[Any, str], parts: Network) -> tuple[str, Part]:
    a = names[row["from_bus"]]
    base = parts.voltages[a] ** 2 / float(row["sn_mva"])
    if (
        abs(_number(row, "rft_pu") - _number(row, "rtf_pu")) + abs(_number(row, "xft_pu") - _number(row, "xtf_pu"))
        > 1e-12
    ):
        raise FarmError(
            f"{name}: an impedance that is not the same in both directions; a farm file knows no such thing"
        )
    r, x = _number(row, "rft_pu") * base, _number(row, "xft_pu") * base
    ends = {"name": name, "from": a, "to": names[row["to_bus"]]}
    return (
        ("series_capacitor", {**ends, "x_ohm": -x, "r_ohm": r})
        if x < 0.0
        else ("series", {**ends, "r_ohm": r, "x_ohm": x})
    )


def _shunts_and_loads(net: Mapping[str, Any], parts: Network, names: Mapping[Any, str]) -> None:
    for index, row in _rows(net, "shunt"):
        bus = names[row["bus"]]
        scale = _number(row, "step", 1.0) * (parts.voltages[bus] / _number(row, "vn_kv", parts.voltages[bus])) ** 2
        name = _name(row, "shunt", index)
        for part in shunt_parts(name, bus, scale * _number(row, "p_mw"), scale * _number(row, "q_mvar")):
            parts.add("shunt", part)
    for index, row in _rows(net, "load"):
        scale = _number(row, "scaling", 1.0)
        p, q = scale * _number(row, "p_mw"), scale * _number(row, "q_mvar")
        if _number(row, "const_z_p_percent", _number(row, "const_z_percent")) < 100.0:
            parts.remark("loads of constant power have become impedances that draw it at the rated voltage")
        for part in load_parts(_name(row, "load", index), names[row["bus"]], p, q):
            parts.add("shunt", part)


def _source(net: Mapping[str, Any], parts: Network, names: Mapping[Any, str], s_sc_mva: float | None) -> None:
    rows = list(_rows(net, "ext_grid"))
    if len(rows) != 1:
        raise FarmError(f"{len(rows)} external grids are in service; needed is exactly one")
    (row,) = (one for _, one in rows)
    bus = names[row["bus"]]
    if parts.source_behind_series(bus, _number(row, "vm_pu", 1.0)):
        return
    power = s_sc_mva or _number(row, "s_sc_max_mva")
    if not power > 0.0:
        raise FarmError("the external grid has no short-circuit power (s_sc_max_mva); give it, --s-sc-mva")
    name = str(row.get("name") or "source")
    source = {"name": name, "bus": bus, "voltage_pu": _number(row, "vm_pu", 1.0), "s_sc_mva": power}
    parts.add("source", {**source, "r_over_x": _number(row, "rx_max", 0.1)})
    parts.remark(
        "the load flow of pandapower holds the voltage at the external grid's bus; here it is held behind its Z"
    )


def _generators(net: Mapping[str, Any], parts: Network, names: Mapping[Any, str], table: str) -> None:
    for kind in ("sgen", "gen"):
        for index, row in _rows(net, kind):
            scale = _number(row, "scaling", 1.0)
            if kind == "gen":
                parts.remark("generators that hold a voltage have become devices without reactive power")
            name, bus = _name(row, kind, index), names[row["bus"]]
            parts.device(name, bus, table, scale * _number(row, "p_mw"), scale * _number(row, "q_mvar"))


# Writing -------------------------------------------------------------------------------------------------------------

_DTYPES = {int: "uint32", float: "float64", bool: "bool", str: "object"}


def to_pandapower(document: Mapping[str, Any], powers_mva: Mapping[str, complex]) -> str:
    """A farm as a pandapower network; the source's impedance is a branch, as pandapower's external grid has none.

    Parameters
    ----------
    document : mapping
        The farm, see `document`.
    powers_mva : mapping of str to complex
        What every device gives at its terminals, P + j Q.
    """
    powers_mva = {name: complex(power) for name, power in powers_mva.items()}
    f1_hz = float(document.get("f1_hz", 50.0))
    tables = _Tables(document)
    for section in ("line", "cable"):
        for k, entry in enumerate(entries_of(document, section), start=1):
            tables.rows("line", _line_row(entry, section, k, tables, f1_hz))
    for k, entry in enumerate(entries_of(document, "transformer"), start=1):
        tables.rows("trafo", _trafo_row(entry, k, tables))
    for section in ("series", "series_capacitor"):
        for k, entry in enumerate(entries_of(document, section), start=1):
            tables.rows("impedance", _series_row(entry, section, k, tables, f1_hz))
    for k, entry in enumerate(entries_of(document, "shunt"), start=1):
        tables.rows("shunt", _shunt_row(entry, k, tables, f1_hz))
    tables.source(f1_hz)
    for k, entry in enumerate(entries_of(document, "device"), start=1):
        tables.rows("sgen", _sgen_row(entry, k, tables, powers_mva))
    return tables.text(str(document.get("name", "farm")), f1_hz)


class _Tables:
    """Tables of a network that is being written."""

    def __init__(self, document: Mapping[str, Any]):
        self.document = document
        self.kv = {str(entry["name"]): float(entry["voltage_kv"]) for entry in entries_of(document, "bus")}
        self.number = {name: k for k, name in enumerate(self.kv)}
        bus = [{"name": name, "vn_kv": kv, "type": "b", "in_service": True} for name, kv in self.kv.items()]
        self.tables: dict[str, list[dict[str, Any]]] = {"bus": bus}

    def rows(self, name: str, row: dict[str, Any]) -> None:
        self.tables.setdefault(name, []).append(row)

    def source(self, f1_hz: float) -> None:
        """The ideal source on a bus of its own, its impedance from there on."""
        from .document import source_impedance

        (entry,) = entries_of(self.document, "source")
        bus, name = str(entry["bus"]), str(entry.get("name", "source"))
        z = source_impedance(entry, name, self.kv[bus] * 1e3)
        ideal = len(self.tables["bus"])
        self.rows("bus", {"name": f"{name}.ideal", "vn_kv": self.kv[bus], "type": "b", "in_service": True})
        self.rows("impedance", _impedance_row(f"{name}.impedance", ideal, self.number[bus], z, self.kv[bus]))
        voltage = float(entry.get("voltage_pu", 1.0))
        self.rows(
            "ext_grid",
            {"name": name, "bus": ideal, "vm_pu": voltage, "va_degree": 0.0, "slack_weight": 1.0, "in_service": True},
        )

    def text(self, name: str, f1_hz: float) -> str:
        tables = {key: _frame(rows) for key, rows in self.tables.items()}
        content = {**tables, "version": "3.1.0", "format_version": "3.1.0", "converged": False, "name": name}
        content |= {"f_hz": f1_hz, "sn_mva": 1.0, "std_types": {"line": {}, "trafo": {}, "trafo3w": {}}}
        whole = {"_module": "pandapower.auxiliary", "_class": "pandapowerNet", "_object": content}
        return json.dumps(whole, indent=1)


def _frame(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    columns = list(rows[0])
    data = {
        "columns": columns,
        "index": list(range(len(rows))),
        "data": [[row[key] for key in columns] for row in rows],
    }
    dtype = {key: _DTYPES[type(rows[0][key])] for key in columns}
    return {
        "_module": "pandas.core.frame",
        "_class": "DataFrame",
        "_object": json.dumps(data),
        "orient": "split",
        "dtype": dtype,
        "is_multiindex": False,
        "is_multicolumn": False,
    }


def _named(entry: Row, section: str, k: int) -> dict[str, Any]:
    return {"name": str(entry.get("name", f"{section}{k}")), "in_service": bool(entry.get("in_service", True))}


def _line_row(entry: Row, section: str, k: int, tables: _Tables, f1_hz: float) -> dict[str, Any]:
    x = entry.get("x_ohm_per_km", 2.0 * pi * f1_hz * 1e-3 * float(entry.get("l_mh_per_km", 0.0)))
    return {
        **_named(entry, section, k),
        "std_type": "",
        "from_bus": tables.number[entry["from"]],
        "to_bus": tables.number[entry["to"]],
        "length_km": float(entry["length_km"]),
        "r_ohm_per_km": float(entry["r_ohm_per_km"]),
        "x_ohm_per_km": float(x),
        "c_nf_per_km": float(entry.get("c_nf_per_km", 0.0)),
        "g_us_per_km": float(entry.get("g_us_per_km", 0.0)),
        "max_i_ka": 1.0,
        "df": 1.0,
        "parallel": int(entry.get("parallel", 1)),
        "type": "cs",
    }


def _trafo_row(entry: Row, k: int, tables: _Tables) -> dict[str, Any]:
    low, high = sorted((entry["from"], entry["to"]), key=lambda bus: tables.kv[bus])
    tap = float(entry.get("tap_percent", 0.0))
    return {
        **_named(entry, "transformer", k),
        "std_type": "",
        "hv_bus": tables.number[high],
        "lv_bus": tables.number[low],
        **{key: float(entry[key]) for key in ("sn_mva", "vn_hv_kv", "vn_lv_kv", "vk_percent")},
        "vkr_percent": float(entry.get("vkr_percent", 0.0)),
        **{"pfe_kw": 0.0, "i0_percent": 0.0, "shift_degree": 0.0, "tap_side": "hv", "tap_neutral": 0.0},
        **{"tap_min": -1.0, "tap_max": 1.0, "tap_step_percent": abs(tap), "tap_step_degree": 0.0},
        "tap_pos": float((tap > 0.0) - (tap < 0.0)),
        **{"tap_changer_type": "Ratio", "parallel": int(entry.get("parallel", 1)), "df": 1.0},
    }


def _series_row(entry: Row, section: str, k: int, tables: _Tables, f1_hz: float) -> dict[str, Any]:
    named = _named(entry, section, k)
    w1, bus = 2.0 * pi * f1_hz, str(entry["from"])
    if section == "series":
        x = float(entry.get("x_ohm", w1 * 1e-3 * float(entry.get("l_mh", 0.0))))
    elif "compensation_percent" in entry:
        raise FarmError(f"{named['name']}: compensation in per cent has no counterpart in pandapower; give x_ohm")
    else:
        x = -float(entry["x_ohm"]) if "x_ohm" in entry else -1.0 / (w1 * float(entry["c_uf"]) * 1e-6)
    z = complex(float(entry.get("r_ohm", 0.0)), x) / int(entry.get("parallel", 1))
    row = _impedance_row(named["name"], tables.number[bus], tables.number[entry["to"]], z, tables.kv[bus])
    return {**row, "in_service": named["in_service"]}


def _impedance_row(name: str, a: int, b: int, z_ohm: complex, kv: float) -> dict[str, Any]:
    z = z_ohm / kv**2
    both = {"rft_pu": z.real, "xft_pu": z.imag, "rtf_pu": z.real, "xtf_pu": z.imag}
    none = {"gf_pu": 0.0, "bf_pu": 0.0, "gt_pu": 0.0, "bt_pu": 0.0}
    return {"name": name, "from_bus": a, "to_bus": b, **both, **none, "sn_mva": 1.0, "in_service": True}


def _shunt_row(entry: Row, k: int, tables: _Tables, f1_hz: float) -> dict[str, Any]:
    from .network_parts import shunt_power

    named, bus = _named(entry, "shunt", k), str(entry["bus"])
    p, q = shunt_power(entry, tables.kv[bus], f1_hz)
    return {
        **named,
        "bus": tables.number[bus],
        "q_mvar": q,
        "p_mw": p,
        "vn_kv": tables.kv[bus],
        "step": 1,
        "max_step": 1,
    }


def _sgen_row(entry: Row, k: int, tables: _Tables, powers_mva: Mapping[str, complex]) -> dict[str, Any]:
    named = _named(entry, "device", k)
    power = powers_mva.get(named["name"], 0j)
    row = {"bus": tables.number[entry["bus"]], "p_mw": power.real, "q_mvar": power.imag, "sn_mva": abs(power)}
    return {**named, **row, "scaling": 1.0, "type": "", "current_source": True}
