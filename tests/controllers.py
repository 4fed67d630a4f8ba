"""Real-code controllers of our own, built with the system's compiler: sources in `boxes/`."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
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


def build(*switches: str) -> Path:
    """The turbine's controls as a library, built with ``-D`` switches; once a test run."""
    return _compiled(SOURCE, "controller", switches)


@cache
def _compiled(source: Path, stem: str, switches: tuple[str, ...], *flags: str) -> Path:
    assert COMPILER is not None
    name = "-".join([stem, *switches]).replace("=", "_").lower()
    path = Path(_folder.name) / f"{name}.so"
    defines = [f"-D{switch}" for switch in switches]
    command = [COMPILER, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", *flags, *defines, "-o", path, source, "-lm"]
    subprocess.run(command, check=True)
    return path


def build_fmu(*switches: str) -> Path:
    """The same controls as an FMU, of the version 3.0 with the switch FMI3; once a test run."""
    return _fmu(switches, _description("FMI3" in switches, "STATE" in switches, "FAULT_WIDTH" in switches))


INPUTS_2 = {
    **{f"v_{phase}": f"v_pcc_{phase}" for phase in "abc"},
    **{f"i_{phase}": f"i_l_{phase}" for phase in "abc"},
    "v_dc": "v_dc",
    "v_dc_ref": 1200.0,
}
OUTPUTS_2 = {f"u_{phase}": f"v_conv_{phase}" for phase in "abc"}
"""The signal map of an FMU after FMI 2.0, which has no arrays; one after FMI 3.0 has the ports of a library."""

_PARAMETERS = ("Kpp", "Kpi", "Kp", "Ki", "Krd", "Kdcp", "Kdci", "Imax", "Lead")


@cache
def _fmu(switches: tuple[str, ...], description: str) -> Path:
    headers = Path(pytest.importorskip("fmpy", reason="the extra 'fmu' is not installed").__file__).parent / "c-code"
    library = _compiled(SOURCE.with_name("turbine_fmu.c"), "fmu", switches, f"-I{headers}")
    path = library.with_suffix(".fmu")
    platform = "x86_64-linux" if "FMI3" in switches else "linux64"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{platform}/controller.so")
    return path


def _description(third: bool, state: bool, narrow: bool) -> str:
    """The text of a modelDescription.xml; a ``narrow`` one declares two phases where the code writes three."""
    real, whole = ("Float64", "Int32") if third else ("Real", "Integer")
    phases = [("", 3)] if third else [("_a", 1), ("_b", 1), ("_c", 1)]
    names = [("v", 0, "V"), ("i", 3, "A")]
    inputs = [(f"{n}_abc" if third else n + p, r + k, u, w) for n, r, u in names for k, (p, w) in enumerate(phases)]
    outputs = [("v_conv_abc" if third else f"u{p}", 8 + k, "V", w) for k, (p, w) in enumerate(phases)]
    told = [*inputs, ("v_dc", 6, "V", 1), ("v_dc_ref", 7, "V", 1)]
    variables = [_variable(third, real, *port, "input", "continuous", "") for port in told]
    variables += [
        _variable(third, real, name, reference, unit, 2 if narrow else width, "output", "continuous", "exact")
        for name, reference, unit, width in outputs
    ]
    variables += [
        _variable(third, "Boolean", "limited", 11, None, 1, "output", "discrete", "calculated"),
        _variable(third, real, "angle", 12, "rad", 1, "output", "continuous", "calculated"),
        *(
            _variable(third, real, name, 20 + k, None, 1, "parameter", "fixed", "exact")
            for k, name in enumerate(_PARAMETERS)
        ),
        _variable(third, whole, "Delay", 29, None, 1, "parameter", "fixed", "exact"),
        _variable(third, real, "FaultTime", 30, None, 1, "parameter", "fixed", "exact"),
    ]
    flag = f'canGetAndSetFMU{"S" if third else "s"}tate="{str(state).lower()}"'
    n_in, n_out = len(told), len(outputs) + 2
    references = [*(port[1] for port in outputs), 11, 12]
    if third:
        head = 'fmiVersion="3.0" instantiationToken="{4712}"'
        structure = "".join(f'<Output valueReference="{r}"/>' for r in references)
    else:
        head = 'fmiVersion="2.0" guid="{4712}"'
        unknowns = "".join(f'<Unknown index="{n_in + 1 + k}"/>' for k in range(n_out))
        initial = "".join(f'<Unknown index="{n_in + 1 + k}"/>' for k in range(n_out - 2, n_out))
        structure = f"<Outputs>{unknowns}</Outputs><InitialUnknowns>{initial}</InitialUnknowns>"
    units = "".join(f'<Unit name="{unit}"/>' for unit in ("V", "A", "rad"))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {head} modelName="controller" version="1.0">'
        f'<CoSimulation modelIdentifier="controller" {flag}/><UnitDefinitions>{units}</UnitDefinitions>'
        f'<DefaultExperiment startTime="0" stepSize="20e-6"/><ModelVariables>{"".join(variables)}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def _variable(third, kind, name, reference, unit, width, causality, variability, initial):
    """One variable, as either version writes it."""
    about = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    about += f' initial="{initial}"' if initial else ""
    start = "" if initial == "calculated" else f' start="{" ".join(["0"] * width)}"'
    start += f' unit="{unit}"' if unit else ""
    if not third:
        return f"<ScalarVariable {about}><{kind}{start}/></ScalarVariable>"
    dimension = f'<Dimension start="{width}"/>' if width > 1 else ""
    return f"<{kind} {about}{start}>{dimension}</{kind}>"
