"""100,000 operating points x 100 frequencies (1e7 rows), measured in part and predicted.

    python benchmarks/hundred_thousand.py [--quick]

Memory: whole campaigns of four frequencies, from the file to the table, in which the results of a few operating points
are handed out again and again in place of measuring; what each further operating point costs is their slope. Without
--quick the last of them has all 100,000. Time and disk: some operating points with all 100 frequencies, measured
together as a worker does; their results stand for those of many more, which are kept as shards, packed and assembled
into a table.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from harness import Report, fresh, peak_memory_mb, planned, run_script
from thousand import campaign_text

OPERATING_POINTS, POINTS = 100_000, 100
WORKERS = 2
TOGETHER = 16
"""Operating points that a worker measures together."""

LOOSE = 256
"""Shards that are not packed yet, at most."""


def measure(quick: bool) -> Report:
    """What a part costs, and what the whole will."""
    # more rows than several groups of the table have: the writer fills its room
    sizes = (8000, 24000) if quick else (8000, 24000, OPERATING_POINTS)
    report = Report(f"{OPERATING_POINTS} operating points x {POINTS} frequencies: measured in part, predicted")
    memory_mb = [fresh(__file__, n_assembled=n, played=True)["memory_mb"] for n in sizes]
    for n, mb in zip(sizes, memory_mb, strict=True):
        report.add(f"peak memory, {n} operating points x 4 frequencies", mb, "MB")
    slope, start = np.polyfit(sizes, memory_mb, 1)
    report.add("memory of a further operating point", 1e3 * slope, "kB")
    kept = [fresh(__file__, n_assembled=n) for n in ((300, 900) if quick else (500, 4000))]
    each = kept[-1]
    report.add("CPU time to measure an operating point and keep it", each["measure_s"], "s")
    report.add("of it in the kernel that steps the shots", each["kernel_s"], "s")
    report.add("of it keeping: shard and pack", 1e3 * each["keep_s"], "ms")
    for found in kept:
        n = found["operating_points"]
        report.add(f"assembling {n} operating points, each", 1e3 * found["assemble_s"], "ms")
        report.add(f"peak memory of assembling {n} operating points", found["memory_mb"], "MB")
    report.add("shard of an operating point, before it is packed", each["loose_kb"], "kB")
    report.add("shard of an operating point, packed", each["packed_kb"], "kB")
    report.add("metadata of an operating point, in the foot of the table", each["foot_b"], "B")
    report.add("table, per operating point", each["table_kb"], "kB")
    whole = OPERATING_POINTS
    report.add(
        "predicted: wall time, two workers", whole * (each["measure_s"] / WORKERS + each["assemble_s"]) / 3600, "h"
    )
    report.add("predicted: peak memory", start + slope * whole, "MB")
    at_most = (whole * each["packed_kb"] + LOOSE * each["loose_kb"]) / 1e6
    report.add("predicted: shards on the disk until the table is written, at most", at_most, "GB")
    report.add("predicted: the table", whole * each["table_kb"] / 1e6, "GB")
    return report


def child(n_assembled: int, played: bool = False) -> dict[str, Any]:
    """Peak memory of a campaign whose results are handed out, or the cost of an operating point, part by part."""
    with tempfile.TemporaryDirectory() as folder:
        return _played(Path(folder), n_assembled) if played else _in_parts(Path(folder), n_assembled)


def _played(folder: Path, n_points: int) -> dict[str, Any]:
    """A whole campaign in which nothing is measured but its first operating points."""
    from seqsweep.sweep.measure.measure import measure_together
    from seqsweep.sweep.run import host
    from seqsweep.sweep.run.campaign import run

    text = campaign_text(n_points, 4).replace("f_min_hz = 1.0", "f_min_hz = 200.0")
    (folder / "campaign.toml").write_text(text, "utf-8")
    plan, plant = planned(folder / "campaign.toml")
    results = cycle(measure_together(plant, list(islice(plan.batches(), TOGETHER))))
    host.measure_together = lambda plant, batches: [next(results) for _ in batches]
    run(plan, plant, folder / "y.parquet", jobs=1)
    return {"memory_mb": peak_memory_mb()}


def _in_parts(folder: Path, n_assembled: int) -> dict[str, Any]:
    """An operating point measured, kept and assembled."""
    from seqsweep.identify.table.read import read_metadata
    from seqsweep.identify.table.write import write_table
    from seqsweep.sweep.measure.measure import measure_together
    from seqsweep.sweep.run.asked import Asked
    from seqsweep.sweep.run.store import Folder
    from seqsweep.sweep.run.swept import Swept

    (folder / "campaign.toml").write_text(campaign_text(n_assembled, POINTS), "utf-8")
    plan, plant = planned(folder / "campaign.toml")
    first = list(islice(plan.batches(), TOGETHER))
    measure_together(plant, first[:1])  # code is loaded
    stepping_s = _timed_stretches()
    begin = time.process_time()
    results = measure_together(plant, first)
    measured_s, in_kernel_s = time.process_time() - begin, sum(stepping_s)
    shards = folder / "y.parquet.parts"
    shards.mkdir()
    store = Folder(shards)
    begin = time.process_time()
    for batch, result in zip(plan.batches(), cycle(results), strict=False):
        store.write(batch, result)
    kept_s = time.process_time() - begin
    packed, loose = _sizes(shards, "*.pack"), _sizes(shards, "?" * 64)
    begin = time.process_time()
    _write(write_table, Swept(plan, plant, store, Asked((plan,)).at, {}), folder / "y.parquet")
    assembled_s = time.process_time() - begin
    memory_mb = peak_memory_mb()
    # by itself: what is there many times over packs too well
    few = replace(plan, conditions=plan.conditions[:TOGETHER])
    _write(write_table, Swept(few, plant, store, Asked((few,)).at, {}), folder / "few.parquet")
    table_bytes = (folder / "few.parquet").stat().st_size
    foot = len(json.dumps(read_metadata(folder / "y.parquet"), separators=(",", ":")))
    return {
        "operating_points": n_assembled,
        "measure_s": measured_s / TOGETHER + kept_s / n_assembled,
        "kernel_s": in_kernel_s / TOGETHER,
        "keep_s": kept_s / n_assembled,
        "assemble_s": assembled_s / n_assembled,
        "loose_kb": float(np.mean(loose)) / 1e3,
        "packed_kb": sum(packed) / (n_assembled - len(loose)) / 1e3,
        "table_kb": table_bytes / TOGETHER / 1e3,
        "foot_b": foot / n_assembled,
        "memory_mb": memory_mb,
    }


def _timed_stretches() -> list[float]:
    """CPU time (s) of every further call of the kernel that steps shots."""
    from seqsweep.plant.under_way import LanesUnderWay

    found: list[float] = []
    stretch = LanesUnderWay._stretch

    def timed(self: Any, advance: Callable[..., None], *rest: Any) -> Any:
        def stepping(*arrays: Any) -> None:
            begin = time.process_time()
            advance(*arrays)
            found.append(time.process_time() - begin)

        return stretch(self, stepping, *rest)

    LanesUnderWay._stretch = timed  # type: ignore[method-assign]
    return found


def _write(write_table: Callable[..., None], swept: Any, path: Path) -> None:
    write_table(path, swept.responses(), swept.header())


def _sizes(folder: Path, names: str) -> list[int]:
    return [path.stat().st_size for path in folder.glob(names)]


if __name__ == "__main__":
    run_script("hundred_thousand", measure, child)
