"""Answers kept on disk, one after the other, so that a run that was ended early can be counted, and gone on with.

They belong to a seed and its options, and to the product that gave them: another one is asked anew.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

ASKED = ("tuning", "identify", "benchmarks/verdict_families")
"""Folders whose text decides what the answers are."""


def fingerprint(root: Path, folders: Sequence[str] = ASKED) -> str:
    """Short hash of the product that answers, and of the benchmark that asks."""
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted((root / folder).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:10]


def answers(
    one: Callable[[int], Any], indices: range, file: Path, jobs: int, goes_on: Callable[[], bool]
) -> Iterator[Any]:
    """Answers in order: those in ``file`` first, then new ones, which are added to it, as long as it ``goes_on``."""
    known, whole = read(file)
    yield from known[: len(indices)]
    for number, answer in enumerate(_each(one, indices[len(known) :], jobs, goes_on)):
        with file.open("r+b" if file.exists() else "wb") as out:
            out.seek(0, 2)
            if number == 0:  # what an interruption cut off is taken away
                out.truncate(whole)
                out.seek(whole)
            pickle.dump(answer, out)
        yield answer


def read(file: Path) -> tuple[list[Any], int]:
    """Whole answers, and where in the file they end."""
    found: list[Any] = []
    end = 0
    if not file.exists():
        return found, end
    with file.open("rb") as source:
        while True:
            try:
                found.append(pickle.load(source))
                end = source.tell()
            except (EOFError, pickle.UnpicklingError):
                return found, end


def _each(one: Callable[[int], Any], indices: Iterable[int], jobs: int, goes_on: Callable[[], bool]) -> Iterator[Any]:
    asked = takewhile(lambda _: goes_on(), indices)
    if jobs == 1:
        yield from map(one, asked)
        return
    with ProcessPoolExecutor(jobs) as pool:
        while batch := [index for _, index in zip(range(8 * jobs), asked, strict=False)]:
            yield from pool.map(one, batch)


def per_run(folder: Path, root: Path, *options: object) -> Callable[[str], Path]:
    """File names of one run: of its options and its product."""
    folder.mkdir(parents=True, exist_ok=True)
    return partial(_name, folder, "-".join(str(option) for option in (*options, fingerprint(root))))


def _name(folder: Path, run: str, kind: str) -> Path:
    return folder / f"{kind}-{run}.pickle"
