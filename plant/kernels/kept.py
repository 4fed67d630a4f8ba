"""Files of compiled kernels: where the code of one is kept, under which key, and that one process makes it.

The key is the kernel's source file and those it takes something from, its options, the kinds of its arguments, the
processor, the versions of Python, numba and llvmlite, and numba's settings in the environment. A file holds its own
check sum: one that is damaged is made anew.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

_MAGIC = b"seqsweep kernel 1\n"
_KEPT_PER_KERNEL = 8
"""Files of one kernel in a folder: of several processors, kinds of arguments, work trees. The oldest give way."""

_PATIENCE_S = 300.0
"""How long (s) a process waits for another one that compiles the same kernel."""

_MAKERS = "compiled.py", "compiler.py", "kept.py"
"""The files that every kernel's code depends on."""

_WITHOUT_MEANING = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")
"""Settings of numba that do not change the code."""


def path_of(function: Callable[..., Any], options: dict[str, Any], kinds: str) -> Path | None:
    """Where the code is or will be; None if the source cannot be read."""
    source = Path(function.__code__.co_filename)
    try:
        text = text_of(source)
    except OSError:
        return None
    settings = sorted((name, sorted(v) if isinstance(v, set) else v) for name, v in options.items())
    told = repr((function.__qualname__, settings, kinds, machine()))
    key = hashlib.sha256(text + told.encode()).hexdigest()[:24]
    return _folder(source) / f"{source.stem}.{function.__qualname__}-{key}.kernel"


def text_of(source: Path) -> bytes:
    """The source file, and those beside it that it takes something from, theirs included."""
    return b"".join(path.read_bytes() for path in _sources(source))


def is_whole(source: Path) -> bool:
    """Whether a file takes nothing from others but the decorators of `compiled`."""
    return {path.name for path in _sources(source)} <= {source.name, *_MAKERS}


def _sources(source: Path) -> list[Path]:
    found = [source]
    for path in found:
        others = sorted(set(re.findall(rb"^ *from \.(\w+) import", path.read_bytes(), re.MULTILINE)))
        beside = (path.with_name(f"{other.decode()}.py") for other in others)
        found += [other for other in beside if other not in found]
    return found


@functools.cache
def machine() -> tuple[Any, ...]:
    """What code depends on beside its source."""
    import llvmlite
    import llvmlite.binding as llvm

    spec = importlib.util.find_spec("numba")
    version = Path(spec.origin).with_name("_version.py").read_text("utf-8") if spec and spec.origin else ""
    settings = sorted(
        (name, value)
        for name, value in os.environ.items()
        if name.startswith("NUMBA_") and name not in _WITHOUT_MEANING
    )
    processor = llvm.get_default_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    return (*processor, llvmlite.__version__, version, sys.version_info[:2], settings)


def _folder(source: Path) -> Path:
    """Numba's folder if one is set, else the one of the compiled Python, else the user's."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen) / "seqsweep"
    beside = source.parent / "__pycache__"
    if os.access(beside if beside.exists() else source.parent, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "seqsweep"


def read(path: Path) -> tuple[str, bytes] | None:
    """Name and object code; None if there is none or it is damaged."""
    try:
        held = path.read_bytes()
    except OSError:
        return None
    magic, digest, rest = held[: len(_MAGIC)], held[len(_MAGIC) :][:32], held[len(_MAGIC) + 32 :]
    if magic != _MAGIC or hashlib.sha256(rest).digest() != digest:
        return None
    name, _, code = rest.partition(b"\n")
    return json.loads(name), code


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """No two processes make the same file at once; where locks are not to be had, or not within `_PATIENCE_S`, they do.

    The lock goes with the process that holds it, however that ends.
    """
    beside = path.with_name(f"{path.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = beside.open("w")
    except OSError:
        yield
        return
    with lock:
        _lock_within(lock, _PATIENCE_S)
        try:
            yield
        finally:
            with suppress(OSError):
                beside.unlink()  # who waits for it holds it open


def _lock_within(file: IO[str], patience_s: float) -> None:
    with suppress(ImportError):  # Linux and its relatives have it
        import fcntl

        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            try:
                return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(0.02)
            except OSError:
                return None


def write(path: Path, name: str, code: bytes) -> tuple[str, bytes]:
    """Keep code if the disk lets us; it works without."""
    rest = json.dumps(name).encode() + b"\n" + code
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, unfinished = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_MAGIC + hashlib.sha256(rest).digest() + rest)
            os.replace(unfinished, path)
        except BaseException:
            with suppress(OSError):
                os.unlink(unfinished)
            raise
        _forget_oldest(path)
    return name, code


def _forget_oldest(path: Path) -> None:
    stem = path.name.rpartition("-")[0]
    kept = sorted(path.parent.glob(f"{stem}-*.kernel"), key=lambda file: file.stat().st_mtime)
    for file in kept[:-_KEPT_PER_KERNEL]:
        file.unlink(missing_ok=True)
