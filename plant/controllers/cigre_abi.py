"""The binary interface of real-code controllers, CIGRE TB 958 (IEEE/CIGRE models, API 2), as Python reads it.

A library says everything of itself through ``Model_GetInfo``: ports, parameters, sample time, state
sizes. Reading that loads the library, which is foreign native code: do it in a process that may die.
"""

from __future__ import annotations

import ctypes as c
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import SeqsweepError

FUNCTIONS = (
    "Model_PrintInfo",
    "Model_FirstCall",
    "Model_CheckParameters",
    "Model_Initialize",
    "Model_Outputs",
    "Model_Iterate",
    "Model_Terminate",
)
"""What a library may export beside ``Model_GetInfo``; only ``Model_Outputs`` must be there."""

OK, MESSAGE = 0, 1
"""What those functions return; anything else is an error."""

MOST = 100_000
"""More ports, parameters, states or elements than this are no description but a misread one."""


class CigreError(SeqsweepError):
    """A library that cannot be used as it is, or is asked for what it has not."""


@dataclass(frozen=True, slots=True)
class DataType:
    """One of the interface's data types: its name there, as numpy spells it, the union's member."""

    name: str
    numpy: str
    member: str


TYPES = {
    1: DataType("char", "S1", "character"),
    2: DataType("int8", "i1", "int8"),
    3: DataType("uint8", "u1", "uint8"),
    4: DataType("int16", "i2", "int16"),
    5: DataType("uint16", "u2", "uint16"),
    6: DataType("int32", "i4", "int32"),
    7: DataType("uint32", "u4", "uint32"),
    8: DataType("real32", "f4", "real32"),
    9: DataType("real64", "f8", "real64"),
    10: DataType("string", "u8", "string"),
}


@dataclass(frozen=True, slots=True)
class Port:
    """An input or output of a library: ``width`` values of one type."""

    name: str
    description: str
    unit: str
    type: DataType
    width: int


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a library; limits are None where it declares none."""

    name: str
    group: str
    description: str
    unit: str
    type: DataType
    fixed: bool
    default: Any
    lowest: float | None
    highest: float | None


@dataclass(frozen=True, slots=True)
class ModelInfo:
    """What a library says of itself."""

    name: str
    version: str
    description: str
    interface: tuple[int, int, int, int]
    sample_time_s: float
    emt_rms: int
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: tuple[Parameter, ...]
    n_int_states: int
    n_float_states: int
    n_double_states: int


class _Value(c.Union):
    _fields_ = (
        ("character", c.c_char),
        ("string", c.c_char_p),
        ("int8", c.c_int8),
        ("uint8", c.c_uint8),
        ("int16", c.c_int16),
        ("uint16", c.c_uint16),
        ("int32", c.c_int32),
        ("uint32", c.c_uint32),
        ("real32", c.c_float),
        ("real64", c.c_double),
    )


class _Signal(c.Structure):
    _fields_ = (
        ("name", c.c_char_p),
        ("description", c.c_char_p),
        ("unit", c.c_char_p),
        ("type", c.c_int),
        ("width", c.c_int32),
    )


class _Parameter(c.Structure):
    _fields_ = (
        ("name", c.c_char_p),
        ("group", c.c_char_p),
        ("description", c.c_char_p),
        ("unit", c.c_char_p),
        ("type", c.c_int),
        ("fixed", c.c_int32),
        ("default", _Value),
        ("lowest", _Value),
        ("highest", _Value),
    )


class _Info(c.Structure):
    _fields_ = (
        ("interface", c.c_uint8 * 4),
        ("name", c.c_char_p),
        ("version", c.c_char_p),
        ("description", c.c_char_p),
        ("about", c.c_char_p * 7),
        ("sample_time_s", c.c_double),
        ("emt_rms", c.c_uint8),
        ("n_inputs", c.c_int32),
        ("inputs", c.POINTER(_Signal)),
        ("n_outputs", c.c_int32),
        ("outputs", c.POINTER(_Signal)),
        ("n_parameters", c.c_int32),
        ("parameters", c.POINTER(_Parameter)),
        ("n_int_states", c.c_int32),
        ("n_float_states", c.c_int32),
        ("n_double_states", c.c_int32),
    )


class InstanceStruct(c.Structure):
    """What a host hands to every function of a library: where its data lie."""

    _fields_ = (
        ("inputs", c.c_void_p),
        ("outputs", c.c_void_p),
        ("parameters", c.c_void_p),
        ("time_s", c.c_double),
        ("emt_rms", c.c_uint8),
        ("error_message", c.c_char_p),
        ("general_message", c.c_char_p),
        ("int_states", c.c_void_p),
        ("float_states", c.c_void_p),
        ("double_states", c.c_void_p),
    )


class Library:
    """A loaded library: what it says of itself, and its functions.

    Parameters
    ----------
    path : path
        The shared library. It is loaded: its initialisers and ``Model_GetInfo`` run.

    Raises
    ------
    CigreError
        If it cannot be loaded, is no TB 958 library, or describes itself in a way that cannot be.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._handle = _loaded(self.path)
        for name in ("Model_GetInfo", "Model_Outputs"):
            if not hasattr(self._handle, name):
                raise CigreError(f"{self.path} is no TB 958 library: it exports no {name}")
        self.info = self._read_info()

    def function(self, name: str) -> Any | None:
        """One of `FUNCTIONS`, or None where it is not exported."""
        function = getattr(self._handle, name, None)
        if function is not None:
            function.restype = c.c_int32
            function.argtypes = [] if name == "Model_PrintInfo" else [c.c_void_p]
        return function

    def exports(self) -> tuple[str, ...]:
        """Those of `FUNCTIONS` that are there."""
        return tuple(name for name in FUNCTIONS if hasattr(self._handle, name))

    def _read_info(self) -> ModelInfo:
        get_info = self._handle.Model_GetInfo
        get_info.restype, get_info.argtypes = c.POINTER(_Info), []
        pointer = get_info()
        if not pointer:
            raise CigreError(f"{self.path}: Model_GetInfo returns nothing")
        return _info(self.path, pointer.contents)


