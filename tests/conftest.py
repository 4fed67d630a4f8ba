"""What `make evidence` finds is kept: every evidence test's words go to docs/evidence.md."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from .support.evidence_page import read, trial_of, written

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two workers, two cores
for _name in ("COLUMNS", "LINES"):  # readline, which pytest imports, gives them to children behind Python's back
    os.environ.pop(_name, None)
    os.unsetenv(_name)

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # begun by a shell's "&": commands would not hear Ctrl-C either
    signal.signal(signal.SIGINT, signal.default_int_handler)

PAGE = Path(__file__).parent.parent / "docs" / "evidence.md"
_said: dict[str, str] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" and "evidence" in report.keywords and report.passed:
        _said[report.nodeid] = report.capstdout.strip()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Only a green run of evidence speaks for the pages."""
    if session.config.option.markexpr != "evidence" or exitstatus != 0 or hasattr(session.config, "workerinput"):
        return
    fresh = {trial.name: trial for name, text in _said.items() if text for trial in [trial_of(name, text)]}
    whole = session.config.args_source is pytest.Config.ArgsSource.TESTPATHS and not session.config.option.keyword
    kept = {} if whole else read(PAGE.read_text("utf-8"))
    PAGE.write_text(written(kept | fresh), "utf-8")
