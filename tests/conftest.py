"""What `make evidence` finds is kept: every evidence test's words go to docs/evidence.md."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two workers, two cores
for _name in ("COLUMNS", "LINES"):  # readline, which pytest imports, gives them to children behind Python's back
    os.environ.pop(_name, None)
    os.unsetenv(_name)

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # begun by a shell's "&": commands would not hear Ctrl-C either
    signal.signal(signal.SIGINT, signal.default_int_handler)

PAGE = Path(__file__).parent.parent / "docs" / "evidence.md"
HEAD = """# Evidence

The heavy trials behind the figures of the other pages, as the last `make evidence` printed them. That command
rewrites this page; a test that fails stops it from doing so. A run of some of the trials
(`python -m pytest -m evidence tests/identify/test_noise.py`) rewrites their sections.
"""

_said: dict[str, str] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" and "evidence" in report.keywords and report.passed:
        _said[report.nodeid] = report.capstdout.strip()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Only a green run of evidence speaks for the pages."""
    if session.config.option.markexpr != "evidence" or exitstatus != 0 or hasattr(session.config, "workerinput"):
        return
    fresh = {_title(name): _section(name, text) for name, text in _said.items() if text}
    whole = session.config.args_source is pytest.Config.ArgsSource.TESTPATHS and not session.config.option.keyword
    kept = {} if whole else _sections(PAGE.read_text("utf-8"))
    PAGE.write_text(HEAD + "".join(text for _, text in sorted((kept | fresh).items())), "utf-8")


def _sections(page: str) -> dict[str, str]:
    """Sections of the page by their title."""
    parts = re.split(r"^## (.*)$", page, flags=re.MULTILINE)
    return {title: f"\n## {title}\n\n{text.strip()}\n" for title, text in zip(parts[1::2], parts[2::2], strict=True)}


def _title(name: str) -> str:
    return name.partition("::")[2].replace("test_", "").replace("_", " ")


def _section(name: str, text: str) -> str:
    return f"\n## {_title(name)}\n\n`{name.partition('::')[0]}`\n\n```\n{text}\n```\n"
