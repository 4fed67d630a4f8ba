"""A black box that cannot save its state, as a plant: dpsim's grid-following converter (EMT, 50 us).

dpsim can only go forwards from the start. So a state here is *how to get there*: the operating point
and everything injected since. `run` builds the simulation anew, waits until it has settled, replays
the past and only then records. Slow, but the same promise: the same job gives the same answer.

    pip install 'seqsweep[bench]'
    seqsweep run examples/dpsim_plant.toml -o build/dpsim.parquet
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from seqsweep.plant.protocol import (
    Injection,
    Job,
    NotSettled,
    OperatingPoint,
    OperatingRange,
    Rating,
    Record,
    Source,
)

F1_HZ, DT_S, U_V = 50.0, 50e-6, 400.0
PERIOD_STEPS = 400
PHASES = np.exp(-2j * np.pi * np.arange(3) / 3.0)  # a, b, c of a space vector: Re(x PHASES)


@dataclass(frozen=True)
class Replay:
    """A state: the operating point, steps until it had settled, what was injected since for how long."""

    operating_point: OperatingPoint
    settling_steps: int
    past: tuple[tuple[Injection | None, int], ...] = ()

    @property
    def time_s(self) -> float:
        return (self.settling_steps + sum(steps for _, steps in self.past)) * DT_S


class DpsimConverter:
    """The converter's terminals on an ideal source; reactive power is zero."""

    id = "python:dpsim-gfl"
    f1_hz, dt_s = F1_HZ, DT_S
    rating = Rating(U_V, 20e3)
    operating_range = OperatingRange((2e3, 15e3), (0.9 * U_V, 1.1 * U_V))
    power_meaning = "power reference of the converter's controller"

    def __init__(self, settled: float = 1e-7, patience_s: float = 5.0):
        if find_spec("dpsimpy") is None:
            raise ImportError("dpsim is not installed: pip install 'seqsweep[bench]'")
        self.settled, self.patience_s = settled, patience_s
        self.steps_spent: Counter[str] = Counter()  # a meter, read by the benchmark; no answer depends on it

    def settle(self, operating_point: OperatingPoint, source: Source) -> Replay:
        """Wait, period by period, until the current repeats; `NotSettled` when the patience is over."""
        if source.kind != "ideal" or operating_point.terminal_voltage_v is None:
            raise ValueError("this converter stands on an ideal source of given |v_pcc|")
        limits = self.operating_range
        given = operating_point.active_power_w, operating_point.terminal_voltage_v
        for value, (low, high) in zip(given, (limits.active_power_w, limits.terminal_voltage_v), strict=True):
            if not low <= value <= high:
                raise ValueError(f"{value:g} is outside the operating range, {low:g} to {high:g}")
        simulation, before = _Simulation(operating_point), None
        for period in range(1, round(self.patience_s * F1_HZ) + 1):
            _, i = simulation.advance(None, PERIOD_STEPS)
            self.steps_spent["settling"] += PERIOD_STEPS
            if before is not None and np.max(np.abs(i - before)) <= self.settled * np.max(np.abs(i)):
                return Replay(operating_point, period * PERIOD_STEPS)
            before = i
        raise NotSettled(f"the current still changes after {self.patience_s:g} s")

    def run(self, jobs: list[Job], n_steps: int) -> list[tuple[Replay, Record]]:
        """Every job from cold: settle, replay, record."""
        if any(job.injection and job.injection.kind == "shunt_current" for job in jobs):
            raise ValueError("shunt_current changes nothing at a PCC that an ideal source holds")
        return [self._run(job.state, job.injection, n_steps) for job in jobs]

    def _run(self, state: Replay, injection: Injection | None, n_steps: int) -> tuple[Replay, Record]:
        simulation = _Simulation(state.operating_point)
        for past, steps in ((None, state.settling_steps), *state.past):
            simulation.advance(past, steps)
            self.steps_spent["replaying"] += steps
        v, i = simulation.advance(injection, n_steps)
        self.steps_spent["recording"] += n_steps
        end = replace(state, past=(*state.past, (injection, n_steps)))
        return end, Record(state.time_s, DT_S, v, i, F1_HZ, "load", self.id)


class _Simulation:
    """dpsim from the start, stepped from here: set the source, step, read the current."""

    def __init__(self, operating_point: OperatingPoint):
        assert operating_point.terminal_voltage_v is not None
        self.peak_v = (2.0 / 3.0) ** 0.5 * operating_point.terminal_voltage_v
        self.step = 0
        self.simulation, self.converter, self.source = _built(operating_point)
        self.simulation.start()

    def advance(self, injection: Injection | None, n_steps: int) -> tuple[np.ndarray, np.ndarray]:
        """v and i (load direction) of ``n_steps`` samples; the source acts one step ahead of the solution."""
        t = (self.step + np.arange(n_steps)) * DT_S
        v = self.peak_v * np.exp(2j * np.pi * F1_HZ * t)
        for tone in injection.tones if injection else ():
            v += tone.amplitude * np.exp(1j * (2 * np.pi * tone.f_hz * t + tone.phase_rad))
        v_abc = (v[:, None] * PHASES).real
        i_abc = np.empty((n_steps, 3))
        reference, current = self.source.attr("V_ref"), self.converter.attr("i_intf")
        for k in range(n_steps):
            reference.set(v_abc[k].reshape(3, 1))
            self.simulation.next()
            i_abc[k] = current.get().ravel()
        self.step += n_steps
        return v, i_abc @ (2.0 / 3.0 * PHASES.conj())


def alone(operating_point: OperatingPoint, duration_s: float) -> Any:
    """A simulation that dpsim runs by itself for ``duration_s``, fed by its own sinusoidal source."""
    return _built(operating_point, duration_s, own_source=True)[0]


def _built(operating_point: OperatingPoint, duration_s: float = 1e9, own_source: bool = False) -> tuple[Any, Any, Any]:
    """Simulation, converter and source: two components at one node."""
    import dpsimpy

    emt, off = dpsimpy.emt, dpsimpy.LogLevel.off
    os.environ.setdefault("CPS_LOG_DIR", tempfile.gettempdir())  # its logs need not lie beside the table
    u = operating_point.terminal_voltage_v
    pcc = emt.SimNode("pcc", dpsimpy.PhaseType.ABC)
    pcc.set_initial_voltage(u * PHASES)
    if own_source:
        source = emt.ph3.VoltageSource("source", off)
        source.set_parameters((2.0 / 3.0) ** 0.5 * u * PHASES.reshape(3, 1), F1_HZ)
    else:
        source = emt.ph3.ControlledVoltageSource("source")
        source.set_parameters(np.zeros((3, 1)))
    source.connect([emt.SimNode.gnd, pcc])
    converter = emt.ph3.GFL("converter", off)
    converter.set_parameters(2 * np.pi * F1_HZ, U_V, operating_point.active_power_w, 0.0)
    converter.set_controller_parameters(0.25, 0.2, 0.05, 0.2, 0.25, 1.0, 2 * np.pi * F1_HZ)
    converter.set_filter_parameters(2e-3, 10e-6, 0.2)
    converter.with_control(True)
    converter.connect([pcc])
    system = dpsimpy.SystemTopology(F1_HZ, [pcc], [source, converter])
    simulation = dpsimpy.Simulation("dpsim_plant", off)
    simulation.set_system(system)
    simulation.set_domain(dpsimpy.Domain.EMT)
    simulation.set_solver(dpsimpy.Solver.MNA)
    simulation.do_init_from_nodes_and_terminals(True)
    simulation.set_time_step(DT_S)
    simulation.set_final_time(duration_s)
    return simulation, converter, source
