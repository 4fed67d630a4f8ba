"""Real-code controllers of our own, built with the system's compiler: sources in `boxes/`."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import time
import zipfile
from functools import cache
from pathlib import Path

import pytest

from .descriptions import Variable, description

SOURCE = Path(__file__).parent / "boxes" / "turbine_controller.c"
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc, clang): boxes cannot be built")

INPUTS = {"v_abc": "v_pcc_abc", "i_abc": "i_l_abc", "v_dc": "v_dc", "v_dc_ref": 1200.0}
OUTPUTS = {"v_conv_abc": "v_conv_abc"}
"""The signal map of every build."""

_folder = tempfile.TemporaryDirectory(prefix="seqsweep-boxes-")


def build(*switches: str) -> Path:
    """The turbine's controls as a library, built with ``-D`` switches; once a test run."""
    return _compiled(SOURCE, "controller", *switches)


@cache
def _compiled(source: Path, stem: str, *switches: str) -> Path:
    assert COMPILER is not None
    name = "-".join([stem, *switches]).replace("=", "_").lower()
    path = Path(_folder.name) / f"{name}.so"
    defines = [f"-D{switch}" for switch in switches]
    command = [COMPILER, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", *defines, "-o", path, source, "-lm"]
    subprocess.run(command, check=True)
    return path


INPUTS_2 = {
    **{f"v_{phase}": f"v_pcc_{phase}" for phase in "abc"},
    **{f"i_{phase}": f"i_l_{phase}" for phase in "abc"},
    "v_dc": "v_dc",
    "v_dc_ref": 1200.0,
}
OUTPUTS_2 = {f"u_{phase}": f"v_conv_{phase}" for phase in "abc"}
"""The signal map of an FMU after FMI 2.0, which has no arrays; one after FMI 3.0 has the ports of a library."""


DEFAULTS = {
    "Kpp": 0.085,
    "Kpi": 32.0,
    "Kp": 0.25,
    "Ki": 355.0,
    "Krd": 0.0471,
    "Kdcp": 0.5,
    "Kdci": 5.0,
    "Imax": 2838.26,
    "Lead": 0.5,
}


def build_fmu(*switches: str) -> Path:
    """The same controls as an FMU, of the version 3.0 with the switch FMI3; once a test run."""
    pytest.importorskip("fmpy", reason="the extra 'fmu' is not installed")
    return _fmu(*switches)


@cache
def _fmu(*switches: str) -> Path:
    library = _compiled(SOURCE.with_name("turbine_fmu.c"), "fmu", *switches)
    third = "FMI3" in switches
    about = {"state": "STATE" in switches, "version": "3.0" if third else "2.0", "step_s": 20e-6}
    path = library.with_suffix(".fmu")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description("controller", _variables(third, switches), **about))
        archive.write(library, f"binaries/{'x86_64-linux' if third else 'linux64'}/controller.so")
    return path


def _variables(third: bool, switches: tuple[str, ...]) -> list[Variable]:
    """Those of `boxes/turbine_fmu.c`; FAULT_WIDTH declares two phases where the code writes three, COLD outputs that
    cannot be set."""
    phases = [("_abc", 3)] if third else [("_a", 1), ("_b", 1), ("_c", 1)]
    told = [
        Variable(name + phase, first + k, "input", unit=unit, width=width)
        for name, first, unit in (("v", 0, "V"), ("i", 3, "A"))
        for k, (phase, width) in enumerate(phases)
    ]
    start, initial = (None, "calculated") if "COLD" in switches else (0.0, "exact")
    given = [
        Variable(("v_conv" if third else "u") + phase, 8 + k, "output", "continuous", start, initial, "V", width)
        for k, (phase, width) in enumerate(phases)
    ]
    if "FAULT_WIDTH" in switches:
        given = [variable._replace(width=2) for variable in given]
    return [
        *told,
        Variable("v_dc", 6, "input", unit="V"),
        Variable("v_dc_ref", 7, "input", unit="V"),
        *given,
        Variable("limited", 11, "output", "discrete", None, "calculated", kind="truth"),
        Variable("angle", 12, "output", "continuous", None, "calculated", "rad"),
        *(Variable(name, 20 + k, "parameter", "fixed", v, "exact") for k, (name, v) in enumerate(DEFAULTS.items())),
        Variable("Delay", 29, "parameter", "fixed", initial="exact", kind="whole"),
        Variable("FaultTime", 30, "parameter", "fixed", 1e30, "exact"),
    ]


def build_inverter(*switches: str) -> Path:
    """The controls of `boxes/inverter_controller.c` as a library: following, FORMING or BATTERY; once a test run."""
    return _compiled(SOURCE.with_name("inverter_controller.c"), "inverter", *switches)


FOLLOWING_MAP = {
    "inputs": {
        **{f"Vt{phase}": f"v_f_{phase}" for phase in "abc"},
        **{f"I1{phase}": f"i_l_{phase}" for phase in "abc"},
        **{f"I2{phase}": f"i_g_{phase}" for phase in "abc"},
        "Idc": "i_dc",
        "VdcMPPT": 1.2,
        "Pref": {"signal": "p_ref", "base": 1e6},
        "Qref": {"signal": "q_ref", "base": 1e6},
        "Vdc_meas": "v_dc",
        "Vref": {"signal": "v_ref", "base": 600.0},
    },
    "outputs": {f"m_{phase}": f"m_conv_{phase}" for phase in "abc"},
}
FORMING_MAP = {
    "inputs": {
        **{f"V{phase}": f"v_f_{phase}" for phase in "abc"},
        **{f"I{phase}": f"i_g_{phase}" for phase in "abc"},
        **{f"I{phase}L1": f"i_l_{phase}" for phase in "abc"},
        "Pref": "p_ref",
        "Qref": "q_ref",
        "Vref": {"signal": "v_ref", "base": 600.0},
    },
    "outputs": {f"E{phase}": f"v_conv_{phase}" for phase in "abc"},
}
BATTERY_MAP = {
    "inputs": {
        "v_ac": "v_f_abc",
        "i_L": "i_l_abc",
        "v_dc": "v_dc",
        "enable": 1,
        "P_request": "p_ref",
        "Q_request": "q_ref",
        "P_lim_high": 1.2e6,
        "P_lim_low": -1.2e6,
    },
    "outputs": {"v_bridge": "v_conv_abc", "pwm_enable": "gate"},
}
INVERTER_CIRCUIT = {
    "u_rated_v": 600.0,
    "s_rated_va": 1e6,
    "f1_hz": 60.0,
    "l_f_h": 1e-4,
    "r_f_ohm": 1.7e-3,
    "c_f_f": 3e-4,
    "r_c_ohm": 0.03,
    "l_g_h": 5e-5,
    "r_g_ohm": 2e-3,
    "c_dc_f": 1e9,
    "v_dc_ref_v": 1200.0,
}


def alone_us(function, argument, n_steps):
    """Price of one bare call from a compiled loop (us)."""
    from numba import njit

    call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(ctypes.cast(function, ctypes.c_void_p).value)

    @njit
    def loop(argument, n):
        for _ in range(n):
            call(argument)

    loop(argument, 1)
    begun = time.process_time()
    loop(argument, n_steps)
    return (time.process_time() - begun) / n_steps * 1e6
