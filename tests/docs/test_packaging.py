"""A wheel has every module and every data file, installs into a clean environment, and works there."""

from __future__ import annotations

import fnmatch
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
FLOORS = ("seqsweep", "identify", "plant", "sweep", "tuning")
SETUPTOOLS = tomllib.loads((TOP / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]


def files_of(floor):
    found = (path.relative_to(TOP) for path in (TOP / floor).rglob("*") if path.is_file())
    return [path for path in found if "__pycache__" not in path.parts]


def package_of(folder):
    return ".".join(folder.parts if folder.parts[0] == "seqsweep" else ("seqsweep", *folder.parts))


def test_every_module_stands_in_a_package_of_the_wheel():
    folders = {path.parent for floor in FLOORS for path in files_of(floor) if path.suffix == ".py"}
    assert sorted(map(package_of, folders)) == sorted(SETUPTOOLS["packages"])


def test_every_data_file_goes_into_the_wheel():
    """As package-data names them: by a pattern of the package that they stand in, or of one above it."""
    for path in (path for floor in FLOORS for path in files_of(floor) if path.suffix not in (".py", ".pyc", ".so")):
        above = [folder for folder in path.parents if folder.parts]
        matched = any(
            fnmatch.fnmatch(str(path.relative_to(folder)), pattern)
            for folder in above
            for pattern in SETUPTOOLS["package-data"].get(package_of(folder), [])
        )
        assert matched, f"{path} is in no pattern of package-data"


@pytest.mark.evidence
def test_a_wheel_installs_into_a_clean_environment_and_works_there(tmp_path):
    """Built in isolation, installed with all its libraries, swept, tuned, reported; with its manual page."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}

    def ran(*words, where=tmp_path):
        done = subprocess.run(list(map(str, words)), cwd=where, env=plain, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    ran(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path / "wheels", TOP)
    (wheel,) = (tmp_path / "wheels").glob("*.whl")
    ran(sys.executable, "-m", "venv", tmp_path / "clean")
    home = tmp_path / "clean" / "bin"
    ran(home / "pip", "install", "-q", "-c", TOP / "constraints.txt", wheel)
    assert "table format" in ran(home / "seqsweep", "--version")
    ran(home / "seqsweep", "init", "-o", "campaign.toml")
    ran(home / "seqsweep", "run", "campaign.toml", "-o", "y.parquet", "--set", "sweep.points=30")
    ran(home / "python", "-m", "seqsweep", "tune", "y.parquet", "--grid", "0.012+0.25j", "-o", "t.json")
    ran(home / "seqsweep", "report", "y.parquet", "t.json", "-o", "report.html")
    ran(home / "seqsweep", "init", "--notebook")
    (bill,) = (tmp_path / "clean").rglob("seqsweep-*.dist-info/sboms/seqsweep.cdx.json")
    assert bill.read_bytes() == (TOP / "supply" / "seqsweep.cdx.json").read_bytes()
    for place in ("man/man1/seqsweep.1", "bash-completion/completions/seqsweep", "zsh/site-functions/_seqsweep"):
        assert (tmp_path / "clean" / "share" / place).read_text("utf-8")
