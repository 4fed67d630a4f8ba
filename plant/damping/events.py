"""A device in time: grid steps, faults, wind and power steps, with and without damping control.

`simulate` drives any plant with a measurement port (`MeasuredPlant`) through a `Scenario` and looks
at its current all 2 ms, as the damping control would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, pi
from typing import Any, Literal, TypeVar

import numpy as np

from ..circuits.circuit import Circuit
from ..circuits.dynamics import SOUND
from ..errors import SeqsweepError
from ..protocol import Compensation, Conditions, MeasuredPlant, OperatingPoint, Plant, Source, Together, Trace
from . import control
from .control import DampingSettings, DampingState, Measurement
from .estimator import SAMPLE_S, Resonance, block_means, matrix_pencil

FaultKind = Literal["a-b-c", "a-g", "b-c", "b-c-g"]
Where = TypeVar("Where")  # conditions of a device, or of a farm


@dataclass(frozen=True, slots=True)
class GridStep:
    """From ``time_s`` on the grid has ``scale`` times the scenario's impedance."""

    time_s: float
    scale: float


@dataclass(frozen=True, slots=True)
class TurbineStep:
    """From ``time_s`` on ``count`` equal turbines share the grid; see `Scenario.turbines`."""

    time_s: float
    count: float


@dataclass(frozen=True, slots=True)
class Fault:
    """A short circuit at the PCC through ``r_ohm`` per faulted phase (b-c: between the phases)."""

    time_s: float
    duration_s: float
    kind: FaultKind
    r_ohm: float = 0.01


@dataclass(frozen=True, slots=True)
class WindStep:
    """From ``time_s`` on the wind blows at ``wind_m_s``."""

    time_s: float
    wind_m_s: float


@dataclass(frozen=True, slots=True)
class PowerStep:
    """From ``time_s`` on the power reference is that of ``active_power_w`` at the initial rotor speed.

    The device's law for its power is scaled by ``active_power_w`` over the initial power; as the rotor
    then changes speed, power follows the scaled law.
    """

    time_s: float
    active_power_w: float


@dataclass(frozen=True, slots=True)
class CircuitStep:
    """From ``time_s`` on the grid's elements are those of ``circuit``; ``what`` says so in words."""

    time_s: float
    circuit: Circuit
    what: str


Event = GridStep | TurbineStep | Fault | WindStep | PowerStep | CircuitStep


@dataclass(frozen=True, slots=True)
class Scenario:
    """One device on one grid, and what happens to it.

    Attributes
    ----------
    active_power_w : float
        Active power at the beginning (W); the state is the periodic one, stable or not.
    r_ohm, l_h : float
        Series impedance of the grid as one turbine sees it (ohm, H), at scale 1.
    source_voltage_v : float
        Fixed voltage behind it, line-to-line RMS (V).
    events : tuple of Event
        In any order; faults must not overlap.
    scale : float
        Factor on the impedance at the beginning.
    turbines : float
        Equal turbines that share the grid at the beginning; with n of them each sees n / ``turbines``
        times the impedance. One aggregated turbine stands for all: it is *per turbine* throughout.
    reactive_power_var : float
        Reactive power out of the device at the beginning (var).
    circuit : Circuit or None
        Elements between device and source, in place of R and L, which then say what the device sees at f1.
    """

    active_power_w: float
    r_ohm: float
    l_h: float
    source_voltage_v: float
    events: tuple[Event, ...] = ()
    scale: float = 1.0
    turbines: float = 1.0
    reactive_power_var: float = 0.0
    circuit: Circuit | None = None

    def __post_init__(self) -> None:
        faults = sorted((e for e in self.events if isinstance(e, Fault)), key=lambda fault: fault.time_s)
        for event in self.events:
            _check_event(event)
        for first, second in pairwise(faults):
            if second.time_s < first.time_s + first.duration_s:
                raise SeqsweepError(
                    f"the faults at {first.time_s:g} s and {second.time_s:g} s overlap; give one at a time"
                )
        if not (self.scale > 0.0 and self.turbines > 0.0):
            raise SeqsweepError(f"scale and turbines must be positive; got {self.scale:g} and {self.turbines:g}")


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """What happened. Space vectors are phase-peak, current in load direction.

    Attributes
    ----------
    time_s : (n,) float
        Times (s) of the waveforms; NaN follows where the device left the numbers.
    v, i : (n,) complex
        PCC voltage (V) and current (A).
    v_dc_v, rotor_rad_s, sync_rad : (n,) float
        DC link (V), rotor speed (rad/s), synchronisation ahead of the source voltage (rad).
    f1_hz : float
        Fundamental (Hz).
    decision_s : (m,) float
        Times (s) of the estimates and decisions below, every 2 ms.
    resonance : (m,) tuple of Resonance
        Estimates over the 150 ms before; NaN while blocked or not yet full again.
    blocked, active : (m,) bool
        |v_pcc| too low to judge; damping control started and not yet stopped.
    lost_s : float or None
        When the PLL, or what stands for it in ``sync_rad``, was half a turn from the source: synchronism lost (s).
    """

    time_s: np.ndarray
    v: np.ndarray
    i: np.ndarray
    v_dc_v: np.ndarray
    rotor_rad_s: np.ndarray
    sync_rad: np.ndarray
    f1_hz: float
    decision_s: np.ndarray
    resonance: tuple[Resonance, ...]
    blocked: np.ndarray
    active: np.ndarray
    lost_s: float | None

    @property
    def p_w(self) -> np.ndarray:
        """Active power out of the device at the PCC (W)."""
        return -1.5 * (self.v * self.i.conj()).real

    @property
    def q_var(self) -> np.ndarray:
        """Reactive power out of the device at the PCC (var)."""
        return -1.5 * (self.v * self.i.conj()).imag

    @property
    def ratio(self) -> np.ndarray:
        """r(t) = A_r / A_0 at the decisions."""
        return np.array([found.ratio for found in self.resonance])

    @property
    def resonance_hz(self) -> np.ndarray:
        """Signed frequency of the stronger component at the decisions (Hz)."""
        return np.array([found.f_hz for found in self.resonance])

    @property
    def resonance_a(self) -> np.ndarray:
        """Magnitude A_r of the stronger component at the decisions (A, phase peak)."""
        return np.array([found.amplitude for found in self.resonance])

    @property
    def mirror_a(self) -> np.ndarray:
        """Magnitude of its mirror at 2 f1 - f at the decisions (A, phase peak)."""
        return np.array([found.mirror for found in self.resonance])

    @property
    def growth_per_s(self) -> np.ndarray:
        """Its growth at the decisions (1/s)."""
        return np.array([found.growth_per_s for found in self.resonance])

    @property
    def started_s(self) -> tuple[float, ...]:
        """When damping control started (s)."""
        return tuple(self.decision_s[np.flatnonzero(np.diff(self.active.astype(int), prepend=0) == 1)].tolist())

    @property
    def stopped_s(self) -> tuple[float, ...]:
        """When damping control stopped (s)."""
        return tuple(self.decision_s[np.flatnonzero(np.diff(self.active.astype(int), prepend=0) == -1)].tolist())


