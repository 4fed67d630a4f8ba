"""Black boxes count their own steps: a sweep takes as many as it asks for, and no way is ever gone again from cold."""

from __future__ import annotations

import pytest

from seqsweep.plant.fmu.device import fmu_plant
from seqsweep.plant.greybox.turbine import GreyTurbine
from seqsweep.sweep.measure.measure import measure

from ..support.controllers import INPUTS, INPUTS_2, OUTPUTS, OUTPUTS_2, build, build_fmu, needs_compiler
from ..support.fmus import PARAMETERS, fmu
from ..support.sweeps import planned

pytestmark = needs_compiler

STEP = "SAMPLE_TIME_S=100e-6"
COUNTED = ("COUNTED", STEP)


def library(*switches, **parameters):
    return GreyTurbine(f"cigre:{build(*COUNTED, *switches)}", INPUTS, OUTPUTS, **parameters)


def controller_fmu(*switches, **parameters):
    path = build_fmu(*COUNTED, *switches)
    maps = (INPUTS, OUTPUTS) if "FMI3" in switches else (INPUTS_2, OUTPUTS_2)
    return GreyTurbine(f"fmu:{path}", *maps, sample_time_s=100e-6, **parameters)


def device_fmu(folder, *switches, **parameters):
    return fmu_plant(str(fmu(folder, "CONVERTER", "COUNTED", *switches)), **{**PARAMETERS, **parameters})


BOXES = {
    "library, declared states": (lambda folder: library(), 1),
    "library, by fork": (lambda folder: library("HIDDEN_STATES", snapshot="fork"), 1),
    "library, found out": (lambda folder: library("HIDDEN_STATES"), 2),
    "FMI 2.0 controller, its own state": (lambda folder: controller_fmu("STATE"), 1),
    "FMI 3.0 controller, by fork": (lambda folder: controller_fmu("FMI3"), 1),
    "FMI 2.0 device, its own state": (lambda folder: device_fmu(folder, "STATE"), 1),
    "FMI 3.0 device, its own state": (lambda folder: device_fmu(folder, "FMI3", "STATE"), 1),
    "FMI 2.0 device, by fork": (lambda folder: device_fmu(folder), 1),
}
"""How each is made, and how often the first operating point is settled: what hides its states is found out by that."""

IN_EVIDENCE = {"library, by fork", "FMI 3.0 controller, by fork", "FMI 2.0 device, its own state"}
"""Another of the same way or the same standard is in every run."""


@pytest.fixture
def steps(tmp_path, monkeypatch):
    """A function that reads the count."""
    path = tmp_path / "steps"
    path.write_bytes(bytes(8))
    monkeypatch.setenv("SEQSWEEP_STEPS", str(path))
    return lambda: int.from_bytes(path.read_bytes(), "little")


class Asked:
    """Steps that are asked of a plant: of every run, and of every operating point until it is settled."""

    def __init__(self, plant, times_first):
        self.steps, self._settled, self._times_first = 0, set(), times_first
        self._settle, self._run, self._listen = plant.settle, plant.run, getattr(plant, "run_phasors", None)
        plant.settle, plant.run = self.settle, self.run
        if self._listen:
            plant.run_phasors = self.run_phasors
        self._dt_s = plant.dt_s

    def settle(self, point, source):
        state = self._settle(point, source)
        if (point, source) not in self._settled:
            self.steps += round(state.time_s / self._dt_s) * (1 if self._settled else self._times_first)
            self._settled.add((point, source))
        return state

    def run(self, jobs, n_steps):
        self.steps += len(jobs) * n_steps
        return self._run(jobs, n_steps)

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        self.steps += len(jobs) * block_steps * n_blocks
        return self._listen(jobs, windows, block_steps, n_blocks)


@pytest.mark.parametrize(
    "box", [pytest.param(box, marks=pytest.mark.evidence) if box in IN_EVIDENCE else box for box in BOXES]
)
def test_a_sweep_in_rounds_takes_the_steps_that_it_asks_for_and_no_other(tmp_path, steps, box):
    """Four operating points, each come back to twice, as an adaptive sweep does."""
    make, times_first = BOXES[box]
    plant = make(tmp_path)
    asked, before = Asked(plant, times_first), steps()
    rounds = [[90.0, 130.0], [170.0, 210.0]]
    points = [{"active_power_mw": p, "terminal_voltage_pu": 1.0} for p in (0.2, 0.3, 0.4, 0.5)]
    for f_hz in rounds:
        for point in points:
            for batch in planned(plant, f_hz=f_hz, point=point, sweep={"tolerance": 1e-3}).batches():
                assert {row.status for row in measure(plant, batch).rows} == {"ok"}
    assert asked.steps > 0
    assert steps() - before == asked.steps
