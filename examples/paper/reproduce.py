"""The paper, reproduced: every figure and number from sweeps and runs of the reference turbine.

    python examples/paper/reproduce.py

writes docs/figures/paper-*.png and the table in docs/paper.md, and prints the table.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import comparison
import pictures
import simulated
import swept
from simulated import NONE, Gain, Story

DOCS = Path(__file__).resolve().parents[2] / "docs"


class Results(NamedTuple):
    """Everything that is drawn and tabled."""

    study: swept.Study
    steps: list[Story]
    wider: list[Story]
    faults: list[Story]


def results() -> Results:
    """Sweep and simulate."""
    study = swept.study()
    paper = Gain(swept.K_PAPER, swept.F_R_PAPER_HZ, f"k = {swept.K_PAPER}")
    ours = Gain(study.search.k, study.f_r_hz, f"k = {study.search.k:.2f}, m = {swept.MARGIN:g} when swept")
    wide = ours._replace(f_r_hz=swept.f_r_of(study.points[swept.SCENARIO]), label=f"k = {study.search.k:.2f}")
    return Results(
        study,
        [simulated.grid_step(power_mw, (NONE, paper, ours)) for power_mw in (0.60, 0.65)],
        [*simulated.weaker_grids((NONE, wide)), *simulated.more_turbines((NONE, wide))],
        simulated.faults(wide),
    )


def main() -> None:
    """Reproduce, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder with paper.md and figures/")
    docs = parser.parse_args().docs
    begun = time.perf_counter()
    found = results()
    table = comparison.rows(found.study, found.steps, found.wider, found.faults)
    pictures.draw_all(docs / "figures", *found)
    comparison.rewrite(docs / "paper.md", comparison.markdown(table))
    print(comparison.plain(table))
    print(f"{time.perf_counter() - begun:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
