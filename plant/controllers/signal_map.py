"""Which port of a controller is what: the signal map of a campaign, checked before anything runs.

An entry names a signal and how the port tells it: ``{ signal = "v_pcc_abc", unit = "kV" }``,
``{ signal = "i_l_abc", unit = "pu", base = 1931.2, sign = -1 }``, ``{ value = 1200.0 }``. Signals and
their signs are those of `SIGNALS`; a port's number is ``sign * signal / unit``.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping, Sequence
from math import isfinite, pi
from typing import Any, NamedTuple

from ..errors import SeqsweepError, nearest

_DIRECTIONS = {
    "alpha": 1.0,
    "beta": 1j,
    "a": 1.0,
    "b": cmath.exp(2j * pi / 3.0),
    "c": cmath.exp(-2j * pi / 3.0),
    "ab": 1.0 - cmath.exp(2j * pi / 3.0),
    "bc": cmath.exp(2j * pi / 3.0) - cmath.exp(-2j * pi / 3.0),
    "ca": cmath.exp(-2j * pi / 3.0) - 1.0,
}
"""A component of a space vector x is Re(x conj(direction)): axes, phases, line-to-line."""

_GROUPS = {"abc": ("a", "b", "c"), "alphabeta": ("alpha", "beta"), "ll": ("ab", "bc", "ca")}
"""Names for several components at once."""

_LINE_TO_LINE = ("ll", "ab", "bc", "ca")

_VECTORS = {"v_pcc": ("V", "V_RE"), "v_f": ("V", "V_F_RE"), "i_l": ("A", "I_L_RE"), "i_g": ("A", "I_G_RE")}
"""Vectors that a controller may be told: dimension, and their quantity in the kernel."""

_SCALARS = {
    "v_dc": ("V", "V_DC"),
    "i_dc": ("A", "I_DC"),
    "p_pcc": ("W", "P_PCC"),
    "q_pcc": ("var", "Q_PCC"),
    "time": ("s", "TIME"),
    "p_ref": ("W", "P_REF"),
    "q_ref": ("var", "Q_REF"),
    "v_ref": ("V", "V_REF"),
}

GATE = "gate"
"""An output that is 0 while the bridge is blocked."""

_COMMANDS = {"v_conv": "V", "m_conv": "1"}
"""What a controller may give: the converter's voltage, or its modulation index v_conv / (v_dc / 2)."""

_UNITS = {
    "V": ("V", 1.0),
    "kV": ("V", 1e3),
    "A": ("A", 1.0),
    "kA": ("A", 1e3),
    "W": ("W", 1.0),
    "kW": ("W", 1e3),
    "MW": ("W", 1e6),
    "var": ("var", 1.0),
    "kvar": ("var", 1e3),
    "Mvar": ("var", 1e6),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "1": ("1", 1.0),
}

_KEYS = ("signal", "value", "unit", "base", "sign", "override_unit")


class WiringError(SeqsweepError):
    """A signal map that does not fit the controller; the message names the port."""


class Terminal(NamedTuple):
    """A port as the wiring needs it: ``width`` cells of one type, from the cell ``first`` on."""

    name: str
    unit: str
    width: int
    type: str
    first: int


class Input(NamedTuple):
    """One number that the controller is told: gain_0 times a quantity plus gain_1 times the next one."""

    type: str
    cell: int
    quantity: str
    gain: tuple[float, float]


class Output(NamedTuple):
    """One number that the controller gives, per ``gain`` the component ``direction`` of the command."""

    type: str
    cell: int
    direction: complex
    weight: complex
    gain: float


class Map(NamedTuple):
    """A checked signal map; ``modulated`` as in the kernel's `Wiring`, ``gate`` what blocks the bridge at 0."""

    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    modulated: bool
    gate: tuple[Terminal, ...]


def signal_names() -> tuple[list[str], list[str]]:
    """Names of signals for input ports and for output ports, the short ones for several components included."""
    parts = [*_GROUPS, *_DIRECTIONS]
    told = [
        f"{vector}_{part}" for vector in _VECTORS for part in parts if vector[0] == "v" or part not in _LINE_TO_LINE
    ]
    given = [f"{vector}_{part}" for vector in _COMMANDS for part in parts if part not in _LINE_TO_LINE]
    return [*told, *_SCALARS], [*given, GATE]


