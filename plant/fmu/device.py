"""``fmu:FILE.fmu``: a device as an FMU for co-simulation, FMI 2.0 or 3.0.

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

A voltage is held for a step, and the current is that at the end of the step. A controller goes into the
turbine's circuit instead: `grey`.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Mapping, Sequence
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ..boxes.box import DrivenPlant, Identity
from ..protocol import OperatingPoint, OperatingRange, Rating, SourceDirection
from ..space_vectors import abc_of, vector_of
from ..states.forks import Forks
from ..states.steady_state import Clock, Patience
from ..states.store import StateStore
from ..states.stores import Replays, Snapshots
from .archive import sha256_of
from .instance import Instance, Model, unpacked, warm
from .units import scale_of
from .variables import (
    Contents,
    FmuError,
    Setting,
    contents_of,
    find,
    find_power,
    find_settable,
    setting,
    width_of,
)


class Terminals(NamedTuple):
    """How the space vectors of the PCC become variables: number of phases, units (V, A), sign of the current."""

    n_voltages: int
    n_currents: int
    voltage_unit_v: float
    current_unit_a: float
    direction: SourceDirection
    power: Setting | None
    power_unit_w: float


class FmuBox:
    """A whole device as a `driven.Box` and a `branches.SnapshotBox`."""

    def __init__(self, model: Model, terminals: Terminals):
        self._instance, self._terminals, self._dt_s = Instance(model), terminals, model.dt_s
        self._step = 0

    def start(self, operating_point: OperatingPoint) -> None:
        """Begin at time zero, cold."""
        power = self._terminals.power
        power_w = operating_point.active_power_w / self._terminals.power_unit_w
        self._instance.start([power._replace(values=(power_w,))] if power else [])
        self._step = 0

    def advance(self, v: np.ndarray) -> np.ndarray:
        """Currents (n,) at the ends of n steps under voltages (n,).

        Raises
        ------
        FmuFault
            If a step is discarded or fails.
        """
        t = self._terminals
        u = (abc_of(v) if t.n_voltages == 3 else v[:, None].view(float)) / t.voltage_unit_v
        y = self._through(u) * (t.current_unit_a if t.direction == "load" else -t.current_unit_a)
        return vector_of(y) if t.n_currents == 3 else y.view(complex)[:, 0]

    def _through(self, u: np.ndarray) -> np.ndarray:
        """Outputs (n, n_out) after n steps under inputs (n, n_in)."""
        from ..kernels import fmi

        u, y = np.ascontiguousarray(u, float), np.empty((len(u), self._terminals.n_currents))
        instance, done = self._instance, np.zeros(1, np.int64)
        (step, block), told, given = map(int, instance.addresses), instance.inputs.cells, instance.outputs.cells
        fmi.advance(step, block, instance.time, self._step, self._dt_s, told.view(float), given.view(float), u, y, done)
        self._step += int(done[0])
        instance.check()
        if done[0] < len(u):
            raise instance.failure()
        return y

    def save(self) -> Any:
        """A snapshot, held by the FMU."""
        return self._instance.save(), self._step

    def load(self, snapshot: Any) -> None:
        """Be as it was when ``snapshot`` was taken."""
        held, self._step = snapshot
        self._instance.load(held)

    def drop(self, snapshot: Any) -> None:
        """Give the snapshot back to the FMU."""
        self._instance.drop(snapshot[0])


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
    voltage_unit_v: float | None = None,
    current_unit_a: float | None = None,
    active_power: str | None = None,
    active_power_unit_w: float | None = None,
    start: Mapping[str, Any] | None = None,
    active_power_w: Sequence[float] = (-inf, inf),
    terminal_voltage_pu: Sequence[float] = (0.5, 1.5),
    power_meaning: str | None = None,
    snapshot: Literal["auto", "state", "fork", "cold"] = "auto",
    settle_tolerance: float = 1e-8,
    patience_s: float = 30.0,
    hold: str = "start",
    validate: bool = True,
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
    voltage_unit_v, current_unit_a, active_power_unit_w : float, optional
        What 1 of the variable means (V, A, W); None: as the FMU declares, 1 where it declares no unit.
    active_power : str, optional
        A variable that is set to the operating point's active power before the start.
    start : mapping, optional
        Values of other variables, set before the start.
    active_power_w, terminal_voltage_pu : (lowest, highest)
        Where it may be operated (W, pu).
    power_meaning : str, optional
        One sentence for the table.
    snapshot : "auto", "state", "fork" or "cold"
        How its states are branched: by its own get and set, by a fork, by starting anew; "auto" takes the first it can.
    settle_tolerance, patience_s : float
        Change from one period to the next, over the peak, at which it counts as settled; simulated time (s) until then.
    hold : "start" or "mean"
        What is told of the voltage in a step; see `periodic.HOLDS`.
    validate : bool
        Whether a description that breaks the standard is refused.

    Raises
    ------
    SeqsweepError
        If the file is no FMU that can be driven, or a variable is not what it should be; with its name.
    """
    contents = contents_of(Path(file), validate)
    sizes = {
        **{"dt_s": dt_s, "f1_hz": f1_hz, "voltage_v": voltage_v, "power_va": power_va},
        **{"voltage_unit_v": voltage_unit_v, "current_unit_a": current_unit_a},
        "active_power_unit_w": active_power_unit_w,
    }
    for name, value in sizes.items():
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < inf:
            raise FmuError(f"{name} is {value!r}; needed: a finite number above 0")
    _one_of("current_direction", current_direction, ("load", "generator"))
    inputs, outputs = _few(contents, "voltage", voltage, "input"), _few(contents, "current", current, "output")
    before = [setting("start", find_settable(contents, "start", name), value) for name, value in (start or {}).items()]
    power = find_power(contents, active_power) if active_power else None
    can_go_back = _goes_back(contents, snapshot)
    model = unpacked(contents, inputs, outputs, before, dt_s, can_go_back)
    terminals = Terminals(
        sum(map(width_of, inputs)),
        sum(map(width_of, outputs)),
        scale_of(contents, "voltage", "voltage", inputs, voltage_unit_v),
        scale_of(contents, "current", "current", outputs, current_unit_a),
        current_direction,
        None if power is None else setting("active_power", power, 0.0),
        scale_of(contents, "active_power", "power", [] if power is None else [power], active_power_unit_w),
    )
    low, high = terminal_voltage_pu
    lowest_w, highest_w = active_power_w
    identity = Identity(
        f"fmu:{file}",
        Clock(float(f1_hz), float(dt_s)),
        Rating(float(voltage_v), float(power_va)),
        OperatingRange((float(lowest_w), float(highest_w)), (low * voltage_v, high * voltage_v)),
        power_meaning or ("as the FMU takes it" if power else "not told to the FMU: active_power names no variable"),
    )
    branches = _branches(partial(FmuBox, model, terminals), can_go_back, snapshot)
    plant = DrivenPlant(
        identity,
        branches,
        Patience(settle_tolerance, patience_s),
        {"file_sha256": sha256_of(contents.path), "model": contents.name},
        hold,
    )
    weakref.finalize(plant, shutil.rmtree, model.folder, ignore_errors=True)
    return plant


