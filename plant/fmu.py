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
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .branches import Replays, Snapshots
from .driven import Branches, DrivenPlant, Identity
from .fmu_archive import description_of, sha256_of, unpack
from .fmu_instance import Instance, Model, Ports, warm
from .forked import Forks
from .periodic import Clock, Patience
from .protocol import OperatingPoint, OperatingRange, Rating, SourceDirection
from .threephase import abc_of, vector_of


class FmuError(ValueError):
    """An FMU that cannot be driven as the campaign says, with the variable and the way out."""


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
