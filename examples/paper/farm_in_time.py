"""The paper's wind farm in time: its four scenarios, its control beside a GSDC, the aggregate beside all turbines.

    python examples/paper/farm_in_time.py [--jobs 2]

simulates the farm of farm.toml with parameter set B, every turbine by itself with its own estimator and control, draws
docs/figures/paper-farm-*.png and writes the farm's second table into docs/paper.md. About five minutes of CPU.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import farm_pictures
import numpy as np
from comparison import Row, markdown, rewrite
from farm import ARDC_K, DOCS, HERE, WITH_COLLECTOR_MW, aggregated, swept, unused_cables, with_collector
from farm_pictures import Runs

from seqsweep.sweep.verify.farm_runs import FarmRun, verify_farm
from seqsweep.sweep.verify.farm_story import FarmFault, FarmStory, FarmSwitch, SourceStep
from seqsweep.tuning.farm.units import Library

BEGIN = "<!-- written by examples/paper/farm_in_time.py: begin -->"
END = "<!-- written by examples/paper/farm_in_time.py: end -->"
STEP_S = 0.1
ON_S = 0.28
LOOK_S = 0.6
SCALES = (1.1, 1.25, 1.375, 1.5)
MORE = (9, 11, 13)
SHARES = (0.05, 0.10, 0.50)
LEAKING = (0.05, 0.10, 0.20, 0.50)
BACK_S = 0.6
STOP_MARGIN = 1.1
COMPARED = (1.375, 1.5, 1.625)
FAULTS = ("a-b-c", "a-g", "b-c", "b-c-g")
POWER_MW = 0.49


Task = Callable[[], Runs]


class Results(NamedTuple):
    """What is drawn and tabled: runs by scenario, by SCR and control, with cables, by fault, and what explains them.

    ``standing`` are scenarios in which nothing comes in, ``leaking`` dampers without a washout, ``stopped`` the
    deactivation.
    """

    scenarios: dict[str, Runs]
    compared: dict[float, dict[str, FarmRun]]
    cabled: dict[str, Runs]
    faults: dict[str, Runs]
    standing: dict[str, Runs]
    leaking: dict[float, dict[str, FarmRun]]
    stopped: dict[str, Runs]


class Cases:
    """What is simulated, for how long, and with the tables of which turbine."""

    def __init__(self, library: Library, duration_s: float):
        self.library, self.duration_s = library, duration_s
        self.document = tomllib.loads((HERE / "farm.toml").read_text("utf-8"))

    def scenarios(self) -> dict[str, Task]:
        """Scenarios 1 to 3: a weaker grid, more turbines; all turbines by themselves, and the aggregate."""
        found: dict[str, Task] = {}
        for scale in SCALES:
            found[f"{scale:g} Z"] = lambda scale=scale: self.weaker(first(self.document, 8), scale)
        for n in MORE:
            found[f"{n} turbines"] = lambda n=n: self.more(first(self.document, n), n)
        return found

    def cabled(self) -> dict[str, Task]:
        """The farm with its collector at 0.28 pu."""
        document = with_collector(self.document, WITH_COLLECTOR_MW)
        return {"11 turbines": lambda: self.more(first(document, 11), 11)}

    def faults(self) -> dict[str, Task]:
        """Scenario 4: 40 ms of every kind at the connection, SCR 1.8, the turbines' control armed."""
        return {kind: lambda kind=kind: self.fault(kind) for kind in FAULTS}

    def compared(self) -> dict[str, Task]:
        """Grid-side dampers of several sizes and the turbines' own control, all switched on at 0.28 s.

        Eight equal turbines on a star move as one: one stands for them here.
        """
        one = self._one_for_eight()
        found: dict[str, Task] = {}
        for scale in COMPARED:
            found[f"{scale:g} ARDC"] = lambda scale=scale: self.weaker(one, scale, **BY_HAND)
            found |= self._dampers(one, scale, SHARES)
        return found

    def leaking(self) -> dict[str, Task]:
        """The same dampers without a washout: their band-passes let some of the fundamental through."""
        found: dict[str, Task] = {}
        for scale in COMPARED:
            found |= self._dampers(self._one_for_eight(), scale, LEAKING, washout_hz=0.0)
        return found

    def standing(self) -> dict[str, Task]:
        """Thirteen turbines in service all the time, and the grid steps from eight thirteenths: none has to come in."""
        document = first(self.document, 13)
        return {"13 turbines": lambda: self.weaker(scaled(document, 8.0 / 13.0), 13.0 / 8.0, aggregate=False)}

    def stopped(self) -> dict[str, Task]:
        """Control starts on a weaker grid, and the grid comes back."""
        return {"1.375 Z and back": lambda: self.back(1.375)}

    def _one_for_eight(self) -> dict[str, Any]:
        one = aggregated(self.document, POWER_MW)
        return {**one, "device": [{**one["device"][0], "count": 8}]}

    def _dampers(
        self, document: dict[str, Any], scale: float, shares: tuple[float, ...], **keys: float
    ) -> dict[str, Task]:
        """A grid-side damper at the connection by its share of the farm."""

        def run(share: float) -> Runs:
            damper = {"name": "gsdc", "bus": "pcc", "share": share, **keys}
            return self.weaker({**document, "damper": [damper]}, scale, 0.0, **BY_HAND)

        return {f"{scale:g} {gsdc(share)}": lambda share=share: run(share) for share in shares}

    def weaker(self, document: dict[str, Any], scale: float, k: float = ARDC_K, **others: Any) -> Runs:
        """The grid's impedance grows at 0.1 s. Control is set for the farm after the step."""
        story = FarmStory(self.duration_s, 1.0 / scale, k=k, events=(SourceStep(STEP_S, 1.0),), **others)
        return verify_farm(scaled(document, scale), self.library, story).runs

    def back(self, scale: float) -> Runs:
        """The grid's impedance grows at 0.1 s and is what it was from 0.6 s on; control may stop by its criterion."""
        events = (SourceStep(STEP_S, 1.0), SourceStep(BACK_S, 1.0 / scale))
        more: dict[str, Any] = {"stop_margin": STOP_MARGIN, "aggregate": False}
        story = FarmStory(self.duration_s + 0.3, 1.0 / scale, k=ARDC_K, events=events, **more)
        return verify_farm(scaled(first(self.document, 8), scale), self.library, story).runs

    def more(self, document: dict[str, Any], n: int) -> Runs:
        """Eight turbines become n at 0.1 s."""
        cables = tuple(f"c{k}" for k in range(9, n + 1)) if "cable" in document else ()
        event = FarmSwitch(STEP_S, (*(f"wt{k}" for k in range(9, n + 1)), *cables), True)
        story = FarmStory(self.duration_s, out=event.names, k=ARDC_K, events=(event,))
        return verify_farm(document, self.library, story).runs

    def fault(self, kind: str) -> Runs:
        """One fault of 40 ms through 5 % of the grid's impedance."""
        event = FarmFault(STEP_S, 0.04, "pcc", kind, 0.05 * 40.5)
        story = FarmStory(self.duration_s, k=ARDC_K, aggregate=False, events=(event,))
        return verify_farm(first(self.document, 8), self.library, story).runs


