"""``fmu:FILE.fmu``: a device, or a controller, as an FMI 2.0 co-simulation FMU.

Which variable is what is said in the campaign's ``[plant.parameters]``, checked before anything runs:

    [plant]
    id = "fmu:converter.fmu"
    [plant.parameters]
    f1_hz = 50.0
    dt_s = 20e-6                               # the communication step
    voltage_v = 690.0                          # rating, line-to-line RMS
    power_va = 1e6
    voltage = ["v_a", "v_b", "v_c"]            # inputs: three phases, or two: alpha, beta
    current = ["i_a", "i_b", "i_c"]            # outputs
    current_direction = "generator"            # "load": into the device
    active_power = "p_ref"                     # optional: set before it starts
    start = { k_p = 0.5 }                      # optional: other variables, set before it starts

A voltage is held for a step, and the current is that at the end of the step.
"""

from __future__ import annotations

import difflib
import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .branches import BoxLost, Replays, Snapshots
from .driven import Branches, DrivenPlant, Identity
from .fmu_archive import description_of, sha256_of, unpack
from .forked import Forks
from .periodic import Clock, Patience
from .protocol import OperatingPoint, OperatingRange, Rating, SourceDirection
from .threephase import abc_of, vector_of

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_FATAL = 4
_CALLS = ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal")


class FmuError(ValueError):
    """An FMU that cannot be driven as the campaign says, with the variable and the way out."""


class FmuFault(RuntimeError):
    """An FMU that gave up on the way; the message says in which call, and its own last message."""


class FmuLost(FmuFault, BoxLost):
    """A fatal answer: the standard allows no further call."""


class Ports(NamedTuple):
    """Value references of what is set and read in every step, and of what is set before the start."""

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    before: tuple[tuple[str, int, Any], ...]


class Model(NamedTuple):
    """An unpacked FMU: everything it takes to make an instance, in any process."""

    folder: str
    guid: str
    identifier: str
    ports: Ports
    dt_s: float
    can_go_back: bool


class Instance:
    """One instance of an FMU, stepped by a compiled loop.

    Parameters
    ----------
    model : Model
        The FMU.
    """

    def __init__(self, model: Model):
        from fmpy.fmi2 import FMU2Slave

        self._model = model
        self._fmu = FMU2Slave(guid=model.guid, unzipDirectory=model.folder, modelIdentifier=model.identifier)
        self._messages: list[str] = []
        self._callbacks = _callbacks(self._messages)
        self._inputs = np.array(model.ports.inputs, np.uint32)
        self._outputs = np.array(model.ports.outputs, np.uint32)
        self._started = False
        self.step = 0

    @property
    def functions(self) -> tuple[int, int, int]:
        """Addresses of fmi2SetReal, fmi2DoStep and fmi2GetReal, for kernels that step it themselves."""
        import ctypes

        found = [ctypes.cast(getattr(self._fmu.dll, name), ctypes.c_void_p).value for name in _CALLS]
        return found[0] or 0, found[1] or 0, found[2] or 0

    @property
    def component(self) -> int:
        """Address of the instance, for the same kernels."""
        return int(self._fmu.component)

    def start(self, more: Sequence[tuple[str, int, Any]] = ()) -> None:
        """Begin at time zero with the start values of the model, and ``more``: (type, reference, value).

        Raises
        ------
        FmuFault
            If a call is not answered by ok or a warning.
        """
        try:
            if not self._started:
                self._fmu.instantiate(callbacks=self._callbacks, loggingOn=False)
                self._started = True
            else:
                self._fmu.reset()
            self._fmu.setupExperiment(startTime=0.0)
            for kind, reference, value in (*self._model.ports.before, *more):
                getattr(self._fmu, f"set{kind}")([reference], [value])
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
        except Exception as error:
            raise FmuFault(f"the FMU does not start: {' '.join(str(error).split())}{self._last_message()}") from None
        self.step = 0

    def advance(self, u: np.ndarray) -> np.ndarray:
        """Outputs (n, n_out) after n steps under inputs (n, n_in).

        Raises
        ------
        FmuFault
            If a step is discarded or fails.
        """
        from .kernels import fmi2

        u = np.ascontiguousarray(u, float)
        y = np.empty((len(u), len(self._outputs)))
        done, call, status = fmi2.advance(
            self.functions,
            self.component,
            self._inputs,
            self._outputs,
            self.step,
            self._model.dt_s,
            np.int32(not self._model.can_go_back),
            u,
            y,
        )
        self.step += int(done)
        if done < len(u):
            raise (FmuLost if status == _FATAL else FmuFault)(
                f"{_CALLS[call]} answered {_STATUS[status] if status < len(_STATUS) else status} at "
                f"{self.step * self._model.dt_s:.6g} s{self._last_message()}"
            )
        return y

    def save(self) -> tuple[Any, int]:
        """A snapshot, held by the FMU."""
        return self._fmu.getFMUstate(), self.step

    def load(self, snapshot: tuple[Any, int]) -> None:
        """Be as it was when ``snapshot`` was taken."""
        state, self.step = snapshot
        self._fmu.setFMUstate(state)

    def drop(self, snapshot: tuple[Any, int]) -> None:
        """Give the snapshot back to the FMU."""
        self._fmu.freeFMUstate(snapshot[0])

    def _last_message(self) -> str:
        return f"; it says: {self._messages[-1]}" if self._messages else ""


