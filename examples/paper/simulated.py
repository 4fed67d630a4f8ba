"""The paper's Sections IV to VI in time: grid steps, more turbines, faults; with and without damping control."""

from __future__ import annotations

from typing import NamedTuple

from swept import SCR_1_8, Z_GRID

from seqsweep.plant.damping.control import THRESHOLD, DampingSettings
from seqsweep.plant.damping.events import Event, Fault, FaultKind, GridStep, Scenario, Trajectory, TurbineStep, simulate
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.verify.reading import RunReport, report
from seqsweep.sweep.verify.runs import has_equilibrium

SOURCE_V = 690.0
STEP_S = 0.1
FAULTS: tuple[FaultKind, ...] = ("a-b-c", "a-g", "b-c", "b-c-g")
TURBINES = (9, 11, 13)
STEPS = (1.1, 1.25, 1.375, 1.5)


class Gain(NamedTuple):
    """Damping control: k, the frequency it is set to (Hz), and its name in legends."""

    k: float
    f_r_hz: float
    label: str


NONE = Gain(0.0, 50.0, "without damping control")


class Run(NamedTuple):
    """One scenario with one gain."""

    gain: Gain
    trajectory: Trajectory
    report: RunReport


class Story(NamedTuple):
    """One scenario with several gains, and whether there is an operating point when all has happened."""

    title: str
    scenario: Scenario
    runs: tuple[Run, ...]
    has_equilibrium: bool


def told(title: str, scenario: Scenario, gains: tuple[Gain, ...], scale: float, duration_s: float) -> Story:
    """Run ``scenario`` once per gain; the gains multiply ``scale`` times the line."""
    plant, grid = make_plant("dpmsg-v1"), Z_GRID.scaled(scale)
    runs = []
    for gain in gains:
        settings = DampingSettings(gain.k, grid.r_ohm, grid.l_h, gain.f_r_hz) if gain.k else None
        trajectory = simulate(plant, scenario, settings, duration_s)
        runs.append(Run(gain, trajectory, report(trajectory, scenario.events, THRESHOLD)))
    return Story(title, scenario, tuple(runs), has_equilibrium(plant, scenario, duration_s))


def grid_step(power_mw: float, gains: tuple[Gain, ...]) -> Story:
    """1.2 Z to 1.4 Z at 0.1 s (Section IV)."""
    scenario = _scenario(power_mw, (GridStep(STEP_S, 1.4),), 1.2)
    return told(f"{power_mw:.2f} MW", scenario, gains, 1.4, 1.5)


def weaker_grids(gains: tuple[Gain, ...]) -> list[Story]:
    """Scenarios 1 and 2 at 1.1 MW: from SCR 1.8 to weaker grids."""
    return [_weaker(factor, (GridStep(STEP_S, SCR_1_8 * factor),), f"Z x {factor:g}", gains) for factor in STEPS]


def more_turbines(gains: tuple[Gain, ...]) -> list[Story]:
    """Scenario 3 at 1.1 MW each: 8 turbines become 9, 11, 13."""
    return [_weaker(n / 8.0, (TurbineStep(STEP_S, float(n)),), f"8 to {n} turbines", gains) for n in TURBINES]


def faults(gain: Gain) -> list[Story]:
    """Scenario 4 at 0.60 MW, SCR 1.8: 40 ms of every kind."""
    stories = []
    for kind in FAULTS:
        scenario = _scenario(0.60, (Fault(STEP_S, 0.04, kind),), SCR_1_8)
        stories.append(told(kind, scenario, (gain,), SCR_1_8, 1.0))
    return stories


def short_circuit_ratio(scale: float) -> float:
    """U^2 / (S |Z|) of the reference turbine on ``scale`` times the line."""
    return 690.0**2 / (1.632e6 * scale * Z_GRID.size_ohm)


def _weaker(factor: float, events: tuple[Event, ...], title: str, gains: tuple[Gain, ...]) -> Story:
    scenario = Scenario(1.1e6, Z_GRID.r_ohm, Z_GRID.l_h, SOURCE_V, events, SCR_1_8, 8.0)
    return told(f"{title}, SCR {short_circuit_ratio(SCR_1_8 * factor):.2f}", scenario, gains, SCR_1_8 * factor, 1.0)


def _scenario(power_mw: float, events: tuple[Event, ...], scale: float) -> Scenario:
    return Scenario(power_mw * 1e6, Z_GRID.r_ohm, Z_GRID.l_h, SOURCE_V, events, scale)
