"""`seqsweep check FILE`: what a file is, told without executing any of it; and of a campaign, its plant driven."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from seqsweep.plant.controllers.shared_object import SharedObjectError, read_shared_object
from seqsweep.sweep.cli.check import inspect, is_inspected

from ..support.commands import SEQSWEEP, campaign, command, unfolded
from ..support.fmus import compiler, fmu

EXAMPLES = Path(__file__).parents[2] / "examples"

# Each leaves a trace when it is executed: a constructor of the library, the top of the module.
LIBRARY = """
#include <stdio.h>
__attribute__((constructor)) static void loaded(void) {{ fclose(fopen("{trace}", "w")); }}
static int hidden(void) {{ return 1; }}
int Model_GetInfo(void) {{ return hidden(); }}
int Model_CheckParameters(void) {{ return 0; }}
int Model_Initialize(void) {{ return 0; }}
{rest}
"""


def library(folder, rest):
    cc, _ = compiler()
    source, path = folder / "box.c", folder / "box.so"
    source.write_text(LIBRARY.format(trace=folder / "trace", rest=rest))
    subprocess.run([cc, "-shared", "-fPIC", "-o", path, source], check=True)
    return path


def called_in(folder, *arguments):
    done = subprocess.run([SEQSWEEP, *arguments], cwd=folder, capture_output=True, text=True, timeout=600)
    done.stdout, done.stderr = unfolded(done.stdout), unfolded(done.stderr)
    return done


def test_a_library_is_read_and_not_loaded(tmp_path):
    path = library(tmp_path, "int Model_Outputs(void) { return 0; }")
    said = inspect(path)
    assert "ELF for x86_64" in said or "ELF for aarch64" in said
    assert "exports: Model_CheckParameters, Model_GetInfo, Model_Initialize, Model_Outputs\n" in said
    assert "an IEEE/CIGRE real-code controller (TB 958), by its names" in said
    assert "would be executed, in a child process: its initialisers" in said
    assert not (tmp_path / "trace").exists()


def test_a_library_that_is_no_controller_says_what_it_lacks(tmp_path):
    assert "no IEEE/CIGRE real-code controller: it lacks Model_Outputs" in inspect(library(tmp_path, ""))


def test_the_exports_are_those_that_the_linker_sees(tmp_path):
    """`nm` is the outside truth."""
    path = library(tmp_path, "int more(int x) { return x; }\nint data = 3;")
    done = subprocess.run(["nm", "-D", "--defined-only", path], capture_output=True, text=True)
    if done.returncode:
        pytest.skip("no nm")
    wanted = [line.split()[-1] for line in done.stdout.splitlines() if " T " in line]
    assert list(read_shared_object(path).functions) == sorted(wanted)


def test_a_windows_library_is_sent_to_where_it_can_run(tmp_path):
    (tmp_path / "box.dll").write_bytes(b"MZ" + bytes(100))
    said = inspect(tmp_path / "box.dll")
    assert "Windows library (PE)" in said
    assert "under wine, can speak for it:\n  process:COMMAND" in said


@pytest.mark.parametrize("content", [b"", b"text", b"\x7fELF\x02\x01" + bytes(10), b"\x7fELF\x02\x01" + b"\xff" * 80])
def test_a_file_that_is_no_library_is_refused(tmp_path, content):
    (tmp_path / "box.so").write_bytes(content)
    with pytest.raises(SharedObjectError, match=r"box\.so: (neither|a damaged)"):
        inspect(tmp_path / "box.so")


def test_an_fmu_is_read_and_not_unpacked(tmp_path):
    compiler()
    path = fmu(tmp_path, "STATE")
    before = sorted(file.name for file in tmp_path.iterdir())
    said = command("check", path)
    assert said.returncode == 0, said.stderr
    for words in (
        "FMI 2.0, model box 3",
        "2 members",
        "branched by its own get and set",
        "inputs: v_a (Real = 0), v_b",
        "outputs: i_a (Real), i_b",
        "parameters: p_w (Real = 0), fault",
        "would be loaded and executed, in a child process, of: binaries/linux64/box.so",
        f'a campaign with [plant] id = "fmu:{path}"',
    ):
        assert words in said.stdout
    assert sorted(file.name for file in tmp_path.iterdir()) == before


def test_an_archive_that_lies_in_wait_is_wrong_input(tmp_path):
    (tmp_path / "box.fmu").write_text("not a zip")
    done = command("check", tmp_path / "box.fmu")
    assert (done.returncode, "not an FMU" in done.stderr) == (2, True)


def test_a_module_is_read_and_not_imported(tmp_path):
    path = tmp_path / "box.py"
    path.write_text(f"open({str(tmp_path / 'trace')!r}, 'w')\ndef make(): ...\nclass Box: ...\ndef _inner(): ...\n")
    said = inspect(path)
    assert "may be factories: make, Box\n" in said
    assert "seqsweep check python:box:make" in said
    assert not (tmp_path / "trace").exists()
    path.write_text("def (")
    with pytest.raises(ValueError, match="not Python"):
        inspect(path)


MODULE = """
from dataclasses import dataclass
from elsewhere import Base
def step(state, v, dt): ...
def scaled(*, scale): ...
def main(): ...
@dataclass
class State: step: int
class Based(Base): ...
class Box:
    def __init__(self, r_ohm=0.1, *, l_h=1e-3): ...
