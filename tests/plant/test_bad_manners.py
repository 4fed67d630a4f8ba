"""Boxes of every kind that move, leave, fork, flood, raise signals or hear none: rows with reasons, and nobody left.

One of each manner runs always, on kinds in turn; all of them on every kind are evidence.
"""

from __future__ import annotations

import json
import os

import pytest

from seqsweep.identify.table.read import read_table

from ..support.commands import HERE, campaign, ended
from ..support.controllers import build, build_fmu, needs_compiler
from ..support.fmus import PARAMETERS, fmu

pytestmark = needs_compiler

MAPS = """\
inputs = {{ {told}, v_dc = "v_dc", v_dc_ref = 1200.0 }}
outputs = {{ {given} }}
settings = {{ FaultTime = 8.5 }}
sample_time_s = 100e-6
settle_tolerance = 1e-7
"""
ARRAYS = {"told": 'v_abc = "v_pcc_abc", i_abc = "i_l_abc"', "given": 'v_conv_abc = "v_conv_abc"'}
PHASES = {
    "told": ", ".join(f'v_{x} = "v_pcc_{x}", i_{x} = "i_l_{x}"' for x in "abc"),
    "given": ", ".join(f'u_{x} = "v_conv_{x}"' for x in "abc"),
}
STEP = "SAMPLE_TIME_S=100e-6"


SLOW_HZ, QUICK_HZ = 49.0, 45.0
"""Points whose shots last until the box goes wrong: 8.5 s after a controller's start, 1 s after that of a device."""


def of_library(*switches):
    def lines(folder, manner):
        return f"cigre:{build(STEP, f'MANNERS={manner}', *switches)}", MAPS.format(**ARRAYS), SLOW_HZ

    return lines


def of_controller(*switches):
    def lines(folder, manner):
        path = build_fmu(STEP, f"MANNERS={manner}", *switches)
        maps = MAPS.format(**(ARRAYS if "FMI3" in switches else PHASES))
        return "dpmsg-grey-v1", f'controller = "fmu:{path}"\n{maps}', SLOW_HZ

    return lines


def of_device(*switches):
    def lines(folder, manner):
        parameters = {**PARAMETERS, "active_power": "p_w"}
        told = "\n".join(f"{key} = {json.dumps(value)}" for key, value in parameters.items())
        box = fmu(folder, f"MANNERS={manner}", *switches)
        return f"fmu:{box}", f"{told}\nstart = {{ fault = 10.0, after_s = 1.0 }}", QUICK_HZ

    return lines


def of_program(folder, manner):
    answer_s = 2.0 if manner in ("deaf", "dies_with_orphans") else 300.0
    parameters = f'faults = ["{manner}"]\nafter = 20000\nanswer_s = {answer_s}'
    return f"process:python3 {HERE / 'boxes' / 'peer.py'}", parameters, QUICK_HZ


def of_python(folder, manner):
    return "python:misbehaving_plants:Rude", f'manner = "{manner}"', QUICK_HZ


KINDS = {
    "library": of_library(),
    "library by fork": of_library("HIDDEN_STATES"),
    "FMI 2.0 controller": of_controller("STATE"),
    "FMI 3.0 controller by fork": of_controller("FMI3"),
    "FMI 2.0 device by fork": of_device(),
    "FMI 3.0 device": of_device("FMI3", "STATE"),
    "program": of_program,
    "Python": of_python,
}
REASONS = {
    "moves": "",
    "forks": "",
    "floods": "",
    "leaves": "exit status 0",
    "dies_with_orphans": "SIGABRT",
    "signals": "SIGTERM",
    "deaf": "",
}
"""What the rows say of it; nothing where they are ok, and of the deaf one that time was up."""

EVERY_DAY = set(
    zip(
        ["library", "FMI 2.0 device by fork", "FMI 3.0 device", "program"],
        ["moves", "dies_with_orphans", "leaves", "forks"],
        strict=True,
    )
)


def cases():
    for kind in KINDS:
        for manner in REASONS:
            marks = () if (kind, manner) in EVERY_DAY else pytest.mark.evidence
            yield pytest.param(kind, manner, marks=marks, id=f"{kind} {manner}")


@pytest.mark.parametrize(("kind", "manner"), list(cases()))
def test_a_box_with_bad_manners_costs_its_own_points_and_leaves_nobody_behind(tmp_path, kind, manner):
    plant, parameters, f_hz = KINDS[kind](tmp_path, manner)
    limit_s = 1.0 if manner == "deaf" else 300.0
    lines = f"timeout_s = {limit_s}\n[plant.parameters]\n{parameters}"
    path = campaign(tmp_path, plant=plant, plant_lines=lines, powers=[1.0])
    path.write_text(path.read_text().replace("f_min_hz = 20.0\nf_max_hz = 900.0\npoints = 8", f"f_hz = [{f_hz}]"))
    (tmp_path / "temporary").mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", "--jobs", 1, env=environment)
    (response,) = read_table(tmp_path / "y.parquet").responses
    assert "Traceback" not in said
    if manner in ("moves", "forks", "floods"):
        assert (status, response.status.tolist()) == (0, ["ok"]), (said, response.reason)
    else:
        assert (status, response.status.tolist()) == (1, ["failed"]), (said, response.reason)
        words = REASONS[manner] or ("no answer to" if kind == "program" else "took longer than")
        assert words in response.reason[0]
    assert list((tmp_path / "temporary").iterdir()) == []
