"""The turbine behind a network of elements: its shunt joins the network, which is fed the converter's current."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..circuits.branches import GROUND, Branch
from ..circuits.circuit import PCC, Circuit
from ..circuits.dynamics import SOUND, Conductance, Fault, Turning
from ..circuits.feeding import Feeding, feeding_of
from ..injection import series_tones, turns
from ..lanes import set_complex
from ..protocol import Job, Source
from ..space_vectors import PHASE_PEAK
from .parameters import TurbineParameters
from .state import TurbineState

SHUNT = "shunt of the device"


class Thevenin(NamedTuple):
    """A grid as the PCC sees it at f1: R, L (negative where it is capacitive), and the no-load gain of its source."""

    r_ohm: float
    l_h: float
    gain: complex = 1.0 + 0j


def thevenin_of(source: Source, w1_rad_s: float) -> Thevenin:
    """Impedance and gain of a source at the fundamental."""
    if source.circuit is None:
        return Thevenin(source.r_ohm, source.l_h)
    z, gain = source.circuit.seen_at(1j * w1_rad_s)
    return Thevenin(z.real, z.imag / w1_rad_s, gain)


def shunt_of(p: TurbineParameters, node: str = PCC, name: str = SHUNT) -> Branch:
    """Rf and Cf of the turbine at a node."""
    return Branch(name, {node: 1.0, GROUND: -1.0}, p.r_f_ohm, 0.0, p.c_f_f)


def feeding(circuit: Circuit, p: TurbineParameters, step_s: float, fault_s: Conductance = SOUND) -> Feeding:
    """The network with the turbine's shunt; ``fault_s`` is a conductance at the PCC."""
    fault = Fault(PCC, fault_s) if any(fault_s) else None
    branches = (*circuit.branches, shunt_of(p))
    return feeding_of(branches, (PCC,), (SHUNT,), p.w1_rad_s, step_s, circuit.source_ratio, fault)


def at_rest(state: TurbineState, p: TurbineParameters, step_s: float) -> TurbineState:
    """A turbine's steady ``state`` with what its network remembers of it."""
    current = np.array([complex(state.values[0], state.values[1])])
    assert state.source.circuit is not None
    return replace(state, memory=feeding(state.source.circuit, p, step_s).at_rest(state.v_source, current))


class Forced(NamedTuple):
    """Something that sources hold for ever: its frequency in the dq frame, PCC voltage and current out of the turbine.

    ``f_hz`` in Hz, ``v`` in V and ``i`` in A at time zero.
    """

    f_hz: float
    v: complex
    i: complex


class Surroundings(NamedTuple):
    """A lane's network in the middle of its way: how it is stepped, what its source forces, and what tones do."""

    feeding: Feeding
    source: tuple[Turning, ...]
    tones: tuple[Turning, ...]
    series: tuple[tuple[float, complex], ...]

    def states(self, state: TurbineState) -> np.ndarray:
        """(m,) from what the turbine's state remembers."""
        assert state.memory is not None
        return self.feeding.entered(state.memory, (*self.source, *self.tones), state.time_s, state.v_source)

    def forced(self, f1_hz: float) -> list[Forced]:
        """The source's parts, then the tones."""
        held = [
            Forced(turning.w_rad_s / (2.0 * np.pi), *map(complex, self.feeding.shown(turning)))
            for turning in (*self.source, *self.tones)
        ]
        n = len(self.source)
        toned = [
            Forced(f_hz - f1_hz, each.v + e, each.i) for each, (f_hz, e) in zip(held[n:], self.series, strict=True)
        ]
        return [*held[:n], *toned]

    def after(self, state: TurbineState, states: np.ndarray) -> TurbineState:
        """The turbine's ``state`` at the end of its way, with the memory that belongs to the network's ``states``."""
        current = np.array([complex(state.values[0], state.values[1])])
        forced = (*self.source, *self.tones)
        memory, shown = self.feeding.left(states, current, forced, state.time_s, state.v_source)
        values = state.values.copy()
        v_c, i_g = memory.values[-1, 1], shown[1]
        values[13:17] = v_c.real, v_c.imag, i_g.real, i_g.imag
        values.setflags(write=False)
        return replace(state, values=values, memory=memory)


