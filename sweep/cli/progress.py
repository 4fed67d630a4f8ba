"""Progress: a bar with the time left on a terminal, one line that changes in a notebook, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

QUIET_S = 1.0
"""What is over sooner needs no progress."""

LINE_S = 5.0
"""Seconds between plain lines."""

REDRAWN_S = 0.5
"""Seconds between two texts of a notebook's line."""

Report = Callable[[int, int, float], None]
"""To call with (points done, points in all, share of the work done)."""


@contextmanager
def progress() -> Iterator[Report]:
    """A `Report` for as long as something is on its way: it shows where the user looks."""
    if (shell := _notebook()) is not None:
        with _changing_line(shell) as report:
            yield report
        return
    if not sys.stderr.isatty():
        yield _every(LINE_S, lambda text: print(text, file=sys.stderr, flush=True))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("sweep"), BarColumn(), TextColumn("{task.fields[points]} points"), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("sweep", total=1.0, points="")
        yield lambda done, total, share: bar.update(task, completed=share, points=f"{done}/{total}")


def _notebook() -> Any:
    """IPython's display module where this process is the kernel of a notebook; None elsewhere."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from importlib import import_module

    return import_module("IPython.display")


@contextmanager
def _changing_line(display: Any) -> Iterator[Report]:
    """One line below the cell, replaced by the next one and gone in the end."""
    shown: list[Any] = []

    def show(text: str) -> None:
        if not shown:
            shown.append(display.display({"text/plain": text}, raw=True, display_id=True))
        else:
            shown[0].update({"text/plain": text}, raw=True)

    try:
        yield _every(REDRAWN_S, show)
    finally:
        if shown:
            shown[0].update({"text/plain": ""}, raw=True)


def _every(seconds: float, show: Callable[[str], None]) -> Report:
    """A `Report` that shows a line of text every so often, and nothing of what is over at once."""
    begin = time.monotonic()
    last, first_share = begin - seconds + QUIET_S, -1.0

    def report(done: int, total: int, share: float) -> None:
        nonlocal last, first_share
        now = time.monotonic()
        if first_share < 0.0:  # what an earlier run kept says nothing about the speed of this one
            first_share = share
        if now - last >= seconds:
            fresh = share - first_share
            left = f", about {(now - begin) / fresh * (1.0 - share):.0f} s left" if fresh > 0.0 else ""
            show(f"{done}/{total} points{left}")
            last = now

    return report