class Needy(Box):
    def __init__(self, r_ohm): ...
class Special(Box): ...
def load(*parts, **more): ...
"""


def test_only_what_can_be_called_without_arguments_is_suggested(tmp_path):
    path = tmp_path / "box.py"
    path.write_text(MODULE)
    said = inspect(path)
    assert "may be factories: main, Box, Special, load\n" in said
    assert "need parameters, or may: step, scaled, State, Based, Needy\n" in said
    assert said.endswith("seqsweep check python:box:Box")
    path.write_text("def step(state, v, dt): ...\ndef main(): ...\n")
    said = inspect(path)
    assert 'id = "python:box:FACTORY" and [plant.parameters]' in said
    assert "check python:" not in said


def test_what_is_suggested_of_an_example_works():
    said = called_in(EXAMPLES, "check", "step_plant.py")
    command = said.stdout.splitlines()[-1].partition("seqsweep ")[2].split()
    assert command == ["check", "python:step_plant:load"]
    assert called_in(EXAMPLES, *command).returncode == 0


@pytest.mark.parametrize(
    "what", ["branch-v1", "fmu:box.fmu", "process:python3 a/b.py", "nowhere.toml", "a/nowhere.toml"]
)
def test_a_name_that_is_no_file_is_a_plant_or_a_campaign(what):
    assert not is_inspected(what)


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("vendor.fmu", "vendor.fmu: no such file"),
        ("turbine.so", "turbine.so: no such file"),
        ("nosuch.py", "nosuch.py: no such file"),
        ("fmu:vendor.fmu", "vendor.fmu: no such file"),
        ("no/such", "no/such: no such file"),
        ("folder.fmu", "folder.fmu is a folder; needed: a file that could hold a plant"),
        ("./folder.fmu", "is a folder"),
        ("notes.txt", "notes.txt is a text file, and seqsweep check needs a plant's id, a campaign or a device"),
        ("./notes", "is no file that could hold a plant"),
    ],
)
def test_what_looks_like_a_file_is_refused_as_a_file(tmp_path, what, words):
    (tmp_path / "folder.fmu").mkdir()
    for name in ("notes", "notes.txt"):
        (tmp_path / name).write_text("a note")
    done = called_in(tmp_path, "check", what)
    assert (done.returncode, "unknown plant" in done.stderr) == (2, False)
    assert words in done.stderr


def test_an_fmu_without_its_parameters_says_which_and_where_they_go(tmp_path):
    (tmp_path / "box.fmu").write_text("")
    done = called_in(tmp_path, "check", "fmu:box.fmu")
    assert done.returncode == 2
    assert "missing: dt_s, voltage_v, power_va, voltage, current; they go under [plant.parameters]" in done.stderr
    assert "TypeError" not in done.stderr


def test_the_plant_of_a_campaign_is_driven_with_its_parameters(tmp_path):
    done = command("check", campaign(tmp_path, plant_lines="[plant.parameters]\nr_ohm = 0.2\ndt_s = 1e-4"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pass  attributes        branch-v1: f1 = 50 Hz, dt = 0.0001 s")
