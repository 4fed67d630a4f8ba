"""A controller that nobody can look into, as a circuit needs it: memory, an address to call, states if it can.

Real-code libraries (`cigre`) and FMUs (`controllers.fmu`) keep this promise; `greybox.stepping` is the circuit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..states.guarded_memory import ControllerFault, Stretch
from .signal_map import Terminal

__all__ = ["ControllerFault", "Offer", "Sealed", "Stretch"]


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
