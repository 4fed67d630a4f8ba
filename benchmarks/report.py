"""Time and size of a report: of the paper's case, and of a bank of many operating points on many grids.

    python benchmarks/report.py --points 1000 --grids 400

The paper's case is the turbine behind three lines (`examples/weak_grid.toml`): swept, decided, confirmed, followed in
time and measured by its metrics; the report of all that is timed, process and imports included, not what it rests on.
In the bank the admittance is that of an R-L branch and the verdicts are drawn by lot.
Bars: 5 s and 3 MB for the case, 30 s for 1,000 operating points on 400 grids.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.bank.table import write_judge
from seqsweep.tuning.bank.judgement import PairVerdict

COMMAND = Path(sys.executable).with_name("seqsweep")


def table(path: Path, n_points: int, n_rows: int) -> None:
    """A table of ``n_points`` operating points of a branch."""
    f = np.geomspace(1.0, 1000.0, n_rows)
    one = 1.0 / (0.01 + 2j * np.pi * f * 1e-4)
    y = one[:, None, None] * np.eye(2)
    covariance = np.broadcast_to(1e-8 * np.eye(8), (n_rows, 8, 8))
    responses = [
        FrequencyResponse(f, y * (1.0 + 1e-3 * k), 50.0, covariance=covariance, meta=_meta(k)) for k in range(n_points)
    ]
    write_table(path, responses, {
        "tool": {"name": "benchmark", "version": "1"}, "plant": {"id": "branch"}, "configuration": {},
        "configuration_sha256": "0" * 64, "power_meaning": "at the terminals",
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1e6},
        "operating_points": [_meta(k) for k in range(n_points)], "f1_hz": 50.0,
    })  # fmt: skip


def _meta(k: int) -> dict[str, object]:
    return {"op_id": f"p{k:04d}", "active_power_mw": 1e-3 * k, "terminal_voltage_pu": 1.0}


def bank(path: Path, n_points: int, n_grids: int) -> None:
    """Verdicts by lot, of which some per cent are unstable."""
    random = np.random.default_rng(1)
    re = random.normal(-20.0, 10.0, (n_points, n_grids))
    pairs = [
        PairVerdict(
            grid_id=f"g{g:03d}", op_id=f"p{p:04d}", status="ok", verdict="unstable" if re[p, g] > 0.0 else "stable",
            probability=float(re[p, g] <= 0.0), reason="", grid="", r_ohm=0.01, x_ohm=0.1, n_unstable=0, margin_m=1.2,
            re_rad_s=float(re[p, g]), im_rad_s=200.0, re_std_rad_s=0.1, damping=float(-re[p, g] / 200.0),
            critical_scale=1.5, missing_hz=None, elements=(), parameters={}, warnings=(),
        )
        for p in range(n_points)
        for g in range(n_grids)
    ]  # fmt: skip
    write_judge(pairs, 50.0, path, {"grids": n_grids})


def paper_case(folder: Path) -> list[str]:
    """Files of the turbine behind three lines, made by the commands that a reader of the tutorial types."""
    example = Path(__file__).parents[1] / "examples" / "weak_grid.toml"
    for line in (
        f"run {example} -o y.parquet",
        "tune y.parquet --grid own --op line-1.4 --confirm -o tuning.json",
        "verify tuning.json -o verify.json",
        "metrics y.parquet -o metrics.json",
    ):
        subprocess.run([COMMAND, *line.split(), "--quiet"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return ["y.parquet", "tuning.json", "verify.json", "metrics.json"]


def many(folder: Path, n_points: int, n_grids: int, n_rows: int) -> list[str]:
    """Files of many operating points on a bank."""
    table(folder / "many.parquet", n_points, n_rows)
    bank(folder / "judge.parquet", n_points, n_grids)
    return ["many.parquet", "judge.parquet"]


def timed(folder: Path, inputs: Sequence[str], what: str) -> None:
    """Make the report once, and say how long that took and how large it is."""
    begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([COMMAND, "report", *inputs, "-o", "r.html", "--force", "--quiet"], cwd=folder, check=True)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    size = (folder / "r.html").stat().st_size / 1e6
    print(f"{what}: {wall:.1f} s, {cpu:.1f} s of CPU, {size:.2f} MB", flush=True)


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--points", type=int, default=1000)
    asked.add_argument("--grids", type=int, default=400)
    asked.add_argument("--rows", type=int, default=100)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        timed(folder, paper_case(folder), "report of the paper's case")
        if given.points * given.grids:
            inputs = many(folder, given.points, given.grids, given.rows)
            timed(folder, inputs, f"report of {given.points} operating points on {given.grids} grids")
    return 0


if __name__ == "__main__":
    sys.exit(main())
