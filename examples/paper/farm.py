"""The paper's wind farm in frequency: eight turbines of 2.1 MVA on 35 kV, its scenarios, its control beside a GSDC.

    python examples/paper/farm.py

sweeps the turbine with parameter set B, judges the farm of farm.toml in every scenario, searches the gains, sets
grid-side dampers, draws docs/figures/paper-farm*.png and writes the farm's table into docs/paper.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from comparison import Row, markdown, rewrite

import seqsweep as ss
from seqsweep.sweep.farm_sweeps import FarmSweeps, resonance_hz, virtual_impedance
from seqsweep.sweep.report.farm_diagram import plot_diagram
from seqsweep.sweep.report.farm_states import plot_states
from seqsweep.tuning.farm.dampers import largest_growth
from seqsweep.tuning.farm.farm import Farm, judged
from seqsweep.tuning.farm.levers import GainLever
from seqsweep.tuning.farm.margin import crossing_at_source
from seqsweep.tuning.farm.states import State, StateVerdict, farm_in, judge_state, judge_states
from seqsweep.tuning.farm.units import Library
from seqsweep.tuning.gain import search_gain

HERE = Path(__file__).resolve().parent
DOCS = HERE.parents[1] / "docs"
BEGIN, END = "<!-- written by examples/paper/farm.py: begin -->", "<!-- written by examples/paper/farm.py: end -->"
REQUIRED = 1.6
ARDC_K = 1.5
WITH_COLLECTOR_MW = 0.28 * 1.632
CABLE = {"r_ohm_per_km": 0.13, "x_ohm_per_km": 0.119, "c_nf_per_km": 190.0}
SPACING_KM = 0.8


class Results(NamedTuple):
    """What is drawn and tabled."""

    states: tuple[StateVerdict, ...]
    gains: dict[str, tuple[float, float, float]]
    dampers: dict[str, float]
    collector: tuple[StateVerdict, ...]
    aggregate: tuple[StateVerdict, ...]
    charging: dict[str, StateVerdict]


def swept() -> Library:
    """The turbine of set B over its region, swept."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "turbine-b.parquet"
        run = [sys.executable, "-m", "seqsweep", "run", str(HERE / "turbine-b.toml"), "-o", str(path)]
        subprocess.run(run, check=True, capture_output=True)
        table = ss.read_table(path)
    return Library(lambda name: table)


def results(library: Library) -> Results:
    """Judge, search, set."""
    document = tomllib.loads((HERE / "farm.toml").read_text("utf-8"))
    states = judge_states(document, library)
    unstable = [found for found in states if found.verdict == "unstable" and found.farm is not None]
    collector = with_collector(document, WITH_COLLECTOR_MW)
    return Results(
        states,
        {found.state.name: gain_for(found.farm, library) for found in unstable if found.farm},
        {found.state.name: growth_with_gsdc(document, found, library) for found in unstable},
        judge_states(collector, library),
        judge_states(aggregated(document, WITH_COLLECTOR_MW), library),
        charging(document, library),
    )


def gain_for(farm: Farm, library: Library) -> tuple[float, float, float]:
    """The uniform gain for m = 1.6, every trial swept: k, m; and the largest growth (1/s) with k = 1.5."""
    lever = GainLever(farm, FarmSweeps(library, virtual_impedance(farm), resonance_hz(farm), jobs=2), k_max=3.0)

    def margin_at(k: float) -> float:
        crossing = crossing_at_source(lever.changed(np.full(len(farm.units), k)))
        return inf if crossing is None else crossing.m

    found = search_gain(margin_at, REQUIRED, 1.2)
    strong = lever.changed(np.full(len(farm.units), ARDC_K))
    return found.k, found.margin_m, max(mode.pole.real for mode in strong.judgement.modes if _is_farm_s(mode))


def growth_with_gsdc(document: dict[str, Any], found: StateVerdict, library: Library) -> float:
    """Largest real part (1/s) of the oscillating modes with a grid-side damper at the farm's connection."""
    content = {**document, "damper": [{"name": "gsdc", "bus": "pcc", "share": 0.1}]}
    farm = judged(farm_in(content, found.state), library)
    return largest_growth(farm.entry, farm.system.units)


