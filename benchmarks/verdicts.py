"""How often is the verdict wrong? Devices of five families, tables of all kinds, exact eigenvalues beside.

    python benchmarks/verdicts.py --tables 100                      a first look; a new seed, which is printed
    python benchmarks/verdicts.py --seed 7 --only 123               one table again, every grid of it in words
    python benchmarks/verdicts.py --tables 3400 --swept 0.6 --calibration 2000 --jobs 2 --write --check

Every table is judged on several grids. ``--check`` ends with 1 where a bar is missed; ``--write`` rewrites the figures
of docs/how-often-wrong.md. Swept tables are kept in ``--cache`` and not swept again for the same seed.
"""

from __future__ import annotations

import argparse
import os
import secrets
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from harness import KEPT, ROOT
from verdict_families import calibration, score
from verdict_families.cases import Case, cases_of

PAGE = ROOT / "docs" / "how-often-wrong.md"
BEGIN, END = "<!-- figures: make evidence -->", "<!-- end of figures -->"


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=int, default=100, help="how many tables are drawn")
    parser.add_argument("--grids", type=int, default=3, help="grids on which each is judged")
    parser.add_argument("--swept", type=float, default=0.4, help="share of tables that are swept by the runner")
    parser.add_argument("--calibration", type=int, default=0, help="extra cases near the edge, for the probabilities")
    parser.add_argument("--seed", type=int, help="a new one unless given")
    parser.add_argument("--only", type=int, help="one table of the seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cache", type=Path, default=KEPT / "swept", help="where swept tables are kept")
    parser.add_argument("--write", action="store_true", help="rewrite the figures of the page")
    parser.add_argument("--check", action="store_true", help="end with 1 where a bar is missed")
    return parser.parse_args()


def main() -> int:
    """Run, print, and say whether the bars are met."""
    asked = arguments()
    seed = secrets.randbelow(10**6) if asked.seed is None else asked.seed
    asked.cache.mkdir(parents=True, exist_ok=True)
    one = partial(cases_of, seed, share_swept=asked.swept, grids=asked.grids, cache=asked.cache)
    if asked.only is not None:
        print(*[score.line_of(case) for case in one(asked.only)], sep="\n")
        return 0
    begin = time.process_time()
    cases = [case for of_table in _each(one, range(asked.tables), asked.jobs) for case in _told(of_table)]
    near = [
        s for s in _each(partial(calibration.stated, seed), _enough(asked.calibration), asked.jobs) if s is not None
    ]
    text, met = report(seed, asked, cases, near[: asked.calibration])
    print(text)
    print(f"\n{len(cases)} cases, {time.process_time() - begin:.0f} s of CPU in this process")
    if asked.write:
        _write(text)
    return 1 if asked.check and not met else 0


def _told(cases: list[Case]) -> list[Case]:
    """The cases; what is bad among them is told at once."""
    print(*[f"{line}\n" for line in score.worst(cases)], sep="", end="", file=sys.stderr, flush=True)
    return cases


def _enough(wanted: int) -> range:
    """Indices of calibration cases: about half of the devices drawn have an edge to stand at."""
    return range(round(2.2 * wanted))


def _each(one: Callable[[int], Any], indices: Iterable[int], jobs: int) -> Iterator[Any]:
    """Results in order."""
    if jobs == 1:
        yield from map(one, indices)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(one, indices, chunksize=4)


def report(seed: int, asked: argparse.Namespace, cases: list[Case], near: list[calibration.Stated]) -> tuple[str, bool]:
    """The figures as Markdown, and whether every bar is met."""
    bars, parts = score.bars(cases), calibration.bins(near)
    swept = len({c.index for c in cases if c.spec.source != "exact"})
    tables = len({c.index for c in cases})
    command = f"--seed {seed} --tables {asked.tables} --grids {asked.grids} --swept {asked.swept:g}"
    lines = [
        f"`python benchmarks/verdicts.py {command} --calibration {asked.calibration}`: {len(cases):,} cases of "
        f"{tables:,} tables, {swept:,} of them swept by the runner. A verdict took {score.seconds(cases)} of CPU.",
        "",
        "| bar | cases | figure | asked | |",
        "|---|---|---|---|---|",
        *[bar.row() for bar in bars],
    ]
    if parts:
        held = sum(b.held for b in parts)
        lines.append(
            f"| bins of the stated probability that hold | {len(near):,} | {held} of {len(parts)} | all | "
            f"{'met' if held == len(parts) else '**missed**'} |"
        )
    lines += ["", score.conditions(cases)]
    if parts:
        lines += ["", calibration.table(parts)]
    return "\n".join(lines), all(bar.met for bar in bars) and all(b.held for b in parts)


def _write(text: str) -> None:
    page = PAGE.read_text("utf-8")
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", "utf-8")


if __name__ == "__main__":
    sys.exit(main())
