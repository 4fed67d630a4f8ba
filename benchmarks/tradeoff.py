"""Accuracy against step: error of the table against the oracle, and time of the sweep, for 12.5 to 200 us.

The default step is chosen by accuracy per second: the largest step whose worst error keeps the 1e-4 asked
for with room to spare. Also draws ``docs/figures/tradeoff.png``.
"""

from __future__ import annotations

import sys
from statistics import median
from typing import Any

import numpy as np
from harness import ROOT, Report, run_script, seconds, table_1_plan

STEPS_US = (12.5, 25.0, 50.0, 100.0, 200.0)
DEFAULT_US = 50.0
BAR_MAX, BAR_MEDIAN = 1e-4, 1e-5


def measure(quick: bool) -> Report:
    """Errors and times of every step."""
    report = Report("Accuracy against step: Table I, 0.65 MW, 1 Hz to 1 kHz, one core")
    found = [_one(step_us, 1 if quick else 5) for step_us in STEPS_US]
    for step_us, (worst, middle, time_s) in zip(STEPS_US, found, strict=True):
        is_default = step_us == DEFAULT_US
        report.add(f"{step_us:g} us: largest relative error", worst, "", BAR_MAX if is_default else None)
        report.add(f"{step_us:g} us: median relative error", middle, "", BAR_MEDIAN if is_default else None)
        report.add(f"{step_us:g} us: time of the sweep", time_s, "s")
    worst, middle, time_s = (list(column) for column in zip(*found, strict=True))
    report.series = {"step_us": list(STEPS_US), "max": worst, "median": middle, "time_s": time_s}
    draw(report.series)
    return report


def _one(step_us: float, repetitions: int) -> tuple[float, float, float]:
    """Largest and median relative Frobenius error, and the sweep's time (s)."""
    from seqsweep.sweep.measure.measure import measure as measure_batch

    sys.path.insert(0, str(ROOT))
    from tests.support import oracle

    plan, plant = table_1_plan(f"plant.parameters.dt_s={step_us}e-6")

    def sweep() -> list[Any]:
        return [row for batch in plan.batches() for row in measure_batch(plant, batch).rows]

    rows = sweep()
    time_s = median(seconds(sweep, repetitions))
    assert all(row.status == "ok" for row in rows), {row.status for row in rows}
    f_hz, parts = np.array([row.f_hz for row in rows]), np.array([row.y for row in rows])
    y = (parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)
    exact = oracle.admittance_pn(f_hz, 0.65e6, 690.0)
    error = np.linalg.norm(y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    return float(error.max()), float(np.median(error)), time_s


def draw(series: dict[str, Any]) -> None:
    """Error over time of the sweep, one point for each step."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, style in (("max", "o-"), ("median", "s--")):
        axes.loglog(series["time_s"], series[name], style, label="largest error" if name == "max" else "median error")
    for step_us, time_s, error in zip(series["step_us"], series["time_s"], series["max"], strict=True):
        axes.annotate(f"{step_us:g} us", (time_s, error), (4, 6), textcoords="offset points", fontsize=9)
    axes.margins(x=0.12, y=0.1)
    axes.axhline(BAR_MAX, color="0.5", lw=0.8)
    axes.annotate(
        "asked: 1e-4", (axes.get_xlim()[1], BAR_MAX), (-4, 3), textcoords="offset points", ha="right", fontsize=9
    )
    k = series["step_us"].index(DEFAULT_US)
    axes.plot(series["time_s"][k], series["max"][k], "o", ms=14, mfc="none", mec="k", label="default")
    axes.set_xlabel("time of the 100-point sweep on one core (s)")
    axes.set_ylabel("relative error of Y against the exact linearisation")
    axes.grid(True, which="both", lw=0.3)
    axes.legend()
    folder = ROOT / "docs" / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "tradeoff.png", dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    run_script("tradeoff", measure)