def with_collector(document: dict[str, Any], power_mw: float | None = None) -> dict[str, Any]:
    """The farm with cables: four strings, turbines 0.8 km apart."""
    content = _at_power(document, power_mw)
    names = [entry["name"] for entry in content["device"]]
    content["bus"] = [*content["bus"], *({"name": f"m{k}", "voltage_kv": 35.0} for k in range(1, len(names) + 1))]
    content["transformer"] = [{**entry, "to": entry["from"].replace("t", "m")} for entry in content["transformer"]]
    before = ["pcc" if k <= 4 else f"m{k - 4}" for k in range(1, len(names) + 1)]
    content["cable"] = [
        {"name": f"c{k}", "from": bus, "to": f"m{k}", "length_km": SPACING_KM, **CABLE}
        for k, bus in enumerate(before, start=1)
    ]
    content["state"] = [
        {"name": "8 turbines", "devices": 8, "out": unused_cables(8), "source_scale": [1.0, 1.1, 1.25, 1.375, 1.5]},
        *({"name": f"{n} turbines", "devices": n, "out": unused_cables(n)} for n in (9, 11, 13)),
    ]
    return content


def unused_cables(n: int) -> list[str]:
    """The cables beyond the first n turbines, which would charge all the same."""
    return [f"c{k}" for k in range(n + 1, 14)]


def aggregated(document: dict[str, Any], power_mw: float) -> dict[str, Any]:
    """One turbine that stands for all, behind one transformer; neither cables nor their charging."""
    content = _at_power(document, power_mw)
    content["state"] = [
        {"name": "8 turbines", "count": {"wt1": 8}, "source_scale": [1.0, 1.1, 1.25, 1.375, 1.5]},
        *({"name": f"{n} turbines", "count": {"wt1": n}} for n in (9, 11, 13)),
    ]
    content["device"], content["bus"] = content["device"][:1], content["bus"][:2]
    content["transformer"] = [{**content["transformer"][0], "parallel": 8}]
    return content


def charging(document: dict[str, Any], library: Library) -> dict[str, StateVerdict]:
    """Nine turbines at 0.30 pu: without cables, with them, and with cables that do not charge."""
    nine, cabled = State("9 turbines", devices=9), State("9 turbines", devices=9, out=tuple(unused_cables(9)))
    cables = with_collector(document)
    lines = [{key: value for key, value in entry.items() if key != "c_nf_per_km"} for entry in cables["cable"]]
    dry = {**cables, "cable": [], "line": lines}
    cases = {"no cables": (document, nine), "cables": (cables, cabled), "cables without their charging": (dry, cabled)}
    return {name: judge_state(farm_in(content, state), state, library) for name, (content, state) in cases.items()}


def _at_power(document: dict[str, Any], power_mw: float | None) -> dict[str, Any]:
    devices = document["device"]
    if power_mw is not None:
        devices = [{**entry, "active_power_mw": power_mw} for entry in devices]
    return {**document, "device": devices}


# The table -----------------------------------------------------------------------------------------------------------


def rows(found: Results) -> list[Row]:
    """Paper, ours, why."""
    first = found.states[0]
    assert first.crossing is not None
    table = [
        Row(
            "farm's Bode crossing, 8 turbines, SCR 1.8",
            "20/80 Hz",
            f"{_crossing(first)}; {_mode(first)}",
            "set B: two gains of the PLL are ours",
        )
    ]
    table += [_scenario(verdict, found) for verdict in found.states[1:]]
    table.append(_dampers(found))
    table.append(_collector(found))
    table.append(_charging(found))
    return table


PAPER = {
    "1.1 Z": "stable, no start",
    "1.25 Z": "resonates; damped",
    "1.375 Z": "resonates at 19/81 Hz; damped, m 1.0 to 1.7",
    "1.5 Z": "resonates more; damped",
    "9 devices": "stable, no start",
    "11 devices": "resonates; damped",
    "13 devices": "resonates more; damped",
}