class Terminals(NamedTuple):
    """How the space vectors of the PCC become variables: number of phases, units (V, A), sign of the current."""

    n_voltages: int
    n_currents: int
    voltage_unit_v: float
    current_unit_a: float
    direction: SourceDirection
    power: tuple[str, int] | None
    power_unit_w: float


class FmuBox:
    """A whole device as a `driven.Box` and a `branches.SnapshotBox`."""

    def __init__(self, model: Model, terminals: Terminals):
        self._instance, self._terminals = Instance(model), terminals

    def start(self, operating_point: OperatingPoint) -> None:
        """Begin at time zero, cold."""
        power = self._terminals.power
        power_w = operating_point.active_power_w / self._terminals.power_unit_w
        self._instance.start([(*power, power_w)] if power else [])

    def advance(self, v: np.ndarray) -> np.ndarray:
        """Currents (n,) at the ends of n steps under voltages (n,)."""
        t = self._terminals
        u = (abc_of(v) if t.n_voltages == 3 else v[:, None].view(float)) / t.voltage_unit_v
        y = self._instance.advance(u) * (t.current_unit_a if t.direction == "load" else -t.current_unit_a)
        return vector_of(y) if t.n_currents == 3 else y.view(complex)[:, 0]

    def save(self) -> Any:
        """As `Instance.save`."""
        return self._instance.save()

    def load(self, snapshot: Any) -> None:
        """As `Instance.load`."""
        self._instance.load(snapshot)

    def drop(self, snapshot: Any) -> None:
        """As `Instance.drop`."""
        self._instance.drop(snapshot)


