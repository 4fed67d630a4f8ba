"""The same 100-point 2x2 tone sweep with dpsim's converter driven through our `Plant`, time per part.

The converter cannot save its state, so every experiment is replayed from cold (`examples/dpsim_plant.py`).
Only every tenth point is run (every twenty-fifth with --quick) and the time scaled up by the number of
points. Both sweeps run on one core and to a tolerance of 1e-4.
"""

from __future__ import annotations

import sys
import time
from statistics import median
from typing import Any

from harness import ROOT, Report, planned, run_script, seconds, table_1_plan

CAMPAIGN = ROOT / "examples" / "dpsim_plant.toml"


class _Timed:
    """A plant and the time spent in it."""

    def __init__(self, plant: Any):
        self._plant = plant
        self.spent = {"settle": 0.0, "run": 0.0}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def settle(self, *arguments: Any) -> Any:
        return self._clocked("settle", arguments)

    def run(self, *arguments: Any) -> Any:
        return self._clocked("run", arguments)

    def _clocked(self, what: str, arguments: tuple[Any, ...]) -> Any:
        begin = time.process_time()
        try:
            return getattr(self._plant, what)(*arguments)
        finally:
            self.spent[what] += time.process_time() - begin


def measure(quick: bool) -> Report:
    """Time of both sweeps, part by part."""
    from seqsweep.sweep.measure.measure import measure as measure_batch

    sys.path.insert(0, str(ROOT))
    ours, our_points, our_simulated_s = _our_sweep(5)
    grid, _ = table_1_plan()
    every = 25 if quick else 10
    f_hz = [point.f_hz for point in grid.points][every // 2 :: every]
    plan, plant = planned(CAMPAIGN, f"sweep.f_hz={f_hz}")
    timed, begin = _Timed(plant), time.process_time()
    results = [measure_batch(timed, batch) for batch in plan.batches()]
    whole = time.process_time() - begin
    scale = len(grid.points) / len(f_hz)
    steps = plant.steps_spent
    per_step = timed.spent["run"] / (steps["replaying"] + steps["recording"])
    ok = sum(row.status == "ok" for result in results for row in result.rows)
    report = Report(f"dpsim's converter through our Plant, 100 points from {len(f_hz)} (x {scale:g}), one core")
    report.add("points measured that are ok", ok / len(f_hz) * 100.0, "%")
    report.add("dpsim: settling (first time)", scale * timed.spent["settle"], "s")
    report.add("dpsim: replaying from cold", scale * per_step * steps["replaying"], "s")
    report.add("dpsim: running what is recorded", scale * per_step * steps["recording"], "s")
    report.add("dpsim: extraction", scale * (whole - sum(timed.spent.values())), "s")
    report.add("dpsim: whole sweep", scale * whole, "s")
    report.add("dpsim: simulated", scale * sum(steps.values()) * plant.dt_s, "s")
    report.add(f"reference turbine: whole sweep ({our_points} points)", ours, "s")
    report.add("reference turbine: simulated, replaying nothing", our_simulated_s, "s")
    report.add("ratio of the two", scale * whole / ours, "")
    return report


def _our_sweep(repetitions: int) -> tuple[float, int, float]:
    """CPU time (s) of our sweep at 1e-4, its points, its simulated seconds."""
    from seqsweep.sweep.measure.measure import measure as measure_batch

    plan, plant = table_1_plan("sweep.tolerance=1e-4")

    def sweep() -> None:
        for batch in plan.batches():
            measure_batch(plant, batch)

    sweep()
    return median(seconds(sweep, repetitions, time.process_time)), len(plan.points), plan.simulated_s


if __name__ == "__main__":
    run_script("dpsim_sweep", measure)
