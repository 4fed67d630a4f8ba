"""Runs every command that the pages show, and writes what it printed into the pages: ``python docs/site/executed.py``.

A page's ``console`` blocks are one session, from its top to its end, in a copy of what a clone has, through a pipe::

    ```console
    $ seqsweep run examples/table1.toml -o y.parquet
    y.parquet: 100 ok
    ```

What is shown shortened (a line of three dots) stays shortened: a printed line is shown if one like it, up to its
digits, was shown before, or if it is new where nothing was left out. Three remarks belong to a session that readers do
not see: ``<!-- before: COMMAND -->`` runs a command without showing it, ``<!-- file: NAME -->`` writes the block below
it to a file, and ``<!-- picture: NAME PLACE -->`` brings a picture into ``docs``. A command that fails ends the
session, unless ``$ echo $?`` follows it; so does a line of `seqsweep` that is wider than 80 columns, JSON excepted.
Lines of progress, which come by the clock, are not shown.

What a session printed is kept in ``build/docs`` until its page's commands or the program change.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

TOP = Path(__file__).parents[2]
DOCS = TOP / "docs"
KEPT = TOP / "build" / "docs" / "executed"
PROGRAM = ("seqsweep", "plant", "identify", "tuning", "sweep", "examples", "data")
CLONE = ("examples", "data", "tests/support/boxes")
"""What a session finds in its folder."""

MOST_S = 900.0
"""Wall time (s) that one command may take."""

WIDTH = 80
"""Columns that a line may take."""

STEP = re.compile(
    r"<!-- before: (?P<before>.*?) -->"
    r"|<!-- picture: (?P<drawn>\S+) (?P<picture>\S+) -->"
    r"|<!-- file: (?P<file>\S+) -->\n+```\w*\n(?P<text>.*?)```"
    r"|```console\n(?P<console>.*?)```",
    re.DOTALL,
)
LEFT_OUT = "..."
PROGRESS = re.compile(  # the last kind goes on below
    r"^(?:\d+/\d+ (?:points|pairs|rows|shots|sweeps)\b.*|took \d.*|going on: \d.*"
    r"|\S+: (?:not yet at a shot|unperturbed|at (?:shot )?\d+ (?:of|shots)).*(?:\n  .*)*)(?:\n|\Z)",
    re.MULTILINE,
)
Step = tuple[str, str, str]
"""Kind (run, file, picture), name, and command, text or file."""


class SessionFailed(Exception):
    """A command of a page that did not do what the page says."""


@dataclass(frozen=True)
class Shown:
    """A command and the lines that are shown below it."""

    command: str
    lines: tuple[str, ...]


@dataclass
class Session:
    """Where a page's commands run, and what the last one left."""

    folder: Path
    there: Path
    status: int = 0
    printed: list[str] = field(default_factory=list)

    def run(self, command: str) -> str:
        """What a command prints, standard output and error as a terminal mixes them."""
        where = self.folder.parent / "where"
        script = f"trap 'pwd > {where}' EXIT\n(exit {self.status})\n{command}"
        done = subprocess.Popen(
            ["bash", "-c", script],
            cwd=self.there,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = done.communicate(timeout=MOST_S)
        except subprocess.TimeoutExpired:
            os.killpg(done.pid, signal.SIGKILL)
            raise SessionFailed(f"$ {command}\ntook longer than {MOST_S:g} s") from None
        self.status = done.returncode
        self.there = Path(where.read_text().strip())
        return said.replace(str(self.folder), "/home/you/seqsweep")


def _environment() -> dict[str, str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    plain = {"PATH": path, "NO_COLOR": "1", "TERM": "dumb", "PYTHONWARNINGS": ""}
    return {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")} | plain


def pages() -> list[Path]:
    """Pages that show commands."""
    made = {DOCS / "generated", DOCS / "gallery", DOCS / "notebooks"}
    return sorted(
        path
        for path in DOCS.rglob("*.md")
        if not made & set(path.parents) and "```console\n" in path.read_text("utf-8")
    )


def commands_of(block: str) -> Iterator[Shown]:
    """Commands of a console block with the lines below each."""
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        command, rest = _split(part)
        yield Shown(command, tuple(rest.splitlines()))


def _split(part: str) -> tuple[str, str]:
    """The command, over all lines that end in a backslash, and what is below it."""
    found = re.match(r"(?:.*\\\n)*.*\n?", part)
    assert found
    return found[0].rstrip("\n"), part[found.end() :]


def steps_of(text: str) -> list[Step]:
    """What a page's session does, in order: (kind, name, text)."""
    steps = []
    for match in STEP.finditer(text):
        if match["before"]:
            steps.append(("run", "hidden", match["before"]))
        elif match["picture"]:
            steps.append(("picture", match["picture"], match["drawn"]))
        elif match["file"]:
            steps.append(("file", match["file"], match["text"]))
        else:
            steps += [("run", "shown", shown.command) for shown in commands_of(match["console"])]
    return steps


def run_session(steps: Sequence[Step], pictures: Path) -> list[str]:
    """What the shown commands of a session print, run in a folder of their own; its pictures go to ``pictures``."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        top = Path(folder) / "seqsweep"
        for name in CLONE:
            shutil.copytree(TOP / name, top / name, ignore=shutil.ignore_patterns("__pycache__"))
        session = Session(top, top)
        printed = []
        for k, (kind, name, text) in enumerate(steps):
            if kind == "file":
                (session.there / name).write_text(text, "utf-8")
            elif kind == "picture":
                shutil.copyfile(top / text, pictures / Path(name).name)
            else:
                expected = k + 1 < len(steps) and steps[k + 1][2] == "echo $?"
                said = _said(session, text, expected)
                printed += [said] if name == "shown" else []
        return printed


def _said(session: Session, command: str, may_fail: bool) -> str:
    """What a command prints, but for lines of progress and of the time taken, which come by the clock."""
    said = session.run(command)
    if session.status and not may_fail:
        raise SessionFailed(f"$ {command}\n{said}exit status {session.status}")
    if wide := too_wide(command, said):
        raise SessionFailed(f"$ {command}\n{wide[0]}\nis wider than {WIDTH} columns")
    return PROGRESS.sub("", said)


def too_wide(command: str, said: str) -> list[str]:
    """Lines of our own commands that fit no terminal; a single word, such as a path, may be as long as it is."""
    if not command.startswith("seqsweep ") or "--json" in command or "seqsweep man" in command:
        return []
    return [line for line in said.splitlines() if len(line) > WIDTH and len(line.split()) > 1]


def kept_or_run(steps: Sequence[Step], program: str) -> tuple[list[str], Path]:
    """What a session prints and the folder of its pictures, kept in `KEPT` until the steps or the program change."""
    key = hashlib.sha256(json.dumps([program, steps]).encode()).hexdigest()[:24]
    folder = KEPT / key
    if not (folder / "printed.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "printed.json").write_text(json.dumps(run_session(steps, folder)), "utf-8")
    kept: list[str] = json.loads((folder / "printed.json").read_text("utf-8"))
    return kept, folder


def program_digest() -> str:
    """A hash of everything that decides what a command prints."""
    digest = hashlib.sha256()
    for name in PROGRAM:
        for path in sorted((TOP / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(str(path.relative_to(TOP)).encode() + path.read_bytes())
    return digest.hexdigest()


def _alike(line: str) -> str:
    """A line up to its digits and rules: what makes two lines the same line of an output."""
    return re.sub(r"[-+]?\d[\d.,]*(e[-+]?\d+)?", "0", re.sub(r"-{2,}|\s+", " ", line)).strip()


TIME_TAKEN = re.compile(r"\b(?:took|wall|done in|finished in)\b|^about [\d.]+ s with ")
A_TIME = re.compile(r"\d[\d.]*(?= (?:s|ms|min|h)\b)")


def merged(shown: Sequence[str], printed: Sequence[str]) -> list[str]:
    """The printed lines, shortened where the shown ones are."""
    if LEFT_OUT not in shown:
        return [_kept_time(line, shown) for line in printed]
    old = [line for line in shown if line != LEFT_OUT]
    gaps = _gaps(shown)
    matcher = difflib.SequenceMatcher(None, [_alike(o) for o in old], [_alike(p) for p in printed], autojunk=False)
    lines: list[str] = []
    for _, low, high, start, stop in matcher.get_opcodes():
        equal = high - low == stop - start and all(
            _alike(a) == _alike(b) for a, b in zip(old[low:high], printed[start:stop], strict=True)
        )
        if equal:
            lines += [_kept_time(line, shown) for line in printed[start:stop]]
        elif stop > start and not gaps & set(range(low, high + 1)):
            lines += printed[start:stop]
        elif stop > start:
            lines += _resembling(printed[start:stop], old[low:high])
    return [line for k, line in enumerate(lines) if line != LEFT_OUT or k == 0 or lines[k - 1] != LEFT_OUT]


def _resembling(printed: Sequence[str], old: Sequence[str]) -> list[str]:
    """Printed lines that read like one of the old ones, with what they go on with; dots for the others."""
    lines = []
    kept = False
    for line in printed:
        goes_on = kept and line.startswith("  ")
        kept = goes_on or bool(difflib.get_close_matches(_alike(line), map(_alike, old), 1, 0.7))
        lines.append(line if kept else LEFT_OUT)
    return lines


def _gaps(shown: Sequence[str]) -> set[int]:
    """Places between the lines that are shown where some are left out."""
    gaps, at = set(), 0
    for line in shown:
        if line == LEFT_OUT:
            gaps.add(at)
        else:
            at += 1
    return gaps


def _kept_time(line: str, shown: Sequence[str]) -> str:
    """A line that says how long something took stays as it is on the page: it is another one every time."""
    if not TIME_TAKEN.search(line):
        return line
    return next((old for old in shown if A_TIME.sub("0", old) == A_TIME.sub("0", line)), line)


def rewritten(text: str, printed: Sequence[str]) -> str:
    """The page with what its commands printed."""
    outputs = iter(printed)

    def block(match: re.Match[str]) -> str:
        if match["console"] is None:
            return match[0]
        parts = []
        for shown in commands_of(match["console"]):
            lines = merged(shown.lines, next(outputs).rstrip("\n").splitlines())
            parts += [f"$ {shown.command}", *(line.rstrip() for line in lines)]
        return "```console\n" + "\n".join(parts) + "\n```"

    return STEP.sub(block, text)


def refreshed(path: Path, program: str) -> dict[Path, bytes]:
    """A page, and the pictures on it, as its commands make them now."""
    text = path.read_text("utf-8")
    steps = steps_of(text)
    try:
        printed, folder = kept_or_run(steps, program)
    except SessionFailed as failure:
        raise SessionFailed(f"{path.relative_to(TOP)}:\n{failure}") from None
    pictures = {DOCS / name: (folder / Path(name).name).read_bytes() for kind, name, _ in steps if kind == "picture"}
    return {path: rewritten(text, printed).encode(), **pictures}


def bring(page: Path, program: str, check: bool) -> bool:
    """Write a page and its pictures as they are now, or with ``check`` say how the page differs; whether it did."""
    refreshed(page, program)
    fresh = refreshed(page, program)  # from what is kept: the page may have been edited meanwhile
    stale = {path: now for path, now in fresh.items() if not path.exists() or path.read_bytes() != now}
    for path, now in stale.items():
        print(f"{path.relative_to(TOP)} is not what its commands give now", flush=True)
        if not check:
            path.write_bytes(now)
    if check and page in stale:
        old, new = page.read_text("utf-8").splitlines(), stale[page].decode().splitlines()
        print(*difflib.unified_diff(old, new, lineterm=""), sep="\n", flush=True)
    return page in stale


def main(names: Sequence[str]) -> int:
    """Refresh all pages, or the named ones; with ``--check`` only say which are out of date."""
    check = "--check" in names
    chosen = [Path(name).resolve() for name in names if name != "--check"] or pages()
    program = program_digest()
    with ThreadPoolExecutor(2) as pool:
        stale = list(pool.map(lambda page: bring(page, program, check), chosen))
    return int(check and any(stale))


if __name__ == "__main__":
    try:
        raise SystemExit(main(sys.argv[1:]))
    except SessionFailed as failure:
        raise SystemExit(str(failure)) from None
