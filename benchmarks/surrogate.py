"""The surrogate over operating points against a library's method: error by number of sweeps, and how fast it is.

The rival is scipy's `RBFInterpolator` with cubic kernels, which is installed anyway, in the same coordinates and for
the same sweeps: of what libraries offer for scattered points it needs no tuning and is exact at the sweeps. Truth is
the turbine's exact linearisation (tests/support); errors are ||dY||/||Y|| at points that were not swept.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import Report, run_script

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

BUILD_BAR_S, EVALUATE_BAR_S = 5.0, 2.0
COUNTS = (8, 10, 12, 16, 20)


def measure(quick: bool) -> Report:
    """Figures of the surrogate and of its rival."""
    from tests.support.regions import PQV, PV

    report = Report("Surrogate over operating points: the turbine's exact Y, designs grown by doubt")
    designs = 2 if quick else 20
    series: dict[str, Any] = {}
    for name, region in (("P, V", PV), ("P, Q, V", PQV)):
        found = [_grown(region, seed, 40 if quick else 300) for seed in range(designs)]
        for k, count in enumerate(COUNTS):
            ours, bar, rival = np.median([each[k] for each in found], axis=0)
            report.add(f"{name}, {count} sweeps: largest true error", ours, "")
            report.add(f"{name}, {count} sweeps: largest error bar", bar, "")
            report.add(f"{name}, {count} sweeps: largest true error of the rival", rival, "")
        series[name] = np.median(found, axis=0).tolist()
    build, evaluate = _speed()
    report.add("built from 20 sweeps of 100 frequencies", build, "s of CPU", BUILD_BAR_S)
    report.add("evaluated 1e5 times (P, Q, V, f)", evaluate, "s of CPU", EVALUATE_BAR_S)
    report.series = series
    return report


def _grown(region: Any, seed: int, n_unseen: int) -> list[tuple[float, float, float]]:
    """(largest true error, largest bar, the rival's largest true error) at each of `COUNTS`."""
    from seqsweep.identify.surrogate.design import first_points, next_point
    from seqsweep.identify.surrogate.surrogate import build_surrogate
    from tests.support.regions import errors_of, exact, swept, unseen

    points = unseen(region, n_unseen, 1000 + seed)
    truth = np.array([exact(point) for point in points])
    responses, found = [swept(point) for point in first_points(region, seed)], []
    while True:
        surrogate = build_surrogate(responses, region=region)
        at, bar = next_point(surrogate, region)
        if len(responses) in COUNTS:
            off, _ = errors_of(surrogate, points, truth)
            found.append((float(off.max()), bar, _rival(surrogate, responses, points, truth)))
        if len(responses) == COUNTS[-1]:
            return found
        responses.append(swept(at))


def _rival(surrogate: Any, responses: Sequence[Any], points: np.ndarray, truth: np.ndarray) -> float:
    """Largest true error of cubic radial basis functions in the surrogate's coordinates."""
    from scipy.interpolate import RBFInterpolator

    y = np.array([response.y.ravel() for response in responses])
    model = RBFInterpolator(surrogate.scale.unit(surrogate.points), np.hstack([y.real, y.imag]), kernel="cubic")
    told = model(surrogate.scale.unit(points))
    told = (told[:, : y.shape[1]] + 1j * told[:, y.shape[1] :]).reshape(truth.shape)
    return float((np.linalg.norm(told - truth, axis=(2, 3)) / np.linalg.norm(truth, axis=(2, 3))).max())


def _speed() -> tuple[float, float]:
    """CPU seconds to build from 20 sweeps at 100 frequencies, and to evaluate 1000 points at all of them."""
    from seqsweep.identify.response import FrequencyResponse
    from seqsweep.identify.surrogate.surrogate import build_surrogate
    from tests.support.regions import PQV, exact, swept, unseen

    f_hz = 50.0 + np.logspace(-0.3, np.log10(950.0), 100)
    responses = []
    for point in unseen(PQV, 20, 5):
        y = exact(point, f_hz)
        size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
        covariance = (3e-6**2 / 8.0) * size**2 * np.eye(8)
        responses.append(FrequencyResponse(f_hz, y, 50.0, covariance=covariance, meta=swept(point).meta))
    begin = time.process_time()
    surrogate = build_surrogate(responses, region=PQV)
    built = time.process_time()
    surrogate.evaluate(unseen(PQV, 1000, 6))
    return built - begin, time.process_time() - built


def child(what: str) -> dict[str, Any]:
    """Nothing runs in a process of its own."""
    raise ValueError(what)


if __name__ == "__main__":
    run_script("surrogate", measure, child)