def simulate(
    plant: Plant,
    scenario: Scenario,
    damping: DampingSettings | None,
    duration_s: float,
    *,
    on_from_s: float | None = None,
    cause_gone: Callable[[Conditions], bool] | None = None,
) -> Trajectory:
    """Drive ``plant`` through ``scenario``.

    Parameters
    ----------
    plant : Plant
        One with a measurement port (`MeasuredPlant`).
    scenario : Scenario
        Where it begins and what happens.
    damping : DampingSettings or None
        The damping control; None leaves the port alone, the resonance is watched all the same.
    duration_s : float
        Simulated time (s).
    on_from_s : float, optional
        Switch damping on at this time, whatever its own logic says.
    cause_gone : callable, optional
        Says for given conditions whether the device is stable on them without damping; asked when the
        conditions change, and never during a fault. Damping control stops where it says yes.

    Raises
    ------
    SeqsweepError
        If the plant has no measurement port, its step does not divide 2 ms, its own damping is on,
        its fundamental is not that of ``damping``, or it cannot do what an event asks; all before anything is run.
    NotSettled
        If there is no initial state.
    """
    port = _with_port(plant)
    n_block = steps_of(SAMPLE_S, port.dt_s)
    n_blocks = steps_of(duration_s, SAMPLE_S)
    settings = damping or replace(_WATCH, f1_hz=port.f1_hz)
    if settings.f1_hz != port.f1_hz:
        raise SeqsweepError(f"the damping control is set for {settings.f1_hz:g} Hz; {port.id} has {port.f1_hz:g} Hz")
    point = OperatingPoint(scenario.active_power_w, None, scenario.reactive_power_var)
    state = port.equilibrium(point, _source(scenario))
    _refuse_impossible(port, state, scenario, duration_s)
    memory = _memory_at_rest(port, state, scenario, settings)
    pieces: list[Trace] = []
    memories: list[DampingState] = []
    verdict = remembered(cause_gone, lambda conditions: any(conditions.fault_s))
    for block in range(n_blocks):
        time_s = block * SAMPLE_S
        if on_from_s is not None and damping is not None and time_s >= on_from_s - 1e-9:
            memory = switched_on(settings, memory)
        compensation = control.output(settings, memory) if damping else None
        traces = []
        for conditions, n_steps in _stretches(scenario, block * n_block, n_block, port.dt_s):
            state, trace = port.trace(state, replace(conditions, compensation=compensation), n_steps)
            traces.append(trace)
        pieces += traces
        if not np.isfinite(traces[-1].v_dc_v[-1]):
            break
        gone = verdict(conditions_at(scenario, time_s + SAMPLE_S))
        memory = control.decide(settings, memory, _measured(port, traces, time_s + SAMPLE_S, gone))
        memories.append(memory)
    return trajectory_of(port, pieces, memories, n_blocks * n_block, damping is not None)


