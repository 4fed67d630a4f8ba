"""The whole command: `seqsweep run examples/table1.toml` warm and for the first time ever, `--help`, memory.

"First ever" has an empty NUMBA_CACHE_DIR: every kernel is compiled. Python keeps byte code as for an installed wheel,
whatever PYTHONDONTWRITEBYTECODE says here: without it every process compiles our sources, a sixth of `run`. The ratios
are of CPU times, taken in alternation with a bare ``import numpy, numba, pyarrow``: they hold on a busy machine too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from harness import TABLE_I, Report, command, run_script

BARS = {"run": 2.0}

BROADBAND = ("multisine", "prbs", "qrb", "chirp")


def measure(quick: bool) -> Report:
    """Wall times and memory of whole processes."""
    warm_times, cold_times = (3, 1) if quick else (11, 3)
    report = Report("Whole processes")
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(Path(folder) / "byte code")}
        output = str(Path(folder) / "y.parquet")
        arguments = ["run", str(TABLE_I), "-o", output, "--force", "--jobs", "2"]
        cold = []
        for k in range(1 + cold_times):
            cache = {"NUMBA_CACHE_DIR": str(Path(folder) / f"cache{k}")}
            cold.append(command(arguments, cache))
        del cold[0]  # it wrote the byte code, which a wheel has once it is installed
        warm = [command(arguments, cache) for _ in range(warm_times)]
        by_signal = {signal: _best_s(_campaign(Path(folder), signal), output, warm_times) for signal in BROADBAND}
        shown = [command(["show", output]) for _ in range(warm_times)]
        helped = [command(["--help"]) for _ in range(warm_times)]
        ratios = _ratios(warm_times)
    report.add(f"run, warm, median of {warm_times}", median(t for t, _, _ in warm), "s", 0.7)
    report.add("run, warm, best", min(t for t, _, _ in warm), "s")
    report.add("run, warm, CPU time of both workers, median", median(cpu for _, _, cpu in warm), "s")
    for signal, best_s in by_signal.items():
        report.add(f"run, warm, best, with signal = {signal}", best_s, "s")
    report.add(f"run, first ever, median of {cold_times}", median(t for t, _, _ in cold), "s", 6.0)
    report.add("run, first ever, CPU time of both workers, median", median(cpu for _, _, cpu in cold), "s")
    report.add("--help, median", median(t for t, _, _ in helped), "s", 0.35)
    report.add("show, median", median(t for t, _, _ in shown), "s")
    for name, ratio in ratios.items():
        report.add(f"{name}, over a bare import of numpy, numba and pyarrow", ratio, "", BARS.get(name))
    report.add("peak memory of run, warm", max(m for _, m, _ in warm), "MB", 300.0)
    report.add("peak memory of run, first ever", max(m for _, m, _ in cold), "MB", 300.0)
    return report


def _ratios(times: int) -> dict[str, float]:
    """CPU times of whole commands over that of the bare import, medians of processes in turns."""
    with tempfile.TemporaryDirectory() as folder:
        table = str(Path(folder) / "y.parquet")
        commands = {
            "run": ["run", str(TABLE_I), "-o", table, "--force", "--jobs", "2"],
            "show": ["show", table],
            "tune": ["tune", table, "--grid", "0.012+0.25j"],
        }
        spent: dict[str, list[float]] = {name: [] for name in ("bare", *commands)}
        for _ in range(1 + times):
            spent["bare"].append(_bare_s())
            for name, arguments in commands.items():
                spent[name].append(command(arguments)[2])
    bare = median(spent["bare"][1:])  # the first round writes byte code
    return {name: median(spent[name][1:]) / bare for name in commands}


def _bare_s() -> float:
    """CPU time (s) of a process that only imports."""
    process = subprocess.Popen([sys.executable, "-c", "import numpy, numba, pyarrow"])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


def _campaign(folder: Path, signal: str) -> str:
    """The campaign of Table I with another signal, at 0.01 pu."""
    path = folder / f"{signal}.toml"
    text = TABLE_I.read_text("utf-8").replace('signal = "tone"', f'signal = "{signal}"')
    path.write_text(text.replace("amplitude_pu = 0.0005", "amplitude_pu = 0.01"), "utf-8")
    return str(path)


def _best_s(campaign: str, output: str, times: int) -> float:
    """Wall time (s) of the whole command, the best of ``times``."""
    return min(command(["run", campaign, "-o", output, "--force", "--jobs", "2"])[0] for _ in range(times))


if __name__ == "__main__":
    run_script("process", measure)
