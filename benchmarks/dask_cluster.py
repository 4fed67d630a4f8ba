"""A dask cluster whose scheduler and workers are processes of their own: efficiency, and what a batch costs besides.

    python benchmarks/dask_cluster.py [--quick]

The same campaign goes to a cluster of one worker and to one of two, in turns. What the scheduler costs is the time of
batches whose work is nothing, one after the other through the same way as a campaign's.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from harness import Report, planned, run_script
from thousand import campaign_text

BAR = 0.9
WAIT_S = 60.0
BATCHES = 400


def measure(quick: bool) -> Report:
    """Wall times of one and two workers, and of batches without work."""
    from seqsweep.sweep.run.campaign import run

    n, times = (12, 2) if quick else (48, 3)
    report = Report(f"dask, scheduler and workers as processes: {n} operating points x 100 frequencies")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "campaign.toml").write_text(campaign_text(n, 100), "utf-8")
        plan, plant = planned(folder / "campaign.toml")
        with cluster(folder / "one", 1) as one, cluster(folder / "two", 2) as two:
            spent: dict[int, list[float]] = {1: [], 2: []}
            for _ in range(1 + times):  # the first round loads code
                for jobs, address in ((1, one), (2, two)):
                    begin = time.perf_counter()
                    run(plan, plant, folder / "y.parquet", jobs=jobs, backend="dask", scheduler=address)
                    spent[jobs].append(time.perf_counter() - begin)
            idle_s = _idle_s(two)
    alone, both = (median(spent[jobs][1:]) for jobs in (1, 2))
    report.add("one worker", alone, "s")
    report.add("two workers", both, "s")
    report.add("efficiency from one to two workers", alone / both / 2.0, "", BAR, at_least=True)
    report.add(f"a batch without work, two workers, mean of {BATCHES}", 1e3 * idle_s, "ms")
    return report


def _idle_s(address: str) -> float:
    """Wall time (s) of a batch whose work is nothing."""
    from seqsweep.sweep.run import workers

    with workers._dask_client(2, address) as client:
        list(workers._on_cluster(client, nothing, 2, ([k] for k in range(10))))  # type: ignore[arg-type]
        begin = time.perf_counter()
        list(workers._on_cluster(client, nothing, 2, ([k] for k in range(BATCHES))))  # type: ignore[arg-type]
        return (time.perf_counter() - begin) / BATCHES


def nothing(bundle: list[Any]) -> list[tuple[str, Any]]:
    """The work of a worker that has none."""
    return [(str(batch), batch) for batch in bundle]


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[str]:
    """Address of a scheduler with so many workers of one thread each, all of them processes."""
    folder.mkdir()
    address = folder / "address.json"
    options = ["--no-dashboard", "--scheduler-file", str(address)]
    quiet: dict[str, Any] = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    at_any_port = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    processes = [subprocess.Popen([sys.executable, "-m", *at_any_port, *options], **quiet)]
    try:
        found = _address(address)
        for _ in range(n_workers):
            worker = ["distributed.cli.dask_worker", "--nthreads", "1", *options]
            processes.append(subprocess.Popen([sys.executable, "-m", *worker], **quiet))
        yield found
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _address(path: Path) -> str:
    """From the file that the scheduler writes, once it is whole."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        try:
            return str(json.loads(path.read_text("utf-8"))["address"])
        except (OSError, ValueError):
            time.sleep(0.1)
    raise SystemExit(f"no dask scheduler after {WAIT_S:g} s")


if __name__ == "__main__":
    run_script("dask_cluster", measure)