def surroundings(job: Job, p: TurbineParameters, step_s: float, fault_s: Conductance = SOUND) -> Surroundings:
    """The network of a job, its source and its tones."""
    state = job.state
    stepped = feeding(state.source.circuit, p, step_s, fault_s)
    series = tuple((f, v / PHASE_PEAK) for f, v in series_tones(job.injection, state.source))
    tones = tuple(stepped.toned(f, v) for f, v in series)
    return Surroundings(stepped, stepped.forced(state.v_source), tones, series)


class NetworkKernel:
    """`kernels.turbine.advance_network` with the states of its lanes' networks, and what comes out of it."""

    def __init__(self, jobs: Sequence[Job], reactive: bool, table: np.ndarray, p: TurbineParameters, step_s: float):
        from ..kernels.turbine import LANES

        self._reactive, self._table = reactive, table
        self._around = [surroundings(job, p, step_s) for job in jobs]
        lanes = [around.states(job.state) for around, job in zip(self._around, jobs, strict=True)]
        self._xi = np.ascontiguousarray(np.array(lanes + [lanes[0]] * (LANES - len(lanes))).T)

    def __call__(self, *arguments: Any) -> None:
        from ..kernels.turbine_network import advance_network

        weights = self._around[0].feeding.weights
        advance_network(self._reactive or None, self._table, *arguments, self._xi, np.empty_like(self._xi), weights)

    def finished(self, ends: list[TurbineState]) -> list[TurbineState]:
        """The turbines' states at the end, with their networks'."""
        return [around.after(end, xi) for around, end, xi in zip(self._around, ends, self._xi.T, strict=False)]


def set_sources(x: np.ndarray, forced: Sequence[Forced], n_tones: int, time_s: float, half_step_s: float) -> None:
    """What sources force into one lane's column: the first of them stands still, the others are tones."""
    from ..kernels import turbine as kernel

    set_complex(x, kernel.V_S_RE, forced[0].v)
    set_complex(x, kernel.V_CS_RE, forced[0].i)
    x[kernel.FRAME] = 1.0
    for tone, each in enumerate(forced[1 : 1 + n_tones]):
        slot = kernel.TONES + kernel.N_TONE_SLOTS * tone
        set_complex(x, slot, each.v * turns(each.f_hz * time_s))
        set_complex(x, slot + 2, turns(each.f_hz * half_step_s))
        set_complex(x, slot + 4, each.i / each.v if each.v else 0j)


def traced(
    lane: np.ndarray, job: Job, reactive: bool, p: TurbineParameters, step_s: float, fault_s: Conductance, n_steps: int
) -> tuple[np.ndarray, np.ndarray, Callable[[TurbineState], TurbineState]]:
    """Lanes at the end, samples (n_steps, 7), and the end's `Surroundings.after`, of one turbine under a fault or none.

    ``lane`` is its column, the port's compensation in place; an unsymmetric fault adds the other sequence as a tone.
    """
    from ..kernels import turbine as kernel
    from ..kernels.turbine_network import advance_tracing_network

    state = job.state
    around = surroundings(job, p, step_s, fault_s)
    forced = around.forced(p.w1_rad_s / (2.0 * np.pi))
    set_sources(lane, forced, len(forced) - 1, state.time_s, 0.5 * step_s)
    if around.feeding.dynamics.frame == "stationary":
        set_complex(lane, kernel.FRAME, np.exp(1j * p.w1_rad_s * state.time_s))
    lanes, samples = np.repeat(lane, kernel.LANES), np.empty((n_steps, 7))
    xi = np.repeat(around.states(state)[:, None], kernel.LANES, axis=1)
    weights, room = around.feeding.weights, np.empty_like(xi)
    advance_tracing_network(reactive or None, lanes, len(forced) - 1, p, step_s, samples, xi, room, weights)
    return lanes, samples, lambda end: around.after(end, xi[:, 0])