def wire(
    inputs: Sequence[Terminal], outputs: Sequence[Terminal], told: Mapping[str, Any], given: Mapping[str, Any]
) -> Map:
    """The signal map ``told`` (to the input ports) and ``given`` (by the output ports), against the ports.

    Raises
    ------
    WiringError
        For a port that does not exist or is not fed, a signal, unit, base or sign that does not fit, a width that is
        not the signals', or a converter voltage that is not given whole.
    """
    _known("inputs", inputs, told)
    _known("outputs", outputs, given)
    unfed = [port.name for port in inputs if port.name not in told]
    if unfed:
        raise WiringError(
            f"inputs: port {unfed[0]!r} is not fed: name its signal, or give it a value, as in "
            f"{unfed[0]} = {{ value = 0.0 }}"
        )
    fed = [part for port in inputs for part in _input(port, _entry("inputs", port, told[port.name]))]
    by_name = {port.name: port for port in outputs}
    entries = {name: _entry("outputs", by_name[name], entry) for name, entry in given.items()}
    gates = [by_name[name] for name, entry in entries.items() if entry.get("signal") == GATE]
    if len(gates) > 1 or any(port.width != 1 for port in gates):
        raise WiringError(f"outputs: the signal {GATE!r} belongs to one port of one number")
    taken = [
        part for name, entry in entries.items() if entry.get("signal") != GATE for part in _output(by_name[name], entry)
    ]
    names = [name for name, _ in taken]
    modulated = _whole(names)
    return Map(tuple(fed), tuple(part for _, part in taken), modulated, tuple(gates))


def _known(key: str, ports: Sequence[Terminal], entries: Mapping[str, Any]) -> None:
    known = [port.name for port in ports]
    if not isinstance(entries, Mapping):
        raise WiringError(f"{key} is {entries!r}; it must be a table with an entry for each port: {', '.join(known)}")
    for name in entries:
        if name not in known:
            raise WiringError(f"{key}: there is no port {name!r}{nearest(name, known)}; there are {', '.join(known)}")


def _entry(key: str, port: Terminal, entry: Any) -> dict[str, Any]:
    """An entry as a table; a text is a signal, a number a value."""
    if isinstance(entry, str):
        entry = {"signal": entry}
    if isinstance(entry, int | float):
        entry = {"value": entry}
    if not isinstance(entry, Mapping):
        raise WiringError(
            f'{key}: port {port.name!r} has {entry!r}; it needs a table such as {{ signal = "v_pcc_abc" }}'
        )
    for name in entry:
        if name not in _KEYS:
            hint = nearest(name, _KEYS)
            raise WiringError(f"{key}: port {port.name!r} has {name!r}{hint}; an entry has {', '.join(_KEYS)}")
    if ("signal" in entry) == ("value" in entry):
        raise WiringError(f"{key}: port {port.name!r} needs either a signal or a value")
    return dict(entry)


def _input(port: Terminal, entry: Mapping[str, Any]) -> list[Input]:
    if "value" in entry:
        value = _number("inputs", port, "value", entry["value"])
        return [Input(port.type, port.first + k, "ONE", (value, 0.0)) for k in range(port.width)]
    names = _names("inputs", port, entry["signal"], signal_names()[0])
    found = [_told(name) for name in names]
    factor = _factor("inputs", port, entry, {dimension for dimension, _, _ in found})
    return [
        Input(port.type, port.first + k, quantity, (direction.real / factor, direction.imag / factor))
        for k, (_, quantity, direction) in enumerate(found)
    ]


def _told(name: str) -> tuple[str, str, complex]:
    """Dimension, quantity and direction of a single signal."""
    if name in _SCALARS:
        return *_SCALARS[name], 1.0 + 0j
    vector, _, part = name.rpartition("_")
    return *_VECTORS[vector], complex(_DIRECTIONS[part])


def _output(port: Terminal, entry: Mapping[str, Any]) -> list[tuple[str, Output]]:
    if "value" in entry:
        raise WiringError(f"outputs: port {port.name!r} has a value; an output port gives a signal")
    names = _names("outputs", port, entry["signal"], signal_names()[1])
    factor = _factor("outputs", port, entry, {_COMMANDS[name.rpartition("_")[0]] for name in names})
    parts = [name.rpartition("_")[2] for name in names]
    return [
        (name, Output(port.type, port.first + k, _DIRECTIONS[part], _weight(part) * factor, 1.0 / factor))
        for k, (name, part) in enumerate(zip(names, parts, strict=True))
    ]


def _weight(part: str) -> complex:
    """What a component adds to the space vector: axes add up, of three phases two thirds."""
    return _DIRECTIONS[part] * (1.0 if part in _GROUPS["alphabeta"] else 2.0 / 3.0)


