"""The page of evidence is a table of claims, and what it was written from can be read back from it."""

from __future__ import annotations

from pathlib import Path

from ..support.evidence_page import read, trial_of, written

PAGE = Path(__file__).parents[2] / "docs" / "evidence.md"


def test_what_was_printed_comes_back():
    trials = [
        trial_of("tests/sweep/test_x.py::test_a_b[1-x]", "first | line\n\n## no head\nlast"),
        trial_of("tests/sweep/test_x.py::test_a_b[2]", "second"),
        trial_of("tests/plant/test_y.py::test_y", "one"),
    ]
    page = written({trial.name: trial for trial in trials})
    assert read(page) == {trial.name: trial for trial in trials}
    assert "| A b | first \\| line<br>second |" in page
    assert page.index("Devices and boxes") < page.index("Campaigns, signals and files")


def test_the_page_of_the_repository_is_written_so():
    page = PAGE.read_text("utf-8")
    assert written(read(page)) == page
    assert len(read(page)) > 40
