"""The inverter behind a network of elements, which its current i_g is fed into: what the network shows stands behind a
line, of what it lets through at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..circuits.circuit import PCC, Circuit
from ..circuits.dynamics import Memory, Turning
from ..circuits.feeding import Feeding, feeding_of
from ..circuits.stepping import Weights
from ..protocol import Job, Rating

if TYPE_CHECKING:
    from .driving import InverterState


class Bases(NamedTuple):
    """What one per unit means, power-invariant: V and A."""

    volt: float
    ampere: float


def bases_of(rating: Rating) -> Bases:
    """Of a rating."""
    return Bases(rating.voltage_v, rating.power_va / rating.voltage_v)


def feeding(circuit: Circuit, w1_rad_s: float, step_s: float) -> Feeding:
    """The network by itself."""
    return feeding_of(circuit.branches, (PCC,), (), w1_rad_s, step_s, circuit.source_ratio)


def direct_line(of: Feeding) -> tuple[float, float]:
    """R (ohm) and L (H) of what the network lets through at once."""
    finite = of.dynamics.finite
    return float((of.outputs.of_x @ finite.d)[0, 0]), float((of.outputs.of_x @ finite.k)[0, 0])


def no_load(of: Feeding, v_source: complex) -> complex:
    """PCC voltage (V) that the source holds by itself."""
    return complex(of.shown(of.forced(v_source)[0])[0])


@lru_cache(maxsize=64)
def _per_unit(of: Feeding, bases: Bases) -> Weights:
    """Weights for currents and voltages per unit; the states stay what they are."""
    w, z = of.weights, bases.volt / bases.ampere
    return w._replace(
        seen=w.seen / bases.volt,
        by_start=w.by_start / z,
        by_first=w.by_first / z,
        by_whole=w.by_whole / z,
        by_second=w.by_second / z,
        start=w.start * bases.ampere,
        middle=w.middle * bases.ampere,
        end=w.end * bases.ampere,
    )


def at_rest(state: InverterState, bases: Bases, w1_rad_s: float, step_s: float, i_g: complex) -> InverterState:
    """A steady ``state``, which gives ``i_g`` (pu), with what its network remembers of it."""
    assert state.source.circuit is not None
    of = feeding(state.source.circuit, w1_rad_s, step_s)
    return replace(state, memory=of.at_rest(state.v_source * bases.volt, np.array([i_g * bases.ampere])))


class NetworkLanes:
    """The networks of jobs that share a circuit, lane by lane.

    Attributes
    ----------
    xi : (m, LANES) float
        Their states, which a kernel takes on.
    weights : Weights
        What takes them through a step.
    """

    def __init__(self, jobs: Sequence[Job], bases: Bases, w1_rad_s: float, step_s: float):
        from ..kernels.inverters import LANES

        self._feeding = feeding(jobs[0].state.source.circuit, w1_rad_s, step_s)
        self._bases = bases
        self.weights = _per_unit(self._feeding, bases)
        lanes = [self._states(job.state) for job in jobs]
        self.xi = np.ascontiguousarray(np.array(lanes + [lanes[0]] * (LANES - len(lanes))).T)

    def _forced(self, state: InverterState) -> tuple[Turning, ...]:
        return self._feeding.forced(state.v_source * self._bases.volt)

    def _states(self, state: InverterState) -> np.ndarray:
        assert state.memory is not None
        v_source = state.v_source * self._bases.volt
        return self._feeding.entered(state.memory, self._forced(state), state.time_s, v_source)

    def states(self, state: InverterState) -> np.ndarray:
        """(m,) of what a state remembers."""
        return self._states(state)

    def finished(self, ends: Sequence[InverterState]) -> list[InverterState]:
        """The inverters' states at the end, with their networks'."""
        return [self.after(end, xi) for end, xi in zip(ends, self.xi.T, strict=False)]

    def after(self, state: InverterState, states: np.ndarray) -> InverterState:
        """A state with the memory that belongs to the network's ``states`` (m,)."""
        from ..kernels.inverters import I_G

        current = np.array([complex(state.values[I_G], state.values[I_G + 1]) * self._bases.ampere])
        v_source = state.v_source * self._bases.volt
        memory: Memory = self._feeding.left(states, current, self._forced(state), state.time_s, v_source)[0]
        return replace(state, memory=memory)
