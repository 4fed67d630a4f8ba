"""Random grids near the edge of stability, a swept device: verdict, count of unstable poles and pole against the truth.

The truth is a tableau of device and network (`tests.support.networks`). `test_..._evidence` is the trial in full, with
a new seed; it prints its figures.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import newton

from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.tuning.bank.edges import scale_at_the_edge
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.scalar_fit import fit_impedance
from seqsweep.tuning.siso import Grid
from seqsweep.tuning.tune import Device, fitted
from seqsweep.tuning.verdict import Stability, judge
from tests.support import oracle
from tests.support.networks import F1_HZ, KINDS, NearCritical, impedance_of, near_critical
from tests.support.sweeps import planned, rows_of, y_of

P_W, U_V = 0.65e6, 690.0
NU_HZ = np.geomspace(0.4, 1950.0, 100)
"""Rows of the device. Aperiodic modes of a cable, nearer to f1 than all of them, decide some cases."""

WITHIN = 2e-4
"""How far the critical pole may be from the truth (rad/s)."""


@pytest.fixture(scope="module")
def linear() -> oracle.Linear:
    return oracle.linearise(P_W, U_V)


@pytest.fixture(scope="module")
def device() -> Device:
    """The reference turbine really swept, 100 rows, logarithmic in |f - f1|."""
    f_hz = sorted({round(F1_HZ + float(nu), 2) for nu in NU_HZ})
    plant = ReferenceTurbine()
    rows = rows_of(plant, planned(plant, f_hz=f_hz, injection={"amplitude_pu": 0.0005}))
    f = np.array([row.f_hz for row in rows])
    meta = {"op_id": "p065", "stable_on": {"grid": "ideal", "basis": "shots"}}
    return fitted(FrequencyResponse(f, y_of(rows), F1_HZ, meta=meta))


def cases(linear: oracle.Linear, seed: int, n: int) -> Iterator[NearCritical]:
    rng = np.random.default_rng(seed)
    for k in range(n):
        yield near_critical(rng, linear, KINDS[k % len(KINDS)])


def tabulated(case: NearCritical, rows: int, noise: float, rng: np.random.Generator) -> Grid:
    """The case's grid as a table of Z(f), 1 to 2500 Hz."""
    f = np.geomspace(1.0, 2500.0, rows)
    z = impedance_of(case.document, 2j * np.pi * f, case.scale)
    if noise == 0.0:
        return fit_impedance(f, z, F1_HZ)
    size = noise * np.abs(z) / np.sqrt(2.0)
    z = z + size * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    return fit_impedance(f, z, F1_HZ, std=noise * np.abs(z))


def judged(device: Device, grid: Grid) -> Stability:
    assert device.model is not None
    return judge(device.model, grid, device.rows, device.anchor)


def test_elements_are_judged_and_counted_right_and_their_pole_is_the_truth(
    device: Device, linear: oracle.Linear
) -> None:
    for case in cases(linear, 4, 10):
        stability = judged(device, elements_grid(case.document, F1_HZ).scaled(case.scale))
        n_unstable = int(np.sum(case.poles.real > 0.0))
        assert stability.verdict in ("undecided", "stable" if case.stable else "unstable"), case
        assert stability.closed_loop.n_unstable == n_unstable
        assert stability.n_open_loop_unstable - stability.winding.number == n_unstable
        assert np.abs(stability.closed_loop.poles - case.critical).min() < WITHIN


@pytest.mark.parametrize(("rows", "noise"), [(25, 0.0), (60, 1e-3)])
def test_no_table_of_z_is_judged_wrong(rows: int, noise: float, device: Device, linear: oracle.Linear) -> None:
    rng = np.random.default_rng(9)
    for case in cases(linear, 5, 10):
        stability = judged(device, tabulated(case, rows, noise, rng))
        sure = stability.probability if not case.stable else 1.0 - stability.probability
        wrong = stability.verdict == ("unstable" if case.stable else "stable")
        assert not (wrong and sure > 0.999), (case, stability.reason)
        if noise == 0.0:
            assert not wrong
            assert np.abs(stability.closed_loop.poles - case.critical).min() < WITHIN


def test_a_lossless_inductance_and_a_lossless_series_capacitor_need_no_hint(
    device: Device, linear: oracle.Linear
) -> None:
    """Poles and zeros of Z on the axis: counts of locus, poles and truth agree."""
    from tests.support.networks import poles_of, tableau_of

    for x_c in (0.02, 0.1, 0.18):
        document = {
            "element": [
                {"kind": "series", "r_ohm": 0.0, "x_ohm": 0.3},
                {"kind": "series_capacitor", "x_ohm": x_c},
            ]
        }
        truth = poles_of(linear, tableau_of(document))
        stability = judged(device, elements_grid(document, F1_HZ))
        n_unstable = int(np.sum(truth.real > 0.0))
        assert stability.closed_loop.n_unstable == n_unstable
        assert stability.n_open_loop_unstable - stability.winding.number == n_unstable


def cable_document(rng: np.random.Generator, length_km: float) -> dict:
    """A distributed cable of 35 kV, seen at 690 V, between a transformer and a source."""
    at = (0.69 / 35.0) ** 2
    per_km = {"r_ohm_per_km": 0.05 * at, "l_mh_per_km": 0.35 * at, "c_nf_per_km": 250.0 / at}
    x = rng.uniform(0.03, 0.1, 2).tolist()
    ends = [{"kind": "series", "r_ohm": 0.05 * value, "x_ohm": value} for value in x]
    return {"element": [ends[0], {"kind": "cable", "length_km": length_km, **per_km}, ends[1]]}


