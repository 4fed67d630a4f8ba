"""A farm in time: every device with its own estimator and damping control, a line that is watched, what happens to it.

`simulate_farm` drives devices that are stepped together (`Together`) through a `FarmScenario` and looks at all currents
every 2 ms. Grid-side dampers start when the resonance of the line's current has lasted, by the same rules as the
devices' control, or when they are told to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np

from ..circuits.circuit import Circuit
from ..circuits.dynamics import Fault as NodeFault
from ..errors import SeqsweepError
from ..protocol import Compensation, FarmConditions, FarmTrace, Record, Together, Trace
from . import control
from .control import DampingSettings, DampingState, Measurement
from .estimator import SAMPLE_S
from .events import FaultKind, Trajectory, fault_conductance, remembered, steps_of, switched_on, trajectory_of


@dataclass(frozen=True, slots=True)
class NetworkStep:
    """From ``time_s`` on the network is another, or other devices are connected to it.

    Attributes
    ----------
    time_s : float
        When (s).
    circuit : Circuit
        The network.
    connected : (n,) tuple of bool
        Which devices are.
    voltages_v : (n,) tuple of complex
        Terminal voltages (V) of a load flow with them: where devices that are put in service begin.
    what : str
        In words.
    sizes : (n,) tuple of float
        What the devices' factors are multiplied with; empty: one.
    """

    time_s: float
    circuit: Circuit
    connected: tuple[bool, ...]
    voltages_v: tuple[complex, ...]
    what: str
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class BusFault:
    """A short circuit at a node through ``r_ohm`` per faulted phase (b-c: between the phases)."""

    time_s: float
    duration_s: float
    node: str
    kind: FaultKind
    r_ohm: float


@dataclass(frozen=True, slots=True)
class DevicePower:
    """From ``time_s`` on a device's law for its power is that of ``active_power_w``, as in `events.PowerStep`."""

    time_s: float
    device: int
    active_power_w: float


FarmEvent = NetworkStep | BusFault | DevicePower


@dataclass(frozen=True, slots=True)
class FarmScenario:
    """A farm, where it stands at the beginning, and what happens to it.

    Attributes
    ----------
    circuit : Circuit
        The network.
    source_v : float
        Voltage of its ideal source (V, line-to-line RMS).
    connected : (n,) tuple of bool
        Devices in service.
    voltages_v : (n,) tuple of complex
        Terminal voltages (V) of the load flow.
    line : (str, str)
        The node and the branch whose voltage and current are watched as the farm's.
    line_peak_v : float
        Rated phase peak of that voltage (V).
    events : tuple of FarmEvent
        In any order; faults must not overlap.
    """

    circuit: Circuit
    source_v: float
    connected: tuple[bool, ...]
    voltages_v: tuple[complex, ...]
    line: tuple[str, str]
    line_peak_v: float
    events: tuple[FarmEvent, ...] = ()


@dataclass(frozen=True, slots=True)
class FarmControl:
    """Damping control of a farm.

    Attributes
    ----------
    devices : (n,) tuple of DampingSettings or None
        Each device's own; None leaves its port alone.
    dampers : int
        How many grid-side dampers there are.
    on_from_s : float or None
        Everything is switched on at this time, whatever its own logic says.
    """

    devices: tuple[DampingSettings | None, ...]
    dampers: int = 0
    on_from_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FarmTrajectory:
    """What happened: every device, and the farm's line (current towards the farm)."""

    devices: tuple[Trajectory, ...]
    line: Trajectory

    @property
    def lost_s(self) -> float | None:
        """When the first device lost synchronism (s)."""
        return min((each.lost_s for each in self.devices if each.lost_s is not None), default=None)


@dataclass(frozen=True, slots=True)
class _Port:
    """What looks at one current: what it is set to, and the scale of its voltage."""

    settings: DampingSettings
    acts: bool
    peak_v: float


CauseGone = Callable[[FarmConditions], bool]
"""Whether the farm is stable without damping in given conditions."""


