"""How long a bank takes: one device on many grids of elements, many tables fitted, and the memory it needs.

    python benchmarks/bank.py [--grids 400] [--points 1] [--tables 400]

Times are CPU seconds of one core.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from seqsweep.identify.fit.model import MIN_POINTS
from seqsweep.sweep.config.sections import load_config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import run
from seqsweep.sweep.run.host import plant_or_card
from seqsweep.tuning.bank.entries import bank_of
from seqsweep.tuning.bank.judgement import judge_pair
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.scalar_fit import fit_impedance
from seqsweep.tuning.tune import fitted

EXAMPLES = Path(__file__).parents[1] / "examples" / "grids"
ROWS = 100


def swept(folder: Path) -> Path:
    """The table of the six powers of the example."""
    output = folder / "powers.parquet"
    config = load_config(EXAMPLES / "powers.toml", ())
    plant = plant_or_card(config)
    run(make_plan(config, plant), plant, output, jobs=2)
    return output


def judged(table: Path, n_grids: int, n_points: int) -> None:
    """Time the pairs; operating points beyond the six of the table are judged over again."""
    from seqsweep.identify.table.read import read_table

    content = read_table(table)
    entries = bank_of(EXAMPLES / "family.toml")
    entries = [entries[k % len(entries)] for k in range(n_grids)]
    begin = time.process_time()
    for k in range(n_points):
        device = fitted(content.responses[k % len(content.responses)])
        for entry in entries:
            judge_pair(device, entry, content.meta.get("bases", {}))
    spent, pairs = time.process_time() - begin, n_points * n_grids
    print(f"{n_points} operating points on {n_grids} grids: {spent:.1f} s, {1e3 * spent / pairs:.1f} ms per pair")


def tabulated(n_tables: int, noise: float) -> None:
    """Time the fits of tables of the family's grids."""
    rng, f_hz = np.random.default_rng(1), np.geomspace(1.0, 2500.0, max(ROWS, MIN_POINTS))
    documents = [entry.document for entry in bank_of(EXAMPLES / "family.toml")]
    spent = 0.0
    for k in range(n_tables):
        z = elements_grid(documents[k % len(documents)] or {}, 50.0).impedance(2j * np.pi * f_hz)
        error = noise / np.sqrt(2.0) * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z)))
        begin = time.process_time()
        fit_impedance(f_hz, z * (1.0 + error), 50.0, std=noise * np.abs(z) if noise else None)
        spent += time.process_time() - begin
    print(f"{n_tables} tables of {ROWS} rows, noise {noise:.1%}: {spent:.1f} s")


def main() -> None:
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grids", type=int, default=400)
    parser.add_argument("--points", type=int, default=1)
    parser.add_argument("--tables", type=int, default=400)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        judged(swept(Path(folder)), given.grids, given.points)
    tabulated(given.tables, 0.0)
    tabulated(given.tables, 1e-3)
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0:.0f} MB")


if __name__ == "__main__":
    main()