def fmu_plant(
    file: str,
    *,
    dt_s: float,
    voltage_v: float,
    power_va: float,
    voltage: Sequence[str],
    current: Sequence[str],
    f1_hz: float = 50.0,
    current_direction: SourceDirection = "load",
    voltage_unit_v: float = 1.0,
    current_unit_a: float = 1.0,
    active_power: str | None = None,
    active_power_unit_w: float = 1.0,
    start: Mapping[str, Any] | None = None,
    active_power_w: Sequence[float] = (-inf, inf),
    terminal_voltage_pu: Sequence[float] = (0.5, 1.5),
    power_meaning: str = "as the FMU takes it",
    snapshot: Literal["auto", "state", "fork", "cold"] = "auto",
    settle_tolerance: float = 1e-8,
    patience_s: float = 30.0,
) -> DrivenPlant:
    """The device in an FMU.

    Parameters
    ----------
    file : str
        What stands behind ``fmu:``.
    dt_s, f1_hz : float
        Communication step (s) and fundamental (Hz).
    voltage_v, power_va : float
        Rating: line-to-line RMS (V) and apparent power (VA).
    voltage, current : 2 or 3 names
        Inputs and outputs: alpha and beta, or the three phases.
    current_direction : "load" or "generator"
        Whether the FMU's current is positive into the device or out of it.
    voltage_unit_v, current_unit_a, active_power_unit_w : float
        What 1 of the variable means (V, A, W).
    active_power : str, optional
        A variable that is set to the operating point's active power before the start.
    start : mapping, optional
        Values of other variables, set before the start.
    active_power_w, terminal_voltage_pu : (lowest, highest)
        Where it may be operated (W, pu).
    power_meaning : str
        One sentence for the table.
    snapshot : "auto", "state", "fork" or "cold"
        How its states are branched: by its own get and set, by a fork, by starting anew; "auto" takes the first it can.
    settle_tolerance, patience_s : float
        Change from one period to the next, over the peak, at which it counts as settled; simulated time (s) until then.

    Raises
    ------
    ValueError
        If the file is no FMU that can be driven, or a variable is not what it should be; with its name.
    """
    path = Path(file)
    description = description_of(path)
    _refuse_what_cannot_be_driven(path, description)
    for name, value in {"dt_s": dt_s, "f1_hz": f1_hz, "voltage_v": voltage_v, "power_va": power_va}.items():
        if not 0.0 < value < inf:
            raise FmuError(f"{name} is {value:g}; needed: a finite number above 0")
    _one_of("current_direction", current_direction, ("load", "generator"))
    find = partial(_variable, path, {variable.name: variable for variable in description.modelVariables})
    inputs = [find("voltage", name, "input") for name in _few("voltage", voltage)]
    outputs = [find("current", name, "output") for name in _few("current", current)]
    before = [(find("start", name, ""), value) for name, value in (start or {}).items()]
    power = find("active_power", active_power, "") if active_power else None
    can_go_back = _goes_back(path, description.coSimulation, snapshot)
    ports = Ports(
        tuple(variable.valueReference for variable in inputs),
        tuple(variable.valueReference for variable in outputs),
        tuple((_setter(variable), variable.valueReference, _value(variable, value)) for variable, value in before),
    )
    folder = tempfile.mkdtemp(prefix="fmu-")
    unpack(path, Path(folder))
    model = Model(
        folder,
        description.guid,
        description.coSimulation.modelIdentifier,
        ports,
        float(dt_s),
        can_go_back,
    )
    terminals = Terminals(
        len(inputs),
        len(outputs),
        voltage_unit_v,
        current_unit_a,
        current_direction,
        None if power is None else ("Real", power.valueReference),
        active_power_unit_w,
    )
    low, high = terminal_voltage_pu
    lowest_w, highest_w = active_power_w
    identity = Identity(
        f"fmu:{file}",
        Clock(float(f1_hz), float(dt_s)),
        Rating(float(voltage_v), float(power_va)),
        OperatingRange((float(lowest_w), float(highest_w)), (low * voltage_v, high * voltage_v)),
        power_meaning,
    )
    branches = _branches(partial(FmuBox, model, terminals), can_go_back, snapshot)
    contents = {"file_sha256": sha256_of(path), "model": f"{description.modelName} {description.version or ''}".strip()}
    plant = DrivenPlant(identity, branches, Patience(settle_tolerance, patience_s), contents)
    weakref.finalize(plant, shutil.rmtree, folder, ignore_errors=True)
    return plant


def _branches(build: partial[FmuBox], can_go_back: bool, snapshot: str) -> Branches:
    if can_go_back:
        return Snapshots(build)
    return Replays(build) if snapshot == "cold" else Forks(build, warm)


def warm() -> None:
    """Have the kernel ready before anything is forked."""
    from .kernels import fmi2

    none = np.empty((0, 1))
    fmi2.advance((0, 0, 0), 0, np.empty(1, np.uint32), np.empty(1, np.uint32), 0, 1.0, np.int32(0), none, none)


# ---------------------------------------------------------------------- what the campaign says, against the FMU


