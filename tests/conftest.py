"""What `make evidence` finds is kept: every evidence test's words go to docs/evidence.md."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

PAGE = Path(__file__).parent.parent / "docs" / "evidence.md"
HEAD = """# Evidence

The heavy trials behind the figures of the other pages, as the last `make evidence` printed them. That command
rewrites this page; a test that fails stops it from doing so.
"""

_said: dict[str, str] = {}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    report = yield
    if report.when == "call" and item.get_closest_marker("evidence") and report.passed:
        _said[item.nodeid] = report.capstdout.strip()
    return report


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Only a whole and green evidence run speaks for the pages."""
    config = session.config
    whole = config.option.markexpr == "evidence" and not config.option.keyword
    if whole and config.args_source is pytest.Config.ArgsSource.TESTPATHS and exitstatus == 0:
        PAGE.write_text(HEAD + "".join(_section(name, text) for name, text in sorted(_said.items()) if text))


def _section(name: str, text: str) -> str:
    file, _, test = name.partition("::")
    return f"\n## {test.replace('test_', '').replace('_', ' ')}\n\n`{file}`\n\n```\n{text}\n```\n"
