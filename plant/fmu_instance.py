"""One instance of an FMI 2.0 co-simulation FMU, stepped by a compiled loop over its functions.

For a whole device see `fmu`; a controller is stepped row by row, or by a kernel of its own through the addresses.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from .branches import BoxLost

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_FATAL = 4
_CALLS = ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal")


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


def warm() -> None:
    """Have the kernel ready before anything is forked."""
    from .kernels import fmi2

    none = np.empty((0, 1))
    fmi2.advance((0, 0, 0), 0, np.empty(1, np.uint32), np.empty(1, np.uint32), 0, 1.0, np.int32(0), none, none)


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
