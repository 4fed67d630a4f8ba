"""What seqsweep stands on, written into docs/dependencies.md and supply/seqsweep.cdx.json: ``make lock``.

The page lists every distribution that the program, its extras, its tests and its site need, directly or through others,
with its licence. The other file is the bill of materials (CycloneDX 1.6) that wheels carry in their metadata (PEP 770):
what the program and its extras need, without tests and site. Both are made of the metadata of what is installed beside
the interpreter that runs this, whose versions are those of constraints.txt.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

from licences import licence_of
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

TOP = Path(__file__).resolve().parent.parent
PAGE = TOP / "docs" / "dependencies.md"
BILL = TOP / "supply" / "seqsweep.cdx.json"

TOOLS = ("test", "docs")
"""Extras that whoever uses the program does without."""

LEFT_OUT = ("bench",)
"""Extras that `make env` does not install."""

HEAD = """\
# What it stands on

| At a glance | |
|---|---|
| You type | `make lock` |
| You see | every distribution that is needed, with version and licence |
| It means | nothing comes along unseen |
| Next | [what a campaign survives](alive.md) |

Every distribution (package of PyPI) that the program needs, directly or through others, on CPython 3.11 under Linux.
Versions are those of `constraints.txt`, with which everything is tested; the program itself allows the ranges in
`pyproject.toml`. The licence is what the distribution's own metadata says.

- `constraints.lock` holds the same versions with the check sums (SHA-256) of all their files on PyPI, and `make env`
  installs by it: a file that differs by one byte is refused. It is made for CPython 3.11 under Linux.
- A wheel carries the first two of these lists in its metadata, `sboms/seqsweep.cdx.json` (CycloneDX 1.6, PEP 770), for
  tools that look for known weaknesses.
- `make audit` compares every installed file with the check sum with which it was installed, and every version with
  `constraints.lock`. It needs no network. Whether a version has a *known* weakness can be told only by a database on
  the network, which `pip-audit -r constraints.lock --disable-pip` asks.
- The program opens no network connection, executes no text and unpickles no file: `tests/face/test_trust.py`.
"""


@dataclass(frozen=True)
class Needed:
    """A distribution: name, version, licence, by what it is needed, and what it needs itself."""

    name: str
    version: str
    licence: str
    groups: tuple[str, ...]
    needs: tuple[str, ...]


def declared() -> dict[str, list[str]]:
    """Requirements of pyproject.toml by group: "" is the program itself."""
    project = tomllib.loads((TOP / "pyproject.toml").read_text("utf-8"))["project"]
    extras = {name: lines for name, lines in project["optional-dependencies"].items() if name not in LEFT_OUT}
    return {"": project["dependencies"], **extras}


def applying(lines: Iterable[str], extras: Iterable[str] = ()) -> list[Requirement]:
    """Requirements whose markers hold here, with one of ``extras`` or none."""
    found = [Requirement(line) for line in lines]
    wanted = [*extras, ""]
    return [r for r in found if r.marker is None or any(r.marker.evaluate({"extra": extra}) for extra in wanted)]


def needs_of(requirement: Requirement) -> list[Requirement]:
    """What a requirement needs itself."""
    return applying(distribution(requirement.name).requires or (), requirement.extras)


def closure(lines: Iterable[str]) -> set[str]:
    """Names of everything that requirements need, directly or through others."""
    waiting, seen = applying(lines), set()
    while waiting:
        requirement = waiting.pop()
        key = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if key not in seen:
            seen.add(key)
            waiting += needs_of(requirement)
    return {name for name, _ in seen}


def everything() -> list[Needed]:
    """Every distribution, by name."""
    groups = {group: closure(lines) for group, lines in declared().items()}
    return [needed(name, groups) for name in sorted(set().union(*groups.values()))]


def needed(name: str, groups: dict[str, set[str]]) -> Needed:
    """One of them, as it is installed."""
    found, all_names = distribution(name), set().union(*groups.values())
    needs = {canonicalize_name(r.name) for r in applying(found.requires or ())} & all_names
    by = tuple(group for group, names in groups.items() if name in names)
    return Needed(name, found.version, licence_of(found), by, tuple(sorted(needs)))


def of_the_program(found: Iterable[Needed]) -> list[Needed]:
    """Without what tests and site alone need."""
    return [one for one in found if set(one.groups) - set(TOOLS)]


# ---------------------------------------------------------------- the page


def page(found: list[Needed]) -> str:
    """Text of docs/dependencies.md."""
    core = [one for one in found if "" in one.groups]
    optional = [one for one in of_the_program(found) if one not in core]
    tools = [one for one in found if one not in core and one not in optional]
    parts = [
        ("The program", core, "Installed with `pip install seqsweep`."),
        ("Its extras", optional, "Installed where an extra is asked for: `pip install 'seqsweep[dask]'`."),
        ("Tests and site", tools, "For developers only."),
    ]
    return HEAD + "".join(map(section, parts))


def section(part: tuple[str, list[Needed], str]) -> str:
    """A title, words and a table."""
    title, rows, words = part
    return f"\n## {title}\n\n{words} {len(rows)} distributions.\n\n{table(rows)}"


def table(rows: list[Needed]) -> str:
    """A table of Markdown."""
    lines = [
        f"| {one.name} | {one.version} | {one.licence} | {', '.join(group for group in one.groups if group)} |\n"
        for one in rows
    ]
    return "| distribution | version | licence | extras |\n|---|---|---|---|\n" + "".join(lines)


# ---------------------------------------------------------------- the bill of materials


def bill(found: list[Needed]) -> dict:
    """CycloneDX 1.6: components, and who needs whom."""
    project = tomllib.loads((TOP / "pyproject.toml").read_text("utf-8"))["project"]
    rows, root = of_the_program(found), reference("seqsweep", project["version"])
    kept = {one.name: reference(one.name, one.version) for one in rows}
    direct = [canonicalize_name(r.name) for g, lines in declared().items() if g not in TOOLS for r in applying(lines)]
    edges = {root: direct, **{kept[one.name]: one.needs for one in rows}}
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "seqsweep",
                "version": project["version"],
                "licenses": [{"expression": project["license"]}],
                "purl": root,
            }
        },
        "components": [component(one) for one in rows],
        "dependencies": [
            {"ref": ref, "dependsOn": sorted({kept[name] for name in names if name in kept})}
            for ref, names in sorted(edges.items())
        ],
    }


def component(one: Needed) -> dict:
    """One distribution; ``scope`` says whether the program runs without it."""
    ref = reference(one.name, one.version)
    return {
        "type": "library",
        "bom-ref": ref,
        "name": one.name,
        "version": one.version,
        "scope": "required" if "" in one.groups else "optional",
        "licenses": [{"expression": one.licence}],
        "purl": ref,
    }


def reference(name: str, version: str) -> str:
    """Its package URL."""
    return f"pkg:pypi/{name}@{version}"


def files() -> dict[Path, str]:
    """What is written, by file."""
    found = everything()
    return {PAGE: page(found), BILL: json.dumps(bill(found), indent=1) + "\n"}


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, "utf-8")
        print(path.relative_to(TOP))