def conditions_at(scenario: Scenario, time_s: float) -> Conditions:
    """What surrounds the device from ``time_s`` on, until the next event."""
    past = sorted((e for e in scenario.events if e.time_s <= time_s + 1e-9), key=lambda event: event.time_s)
    scale, turbines, wind_m_s, power_w = scenario.scale, scenario.turbines, None, scenario.active_power_w
    fault_s, circuit = SOUND, scenario.circuit
    for event in past:
        match event:
            case GridStep():
                scale = event.scale
            case TurbineStep():
                turbines = event.count
            case WindStep():
                wind_m_s = event.wind_m_s
            case PowerStep():
                power_w = event.active_power_w
            case CircuitStep():
                circuit = event.circuit
            case Fault():
                over = event.time_s + event.duration_s <= time_s + 1e-9
                fault_s = SOUND if over else fault_conductance(event.kind, event.r_ohm)
    factor = scale * turbines / scenario.turbines
    return Conditions(
        r_ohm=factor * scenario.r_ohm,
        l_h=factor * scenario.l_h,
        fault_s=fault_s,
        wind_m_s=wind_m_s,
        power_scale=1.0 if power_w == scenario.active_power_w else power_w / scenario.active_power_w,
        circuit=None if circuit is None else circuit.scaled(factor),
    )


def source_of(conditions: Conditions, voltage_v: float) -> Source:
    """What feeds the device under conditions, with ``voltage_v`` (V, line-to-line RMS) behind it."""
    kind: Literal["thevenin", "network"] = "thevenin" if conditions.circuit is None else "network"
    return Source(kind, conditions.r_ohm, conditions.l_h, voltage_v=voltage_v, circuit=conditions.circuit)


def fault_conductance(kind: FaultKind, r_ohm: float) -> tuple[float, float, float]:
    """Conductance on (alpha, beta) of a short circuit: alpha-alpha, alpha-beta, beta-beta (S).

    Three wires: the fault's zero-sequence current closes through ground and meets no voltage, v_0 = 0.
    A conductance g from phase a to ground draws i_alpha = 2/3 g v_alpha; b and c to ground draw
    i_alpha = 1/3 g v_alpha and i_beta = g v_beta; g between b and c draws i_beta = 2 g v_beta.
    """
    g = 1.0 / r_ohm
    per_kind: dict[FaultKind, tuple[float, float, float]] = {
        "a-b-c": (g, 0.0, g),
        "a-g": (2.0 / 3.0 * g, 0.0, 0.0),
        "b-c": (0.0, 0.0, 2.0 * g),
        "b-c-g": (1.0 / 3.0 * g, 0.0, g),
    }
    return per_kind[kind]


def resonance_between(trajectory: Trajectory, from_s: float, to_s: float) -> Resonance:
    """Resonance of the current between two times; the amplitudes are those at ``to_s``."""
    first, last = np.searchsorted(trajectory.time_s, (from_s - 1e-9, to_s - 1e-9))
    n_block = steps_of(SAMPLE_S, float(trajectory.time_s[1] - trajectory.time_s[0]))
    return matrix_pencil(block_means(trajectory.i[first:last], n_block), SAMPLE_S, trajectory.f1_hz)


# ---------------------------------------------------------------------- pieces of a simulation


_WATCH = DampingSettings(k=0.0, r_ohm=0.0, l_h=0.0, resonance_hz=None)


def _check_event(event: Event) -> None:
    if not 0.0 <= event.time_s < inf:
        raise SeqsweepError(f"an event needs a time from 0 s on; got {event.time_s:g} s")
    for name in ("scale", "count", "wind_m_s", "active_power_w", "r_ohm", "duration_s"):
        value = getattr(event, name, 1.0)
        if not 0.0 < value < inf:
            raise SeqsweepError(f"{name} of the event at {event.time_s:g} s must be positive; got {value:g}")
    if isinstance(event, Fault) and event.kind not in ("a-b-c", "a-g", "b-c", "b-c-g"):
        raise SeqsweepError(f"unknown kind of fault {event.kind!r}; known are 'a-b-c', 'a-g', 'b-c', 'b-c-g'")


def _with_port(plant: Plant) -> MeasuredPlant:
    if not isinstance(plant, MeasuredPlant):
        raise SeqsweepError(
            f"{plant.id} has no measurement port: damping control and events need one, see MeasuredPlant"
        )
    if plant.compensation != Compensation():
        raise SeqsweepError(f"{plant.id} was made with damping_gain > 0; give DampingSettings to simulate instead")
    return plant