def _branches(build: partial[FmuBox], can_go_back: bool, snapshot: str) -> StateStore:
    if can_go_back:
        return Snapshots(build)
    return Replays(build) if snapshot == "cold" else Forks(build, warm)


def _goes_back(contents: Contents, snapshot: str) -> bool:
    """Whether its own get and set of the state are used."""
    _one_of("snapshot", snapshot, ("auto", "state", "fork", "cold"))
    if snapshot == "state" and not contents.can_go_back:
        raise FmuError(
            f'{contents.path}: snapshot = "state", but it cannot get and set its state; "auto" takes what there is'
        )
    return contents.can_go_back and snapshot in ("auto", "state")


def _one_of(name: str, value: Any, known: Sequence[str]) -> None:
    if value not in known:
        raise FmuError(f"{name} is {value!r}; needed: {', '.join(known)}")


def _few(contents: Contents, key: str, names: Sequence[str], causality: str) -> list[Any]:
    """Variables that make a space vector."""
    if isinstance(names, list | tuple) and all(isinstance(name, str) for name in names):
        variables = [find(contents, key, name, causality) for name in names]
        if len(set(names)) < len(names):
            raise FmuError(f"{key} is {names!r}; needed: each variable once")
        if sum(map(width_of, variables)) in (2, 3):
            return variables
    raise FmuError(
        f"{key} is {names!r}; needed: the names of two variables, alpha and beta, or of three phases, or of an array "
        "of so many"
    )
