"""The paper's wind farm in time: its four scenarios, its control beside a GSDC, the aggregate beside all turbines.

    python examples/paper/farm_in_time.py

simulates the farm of farm.toml with parameter set B, every turbine by itself with its own estimator and control, draws
docs/figures/paper-farm-*.png and writes the farm's second table into docs/paper.md. About four minutes of CPU.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import farm_pictures
from comparison import rewrite
from farm import ARDC_K, DOCS, HERE, Row, _unused, aggregated, swept, with_collector

from seqsweep.sweep.verify.farm_runs import FarmRun, FarmVerification, verify_farm
from seqsweep.sweep.verify.farm_story import FarmFault, FarmStory, FarmSwitch, SourceStep
from seqsweep.sweep.verify.reading import RunReport
from seqsweep.tuning.farm.units import Library

BEGIN = "<!-- written by examples/paper/farm_in_time.py: begin -->"
END = "<!-- written by examples/paper/farm_in_time.py: end -->"
STEP_S = 0.1
ON_S = 0.28
SCALES = (1.1, 1.25, 1.375, 1.5)
MORE = (9, 11, 13)
SHARES = (0.05, 0.10, 0.20, 0.50)
COMPARED = (1.25, 1.375, 1.5, 1.625)
FAULTS = ("a-b-c", "a-g", "b-c", "b-c-g")
POWER_MW = 0.49
WITH_COLLECTOR_MW = 0.28 * 1.632


class Results(NamedTuple):
    """What is drawn and tabled: runs by scenario, by SCR and control, with cables, by fault."""

    scenarios: dict[str, FarmVerification]
    compared: dict[float, dict[str, FarmRun]]
    cabled: dict[str, FarmVerification]
    faults: dict[str, FarmRun]


def results(library: Library) -> Results:
    """Simulate everything."""
    document = tomllib.loads((HERE / "farm.toml").read_text("utf-8"))
    return Results(
        scenarios(document, library), compared(document, library), cabled(library), faults(document, library)
    )


def scenarios(document: dict[str, Any], library: Library) -> dict[str, FarmVerification]:
    """Scenarios 1 to 3: a weaker grid, more turbines; all turbines by themselves, and the aggregate."""
    found = {f"{scale:g} Z": weaker(first(document, 8), scale, library) for scale in SCALES}
    return found | {f"{n} turbines": more(first(document, n), n, library) for n in MORE}


def weaker(
    document: dict[str, Any], scale: float, library: Library, k: float = ARDC_K, **others: Any
) -> FarmVerification:
    """The grid's impedance grows at 0.1 s. Control is set for the farm after the step."""
    story = FarmStory(1.5, 1.0 / scale, k=k, events=(SourceStep(STEP_S, 1.0),), **others)
    return verify_farm(scaled(document, scale), library, story)


def more(document: dict[str, Any], n: int, library: Library, **others: Any) -> FarmVerification:
    """Eight turbines become n at 0.1 s."""
    new = tuple(f"wt{k}" for k in range(9, n + 1))
    cables = tuple(f"c{k}" for k in range(9, n + 1)) if "cable" in document else ()
    event = FarmSwitch(STEP_S, (*new, *cables), True)
    return verify_farm(document, library, FarmStory(1.5, out=event.names, k=ARDC_K, events=(event,), **others))


def compared(document: dict[str, Any], library: Library) -> dict[float, dict[str, FarmRun]]:
    """Grid-side dampers of several sizes and the turbines' own control, all switched on at 0.28 s.

    Eight equal turbines on a star move as one: one stands for them here.
    """
    one = aggregated(document, POWER_MW)
    one["device"] = [{**one["device"][0], "count": 8}]
    found = {}
    for scale in COMPARED:
        ardc = weaker(one, scale, library, on_from_s=ON_S, aggregate=False)
        found[scale] = {"none": ardc.runs[0]}
        for share in SHARES:
            damped = {**one, "damper": [{"name": "gsdc", "bus": "pcc", "share": share}]}
            run = weaker(damped, scale, library, 0.0, on_from_s=ON_S, aggregate=False).runs[1]
            found[scale][f"GSDC {100.0 * share:g} %"] = run
        found[scale]["ARDC"] = ardc.runs[1]
    return found


def cabled(library: Library) -> dict[str, FarmVerification]:
    """The farm with its collector at 0.28 pu."""
    document = with_collector(tomllib.loads((HERE / "farm.toml").read_text("utf-8")), WITH_COLLECTOR_MW)
    eight = weaker(first(document, 8), 1.375, library)
    return {"1.375 Z": eight, "11 turbines": more(first(document, 11), 11, library)}


def faults(document: dict[str, Any], library: Library) -> dict[str, FarmRun]:
    """Scenario 4: 40 ms of every kind at the connection, SCR 1.8, the turbines' control armed."""
    farm = first(document, 8)
    r_ohm = 0.05 * 40.5
    stories = {
        kind: FarmStory(1.0, k=ARDC_K, aggregate=False, events=(FarmFault(STEP_S, 0.04, "pcc", kind, r_ohm),))
        for kind in FAULTS
    }
    return {kind: verify_farm(farm, library, story).runs[1] for kind, story in stories.items()}


