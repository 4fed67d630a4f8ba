"""The big campaign: 1,000 operating points (40 powers x 25 voltages) x 100 frequencies, the whole command.

    python benchmarks/thousand.py                       measures plan, run, memory
    python benchmarks/thousand.py --write thousand.toml [--operating-points 1000] [--points 100]

The second form only writes the campaign, to be run by hand: ``seqsweep run thousand.toml -o y.parquet``.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from harness import Report, command, entry_point, run_script

MEMORY_BAR_MB = 600.0
PLAN_BAR = 1.3
OPERATING_POINT_BAR_S = 0.06
"""Wall time of an operating point: a minute for a thousand."""


def campaign_text(operating_points: int, points: int) -> str:
    """A campaign over a grid of active power and |v_pcc|."""
    n_powers = next(n for n in range(ceil(sqrt(1.6 * operating_points)), 0, -1) if operating_points % n == 0)
    powers = np.linspace(0.2, 1.3, n_powers)
    voltages = np.linspace(0.9, 1.1, operating_points // n_powers)
    sections = [
        f"[[operating_point]]\nactive_power_mw = {power:.6g}\nterminal_voltage_pu = {voltage:.6g}\n"
        for power in powers
        for voltage in voltages
    ]
    return "\n".join(
        [
            f'[campaign]\nname = "{operating_points} operating points"\n\n[plant]\nid = "dpmsg-v1"\n',
            *sections,
            f"[sweep]\nf_min_hz = 1.0\nf_max_hz = 1000.0\npoints = {points}\n",
            '[injection]\nkind = "series_voltage"\nsignal = "tone"\namplitude_pu = 0.001\n',
            '[source]\nkind = "ideal"\n',
        ]
    )


def measure(quick: bool) -> Report:
    """Predicted and measured wall time and the memory of the command."""
    operating_points = 100 if quick else 1000
    report = Report(f"The whole command: {operating_points} operating points x 100 frequencies, two workers")
    with tempfile.TemporaryDirectory() as folder:
        campaign, output = Path(folder) / "campaign.toml", Path(folder) / "y.parquet"
        campaign.write_text(campaign_text(operating_points, 100), "utf-8")
        predicted_s = predicted(campaign)
        wall_s, memory_mb, cpu_s = command(["run", str(campaign), "-o", str(output), "--jobs", "2"])
        report.add("wall time that `plan` predicts", predicted_s, "s")
        report.add("wall time of `run`", wall_s, "s", operating_points * OPERATING_POINT_BAR_S)
        report.add("CPU time of `run`, both workers", cpu_s, "s")
        off = max(wall_s / predicted_s, predicted_s / wall_s)
        report.add("`run` over prediction, or its inverse", off, "", PLAN_BAR)
        report.add("peak memory of `run`", memory_mb, "MB", MEMORY_BAR_MB)
        report.add("size of the table", output.stat().st_size / 1e6, "MB")
        report.add("points per second", operating_points * 100 / wall_s, "1/s")
    return report


def predicted(campaign: Path, jobs: int = 2) -> float:
    """Wall time (s) that ``seqsweep plan`` prints."""
    arguments = [str(entry_point()), "plan", str(campaign), "--jobs", str(jobs)]
    text = subprocess.run(arguments, capture_output=True, text=True, check=True).stdout
    found = re.search(r"about ([\d.e+]+) s with", text)
    assert found, text[-500:]
    return float(found[1])


if __name__ == "__main__":
    if "--write" in sys.argv:
        parser = argparse.ArgumentParser()
        parser.add_argument("--write", type=Path)
        parser.add_argument("--operating-points", type=int, default=1000)
        parser.add_argument("--points", type=int, default=100)
        given = parser.parse_args()
        given.write.write_text(campaign_text(given.operating_points, given.points), "utf-8")
    else:
        run_script("thousand", measure)