def _loaded(path: Path) -> c.CDLL:
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise CigreError(f"{path} cannot be read: {error.strerror}") from None
    if magic[:2] == b"MZ":
        raise CigreError(
            f"{path} is a library for Windows, which this machine cannot load; ask for one built for Linux"
        )
    if magic[:2] == b"PK":
        raise CigreError(f'{path} is an archive: if it is an FMU, give controller = "fmu:{path}"')
    try:
        return c.CDLL(str(path.resolve()))
    except OSError as error:
        raise CigreError(f"{path} cannot be loaded: {error}") from None


def _info(path: Path, raw: _Info) -> ModelInfo:
    sizes = {name: getattr(raw, name) for name, *_ in _Info._fields_ if name.startswith("n_")}
    for name, size in sizes.items():
        if not 0 <= size <= MOST:
            raise CigreError(f"{path}: {name[2:].replace('_', ' ')}: the library declares {size} of them")
    if not (math.isfinite(raw.sample_time_s) and 0.0 <= raw.sample_time_s < 1.0):
        raise CigreError(f"{path}: the library declares a sample time of {raw.sample_time_s:g} s")
    return ModelInfo(
        name=_text(raw.name),
        version=_text(raw.version),
        description=_text(raw.description),
        interface=tuple(raw.interface),
        sample_time_s=raw.sample_time_s,
        emt_rms=raw.emt_rms,
        inputs=_named(path, "input port", [_port(path, "input", raw.inputs[k]) for k in range(raw.n_inputs)]),
        outputs=_named(path, "output port", [_port(path, "output", raw.outputs[k]) for k in range(raw.n_outputs)]),
        parameters=_named(path, "parameter", [_parameter(path, raw.parameters[k]) for k in range(raw.n_parameters)]),
        n_int_states=raw.n_int_states,
        n_float_states=raw.n_float_states,
        n_double_states=raw.n_double_states,
    )


