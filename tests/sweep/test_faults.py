"""A bug is never told as wrong input: status 5, one line, and the details where that line says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from seqsweep.plant.errors import SeqsweepError, closest, in_words, nearest

from ..support.commands import campaign, unfolded

FAULT = 5

BUGS = {
    "broadcasting": ("numpy.zeros(3) + numpy.zeros(4)", "ValueError: operands could not be broadcast"),
    "linear algebra": ("numpy.linalg.inv(numpy.zeros((2, 2)))", "LinAlgError: Singular matrix"),
    "a key": ("{}['nothing']", "KeyError: 'nothing'"),
    "an assertion": ("(_ for _ in ()).throw(AssertionError())", "AssertionError"),
}


def with_bug(expression, *arguments, cwd):
    """The command line in a process of its own, whose planning runs into ``expression``."""
    program = (
        "import numpy, sys; import seqsweep.sweep.cli.main as command, seqsweep.sweep.planning as plan\n"
        f"def bug(*given): {expression}\n"
        f"plan.make_plan = bug; sys.argv = ['seqsweep', *{list(map(str, arguments))!r}]; command.main()"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=cwd, capture_output=True, text=True, timeout=600)
    done.stderr = unfolded(done.stderr)
    return done


@pytest.mark.parametrize("name", BUGS)
def test_a_bug_ends_with_status_5_and_says_where_its_details_are(tmp_path, name):
    expression, words = BUGS[name]
    output = tmp_path / "y.parquet"
    done = with_bug(expression, "run", campaign(tmp_path), "-o", output, cwd=tmp_path)
    assert done.returncode == FAULT
    (line,) = done.stderr.strip().splitlines()
    assert words in line
    log = tmp_path / "y.parquet.fault.log"
    assert str(log) in line
    assert "Traceback" in log.read_text()
    assert "in bug" in log.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["campaign.toml", log.name]


def test_without_an_output_the_log_lies_among_temporary_files(tmp_path):
    done = with_bug(BUGS["broadcasting"][0], "plan", campaign(tmp_path), cwd=tmp_path)
    assert done.returncode == FAULT
    log = Path(re.search(r"details in (\S+),", done.stderr).group(1))
    try:
        assert "Traceback" in log.read_text()
    finally:
        log.unlink()


@pytest.mark.parametrize("before", [True, False])
def test_debug_prints_the_details_and_leaves_no_log(tmp_path, before):
    command = ["run", campaign(tmp_path), "-o", tmp_path / "y.parquet"]
    line = ["--debug", *command] if before else [*command, "--debug"]
    done = with_bug(BUGS["linear algebra"][0], *line, cwd=tmp_path)
    assert done.returncode == FAULT
    assert "Traceback" in done.stderr
    assert "LinAlgError" in done.stderr.splitlines()[-1]
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.toml"]


def test_a_refusal_stays_wrong_input(tmp_path):
    bug = "raise __import__('seqsweep.plant.errors').plant.errors.SeqsweepError('too much')"
    done = with_bug(bug, "run", campaign(tmp_path), "-o", tmp_path / "y.parquet", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "too much\n")


def test_every_refusal_has_one_base():
    """Errors that derive from ``ValueError`` past `SeqsweepError` would be told as faults."""
    top = Path(__file__).parents[2]
    for floor in ("plant", "identify", "tuning", "sweep", "seqsweep"):
        for path in (top / floor).rglob("*.py"):
            past = re.findall(r"raise ValueError|^class \w+\(ValueError\)", path.read_text("utf-8"), re.M)
            assert not past or path == top / "plant" / "errors.py", path


def test_the_nearest_name_is_found_whatever_its_case():
    assert closest("R_OMH", ["r_ohm", "x_ohm"]) == "r_ohm"
    assert nearest("ia_pcc", ["Ia_PCC", "Ib"]) == " (did you mean 'Ia_PCC'?)"
    assert nearest("zebra", ["r_ohm"]) == ""


def test_words_name_the_class_where_the_text_alone_says_little():
    assert in_words(SeqsweepError("given 1,\n needed 2")) == "given 1, needed 2"
    assert in_words(KeyError("x")) == "KeyError: 'x'"
    assert in_words(np.linalg.LinAlgError("Singular matrix")) == "Singular matrix"
