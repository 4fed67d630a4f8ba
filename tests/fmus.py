"""FMUs that the tests build from ``boxes/box_fmu.c`` with the system's compiler."""

from __future__ import annotations

import functools
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent / "boxes" / "box_fmu.c"

VARIABLES = [
    *[(f"v_{phase}", "input", "continuous", 0.0) for phase in "abc"],
    *[(f"i_{phase}", "output", "continuous", None) for phase in "abc"],
    ("p_w", "parameter", "fixed", 0.0),
    ("fault", "parameter", "fixed", 0.0),
    ("after_s", "parameter", "fixed", 0.0),
    ("k_pll", "parameter", "fixed", 0.5),
    ("v_alpha", "input", "continuous", 0.0),
    ("v_beta", "input", "continuous", 0.0),
    ("i_alpha", "output", "continuous", None),
    ("i_beta", "output", "continuous", None),
]

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
    cc, headers = compiler()
    library = Path(folder) / f"box-{'-'.join(defines) or 'plain'}.so"
    flags = [
        "-O2",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wno-unused-parameter",
        "-shared",
        "-fPIC",
        f"-I{headers}",
        *[f"-D{d}" for d in defines],
    ]
    subprocess.run([cc, *flags, "-o", library, SOURCE, "-lm"], check=True)
    return library


def description(state=False, version="2.0", interface="CoSimulation", **attributes):
    """The text of a modelDescription.xml."""
    flags = {"canGetAndSetFMUstate": str(state).lower(), "modelIdentifier": "box", **attributes}
    written = " ".join(f'{name}="{value}"' for name, value in flags.items())
    variables = []
    for reference, (name, causality, variability, start) in enumerate(VARIABLES):
        real = "<Real/>" if start is None else f'<Real start="{start}"/>'
        variables.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}">{real}</ScalarVariable>'
        )
    outputs = [k + 1 for k, variable in enumerate(VARIABLES) if variable[1] == "output"]
    unknowns = "".join(f'<Unknown index="{k}"/>' for k in outputs)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{version}" modelName="box" '
        f'guid="{{4711}}" version="3"><{interface} {written}/><ModelVariables>{"".join(variables)}</ModelVariables>'
        f"<ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>"
        "</fmiModelDescription>"
    )


def fmu(folder, *defines, name="box.fmu", platform="linux64"):
    """An FMU in ``folder``, compiled with ``defines``; its path."""
    path = Path(folder) / name
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(state="STATE" in defines))
        archive.write(library(str(folder), defines), f"binaries/{platform}/box.so")
    return path
