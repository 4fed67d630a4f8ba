"""What the hosts of black boxes add to the cost of a box itself, and what a sweep of one takes.

    python benchmarks/host.py [--quick]

The boxes are those of the tests, built with the system's compiler: an R-L branch and a converter, as FMUs. Their own
cost is a loop in C over the same functions. Figures are CPU time, so that neighbours on the machine matter less.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import ROOT, Report, run_script

sys.path.insert(0, str(ROOT))

HOST_NS = 300.0
SWEEP_S = 20.0
CAMPAIGN = """\
[campaign]
name = "box"
[plant]
id = "fmu:{fmu}"
[plant.parameters]
{parameters}
[[operating_point]]
id = "a"
active_power_mw = 0.4
terminal_voltage_pu = 1.0
[sweep]
f_min_hz = 1.0
f_max_hz = 1000.0
points = 100
[injection]
amplitude_pu = 0.001
"""


def measure(quick: bool) -> Report:
    """Steps alone, by the hosts, and a whole sweep."""
    report = Report("Hosts of black boxes")
    with tempfile.TemporaryDirectory() as folder:
        for name, defines in (("R-L branch", ("STATE",)), ("converter", ("CONVERTER", "STATE"))):
            _steps(report, Path(folder), name, defines, 200_000 if quick else 1_000_000)
        for name, defines in (("its own state", ("CONVERTER", "STATE")), ("a fork", ("CONVERTER",))):
            _sweep(report, Path(folder), name, defines)
    return report


def _steps(report: Report, folder: Path, name: str, defines: tuple[str, ...], n: int) -> None:
    from tests.fmus import PARAMETERS, fmu, library

    from seqsweep.plant.fmu.device import fmu_plant
    from seqsweep.plant.space_vectors import abc_of

    path = fmu(folder, *defines)
    alone = _alone_ns(folder, library(str(folder), defines), n)
    v = 563.0 * np.exp(2j * np.pi * 50.0 * 50e-6 * np.arange(n))
    plant: Any = fmu_plant(str(path), **PARAMETERS)
    box = plant._branches._build()
    box.start(_point())
    u = abc_of(v)
    hosted = _best_ns(lambda: box._through(u), n)
    whole = _best_ns(lambda: box.advance(v), n)
    report.add(f"{name}: the FMU's own step, driven from C", alone, "ns")
    report.add(f"{name}: compiled loop over its functions, above that", hosted - alone, "ns", HOST_NS)
    report.add(f"{name}: the same with space vectors in and out, above that", whole - alone, "ns", HOST_NS)
    report.add(
        f"{name}: a loop in Python over fmpy, above that", _fmpy_ns(box._instance._slave, u[:20_000]) - alone, "ns"
    )


def _point() -> Any:
    from seqsweep.plant.protocol import OperatingPoint

    return OperatingPoint(0.4e6, 690.0)


def _best_ns(what: Callable[[], object], n: int) -> float:
    best = float("inf")
    for _ in range(5):
        begin = time.process_time()
        what()
        best = min(best, time.process_time() - begin)
    return best / n * 1e9


def _alone_ns(folder: Path, box: Path, n: int) -> float:
    from tests.fmus import compiler

    cc, headers = compiler()
    driver, source = folder / "drive", ROOT / "tests" / "boxes" / "drive_fmu.c"
    subprocess.run([cc, "-O2", f"-I{headers}", "-o", driver, source, "-ldl", "-lm"], check=True)
    runs = [subprocess.run([driver, box, str(n)], check=True, capture_output=True, text=True) for _ in range(5)]
    return min(float(run.stdout.split()[0]) for run in runs)


def _fmpy_ns(slave: Any, u: np.ndarray) -> float:
    def loop() -> None:
        for k, row in enumerate(u):
            slave.setReal([0, 1, 2], row)
            slave.doStep(k * 50e-6, 50e-6)
            slave.getReal([3, 4, 5])

    return _best_ns(loop, len(u))


def _sweep(report: Report, folder: Path, name: str, defines: tuple[str, ...]) -> None:
    """The whole command, 100 points, two workers; and the CPU time of the same sweep by one worker alone."""
    from tests.fmus import PARAMETERS, fmu

    campaign, table, path = folder / "campaign.toml", folder / "y.parquet", fmu(folder, *defines)
    parameters = "\n".join(f"{key} = {json.dumps(value)}" for key, value in PARAMETERS.items())
    campaign.write_text(CAMPAIGN.format(fmu=path, parameters=parameters))
    seqsweep = Path(sys.executable).with_name("seqsweep")
    begin = time.perf_counter()
    subprocess.run(
        [seqsweep, "run", campaign, "-o", table, "--force", "--jobs", "2"], check=True, stderr=subprocess.DEVNULL
    )
    wall = time.perf_counter() - begin
    report.add(f"100 points of the converter branched by {name}, two workers: wall", wall, "s", SWEEP_S)
    report.add(
        "the same, CPU time of one worker and its forks without its start, for 100 points", _cpu_s(campaign, path), "s"
    )


def _cpu_s(campaign: Path, path: Path) -> float:
    """CPU time (s) of every batch in this process, that of nursery and forks included."""
    from tests.commands import family_s
    from tests.fmus import PARAMETERS

    from seqsweep.plant.fmu.device import fmu_plant
    from seqsweep.sweep.config.sections import load_config
    from seqsweep.sweep.measure.measure import measure
    from seqsweep.sweep.planning import make_plan

    plant: Any = fmu_plant(str(path), **PARAMETERS)
    plan = make_plan(load_config(campaign), plant)
    begin = time.process_time()
    for batch in plan.batches():
        measure(plant, batch)
    own = time.process_time() - begin
    nursery = getattr(plant._branches, "_nursery", None)
    return own + (family_s(nursery[0].pid) if nursery else 0.0)


if __name__ == "__main__":
    run_script("host", measure)
