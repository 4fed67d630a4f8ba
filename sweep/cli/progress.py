"""Progress: a bar with the time left on a terminal, one line that changes in a notebook, plain lines elsewhere.

Where nothing has been finished for long, that is said, too.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from ...tuning.layout import folded
from .say import columns
from .telling import in_words, is_quiet

QUIET_S = 1.0
"""What is over sooner needs no progress."""

LINE_S = 5.0
"""Seconds between plain lines."""

REDRAWN_S = 0.5
"""Seconds between two texts of a notebook's line."""

STALLED_S = 20.0
"""Nothing finished for so long is said, and again after each such time."""

Report = Callable[[int, int, float], None]
"""To call with (points done, points in all, share of the work done)."""


class Progress(NamedTuple):
    """Where progress goes: numbers by ``report``, a line of text by ``say``; ``say`` may be called from any thread."""

    report: Report
    say: Callable[[str], None]


@contextmanager
def progress() -> Iterator[Progress]:
    """A `Progress` for as long as something is on its way: it shows where the user looks."""
    if is_quiet():
        yield Progress(lambda done, total, share: None, lambda text: None)
    elif (shell := _notebook()) is not None:
        with _changing_line(shell) as shown:
            yield shown
    elif sys.stderr.isatty():
        with _bar() as shown:
            yield shown
    else:
        with _lines(LINE_S, _print) as shown:
            yield shown


def _print(text: str) -> None:
    print(folded(text, columns()), file=sys.stderr, flush=True)


@contextmanager
def _bar() -> Iterator[Progress]:
    """A bar at the foot of the terminal; lines of text, also those of others on stderr, go above it."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        TextColumn("sweep"),
        BarColumn(bar_width=None),
        TextColumn("{task.fields[points]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console, transient=True, expand=True, redirect_stdout=False) as bar:
        task = bar.add_task("sweep", total=1.0, points="")

        def report(done: int, total: int, share: float) -> None:
            bar.update(task, completed=share, points=f"{done}/{total} points")

        yield Progress(report, lambda text: console.print(text, markup=False, highlight=False))


def _notebook() -> Any:
    """IPython's display module where this process is the kernel of a notebook; None elsewhere."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from importlib import import_module

    return import_module("IPython.display")


@contextmanager
def _changing_line(display: Any) -> Iterator[Progress]:
    """One line below the cell, replaced by the next one and gone in the end."""
    shown: list[Any] = []

    def show(text: str) -> None:
        if not shown:
            shown.append(display.display({"text/plain": text}, raw=True, display_id=True))
        else:
            shown[0].update({"text/plain": text}, raw=True)

    try:
        with _lines(REDRAWN_S, show) as found:
            yield found
    finally:
        if shown:
            shown[0].update({"text/plain": ""}, raw=True)


@contextmanager
def _lines(seconds: float, show: Callable[[str], None]) -> Iterator[Progress]:
    """Lines of text every so often, and where nothing has been finished for long; nothing of what is over at once."""
    lock, over, seen = threading.Lock(), threading.Event(), _Seen()

    def say(text: str) -> None:
        with lock:
            show(text)

    every = _every(seconds, say)

    def report(done: int, total: int, share: float) -> None:
        seen.at, seen.done, seen.total = time.monotonic(), done, total
        every(done, total, share)

    def watch() -> None:
        while not over.wait(STALLED_S):
            stalled = time.monotonic() - seen.at
            if stalled >= STALLED_S:
                points = f"{seen.done}/{seen.total} points, " if seen.total else ""
                say(f"{points}none finished for {in_words(stalled)}")

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield Progress(report, say)
    finally:
        over.set()
        watching.join()


class _Seen:
    """When something was finished last, and how many were by then."""

    def __init__(self) -> None:
        self.at, self.done, self.total = time.monotonic(), 0, 0


def _every(seconds: float, show: Callable[[str], None]) -> Report:
    """A `Report` that shows a line of text every so often, and nothing of what is over at once."""
    last = time.monotonic() - seconds + QUIET_S
    kept, paced_from = -1.0, (0.0, 1.0)

    def report(done: int, total: int, share: float) -> None:
        nonlocal last, kept, paced_from
        now = time.monotonic()
        if kept < 0.0:  # what an earlier run kept says nothing about the speed of this one
            kept = share
        elif paced_from[1] == 1.0 and share > kept:  # nor does the first of this one: it waits for code and workers
            paced_from = now, share
        if now - last >= seconds:
            begin, fresh = paced_from[0], share - paced_from[1]
            left = f", about {in_words((now - begin) / fresh * (1.0 - share))} left" if fresh > 0.0 else ""
            show(f"{done}/{total} points{left}")
            last = now

    return report
