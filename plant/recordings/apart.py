"""`read_recording` in a process of its own: what a damaged file does to its reader happens there.

The process keeps the file open; samples are read when they are asked for, as they are in this process, and come back
through memory that both see.
"""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SeqsweepError
from ..foreign import sandbox
from .read import check_file, read_recording
from .recording import Recording, RecordingError, Samples

_HERE = __name__


def read_recording_apart(path: str | Path, *, sample_rate_hz: float | None = None) -> Recording:
    """As `read_recording`; a crash, a hang or an outgrown memory of the reader is a `RecordingError` too."""
    path = Path(path)
    check_file(path, sample_rate_hz)
    remote = _Remote(path)
    try:
        recording: Recording = remote.ask("open_here", str(remote.absolute), sample_rate_hz)
    except BaseException:
        remote.close()
        raise
    samples = _samples(remote)
    weakref.finalize(samples, remote.close)
    return replace(recording, path=path, samples=samples)


class _Remote:
    """A process that holds one recording open."""

    def __init__(self, path: Path):
        self.path, self.absolute = path, path.absolute()
        self._process: sandbox.Sandbox | None = sandbox.borrow()

    def ask(self, function: str, *arguments: Any) -> Any:
        if self._process is None:
            raise RecordingError(f"{self.path}: its reader has ended")
        try:
            return self._process.ask(self.absolute, f"{_HERE}:{function}", *arguments)
        except SeqsweepError as error:
            raise RecordingError(str(error).replace(str(self.absolute), str(self.path))) from None

    def read(self, columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        """Samples (stop - start, columns), as many at a time as the shared memory holds."""
        found = np.empty((stop - start, len(columns)))
        rows = max(1, sandbox.SHARED_BYTES // (8 * max(1, len(columns))))
        for first in range(start, stop, rows):
            last = min(first + rows, stop)
            self.ask("samples_here", [int(k) for k in columns], first, last)
            assert self._process is not None
            shared = np.frombuffer(self._process.shared, dtype=float, count=(last - first) * len(columns))
            found[first - start : last - start] = shared.reshape(last - first, len(columns))
        return found

    def close(self) -> None:
        """Give the process to the next file."""
        process, self._process = self._process, None
        if process is not None:
            sandbox.give_back(process)


def _samples(remote: _Remote) -> Samples:
    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return remote.read(columns, start, stop)

    return samples


# In the process

_opened: Recording | None = None


def open_here(path: str, sample_rate_hz: float | None) -> Recording:
    """Open a recording and keep it; the one before is closed. Its samples stay here."""
    global _opened
    _opened = None
    recording = read_recording(path, sample_rate_hz=sample_rate_hz)
    _opened = recording
    return replace(recording, samples=_not_here)


def samples_here(columns: Sequence[int], start: int, stop: int) -> None:
    """Put samples of the open recording into the shared memory."""
    assert _opened is not None
    values = _opened.samples(columns, start, stop)
    np.frombuffer(sandbox.shared, dtype=float, count=values.size)[:] = values.ravel()


def _not_here(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
    raise AssertionError("samples are read in the process that opened the file")