def z_of_cable(document: dict, s: complex) -> complex:
    """z(s) in the phase frame by the line equations."""
    first, cable, last = document["element"]
    l_h = cable["l_mh_per_km"] * 1e-3
    series, shunt = cable["r_ohm_per_km"] + s * l_h, s * cable["c_nf_per_km"] * 1e-9
    zc, x = np.sqrt(series / shunt), cable["length_km"] * np.sqrt(series * shunt)
    behind = last["r_ohm"] + s * last["x_ohm"] / (2.0 * np.pi * F1_HZ)
    through = zc * (behind + zc * np.tanh(x)) / (zc + behind * np.tanh(x))
    return first["r_ohm"] + s * first["x_ohm"] / (2.0 * np.pi * F1_HZ) + through


def mode_of_cable(linear: oracle.Linear, document: dict, scale: float, near: complex) -> complex:
    """The zero of det(1 + Y Z) at ``near`` by secants, all in closed form."""
    w1 = 2.0 * np.pi * F1_HZ

    def value(s: complex) -> complex:
        y = linear.C @ np.linalg.solve(s * np.eye(len(linear.A)) - linear.A, linear.B.astype(complex)) + linear.D
        z1, z2 = (scale * z_of_cable(document, s + shift) for shift in (1j * w1, -1j * w1))
        z = np.array([[z1 + z2, 1j * (z1 - z2)], [-1j * (z1 - z2), z1 + z2]]) / 2.0
        return complex(np.linalg.det(np.eye(2) + y @ z))

    return complex(newton(value, near, tol=1e-10, maxiter=60))


def cable_errors(device: Device, linear: oracle.Linear, rng: np.random.Generator, n: int) -> Iterator[float]:
    """Errors (rad/s) of the deciding mode on random cables of 20 to 300 km, scaled to where it is near the edge."""
    for _ in range(n):
        document = cable_document(rng, float(np.exp(rng.uniform(np.log(20.0), np.log(300.0)))))
        grid = elements_grid(document, F1_HZ)
        assert device.model is not None
        scale = 0.98 * (scale_at_the_edge(device.model, grid, 0) or 1.0)
        loop = judged(device, grid.scaled(scale)).closed_loop
        inside = np.flatnonzero((loop.poles.imag > 30.0) & (loop.poles.imag < 2.0 * np.pi * 900.0))
        found = complex(loop.poles[inside[np.argmax(loop.poles.real[inside])]])
        yield abs(found - mode_of_cable(linear, document, scale, found))


def test_a_distributed_cable_has_its_mode_where_the_line_equations_put_it(
    device: Device, linear: oracle.Linear
) -> None:
    assert max(cable_errors(device, linear, np.random.default_rng(2), 4)) < 5e-5


@pytest.mark.evidence
def test_distributed_cables_evidence(device: Device, linear: oracle.Linear) -> None:
    """100 cables of 20 to 300 km, or as many as SEQSWEEP_TRIALS says, with the device really swept."""
    seed = int(np.random.SeedSequence().entropy % 2**31)
    n = int(os.environ.get("SEQSWEEP_TRIALS", "100"))
    errors = list(cable_errors(device, linear, np.random.default_rng(seed), n))
    print(f"seed {seed}, {n} cables: error of the mode {np.median(errors):.1e} / {max(errors):.1e} rad/s")
    assert max(errors) < 5e-5


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("rows", "noise", "most_undecided"),
    [(0, 0.0, 0.10), (100, 0.0, 0.10), (60, 0.0, 0.05), (25, 0.0, 1.0), (60, 1e-3, 0.10), (60, 1e-2, 0.35)],
)
def test_near_critical_grids_evidence(
    rows: int, noise: float, most_undecided: float, device: Device, linear: oracle.Linear
) -> None:
    """200 grids, or as many as SEQSWEEP_TRIALS says; rows = 0: as elements."""
    seed = int(np.random.SeedSequence().entropy % 2**31)
    rng, n = np.random.default_rng(seed), int(os.environ.get("SEQSWEEP_TRIALS", "200"))
    wrong = undecided = miscounted = believed = 0
    errors = []
    for case in cases(linear, seed, n):
        exact = elements_grid(case.document, F1_HZ).scaled(case.scale)
        stability = judged(device, exact if rows == 0 else tabulated(case, rows, noise, rng))
        true = "stable" if case.stable else "unstable"
        n_unstable = int(np.sum(case.poles.real > 0.0))
        by_locus = stability.n_open_loop_unstable - stability.winding.number
        differs = by_locus != n_unstable or stability.closed_loop.n_unstable != n_unstable
        miscounted += differs
        believed += differs and stability.verdict != "undecided"
        undecided += stability.verdict == "undecided"
        wrong += stability.verdict not in ("undecided", true)
        errors.append(np.abs(stability.closed_loop.poles - case.critical).min())
    median, high, worst = np.quantile(errors, [0.5, 0.95, 1.0])
    print(
        f"seed {seed}, {n} grids, rows {rows}, noise {noise:g}: {wrong} wrong, {undecided} undecided, {miscounted} "
        f"miscounted ({believed} of them decided), pole error {median:.1e} / {high:.1e} / {worst:.1e} rad/s "
        "(median, 95 %, largest)"
    )
    assert wrong == 0 if noise == 0.0 else wrong <= 0.01 * n
    assert undecided <= most_undecided * n
    if noise == 0.0:
        assert miscounted == 0
        assert rows not in (0, 100) or worst < WITHIN
