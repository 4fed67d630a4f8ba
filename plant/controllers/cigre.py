"""One running controller of a TB 958 library: its memory, laid out as the library declares it.

The host owns everything that the interface names: inputs, outputs, parameters and the declared state
arrays. A library that keeps its whole state there can be put back to any moment (`Controller.memory`,
`Controller.restore`); one that hides some of it cannot.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import nearest
from .cigre_abi import MESSAGE, OK, CigreError, InstanceStruct, Library, Parameter, Port
from .interface import ControllerFault, Offer, Stretch
from .signal_map import Terminal

EMT, RMS = 1, 2


class ControllerMemory(NamedTuple):
    """All that a library declares it remembers, and its inputs and outputs."""

    inputs: bytes
    outputs: bytes
    int_states: bytes
    float_states: bytes
    double_states: bytes


class Controller:
    """A library, allocated and ready to be started.

    Parameters
    ----------
    library : Library
        The code.
    settings : mapping
        Values of parameters by name; the others have the library's defaults.
    again : callable, optional
        Gives the library of the next run, for one that does not start anew by itself; the same unless given.

    Raises
    ------
    CigreError
        If a setting is unknown, of the wrong kind, or beyond the library's limits.
    """

    def __init__(
        self,
        library: Library,
        settings: Mapping[str, Any] | None = None,
        again: Callable[[], Library] | None = None,
    ):
        self.library, self._settings, self._again, self._started = library, settings or {}, again, False
        info = library.info
        inputs, outputs = _layout(info.inputs), _layout(info.outputs)
        self.inputs, self.outputs = Stretch("inputs", inputs.itemsize), Stretch("outputs", outputs.itemsize)
        self.input_terminals = _terminals(info.inputs, inputs)
        self.output_terminals = _terminals(info.outputs, outputs)
        self._states = (
            Stretch("integer states", 4 * info.n_int_states),
            Stretch("float states", 4 * info.n_float_states),
            Stretch("double states", 8 * info.n_double_states),
        )
        self._parameters, self._strings = _parameters(info.parameters, self._settings, library.path)
        self._struct = InstanceStruct(
            inputs=self.inputs.address,
            outputs=self.outputs.address,
            parameters=self._parameters.address,
            emt_rms=EMT,
            int_states=self._states[0].address,
            float_states=self._states[1].address,
            double_states=self._states[2].address,
        )
        first = InstanceStruct.time_s.offset
        self.time = np.frombuffer(memoryview(self._struct).cast("B"), np.uint8)[first : first + 8].view(np.float64)
        step = library.function("Model_Outputs")
        assert step is not None
        function = ctypes.cast(step, ctypes.c_void_p).value
        self.addresses = np.array([function, ctypes.addressof(self._struct)], np.int64)
        self.messages: list[str] = []

    def renewed(self) -> Controller:
        """This one, before its first run; then another one, whose memory is blank."""
        if not self._started:
            return self
        self.end()
        return Controller(self._again() if self._again else self.library, self._settings, self._again)

    def start(self) -> None:
        """First calls of a run, at time zero; inputs and outputs already hold their initial values."""
        self._started = True
        self.time[0] = 0.0
        for name in ("Model_FirstCall", "Model_CheckParameters", "Model_Initialize"):
            self._call(name)
        self.check()

    def end(self) -> None:
        """Last call of a run; what it returns changes nothing any more."""
        function = self.library.function("Model_Terminate")
        if function is not None:
            function(ctypes.addressof(self._struct))

    def memory(self) -> ControllerMemory:
        """Everything declared, as it is now."""
        return ControllerMemory(*(stretch.cells.tobytes() for stretch in (self.inputs, self.outputs, *self._states)))

    def restore(self, memory: ControllerMemory) -> None:
        """Back to a moment of the past, as far as the library declares what it remembers."""
        for stretch, content in zip((self.inputs, self.outputs, *self._states), memory, strict=True):
            stretch.cells[:] = np.frombuffer(content, np.uint8)

    def check(self) -> None:
        """Note the library's message, if any; refuse a library that wrote out of bounds."""
        text = _words(self._struct.general_message)
        if text and text not in self.messages:
            self.messages.append(text)
        for stretch in (self.inputs, self.outputs, *self._states, self._parameters):
            stretch.check()

    def refusal(self, name: str = "Model_Outputs") -> ControllerFault:
        """The error that the library left behind when ``name`` failed."""
        text = _words(self._struct.error_message) or "no message"
        before = f" (it had said: {self.messages[-1]})" if self.messages else ""
        return ControllerFault(f"{name} refuses at {self.time[0]:.6g} s: {text}{before}")

    def _call(self, name: str) -> None:
        function = self.library.function(name)
        if function is None:
            return
        if function(ctypes.addressof(self._struct)) not in (OK, MESSAGE):
            raise self.refusal(name)


