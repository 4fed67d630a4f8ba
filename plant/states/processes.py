"""How processes end: with the one that started them, and with what last words."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36


def die_with_parent(parent: int) -> None:
    """Ask Linux to end this process with process ``parent``, even while it is deep in native code."""
    if sys.platform == "linux":
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it was gone before it was asked
            os._exit(1)


def adopt_orphans() -> None:
    """Ask Linux to make this process the parent of descendants whose own parent ends."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def how_it_ended(code: int, said: Path | None = None) -> str:
    """An exit code in words (a signal is negative), with the last words left in a file."""
    how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
    words = last_words(said) if said is not None else ""
    return f"{how}, last words {words!r}" if words else how


def last_words(path: Path) -> str:
    """The last line that a process left in a file, shortened."""
    with suppress(OSError), path.open("rb") as said:
        said.seek(max(0, said.seek(0, os.SEEK_END) - 4096))
        words = said.read().decode(errors="replace").strip().splitlines()
        return words[-1][:200] if words else ""
    return ""


def _prctl(option: int, value: int) -> None:
    import ctypes

    ctypes.CDLL(None).prctl(option, value)
