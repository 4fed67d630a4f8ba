"""The surrogate over operating points held to its bars, beside a library's method.

    python benchmarks/surrogate.py                               a first look; a new seed, which is printed
    python benchmarks/surrogate.py --only certificates --designs 50 --seed 7
    python benchmarks/surrogate.py --only certificates --designs 1 --seed 23     the design of one seed again
    python benchmarks/surrogate.py --designs 200 --jobs 2 --write --check

Truth is the exact linearisation of the devices (tests/support). What misses a bar is told with its seed. Answers are
kept as they come: the same seed goes on where it was ended, and a larger count adds to a smaller one. ``--write``
rewrites the figures of docs/surrogate.md (or of ``--page``), ``--check`` ends with 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from harness import FIGURES, KEPT, ROOT, add_run_options, rewrite

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from operating_region import bars
from operating_region.kept import Kept

PAGE = ROOT / "docs" / "surrogate.md"

BARS = {
    "certificates": (bars.certificates, "designs"),
    "coverage": (bars.coverage, "covered"),
    "verdicts": (bars.judged, "pairs"),
    "modes": (bars.modes, "grids"),
    "worst": (bars.worst, "searches"),
    "jumps": (bars.jumps, "placements"),
    "swept": (bars.swept, "runs"),
    "speed": (bars.speed, "campaigns"),
}
"""Every bar, and the option that says how much of it is run."""


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", default=",".join(BARS), help=f"bars, separated by commas: {', '.join(BARS)}")
    parser.add_argument("--designs", type=int, default=4, help="designs of each kind that are to be certified")
    parser.add_argument("--covered", type=int, default=8, help="designs whose regions are held against the truth")
    parser.add_argument("--pairs", type=int, default=40, help="grids and operating points that are judged")
    parser.add_argument("--grids", type=int, default=20, help="grids on which the critical mode is asked for")
    parser.add_argument("--searches", type=int, default=0, help="searches of the worst point of a bank")
    parser.add_argument("--placements", type=int, default=0, help="placements of each kind of jump, and of none")
    parser.add_argument("--runs", type=int, default=0, help="campaigns of each device whose rows `run` sweeps")
    parser.add_argument("--campaigns", type=int, default=1, help="campaigns that are timed")
    parser.add_argument("--rivals", type=int, default=2, help="as many of each kind for the library's method")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page whose figures --write rewrites")
    add_run_options(parser)
    return parser.parse_args()


def main() -> int:
    """Run, print, and say whether the bars are met."""
    asked = arguments()
    print(f"seed {asked.seed}", file=sys.stderr)
    parts, met = [], True
    with ProcessPoolExecutor(asked.jobs) as processes:
        pool = Kept(processes, asked.jobs, KEPT / "surrogate", ROOT)
        for name in asked.only.split(","):
            begin = time.perf_counter()
            bar, option = BARS[name]
            rows = bar(pool, asked.seed, getattr(asked, option), asked.rivals)
            parts += [row.line() for row in rows]
            met = met and all(row.met is not False for row in rows)
            print(f"{name}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
            print(*[row.line() for row in rows], sep="\n", flush=True)
    if asked.write:
        rewrite(asked.page, *FIGURES, _page(asked, parts))
    return 1 if asked.check and not met else 0


def _page(asked: argparse.Namespace, lines: list[str]) -> str:
    counts = [*(option for name, (_, option) in BARS.items() if name in asked.only.split(",")), "rivals"]
    told = " ".join(f"--{option} {getattr(asked, option)}" for option in counts)
    only = "" if asked.only == ",".join(BARS) else f" --only {asked.only}"
    return "\n".join([f"`python benchmarks/surrogate.py --seed {asked.seed} {told}{only}`:", "", bars.HEAD, *lines])


if __name__ == "__main__":
    sys.exit(main())