def offer(path: Path, settings: Mapping[str, Any], sample_time_s: float | None) -> Offer:
    """A library as a controller for a circuit in time; it is loaded into this process.

    Raises
    ------
    CigreError
        If it cannot be used, or its sample time is not known, or another one.
    """
    library = Library(path)
    info = library.info
    if info.emt_rms == RMS:
        raise CigreError(f"{path} is a model for RMS programs; its control cannot be sampled in a circuit in time")
    own = info.sample_time_s
    if sample_time_s is None and not own:
        raise CigreError(f"{path} names no sample time: give sample_time_s, in s")
    if own and sample_time_s is not None and abs(sample_time_s - own) > 1e-9 * own:
        raise CigreError(f"sample_time_s is {sample_time_s:g} s, but {path} is sampled every {own:g} s: leave it away")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return Offer(
        partial(_opened, path, settings),
        partial(_opened_copy, path, settings),
        "arrays",
        own or float(sample_time_s or 0.0),
        {"name": info.name, "version": info.version, "sha256": digest},
    )


def _opened(path: Path, settings: Mapping[str, Any]) -> Controller:
    return Controller(Library(path), settings)


def _opened_copy(path: Path, settings: Mapping[str, Any]) -> Controller:
    copy = partial(private_copy, path)
    return Controller(copy(), settings, copy)


def private_copy(path: str | Path) -> Library:
    """The library once more, from a file of its own: with statics of its own.

    A file loaded twice is one library. The copy is gone from the disk when this returns; what is loaded stays.
    """
    with tempfile.TemporaryDirectory(prefix="seqsweep-") as folder:
        return Library(shutil.copy2(path, Path(folder) / Path(path).name))


def _layout(ports: Sequence[Port]) -> np.dtype:
    """Ports as the members of a C structure, naturally aligned."""
    return np.dtype([(port.name, port.type.numpy, (port.width,)) for port in ports], align=True)


def _terminals(ports: Sequence[Port], layout: np.dtype) -> tuple[Terminal, ...]:
    assert layout.fields is not None or not ports
    return tuple(
        Terminal(port.name, port.unit, port.width, kind, layout.fields[port.name][1] // np.dtype(kind).itemsize)  # type: ignore[index]
        for port in ports
        for kind in ["u1" if port.type.name == "char" else port.type.numpy]
    )


def _parameters(
    declared: Sequence[Parameter], settings: Mapping[str, Any], path: Path
) -> tuple[Stretch, list[ctypes.c_char_p]]:
    """The parameters in memory, and the strings to which they point."""
    by_name = {parameter.name: parameter for parameter in declared}
    for name in settings:
        if name not in by_name:
            hint = nearest(name, list(by_name))
            raise CigreError(f"settings: {path.name} has no parameter {name!r}{hint}; it has {', '.join(by_name)}")
    layout = np.dtype([(parameter.name, parameter.type.numpy) for parameter in declared], align=True)
    stretch, strings = Stretch("parameters", layout.itemsize), []
    values = stretch.cells[: layout.itemsize].view(layout) if declared else None
    for parameter in declared:
        value = _setting(parameter, settings.get(parameter.name, parameter.default))
        if parameter.type.name == "string":
            strings.append(ctypes.c_char_p(value.encode()))
            value = ctypes.cast(strings[-1], ctypes.c_void_p).value
        assert values is not None
        values[parameter.name] = value
    return stretch, strings


def _setting(parameter: Parameter, value: Any) -> Any:
    """``value`` if the parameter can have it."""
    kind, name = parameter.type, parameter.name
    if kind.name in ("string", "char"):
        if not isinstance(value, str):
            raise CigreError(f"settings: {name} is {value!r}; the library takes text")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CigreError(f"settings: {name} is {value!r}; the library takes a number{_unit(parameter)}")
    if kind.numpy[0] in "iu":
        limits = np.iinfo(kind.numpy)
        if value != int(value) or not limits.min <= value <= limits.max:
            raise CigreError(f"settings: {name} is {value!r}; the library takes a whole number ({kind.name})")
        value = int(value)
    lowest, highest = parameter.lowest, parameter.highest
    if lowest is not None and highest is not None and not lowest <= value <= highest:
        raise CigreError(
            f"settings: {name} is {value:g}; the library takes {lowest:g} to {highest:g}{_unit(parameter)}"
        )
    return value


def _unit(parameter: Parameter) -> str:
    return f", in {parameter.unit}" if parameter.unit else ""


def _words(text: bytes | None) -> str:
    return " ".join((text or b"").decode(errors="replace").split())
