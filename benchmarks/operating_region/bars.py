"""What is asked of the surrogate, bar by bar; every bar gives rows of a table."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from seqsweep.identify.surrogate.design import WIDTH
from tests.support.regions import DROOP_INVERTER, PQV, PQV_DROOP, PV, TURBINE, Device
from tests.support.switching import KINDS, Placed, placed

from . import campaigns, searches, timing, verdicts
from .designs import Certified, Truth, certified, grown, noisy, swept_by
from .kept import Kept
from .rival import BUILDS

TOLERANCES = (8e-3, 1e-3, 1e-4)
MOST = 30
"""Sweeps at which a design that is not certified is given up."""

ROW_NOISE = 3e-6
"""Relative error of a row that `run` sweeps with its default settings."""

UNSEEN = 1000
"""Operating points at which the largest true error of a design is looked for; coverage takes a fifth of them."""

POWERS = (24, 33)
"""Active and reactive powers of the brute force."""


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


def certificates(pool: Kept, seed: int, designs: int, rivals: int) -> list[Row]:
    """Sweeps until a design is certified, and its largest true error then."""
    rows: list[Row] = []
    for name, case in CASES.items():
        n_tolerances = sum(limit is not None for limit in case.asked)
        n = designs if case.device is TURBINE else max(designs // 10, 1)
        for noise in (0.0, ROW_NOISE):
            one = partial(_certified, name, n_tolerances, noise)
            ours = list(pool.map(partial(one, "ours"), range(seed, seed + n)))
            theirs = list(pool.map(partial(one, "rival"), range(seed, seed + min(n, rivals))))
            rows += [_certificate(case, k, f"rows' noise {noise:g}", ours, theirs, seed) for k in range(n_tolerances)]
    return rows


def _certified(name: str, n_tolerances: int, noise: float, build: str, seed: int) -> list[Certified]:
    case = CASES[name]
    design = grown(case.region, seed, noisy(case.device, noise, seed), BUILDS[build])
    return certified(design, TOLERANCES[:n_tolerances], truth_of(name, UNSEEN), MOST)


def _certificate(
    case: Case, k: int, rows: str, ours: Sequence[list[Certified]], theirs: Sequence[list[Certified]], seed: int
) -> Row:
    limit, tolerance = case.asked[k], TOLERANCES[k]
    assert limit is not None
    sweeps = np.array([found[k].sweeps for found in ours])
    off = np.array([found[k].off for found in ours])
    missed = ~((sweeps <= limit) & (off <= tolerance))
    what = f"{case.axes}: certified to {100 * tolerance:g} %, {rows}"
    for at in np.flatnonzero(missed):
        print(f"  {what}, seed {seed + at}: {sweeps[at]:g} sweeps, error {100 * off[at]:.2g} %", file=sys.stderr)
    told, rival = _sweeps(sweeps, off), _sweeps(*np.array([found[k] for found in theirs]).reshape(-1, 2).T)
    wanted = f"<= {limit} sweeps, error <= {100 * tolerance:g} %"
    return Row(what, f"{len(ours)} designs", told, rival, wanted, not missed.any())


def _sweeps(sweeps: np.ndarray, off: np.ndarray) -> str:
    """Median and most sweeps, the largest true error; and how many designs were given up."""
    done = np.isfinite(sweeps)
    if len(sweeps) == 0:
        return ""
    if not done.any():
        return f"not within {MOST} sweeps"
    given_up = f", {np.sum(~done)} not within {MOST}" if not done.all() else ""
    middle, most = np.median(sweeps[done]), sweeps[done].max()
    return f"{middle:.0f} sweeps, at most {most:.0f}{given_up}; error at most {100 * off[done].max():.2g} %"


COVERED = (0.93, 0.99)
"""Share of points and frequencies at which a 95 % region is to hold."""

LEAST_COVERED = 0.85
"""Of any design."""

NOISES = (0.0, 1e-4, 1e-3, 1e-2)


class Covered(NamedTuple):
    """How often the regions of one design held."""

    held: float
    seed: int
    sweeps: int
    axes: str
    by_doubt: bool

    def words(self) -> str:
        """In one line."""
        how = "grown by doubt" if self.by_doubt else "listed at random"
        return f"{100 * self.held:.1f} % of {self.axes}, {self.sweeps} sweeps {how}, seed {self.seed}"


def coverage(pool: Kept, seed: int, designs: int, rivals: int) -> list[Row]:
    """How often the 95 % regions hold, over designs along two and three axes, grown by doubt and listed at random."""
    rows = []
    for noise in NOISES:
        ours = list(pool.map(partial(_covered, noise, "ours"), range(seed, seed + designs)))
        theirs = list(pool.map(partial(_covered, noise, "rival"), range(seed, seed + min(designs, rivals))))
        for one in sorted(ours)[:20]:
            print(f"  noise {noise:g}: {one.words()}", file=sys.stderr)
        held = np.array([one.held for one in ours])
        met = bool(COVERED[0] <= held.mean() <= COVERED[1] and held.min() >= LEAST_COVERED)
        asked = f"{100 * COVERED[0]:g} to {100 * COVERED[1]:g} %, none below {100 * LEAST_COVERED:g} %"
        told, rival = _shares(held), _shares(np.array([one.held for one in theirs]))
        rows.append(Row(f"95 % regions that hold, noise {noise:g}", f"{designs} designs", told, rival, asked, met))
    return rows


def _covered(noise: float, build: str, seed: int) -> Covered:
    """The regions of one design of 8 to 16 sweeps."""
    name = ("P, V", "P, Q, V")[seed % 2]
    case, random = CASES[name], np.random.default_rng(seed)
    sweeps, by_doubt = int(random.integers(8, 17)), bool(seed // 2 % 2)
    sweep = noisy(case.device, noise, seed, stated=noise)
    if by_doubt:
        surrogate = next(
            s.surrogate for s in grown(case.region, seed, sweep, BUILDS[build]) if len(s.responses) == sweeps
        )
    else:
        surrogate = BUILDS[build](swept_by(sweep, case.region, sweeps, seed), case.region)
    return Covered(float(truth_of(name, UNSEEN // 5).held(surrogate).mean()), seed, sweeps, case.axes, by_doubt)


def _shares(held: np.ndarray) -> str:
    if len(held) == 0:
        return ""
    low = int(np.sum(held < LEAST_COVERED))
    return f"{100 * held.mean():.1f} %, least {100 * held.min():.1f} %, {low} below {100 * LEAST_COVERED:g} %"


def judged(pool: Kept, seed: int, pairs: int, rivals: int) -> list[Row]:
    """Verdicts on grids near the edge of stability, at operating points that were not swept."""
    n = max(pairs // verdicts.PAIRS, 1)
    rows = []
    for noise in (ROW_NOISE, 1e-3):
        one = partial(verdicts.judged, noise)
        ours = [said for of in pool.map(partial(one, "ours"), range(seed, seed + n)) for said in of]
        theirs = [said for of in pool.map(partial(one, "rival"), range(seed, seed + min(n, rivals))) for said in of]
        met = not any(said.wrong and said.certain for said in ours)
        what = f"verdicts at unseen points, rows' noise {noise:g}"
        rows.append(Row(what, f"{len(ours)} pairs", _verdicts(ours), _verdicts(theirs), "0 certain and wrong", met))
    return rows


def _verdicts(said: Sequence[verdicts.Judged]) -> str:
    if not said:
        return ""
    wrong = sum(one.wrong for one in said)
    certain = sum(one.wrong and one.certain for one in said)
    undecided = sum(one.undecided for one in said)
    return f"{certain} certain and wrong, {wrong} wrong, {undecided} undecided of {len(said)}"


def modes(pool: Kept, seed: int, grids: int, rivals: int) -> list[Row]:
    """Distance of the critical mode from the exact one, on grids that were not seen, from 20 sweeps."""
    n = max(grids // verdicts.PAIRS, 1)
    one = partial(verdicts.modes, ROW_NOISE)
    ours = np.ravel(list(pool.map(partial(one, "ours"), range(seed, seed + n))))
    theirs = np.ravel(list(pool.map(partial(one, "rival"), range(seed, seed + min(n, rivals)))))
    what = f"critical mode from {verdicts.SWEEPS} sweeps, rows' noise {ROW_NOISE:g}"
    limit = verdicts.NEAR_RAD_S
    told, rival = _distances(ours), _distances(theirs)
    return [Row(what, f"{len(ours)} grids", told, rival, f"<= {limit:g} rad/s", bool(ours.max() <= limit))]


def _distances(off: np.ndarray) -> str:
    return f"median {np.median(off):.2g}, at most {off.max():.2g} rad/s" if len(off) else ""


def worst(pool: Kept, seed: int, designs: int, rivals: int) -> list[Row]:
    """The worst m over 27 grids and the turbine's P, Q and V, against brute force with the exact admittance."""
    if designs == 0:
        return []
    truth = min(pool.map(partial(searches.brute_force_on, POWERS), range(27)))
    ours = list(pool.map(partial(searches.searched, "ours"), range(seed, seed + designs)))
    theirs = list(pool.map(partial(searches.searched, "rival"), range(seed, seed + min(designs, rivals))))
    met = all(one.sweeps <= searches.MOST and abs(one.m / truth - 1.0) <= searches.NEAR for one in ours)
    what = f"worst m of 27 grids over P, Q and V; brute force {truth:.4f}"
    asked = f"<= {searches.MOST} sweeps, within {100 * searches.NEAR:g} %"
    told, rival = _searches(ours, truth), _searches(theirs, truth)
    return [Row(what, f"{designs} designs", told, rival, asked, met)]