def _port(path: Path, kind: str, raw: Any) -> Port:
    name = _text(raw.name)
    if raw.type not in TYPES or raw.type == 10:
        raise CigreError(f"{path}: {kind} port {name!r} has data type {raw.type}, which no port can have")
    if not 1 <= raw.width <= MOST:
        raise CigreError(f"{path}: {kind} port {name!r} is declared {raw.width} wide")
    return Port(name, _text(raw.description), _text(raw.unit), TYPES[raw.type], raw.width)


def _parameter(path: Path, raw: Any) -> Parameter:
    name = _text(raw.name)
    if raw.type not in TYPES:
        raise CigreError(f"{path}: parameter {name!r} has data type {raw.type}, which does not exist")
    kind = TYPES[raw.type]
    default, lowest, highest = (getattr(value, kind.member) for value in (raw.default, raw.lowest, raw.highest))
    about = name, _text(raw.group), _text(raw.description), _text(raw.unit), kind, bool(raw.fixed)
    if isinstance(default, bytes) or default is None:
        return Parameter(*about, _text(default), None, None)
    limited = lowest < highest  # equal ones, zeros as a rule, were never filled in
    return Parameter(*about, default, lowest if limited else None, highest if limited else None)


def _named(path: Path, what: str, items: Sequence[Any]) -> tuple[Any, ...]:
    """The items, if each has a name of its own."""
    names = [item.name for item in items]
    for name in names:
        if not name or names.count(name) > 1:
            raise CigreError(f"{path}: {what}s need names of their own; {name!r} is there {names.count(name)} times")
    return tuple(items)


def _text(raw: bytes | None) -> str:
    return (raw or b"").decode(errors="replace").strip()


def describe(path: str | Path) -> list[str]:
    """What a library is and what a run would execute of it, line by line; nothing is stepped."""
    library = Library(path)
    info, exported = library.info, library.exports()
    states = f"{info.n_int_states} integer, {info.n_float_states} float, {info.n_double_states} double"
    absent = [name for name in FUNCTIONS if name not in exported]
    return [
        f"{info.name} {info.version}: {info.description}".rstrip(": "),
        f"interface: TB 958, version {'.'.join(map(str, info.interface))}; for {_programs(info.emt_rms)}",
        f"sample time: {info.sample_time_s:g} s" if info.sample_time_s else "sample time: any, set sample_time_s",
        f"declared states: {states}",
        *(f"input {_port_words(port)}" for port in info.inputs),
        *(f"output {_port_words(port)}" for port in info.outputs),
        *(f"parameter {_parameter_words(parameter)}" for parameter in info.parameters),
        "executed for this: the library's initialisers, Model_GetInfo",
        f"a run executes: {', '.join(name for name in exported if name not in ('Model_Iterate', 'Model_PrintInfo'))}",
        f"not exported: {', '.join(absent) or 'nothing'}",
    ]


def _programs(emt_rms: int) -> str:
    return {1: "EMT programs", 2: "RMS programs", 3: "EMT and RMS programs"}.get(emt_rms, "programs it does not name")


def _port_words(port: Port) -> str:
    width = f"[{port.width}]" if port.width > 1 else ""
    return f"{port.name}{width} ({port.type.name}, {port.unit or 'no unit'}): {port.description}".rstrip(": ")


def _parameter_words(parameter: Parameter) -> str:
    limits = "" if parameter.lowest is None else f", {parameter.lowest:g} to {parameter.highest:g}"
    value = f"{parameter.default!r}" if isinstance(parameter.default, str) else f"{parameter.default:g}"
    about = f"({parameter.type.name}, {parameter.unit or 'no unit'}{limits}): {parameter.description}".rstrip(": ")
    return f"{parameter.name} = {value} {about}"


def main() -> None:
    """``python -m seqsweep.plant.controllers.cigre_abi FILE``: print `describe`, in a process that may die of it."""
    try:
        print("\n".join(describe(sys.argv[1])))
    except CigreError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
