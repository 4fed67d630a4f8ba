"""What the hosts of black boxes add to the cost of a box itself, and what a sweep of one takes.

    python benchmarks/host.py [--quick]

The boxes are those of the tests, built with the system's compiler: an R-L branch and a converter, as FMUs, and the
controls of the reference turbine as a library in its circuit. Their own cost is a loop over the same functions. Figures
are CPU time, so that neighbours on the machine matter less; but for wall times, which need two quiet cores.
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
from harness import ROOT, Report, command, run_script

sys.path.insert(0, str(ROOT))

HOST_NS = 150.0
SWEEP_S = 10.0

OWN_NS, OWN_SWEEP_S = 200.0, 3.0
"""A controller that costs so much a step (ns) is to be swept at 100 points in so much wall time (s) on two cores."""

PRBS_CPU_S = 1.5
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
        _library(report, 200_000 if quick else 1_000_000)
        _sweeps_of_libraries(report, Path(folder), 3 if quick else 7)
    return report


def _steps(report: Report, folder: Path, name: str, defines: tuple[str, ...], n: int) -> None:
    from seqsweep.plant.fmu.device import fmu_plant
    from seqsweep.plant.space_vectors import abc_of
    from tests.support.fmus import PARAMETERS, fmu, library

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
    from tests.support.fmus import compiler

    cc, headers = compiler()
    driver, source = folder / "drive", ROOT / "tests" / "support" / "boxes" / "drive_fmu.c"
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
    from tests.support.fmus import PARAMETERS, fmu

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
    from seqsweep.plant.fmu.device import fmu_plant
    from seqsweep.sweep.config.sections import load_config
    from seqsweep.sweep.measure.measure import measure
    from seqsweep.sweep.planning import make_plan
    from tests.support.commands import family_s
    from tests.support.fmus import PARAMETERS

    plant: Any = fmu_plant(str(path), **PARAMETERS)
    plan = make_plan(load_config(campaign), plant)
    begin = time.process_time()
    for batch in plan.batches():
        measure(plant, batch)
    own = time.process_time() - begin
    nursery = getattr(plant._branches, "_nursery", None)
    return own + (family_s(nursery[0].pid) if nursery else 0.0)


# A library in the circuit


def _library(report: Report, n: int) -> None:
    """Steps of a library in the circuit above its own code, and what a stretch of a shot costs beside its steps."""
    from seqsweep.plant.protocol import Injection, Job, Source, Tone, Window
    from tests.support.controllers import build

    plant = _around(build())
    state = plant.settle(_point(), Source())
    jobs, windows = [Job(state, Injection("series_voltage", (Tone(77.0, 0.5),)))], [Window(77.0, 100)]
    own = _own_ns(plant, n)
    listening = _best_ns(lambda: plant.run_phasors(jobs, windows, 1000, n // 1000), n)
    recording = _best_ns(lambda: plant.run(jobs, n), n)
    stretch = _best_ns(lambda: [plant.run_phasors(jobs, windows, 1, 1) for _ in range(100)], 100)
    name = "library in the circuit"
    report.add(f"{name}: its own code, called from a loop", own, "ns")
    report.add(f"{name}: a step with circuit, ports and listening, above that", listening - own, "ns", HOST_NS)
    report.add(f"{name}: a step with circuit, ports and a record, above that", recording - own, "ns", HOST_NS)
    report.add(f"{name}: a stretch of a shot (15,000 steps in these sweeps), beside its steps", stretch / 1e3, "us")


def _around(library: Path) -> Any:
    from seqsweep.plant.greybox.turbine import GreyTurbine
    from tests.support.controllers import INPUTS, OUTPUTS

    return GreyTurbine(f"cigre:{library}", INPUTS, OUTPUTS)


def _own_ns(plant: Any, n: int) -> float:
    """Price (ns) of a call of the library's function alone."""
    from tests.support.controllers import alone_us

    controller = plant._core.controller
    function = controller.library.function("Model_Outputs")
    return 1e3 * min(alone_us(function, int(controller.addresses[1]), n) for _ in range(9))


def _operations(own_ns: float) -> int:
    """How many operations besides make a step of the library cost so much (ns)."""
    from tests.support.controllers import build

    few, many = 20, 220
    at_few, at_many = (_own_ns(_around(build(f"WORK={n}")), 100_000) for n in (few, many))
    return max(0, round(few + (own_ns - at_few) * (many - few) / (at_many - at_few)))


def _sweeps_of_libraries(report: Report, folder: Path, times: int) -> None:
    """Whole commands around libraries with two workers: 100 points by tones, and a PRBS."""
    from tests.support.controllers import build

    priced = f"WORK={_operations(OWN_NS)}"
    for step_us in (20, 50):
        library = build(priced, f"SAMPLE_TIME_S={step_us}e-6")
        wall, cpu = _command_s(folder, library, "tone", times)
        what = f"100 points of a library of {_own_ns(_around(library), 100_000):.0f} ns a step of {step_us} us"
        report.add(f"{what}, two workers: wall, best of {times}", wall, "s", OWN_SWEEP_S)
        report.add("the same, CPU time of the whole command, least", cpu, "s")
    wall, cpu = _command_s(folder, build(), "prbs", times)
    report.add(f"75 points of the library by a PRBS: wall, best of {times}", wall, "s")
    report.add("the same, CPU time of the whole command, least", cpu, "s", PRBS_CPU_S)


def _command_s(folder: Path, library: Path, signal: str, times: int) -> tuple[float, float]:
    """Least wall and CPU time (s) of `seqsweep run`, the example's campaign around ``library``."""
    campaign = folder / f"{library.stem}-{signal}.toml"
    text = (ROOT / "examples" / "cigre.toml").read_text("utf-8")
    text = text.replace("cigre:turbine_controller.so", f"cigre:{library}")
    campaign.write_text(text + f'\n[injection]\nsignal = "{signal}"\n', "utf-8")
    words = ["run", str(campaign), "-o", str(folder / "y.parquet"), "--force", "--jobs", "2"]
    runs = [command(words) for _ in range(times)]
    return min(wall for wall, _, _ in runs), min(cpu for _, _, cpu in runs)


if __name__ == "__main__":
    run_script("host", measure)