def _searches(found: Sequence[searches.Searched], truth: float) -> str:
    if not found:
        return ""
    sweeps = [one.sweeps for one in found]
    off = max(abs(one.m / truth - 1.0) for one in found)
    return f"{min(sweeps)} to {max(sweeps)} sweeps; {100 * off:.2g} % off at most"


def jumps(pool: Kept, seed: int, placements: int, rivals: int) -> list[Row]:
    """Limits and changes of mode at random places are found and located, smooth devices are left whole."""
    if placements == 0:
        return []
    rows = []
    for kind, most in KINDS.items():
        found = list(pool.map(partial(_placed, kind, most), range(seed, seed + placements)))
        for at, one in zip(range(seed, seed + placements), found, strict=True):
            if one.wrong:
                print(f"  {kind}, seed {at}: {one.wrong}", file=sys.stderr)
        right, sweeps = sum(not one.wrong for one in found), [one.sweeps for one in found]
        told = f"{right} right, {min(sweeps)} to {max(sweeps)} sweeps"
        asked = "no jump found" if kind == "smooth" else f"all found, to {100 * WIDTH:g} % of the range"
        rows.append(Row(JUMPS[kind], f"{placements} placements", told, "", asked, right == placements))
    return rows


JUMPS = {"limit": "current limits", "mode": "changes of mode", "smooth": "smooth devices"}