def _names(key: str, port: Terminal, signal: Any, known: Sequence[str]) -> list[str]:
    """Single signals of a port, one for each of its numbers."""
    wanted = [signal] if isinstance(signal, str) else signal
    if not isinstance(wanted, list | tuple) or not all(isinstance(name, str) for name in wanted):
        raise WiringError(f"{key}: port {port.name!r} has the signal {signal!r}; it needs a name or a list of names")
    names = []
    for name in wanted:
        if name not in known:
            hint = nearest(name, known) or f"; known are {', '.join(known)}"
            raise WiringError(f"{key}: port {port.name!r} has the signal {name!r}, which does not exist{hint}")
        vector, _, group = name.rpartition("_")
        names += [f"{vector}_{part}" for part in _GROUPS[group]] if group in _GROUPS else [name]
    if len(names) != port.width:
        raise WiringError(
            f"{key}: port {port.name!r} is {port.width} wide, but {signal!r} is {len(names)} numbers; "
            'list as many signals as it is wide, such as ["v_pcc_a", "v_pcc_b"]'
        )
    return names


def _factor(key: str, port: Terminal, entry: Mapping[str, Any], dimensions: set[str]) -> float:
    """One of the port's units in SI, with the sign."""
    sign = entry.get("sign", 1)
    if sign not in (1, -1) or isinstance(sign, bool):
        raise WiringError(f"{key}: port {port.name!r} has sign = {sign!r}; it is 1 or -1")
    if len(dimensions) > 1:
        raise WiringError(f"{key}: port {port.name!r} mixes signals in {' and '.join(sorted(dimensions))}")
    (dimension,) = dimensions
    unit = _unit(key, port, entry, dimension)
    if unit != "pu":
        if "base" in entry:
            raise WiringError(
                f'{key}: port {port.name!r} has a base, but its unit is {unit!r}; a base needs unit = "pu"'
            )
        return float(sign) * _UNITS[unit][1]
    if "base" not in entry:
        raise WiringError(f"{key}: port {port.name!r} is in pu: say what one pu is, base = ... in {dimension}")
    base = _number(key, port, "base", entry["base"])
    if not base > 0.0:
        raise WiringError(f"{key}: port {port.name!r} has base = {base:g}; it needs a number above 0, in {dimension}")
    return float(sign) * base


def _unit(key: str, port: Terminal, entry: Mapping[str, Any], dimension: str) -> str:
    """The port's unit: as the map says, which must not contradict the controller, else as that says."""
    own = port.unit.strip("[]() ")
    own = {"p.u.": "pu", "p.u": "pu", "PU": "pu", "-": "", "none": ""}.get(own, own)
    own = own if own == "pu" or own in _UNITS else ""
    default = "1" if dimension == "1" else own
    unit = entry.get("unit", default)
    fitting = [name for name, (of, _) in _UNITS.items() if of == dimension]
    if unit == "":
        said = f"the controller says {port.unit!r}" if port.unit else "the controller does not say it"
        raise WiringError(f"{key}: port {port.name!r} needs a unit ({said}): {', '.join(fitting)} or pu")
    if unit != "pu" and unit not in fitting:
        raise WiringError(
            f"{key}: port {port.name!r} has unit {unit!r}, but its signal is in {dimension}; {', '.join(fitting)} or pu"
        )
    if own and unit != own and "unit" in entry and entry.get("override_unit") is not True:
        raise WiringError(
            f"{key}: port {port.name!r} is in {own} by the controller's own description, in {unit} by the signal map; "
            "if that is wrong, add override_unit = true"
        )
    return str(unit)


def _whole(names: Sequence[str]) -> bool:
    """Whether the command is a modulation index; it must be given whole, and once."""
    families = {name.rpartition("_")[0] for name in names}
    parts = sorted(name.rpartition("_")[2] for name in names)
    whole = [sorted(_GROUPS["abc"]), sorted(_GROUPS["alphabeta"])]
    if len(families) != 1 or parts not in whole:
        found = ", ".join(names) or "nothing"
        raise WiringError(
            f"outputs: the ports give {found}; needed are all of v_conv_abc, v_conv_alphabeta, m_conv_abc or "
            "m_conv_alphabeta, each once"
        )
    return families == {"m_conv"}


def _number(key: str, port: Terminal, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise WiringError(f"{key}: port {port.name!r} has {name} = {value!r}; it needs a number")
    return float(value)
