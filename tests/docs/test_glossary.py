"""The glossary and what commands print keep together: no row of a line that is gone, no line without a row."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import chain, pairwise
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
GLOSSARY = (TOP / "docs" / "glossary.md").read_text("utf-8").replace("\\|", "|")
SOURCES = [path for floor in ("plant", "identify", "tuning", "sweep") for path in (TOP / floor).rglob("*.py")]
PAGES = [path for path in sorted((TOP / "docs").rglob("*.md")) if "generated" not in path.parts]
ERRORS = ("needed", "need R", "no such file")
"""What a refusal says is its own explanation."""

A_WORD = r"[A-Za-z|][A-Za-z|'-]*"


def pairs_of(text: str) -> set[tuple[str, ...]]:
    """Neighbouring words of a text; numbers, signs and what is put in at the time part it."""
    parts = re.split(r"\{[^{}]*\}|[\d().,:;`\"/=+*<>%{}]|\.\.\.", text)
    listed = [[word.lower() for word in re.findall(A_WORD, part)] for part in parts]
    return set(chain.from_iterable(pairwise(words) for words in listed))


def rows() -> Iterator[str]:
    """The lines that the glossary explains."""
    for line in GLOSSARY.splitlines():
        if line.startswith("| `"):
            yield from re.findall(r"`([^`]+)`", line.split(" | ")[0])


def printed() -> Iterator[str]:
    """Lines that the pages show below a command of ours, with what goes on below them."""
    for page in PAGES:
        for block in re.findall(r"```console\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
            ours, line = False, ""
            for each in block.splitlines():
                if ours and line and each.startswith("  "):
                    line += f" {each.strip()}"
                    continue
                if ours and line:
                    yield line
                ours = each.startswith("$ seqsweep ") if each.startswith("$ ") else ours
                line = "" if each.startswith("$ ") else each
            if ours and line:
                yield line


@pytest.fixture(scope="module")
def is_said() -> Callable[[str], bool]:
    """Whether the program can say a line: two of its words stand together in the sources, or all of them are there."""
    texts = "\n".join(path.read_text("utf-8") for path in SOURCES)
    joined = re.sub(r"\"\s*\n\s*f?\"", "", texts)  # a text over several lines of the source
    said, words = pairs_of(joined), set(re.findall(A_WORD, joined.lower()))

    def found(line: str) -> bool:
        pairs = pairs_of(line)
        return not pairs or bool(pairs & said) or all(word in words for pair in pairs for word in pair)

    return found


def test_every_row_explains_a_line_that_the_program_has(is_said: Callable[[str], bool]) -> None:
    assert [row for row in rows() if not is_said(row)] == []


@pytest.fixture(scope="module")
def is_explained() -> Callable[[str], bool]:
    """Whether the glossary has two of a line's words side by side, or a row with one of its first words."""
    explained = set(chain.from_iterable(pairs_of(row) for row in rows())) | pairs_of(GLOSSARY)
    labels = {word for row in rows() for word in re.findall(r"[\w|]+", row)}

    def found(line: str) -> bool:
        begun = re.findall(r"[\w|]+", line)[:4]
        return bool(pairs_of(line) & explained) or bool(set(begun) & labels) or any(word in line for word in ERRORS)

    return found


def test_every_line_on_a_page_has_its_row(is_explained: Callable[[str], bool]) -> None:
    assert [line for line in dict.fromkeys(printed()) if pairs_of(line) and not is_explained(line)] == []


def test_a_line_that_nobody_prints_or_explains_is_seen(
    is_said: Callable[[str], bool], is_explained: Callable[[str], bool]
) -> None:
    assert not is_said("purple elephants never oscillate")
    assert not is_explained("purple elephants never oscillate")
