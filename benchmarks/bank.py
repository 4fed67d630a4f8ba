"""How long a bank takes: many operating points on 400 grids of elements, killed and resumed, many tables fitted.

    python benchmarks/bank.py [--grids 400] [--points 1] [--tables 400]

Times are CPU seconds of one core. Operating points beyond the six of the example's table are those again under other
names. What 1,000 operating points take is predicted from the last ones judged; it is not measured.
"""

from __future__ import annotations

import argparse
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from seqsweep.identify.fit.model import MIN_POINTS
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.read import Table, read_table
from seqsweep.sweep.bank.judge import Report, judge_bank
from seqsweep.sweep.bank.table import write_judge
from seqsweep.sweep.config.sections import load_config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import shards
from seqsweep.sweep.run.campaign import run
from seqsweep.sweep.run.host import plant_or_card
from seqsweep.tuning.bank.entries import BankEntry, bank_of
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.scalar_fit import fit_impedance

EXAMPLES = Path(__file__).parents[1] / "examples" / "grids"
FAMILY = EXAMPLES / "family.toml"
ROWS = 100
PREDICTED = 1000


def swept(folder: Path) -> Path:
    """The table of the six powers of the example."""
    output = folder / "powers.parquet"
    config = load_config(EXAMPLES / "powers.toml", ())
    plant = plant_or_card(config)
    run(make_plan(config, plant), plant, output, jobs=2)
    return output


def judged(table: Table, n_grids: int, n_points: int, folder: Path) -> None:
    """Time and memory of the pairs, kept and written as the command does."""
    entries = bank_of(FAMILY)
    entries = tuple(replace(entries[k % len(entries)], grid_id=f"{k:05d}") for k in range(n_grids))
    responses = [_again(table.responses[k % len(table.responses)], k) for k in range(n_points)]
    _judge(responses[:1], table, entries[:10], folder / "first.parquet")  # imports and compilation are not the bank's
    memory_mb, begin = [_resident_mb()], time.process_time()
    _judge(responses, table, entries, folder / "judge.parquet", lambda done, total: memory_mb.append(_resident_mb()))
    spent, pairs = time.process_time() - begin, n_points * n_grids
    middle = len(memory_mb) // 2
    grown, written_mb = 2.0 * (memory_mb[-1] - memory_mb[middle]), _resident_mb()
    print(
        f"{n_points} x {n_grids}: {spent:.1f} s of CPU, {1e3 * spent / pairs:.1f} ms a pair; memory {memory_mb[0]:.1f} "
        f"MB at the beginning, {memory_mb[middle]:.1f} half way, {memory_mb[-1]:.1f} at the end, {written_mb:.1f} when "
        f"written: {1e6 * grown / pairs:.0f} bytes a pair in the second half"
    )
    print(
        f"predicted: {PREDICTED} x {n_grids} in {spent / pairs * PREDICTED * n_grids / 3600.0:.1f} h of one core, "
        f"{written_mb + grown / pairs * PREDICTED * n_grids:.0f} MB"
    )


def _again(response: FrequencyResponse, number: int) -> FrequencyResponse:
    return replace(response, meta={**dict(response.meta), "op_id": f"p{number:04d}"})


def _judge(
    responses: Sequence[FrequencyResponse],
    table: Table,
    entries: Sequence[BankEntry],
    output: Path,
    report: Report = lambda done, total: None,
) -> None:
    bases, common = table.meta.get("bases", {}), {"output": output, "jobs": 1, "elements": 0}
    verdicts = judge_bank(responses, bases, "benchmark", entries, report=report, **common)
    write_judge(verdicts, responses[0].f1_hz, output, {})


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def killed(table: Path, folder: Path) -> None:
    """The command ended by SIGKILL in the middle, and called again: the same bytes as without."""
    whole, broken = folder / "whole.parquet", folder / "broken.parquet"
    program = Path(sys.executable).with_name("seqsweep")
    command = [program, "judge", table, "--grids", FAMILY, "--jobs", "1", "--op", "0.60MW"]
    begin = time.monotonic()
    subprocess.run([*command, "-o", whole], check=True, capture_output=True)
    whole_s = time.monotonic() - begin
    process = subprocess.Popen([*command, "-o", broken], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    folder = shards.folder_of(broken)
    while not folder.exists() or len(shards.keys(folder)) < 6:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept, begin = len(shards.keys(folder)), time.monotonic()
    subprocess.run([*command, "-o", broken], check=True, capture_output=True)
    same = whole.read_bytes() == broken.read_bytes()
    print(
        f"killed with {kept} of 16 shards kept: finished in {time.monotonic() - begin:.0f} s (whole: {whole_s:.0f} s), "
        f"{'the same bytes' if same else 'OTHER BYTES'}"
    )


def tabulated(n_tables: int, noise: float) -> None:
    """Time the fits of tables of the family's grids."""
    rng, f_hz = np.random.default_rng(1), np.geomspace(1.0, 2500.0, max(ROWS, MIN_POINTS))
    documents = [entry.document for entry in bank_of(FAMILY)]
    spent = 0.0
    for k in range(n_tables):
        z = elements_grid(documents[k % len(documents)] or {}, 50.0).impedance(2j * np.pi * f_hz)
        error = noise / np.sqrt(2.0) * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z)))
        begin = time.process_time()
        fit_impedance(f_hz, z * (1.0 + error), 50.0, std=noise * np.abs(z) if noise else None)
        spent += time.process_time() - begin
    print(f"{n_tables} tables of {ROWS} rows, noise {noise:.1%}: {spent:.1f} s of CPU")


def main() -> None:
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grids", type=int, default=400)
    parser.add_argument("--points", type=int, default=1)
    parser.add_argument("--tables", type=int, default=400)
    parser.add_argument("--kill", action="store_true", help="also end the command in the middle and go on")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table = swept(folder)
        judged(read_table(table), given.grids, given.points, folder)
        if given.kill:
            killed(table, folder)
    tabulated(given.tables, 0.0)
    tabulated(given.tables, 1e-3)


if __name__ == "__main__":
    main()
