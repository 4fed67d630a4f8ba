"""The page of what the heavy trials printed: a table of claims by area, then every trial's own words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

HEAD = """# Evidence, trial by trial

| At a glance | |
|---|---|
| You type | `make evidence` |
| You see | what every heavy trial prints; this page holds it as it was when that command last ran |
| It means | each claim below was measured, by the command above its table |
| Next | [how often is the verdict wrong](how-often-wrong.md), [performance](performance.md) |

These are the heavy trials behind the figures of the other pages. `make evidence` rewrites this page; a test that fails
stops it from doing so. Running some of the trials by the command above a table rewrites their part. The first column is
the claim, the second the first line that was printed; all of it stands further below.
"""

AREAS = {
    "plant": "Devices and boxes",
    "identify": "From records to the table",
    "tuning": "From the table to the verdict",
    "sweep": "Campaigns, signals and files",
    "docs": "This site",
}
"""Folders of the tests, and what their trials are about."""

SHOWN = 96


class Trial(NamedTuple):
    """What one trial printed; ``name`` is its title, with the parameters in brackets."""

    name: str
    file: str
    text: str

    @property
    def claim(self) -> str:
        """The title without its parameters, as a sentence."""
        words = self.name.partition("[")[0].strip()
        return words[:1].upper() + words[1:]

    @property
    def area(self) -> str:
        return self.file.split("/")[1]


def trial_of(nodeid: str, text: str) -> Trial:
    """The trial of a test and what it printed."""
    file, _, name = nodeid.partition("::")
    return Trial(name.replace("test_", "").replace("_", " "), file, text.strip())


def read(page: str) -> dict[str, Trial]:
    """Trials of a page by their name."""
    found = re.findall(r"^#{2,3} ([^\n]*)\n\n`(tests/\S+)`\n\n```\n(.*?)\n```$", page, re.MULTILINE | re.DOTALL)
    return {name: Trial(name, file, text) for name, file, text in found}


def written(trials: Mapping[str, Trial]) -> str:
    """The page of these trials."""
    ordered = sorted(trials.values(), key=lambda trial: (_place(trial.area), trial.file, trial.name))
    tables = [_area(area, list(members)) for area, members in groupby(ordered, lambda trial: trial.area)]
    words = [f"### {trial.name}\n\n`{trial.file}`\n\n```\n{trial.text}\n```\n" for trial in ordered]
    return HEAD + "\n" + "\n".join(tables) + "\n## What each trial printed\n\n" + "\n".join(words)


def _place(area: str) -> int:
    return list(AREAS).index(area) if area in AREAS else len(AREAS)


def _area(area: str, trials: Sequence[Trial]) -> str:
    files = [_file(file, list(members)) for file, members in groupby(trials, lambda trial: trial.file)]
    return f"## {AREAS.get(area, area)}\n\n" + "\n".join(files)


def _file(file: str, trials: Iterable[Trial]) -> str:
    rows = [_row(claim, list(members)) for claim, members in groupby(trials, lambda trial: trial.claim)]
    return f"    python -m pytest -m evidence -s {file}\n\n| claim | it printed |\n|---|---|\n{''.join(rows)}"


def _row(claim: str, trials: Sequence[Trial]) -> str:
    lines = "<br>".join(_first(trial.text) for trial in trials)
    return f"| {claim} | {lines} |\n"


def _first(text: str) -> str:
    line = " ".join(text.splitlines()[0].split())
    short = line if len(line) <= SHOWN else line[:SHOWN].rpartition(" ")[0] + " ..."
    return short.replace("|", "\\|").replace("<", "&lt;").replace("{}", "no conditions")