def _refuse_what_cannot_be_driven(path: Path, description: Any) -> None:
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        kinds = [kind for kind in ("modelExchange", "coSimulation") if getattr(description, kind) is not None]
        raise FmuError(
            f"{path}: FMI {description.fmiVersion}, {' and '.join(kinds) or 'no interface'}; needed: FMI 2.0 for "
            "co-simulation, which most tools export on request"
        )
    if description.coSimulation.needsExecutionTool:
        raise FmuError(f"{path}: it needs the tool it comes from, running; export it as a self-contained FMU")
    from fmpy import platform, supported_platforms

    offered = supported_platforms(str(path))
    if platform not in offered:
        raise FmuError(
            f"{path}: it has binaries for {', '.join(offered) or 'no platform'}, this machine is {platform}; export it "
            "for this one, or drive it elsewhere by process:COMMAND"
        )


def _goes_back(path: Path, interface: Any, snapshot: str) -> bool:
    """Whether its own get and set of the state are used."""
    _one_of("snapshot", snapshot, ("auto", "state", "fork", "cold"))
    if snapshot == "state" and not interface.canGetAndSetFMUstate:
        raise FmuError(f'{path}: snapshot = "state", but it cannot get and set its state; "auto" takes what there is')
    return bool(interface.canGetAndSetFMUstate) and snapshot in ("auto", "state")


def _one_of(name: str, value: Any, known: Sequence[str]) -> None:
    if value not in known:
        raise FmuError(f"{name} is {value!r}; needed: {', '.join(known)}")


def _few(name: str, names: Sequence[str]) -> Sequence[str]:
    if not isinstance(names, list | tuple) or len(names) not in (2, 3) or not all(isinstance(n, str) for n in names):
        raise FmuError(f"{name} is {names!r}; needed: the names of two variables, alpha and beta, or of three phases")
    return names


def _variable(path: Path, known: Mapping[str, Any], key: str, name: str, causality: str) -> Any:
    """The variable called ``name``, of the right causality and type for ``key``."""
    if name not in known:
        alike = [other for other, variable in known.items() if not causality or variable.causality == causality]
        near = difflib.get_close_matches(name, alike, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else f"; it has {', '.join(alike[:12])}"
        raise FmuError(f"{key}: {path} has no variable {name!r}{hint}")
    variable = known[name]
    if causality and variable.causality != causality:
        raise FmuError(f"{key}: variable {name!r} of {path} is an {variable.causality}; needed: an {causality}")
    if (causality or key == "active_power") and variable.type != "Real":
        raise FmuError(f"{key}: variable {name!r} of {path} is a {variable.type}; needed: a Real")
    if not causality and variable.causality not in ("parameter", "input") and variable.initial != "exact":
        raise FmuError(f"{key}: variable {name!r} of {path}, {variable.causality}, cannot be set at the start")
    return variable


def _setter(variable: Any) -> str:
    """Which of the FMU's functions sets a variable."""
    return "Integer" if variable.type == "Enumeration" else str(variable.type)


def _value(variable: Any, value: Any) -> Any:
    """A start value as the type of its variable wants it."""
    right = {
        "Real": isinstance(value, int | float) and not isinstance(value, bool),
        "Integer": isinstance(value, int) and not isinstance(value, bool),
        "Enumeration": isinstance(value, int) and not isinstance(value, bool),
        "Boolean": isinstance(value, bool),
        "String": isinstance(value, str),
    }
    if not right.get(variable.type, False):
        raise FmuError(f"start: variable {variable.name!r} is a {variable.type}; given {value!r}")
    return value


def _callbacks(messages: list[str]) -> Any:
    """The functions an FMU may call: it logs into ``messages``, of which the last are kept."""
    from ctypes import byref

    from fmpy import calloc, free
    from fmpy import fmi2 as interface

    def hear(environment: Any, name: Any, status: int, category: Any, message: bytes | None) -> None:
        messages.append((message or b"").decode(errors="replace").strip()[:200])
        del messages[:-10]

    callbacks = interface.fmi2CallbackFunctions()
    callbacks.logger = interface.fmi2CallbackLoggerTYPE(hear)
    callbacks.allocateMemory = interface.fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = interface.fmi2CallbackFreeMemoryTYPE(free)
    with suppress(Exception):  # fills in what a message's % stand for, where it can be loaded
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(byref(callbacks))
    return callbacks
