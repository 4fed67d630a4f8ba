"""What is asked of the surrogate, bar by bar; every bar gives rows of a table."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from tests.support.regions import DROOP_INVERTER, PQV, PQV_DROOP, PV, TURBINE, Device

from .designs import Certified, Truth, build_ours, certified, grown, noisy
from .rival import build_rival

TOLERANCES = (8e-3, 1e-3, 1e-4)
MOST = 30
"""Sweeps at which a design that is not certified is given up."""

ROW_NOISE = 3e-6
"""Relative error of a row that `run` sweeps with its default settings."""

UNSEEN = 1000

BUILDS = {"ours": build_ours, "rival": build_rival}


class Row(NamedTuple):
    """One figure: what it is of, over how many cases, ours, the rival's, what is asked, and whether ours meets it."""

    what: str
    cases: str
    ours: str
    rival: str
    asked: str
    met: bool | None

    def line(self) -> str:
        """As a row of a Markdown table."""
        told = {True: "met", False: "**missed**", None: ""}[self.met]
        return f"| {self.what} | {self.cases} | {self.ours} | {self.rival} | {self.asked} | {told} |"


HEAD = "| bar | cases | ours | Gaussian process | asked | |\n|---|---|---|---|---|---|"


class Case(NamedTuple):
    """A device, its region and the sweeps that it may take for each of `TOLERANCES`."""

    device: Device
    region: Any
    axes: str
    asked: tuple[int | None, ...]


CASES = {
    "P, V": Case(TURBINE, PV, "turbine, P and V", (10, 13, 16)),
    "P, Q, V": Case(TURBINE, PQV, "turbine, P, Q and V", (13, 16, 20)),
    "droop": Case(DROOP_INVERTER, PQV_DROOP, "droop inverter, P, Q and V", (25, None, None)),
}


@cache
def truth_of(name: str, n: int) -> Truth:
    """Unseen points of a case; the same for every design of a run."""
    case = CASES[name]
    return Truth(case.device, case.region, n, seed=20250)


def certificates(pool: Executor, seed: int, designs: int, rivals: int) -> list[Row]:
    """Sweeps until a design is certified, and its largest true error then."""
    rows: list[Row] = []
    for name, case in CASES.items():
        n_tolerances = sum(limit is not None for limit in case.asked)
        n = designs if case.device is TURBINE else max(designs // 10, 1)
        for noise in (0.0, ROW_NOISE):
            one = partial(_certified, name, n_tolerances, noise)
            ours = list(pool.map(partial(one, "ours"), range(seed, seed + n)))
            theirs = list(pool.map(partial(one, "rival"), range(seed, seed + min(n, rivals))))
            rows += [_certificate(case, k, noise, ours, theirs) for k in range(n_tolerances)]
    return rows


def _certified(name: str, n_tolerances: int, noise: float, build: str, seed: int) -> list[Certified]:
    case = CASES[name]
    design = grown(case.region, seed, noisy(case.device, noise, seed), BUILDS[build])
    return certified(design, TOLERANCES[:n_tolerances], truth_of(name, UNSEEN), MOST)


def _certificate(
    case: Case, k: int, noise: float, ours: Sequence[list[Certified]], theirs: Sequence[list[Certified]]
) -> Row:
    limit, tolerance = case.asked[k], TOLERANCES[k]
    assert limit is not None
    sweeps = np.array([found[k].sweeps for found in ours])
    off = np.array([found[k].off for found in ours])
    met = bool(np.all(sweeps <= limit) and np.all(off <= tolerance))
    what = f"{case.axes}: certified to {100 * tolerance:g} %, rows' noise {noise:g}"
    told, rival = _sweeps(sweeps, off), _sweeps(*np.array([found[k] for found in theirs]).T)
    return Row(what, f"{len(ours)} designs", told, rival, f"<= {limit} sweeps, error <= {100 * tolerance:g} %", met)


def _sweeps(sweeps: np.ndarray, off: np.ndarray) -> str:
    """Median and most sweeps, the largest true error; and how many designs were given up."""
    done = np.isfinite(sweeps)
    if not done.any():
        return f"not within {MOST} sweeps"
    given_up = f", {np.sum(~done)} not within {MOST}" if not done.all() else ""
    middle, most = np.median(sweeps[done]), sweeps[done].max()
    return f"{middle:.0f} sweeps, at most {most:.0f}{given_up}; error at most {100 * off[done].max():.2g} %"
