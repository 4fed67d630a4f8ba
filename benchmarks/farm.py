"""How long a farm takes: load flow and verdict over its size, and one operating point on many source impedances.

    python benchmarks/farm.py [--turbines 25 50 100] [--sources 400] [--grids 400]

Turbines stand in strings of ten on cables, at six powers, each power swept once. Times are CPU seconds of one core,
without the sweeps; the fits of the six tables are told apart, as they do not grow with the farm. Under "a load flow on
each" every turbine has a power of its own, the load flow is solved anew on every grid, and every turbine's admittance
comes from the surrogate of a swept region at its own P, Q and |v| there; every fourth grid has a shunt capacitor.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import ROOT, command

from seqsweep.identify.table.read import read_table
from seqsweep.sweep.bank.following import FarmFollowing
from seqsweep.sweep.bank.judge import judge_bank
from seqsweep.tuning.bank.entries import BankEntry
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.farm import judged
from seqsweep.tuning.farm.on_grids import farm_on_grids
from seqsweep.tuning.farm.sources import judge_sources
from seqsweep.tuning.farm.units import Library

EXAMPLES = ROOT / "examples"
POWERS = EXAMPLES / "grids" / "powers.toml"
REGION = EXAMPLES / "farm" / "turbine.toml"
STRING = 10
CABLE = {"length_km": 0.8, "r_ohm_per_km": 0.13, "x_ohm_per_km": 0.119, "c_nf_per_km": 190.0}
TRANSFORMER = {"sn_mva": 2.0, "vn_hv_kv": 35.0, "vn_lv_kv": 0.69, "vk_percent": 6.0, "vkr_percent": 0.8}


def swept(campaign: Path) -> Library:
    """A campaign of the examples, swept."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "swept.parquet"
        command(["run", str(campaign), "-o", str(path)])
        table = read_table(path)
    return Library(lambda name: table)


def document(n: int, points: list[dict[str, Any]]) -> dict[str, Any]:
    """A farm of n turbines in strings of ten, at operating points that are taken in turn."""
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
        farm["device"].append({"name": f"wt{k}", "bus": f"t{k}", "table": "swept", **points[k % len(points)]})
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
    parser.add_argument("--grids", type=int, default=400)
    asked = parser.parse_args()
    one_operating_point(asked.turbines, asked.sources)
    a_load_flow_on_each(asked.turbines, asked.grids)


def one_operating_point(turbines: list[int], sources: int) -> None:
    """The farm where it stands, and on many sources at that operating point."""
    library = swept(POWERS)
    ops = [{"op": op} for op in library.table("swept").op_ids]
    _, seconds = timed(lambda: judged(farm_of(document(len(ops), ops)), library))
    print(f"their fits, and a farm of {len(ops)}: {seconds:.1f} s")
    for n in turbines:
        farm, alone = timed(lambda n=n: judged(farm_of(document(n, ops)), library))
        z = farm.entry.source_z_ohm * np.linspace(0.5, 1.6, sources)
        found, more = timed(lambda farm=farm, z=z: judge_sources(farm, z))
        kinds = [sum(one.verdict == kind for one in found) for kind in ("stable", "unstable", "undecided")]
        whole = sum(one.whole for one in found)
        print(f"{n} turbines: judged in {alone:.1f} s ({farm.judgement.verdict}); {sources} sources in {more:.1f} s")
        print(f"    {kinds[0]} stable, {kinds[1]} unstable, {kinds[2]} undecided, {whole} by the whole pencil")


def a_load_flow_on_each(turbines: list[int], count: int) -> None:
    """Every turbine at a power of its own, its admittance found anew on every grid."""
    library = swept(REGION)
    for n in turbines:
        points = [{"active_power_mw": float(p)} for p in np.linspace(0.4, 0.9, n)]
        entry = farm_of(document(n, points))
        farm, ready = timed(lambda entry=entry: farm_on_grids(entry, library))
        entries = [grid(k, scale * entry.source_z_ohm) for k, scale in enumerate(np.linspace(0.5, 1.6, count))]
        found, more = timed(
            lambda farm=farm, entries=entries: judge_bank(
                FarmFollowing(farm), farm.bases, "", entries, output=None, jobs=1, elements=0
            )
        )
        kinds = [sum(pair.verdict == kind for pair in found) for kind in ("stable", "unstable", "undecided")]
        print(f"{n} turbines, a load flow and surrogates on each of {count} grids: {ready:.1f} + {more:.1f} s")
        print(f"    {kinds[0]} stable, {kinds[1]} unstable, {kinds[2]} undecided")


def grid(k: int, z_ohm: complex) -> BankEntry:
    """R + jX, every fourth with a capacitor of a tenth of its susceptance."""
    capacitor = {"kind": "shunt_capacitor", "c_uf": 0.1e6 / (100.0 * np.pi * abs(z_ohm))}
    series = {"kind": "series", "r_ohm": z_ohm.real, "x_ohm": z_ohm.imag}
    return BankEntry(f"{k:05d}", document={"element": [capacitor, series] if k % 4 == 0 else [series]})


if __name__ == "__main__":
    main()
