"""Cases: a device, a table of it and some grids, all from (seed, index)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .asking import NOTHING, Said, ask
from .linear import Linear
from .tables import Spec, draw_spec, exact_pn, table_of
from .truth import Truth, truth_of
from .units import FAMILIES, SCR, Unit, draw_unit, edges, grid_of

NEAREST = {"sampled": 0.01}
"""How near the edge may be, where not 0.3 %: a sampled device's Y depends on its grid by some parts in a thousand."""


@dataclass(frozen=True)
class Case:
    """One verdict beside the truth; plain values, so that it can be sent and kept."""

    seed: int
    index: int
    grid_number: int
    family: str
    text: str
    spec: Spec
    n_rows: int
    error: float
    swept_on: tuple[float, float] | None
    own_unstable: int
    r_ohm: float
    x_ohm: float
    scr: float
    truth: Truth
    said: Said

    @property
    def name(self) -> str:
        """What reproduces it."""
        return f"--seed {self.seed} --only {self.index}"

    @property
    def noise(self) -> float:
        """Relative noise of Y: as drawn where rows are exact, as found where they were swept."""
        return self.spec.noise if self.spec.source == "exact" else self.error

    @property
    def wrong(self) -> bool:
        right = "stable" if self.truth.stable else "unstable"
        return self.said.verdict not in (right, "undecided", "crash")

    @property
    def certain(self) -> bool:
        """Whether the probability is stated as certain."""
        p = self.said.probability
        return bool(self.said.verdict in ("stable", "unstable") and (p > 0.999 or p < 0.001))


def cases_of(
    seed: int,
    index: int,
    share_swept: float,
    grids: int,
    cache: Path,
    is_wanted: Callable[[Case], bool] | None = None,
) -> list[Case]:
    """Every case of one table, or those that are wanted; no question is asked of the others."""
    rng = np.random.default_rng([seed, index])
    family = FAMILIES[index % len(FAMILIES)]
    unit, r_over_x, found = _unit_with_edges(family, rng)
    spec = draw_spec(unit, rng, _source(unit, share_swept, rng))
    response = table_of(unit, spec, rng, cache / f"{seed}-{index}.parquet")
    usable = response.usable
    exact = exact_pn(unit, response.f_hz)
    off = np.linalg.norm(response.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    nu_hz = np.unique(np.abs(response.f_hz[usable] - unit.bases.f1_hz))
    nu_hz = nu_hz if len(nu_hz) else np.array([np.inf])
    error = float(np.median(off[usable])) if usable.any() else float("nan")
    noise = spec.noise if spec.source == "exact" else error
    cases, wanted = [], is_wanted or (lambda _: True)
    for number, (size, distance) in enumerate(_sizes(unit, found, grids, rng)):
        grid = grid_of(size, r_over_x)
        truth = truth_of(unit, grid, distance, nu_hz, noise)
        cases.append(
            Case(
                seed=seed,
                index=index,
                grid_number=number,
                family=family,
                text=unit.text,
                spec=spec,
                n_rows=int(usable.sum()),
                error=error,
                swept_on=unit.swept_on,
                own_unstable=unit.own_unstable,
                r_ohm=grid[0],
                x_ohm=grid[1],
                scr=unit.bases.z_ohm / size,
                truth=truth,
                said=NOTHING,
            )
        )
    return [replace(case, said=ask(response, (case.r_ohm, case.x_ohm))) for case in cases if wanted(case)]


def _source(unit: Unit, share_swept: float, rng: np.random.Generator) -> str:
    """One measured table in thirty is a recording; the turbine and sampled devices are swept instead."""
    if rng.random() >= share_swept:
        return "exact"
    recorded = isinstance(unit.device, Linear) and unit.family != "turbine" and rng.random() < 1.0 / 18.0
    return "recorded" if recorded else "swept"


def _unit_with_edges(family: str, rng: np.random.Generator) -> tuple[Unit, float, list[float]]:
    """A device and the ratio R/X of its grids; four in five have an edge."""
    wanted = rng.random() < 0.8
    for _ in range(60):
        unit = draw_unit(family, rng)
        r_over_x = 0.0 if rng.random() < 0.15 else float(np.exp(rng.uniform(np.log(0.01), np.log(3.0))))
        found = edges(unit, r_over_x)
        if found or not wanted:
            return unit, r_over_x, found
    return unit, r_over_x, found


def _sizes(unit: Unit, found: list[float], grids: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """(size of the grid in ohm, relative distance of the nearest edge)."""
    nearest = NEAREST.get(unit.family, 0.003)
    sizes = []
    while len(sizes) < grids:
        if found and rng.random() < 0.8:
            away = float(np.exp(rng.uniform(np.log(nearest), np.log(0.3))))
            size = float(rng.choice(found)) * (1.0 + away * float(rng.choice([-1.0, 1.0])))
        else:
            size = unit.bases.z_ohm / float(np.exp(rng.uniform(np.log(SCR[1]), np.log(SCR[0]))))
        distance = min((abs(size / edge - 1.0) for edge in found), default=float("inf"))
        if distance >= nearest * 0.999:
            sizes.append((size, distance))
    return sizes