def simulate_farm(
    farm: Together,
    scenario: FarmScenario,
    control_of: FarmControl | None,
    duration_s: float,
    cause_gone: CauseGone | None = None,
) -> FarmTrajectory:
    """Drive a farm through a scenario.

    Parameters
    ----------
    farm : Together
        The devices.
    scenario : FarmScenario
        Where it begins and what happens.
    control_of : FarmControl or None
        Damping control; None leaves all ports alone, resonances are watched all the same.
    duration_s : float
        Simulated time (s).
    cause_gone : callable, optional
        Says for given conditions whether the farm is stable in them without damping; asked when the conditions change,
        and never during a fault. All damping control stops where it says yes, and none starts.

    Raises
    ------
    SeqsweepError
        If the step does not divide 2 ms, or faults overlap.
    """
    n_block, n_blocks = steps_of(SAMPLE_S, farm.dt_s), steps_of(duration_s, SAMPLE_S)
    _check_faults(scenario)
    ports = _ports(farm, scenario, control_of)
    conditions = conditions_at(farm, scenario, 0.0)
    state = farm.at_rest(_as_started(farm, scenario), np.array(scenario.voltages_v))
    memories = _memories_at_rest(farm, state, scenario, ports)
    pieces: list[list[Trace]] = [[] for _ in ports]
    kept: list[list[DampingState]] = [[] for _ in ports]
    verdict = remembered(cause_gone, lambda conditions: conditions.fault is not None)
    for block in range(n_blocks):
        time_s = block * SAMPLE_S
        if control_of is not None and control_of.on_from_s is not None and time_s >= control_of.on_from_s - 1e-9:
            memories = [
                switched_on(port.settings, memory) if port.acts else memory
                for port, memory in zip(ports, memories, strict=True)
            ]
        traced: list[list[Trace]] = [[] for _ in ports]
        for now, n_steps in _stretches(farm, scenario, block * n_block, n_block):
            if new := _newcomers(farm, conditions, now):
                state = farm.joined(state, now, new, np.array(_voltages_at(scenario, time_s + SAMPLE_S)))
            conditions = now
            state, trace = farm.trace(state, _controlled(now, ports, memories), n_steps)
            for of, each in zip(traced, _all_traces(farm, trace), strict=True):
                of.append(each)
        for of, new_pieces in zip(pieces, traced, strict=True):
            of += new_pieces
        if not all(np.isfinite(of[-1].record.v[-1]) for of in traced):
            break
        gone = verdict(conditions_at(farm, scenario, time_s + SAMPLE_S))
        memories = [
            control.decide(port.settings, memory, _measured(port, of, time_s + SAMPLE_S, gone))
            for port, memory, of in zip(ports, memories, traced, strict=True)
        ]
        for of_port, memory in zip(kept, memories, strict=True):
            of_port.append(memory)
    n = n_blocks * n_block
    found = [trajectory_of(farm, of, each, n, port.acts) for of, each, port in zip(pieces, kept, ports, strict=True)]
    return FarmTrajectory(tuple(found[:-1]), found[-1])


def conditions_at(farm: Together, scenario: FarmScenario, time_s: float) -> FarmConditions:
    """What surrounds the farm from ``time_s`` on, without its control."""
    n = len(farm.members)
    circuit, connected, fault, power = scenario.circuit, scenario.connected, None, [1.0] * n
    sizes: tuple[float, ...] = ()
    for event in sorted(scenario.events, key=lambda each: each.time_s):
        if event.time_s > time_s + 1e-9:
            continue
        match event:
            case NetworkStep():
                circuit, connected, sizes = event.circuit, event.connected, event.sizes
            case DevicePower():
                power[event.device] = event.active_power_w / farm.members[event.device].active_power_w
            case BusFault():
                over = event.time_s + event.duration_s <= time_s + 1e-9
                fault = None if over else NodeFault(event.node, fault_conductance(event.kind, event.r_ohm))
    node, branch = scenario.line
    return FarmConditions(
        circuit=circuit,
        source_v=scenario.source_v,
        connected=connected,
        power_scale=tuple(power),
        compensation=(Compensation(),) * n,
        fault=fault,
        watch=(("v", node), ("i", branch)),
        sizes=sizes,
    )


# ---------------------------------------------------------------------- pieces


def _as_started(farm: Together, scenario: FarmScenario) -> FarmConditions:
    return _with_dampers(conditions_at(farm, replace(scenario, events=()), 0.0), farm, False)


def _with_dampers(conditions: FarmConditions, farm: Together, on: bool) -> FarmConditions:
    return replace(conditions, dampers_on=(on,) * len(farm.dampers))


