"""A controller as an FMU for co-simulation, in the turbine's circuit.

Its ports are its inputs and outputs of a numeric type, one terminal for each variable. A sample is: set the inputs,
fmi2DoStep (fmi3DoStep) over the sample time, get the outputs of the signal map.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ..fmu.archive import sha256_of
from ..fmu.instance import Instance, Model, unpacked
from ..fmu.variables import Contents, FmuError, Setting, contents_of, find_settable, is_settable, laid_out, setting
from .interface import Offer
from .signal_map import Terminal


class Port(NamedTuple):
    """A terminal, and the variable behind it: its type, its reference, whether the start may be told what it holds."""

    terminal: Terminal
    type: str
    reference: int
    told: bool


class FmuController:
    """An FMU as a `Sealed` controller, which also takes snapshots of itself where the FMU can.

    Parameters
    ----------
    model : Model
        The unpacked FMU; it is loaded into this process at its first start.
    inputs, outputs : tuple of Port
        Its ports. Outputs that are not in the signal map have no memory: nobody gets them.
    """

    def __init__(self, model: Model, inputs: tuple[Port, ...], outputs: tuple[Port, ...]):
        self._instance, self._inputs, self._outputs = Instance(model), inputs, outputs
        self.input_terminals = tuple(port.terminal for port in inputs)
        self.output_terminals = tuple(port.terminal for port in outputs)
        self.inputs, self.outputs = self._instance.inputs, self._instance.outputs
        self.time, self.addresses = self._instance.time, self._instance.addresses

    def renewed(self) -> FmuController:
        """This one: an FMU is reset."""
        return self

    def start(self) -> None:
        """Reset, told what inputs and outputs hold now: inputs in initialization, outputs before, if they can be set.

        Raises
        ------
        FmuFault
            If a call is refused.
        """
        self._instance.start(
            [_held(port, self.outputs.cells) for port in self._outputs if port.told],
            [_held(port, self.inputs.cells) for port in self._inputs],
        )
        self.check()

    def memory(self) -> None:
        """Nothing: what an FMU remembers is its own."""

    def restore(self, memory: None) -> None:
        """Nothing: see `load`."""

    def check(self) -> None:
        """As `Instance.check`."""
        self._instance.check()

    def refusal(self) -> Exception:
        """As `Instance.failure`."""
        return self._instance.failure()

    def save(self) -> Any:
        """As `Instance.save`."""
        return self._instance.save()

    def load(self, snapshot: Any) -> None:
        """As `Instance.load`."""
        self._instance.load(snapshot)

    def drop(self, snapshot: Any) -> None:
        """As `Instance.drop`."""
        self._instance.drop(snapshot)


def offer(
    path: Path,
    settings: Mapping[str, Any],
    sample_time_s: float | None,
    mapped: Iterable[str],
    by_snapshot: bool,
    validate: bool,
) -> Offer:
    """An FMU as a controller for a circuit in time; it is unpacked, but not loaded.

    Parameters
    ----------
    path : path
        The FMU.
    settings : mapping
        Values of variables, set before the start.
    sample_time_s : float, optional
        Communication step (s); the step of the FMU's default experiment unless given.
    mapped : iterable of str
        Outputs of the signal map; the others are not read.
    by_snapshot : bool
        Whether it may be asked to go back, where it can.
    validate : bool
        Whether a description that breaks the standard is refused.

    Raises
    ------
    SeqsweepError
        If it cannot be driven, a setting does not fit, or the sample time is not known.
    """
    contents = contents_of(path, validate)
    before = [setting("settings", find_settable(contents, "settings", name), value) for name, value in settings.items()]
    inputs = [variable for variable in _numeric(contents, "input") if variable.name not in settings]
    outputs = _numeric(contents, "output")
    read = [variable for variable in outputs if variable.name in set(mapped)]
    step_s = _sample_time(contents, sample_time_s)
    model = unpacked(contents, inputs, read, before, step_s, by_snapshot and contents.can_go_back)
    ports = _ports(contents, inputs, inputs), _ports(contents, outputs, read)
    return Offer(
        partial(FmuController, model, *ports),
        partial(_copied, model, *ports),
        "snapshots" if contents.can_go_back else "",
        step_s,
        {"name": contents.name, "version": contents.description.version or "", "sha256": sha256_of(path)},
        model.folder,
    )


def _copied(model: Model, inputs: tuple[Port, ...], outputs: tuple[Port, ...]) -> FmuController:
    """The controller from files of its own: with statics of its own."""
    folder = tempfile.mkdtemp(prefix="fmu-")
    shutil.copytree(model.folder, folder, dirs_exist_ok=True)
    controller = FmuController(model._replace(folder=folder), inputs, outputs)
    weakref.finalize(controller, shutil.rmtree, folder, ignore_errors=True)
    return controller


def _numeric(contents: Contents, causality: str) -> list[Any]:
    """The variables that can be a port."""
    kinds = contents.spelled.types
    return [v for v in contents.description.modelVariables if v.causality == causality and v.type in kinds]


def _ports(contents: Contents, variables: list[Any], in_memory: list[Any]) -> tuple[Port, ...]:
    """Ports of ``variables``, of which only some lie ``in_memory``."""
    _, cells = laid_out(contents, in_memory)
    _, all_cells = laid_out(contents, variables)
    ports = []
    for variable in variables:
        kind, first, width = cells.get(variable.name, all_cells[variable.name])
        terminal = Terminal(variable.name, _unit(variable), width, kind, first)
        told = variable.name in cells and is_settable(variable)
        ports.append(Port(terminal, variable.type, variable.valueReference, told))
    return tuple(ports)


def _unit(variable: Any) -> str:
    return str(variable.unit or (variable.declaredType and variable.declaredType.unit) or "")


def _held(port: Port, cells: Any) -> Setting:
    """A variable, set to what its cells hold."""
    _, _, width, kind, first = port.terminal
    return Setting(port.type, port.reference, tuple(cells.view(kind)[first : first + width].tolist()))


def _sample_time(contents: Contents, given: float | None) -> float:
    if given is not None:
        return given
    experiment = contents.description.defaultExperiment
    if experiment is None or not experiment.stepSize:
        raise FmuError(f"{contents.path} names no step of its own: give sample_time_s, in s")
    return float(experiment.stepSize)