def _scenario(verdict: StateVerdict, found: Results) -> Row:
    assert verdict.crossing is not None
    said = f"{verdict.verdict}, m = {verdict.crossing.m:.2f}; {_mode(verdict)}"
    if verdict.state.name in found.gains:
        k, m, sigma = found.gains[verdict.state.name]
        reached = f"k = {k:.2f} gives m = {m:.2f}" if m >= REQUIRED else f"m = {m:.2f} at most, with k = {k:.2f}"
        said += f"; swept again, {reached}; k = {ARDC_K:g} gives {sigma:+.1f} rad/s"
    paper = next(words for key, words in PAPER.items() if verdict.state.name.endswith(key))
    why = "two gains of the PLL are ours" if verdict.verdict == "unstable" else "damping control may stay off"
    return Row(verdict.state.name, paper, said, why)


def _is_farm_s(mode: Any) -> bool:
    """Whether it is the farm's resonance, and not the notch's of a damping control, which no network moves."""
    return bool(60.0 < mode.pole.imag < 315.0 and np.abs(mode.devices).sum() > 0.5 * abs(mode.pole.real))


def _dampers(found: Results) -> Row:
    pairs = [
        f"{name.removeprefix('8 turbines, ').removeprefix('more turbines, ').replace('devices', 'turbines')}: "
        f"{growth:+.1f} and {found.gains[name][2]:+.1f}"
        for name, growth in found.dampers.items()
    ]
    return Row(
        f"GSDC at the connection, and ARDC with k = {ARDC_K:g}",
        "10 % of the farm damps only to an extent, ARDC succeeds",
        "; ".join(pairs) + " rad/s, whatever the GSDC's share of 5, 10, 20 or 50 %",
        "below its limit a small GSDC damps as a large one: only in time does the limit tell them apart",
    )


def _collector(found: Results) -> Row:
    pairs = [
        f"{verdict.state.name.removeprefix('8 turbines, ')}: {_sigma(verdict)} and {_sigma(alone)}"
        for verdict, alone in zip(found.collector, found.aggregate, strict=True)
    ]
    return Row(
        "individual turbines on cables, and one that stands for all, 0.28 pu",
        "one aggregate",
        "; ".join(pairs) + " rad/s",
        "the aggregate leaves out the cables: always on the unsafe side",
    )


def _charging(found: Results) -> Row:
    said = "; ".join(f"{name}: {_sigma(verdict)} rad/s" for name, verdict in found.charging.items())
    return Row("9 turbines at 0.30 pu", "stable", said, "the charging of the cables decides, not their impedance")


def _sigma(verdict: StateVerdict) -> str:
    if verdict.farm is None or verdict.farm.judgement.critical is None:
        return verdict.verdict
    return f"{verdict.farm.judgement.critical.pole.real:+.1f}"


def _crossing(verdict: StateVerdict) -> str:
    assert verdict.crossing is not None
    f_hz = verdict.crossing.f_hz
    return f"{100.0 - f_hz:.1f}/{f_hz:.1f} Hz, m = {verdict.crossing.m:.2f}"


def _mode(verdict: StateVerdict) -> str:
    assert verdict.farm is not None
    mode = verdict.farm.judgement.critical
    assert mode is not None
    nu = mode.pole.imag / (2.0 * np.pi)
    return f"mode {50.0 - nu:.1f}/{50.0 + nu:.1f} Hz, {mode.pole.real:+.1f} rad/s"


def main() -> None:
    """Judge, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder with paper.md and figures/")
    docs = parser.parse_args().docs
    found = results(swept())
    table = markdown(rows(found))
    plot_states(docs / "figures" / "paper-farm.png", found.states)
    nine = found.charging["cables"].farm
    assert nine is not None
    plot_diagram(docs / "figures" / "paper-farm-diagram.png", nine)
    rewrite(docs / "paper.md", table, BEGIN, END)
    print(table)


if __name__ == "__main__":
    main()
