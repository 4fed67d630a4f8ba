"""How processes end: with the one that started them, and with what last words."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_PR_GET_CHILD_SUBREAPER = 37


def die_with_parent(parent: int) -> None:
    """Ask Linux to end this process with process ``parent``, even while it is deep in native code."""
    if sys.platform == "linux":
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it was gone before it was asked
            os._exit(1)


def adopt_orphans() -> None:
    """Ask Linux to make this process the parent of descendants whose own parent ends."""
    _subreaper(True)


@contextmanager
def adopting_orphans() -> Iterator[None]:
    """While in the block, this process is the parent of descendants whose own parent ends (Linux)."""
    before = _is_subreaper()
    _subreaper(True)
    try:
        yield
    finally:
        _subreaper(before)


def bury(group: int, patience_s: float = 0.5) -> None:
    """Take note of the end of a killed process group's members, so that none stays as a zombie.

    Where the system's first process buries nobody, as in many containers, nobody else would.
    """
    end = time.monotonic() + patience_s
    with suppress(ProcessLookupError, PermissionError):
        while time.monotonic() < end:
            os.killpg(group, 0)  # somebody of the group is there, if only as a zombie
            with suppress(ChildProcessError):  # not ours yet: its parent is just ending
                os.waitpid(-group, os.WNOHANG)
            time.sleep(0.001)


def most_memory_mb(group: int) -> float:
    """Resident memory (MB) of that process of a group which has most of it; 0 where the system does not tell."""
    return max((_resident_mb(process) for process in _members(group)), default=0.0)


def _members(group: int) -> Iterator[Path]:
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getpgid(int(process.name)) == group:
                yield process


def _resident_mb(process: Path) -> float:
    with suppress(OSError):
        return int((process / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return 0.0


def has_ended(pid: int) -> bool:
    """Whether a process is gone, or only waits to be taken note of (Linux)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in ("Z", "X")
    except OSError:
        return True


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


def _subreaper(wished: bool) -> None:
    if sys.platform == "linux":
        _prctl(_PR_SET_CHILD_SUBREAPER, int(wished))


def _is_subreaper() -> bool:
    if sys.platform != "linux":
        return False
    import ctypes

    answer = ctypes.c_int(0)
    _prctl(_PR_GET_CHILD_SUBREAPER, ctypes.byref(answer))
    return bool(answer.value)


def _prctl(option: int, value: Any) -> None:
    import ctypes

    ctypes.CDLL(None).prctl(option, value)
