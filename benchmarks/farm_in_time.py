"""What a turbine of a farm costs in time, beside a lane of a sweep that has a grid of its own.

    python benchmarks/farm_in_time.py --turbines 2 8 13 50 --rounds 9

For every number of turbines, on a star (each behind its transformer on one bus) and on strings of four on cables, the
medians over the rounds of the CPU time of one step, per turbine; each round measures the farm and the lane one after
the other. `lane`: `run_phasors` of eight lanes behind R + jX, without damping control, which a farm's lane always has;
`damped lane`: with it. Waveforms that are handed over cost beside it; they are left out on both sides. Last, the CPU
time of a whole run with control, of which most is the search for resonances.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from seqsweep.plant.circuits.branches import GROUND, Branch
from seqsweep.plant.circuits.circuit import SOURCE, Circuit
from seqsweep.plant.damping.control import DampingSettings
from seqsweep.plant.damping.farm_events import FarmControl, FarmScenario, simulate_farm
from seqsweep.plant.kernels import turbine_farm as kernel
from seqsweep.plant.protocol import Compensation, FarmConditions, Job, Member, OperatingPoint, Source, Window
from seqsweep.plant.turbine.farm import TurbineFarm
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
from seqsweep.plant.turbine.reference import ReferenceTurbine

W1 = 100.0 * np.pi
POWER_W = 0.6e6
TRANSFORMER = 0.0017, 0.0175 / W1
CABLE = 4.0e-5, 1.2e-7, 4.0e-4
"""Of 0.8 km at 690 V: R (ohm), L (H), C (F)."""


def star(n: int) -> Circuit:
    """Every turbine behind its transformer on one bus with a capacitor."""
    branches = [Branch(f"z{k}", {f"t{k}": 1.0, "bus": -1.0}, *TRANSFORMER) for k in range(n)]
    branches.append(Branch("c", {"bus": 1.0, GROUND: -1.0}, c_f=400e-6))
    return Circuit((*branches, _source(n)))


def strings(n: int) -> Circuit:
    """Strings of four turbines on cables that charge."""
    branches = [Branch(f"z{k}", {f"t{k}": 1.0, f"m{k}": -1.0}, *TRANSFORMER) for k in range(n)]
    for k in range(n):
        before = "bus" if k % 4 == 0 else f"m{k - 1}"
        branches.append(Branch(f"cable{k}", {f"m{k}": 1.0, before: -1.0}, *CABLE[:2]))
        branches.append(Branch(f"c{k}", {f"m{k}": 1.0, GROUND: -1.0}, c_f=CABLE[2]))
    return Circuit((*branches, _source(n)))


def _source(n: int) -> Branch:
    return Branch("source", {"bus": 1.0, SOURCE: -1.0}, 0.0034 / n, 0.23 / n / W1)


def farm_s(n: int, circuit: Circuit, n_steps: int) -> tuple[Callable[[], float], list[int]]:
    """What measures a farm's CPU time per turbine and step (s), and the sums that the turbines exchange."""
    farm, conditions = on_network(n, circuit)
    state = farm.at_rest(conditions, settled(farm, conditions))
    spent: list[float] = []
    advance = kernel.advance_farm

    def timed(*arguments: object) -> None:
        advance(*arguments)  # the memory of the waveforms has been touched, as in a run with control
        begun = time.process_time()
        advance(*arguments)
        spent.append(time.process_time() - begun)

    def measured() -> float:
        kernel.advance_farm = timed  # the waveforms' way out is left out
        try:
            farm.trace(state, conditions, n_steps)
        finally:
            kernel.advance_farm = advance
        return spent[-1] / n_steps / n

    measured()
    sums = [len(each.into) for each in farm._stepped(conditions).split.coupled[:6]]
    return measured, sums


