"""Cost against the number of points and of operating points: the fitted exponent, and peak memory.

Every size runs in a process of its own, through the campaign runner with two workers, table included;
kernels are compiled before the clock starts.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from harness import Report, fresh, peak_memory_mb, planned, run_script, table_1_plan
from thousand import campaign_text

POINTS = (50, 100, 200, 400, 800)
OPERATING_POINTS = (4, 16, 64, 256)


def measure(quick: bool) -> Report:
    """Figures and series."""
    repetitions = 1 if quick else 3
    report = Report("Cost against size: campaign runner with two workers, table included")
    sizes = {"points": [(1, n) for n in POINTS], "operating points": [(n, 100) for n in OPERATING_POINTS]}
    for what, pairs in sizes.items():
        pairs = pairs[:-1] if quick else pairs
        found = [_middle([fresh(__file__, powers_voltages=n, points=m) for _ in range(repetitions)]) for n, m in pairs]
        n = [run["points"] if what == "points" else run["operating_points"] for run in found]
        per_simulated = [run["wall_s"] / run["simulated_s"] for run in found]
        wall = [run["wall_s"] for run in found]
        for size, run in zip(n, found, strict=True):
            report.add(f"{size} {what}: wall time", run["wall_s"], "s")
        report.add(f"exponent of wall time in {what}", _exponent(n, wall), "", 1.1)
        report.add(f"{what}: dearest over cheapest simulated second", max(per_simulated) / min(per_simulated), "")
        report.add(f"peak memory at {n[0]} {what}", found[0]["memory_mb"], "MB")
        report.add(f"peak memory at {n[-1]} {what}", found[-1]["memory_mb"], "MB", 600.0)
        report.series[what] = {"n": n, "wall_s": wall, "memory_mb": [run["memory_mb"] for run in found]}
    return report


def _middle(runs: list[dict[str, float]]) -> dict[str, float]:
    return {name: median(run[name] for run in runs) for name in runs[0]}


def _exponent(n: list[float], cost: list[float]) -> float:
    """Slope of log cost over log n."""
    return float(np.polyfit(np.log(n), np.log(cost), 1)[0])


def child(powers_voltages: int, points: int) -> dict[str, Any]:
    """One campaign of ``powers_voltages`` operating points and about ``points`` frequencies, once warm."""
    from seqsweep.sweep.run.campaign import run

    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.toml"
        campaign.write_text(campaign_text(powers_voltages, points), "utf-8")
        plan, plant = planned(campaign)
        warm, warm_plant = table_1_plan()
        run(warm, warm_plant, Path(folder) / "warm.parquet", jobs=2)
        begin = time.perf_counter()
        run(plan, plant, Path(folder) / "y.parquet", jobs=2)
        wall_s = time.perf_counter() - begin
    return {
        "points": len(plan.points),
        "operating_points": len(plan.conditions),
        "simulated_s": plan.simulated_s,
        "wall_s": wall_s,
        "memory_mb": peak_memory_mb(),
    }


if __name__ == "__main__":
    run_script("scaling", measure, child)