def gsdc(share: float) -> str:
    """What a damper of a share is called."""
    return f"GSDC {100.0 * share:g} %"


BY_HAND: dict[str, Any] = {"on_from_s": ON_S, "aggregate": False}
GROUPS = ("scenarios", "compared", "cabled", "faults", "standing", "leaking", "stopped")
_tasks: dict[tuple[str, str], Task] = {}


def results(library: Library, duration_s: float, jobs: int) -> Results:
    """Simulate everything."""
    cases = Cases(library, duration_s)
    for group in GROUPS:
        _tasks.update({(group, name): task for name, task in getattr(cases, group)().items()})
    found: dict[str, dict[str, Runs]] = {}
    with multiprocessing.get_context("fork").Pool(jobs) as pool:  # children have the tasks, and hand back runs
        for (group, name), runs in zip(_tasks, pool.imap(_done, _tasks), strict=True):
            print(f"{group}: {name}", file=sys.stderr)
            found.setdefault(group, {})[name] = runs
    found["compared"], found["leaking"] = _by_grid(found["compared"]), _leaking(found["leaking"])
    return Results(**found)


def _done(name: tuple[str, str]) -> Runs:
    return _tasks[name]()


def _by_grid(runs: dict[str, Runs]) -> dict[float, dict[str, FarmRun]]:
    """Runs of one grid together: without damping, with dampers, with the turbines' own control."""
    found: dict[float, dict[str, FarmRun]] = {}
    for scale in COMPARED:
        ardc = runs[f"{scale:g} ARDC"]
        damped = {gsdc(share): runs[f"{scale:g} {gsdc(share)}"][1] for share in SHARES}
        found[scale] = {"none": ardc[0], **damped, "ARDC": ardc[1]}
    return found


