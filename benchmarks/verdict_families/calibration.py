"""Stated probabilities against what came true, close to the edge: within three standard errors of it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .asking import ask
from .tables import Spec, table_of
from .truth import truth_of
from .units import Unit, draw_unit, edges, grid_of, rightmost

CALIBRATED = ("turbine", "following", "forming", "rational")


class Stated(NamedTuple):
    """A probability of being stable, and whether it was."""

    index: int
    probability: float
    stable: bool
    verdict: str


def stated(seed: int, index: int) -> Stated | None:
    """One case within three standard errors of the edge; None where the device has no such edge."""
    rng = np.random.default_rng([seed, index, 7])
    unit = draw_unit(CALIBRATED[index % len(CALIBRATED)], rng)
    r_over_x = float(np.exp(rng.uniform(np.log(0.01), np.log(0.5))))
    found = edges(unit, r_over_x)
    if not found:
        return None
    edge, spec = float(rng.choice(found)), _spec(unit, rng)
    from pathlib import Path

    response = table_of(unit, spec, rng, Path())
    at_edge = ask(response, grid_of(edge, r_over_x))
    truth = truth_of(unit, grid_of(edge, r_over_x), 0.0, np.sort(np.abs(spec.f_hz - spec.f1_hz)))
    std = float(np.sqrt(at_edge.covariance[0, 0]))
    if not (np.isfinite(std) and abs(at_edge.resonance - truth.critical) < 6.0 * std + 0.3 and truth.critical_covered):
        return None
    slope = (rightmost(unit, edge * 1.0001, r_over_x) - rightmost(unit, edge * 0.9999, r_over_x)) / (2e-4 * edge)
    size = edge + rng.uniform(-3.0, 3.0) * std / slope
    if not 0.8 * edge < size < 1.25 * edge:
        return None
    said = ask(response, grid_of(size, r_over_x))
    return Stated(index, said.probability, rightmost(unit, size, r_over_x) < 0.0, said.verdict)


def _spec(unit: Unit, rng: np.random.Generator) -> Spec:
    """Noisy rows that cover the band."""
    f1_hz, points = unit.bases.f1_hz, int(rng.integers(60, 160))
    near = np.geomspace(0.5, 0.9 * f1_hz, points // 3)
    f = np.unique(np.concatenate([np.geomspace(1.0, 1500.0, points - len(near)), f1_hz + near]))
    blank = Spec(
        "exact", "both", f[np.abs(f - f1_hz) > 0.1], f1_hz, "tone", 1e-3, 0.0, 0.0, "white", "known", False, True, ""
    )
    return replace(
        blank,
        noise=float(10.0 ** rng.uniform(-3.0, -1.5)),
        colour=str(rng.choice(["white", "falling"])),
        covariance=str(rng.choice(["known", "estimated"], p=[0.7, 0.3])),
    )


class Bin(NamedTuple):
    """Cases whose stated probability lies between ``low`` and ``high``."""

    low: float
    high: float
    number: int
    stated: float
    seen: float

    @property
    def held(self) -> bool:
        """Within 3 %, or within two binomial errors."""
        if self.number == 0:
            return True
        error = np.sqrt(max(self.stated * (1.0 - self.stated), 1e-4) / self.number)
        return bool(abs(self.seen - self.stated) <= max(0.03, 2.0 * error))


def bins(found: list[Stated]) -> list[Bin]:
    """Ten bins of equal width."""
    p = np.array([s.probability for s in found])
    stable = np.array([s.stable for s in found], float)
    which = np.clip((10.0 * p).astype(int), 0, 9)
    parts = [(k, which == k) for k in range(10)]
    return [
        Bin(k / 10.0, (k + 1) / 10.0, int(at.sum()), float(p[at].mean()), float(stable[at].mean()))
        for k, at in parts
        if at.any()
    ]


def table(found: list[Bin]) -> str:
    """Markdown."""
    rows = ["| stated probability | cases | stated, mean | stable | |", "|---" * 5 + "|"]
    rows += [
        f"| {b.low:.1f} to {b.high:.1f} | {b.number} | {b.stated:.3f} | {b.seen:.3f} | "
        f"{'held' if b.held else '**not held**'} |"
        for b in found
    ]
    return "\n".join(rows)
