"""A campaign drafted from what a real-code controller says of itself: its ports, their units, its parameters.

What a port is follows from its name and unit, as far as these speak; every guess stands in the draft, to be read before
it is run. `python -m seqsweep.plant.controllers.draft FILE` prints it, in a process that may die of the library.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .cigre_abi import CigreError, Library, ModelInfo, Parameter, Port

_GUESS = "guessed from name and unit"


class Rating(NamedTuple):
    """What the draft takes as the device's rating, and whether the controller says so."""

    voltage_v: float
    power_va: float
    f1_hz: float
    v_dc_v: float


def draft(info: ModelInfo, where: str) -> str:
    """The campaign as TOML; ``where`` is the file as the campaign names it."""
    rating = _rating(info.parameters)
    return "\n".join([*_head(info, where), *_circuit(rating), *_ports(info, rating), *_settings(info), *_rest(rating)])


def _head(info: ModelInfo, where: str) -> Iterator[str]:
    yield f"# {info.name} {info.version}: {info.description}".rstrip(": ")
    yield "# Drafted by seqsweep init from what the controller says of itself. READ IT: circuit, ratings and every line"
    yield "# marked 'guessed' are yours to confirm; then seqsweep check and seqsweep run."
    yield ""
    yield "[campaign]"
    yield f"name = {json.dumps(info.name)}"
    yield ""
    yield "[plant]"
    yield 'id = "inverter-grey-v1"'
    yield ""
    yield "[plant.parameters]"
    yield f"controller = {json.dumps('cigre:' + where)}"
    if not info.sample_time_s:
        yield "sample_time_s = 20e-6       # the controller leaves it open"
    yield "# believed_from_s = 2.0      # nothing counts as settled before: the controller's own start-up sequence"
    yield "# settle_tolerance = 1e-6    # for a controller in single precision"


def _circuit(rating: Rating) -> Iterator[str]:
    z, w = rating.voltage_v**2 / rating.power_va, 2.0 * 3.141592653589793 * rating.f1_hz
    yield f"u_rated_v = {rating.voltage_v:g}"
    yield f"s_rated_va = {rating.power_va:g}"
    yield f"f1_hz = {rating.f1_hz:g}"
    yield "# the circuit, guessed: choke 10 %, capacitor 4 %, transformer 5 %; replace it by the device's own"
    yield f"l_f_h = {0.10 * z / w:.4g}"
    yield f"r_f_ohm = {0.004 * z:.4g}"
    yield f"c_f_f = {0.04 / (z * w):.4g}"
    yield f"r_c_ohm = {0.08 * z:.4g}          # damps the filter; 0 where there is none"
    yield f"l_g_h = {0.05 * z / w:.4g}"
    yield f"r_g_ohm = {0.005 * z:.4g}"
    yield "c_dc_f = 1e9                # so large that v_dc is constant; r_dc_ohm > 0 makes it a battery"
    yield f"v_dc_ref_v = {rating.v_dc_v:g}"
    yield ""


def _ports(info: ModelInfo, rating: Rating) -> Iterator[str]:
    names = [port.name for port in info.inputs]
    yield "[plant.parameters.inputs]"
    for port in info.inputs:
        yield _line(port, told_as(port, names, rating))
    yield ""
    yield "[plant.parameters.outputs]"
    for port in info.outputs:
        entry = given_as(port)
        yield _line(port, entry) if entry else f"# {port.name}: not needed ({port.unit or 'no unit'})"
    yield ""


def _line(port: Port, entry: str) -> str:
    about = f"{port.description}, " if port.description else ""
    return f"{port.name} = {entry}    # {about}{port.unit or 'no unit'}; {_GUESS}"


def told_as(port: Port, names: Sequence[str], rating: Rating) -> str:
    """The signal of an input port, as TOML."""
    name, unit = port.name.lower(), _unit(port)
    if found := _three_phase(port, names):
        return found
    if "dc" in name and unit in ("V", "kV", "pu"):
        if any(word in name for word in ("mppt", "ref", "nom", "set")):
            return _constant(rating.v_dc_v, unit, rating.v_dc_v)
        return _signal("v_dc", unit, rating.v_dc_v)
    if "dc" in name:
        return _signal("i_dc", unit, rating.power_va / rating.v_dc_v)
    if "lim" in name and name[0] in "pq":
        sign = -1.0 if "low" in name or "min" in name else 1.0
        return _constant(sign * 1.2 * rating.power_va, unit, rating.power_va)
    if re.search(r"ref|request|set|cmd|command|order", name):
        quantity = {"p": "p_ref", "q": "q_ref", "v": "v_ref"}.get(name[0])
        if quantity:
            return _signal(quantity, unit, rating.voltage_v if quantity == "v_ref" else rating.power_va)
    if re.search(r"enable|run|start|close", name):
        return "{ value = 1 }"
    return "{ value = 0.0 }"


