"""A device against another table: a line with a second turbine behind it, against the linearisation of all three."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.open import open_grid
from seqsweep.tuning.grids.response import ResponseGrid
from seqsweep.tuning.grids.series import SeriesRL
from seqsweep.tuning.verdict import judge
from tests.support import oracle

F1_HZ, W1, U_V = 50.0, 100.0 * np.pi, 690.0
J = np.array([[0.0, -1.0], [1.0, 0.0]])
T = np.array([[1.0, 1j], [1.0, -1j]])
NU = np.geomspace(0.4, 1950.0, 100)
METADATA = {
    "f1_hz": F1_HZ,
    "bases": {"rated_voltage_v": U_V, "rated_power_va": 1.632e6},
    "power_meaning": "at the PCC, out of the device",
    "operating_points": [{"op_id": name, "active_power_mw": 0.0, "terminal_voltage_pu": 1.0} for name in "ab"],
    "configuration": {},
    "plant": {"id": "line"},
}
IDEAL = {"op_id": "a", "stable_on": {"grid": "ideal", "basis": "shots"}}
FIRST, SECOND = oracle.linearise(0.65e6, U_V), oracle.linearise(0.3e6, U_V)


def of_line(s: np.ndarray, scale: float) -> np.ndarray:
    """Ydq of 0.012 + 0.25j ohm at 50 Hz times ``scale``."""
    r, l_h = 0.012 * scale, 0.25 * scale / W1
    return np.linalg.inv((r + s * l_h)[:, None, None] * np.eye(2) + W1 * l_h * J)


def of_turbine(linear: oracle.Linear, s: np.ndarray) -> np.ndarray:
    """Ydq of a linearised turbine."""
    inner = s[:, None, None] * np.eye(len(linear.A)) - linear.A
    return linear.C @ np.linalg.solve(inner, linear.B.astype(complex)) + linear.D


def measured(y_dq: np.ndarray, noise: float, rng: np.random.Generator) -> FrequencyResponse:
    """A table with noise of a part of the size of Y on every element."""
    y, covariance = T @ y_dq @ np.linalg.inv(T), None
    if noise > 0.0:
        size = noise * np.linalg.norm(y, axis=(1, 2))[:, None, None] / 2.0
        y = y + size / np.sqrt(2.0) * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
        covariance = np.eye(8) * size**2 / 2.0
    return FrequencyResponse(F1_HZ + NU, y, F1_HZ, covariance=covariance, meta=IDEAL)


def truth(scale: float) -> np.ndarray:
    """Poles of two turbines and a line at one bus: its voltage follows from the currents adding up to zero."""
    r, l_h = 0.012 * scale, 0.25 * scale / W1
    n = len(FIRST.A)
    a = np.zeros((2 * n + 2, 2 * n + 2))
    a[:n, :n], a[n : 2 * n, n : 2 * n], a[2 * n :, 2 * n :] = FIRST.A, SECOND.A, -r / l_h * np.eye(2) - W1 * J
    voltage = -np.linalg.solve(FIRST.D + SECOND.D, np.hstack([FIRST.C, SECOND.C, np.eye(2)]))
    return np.linalg.eigvals(a + np.vstack([FIRST.B, SECOND.B, np.eye(2) / l_h]) @ voltage)


def source(scale: float, noise: float, rng: np.random.Generator) -> ResponseGrid:
    s = 2j * np.pi * NU
    return ResponseGrid(fit_response(measured(of_line(s, scale) + of_turbine(SECOND, s), noise, rng)), "farm")


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("x_c", [0.0, 0.1])
def test_a_measured_line_names_the_resonance_that_the_line_has(x_c: float, noise: float) -> None:
    """Of 0.012 + 0.25j ohm, with and without a series capacitor: nothing at 0/100 Hz, and the verdict is given.

    Ys has poles there, of which a fit may see one too many, and a capacitor makes it vanish at 0 Hz.
    """
    rng, s = np.random.default_rng(3), 2j * np.pi * NU

    def z(phase: np.ndarray) -> np.ndarray:
        return 0.012 + phase * 0.25 / W1 + x_c * W1 / phase

    z1, z2 = z(s + 1j * W1), z(s - 1j * W1)
    z_dq = ((z1 + z2) / 2.0)[:, None, None] * np.eye(2) + ((z1 - z2) / 2j)[:, None, None] * J
    line = ResponseGrid(fit_response(measured(np.linalg.inv(z_dq), noise, rng)), "line")
    elements = [{"kind": "series", "r_ohm": 0.012, "x_ohm": 0.25}, {"kind": "series_capacitor", "x_ohm": x_c}]
    exact = elements_grid({"element": elements[: 2 if x_c else 1]}, F1_HZ)
    device = fit_response(measured(of_turbine(FIRST, s), 0.0, rng))
    of_table, of_elements = judge(device, line), judge(device, exact)
    assert of_table.verdict == of_elements.verdict == "stable"
    assert of_table.closed_loop.resonance_hz == pytest.approx(of_elements.closed_loop.resonance_hz, abs=0.01)


@pytest.mark.parametrize("scale", [0.6, 0.75, 0.8, 1.2])
def test_without_noise_two_tables_give_the_modes_of_both_devices_to_1e_7(scale: float) -> None:
    rng = np.random.default_rng(0)
    device = fit_response(measured(of_turbine(FIRST, 2j * np.pi * NU), 0.0, rng))
    poles = truth(scale)
    stability = judge(device, source(scale, 0.0, rng))
    critical = max((p for p in poles if p.imag >= 30.0), key=lambda p: p.real)  # slower ones are the machines'
    assert np.abs(stability.closed_loop.poles - critical).min() < 1e-7
    n_unstable = int(np.sum(poles.real > 0.0))
    assert stability.closed_loop.n_unstable == n_unstable
    assert stability.n_open_loop_unstable - stability.winding.number == n_unstable
    assert stability.verdict == ("stable" if n_unstable == 0 else "unstable")


def test_with_noise_the_ellipse_of_both_tables_holds_the_truth() -> None:
    """Chi-squared of two degrees below 5.991 in 95 % of the cases; the device's errors alone are far too small."""
    inside, by_device = inside_of(1e-3, 20, np.random.default_rng(3))
    assert inside >= 0.85 * 20
    assert by_device < 20


