"""The machine code of kernels as it is kept, in words."""

from __future__ import annotations

import shutil
import subprocess
from tempfile import NamedTemporaryFile

import pytest

from seqsweep.plant.kernels import kept
from seqsweep.plant.kernels.compiled import Kernel, _kind


def instructions(kernel, *arguments):
    """The instructions of a kernel for such arguments, which it is called with; skips where they cannot be shown."""
    objdump = shutil.which("objdump") or pytest.skip("no objdump (binutils): machine code is not looked at")
    if not isinstance(kernel, Kernel):
        pytest.skip("nothing is compiled")
    kernel(*arguments)
    path = kept.path_of(kernel.py_func, kernel._options, ",".join(map(_kind, arguments)))
    _, code = kept.read(path) or ("", b"")
    assert code, f"{kernel.py_func.__name__} is not kept"
    with NamedTemporaryFile(suffix=".o") as file:
        file.write(code)
        file.flush()
        command = [objdump, "--disassemble", "--no-show-raw-insn", file.name]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout
