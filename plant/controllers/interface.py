"""A controller that nobody can look into, as a circuit needs it: memory, an address to call, states if it can.

Real-code libraries (`cigre`) and FMUs (`fmu_controller`) keep this promise; `grey_core` is the circuit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from .signal_map import Terminal

GUARD_BYTES = 4096
"""Before and behind everything that foreign code may write: what changes there was written out of bounds."""

GUARD = 0xFF
"""Eight of these are not a number: code that reads out of bounds shows it."""


class ControllerFault(Exception):
    """The controller refused, or broke its interface; the message says what it did."""


class Stretch:
    """Memory between two guards, aligned for every type.

    Attributes
    ----------
    address : int
        Where it begins.
    cells : (n,) uint8
        The bytes themselves, rounded up to whole doubles.
    """

    def __init__(self, what: str, n_bytes: int):
        self._what, self._n_bytes = what, n_bytes
        room = -(-n_bytes // 8) * 8
        self._all = np.full(room + 2 * GUARD_BYTES + 64, GUARD, np.uint8)
        self._first = GUARD_BYTES + -(self._all.ctypes.data + GUARD_BYTES) % 64
        self.cells = self._all[self._first : self._first + room]
        self.cells[:n_bytes] = 0
        self.address = self._all.ctypes.data + self._first

    def check(self) -> None:
        """Raise `ControllerFault` if anything around the memory was written."""
        outside = np.flatnonzero(self._all != GUARD) - self._first
        beyond = outside[(outside < 0) | (outside >= self._n_bytes)]
        if len(beyond):
            raise ControllerFault(
                f"the controller wrote out of bounds, {beyond[0]:+d} bytes from the start of its {self._what}, for "
                f"which it declares {self._n_bytes} bytes: a width or a type that it declares does not fit its code"
            )


class Sealed(Protocol):
    """A controller, ready to be started.

    Attributes
    ----------
    input_terminals, output_terminals : tuple of Terminal
        Its ports.
    inputs, outputs : Stretch
        Their memory.
    time : (1,) float
        Where it reads the time (s).
    addresses : (2,) int64
        Of its function and of that function's argument. The function returns 0 (fine), 1 (there is a
        message) or anything else (it refuses).
    """

    input_terminals: tuple[Terminal, ...]
    output_terminals: tuple[Terminal, ...]
    inputs: Stretch
    outputs: Stretch
    time: np.ndarray
    addresses: np.ndarray

    def renewed(self) -> Sealed:
        """The controller for the next run: this one, or another of its kind."""
        ...

    def start(self) -> None:
        """First calls of a run, at time zero; inputs and outputs already hold their initial values."""
        ...

    def memory(self) -> Any:
        """Everything it declares it remembers, as it is now; None where it declares nothing."""
        ...

    def restore(self, memory: Any) -> None:
        """Back to a moment of the past, as far as it declares what it remembers."""
        ...

    def check(self) -> None:
        """Raise `ControllerFault` if it broke its interface."""
        ...

    def refusal(self) -> Exception:
        """Why its function refused."""
        ...


class Offer(NamedTuple):
    """A controller that was read, but not started.

    Attributes
    ----------
    open : callable
        Makes a `Sealed`; can be pickled.
    open_copy : callable
        The same, with code and statics of its own.
    states : str
        How its states can be kept beside fork and copy: "arrays" that it declares, its own "snapshots", or "".
    sample_time_s : float
        How often it is called (s).
    contents : mapping
        What tells it from the next one under the same name.
    folder : str, optional
        Where it was unpacked, to be removed when it is not needed any more.
    """

    open: Callable[[], Sealed]
    open_copy: Callable[[], Sealed]
    states: str
    sample_time_s: float
    contents: Mapping[str, str]
    folder: str | None = None
