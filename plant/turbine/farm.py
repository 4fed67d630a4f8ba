"""Many reference turbines on one network, stepped together: each with its own state, power and compensation.

The turbines are lanes of `kernels.turbine_farm`; collector, transformers, grid and the turbines' own shunts are one
network that is taken exactly. Voltages and currents are power-invariant in the dq frame of the source inside,
phase-peak space vectors in load direction outside.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..circuits.branches import GROUND, Branch
from ..circuits.coupled import Place, Split, split
from ..circuits.dynamics import Dynamics, Memory, Turning, as_pairs, dynamics_of, from_pairs
from ..circuits.stepping import Outputs
from ..damping.control import NOTCH_XI
from ..damping.grid_side import GridSideDamper
from ..errors import SeqsweepError
from ..kernels.lanes import LANES
from ..lanes import aligned_zeros
from ..protocol import FarmConditions, FarmTrace, Member, OperatingPoint, Record, Source, Trace
from ..space_vectors import PHASE_PEAK
from .state import TurbineState

if TYPE_CHECKING:
    from .reference import ReferenceTurbine


@dataclass(frozen=True, slots=True, eq=False)
class FarmState:
    """Everything from which a farm can go on; opaque to everybody else.

    Attributes
    ----------
    step : int
        Steps since time zero.
    time_s : float
        Time (s).
    turbines : tuple of TurbineState
        Every member, also one that is not connected.
    memory : Memory
        Of the network, the connected turbines' shunts among it.
    dampers : (d, 8) float
        States of the grid-side dampers: m, x1, x2, i, real and imaginary parts in turn.
    v_source : complex
        Source voltage in the dq frame (V, power-invariant).
    """

    step: int
    time_s: float
    turbines: tuple[TurbineState, ...]
    memory: Memory
    dampers: np.ndarray
    v_source: complex


class Stepped(NamedTuple):
    """A network with members connected, as it is stepped: their places among all, and their factors."""

    dynamics: Dynamics
    outputs: Outputs
    split: Split
    connected: tuple[int, ...]
    factors: tuple[float, ...]

    def forced(self, v_source: complex) -> tuple[Turning, ...]:
        """What the source holds by itself."""
        return self.dynamics.by_source(v_source)


class TurbineFarm:
    """Members on a network.

    Parameters
    ----------
    plant : ReferenceTurbine
        What every member is.
    members : sequence of Member
        Names, nodes, powers, and how many equal turbines each stands for.
    dampers : sequence of (str, GridSideDamper)
        Node and converter of each grid-side damper.
    """

    def __init__(
        self, plant: ReferenceTurbine, members: Sequence[Member], dampers: Sequence[tuple[str, GridSideDamper]] = ()
    ):
        if plant.integrator != "rk4":
            raise SeqsweepError(f"a farm in time needs integrator 'rk4'; the turbine has {plant.integrator!r}")
        self.plant, self.members, self.dampers = plant, tuple(members), tuple(dampers)
        self.f1_hz, self.dt_s, self.rating = plant.f1_hz, plant.dt_s, plant.rating

    # ------------------------------------------------------------------ steady state

    def drawn(self, voltage_v: np.ndarray) -> np.ndarray:
        """Complex power (n,) in VA that each member draws at |v| (n,) in V, line-to-line RMS: for a load flow."""
        return np.array([self._power(member, float(v)) for member, v in zip(self.members, voltage_v, strict=True)])

    def _power(self, member: Member, voltage_v: float) -> complex:
        low, high = self.plant.operating_range.terminal_voltage_v
        held = min(max(voltage_v, low), high)  # beyond the range on the way to a solution
        values = self._turbine(member, complex(held)).values
        out = held * complex(values[15], -values[16])
        return -member.factor * out

    def _turbine(self, member: Member, voltage_v: complex) -> TurbineState:
        """The member at rest at a terminal voltage (V, in the source's frame)."""
        point = OperatingPoint(member.active_power_w, abs(voltage_v), member.reactive_power_var)
        return self.plant.equilibrium(point, Source(angle_rad=cmath.phase(voltage_v)))

    def at_rest(self, conditions: FarmConditions, voltages_v: np.ndarray) -> FarmState:
        """The farm where a load flow (n,) of all members puts it; those not connected rest by themselves."""
        turbines = tuple(self._turbine(m, complex(v)) for m, v in zip(self.members, voltages_v, strict=True))
        stepped = self._stepped(conditions)
        memory, seen = self._steady(stepped, turbines, conditions)
        wanted = np.array([voltages_v[k] for k in stepped.connected])
        terminals, buses = seen[: len(wanted)], seen[len(wanted) :]
        if np.max(np.abs(terminals - wanted)) > 1e-5 * np.max(np.abs(wanted)):
            raise SeqsweepError("the load flow does not belong to this network: its terminal voltages are others")
        rested = [device.at_rest(complex(v)) for (_, device), v in zip(self.dampers, buses, strict=True)]
        dampers = np.array(rested).reshape(-1, 8)
        return FarmState(0, 0.0, turbines, memory, dampers, complex(conditions.source_v))

    def _steady(
        self, stepped: Stepped, turbines: Sequence[TurbineState], conditions: FarmConditions
    ) -> tuple[Memory, np.ndarray]:
        """What the network remembers of turbines at rest, and the voltages of terminals and dampers that it shows."""
        fed = np.array(_currents(stepped, turbines))
        fed = np.concatenate([fed, np.zeros(len(self.dampers))])
        v_source = complex(conditions.source_v)
        (source,), (own,) = stepped.forced(v_source), stepped.dynamics.by_current(fed)
        x = source.x + own.x
        shown = stepped.outputs.of_x @ x + stepped.outputs.of_u @ fed
        memory = Memory(stepped.dynamics.names, stepped.dynamics.remembered(x, v_source))
        return memory, shown[: len(stepped.connected) + len(self.dampers)]

    def joined(
        self, state: FarmState, conditions: FarmConditions, names: Sequence[str], voltages_v: np.ndarray
    ) -> FarmState:
        """The farm with members put in service, which begin with what stands at their terminals as the load flow says.

        ``voltages_v`` (n,) is that of all members under ``conditions``, in which they are connected.
        """
        new = [k for k, member in enumerate(self.members) if member.name in names]
        turbines = list(state.turbines)
        for k in new:
            at_rest = self._turbine(self.members[k], complex(voltages_v[k]))
            turbines[k] = replace(at_rest, step=state.step, time_s=state.time_s)
        calm = replace(conditions, fault=None)
        stepped = self._stepped(calm)
        everybody = [self._turbine(m, complex(v)) for m, v in zip(self.members, voltages_v, strict=True)]
        steady, _ = self._steady(stepped, everybody, calm)
        nodes = {self.members[k].node for k in new}
        values = state.memory.of(steady.names).copy()
        for row, branch in enumerate(stepped.dynamics.branches):
            if nodes & set(branch.ends):
                values[row] = steady.values[row]
        return replace(state, turbines=tuple(turbines), memory=Memory(steady.names, values))

    # ------------------------------------------------------------------ driving

    def _stepped(self, conditions: FarmConditions) -> Stepped:
        connected = tuple(k for k, on in enumerate(conditions.connected) if on)
        p = self.plant.parameters
        sizes = conditions.sizes or (1.0,) * len(self.members)
        factors = tuple(float(sizes[k] * self.members[k].factor) for k in connected)
        shunts = tuple(
            _shunt(self.members[k], factor, p.r_f_ohm, p.c_f_f) for k, factor in zip(connected, factors, strict=True)
        )
        ports = tuple(self.members[k].node for k in connected) + tuple(node for node, _ in self.dampers)
        branches = (*conditions.circuit.branches, *shunts)
        dynamics = dynamics_of(branches, ports, p.w1_rad_s, conditions.fault)
        return _stepped(dynamics, conditions.watch, self.dt_s, connected, tuple(each.name for each in shunts), factors)

    def trace(self, state: FarmState, conditions: FarmConditions, n_steps: int) -> tuple[FarmState, FarmTrace]:
        """Go on under ``conditions``; samples at steps 0 ... n_steps - 1.

        What is not connected stays where it is, and its samples are not a number.
        """
        from ..kernels import turbine_farm as kernel

        stepped = self._stepped(conditions)
        forced = stepped.forced(state.v_source)
        places, rest = stepped.split.spread(self._network_states(state, stepped, forced))
        x = self._lanes(state, stepped, conditions, places)
        held = _held(stepped, forced)
        _set_network(x, stepped, held)
        room = self._room(state, stepped, rest)
        samples = np.empty((n_steps, len(x), 7 * LANES))
        watched = np.empty((n_steps, 2 * len(conditions.watch)))
        reactive = True if any(state.turbines[k].i_q_ref_a for k in stepped.connected) else None
        wiring = self._wiring(state, stepped, held, conditions)
        coupled = stepped.split.coupled
        kernel.advance_farm(reactive, x, self.plant.parameters, self.dt_s, samples, watched, coupled, wiring, room)
        end = self._end(state, stepped, forced, x, room, n_steps)
        return end, self._trace_of(state, stepped, samples, watched)

    def _lanes(self, state: FarmState, stepped: Stepped, conditions: FarmConditions, places: np.ndarray) -> np.ndarray:
        """(groups, N_SLOTS LANES) of the connected turbines; ``places`` (n, 4) are their states of the network."""
        from ..kernels import turbine as slots_of
        from ..kernels import turbine_farm as kernel

        p, n = self.plant.parameters, len(stepped.connected)
        groups = -(-n // LANES)
        x = aligned_zeros(groups, kernel.N_SLOTS * LANES)
        slots = x.reshape(groups, kernel.N_SLOTS, LANES)
        for place in range(groups * LANES):
            same = place if place < n else 0
            k = stepped.connected[same]
            turbine, lane = state.turbines[k], slots[place // LANES, :, place % LANES]
            lane[: len(turbine.values)] = turbine.values
            self.plant.set_asked(lane, turbine)
            lane[slots_of.COMP_R : slots_of.COMP_R + 2] = conditions.compensation[k]
            lane[slots_of.NOTCH_W0], lane[slots_of.NOTCH_WIDTH] = p.w1_rad_s, 2.0 * NOTCH_XI * p.w1_rad_s
            lane[kernel.LAW] = p.k_opt * conditions.power_scale[k]
            lane[kernel.NETWORK] = places[same]
        return x

    def _wiring(self, state: FarmState, stepped: Stepped, held: np.ndarray, conditions: FarmConditions) -> object:
        from ..kernels import turbine_farm as kernel

        n, d, w1 = len(stepped.connected), len(self.dampers), self.plant.parameters.w1_rad_s
        of_none = np.concatenate([held[:, 2 * n : 2 * (n + d)], held[:, 2 * (2 * n + d) :]], axis=1)
        moving = stepped.dynamics.frame == "stationary"
        turns = [
            cmath.exp(1j * w1 * state.time_s) if moving else 1.0,
            cmath.exp(-2j * w1 * state.time_s),
            cmath.exp(-1j * w1 * self.dt_s),
        ]
        return kernel.Wiring(
            np.ascontiguousarray(of_none),
            as_pairs(np.array(turns)[:, None]),
            w1 if moving else 0.0,
            _damper_rows(self.dampers, conditions.dampers_on),
        )

    def _network_states(self, state: FarmState, stepped: Stepped, forced: tuple[Turning, ...]) -> np.ndarray:
        """(m,) of the network: what deviates from the forced."""
        held = sum((turning.at(state.time_s) for turning in forced), np.zeros(stepped.dynamics.system.at.n, complex))
        steady = stepped.dynamics.remembered(held, state.v_source)
        return stepped.dynamics.entered(state.memory.of(stepped.dynamics.names) - steady, state.time_s)

    def _room(self, state: FarmState, stepped: Stepped, rest: np.ndarray) -> object:
        from ..kernels import turbine_farm as kernel

        coupled, d = stepped.split.coupled, len(self.dampers)
        dampers = np.zeros((3, d, 8))
        dampers[0] = state.dampers
        most = max(max(coupling.core.shape) for coupling in coupled[:6]) + 1
        sizes = (most, most, 4 * d + len(rest), 2 * d, 4 * d, 2 * d, len(coupled.by_rates))
        begun = np.concatenate([rest, np.zeros(2 * d)])
        return kernel.Room._make([begun, *(np.zeros(size) for size in sizes), dampers])

    def _end(
        self, state: FarmState, stepped: Stepped, forced: tuple[Turning, ...], x: np.ndarray, room: object, n_steps: int
    ) -> FarmState:
        from ..kernels import turbine_farm as kernel

        step = state.step + n_steps
        time_s = step * self.dt_s
        lanes = _by_lane(x.reshape(len(x), kernel.N_SLOTS, LANES), len(stepped.connected))
        turbines = list(state.turbines)
        for place, k in enumerate(stepped.connected):
            values = lanes[place, :21].copy()
            values.setflags(write=False)
            turbines[k] = replace(state.turbines[k], step=step, time_s=time_s, values=values)
        fed = np.array(_currents(stepped, turbines))
        dampers, rest = room.damper[0].copy(), room.rest[: len(stepped.split.rest)]  # type: ignore[attr-defined]
        fed = np.concatenate([fed, -from_pairs(dampers.reshape(-1, 8)[:, 6:8].ravel())])
        states = stepped.split.gathered(lanes[:, kernel.NETWORK], rest)
        z = stepped.dynamics.left(states, fed, time_s)
        z = sum((turning.at(time_s) for turning in forced), z)
        memory = Memory(stepped.dynamics.names, stepped.dynamics.remembered(z, state.v_source))
        return FarmState(step, time_s, tuple(turbines), memory, dampers, state.v_source)

    def _trace_of(self, state: FarmState, stepped: Stepped, samples: np.ndarray, watched: np.ndarray) -> FarmTrace:
        time_s = (state.step + np.arange(len(samples))) * self.dt_s
        to_stationary = PHASE_PEAK * np.exp(2j * np.pi * ((self.f1_hz * time_s) % 1.0))
        traces = [self._absent(state, len(samples))] * len(self.members)
        by_lane = samples.reshape(len(samples), -1, 7, LANES)
        for place, k in enumerate(stepped.connected):
            of = by_lane[:, place // LANES, :, place % LANES]
            v, i = (of[:, 0] + 1j * of[:, 1]) * to_stationary, -(of[:, 2] + 1j * of[:, 3]) * to_stationary
            record = Record(state.time_s, self.dt_s, v, i, self.f1_hz, "load", self.members[k].name)
            traces[k] = Trace(record, of[:, 4], of[:, 5], of[:, 6] - cmath.phase(state.v_source))
        seen = from_pairs(watched.ravel()).reshape(len(watched), -1) * to_stationary[:, None]
        return FarmTrace(tuple(traces), seen)

    def _absent(self, state: FarmState, n: int) -> Trace:
        nothing = np.full(n, np.nan)
        record = Record(state.time_s, self.dt_s, nothing + 0j, nothing + 0j, self.f1_hz)
        return Trace(record, nothing, nothing, nothing)


def _currents(stepped: Stepped, turbines: Sequence[TurbineState]) -> list[complex]:
    """What the connected members feed in (A)."""
    pairs = zip(stepped.connected, stepped.factors, strict=True)
    return [factor * complex(*turbines[k].values[:2]) for k, factor in pairs]


def _held(stepped: Stepped, forced: Sequence[Turning]) -> np.ndarray:
    """(2, outputs) in pairs, of one device: what the source forces that stands in the dq frame, and what turns."""
    n, d = len(stepped.connected), len(stepped.dynamics.ports) - len(stepped.connected)
    held = np.zeros((2, 2 * len(stepped.outputs.of_x)))
    for row, turning in enumerate(forced):
        held[row] = as_pairs(stepped.outputs.of_x @ turning.x)
    held[:, 2 * (n + d) : 2 * (2 * n + d)] /= np.repeat(stepped.factors, 2)
    return held


def _set_network(x: np.ndarray, stepped: Stepped, held: np.ndarray) -> None:
    """What the lanes' terminals do to themselves, and what the source forces there, into their slots."""
    from ..kernels import turbine_farm as kernel

    n, d = len(stepped.connected), len(stepped.dynamics.ports) - len(stepped.connected)
    of_v, of_i = held[:, : 2 * n].reshape(2, n, 2), held[:, 2 * (n + d) : 2 * (2 * n + d)].reshape(2, n, 2)
    forced = np.stack([of_v, of_i], axis=2).transpose(1, 0, 2, 3).reshape(n, 8)
    slots = x.reshape(len(x), kernel.N_SLOTS, LANES)
    for place in range(len(x) * LANES):
        same, lane = place if place < n else 0, slots[place // LANES, :, place % LANES]
        lane[kernel.FORCED : kernel.FORCED + 8] = forced[same]
        lane[kernel.OWN_START : kernel.N_SLOTS] = stepped.split.local[same]


def _by_lane(slots: np.ndarray, n: int) -> np.ndarray:
    """(n, n_slots) of the first lanes of (groups, n_slots, LANES)."""
    return slots.transpose(0, 2, 1).reshape(-1, slots.shape[1])[:n]


def _shunt(member: Member, factor: float, r_ohm: float, c_f: float) -> Branch:
    """Rf and Cf of all turbines that a member stands for."""
    name = f"shunt of {member.name}"
    return Branch(name, {member.node: 1.0, GROUND: -1.0}, r_ohm / factor, 0.0, c_f * factor)


@lru_cache(maxsize=64)
def _stepped(
    dynamics: Dynamics,
    watch: tuple[tuple[str, str], ...],
    step_s: float,
    connected: tuple[int, ...],
    shunts: tuple[str, ...],
    factors: tuple[float, ...],
) -> Stepped:
    """Outputs and weights: voltages of the ports, currents out of the turbines, what is watched."""
    at, names, ports, n = dynamics.system.at, dynamics.names, dynamics.ports, len(connected)
    rows = len(ports) + n + len(watch)
    of_x, of_u = np.zeros((rows, at.n)), np.zeros((rows, len(ports)))
    for k, port in enumerate(ports):
        of_x[k, at.node[port]] = 1.0
    for k, shunt in enumerate(shunts):
        of_x[len(ports) + k, at.current[names.index(shunt)]] = -1.0
        of_u[len(ports) + k, k] = 1.0
    for k, (what, name) in enumerate(watch):
        of_x[len(ports) + n + k, at.node[name] if what == "v" else at.current[names.index(name)]] = 1.0
    outputs = Outputs(of_x, of_u)
    places = [Place(*each) for each in zip(ports[:n], shunts, factors, strict=True)]
    parts = split(dynamics, outputs, step_s, places, len(ports) - n, LANES)
    return Stepped(dynamics, outputs, parts, connected, factors)


def _damper_rows(dampers: Sequence[tuple[str, GridSideDamper]], on: Sequence[bool]) -> np.ndarray:
    """The kernel's rows of the grid-side dampers."""
    rows = [
        [
            *(of.nu_rad_s, of.bandwidth_rad_s, of.washout_rad_s, 1.0 / of.lag_s),
            *(of.y_mode.real, of.y_mode.imag, of.y_mirror.real, of.y_mirror.imag),
            *(min(of.limit_a, 1e300), float(acts)),
        ]
        for (_, of), acts in zip(dampers, on, strict=True)
    ]
    return np.array(rows).reshape(-1, 10)