def steps_of(duration_s: float, step_s: float) -> int:
    """Steps in a duration, which must be a whole number of them."""
    n = round(duration_s / step_s)
    if n < 1 or abs(n * step_s - duration_s) > 1e-6 * step_s:
        raise SeqsweepError(f"{duration_s:g} s is not a whole number of steps of {step_s:g} s")
    return n


def _source(scenario: Scenario) -> Source:
    return source_of(conditions_at(replace(scenario, events=()), 0.0), scenario.source_voltage_v)


def _stretches(scenario: Scenario, first: int, n_steps: int, dt_s: float) -> Iterator[tuple[Conditions, int]]:
    """The block's stretches of constant conditions, with their numbers of steps."""
    ends = [event.time_s + getattr(event, "duration_s", 0.0) for event in scenario.events]
    changes = {round(t / dt_s) for t in [*(event.time_s for event in scenario.events), *ends]}
    borders = sorted({first, first + n_steps, *(step for step in changes if first < step < first + n_steps)})
    for start, end in pairwise(borders):
        yield conditions_at(scenario, (start + 0.5) * dt_s), end - start


def _refuse_impossible(port: MeasuredPlant, state: Any, scenario: Scenario, duration_s: float) -> None:
    """Ask for one step under all that is to come: what the device cannot do, it says at once."""
    times_s = {event.time_s for event in scenario.events if event.time_s < duration_s}
    for conditions in dict.fromkeys(conditions_at(scenario, time_s) for time_s in sorted(times_s)):
        port.trace(state, conditions, 1)


def _memory_at_rest(port: MeasuredPlant, state: Any, scenario: Scenario, settings: DampingSettings) -> DampingState:
    """Memory of a device that has been in its initial state for a long time.

    The samples of a block lie half a step before its middle on average.
    """
    _, trace = port.trace(state, conditions_at(replace(scenario, events=()), 0.0), 1)
    early = np.exp(-1j * pi * port.f1_hz * port.dt_s)
    v, i = early * trace.record.v[0], early * trace.record.i[0]
    return control.at_rest(0.0, v / port.rating.peak_voltage_v, i, settings.f1_hz)


def _measured(port: MeasuredPlant, traces: list[Trace], time_s: float, cause_gone: bool) -> Measurement:
    v, i = (np.mean(np.concatenate([getattr(t.record, name) for t in traces])) for name in ("v", "i"))
    return Measurement(time_s, complex(v) / port.rating.peak_voltage_v, complex(i), cause_gone)


def switched_on(settings: DampingSettings, memory: DampingState) -> DampingState:
    """The memory of a control that somebody has switched on."""
    if memory.active:
        return memory
    hz = memory.resonance.f_hz if settings.resonance_hz is None else settings.resonance_hz
    return replace(memory, active=True, resonance_hz=hz)


def remembered(
    cause_gone: Callable[[Where], bool] | None, in_fault: Callable[[Where], bool]
) -> Callable[[Where], bool]:
    """The injected check, asked once for each set of conditions; it is False in a fault, and if none was injected."""
    answers: dict[Where, bool] = {}

    def answer(conditions: Where) -> bool:
        if cause_gone is None or in_fault(conditions):
            return False
        if conditions not in answers:
            answers[conditions] = bool(cause_gone(conditions))
        return answers[conditions]

    return answer


def trajectory_of(
    port: MeasuredPlant | Together, pieces: list[Trace], memories: list[DampingState], n_samples: int, damped: bool
) -> Trajectory:
    """Pieces of waveforms and the memories at the decisions, as one; what is missing at the end is not a number."""

    def joined(name: str) -> np.ndarray:
        x = np.concatenate([getattr(t, name) if hasattr(t, name) else getattr(t.record, name) for t in pieces])
        return np.concatenate([x, np.full(n_samples - len(x), np.nan, x.dtype)])

    sync_rad = joined("sync_rad")
    lost = np.flatnonzero(~(np.abs(sync_rad) < pi))
    time_s = np.arange(n_samples) * port.dt_s
    return Trajectory(
        time_s=time_s,
        v=joined("v"),
        i=joined("i"),
        v_dc_v=joined("v_dc_v"),
        rotor_rad_s=joined("rotor_rad_s"),
        sync_rad=sync_rad,
        f1_hz=port.f1_hz,
        decision_s=SAMPLE_S * np.arange(1, len(memories) + 1),
        resonance=tuple(memory.resonance for memory in memories),
        blocked=np.array([memory.blocked for memory in memories], dtype=bool),
        active=np.array([damped and memory.active for memory in memories], dtype=bool),
        lost_s=float(time_s[lost[0]]) if len(lost) else None,
    )
