"""The notebooks of the examples run from the first cell to the last, in a kernel of their own; they assert things."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
NOTEBOOKS = sorted((TOP / "examples" / "notebooks").glob("*.ipynb"))
TEMPLATE = TOP / "sweep" / "config" / "template.ipynb"
"""What `seqsweep init --notebook` writes."""

RUN = """
import sys, nbformat
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=600, kernel_name="python3", resources={"metadata": {"path": sys.argv[2]}}).execute()
nbformat.write(book, sys.argv[3])
"""


def test_there_is_one_for_every_kind_of_device():
    assert [path.stem for path in NOTEBOOKS] == ["fmu", "recording", "step_function", "turbine"]


@pytest.mark.parametrize("path", [*NOTEBOOKS, TEMPLATE], ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    pytest.importorskip("nbclient", reason="the extra 'test' is not installed")
    if path.stem == "fmu":
        pytest.importorskip("pythonfmu", reason="the extra 'test' is not installed")
    folder = tmp_path / "examples"
    folder.mkdir()
    if path.stem == "recording":
        data, left_out = Path(__file__).parents[2] / "data", shutil.ignore_patterns("comtrade*", "hdf5", "matlab*")
        shutil.copytree(data, tmp_path / "data", ignore=left_out)
    executed = tmp_path / "executed.ipynb"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RUN, path, folder, executed], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert '"image/png"' in executed.read_text() or path.stem != "turbine"
