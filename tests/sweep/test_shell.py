"""What a shell user meets beside the commands: versions, synonyms, other ways in, and `compare`'s exit status."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..support.commands import campaign, command


def test_the_module_is_the_command():
    done = subprocess.run([sys.executable, "-m", "seqsweep", "-h"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert "compare" in done.stdout


def test_version_names_the_table_format_and_python():
    done = command("--version")
    assert "table format 1." in done.stdout
    assert f"Python {sys.version_info.major}.{sys.version_info.minor}" in done.stdout


@pytest.mark.parametrize(
    ("typed", "meant"), [("sweep", "run"), ("plot", "show"), ("tuen", "tune"), ("diff", "compare")]
)
def test_an_unknown_command_is_told_what_is_meant(typed, meant):
    done = command(typed, "x")
    assert done.returncode == 2
    told = done.stderr.lower()
    assert told.count("did you mean") == 1
    assert f"did you mean: seqsweep {meant}" in told or f"did you mean '{meant}'?" in told


def test_a_table_under_another_suffix_is_refused_with_the_way_out(tmp_path):
    done = command("run", campaign(tmp_path), "-o", tmp_path / "y.csv")
    assert done.returncode == 2
    assert "seqsweep export" in done.stderr


def test_compare_ends_with_0_or_6(tmp_path):
    for name, ohm in (("a", "1.0"), ("b", "1.0"), ("c", "1.05")):
        file = campaign(tmp_path, plant="branch-v1", plant_lines=f"parameters = {{ r_ohm = {ohm} }}", powers=(0.0,))
        assert command("run", file, "-o", tmp_path / f"{name}.parquet", "--jobs", 1).returncode == 0
    same = command("compare", tmp_path / "a.parquet", tmp_path / "b.parquet")
    assert same.returncode == 0, same.stderr
    assert "agree within their uncertainty: yes" in same.stdout
    other = command("compare", tmp_path / "a.parquet", tmp_path / "c.parquet")
    assert other.returncode == 6
    assert "agree within their uncertainty: no" in other.stdout
