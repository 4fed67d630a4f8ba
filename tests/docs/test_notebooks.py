"""The notebooks run from the first cell to the last; they assert things.

They run one after another in one interpreter, each with names of its own: starting a kernel takes longer than what they
show. What `seqsweep init` writes runs in a kernel of its own as well, with its pictures, as evidence.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
NOTEBOOKS = sorted((TOP / "examples" / "notebooks").glob("*.ipynb"))
TEMPLATE = TOP / "sweep" / "config" / "template.ipynb"
"""What `seqsweep init --notebook` writes."""

IN_A_KERNEL = """
import sys, nbformat
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=600, kernel_name="python3", resources={"metadata": {"path": sys.argv[2]}}).execute()
nbformat.write(book, sys.argv[3])
"""

ONE_BY_ONE = """
import gc, json, os, sys
gc.disable()  # looking for garbage would take a tenth of the time
import nbformat
from IPython.core.interactiveshell import InteractiveShell
from matplotlib import pyplot
from traitlets.config import Config

told = {}
for path, folder in zip(sys.argv[2::2], sys.argv[3::2]):
    os.chdir(folder)
    shell = InteractiveShell(config=Config({"HistoryManager": {"enabled": False}}), user_ns={})
    told[path] = []
    for cell in nbformat.read(path, 4).cells:
        if cell.cell_type == "code":
            outcome = shell.run_cell(cell.source)
            told[path].append(repr(outcome.error_before_exec or outcome.error_in_exec or ""))
    told[path].append(len(pyplot.get_fignums()))
    pyplot.close("all")
json.dump(told, open(sys.argv[1], "w"))
"""


def run(code, *arguments, **environment):
    command = [sys.executable, "-W", "ignore", "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What every cell of a notebook ended with ('' where it ended well), and how many figures, by its path."""
    pytest.importorskip("nbformat", reason="the extra 'test' is not installed")
    places, copied = [], shutil.ignore_patterns("comtrade*", "hdf5", "matlab*")
    for path in (*NOTEBOOKS, TEMPLATE):
        folder = tmp_path_factory.mktemp(path.stem) / "examples"
        folder.mkdir()
        if path.stem == "recording":
            shutil.copytree(TOP / "data", folder.parent / "data", ignore=copied)
        places += [path, folder]
    told = tmp_path_factory.mktemp("told") / "told.json"
    run(ONE_BY_ONE, told, *places, MPLBACKEND="agg")
    return json.loads(told.read_text())


def test_there_is_one_for_every_kind_of_device():
    assert [path.stem for path in NOTEBOOKS] == ["fmu", "recording", "step_function", "turbine"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, outcomes):
    if path.stem == "fmu":
        pytest.importorskip("pythonfmu", reason="the extra 'test' is not installed")
    *cells, _ = outcomes[str(path)]
    assert cells
    assert set(cells) == {"''"}


def test_the_notebook_of_init_runs_and_draws(outcomes):
    *cells, n_figures = outcomes[str(TEMPLATE)]
    assert cells
    assert set(cells) == {"''"}
    assert n_figures >= 1


@pytest.mark.evidence
def test_the_notebook_of_init_runs_in_a_kernel_and_draws(tmp_path):
    pytest.importorskip("nbclient", reason="the extra 'test' is not installed")
    executed = tmp_path / "executed.ipynb"
    run(IN_A_KERNEL, TEMPLATE, tmp_path, executed)
    assert '"image/png"' in executed.read_text()
