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
def progress() -> Iterator[Callable[[int, int], None]]:
    """A function to call with (points done, points in all)."""
    if not sys.stderr.isatty():
        yield _plain_lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("sweep"), BarColumn(), MofNCompleteColumn(), TextColumn("points"), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("sweep", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _plain_lines() -> Callable[[int, int], None]:
    begin = time.monotonic()
    last, first_done = begin - LINE_S + QUIET_S, -1

    def report(done: int, total: int) -> None:
        nonlocal last, first_done
        now = time.monotonic()
        if first_done < 0:  # points kept by an earlier run say nothing about the speed of this one
            first_done = done
        if now - last >= LINE_S:
            fresh = done - first_done
            left = f", about {(now - begin) / fresh * (total - done):.0f} s left" if fresh else ""
            print(f"{done}/{total} points{left}", file=sys.stderr, flush=True)
            last = now

    return report
