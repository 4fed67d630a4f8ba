"""Answers kept on disk one by one: what was ended early goes on where it was, and more adds to what is known.

They belong to the function that gave them, to what it was asked, and to the text of the product and of the benchmark.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from verdict_families.kept import fingerprint, read

ASKED = ("identify", "tuning", "sweep", "benchmarks/operating_region", "tests/support")
"""Folders whose text decides what the answers are."""


class Kept:
    """Maps functions over seeds as a pool does; what was answered before is read, what is new is kept.

    Parameters
    ----------
    pool : Executor
        Asks what is not known.
    jobs : int
        How many questions it is asked at a time.
    folder : path
        Where answers are kept.
    root : path
        The repository.
    """

    def __init__(self, pool: Executor, jobs: int, folder: Path, root: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self._pool, self._jobs = pool, jobs
        self._file = folder / f"{fingerprint(root, ASKED)}.pickle"
        entries, whole = read(self._file)
        self._known = dict(entries)
        with self._file.open("ab") as out:  # what an interruption cut off is taken away
            out.truncate(whole)

    def map(self, function: Callable[[Any], Any], questions: Iterable[Any]) -> Iterator[Any]:
        """Answers in the order of the questions."""
        asked, name = list(questions), _name(function)
        new = [each for each in asked if (*name, each) not in self._known]
        for start in range(0, len(new), self._jobs):
            batch = new[start : start + self._jobs]
            for each, answer in zip(batch, self._pool.map(function, batch), strict=True):
                self._keep((*name, each), answer)
        return iter([self._known[*name, each] for each in asked])

    def _keep(self, key: tuple[Any, ...], answer: Any) -> None:
        self._known[key] = answer
        with self._file.open("ab") as out:
            pickle.dump((key, answer), out)


def _name(function: Callable[[Any], Any]) -> tuple[Any, ...]:
    """What a function is, and what it is asked but for its last argument."""
    if isinstance(function, partial):
        return (*_name(function.func), *function.args)
    return (function.__module__, function.__qualname__)
