"""The examples run as they stand, in seconds, and say what they promise."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

EXAMPLES = Path(__file__).parents[2] / "examples"
SEQSWEEP = str(Path(sys.executable).with_name("seqsweep"))
SOURCES = EXAMPLES.parent / "tests" / "support" / "boxes"


def output_of(*command: str, cwd: Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_plant_of_ones_own_keeps_its_promise_and_is_swept_to_its_closed_form(tmp_path: Path) -> None:
    said = output_of(sys.executable, str(EXAMPLES / "bring_your_own_plant.py"), cwd=tmp_path)
    assert "FAIL" not in said
    found = re.search(r"(\d+) points, largest error .*: (\S+)$", said.strip())
    assert found, said
    points, error = found.groups()
    assert int(points) == 5
    assert float(error) < 1e-4  # windows agree to 1e-5, the default tolerance


def test_the_table_is_read_without_the_package(tmp_path: Path) -> None:
    table = str(tmp_path / "y.parquet")
    points = "sweep.points=8"
    output_of(SEQSWEEP, "run", str(EXAMPLES / "table1.toml"), "-o", table, "--set", points, cwd=tmp_path)
    said = output_of(sys.executable, str(EXAMPLES / "read_the_table.py"), table, cwd=tmp_path)
    assert "seqsweep-admittance 1." in said
    assert "8 rows" in said
    assert "|Ypp| is largest at" in said


def test_without_a_table_its_usage_is_told(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / "read_the_table.py")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert done.stderr.startswith("usage: ")


@pytest.mark.skipif(find_spec("dpsimpy") is not None, reason="dpsim is installed")
def test_a_simulator_that_is_missing_is_wrong_input(tmp_path: Path) -> None:
    command = [SEQSWEEP, "run", "examples/dpsim_plant.toml", "-o", str(tmp_path / "y.parquet")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=EXAMPLES.parent, timeout=600)
    assert done.returncode == 2
    assert "pip install 'seqsweep[bench]'" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_simulator_from_elsewhere_is_swept_from_cold(tmp_path: Path) -> None:
    pytest.importorskip("dpsimpy", reason="the extra 'bench' is not installed")
    shutil.copytree(EXAMPLES, tmp_path / "examples")
    table = str(tmp_path / "y.parquet")
    campaign = str(EXAMPLES / "dpsim_plant.toml")
    output_of(SEQSWEEP, "run", campaign, "-o", table, "--set", "sweep.f_hz=[80.0]", cwd=tmp_path)
    output_of(SEQSWEEP, "validate", table, cwd=tmp_path)


def test_the_grid_is_found_in_a_noisy_second(tmp_path: Path) -> None:
    picture = tmp_path / "grid.png"
    said = output_of(sys.executable, str(EXAMPLES / "identify_the_grid.py"), str(picture), cwd=tmp_path)
    for found, half, true in re.findall(r"= (\S+) \+- (\S+) ohm.*true (\S+)", said):
        assert abs(float(found) - float(true)) < 2.0 * float(half)
    assert "an R-L branch: True" in said
    colours = imread(picture)[::7, ::7, :3].reshape(-1, 3)
    assert len(np.unique(np.round(colours, 1), axis=0)) > 5  # axes, lines, their errors and the fit: no empty sheet


def test_a_script_becomes_a_plant_in_five_lines() -> None:
    said = output_of(SEQSWEEP, "check", "python:step_plant:load", cwd=EXAMPLES)
    assert "FAIL" not in said


def test_the_reference_programs_are_the_same_device(tmp_path: Path) -> None:
    """Python and C, through the command: every promise, with and without snapshots."""
    cc = shutil.which("cc") or pytest.skip("no C compiler")
    program = tmp_path / "process_plant"
    output_of(cc, "-O2", "-Wall", "-Werror", "-o", str(program), str(EXAMPLES / "process_plant.c"), "-lm", cwd=tmp_path)
    for command in (f"{sys.executable} {EXAMPLES / 'process_plant.py'}", str(program)):
        said = output_of(SEQSWEEP, "check", f"process:{command}", cwd=tmp_path)
        assert "FAIL" not in said
        assert "pass  halves" in said


def test_the_page_shows_the_step_function_as_it_is() -> None:
    page = (EXAMPLES.parent / "docs" / "black-boxes.md").read_text("utf-8")
    example = (EXAMPLES / "step_plant.py").read_text("utf-8")
    code = example[example.index("from seqsweep") :].replace("\n\n\n", "\n\n").strip()
    assert code in page.replace("\n    ", "\n")


def test_the_adaptive_points_are_drawn(tmp_path: Path) -> None:
    said = output_of(sys.executable, str(EXAMPLES / "adaptive_points.py"), "a.png", cwd=tmp_path)
    found = re.search(r"(\d+) points, certified to (\S+); largest difference (\S+)$", said.strip())
    assert found, said
    assert int(found[1]) <= 30
    assert float(found[3]) <= float(found[2]) <= 1e-3
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc): the example's library cannot be built")
def test_a_real_code_controller_is_swept_in_the_turbines_circuit(tmp_path: Path) -> None:
    library = ["-o", "turbine_controller.so", str(SOURCES / "turbine_controller.c"), "-lm"]
    output_of("cc", "-O2", "-shared", "-fPIC", *library, cwd=tmp_path)
    table = str(tmp_path / "y.parquet")
    campaign = str(EXAMPLES / "cigre.toml")
    output_of(SEQSWEEP, "run", campaign, "-o", table, "--set", "sweep.points=4", cwd=tmp_path)
    output_of(SEQSWEEP, "validate", table, cwd=tmp_path)
