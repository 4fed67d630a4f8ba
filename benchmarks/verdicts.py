"""How often is the verdict wrong? Devices of five families, tables of all kinds, exact eigenvalues beside.

    python benchmarks/verdicts.py --tables 100                      a first look; a new seed, which is printed
    python benchmarks/verdicts.py --tables 2000 --due               only cases in which a verdict is due, none swept
    python benchmarks/verdicts.py --seed 7 --only 123               one table again, every grid of it in words
    python benchmarks/verdicts.py --tables 3400 --swept 0.6 --calibration 2000 --jobs 2 --write --check

Every table is judged on several grids. ``--check`` ends with 1 where a bar is missed; ``--write`` rewrites the figures
of docs/how-often-wrong.md. Answers are kept as they come: the same seed goes on where it was ended (by Ctrl-C, or by
``--minutes``), and the figures are those of the tables that were really judged. Swept tables are kept as well.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from harness import FIGURES, KEPT, ROOT, add_run_options, rewrite
from verdict_families import calibration, kept, score
from verdict_families.cases import Case, cases_of

PAGE = ROOT / "docs" / "how-often-wrong.md"


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=int, default=100, help="how many tables are drawn")
    parser.add_argument("--grids", type=int, default=3, help="grids on which each is judged")
    parser.add_argument("--swept", type=float, default=0.4, help="share of tables that are swept by the runner")
    parser.add_argument("--due", action="store_true", help="only cases in which a verdict is due, rows by formula")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no further table after so long")
    parser.add_argument("--calibration", type=int, default=0, help="extra cases near the edge, for the probabilities")
    parser.add_argument("--only", type=int, help="one table of the seed")
    parser.add_argument("--cache", type=Path, default=KEPT / "swept", help="where swept tables are kept")
    add_run_options(parser)
    return parser.parse_args()


def main() -> int:
    """Run, print, and say whether the bars are met."""
    asked = arguments()
    asked.cache.mkdir(parents=True, exist_ok=True)
    share, wanted = (0.0, partial(score.is_nearly_due, noise=score.NOISY)) if asked.due else (asked.swept, None)
    one = partial(cases_of, asked.seed, share_swept=share, grids=asked.grids, cache=asked.cache, is_wanted=wanted)
    if asked.only is not None:
        print(*[score.line_of(case) for case in one(asked.only)], sep="\n")
        return 0
    print(f"seed {asked.seed}", file=sys.stderr)
    file = kept.per_run(KEPT / "verdicts", ROOT, asked.seed, asked.grids, f"{share:g}", "due" if asked.due else "all")
    goes_on = _until(time.monotonic() + 60.0 * asked.minutes)
    answered = partial(kept.answers, jobs=asked.jobs, goes_on=goes_on)
    tables = list(_told(answered(one, range(asked.tables), file("cases"))))
    near = _near(answered(partial(calibration.stated, asked.seed), _enough(asked.calibration), file("calibration")))
    text, met = report(asked, tables, near[: asked.calibration])
    print(text)
    if asked.write:
        rewrite(PAGE, *FIGURES, text)
    return 1 if asked.check and not met else 0


def _until(end_s: float) -> Callable[[], bool]:
    return lambda: time.monotonic() < end_s


def _told(tables: Iterator[list[Case]]) -> Iterator[list[Case]]:
    """The tables' cases; what is bad among them is told at once. Ctrl-C ends them, and what there is counts."""
    try:
        for cases in tables:
            print(*[f"{line}\n" for line in score.worst(cases)], sep="", end="", file=sys.stderr, flush=True)
            yield cases
    except KeyboardInterrupt:
        print("ended early", file=sys.stderr)


def _near(found: Iterator[Any]) -> list[calibration.Stated]:
    """Cases of the calibration."""
    return [stated for stated in found if stated is not None]


def _enough(wanted: int) -> range:
    """Indices of calibration cases: about half of the devices drawn have an edge to stand at."""
    return range(round(2.2 * wanted))


def report(asked: argparse.Namespace, tables: list[list[Case]], near: list[calibration.Stated]) -> tuple[str, bool]:
    """The figures as Markdown, of what was really judged, and whether every bar is met."""
    cases = [case for of_table in tables for case in of_table]
    bars, parts = score.bars(cases), calibration.bins(near)
    swept = len({c.index for c in cases if c.spec.source != "exact"})
    drawn = "--due" if asked.due else f"--swept {asked.swept:g}"
    command = f"--seed {asked.seed} --tables {len(tables)} --grids {asked.grids} {drawn}"
    lines = [
        f"`python benchmarks/verdicts.py {command} --calibration {len(near)}`: {len(cases):,} cases of "
        f"{len({c.index for c in cases}):,} tables, {swept:,} of them swept by the runner. A verdict took "
        f"{score.seconds(cases)} of CPU.",
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
    lines += ["", score.certain_shares(cases), "", score.conditions(cases)]
    if parts:
        lines += ["", calibration.table(parts)]
    return "\n".join(lines), all(bar.met for bar in bars) and all(b.held for b in parts)


if __name__ == "__main__":
    sys.exit(main())
