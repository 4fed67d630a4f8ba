"""What `tune` costs: 1,000 operating points of the reference turbine, 100 rows each, on one grid, in CPU time.

    python benchmarks/tuning.py [--quick]

Rows are those of the exact linearisation (tests/support/oracle.py), without noise and with 0.1 % of it, white, its
covariance known. The quick run takes forty operating points and multiplies.
"""

from __future__ import annotations

import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from harness import Report, run_script
from verdict_families.tables import T_PN
from verdict_families.turbines import BASES, linear_turbine

from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune

POINTS, QUICK = 1000, 40
GRID = SeriesRL(0.012, 0.25, BASES.f1_hz)
BAR_S = 45.0


def operating_point(rng: np.random.Generator, noise: float) -> FrequencyResponse:
    """Hundred logarithmic rows of the turbine at a random power and voltage."""
    f_hz = np.geomspace(1.0, 1000.0, 100)
    device = linear_turbine(float(rng.uniform(0.2, 1.3)), float(rng.uniform(0.9, 1.1)))
    y = T_PN @ device.admittance(f_hz - BASES.f1_hz) @ np.linalg.inv(T_PN)
    std = noise * np.linalg.norm(y, axis=(1, 2)) / 2.0
    error = (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)) / np.sqrt(2.0)
    covariance = std[:, None, None] ** 2 / 2.0 * np.eye(8) if noise else None
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", "growth_bound_per_s": 0.7, "disturbed_s": 10.0}}
    return FrequencyResponse(f_hz, y + std[:, None, None] * error, BASES.f1_hz, covariance=covariance, meta=meta)


def cpu_s(responses: list[FrequencyResponse]) -> float:
    """CPU time of `tune`."""
    begin = time.process_time()
    tune(responses, GRID)
    return time.process_time() - begin


def measure(quick: bool) -> Report:
    """CPU time of `tune`, with and without noise."""
    report = Report(f"Tuning: {POINTS} operating points x 100 rows on one grid")
    number = QUICK if quick else POINTS
    rng = np.random.default_rng(12)
    for noise in (0.0, 1e-3):
        responses = [operating_point(rng, noise) for _ in range(number)]
        tune(responses[:1], GRID)  # what is loaded late is loaded
        what = f"CPU time of `tune`, rows with {100.0 * noise:g} % of noise" if noise else "CPU time of `tune`"
        report.add(what, cpu_s(responses) * POINTS / number, "s", BAR_S)
    return report


if __name__ == "__main__":
    run_script("tuning", measure)