@pytest.mark.evidence
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_ellipses_of_two_tables_evidence(noise: float) -> None:
    """400 pairs of tables, or as many as SEQSWEEP_TRIALS says: 95 % within what so few can tell."""
    seed = int(np.random.SeedSequence().entropy % 2**31)
    n = int(os.environ.get("SEQSWEEP_TRIALS", "400"))
    inside, _ = inside_of(noise, n, np.random.default_rng(seed))
    print(f"seed {seed}, noise {noise:g}: {inside} of {n} inside the 95 % ellipse ({inside / n:.1%})")
    slack = 2.0 * np.sqrt(0.05 * 0.95 / n)
    assert 0.93 - slack <= inside / n <= 0.97 + slack


def inside_of(noise: float, n: int, rng: np.random.Generator) -> tuple[int, int]:
    """How many of n critical modes are inside their 95 % ellipse, and inside a third of their standard error."""
    critical = max((p for p in truth(1.0) if p.imag >= 30.0), key=lambda p: p.real)
    inside, by_device = 0, 0
    for _ in range(n):
        device = fit_response(measured(of_turbine(FIRST, 2j * np.pi * NU), noise, rng))
        loop = judge(device, source(1.0, noise, rng)).closed_loop
        k = int(np.argmin(np.abs(loop.poles - critical)))
        off = np.array([(loop.poles[k] - critical).real, (loop.poles[k] - critical).imag])
        inside += bool(off @ np.linalg.solve(loop.covariance[k], off) < 5.991)
        by_device += bool(np.abs(off[0]) < 2.0 * np.sqrt(loop.covariance[k, 0, 0]) / 3.0)
    return inside, by_device


def test_an_ordinary_line_as_a_table_is_the_line() -> None:
    rng = np.random.default_rng(1)
    grid = ResponseGrid(fit_response(measured(of_line(2j * np.pi * NU, 1.3), 0.0, rng)))
    line = SeriesRL(1.3 * 0.012, 1.3 * 0.25, F1_HZ)
    s = 2j * np.pi * NU[::9] - 2.0
    np.testing.assert_allclose(grid.impedance_dq(s), line.impedance_dq(s), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(grid.slope_dq(s), line.slope_dq(s), rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(grid.scaled(2.0).impedance_dq(s), 2.0 * line.impedance_dq(s), rtol=1e-6, atol=1e-7)
    assert grid.couples
    assert grid.at_f1 == pytest.approx(line.at_f1, rel=1e-6)


def test_a_source_of_several_points_is_named_and_its_table_read(tmp_path: Path) -> None:
    y = of_line(2j * np.pi * NU, 1.0)
    response = measured(y, 0.0, np.random.default_rng(0))
    points = [
        replace(response, meta={"op_id": name, **{k: v for k, v in IDEAL.items() if k != "op_id"}}) for name in "ab"
    ]
    write_table(tmp_path / "source.parquet", points, METADATA)
    with pytest.raises(ValueError, match=r"write .*#ID"):
        open_grid(str(tmp_path / "source.parquet"), F1_HZ)
    grid = open_grid(f"{tmp_path / 'source.parquet'}#b", F1_HZ)
    assert grid.at_f1 == pytest.approx(0.012 + 0.25j, rel=1e-5)
