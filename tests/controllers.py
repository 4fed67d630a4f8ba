"""Real-code controllers of our own, built with the system's compiler: sources in `boxes/`."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent / "boxes" / "turbine_controller.c"
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc, clang): boxes cannot be built")

INPUTS = {"v_abc": "v_pcc_abc", "i_abc": "i_l_abc", "v_dc": "v_dc", "v_dc_ref": 1200.0}
OUTPUTS = {"v_conv_abc": "v_conv_abc"}
"""The signal map of every build."""

_folder = tempfile.TemporaryDirectory(prefix="seqsweep-boxes-")


@cache
def build(*switches: str) -> Path:
    """The turbine's controls as a library, built with ``-D`` switches; once a test run."""
    assert COMPILER is not None
    name = "-".join(["controller", *switches]).replace("=", "_").lower()
    path = Path(_folder.name) / f"{name}.so"
    defines = [f"-D{switch}" for switch in switches]
    command = [COMPILER, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", *defines, "-o", str(path), str(SOURCE), "-lm"]
    subprocess.run(command, check=True)
    return path
