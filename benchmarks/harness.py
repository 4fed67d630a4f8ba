"""What the benchmarks share: figures with their bars, fresh processes, one report.

A benchmark is a script: ``python benchmarks/kernel.py [--quick]`` prints its table and keeps the same
figures in ``build/benchmarks/kernel.json``, from which `run_all` writes the page and the plot.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "build" / "benchmarks"
TABLE_I = ROOT / "examples" / "table1.toml"

FIGURES = "<!-- figures: make evidence -->", "<!-- end of figures -->"
"""Comments of a page between which a heavy trial writes what it found."""


@dataclass(frozen=True)
class Figure:
    """One measured number; ``bar`` is what it must not exceed (or reach, where ``at_least``)."""

    what: str
    value: float
    unit: str
    bar: float | None = None
    at_least: bool = False

    @property
    def verdict(self) -> str:
        if self.bar is None:
            return ""
        met = self.value >= self.bar if self.at_least else self.value <= self.bar
        return "met" if met else f"MISSED, {self.value / self.bar:.2f} of the bar"


@dataclass
class Report:
    """Figures of one benchmark, and series for the plot."""

    title: str
    figures: list[Figure] = field(default_factory=list)
    series: dict[str, Any] = field(default_factory=dict)

    def add(self, what: str, value: float, unit: str, bar: float | None = None, at_least: bool = False) -> None:
        self.figures.append(Figure(what, float(value), unit, bar, at_least))

    def table(self) -> str:
        """The figures as a Markdown table."""
        rows = [(f.what, f"{f.value:.3g} {f.unit}".strip(), _bar(f), f.verdict) for f in self.figures]
        head = ("measured", "value", "bar", "")
        return "\n".join(f"| {' | '.join(row)} |" for row in (head, ("---",) * 4, *rows))


def _bar(figure: Figure) -> str:
    return "" if figure.bar is None else f"{'>=' if figure.at_least else '<='} {figure.bar:g} {figure.unit}".strip()


def run_script(name: str, measure: Callable[[bool], Report], child: Callable[..., Any] | None = None) -> None:
    """The command line of a benchmark: print its table and keep its figures.

    With ``--child JSON`` the script does one measurement in a process of its own, for `fresh`.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and smaller sizes")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        assert child is not None
        print(json.dumps(child(**json.loads(arguments.child))))
        return
    load = os.getloadavg()[0]
    report = measure(arguments.quick)
    report.add("load average of the machine before it began", load, f"on {os.cpu_count()} cores")
    print(f"{report.title}\n\n{report.table()}")
    KEPT.mkdir(parents=True, exist_ok=True)
    kept = {"quick": arguments.quick, **asdict(report)}
    (KEPT / f"{name}.json").write_text(json.dumps(kept, indent=1), "utf-8")


def read_report(name: str) -> tuple[Report, bool]:
    """What `run_script` kept, and whether it was a quick run."""
    kept = json.loads((KEPT / f"{name}.json").read_text("utf-8"))
    return Report(kept["title"], [Figure(**f) for f in kept["figures"]], kept["series"]), kept["quick"]


def fresh(script: str, environment: Mapping[str, str] | None = None, **arguments: Any) -> Any:
    """The answer of ``script``'s child, from a process of its own."""
    command = [sys.executable, script, "--child", json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **(environment or {})})
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def without_avx512() -> dict[str, str] | None:
    """Numba's settings that make it compile as for the same processor with AVX2 alone; None if it has no AVX-512."""
    import llvmlite.binding as llvm

    host = llvm.get_host_cpu_features()
    if not host.get("avx512f"):
        return None
    kept = (f"{'-' if 'avx512' in name or 'avx10' in name or not on else '+'}{name}" for name, on in host.items())
    return {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": ",".join(kept)}


def seconds(function: Callable[[], object], repetitions: int, clock: Callable[[], float] = time.perf_counter) -> list:
    """Time of every repetition (s)."""
    found = []
    for _ in range(repetitions):
        begin = clock()
        function()
        found.append(clock() - begin)
    return found


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far (MB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def command(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[float, float, float]:
    """Wall time (s), peak memory (MB) and CPU time (s) of ``seqsweep ARGUMENTS``, a whole process."""
    program = [str(entry_point()), *arguments]
    begin = time.perf_counter()
    process = subprocess.Popen(
        program,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, **(environment or {})},
    )
    assert process.stderr is not None
    message = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall_s = time.perf_counter() - begin
    if process.returncode:
        raise SystemExit(f"{' '.join(program)} ended with {process.returncode}:\n{message.decode()}")
    return wall_s, usage.ru_maxrss / 1024.0, usage.ru_utime + usage.ru_stime


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Options of a benchmark that draws its cases: ``--seed``, ``--jobs``, ``--write`` and ``--check``."""
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="a new one unless given")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--write", action="store_true", help="rewrite the figures of the page")
    parser.add_argument("--check", action="store_true", help="end with 1 where a bar is missed")


def rewrite(page: Path, begin: str, end: str, text: str) -> None:
    """Put ``text`` between two comments of a page, in the place of what stands there."""
    before, rest = page.read_text("utf-8").split(begin)
    _, after = rest.split(end)
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", "utf-8")


def entry_point() -> Path:
    """The installed command of this interpreter's environment."""
    found = Path(sys.executable).with_name("seqsweep")
    if not found.exists():
        raise SystemExit(f"{found} is missing: install the project into this environment (make env)")
    return found


def table_1_plan(*settings: str) -> tuple[Any, Any]:
    """Plan and plant of ``examples/table1.toml``."""
    return planned(TABLE_I, *settings)


def planned(campaign: Path, *settings: str) -> tuple[Any, Any]:
    """Plan and plant of a campaign."""
    from seqsweep.plant.registry import make_plant
    from seqsweep.sweep.config.sections import load_config
    from seqsweep.sweep.planning import make_plan

    config = load_config(campaign, settings)
    plant = make_plant(config.plant.id, config.plant.parameters)
    return make_plan(config, plant), plant