def _leaking(runs: dict[str, Runs]) -> dict[float, dict[str, FarmRun]]:
    """Runs of one grid together, by the damper's size."""
    return {scale: {gsdc(share): runs[f"{scale:g} {gsdc(share)}"][1] for share in LEAKING} for scale in COMPARED}


def first(document: dict[str, Any], n: int) -> dict[str, Any]:
    """The farm with its first n turbines alone."""
    unused = {*(f"wt{k}" for k in range(n + 1, 14)), *(f"tr{k}" for k in range(n + 1, 14)), *unused_cables(n)}
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
    table = [_scenario(name, runs) for name, runs in found.scenarios.items()]
    table.append(_standing(found.standing["13 turbines"]))
    table.append(_stopped(found.stopped["1.375 Z and back"]))
    table += [_comparison(scale, runs) for scale, runs in found.compared.items()]
    table += [_without_washout(scale, runs) for scale, runs in found.leaking.items()]
    table.append(_aggregate("farm and aggregate, no cables", found.scenarios, "what all meet"))
    table.append(
        _aggregate("farm and aggregate, on cables, 0.28 pu", found.cabled, "the mean of the terminal voltages")
    )
    table.append(_faults(found.faults))
    return table


def _scenario(name: str, runs: Runs) -> Row:
    without, damped = runs[:2]
    said = f"without: {_told(without)}; k = {ARDC_K:g}: {_told(damped)}{_started(damped)}"
    paper = PAPER[name]
    why = "no limit cycle here: synchronism is lost" if without.trajectory.lost_s is not None else ""
    if damped.trajectory.lost_s is not None:
        why = "too hard a step: five turbines come in where their load flow puts them, out of step with the eight"
    return Row(f"{name}, in time", paper, said, why)


def _standing(runs: Runs) -> Row:
    without, damped = runs[:2]
    return Row(
        "13 turbines in service, their grid steps from 8/13",
        PAPER["13 turbines"],
        f"without: {_told(without)}; k = {ARDC_K:g}: {_told(damped)}{_started(damped)}",
        "the same impedance for each turbine, and none has to come in",
    )


def _stopped(runs: Runs) -> Row:
    without, damped = runs[:2]
    times = [device.stopped_s[0] for device in damped.devices if device.stopped_s]
    stop = f", stops at {min(times):.2f} s" if times else ", does not stop"
    before = f"without: {_told(without)}; k = {ARDC_K:g}: "
    return Row(
        f"1.375 Z at {STEP_S:g} s, back at {BACK_S:g} s, may stop from m = {STOP_MARGIN:g}",
        "deactivation by the farm's topology (Section III-D)",
        f"{before}{_told(damped)}{_started(damped)}{stop}",
        "asked for: stable without control, modes between turbines included, and the margin at the connection",
    )


