"""Results as text and as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from seqsweep.sweep.cli import telling

ROWS = [{"a": 1.5, "b": [1, 2], "text": "two\nlines"}, {"a": float("nan"), "b": [], "text": ""}, {}]


@pytest.fixture
def as_json() -> Iterator[None]:
    token = telling._MANNER.set(telling.Manner(as_json=True))
    yield
    telling._MANNER.reset(token)


def printed(say: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> str:
    say()
    return capsys.readouterr().out


@pytest.mark.usefixtures("as_json")
@pytest.mark.parametrize("n", range(4))
def test_a_list_written_row_by_row_is_the_same_document(n: int, capsys: pytest.CaptureFixture[str]) -> None:
    whole = printed(lambda: telling.result("", lambda: ROWS[:n]), capsys)
    assert printed(lambda: telling.results(str, lambda: iter(ROWS[:n])), capsys) == whole
    assert len(json.loads(whole)) == n


@pytest.mark.usefixtures("as_json")
def test_of_a_list_one_row_is_held_at_a_time(capsys: pytest.CaptureFixture[str]) -> None:
    def rows() -> Iterator[Any]:
        for k in range(3):
            assert capsys.readouterr().out.count("row") == min(k, 1)  # the one before is written already
            yield {"row": k}

    telling.results(str, rows)


def test_for_people_the_rows_are_not_asked(capsys: pytest.CaptureFixture[str]) -> None:
    def rows() -> Iterator[Any]:
        raise AssertionError

    assert printed(lambda: telling.results(lambda: "said", rows), capsys) == "said\n"
