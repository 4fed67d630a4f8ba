"""One instance of an FMU for co-simulation, stepped by compiled code through the addresses of its functions.

For a whole device see `fmu.device`, for a controller in the turbine's circuit `controllers.fmu`.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..states.guarded_memory import Stretch
from ..states.store import BoxLost
from .archive import unpack
from .variables import Contents, Group, Setting, laid_out, n_bytes
from .versions import VERSIONS

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_FATAL = 4


class FmuFault(RuntimeError):
    """An FMU that gave up on the way; the message says in which call, and its own last message."""


class FmuLost(FmuFault, BoxLost):
    """A fatal answer: the standard allows no further call."""


class Model(NamedTuple):
    """An unpacked FMU: everything it takes to make an instance, in any process.

    Attributes
    ----------
    folder, guid, identifier : str
        Where it was unpacked; what its description says of it.
    version : int
        Of the standard, its first number.
    inputs, outputs : tuple of Group
        What is set and read in every step.
    n_input_bytes, n_output_bytes : int
        Memory that these take.
    before : tuple of Setting
        What is set before every start.
    dt_s : float
        Communication step (s).
    can_go_back : bool
        Whether its own get and set of the state are used.
    needs : str
        The tool that must be there for it to run; nothing for a self-contained FMU.
    """

    folder: str
    guid: str
    identifier: str
    version: int
    inputs: tuple[Group, ...]
    outputs: tuple[Group, ...]
    n_input_bytes: int
    n_output_bytes: int
    before: tuple[Setting, ...]
    dt_s: float
    can_go_back: bool
    needs: str


def unpacked(
    contents: Contents,
    inputs: Sequence[Any],
    outputs: Sequence[Any],
    before: Sequence[Setting],
    dt_s: float,
    can_go_back: bool,
) -> Model:
    """The FMU in a new folder, which is the caller's to remove; ``inputs`` and ``outputs`` are variables (fmpy's).

    Raises
    ------
    ArchiveError
        If something in it is not fit to be unpacked.
    """
    told, given = laid_out(contents, inputs)[0], laid_out(contents, outputs)[0]
    folder = tempfile.mkdtemp(prefix="fmu-")
    unpack(contents.path, Path(folder))
    return Model(
        folder,
        contents.description.guid,
        contents.description.coSimulation.modelIdentifier,
        contents.version,
        told,
        given,
        n_bytes(contents, told),
        n_bytes(contents, given),
        tuple(before),
        float(dt_s),
        can_go_back,
        contents.needs,
    )


class Instance:
    """One instance of an FMU.

    Parameters
    ----------
    model : Model
        The FMU; it is loaded into this process at its first start.

    Attributes
    ----------
    inputs, outputs : Stretch
        Memory of what is set and read in every step.
    time : (1,) float
        Time (s) at the beginning of the next step.
    addresses : (2,) int64
        Of a function that sets, steps and gets, and of its argument: 0 or 1 is well, see `Sealed`.
    """

    def __init__(self, model: Model):
        from ..kernels import fmi

        self._model, self._version = model, VERSIONS[model.version]
        self._slave: Any = None
        self._messages: list[str] = []
        self.inputs, self.outputs = Stretch("inputs", model.n_input_bytes), Stretch("outputs", model.n_output_bytes)
        self._references = [np.array(group.references, np.uint32) for group in (*model.inputs, *model.outputs)]
        self._calls = [
            f"{verb}{self._version.types[group.type].called}"
            for verb, groups in (("Set", model.inputs), ("Get", model.outputs))
            for group in groups
        ]
        self._block = np.zeros(fmi.N_CELLS, np.int64)
        times = self._block.view(np.float64)
        times[fmi.STEP_SIZE] = model.dt_s
        self.time = times[fmi.TIME : fmi.TIME + 1]
        self.addresses = np.array([fmi.step_of(model.version), self._block.ctypes.data], np.int64)

    def start(self, before: Sequence[Setting] = (), within: Sequence[Setting] = ()) -> None:
        """Begin at time zero with the start values of the model, and more set ``before`` and ``within`` initialization.

        Raises
        ------
        FmuFault
            If a call is not answered by ok or a warning.
        """
        from ..kernels import fmi

        try:
            slave = self._slave = self._slave or self._loaded()
            if slave.component is None:
                self._version.instantiate(slave, self._messages)
            else:
                slave.reset()
            self._set((*self._model.before, *before))
            self._version.initialize(slave)
            self._set(within)
            slave.exitInitializationMode()
        except Exception as error:
            needs = f"; it needs {self._model.needs}, installed or running" if self._model.needs else ""
            raise FmuFault(
                f"the FMU does not start: {' '.join(str(error).split())}{self._last_message()}{needs}"
            ) from None
        self._block[fmi.INSTANCE] = int(slave.component)
        self.time[0] = 0.0

    def check(self) -> None:
        """Raise `ControllerFault` if it wrote beyond the widths that it declares."""
        self.inputs.check()
        self.outputs.check()

    def failure(self) -> FmuFault:
        """Why the last step ended early."""
        from ..kernels import fmi

        where, status = int(self._block[fmi.WHERE]), int(self._block[fmi.STATUS])
        when = f"at {self.time[0]:.6g} s{self._last_message()}"
        if where == fmi.END_ASKED:
            return FmuFault(f"the FMU asks for the end of the simulation {when}")
        call = f"{self._version.prefix}{'DoStep' if where == fmi.STEP else self._calls[where]}"
        answer = _STATUS[status] if status < len(_STATUS) else status
        return (FmuLost if status == _FATAL else FmuFault)(f"{call} answered {answer} {when}")

    def save(self) -> Any:
        """A snapshot, held by the FMU."""
        return getattr(self._slave, f"get{self._version.state}")()

    def load(self, snapshot: Any) -> None:
        """Be as it was when ``snapshot`` was taken."""
        getattr(self._slave, f"set{self._version.state}")(snapshot)

    def drop(self, snapshot: Any) -> None:
        """Give the snapshot back to the FMU."""
        getattr(self._slave, f"free{self._version.state}")(snapshot)

    def _loaded(self) -> Any:
        """The FMU in this process, and in the block the numbers that a step reads: `kernels.fmi`."""
        from ..kernels import fmi

        model, block = self._model, self._block
        slave = self._version.load(model.folder, model.guid, model.identifier)
        block[fmi.DO_STEP] = self._address(slave, "DoStep")
        block[fmi.NO_WAY_BACK] = not model.can_go_back
        block[fmi.N_SETS], block[fmi.N_GETS] = len(model.inputs), len(model.outputs)
        memories = [self.inputs.address] * len(model.inputs) + [self.outputs.address] * len(model.outputs)
        groups = (*model.inputs, *model.outputs)
        for k, (group, memory, references) in enumerate(zip(groups, memories, self._references, strict=True)):
            values = memory + group.first, group.n_values
            block[fmi.group(k)] = self._address(slave, self._calls[k]), references.ctypes.data, len(references), *values
        return slave

    def _address(self, slave: Any, call: str) -> int:
        function = getattr(slave.dll, f"{self._version.prefix}{call}")
        return ctypes.cast(function, ctypes.c_void_p).value or 0

    def _set(self, settings: Sequence[Setting]) -> None:
        for kind, reference, values in settings:
            name = self._version.enumeration if kind == "Enumeration" else kind
            getattr(self._slave, f"set{name}")([reference], list(values))

    def _last_message(self) -> str:
        return f"; it says: {self._messages[-1]}" if self._messages else ""


def warm() -> None:
    """Have the kernels ready before anything is forked."""
    from ..kernels import fmi

    nothing = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(lambda argument: 0)
    address, none = ctypes.cast(nothing, ctypes.c_void_p).value or 0, np.zeros(0)
    fmi.advance(address, 0, np.zeros(1), 0, 1.0, none, none, np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1, np.int64))
    for version in VERSIONS:
        fmi.step_of(version)