def _without_washout(scale: float, runs: dict[str, FarmRun]) -> Row:
    said = "; ".join(f"{name}: {_kept(run, with_later=True)}" for name, run in runs.items())
    return Row(
        f"SCR {1.8 / scale:.2f}, GSDC without washout",
        "GSDC of 10 % only to an extent, ARDC succeeds",
        said,
        "band-passes of 5 Hz let 17 % of the fundamental through: it takes the current of a small GSDC",
    )


def _told(run: FarmRun) -> str:
    """The line's end in words: lost, or r half a second after the event and at the end."""
    if run.trajectory.lost_s is not None:
        return f"synchronism lost at {run.trajectory.lost_s:.2f} s"
    line = run.trajectory.line
    later = float(line.ratio[min(np.searchsorted(line.decision_s, LOOK_S), len(line.ratio) - 1)])
    return f"r {_percent(later)} at {LOOK_S:g} s, {_percent(run.line.last_ratio)} at the end"


def _percent(ratio: float) -> str:
    return f"{100.0 * ratio:.2g} %"


def _started(run: FarmRun) -> str:
    times = [device.started_s[0] for device in run.devices if device.started_s]
    return f", control starts at {min(times):.2f} s" if times else ", no start"


def _comparison(scale: float, runs: dict[str, FarmRun]) -> Row:
    said = "; ".join(f"{name}: {_kept(run)}" for name, run in runs.items())
    paper = "GSDC of 10 % only to an extent, ARDC succeeds"
    kept = {run.trajectory.lost_s is None for name, run in runs.items() if name.startswith("GSDC")}
    why = "with a washout the GSDC asks for little current: its limit decides nothing"
    return Row(
        f"SCR {1.8 / scale:.2f}, all on at {ON_S:g} s",
        paper,
        said,
        why if len(kept) == 1 else "the GSDC meets its limit",
    )


def _kept(run: FarmRun, with_later: bool = False) -> str:
    if run.trajectory.lost_s is not None:
        return f"lost at {run.trajectory.lost_s:.2f} s"
    return f"kept, {_told(run)}" if with_later else f"kept, r {_percent(run.line.last_ratio)} at the end"


def _aggregate(subject: str, found: dict[str, Runs], what: str) -> Row:
    pairs = []
    for name, runs in found.items():
        alone = [run for run in runs if run.title == "aggregate without damping"]
        pairs.append(f"{name}: {_end(runs[0])} and {_end(alone[0])}")
    return Row(subject, "one aggregate", "; ".join(pairs), f"the aggregate meets {what}")


def _end(run: FarmRun) -> str:
    if run.trajectory.lost_s is not None:
        return f"lost {run.trajectory.lost_s:.3f} s"
    rate = run.line.rate_per_s
    return "r " + _percent(run.line.last_ratio) if rate is None else f"{rate:+.2f} 1/s"


def _faults(found: dict[str, Runs]) -> Row:
    said = "; ".join(f"{kind}: {_fault(runs[1])}" for kind, runs in found.items())
    paper = "no false start; 1.7 % after 106 ms"
    return Row(
        "40 ms faults at the connection, 8 turbines",
        paper,
        said,
        "faults of all phases cost synchronism, without ride-through; the others decay slowly",
    )


def _fault(run: FarmRun) -> str:
    starts = sum(bool(device.started_s) for device in run.devices)
    calm = "not calm to the end" if run.line.calm_s is None else f"r below 3 % from {run.line.calm_s:.2f} s"
    if run.trajectory.lost_s is not None:
        calm = f"synchronism lost at {run.trajectory.lost_s:.2f} s"
    return f"{calm}, {starts or 'no'} start{'s' if starts > 1 else ''}"


def main() -> None:
    """Simulate, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder with paper.md and figures/")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--duration", type=float, default=0.9, help="simulated time of a run (s); less is a trial")
    asked = parser.parse_args()
    found = results(swept(), asked.duration, asked.jobs)
    table = markdown(rows(found))
    print(table)
    rewrite(asked.docs / "paper.md", table, BEGIN, END)
    farm_pictures.draw_all(asked.docs / "figures", found.scenarios, found.compared, ON_S)


if __name__ == "__main__":
    main()