def given_as(port: Port) -> str:
    """The signal of an output port, as TOML; empty where the circuit does not need it."""
    name, unit = port.name.lower(), _unit(port)
    if re.search(r"gate|pwm.*enable|enable.*pwm|deblock", name):
        return '"gate"'
    if port.width == 3 and re.match(r"[vemu]", name):
        vector = "v_conv" if unit in ("V", "kV") else "m_conv"
        return f'"{vector}_abc"'
    phase = re.fullmatch(r"([emu])_?(?:conv_?)?([abc])", name)
    if phase:
        return f'"{"v_conv" if unit in ("V", "kV") else "m_conv"}_{phase.group(2)}"'
    return ""


def _three_phase(port: Port, names: Sequence[str]) -> str:
    """The entry of a port of three-phase voltage or current."""
    name, unit = port.name.lower(), _unit(port)
    if "dc" in name or name[0] not in "iv" or unit not in ("V", "kV", "A", "kA"):
        return ""
    part = "abc" if port.width == 3 else _phase_of(name)
    if not part:
        return ""
    if name[0] == "v":
        return f'"v_f_{part}"'
    return f'"{_side_of(name, names)}_{part}"'


def _phase_of(name: str) -> str:
    """a, b or c of names such as Vta, I1b, Ic, IaL1, v_a; empty where there is none."""
    found = re.fullmatch(r"[iv]_?(?:t|g|pcc|ac|f|l|s)?_?\d?_?([abc])(?:_?l?\d?)", name)
    return found.group(1) if found else ""


def _side_of(name: str, names: Sequence[str]) -> str:
    """Which side of the capacitor a current is measured at: 1 and L are the converter's, 2 and g the grid's."""
    if re.search(r"l\d?$|^i_?l|^i_?1", name):
        return "i_l"
    if re.search(r"^i_?2|^i_?g", name):
        return "i_g"
    others = [other.lower() for other in names if other.lower() != name]
    return "i_g" if any(re.match(r"i", other) and re.search(r"l\d?$|^i_?l", other) for other in others) else "i_l"


def _signal(name: str, unit: str, base: float) -> str:
    return f'{{ signal = "{name}", base = {base:g} }}' if unit == "pu" else f'"{name}"'


def _constant(value: float, unit: str, base: float) -> str:
    scale = {"kV": 1e3, "kA": 1e3, "kW": 1e3, "MW": 1e6, "kvar": 1e3, "Mvar": 1e6, "pu": base}.get(unit, 1.0)
    return f"{{ value = {value / scale:.6g} }}"


def _unit(port: Port) -> str:
    unit = port.unit.strip("[]() ")
    return {"p.u.": "pu", "p.u": "pu", "PU": "pu"}.get(unit, unit)


def _rating(parameters: Sequence[Parameter]) -> Rating:
    """What parameters that are named like ratings say, else a usual unit of 1 MVA."""
    voltage = _named(parameters, r"(u|v)_?(base|nom|rated|n)(_?ll)?$", {"kV": 1e3}, 690.0)
    power = _named(parameters, r"(s|mva)_?(base|nom|rated|n)?$|sbase|mvabase", {"MVA": 1e6, "kVA": 1e3}, 1e6)
    f1 = _named(parameters, r"f_?(1|n|nom|base|rated)$", {}, 50.0)
    v_dc = _named(parameters, r"(u|v)_?dc_?(nom|ref|base|rated)$", {"kV": 1e3}, round(2.0 * voltage, -2))
    return Rating(voltage, power, f1, v_dc)


def _named(parameters: Sequence[Parameter], pattern: str, scale: dict[str, float], otherwise: float) -> float:
    for parameter in parameters:
        number = isinstance(parameter.default, int | float) and parameter.default > 0
        if number and re.fullmatch(pattern, parameter.name.lower()):
            return float(parameter.default) * scale.get(parameter.unit, 1.0)
    return otherwise


def _settings(info: ModelInfo) -> Iterator[str]:
    yield "[plant.parameters.settings]   # parameters of the controller; its defaults stand in comments"
    for parameter in info.parameters:
        value: Any = parameter.default
        about = f"{parameter.description} ({parameter.unit or 'no unit'})".strip()
        yield f"# {parameter.name} = {json.dumps(value)}    # {about}"
    yield ""


def _rest(rating: Rating) -> Iterator[str]:
    x = rating.voltage_v**2 / rating.power_va / 5.0
    yield "[[operating_point]]"
    yield 'id = "p"'
    yield f"active_power_mw = {0.5 * rating.power_va / 1e6:g}"
    yield "reactive_power_mvar = 0.0"
    yield "terminal_voltage_pu = 1.0"
    yield ""
    yield "[sweep]"
    yield "f_min_hz = 1.0"
    yield "f_max_hz = 1000.0"
    yield "points = 60"
    yield ""
    yield "[source]"
    yield 'kind = "thevenin"           # a grid-forming device may be unstable on an ideal source'
    yield f"r_ohm = {0.1 * x:.4g}"
    yield f"x_ohm = {x:.4g}                # short-circuit ratio 5"
    yield f"# settle_on = {{ r_ohm = {0.2 * x:.4g}, x_ohm = {2.0 * x:.4g} }}    # where it cannot be started cold here"
    yield ""


def main() -> None:
    """Print the draft of a library; its complaint on stderr and status 2 where it is none."""
    try:
        path = Path(sys.argv[1])
        print(draft(Library(path).info, str(path)))
    except CigreError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
