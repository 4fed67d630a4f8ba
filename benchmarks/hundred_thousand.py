"""100,000 operating points x 100 frequencies (1e7 rows), measured in part and predicted.

    python benchmarks/hundred_thousand.py [--quick]

Memory: the whole command at a few numbers of operating points with four frequencies each; what each further operating
point costs is their slope. Time and disk: some operating points with all 100 frequencies, measured together as a
worker does; their results stand for those of many more, which are kept as shards and assembled into a table.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from harness import Report, command, fresh, peak_memory_mb, planned, run_script
from thousand import campaign_text

OPERATING_POINTS, POINTS = 100_000, 100
WORKERS = 2
TOGETHER = 16
"""Operating points that a worker measures together."""


def measure(quick: bool) -> Report:
    """What a part costs, and what the whole will."""
    # more rows than a group of the table has: the writer fills its room
    sizes = (2500, 5000) if quick else (2500, 5000, 10000)
    report = Report(f"{OPERATING_POINTS} operating points x {POINTS} frequencies: measured in part, predicted")
    memory_mb = [_memory_mb(n) for n in sizes]
    for n, mb in zip(sizes, memory_mb, strict=True):
        report.add(f"peak memory of `run`, {n} operating points x 4 frequencies", mb, "MB")
    slope, start = np.polyfit(sizes, memory_mb, 1)
    kept = [fresh(__file__, n_assembled=n) for n in ((200, 800) if quick else (500, 4000))]
    each = kept[-1]
    report.add("CPU time to measure an operating point", each["measure_s"], "s")
    for found in kept:
        n = found["operating_points"]
        report.add(f"assembling {n} operating points, each", 1e3 * found["assemble_s"], "ms")
        report.add(f"peak memory of assembling {n} operating points", found["memory_mb"], "MB")
    report.add("shard of an operating point", each["shard_kb"], "kB")
    report.add("table, per operating point", each["table_kb"], "kB")
    whole = OPERATING_POINTS
    report.add(
        "predicted: wall time, two workers", whole * (each["measure_s"] / WORKERS + each["assemble_s"]) / 3600, "h"
    )
    report.add("predicted: peak memory", start + slope * whole, "MB")
    report.add("predicted: shards on the disk until the table is written", whole * each["shard_kb"] / 1e6, "GB")
    report.add("predicted: the table", whole * each["table_kb"] / 1e6, "GB")
    return report


def _memory_mb(n: int) -> float:
    """Peak memory (MB) of the whole command with so many operating points."""
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.toml"
        campaign.write_text(campaign_text(n, 4).replace("f_min_hz = 1.0", "f_min_hz = 200.0"), "utf-8")
        return command(["run", str(campaign), "-o", str(Path(folder) / "y.parquet"), "--jobs", str(WORKERS)])[1]


def child(n_assembled: int) -> dict[str, Any]:
    """Cost of an operating point: measured, kept and assembled."""
    from seqsweep.identify.table.write import write_table
    from seqsweep.sweep.measure.measure import measure_together
    from seqsweep.sweep.run import shards
    from seqsweep.sweep.run.swept import Swept

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "campaign.toml").write_text(campaign_text(n_assembled, POINTS), "utf-8")
        plan, plant = planned(folder / "campaign.toml")
        batches = list(plan.batches())
        measure_together(plant, batches[:1])  # code is loaded
        begin = time.process_time()
        results = measure_together(plant, batches[:TOGETHER])
        measured_s = time.process_time() - begin
        store = shards.Folder(folder)
        begin = time.process_time()
        for batch, result in zip(batches, cycle(results), strict=False):
            store.write(batch, result)
        kept_s = time.process_time() - begin
        swept = Swept(plan, plant, store, batches, {})
        begin = time.process_time()
        write_table(folder / "y.parquet", swept.responses(), swept.metadata())
        assembled_s = time.process_time() - begin
        sizes = list(_sizes(folder, batches))
        # by itself: what is there many times over packs too well
        few = Swept(replace(plan, conditions=plan.conditions[:TOGETHER]), plant, store, batches[:TOGETHER], {})
        write_table(folder / "few.parquet", few.responses(), few.metadata())
        table_bytes = (folder / "few.parquet").stat().st_size
    return {
        "operating_points": n_assembled,
        "measure_s": measured_s / TOGETHER + kept_s / n_assembled,
        "assemble_s": assembled_s / n_assembled,
        "shard_kb": float(np.mean(sizes)) / 1e3,
        "table_kb": table_bytes / TOGETHER / 1e3,
        "memory_mb": peak_memory_mb(),
    }


def _sizes(folder: Path, batches: list[Any]) -> Iterator[int]:
    return ((folder / batch.key).stat().st_size for batch in batches)


if __name__ == "__main__":
    run_script("hundred_thousand", measure, child)