def first(document: dict[str, Any], n: int) -> dict[str, Any]:
    """The farm with its first n turbines alone."""
    unused = {*(f"wt{k}" for k in range(n + 1, 14)), *(f"tr{k}" for k in range(n + 1, 14)), *_unused(n)}
    unused |= {f"{kind}{k}" for kind in "tm" for k in range(n + 1, 14)}
    return {
        key: [each for each in entries if each.get("name") not in unused] if isinstance(entries, list) else entries
        for key, entries in document.items()
        if key != "state"
    }


def scaled(document: dict[str, Any], scale: float) -> dict[str, Any]:
    """The farm behind a grid of more impedance."""
    source = document["source"][0]
    weaker_one = {**source, "r_ohm": scale * source["r_ohm"], "x_ohm": scale * source["x_ohm"]}
    return {**document, "source": [weaker_one]}


# The table -----------------------------------------------------------------------------------------------------------

PAPER = {
    "1.1 Z": "stable, no start",
    "1.25 Z": "resonates; damped",
    "1.375 Z": "resonates at 19/81 Hz; damped",
    "1.5 Z": "resonates more; damped",
    "9 turbines": "stable, no start",
    "11 turbines": "resonates; damped",
    "13 turbines": "resonates more; damped",
}


def rows(found: Results) -> list[Row]:
    """Paper, ours, why."""
    table = [_scenario(name, verified) for name, verified in found.scenarios.items()]
    table += [_comparison(scale, runs) for scale, runs in found.compared.items()]
    table.append(_aggregate("farm and aggregate, no cables", found.scenarios, "one"))
    table.append(
        _aggregate("farm and aggregate, on cables, 0.28 pu", found.cabled, "the mean of the terminal voltages")
    )
    table.append(_faults(found.faults))
    return table


def _scenario(name: str, verified: FarmVerification) -> Row:
    without, damped = verified.runs[:2]
    said = f"without: {_told(without.line)}; k = {ARDC_K:g}: {_told(damped.line)}{_started(damped)}"
    paper = PAPER[name]
    why = "no limit cycle here: synchronism is lost" if without.line.lost_s is not None else ""
    return f"{name}, in time", paper, said, why


def _told(line: RunReport) -> str:
    """A line's end in words: lost, or r at its last."""
    if line.lost_s is not None:
        return f"synchronism lost at {line.lost_s:.2f} s"
    return f"r {100.0 * line.largest_ratio:.1f} % at most, {_percent(line.last_ratio)} at the end"


def _percent(ratio: float) -> str:
    return f"{100.0 * ratio:.2g} %"


def _started(run: FarmRun) -> str:
    times = [device.started_s[0] for device in run.devices if device.started_s]
    return f", control starts at {min(times):.2f} s" if times else ", no start"


def _comparison(scale: float, runs: dict[str, FarmRun]) -> Row:
    said = "; ".join(f"{name}: {_kept(run)}" for name, run in runs.items())
    paper = "GSDC of 10 % only to an extent, ARDC succeeds"
    return f"SCR {1.8 / scale:.2f}, all on at {ON_S:g} s", paper, said, "the GSDC meets its limit of current"


def _kept(run: FarmRun) -> str:
    if run.line.lost_s is not None:
        return f"lost at {run.line.lost_s:.2f} s"
    return f"kept, r {_percent(run.line.last_ratio)} at the end"


def _aggregate(subject: str, found: dict[str, FarmVerification], what: str) -> Row:
    pairs = []
    for name, verified in found.items():
        alone = [run for run in verified.runs if run.title == "aggregate without damping"]
        pairs.append(f"{name}: {_end(verified.runs[0])} and {_end(alone[0])}")
    return subject, "one aggregate", "; ".join(pairs), f"the aggregate meets {what}"


def _end(run: FarmRun) -> str:
    if run.line.lost_s is not None:
        return f"lost {run.line.lost_s:.3f} s"
    rate = run.line.rate_per_s
    return "r " + _percent(run.line.last_ratio) if rate is None else f"{rate:+.2f} 1/s"


def _faults(found: dict[str, FarmRun]) -> Row:
    said = "; ".join(f"{kind}: {_fault(run)}" for kind, run in found.items())
    paper = "no false start; 1.7 % after 106 ms"
    return (
        "40 ms faults at the connection, 8 turbines",
        paper,
        said,
        "set B at 0.30 pu rides through without its limits",
    )


def _fault(run: FarmRun) -> str:
    starts = sum(bool(device.started_s) for device in run.devices)
    calm = "lost" if run.line.calm_s is None else f"r below 3 % from {run.line.calm_s:.2f} s"
    return f"{calm}, {starts or 'no'} start{'s' if starts > 1 else ''}"


def main() -> None:
    """Simulate, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder with paper.md and figures/")
    docs = parser.parse_args().docs
    found = results(swept())
    lines = ["| | paper | ours | why different |", "|---|---|---|---|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows(found)]
    print("\n".join(lines))
    rewrite(docs / "paper.md", "\n".join(lines), BEGIN, END)
    farm_pictures.draw_all(docs / "figures", found.scenarios, found.compared)


if __name__ == "__main__":
    main()