def _check_faults(scenario: FarmScenario) -> None:
    faults = sorted((e for e in scenario.events if isinstance(e, BusFault)), key=lambda fault: fault.time_s)
    for first, second in pairwise(faults):
        if second.time_s < first.time_s + first.duration_s:
            raise SeqsweepError(f"the faults at {first.time_s:g} s and {second.time_s:g} s overlap; give one at a time")


def _ports(farm: Together, scenario: FarmScenario, control_of: FarmControl | None) -> list[_Port]:
    """Every device's port, then the line's."""
    watch = DampingSettings(k=0.0, r_ohm=0.0, l_h=0.0, resonance_hz=None, f1_hz=farm.f1_hz)
    given = control_of.devices if control_of is not None else (None,) * len(farm.members)
    devices = [_Port(each or watch, each is not None, farm.rating.peak_voltage_v) for each in given]
    line = _Port(watch, bool(control_of is not None and control_of.dampers), scenario.line_peak_v)
    return [*devices, line]


def _controlled(conditions: FarmConditions, ports: Sequence[_Port], memories: Sequence[DampingState]) -> FarmConditions:
    """The conditions with what the controls decided last."""
    told = tuple(
        control.output(port.settings, memory) if port.acts else Compensation()
        for port, memory in zip(ports[:-1], memories[:-1], strict=True)
    )
    on = ports[-1].acts and memories[-1].acts
    return replace(conditions, compensation=told, dampers_on=(on,) * len(conditions.dampers_on))


def _all_traces(farm: Together, trace: FarmTrace) -> list[Trace]:
    """The devices' traces and the line's; what is not connected is silent."""
    quiet = [_silent(each) for each in trace.devices]
    v, i = trace.watched[:, 0], trace.watched[:, 1]
    first = trace.devices[0].record
    nothing = np.zeros(len(v))
    line = Trace(Record(first.t0_s, farm.dt_s, v, -i, farm.f1_hz), nothing, nothing, nothing)
    return [*quiet, line]


def _silent(trace: Trace) -> Trace:
    """A trace of a device that is not connected has no voltage and no current, and loses no synchronism."""
    if not np.all(np.isnan(trace.sync_rad)) or len(trace.sync_rad) == 0:
        return trace
    nothing = np.zeros(len(trace.sync_rad))
    record = replace(trace.record, v=nothing + 0j, i=nothing + 0j)
    return Trace(record, nothing, nothing, nothing)


def _memories_at_rest(farm: Together, state: Any, scenario: FarmScenario, ports: Sequence[_Port]) -> list[DampingState]:
    """Memories of ports that have been where they are for a long time; see `events`."""
    _, trace = farm.trace(state, _as_started(farm, scenario), 1)
    early = np.exp(-1j * pi * farm.f1_hz * farm.dt_s)
    return [
        control.at_rest(0.0, early * of.record.v[0] / port.peak_v, early * of.record.i[0], farm.f1_hz)
        for port, of in zip(ports, _all_traces(farm, trace), strict=True)
    ]


def _measured(port: _Port, traces: Sequence[Trace], time_s: float, cause_gone: bool) -> Measurement:
    v, i = (np.mean(np.concatenate([getattr(t.record, name) for t in traces])) for name in ("v", "i"))
    return Measurement(time_s, complex(v) / port.peak_v, complex(i), cause_gone)


def _stretches(
    farm: Together, scenario: FarmScenario, first: int, n_steps: int
) -> Iterator[tuple[FarmConditions, int]]:
    """The block's stretches of constant conditions, with their numbers of steps."""
    times = [event.time_s for event in scenario.events]
    times += [event.time_s + event.duration_s for event in scenario.events if isinstance(event, BusFault)]
    changes = {round(t / farm.dt_s) for t in times}
    borders = sorted({first, first + n_steps, *(step for step in changes if first < step < first + n_steps)})
    for start, end in pairwise(borders):
        yield _with_dampers(conditions_at(farm, scenario, (start + 0.5) * farm.dt_s), farm, False), end - start


def _newcomers(farm: Together, before: FarmConditions, now: FarmConditions) -> list[str]:
    """Names of the devices that have been put in service."""
    pairs = zip(farm.members, before.connected, now.connected, strict=True)
    return [member.name for member, was, is_now in pairs if is_now and not was]


def _voltages_at(scenario: FarmScenario, time_s: float) -> tuple[complex, ...]:
    steps = [event for event in scenario.events if isinstance(event, NetworkStep) and event.time_s < time_s]
    return max(steps, key=lambda event: event.time_s).voltages_v if steps else scenario.voltages_v
