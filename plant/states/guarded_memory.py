"""Memory that foreign code is given to write to, between two guards that show when it wrote beyond."""

from __future__ import annotations

import numpy as np

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
        self._around = self._all[: self._first], self._all[self._first + n_bytes :]
        self._untouched = tuple(part.tobytes() for part in self._around)
        self.cells[:n_bytes] = 0
        self.address = self._all.ctypes.data + self._first

    def check(self) -> None:
        """Raise `ControllerFault` if anything around the memory was written."""
        if tuple(part.tobytes() for part in self._around) == self._untouched:
            return
        outside = np.flatnonzero(self._all != GUARD) - self._first
        beyond = outside[(outside < 0) | (outside >= self._n_bytes)]
        if len(beyond):
            raise ControllerFault(
                f"the controller wrote out of bounds, {beyond[0]:+d} bytes from the start of its {self._what}, for "
                f"which it declares {self._n_bytes} bytes: a width or a type that it declares does not fit its code"
            )
