"""Parallel efficiency, 1 -> 2 workers, and the 100-point sweep by itself: simulation and extraction.

The runs with one and with two workers take turns, so that what else the machine does hits both alike.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from harness import Report, fresh, planned, run_script, seconds, table_1_plan
from thousand import campaign_text


def measure(quick: bool) -> Report:
    """Figures of one process with and without a second worker."""
    report = Report("One and two workers")
    found = [fresh(__file__, quick=quick) for _ in range(1 if quick else 2)]
    for name in found[0]:
        bar = {"sweep, 2 threads: simulation + extraction": 0.06}.get(name)
        unit = "" if "efficiency" in name or "ratio" in name else "s"
        report.add(name, median(run[name] for run in found), unit, bar)
    return report


def child(quick: bool) -> dict[str, float]:
    """Times (s) and efficiencies."""
    from seqsweep.sweep.run.campaign import run
    from seqsweep.sweep.run.workers import Workers, pool

    plan, plant = table_1_plan("sweep.tolerance=1e-4")

    bare, _ = table_1_plan("sweep.tolerance=1e-4", "sweep.probes=0")

    def sweep(jobs: int, plan: Any = plan) -> Callable[[], object]:
        """What `run` does between the plan and the table: batches to workers, and their results."""
        batches = list(plan.batches())

        def swept() -> object:
            with pool(plan, plant, Workers(jobs, "threading", None)) as results:
                return list(results(batches))

        return swept

    with tempfile.TemporaryDirectory() as folder:
        one, two, fewer = _in_turns((sweep(1), sweep(2), sweep(1, bare)), 5 if quick else 15)
        found = {
            "sweep: ratio of probed to unprobed": one / fewer,
            "sweep, 1 thread: simulation + extraction": one,
            "sweep, 2 threads: simulation + extraction": two,
            "sweep: efficiency": one / two / 2.0,
            "kernel alone, 100 points, 1 thread": _kernel_s(plan, plant),
        }
        campaign, output = Path(folder) / "campaign.toml", Path(folder) / "y.parquet"
        campaign.write_text(campaign_text(12 if quick else 30, 100), "utf-8")
        big, big_plant = planned(campaign)

        def command(jobs: int) -> Callable[[], object]:
            return lambda: run(big, big_plant, output, jobs=jobs)

        one, two = _in_turns((command(1), command(2)), 1 if quick else 2)
    n = len(big.conditions)
    return found | {
        f"campaign of {n} operating points, 1 worker": one,
        f"campaign of {n} operating points, 2 workers": two,
        "campaign: efficiency": one / two / 2.0,
    }


def _in_turns(functions: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """Median time (s) of each, run one after the other, round by round; the first round is for warmth."""
    rounds = []
    for _ in range(1 + repetitions):
        rounds.append([seconds(function, 1)[0] for function in functions])
    return [median(times) for times in zip(*rounds[1:], strict=True)]


def _kernel_s(plan: Any, plant: Any) -> float:
    """Time of the stepping alone: the sweep again, with a clock around what the plant is asked to step."""
    from seqsweep.sweep.measure.measure import measure_together

    spent = 0.0

    class Clocked:
        def __getattr__(self, name: str) -> Any:
            return getattr(plant, name)

        settle, run, run_phasors = plant.settle, plant.run, plant.run_phasors

        def phasor_run(self, *arguments: Any) -> Any:
            under_way = plant.phasor_run(*arguments)

            class Stretches:
                def go_on(self, *asked: Any) -> Any:
                    nonlocal spent
                    begin = time.perf_counter()
                    heard = under_way.go_on(*asked)
                    spent += time.perf_counter() - begin
                    return heard

            return Stretches()

    measure_together(Clocked(), list(plan.batches()))
    return spent


if __name__ == "__main__":
    run_script("parallel", measure, child)
