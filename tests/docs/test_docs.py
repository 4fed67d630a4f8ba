"""The pages name what is there: commands with their options, files, and places on other pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from seqsweep.sweep.cli.main import app

TOP = Path(__file__).parents[2]
PAGES = [*TOP.glob("*.md"), TOP / "data" / "README.md", *sorted((TOP / "docs").glob("*.md"))]
PAGES += sorted((TOP / "docs" / "how-to").glob("*.md"))
MADE = ("docs/generated/", "docs/gallery/", "docs/notebooks/")
"""Pages that the site's build makes."""
COMMANDS = {
    name: {option for parameter in command.params for option in parameter.opts}
    for name, command in typer.main.get_command(app).commands.items()
}
FOLDERS = "benchmarks|data|docs|examples|identify|plant|sweep|tests|tuning"


def unknown_in(line):
    """Commands and options in a line of a page that the command line does not have."""
    for name, rest in re.findall(r"(?:^ {4,}|`|^\$ )seqsweep ([a-z]+)\b([^`#]*)", line):
        if name not in COMMANDS:
            yield f"seqsweep {name}"
        for option in re.findall(r"--[a-z][a-z0-9-]*", rest):
            if option not in COMMANDS.get(name, {option}):
                yield f"seqsweep {name} {option}"


def anchors_of(page):
    headings = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_what_is_unknown_is_seen():
    assert list(unknown_in('    seqsweep tune y.parquet --grid "1j" --gird')) == ["seqsweep tune --gird"]
    assert list(unknown_in("as `seqsweep show --plot` or `seqsweep sweep` do")) == ["seqsweep sweep"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_and_option_on_a_page_exists(page):
    unknown = [found for line in page.read_text("utf-8").splitlines() for found in unknown_in(line)]
    assert [found for found in unknown if (page.stem, found) != ("wrong-input", "seqsweep sweep")] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_option_that_is_named_alone_is_one_of_some_command(page):
    known = set().union(*COMMANDS.values(), {"--help", "--version", "--debug"})
    named = re.findall(r"`(--[a-z][a-z0-9-]*)[ `]", page.read_text("utf-8"))
    assert [option for option in named if option not in known and (page.stem, option) not in OF_SCRIPTS] == []


OF_SCRIPTS = {("report", "--points")}
"""Options of scripts, by page."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_file_and_link_on_a_page_leads_somewhere(page):
    text = page.read_text("utf-8")
    text = re.sub(r"<!-- picture: .*? -->", "", text)  # brought by the site's build
    paths = re.findall(rf"(?<![\w/.])((?:{FOLDERS})/[\w./-]*\w)(?![*\w])", text)
    assert [path for path in paths if not (TOP / path).exists() and not path.startswith(MADE)] == []
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if not link.startswith("http")]
    for link in links:
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if str(target.resolve().relative_to(TOP)).startswith(MADE):
            continue
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link
