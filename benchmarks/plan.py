"""What `seqsweep plan` promises against what `seqsweep run` takes, over campaigns of many kinds.

    python benchmarks/plan.py [--quick]

Each campaign is planned and run with one worker in a process of its own, by CPU time, which neighbours on the machine
disturb least; without ``--quick`` also as whole commands with two workers, by the clock.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any

from harness import Report, command, fresh, planned, run_script
from thousand import campaign_text, predicted

BAR = 1.3

HEAD = '[campaign]\nname = "{name}"\n\n[plant]\nid = "{plant}"\n'
POINT = "[[operating_point]]\nactive_power_mw = {p}\nterminal_voltage_pu = {v}\n"
SWEEP = "[sweep]\nf_min_hz = {low}\nf_max_hz = 1000.0\npoints = {n}\n"
INJECTION = '[injection]\nkind = "series_voltage"\nsignal = "{signal}"\namplitude_pu = {pu}\n'
LINE = '[source]\nkind = "thevenin"\nr_ohm = 0.002\nx_ohm = 0.02\n'
DAMPED = "[plant.parameters]\ndamping_gain = 0.5\n"


def _text(
    plant: str = "dpmsg-v1", ops: int = 4, n: int = 60, signal: str = "tone", pu: float = 1e-3, more: str = ""
) -> str:
    """A campaign of ``ops`` operating points and ``n`` frequencies."""
    points = [POINT.format(p=0.4 + 0.05 * k, v=1.0 - 0.002 * k) for k in range(ops)]
    sweep, injection = SWEEP.format(low=1.0, n=n), INJECTION.format(signal=signal, pu=pu)
    return "\n".join([HEAD.format(name="plan", plant=plant), *points, sweep, injection, more])


def campaigns(quick: bool) -> Iterator[tuple[str, str]]:
    """Names and texts."""
    ops = 4 if quick else 16
    yield "a grid of operating points", campaign_text(20 if quick else 100, 100)
    yield "one operating point, 400 points", _text(ops=1, n=400)
    yield "behind a line", _text(ops=ops, more=LINE)
    yield "damping control", _text(ops=ops, more=DAMPED)
    yield "second-order step", _text(ops=ops, more='[plant.parameters]\nintegrator = "emt"\n')
    yield "grid-following inverter", _text("gfl-v1", ops)
    yield "grid-forming inverter behind a line", _text("gfm-v1", ops, more=LINE)
    yield "R-L branch", _text("branch-v1", ops)
    yield "multisine", _text(ops=ops, signal="multisine", pu=0.01)
    yield "binary sequence", _text(ops=ops, signal="prbs", pu=0.01)


def measure(quick: bool) -> Report:
    """Ratios, those below one turned over."""
    report = Report("What `plan` promises and what `run` takes")
    for name, text in campaigns(quick):
        with tempfile.TemporaryDirectory() as folder:
            campaign = Path(folder) / "campaign.toml"
            campaign.write_text(text, "utf-8")
            runs = [fresh(__file__, campaign=str(campaign)) for _ in range(1 if quick else 3)]
            says, took = (median(run[key] for run in runs) for key in ("plan_s", "run_s"))
            report.add(f"{name}: run by CPU time", took, "s")
            report.add(f"{name}: run over plan, or its inverse", max(took / says, says / took), "", BAR)
            if not quick:
                wall_s, _, _ = command(["run", str(campaign), "-o", str(Path(folder) / "y.parquet"), "--jobs", "2"])
                says = predicted(campaign)
                report.add(f"{name}: the same by the clock, two workers", max(wall_s / says, says / wall_s), "", BAR)
    return report


def child(campaign: str) -> dict[str, Any]:
    """Predicted and measured CPU time of one campaign, the start of the command left out of both."""
    from seqsweep.sweep.run import wall_time
    from seqsweep.sweep.run.campaign import run

    setattr(wall_time, "time", SimpleNamespace(perf_counter=time.process_time))  # noqa: B010
    plan, plant = planned(Path(campaign))
    run(plan, plant, Path(campaign).with_suffix(".warm"), jobs=1)
    says = wall_time.wall_time_s(plan, plant, 1) - wall_time.START_S
    begin = time.process_time()
    run(plan, plant, Path(campaign).with_suffix(".parquet"), jobs=1)
    return {"plan_s": says, "run_s": time.process_time() - begin}


if __name__ == "__main__":
    run_script("plan", measure, child)
