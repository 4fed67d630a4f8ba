"""Devices that are not the turbine on random grids near the edge: inverters, random rational devices, imports.

The truth is a tableau of device and network (`tests.support.networks`), the device's matrices are those of the
benchmark of verdicts, which shares nothing with the product. `test_..._evidence` is the trial in full, with a new seed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))

from verdict_families.tables import Spec, exact_pn, table_of
from verdict_families.units import Unit, draw_unit

from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.scalar_fit import fit_impedance
from seqsweep.tuning.siso import Grid
from seqsweep.tuning.tune import Device, fitted
from seqsweep.tuning.verdict import judge
from tests.support import oracle
from tests.support.networks import KINDS, NearCritical, impedance_of, near_critical_once

FAMILIES = ("following", "forming", "rational", "turbine")
SOURCES = ("exact", "import", "swept")
"""How the device is known: by formula; by formula in single precision and without covariance; by the runner."""

TRIES = 6


class Case(NamedTuple):
    """A device as it is known, the truth on one grid, and f1."""

    source: str
    unit: Unit
    device: Device
    grid: NearCritical


def frequencies(unit: Unit) -> np.ndarray:
    """A hundred rows, logarithmic in |f - f1|, beyond the device's own modes."""
    highest = float(np.abs(unit.device.own_poles.imag).max()) / (2.0 * np.pi)
    end = max(1950.0, 1.5 * highest) if unit.family == "rational" else 1950.0
    return unit.bases.f1_hz + np.geomspace(0.4, end, 100)


def known(unit: Unit, source: str, rng: np.random.Generator, cache: Path) -> Device:
    """The device's table, fitted."""
    f_hz, f1_hz = frequencies(unit), unit.bases.f1_hz
    if source == "swept":
        swept = Spec("swept", "listed", f_hz, f1_hz, "tone", 5e-4, 0.1, 0.0, "white", "known", False, True, "")
        return fitted(table_of(unit, swept, rng, cache))
    y = exact_pn(unit, f_hz)
    if source == "import":
        y = y.astype(np.complex64).astype(complex)
    on = "ideal" if unit.swept_on is None else dict(zip(("r_ohm", "x_ohm"), unit.swept_on, strict=True))
    return fitted(FrequencyResponse(f_hz, y, f1_hz, meta={"op_id": "a", "stable_on": {"grid": on, "basis": "stated"}}))


def matrices(unit: Unit) -> SimpleNamespace:
    """The device as `tests.support.networks` takes it."""
    d = unit.device
    return SimpleNamespace(A=d.a, B=d.b, C=d.c, D=d.d, E=d.e)


def cases(seed: int, n: int, folder: Path, sources: tuple[str, ...] = SOURCES) -> Iterator[Case]:
    """``n`` near-critical grids, about five of each device."""
    rng, done, number = np.random.default_rng(seed), 0, 0
    while done < n:
        family, source = FAMILIES[number % len(FAMILIES)], sources[number // len(FAMILIES) % len(sources)]
        unit = draw_unit(family, rng)
        grids = [grid for kind in KINDS if (grid := drawn(rng, unit, kind)) is not None][: n - done]
        device = known(unit, source, rng, folder / f"{number}.parquet") if grids else None
        number += 1
        for grid in grids:
            assert device is not None
            yield Case(source, unit, device, grid)
        done += len(grids)


def drawn(rng: np.random.Generator, unit: Unit, kind: str) -> NearCritical | None:
    """A grid of the kind near the edge; None where the device finds none in some tries."""
    size = unit.bases.z_ohm / 0.25 * float(np.exp(rng.uniform(np.log(0.2), np.log(1.2))))
    for _ in range(TRIES):
        found = near_critical_once(rng, matrices(unit), kind, size, unit.bases.f1_hz)
        if found is not None:
            return found
    return None


def tabulated(case: Case, rows: int, noise: float, rng: np.random.Generator) -> Grid:
    """The grid exactly (rows = 0) or as a table of Z(f)."""
    document, scale, f1_hz = case.grid.document, case.grid.scale, case.unit.bases.f1_hz
    if rows == 0:
        return elements_grid(document, f1_hz).scaled(scale)
    f = np.geomspace(1.0, 2500.0, rows)
    z = impedance_of(document, 2j * np.pi * f, scale, f1_hz)
    if noise == 0.0:
        return fit_impedance(f, z, f1_hz)
    z = z * (1.0 + noise / np.sqrt(2.0) * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows)))
    return fit_impedance(f, z, f1_hz, std=noise * np.abs(z))


class Found(NamedTuple):
    """What came of one case."""

    source: str
    undecided: bool
    wrong: bool
    certain: bool
    miscounted: bool
    error: float


