"""Progress on stderr: a bar with the time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

QUIET_S = 1.0
"""What is over sooner needs no progress."""

LINE_S = 5.0
"""Seconds between plain lines."""


@contextmanager
def progress() -> Iterator[Callable[[int, int, float], None]]:
    """A function to call with (points done, points in all, share of the work done)."""
    if not sys.stderr.isatty():
        yield _plain_lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("sweep"), BarColumn(), TextColumn("{task.fields[points]} points"), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("sweep", total=1.0, points="")
        yield lambda done, total, share: bar.update(task, completed=share, points=f"{done}/{total}")


def _plain_lines() -> Callable[[int, int, float], None]:
    begin = time.monotonic()
    last, first_share = begin - LINE_S + QUIET_S, -1.0

    def report(done: int, total: int, share: float) -> None:
        nonlocal last, first_share
        now = time.monotonic()
        if first_share < 0.0:  # what an earlier run kept says nothing about the speed of this one
            first_share = share
        if now - last >= LINE_S:
            fresh = share - first_share
            left = f", about {(now - begin) / fresh * (1.0 - share):.0f} s left" if fresh > 0.0 else ""
            print(f"{done}/{total} points{left}", file=sys.stderr, flush=True)
            last = now

    return report
