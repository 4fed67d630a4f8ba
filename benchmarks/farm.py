"""How long a farm takes: load flow and verdict over its size, and one operating point on many source impedances.

    python benchmarks/farm.py [--turbines 25 50 100] [--sources 400]

Turbines stand in strings of ten on cables, at six powers, each power swept once. Times are CPU seconds of one core;
the sweep and the fits of the six tables are told apart, as they do not grow with the farm.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from seqsweep.identify.table.read import read_table
from seqsweep.sweep.config.sections import load_config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import run
from seqsweep.sweep.run.host import plant_or_card
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.farm import judged
from seqsweep.tuning.farm.sources import judge_sources
from seqsweep.tuning.farm.units import Library

POWERS = Path(__file__).parents[1] / "examples" / "grids" / "powers.toml"
STRING = 10
CABLE = {"length_km": 0.8, "r_ohm_per_km": 0.13, "x_ohm_per_km": 0.119, "c_nf_per_km": 190.0}
TRANSFORMER = {"sn_mva": 2.0, "vn_hv_kv": 35.0, "vn_lv_kv": 0.69, "vk_percent": 6.0, "vkr_percent": 0.8}


def swept() -> Library:
    """The six powers of the example, swept."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "powers.parquet"
        config = load_config(POWERS, ())
        plant = plant_or_card(config)
        run(make_plan(config, plant), plant, path, jobs=2)
        table = read_table(path)
    return Library(lambda name: table)


def document(n: int, ops: tuple[str, ...]) -> dict[str, Any]:
    """A farm of n turbines in strings of ten."""
    farm: dict[str, Any] = {
        "bus": [{"name": "pcc", "voltage_kv": 35.0}],
        "source": [{"bus": "pcc", "s_sc_mva": 2.6 * n, "r_over_x": 0.05}],
        "cable": [],
        "transformer": [],
        "device": [],
    }
    for k in range(n):
        before = "pcc" if k % STRING == 0 else f"m{k - 1}"
        farm["bus"] += [{"name": f"m{k}", "voltage_kv": 35.0}, {"name": f"t{k}", "voltage_kv": 0.69}]
        farm["cable"].append({"name": f"c{k}", "from": before, "to": f"m{k}", **CABLE})
        farm["transformer"].append({"name": f"x{k}", "from": f"t{k}", "to": f"m{k}", **TRANSFORMER})
        farm["device"].append({"name": f"wt{k}", "bus": f"t{k}", "table": "powers", "op": ops[k % len(ops)]})
    return farm


def timed(what: Callable[[], Any]) -> tuple[Any, float]:
    """A value and the CPU time (s) that it took."""
    begun = time.process_time()
    value = what()
    return value, time.process_time() - begun


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turbines", type=int, nargs="+", default=[25, 50, 100])
    parser.add_argument("--sources", type=int, default=400)
    asked = parser.parse_args()
    library, seconds = timed(swept)
    ops = tuple(library.table("powers").op_ids)
    print(f"sweep of {len(ops)} operating points: {seconds:.1f} s")
    _, seconds = timed(lambda: judged(farm_of(document(len(ops), ops)), library))
    print(f"their fits, and a farm of {len(ops)}: {seconds:.1f} s")
    for n in asked.turbines:
        farm, alone = timed(lambda n=n: judged(farm_of(document(n, ops)), library))
        z = farm.entry.source_z_ohm * np.linspace(0.5, 1.6, asked.sources)
        found, more = timed(lambda farm=farm, z=z: judge_sources(farm, z))
        kinds = [sum(one.verdict == kind for one in found) for kind in ("stable", "unstable", "undecided")]
        whole = sum(one.whole for one in found)
        print(
            f"{n} turbines: judged in {alone:.1f} s ({farm.judgement.verdict}); {asked.sources} sources in {more:.1f} s"
        )
        print(f"    {kinds[0]} stable, {kinds[1]} unstable, {kinds[2]} undecided, {whole} by the whole pencil")


if __name__ == "__main__":
    main()