def _placed(kind: str, most: int, seed: int) -> Placed:
    return placed(kind, (PV, PQV)[seed % 2], seed, most)


def swept(pool: Kept, seed: int, runs: int, rivals: int) -> list[Row]:
    """Certificates of campaigns whose rows `run` sweeps, and their largest true error."""
    if runs == 0:
        return []
    rows = []
    for name, case in CASES.items():
        n_tolerances = sum(limit is not None for limit in case.asked)
        found = list(pool.map(partial(_swept, name, n_tolerances), range(seed, seed + runs)))
        rows += [_certificate(case, k, "swept by run", found, [], seed) for k in range(n_tolerances)]
    return rows


def _swept(name: str, n_tolerances: int, seed: int) -> list[Certified]:
    case = CASES[name]
    return campaigns.swept(name, case.device, case.region, TOLERANCES[:n_tolerances], seed)


def speed(pool: Kept, seed: int, campaigns: int, rivals: int) -> list[Row]:
    """How long it takes, in CPU seconds of one core where it is said, else by the clock."""
    build, evaluate = timing.speed("ours")
    theirs = timing.speed("rival")
    rows = [
        _time("built from 20 sweeps of 100 frequencies", build, theirs[0], timing.BUILD_S, "CPU"),
        _time("evaluated 1e5 times (P, Q, V, f)", evaluate, theirs[1], timing.EVALUATE_S, "CPU"),
    ]
    for _ in range(campaigns):
        wall, used, swept = timing.campaign()
        what = f"certified campaign, examples/region.toml, {swept} operating points"
        row = _time(what, wall, None, timing.CAMPAIGN_S, "")
        rows.append(row._replace(ours=f"{row.ours} by the clock, {used:.1f} s of CPU"))
    return rows


def _time(what: str, ours: float, rival: float | None, limit: float, clock: str) -> Row:
    unit = f"s of {clock}" if clock else "s"
    told = "" if rival is None else f"{rival:.2g} {unit}"
    return Row(what, "1", f"{ours:.2g} {unit}", told, f"<= {limit:g} {unit}", ours <= limit)