def on_network(n: int, circuit: Circuit) -> tuple[TurbineFarm, FarmConditions]:
    """n turbines, and what surrounds them."""
    farm = ReferenceTurbine().together([Member(f"wt{k}", f"t{k}", POWER_W) for k in range(n)])
    return farm, FarmConditions(circuit, 690.0, (True,) * n, (1.0,) * n, (Compensation(),) * n)


def whole_s(n: int, circuit: Circuit, simulated_s: float) -> float:
    """CPU time (s) of a run in which every turbine has its own estimator and control."""
    farm, conditions = on_network(n, circuit)
    v = tuple(complex(x) for x in settled(farm, conditions))
    scenario = FarmScenario(circuit, 690.0, (True,) * n, v, ("bus", "source"), 563.4)
    control = FarmControl((DampingSettings(0.5, LINE_R_OHM, LINE_L_H, 77.0),) * n)
    simulate_farm(farm, scenario, control, 0.01)
    begun = time.process_time()
    simulate_farm(farm, scenario, control, simulated_s)
    return time.process_time() - begun


def settled(farm: TurbineFarm, conditions: FarmConditions) -> np.ndarray:
    """Terminal voltages (n,) of the load flow, by fixed-point iteration."""
    n = len(farm.members)
    v = np.full(n, 690.0 + 0j)
    stepped = farm._stepped(conditions)
    (source,) = stepped.forced(690.0)
    c_f, r_f = farm.plant.parameters.c_f_f, farm.plant.parameters.r_f_ohm
    shunt = 1.0 / (r_f + 1.0 / (1j * W1 * c_f))
    for _ in range(400):
        fed = np.conj(-farm.drawn(np.abs(v)) / v) + shunt * v
        (own,) = stepped.dynamics.by_current(fed)
        seen = stepped.outputs.of_x @ (source.x + own.x)
        v = v + 0.3 * (seen[:n] - v)
    return v


def lane_s(gain: float, n_steps: int) -> Callable[[], float]:
    """What measures a lane's CPU time per step (s)."""
    plant = ReferenceTurbine(damping_gain=gain, damping_r_ohm=LINE_R_OHM, damping_l_h=LINE_L_H)
    source = Source("thevenin", LINE_R_OHM, LINE_L_H)
    jobs = 8 * [Job(plant.equilibrium(OperatingPoint(POWER_W, 690.0), source), None)]

    def measured() -> float:
        begun = time.process_time()
        plant.run_phasors(jobs, 8 * [Window(77.0, 15)], n_steps, 1)
        return (time.process_time() - begun) / n_steps / 8

    measured()
    return measured


def main() -> None:
    """Measure side by side, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turbines", type=int, nargs="+", default=[2, 8, 13, 50])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--seconds", type=float, default=2.5, help="simulated time of the whole runs; 0: none")
    asked = parser.parse_args()
    lane, damped = lane_s(0.0, asked.steps), lane_s(0.5, asked.steps)
    print("turbines  network  sums            ns/turbine  lane  damped lane  ratio  to the damped")
    for n in asked.turbines:
        for name, build in (("star", star), ("strings", strings)):
            farm, sums = farm_s(n, build(n), asked.steps)
            rows = np.array([(farm(), lane(), damped()) for _ in range(asked.rounds)])
            ratios = np.median(rows[:, :1] / rows[:, 1:], axis=0)
            own, plain, with_port = 1e9 * np.median(rows, axis=0)
            exchanged = ",".join(map(str, sums))
            print(
                f"{n:8d}  {name:7s}  {exchanged:14s}  {own:10.0f}  {plain:4.0f}  {with_port:11.0f}  "
                f"{ratios[0]:5.1f}  {ratios[1]:13.1f}"
            )
    for n in asked.turbines if asked.seconds else ():
        for name, build in (("star", star), ("strings", strings)):
            spent = whole_s(n, build(n), asked.seconds)
            print(f"{n} turbines, {name}: {asked.seconds:g} s with control in {spent:.1f} s of CPU")


if __name__ == "__main__":
    main()
