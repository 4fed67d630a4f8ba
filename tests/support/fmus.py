"""FMUs that the tests build from ``boxes/box_fmu.c`` with the system's compiler."""

from __future__ import annotations

import functools
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from .descriptions import Variable
from .descriptions import description as described

SOURCE = Path(__file__).parent / "boxes" / "box_fmu.c"

_PARAMETERS = {"p_w": 0.0, "fault": 0.0, "after_s": 0.0, "k_pll": 0.5}

VARIABLES = [
    *(Variable(f"v_{phase}", k, "input") for k, phase in enumerate("abc")),
    *(Variable(f"i_{phase}", 3 + k, "output", start=None) for k, phase in enumerate("abc")),
    *(Variable(name, 6 + k, "parameter", "fixed", start) for k, (name, start) in enumerate(_PARAMETERS.items())),
    Variable("v_alpha", 10, "input"),
    Variable("v_beta", 11, "input"),
    Variable("i_alpha", 12, "output", start=None),
    Variable("i_beta", 13, "output", start=None),
]

ARRAYS = [Variable("v_abc", 20, "input", width=3), Variable("i_abc", 23, "output", start=None, width=3)]
"""What FMI 3.0 has besides."""

PARAMETERS = {
    "dt_s": 50e-6,
    "voltage_v": 690.0,
    "power_va": 1e6,
    "voltage": ["v_a", "v_b", "v_c"],
    "current": ["i_a", "i_b", "i_c"],
    "active_power": "p_w",
    "active_power_w": [-1e9, 1e9],
}
"""How `fmu_plant` is told which variable is what."""


def compiler():
    """The system's C compiler and the headers of FMI; skips the test where one of them is missing."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        pytest.skip("no C compiler: the FMUs of the tests cannot be built")
    fmpy = pytest.importorskip("fmpy", reason="the extra 'fmu' is not installed")
    return found, Path(fmpy.__file__).parent / "c-code"


@functools.cache
def library(folder, defines):
    """The shared library of the box, compiled with ``defines``."""
    cc, _ = compiler()
    library = Path(folder) / f"box-{'-'.join(defines) or 'plain'}.so"
    flags = [
        "-O2",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wno-unused-parameter",
        "-shared",
        "-fPIC",
        *[f"-D{d}" for d in defines],
    ]
    subprocess.run([cc, *flags, "-o", library, SOURCE, "-lm"], check=True)
    return library


def description(state=False, version="2.0", **attributes):
    """The text of a modelDescription.xml."""
    variables = VARIABLES if version == "2.0" else [*VARIABLES, *ARRAYS]
    return described("box", variables, state, version, **attributes)


def fmu(folder, *defines, name="box.fmu"):
    """An FMU in ``folder``, compiled with ``defines``, of the version 3.0 with FMI3; its path."""
    path = Path(folder) / name
    version, platform = ("3.0", "x86_64-linux") if "FMI3" in defines else ("2.0", "linux64")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description("STATE" in defines, version))
        archive.write(library(str(folder), defines), f"binaries/{platform}/box.so")
    return path