def outcome(case: Case, grid: Grid) -> Found:
    """The verdict against the truth."""
    assert case.device.model is not None, case.device.problem
    stability = judge(case.device.model, grid, case.device.rows, case.device.anchor)
    true = "stable" if case.grid.stable else "unstable"
    n_unstable = int(np.sum(case.grid.poles.real > 0.0))
    by_locus = stability.n_open_loop_unstable - stability.winding.number
    sure = stability.probability if case.grid.stable else 1.0 - stability.probability
    return Found(
        case.source,
        stability.verdict == "undecided",
        stability.verdict not in ("undecided", true),
        bool(1.0 - sure > 0.999),
        by_locus != n_unstable or stability.closed_loop.n_unstable != n_unstable,
        float(np.abs(stability.closed_loop.poles - case.grid.critical).min()),
    )


def test_a_few_other_devices_on_elements_and_on_tables_are_judged_right(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for case in cases(11, 10, tmp_path, ("exact", "import")):
        for rows in (0, 100):
            found = outcome(case, tabulated(case, rows, 0.0, rng))
            assert not found.wrong, (case.unit.text, case.grid)
            assert case.source != "exact" or not found.miscounted, (case.unit.text, case.grid)


def test_an_integrator_of_the_device_s_own_is_counted_on_the_grid_that_it_was_swept_on() -> None:
    """Voltage loops alone, swept behind a line: a pole at s = 0, of which rows from 0.4 Hz on do not tell the side."""
    rng = np.random.default_rng(6)
    unit = draw_unit("following", rng)
    assert np.abs(unit.device.own_poles).min() < 1e-6
    grid = drawn(rng, unit, "shunt_capacitor")
    assert grid is not None
    device = known(unit, "exact", rng, Path())
    found = outcome(
        Case("exact", unit, device, grid), elements_grid(grid.document, unit.bases.f1_hz).scaled(grid.scale)
    )
    assert device.anchor is not None
    assert device.model is not None
    assert device.anchor.n_unstable == device.model.n_unstable
    assert (found.undecided, found.wrong, found.miscounted) == (False, False, False)


@pytest.mark.parametrize("seed", [5, 50])
def test_a_slow_mode_nearer_to_f1_than_every_row_is_decided_where_the_rows_hold_it(seed: int) -> None:
    """A cable that resonates near f1: -0.12 and +0.25 rad/s, the lowest row 2.5 rad/s away. Noise takes the hold."""
    rng = np.random.default_rng(seed)
    linear = oracle.linearise(0.65e6, 690.0)
    case = near_critical_once(rng, linear, "cable")
    assert case is not None
    assert case.critical.imag == 0.0
    assert abs(case.critical.real) < 0.3
    grid = elements_grid(case.document, 50.0).scaled(case.scale)
    f_hz = 50.0 + np.geomspace(0.4, 1950.0, 100)
    y = oracle.admittance_pn(f_hz, 0.65e6, 690.0)
    true = "stable" if case.stable else "unstable"
    for noise in (0.0, 1e-2):
        size = noise * np.linalg.norm(y, axis=(1, 2))[:, None, None] / np.sqrt(8.0)
        noisy = y + size * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
        meta = {"op_id": "a", "stable_on": {"grid": "ideal", "basis": "stated"}}
        device = fitted(FrequencyResponse(f_hz, noisy, 50.0, meta=meta))
        assert device.model is not None
        verdict = judge(device.model, grid, device.rows, device.anchor).verdict
        assert verdict == (true if noise == 0.0 else "undecided")


@pytest.mark.evidence
@pytest.mark.parametrize(("rows", "noise"), [(0, 0.0), (100, 0.0), (60, 0.0), (60, 1e-3), (60, 1e-2)])
def test_other_devices_near_the_edge_evidence(rows: int, noise: float, tmp_path: Path) -> None:
    """200 grids, or as many as SEQSWEEP_TRIALS says; rows = 0: as elements."""
    seed = int(np.random.SeedSequence().entropy % 2**31)
    rng, n = np.random.default_rng(seed), int(os.environ.get("SEQSWEEP_TRIALS", "200"))
    found = [outcome(case, tabulated(case, rows, noise, rng)) for case in cases(seed, n, tmp_path)]
    print(f"seed {seed}, {n} grids, rows {rows}, noise {noise:g}")
    for source in SOURCES:
        of = [each for each in found if each.source == source]
        if of:
            middle, high, worst = np.quantile([each.error for each in of], [0.5, 0.95, 1.0])
            print(
                f"  device {source}: {sum(e.wrong for e in of)} of {len(of)} wrong, {sum(e.undecided for e in of)} "
                f"undecided, {sum(e.miscounted for e in of)} miscounted, pole error {middle:.1e} / {high:.1e} / "
                f"{worst:.1e} rad/s (median, 95 %, largest)"
            )
    assert not any(each.wrong and each.certain for each in found)
    assert sum(each.wrong for each in found) <= 0.01 * n
