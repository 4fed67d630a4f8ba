"""A network behind the terminals of one or many devices, from what it remembers to what a kernel is given, and back.

What sources force for ever (the ideal source at w1, tones) is known in closed form and kept apart; the states that are
stepped are what deviates from it, driven by the devices' currents. Quantities are those of the device that uses it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np

from .branches import Branch
from .dynamics import Dynamics, Fault, Memory, Turning, dynamics_of
from .stepping import Outputs, Weights, weights_of


@dataclass(frozen=True, eq=False)
class Feeding:
    """A network as a kernel steps it.

    Attributes
    ----------
    dynamics : Dynamics
        Its motion; the devices' currents are fed in at its ports.
    shunts : tuple of str
        Per port the branch that belongs to the device itself, with a resistor and no inductor: what flows into it is
        not the device's current at its terminals. Empty if the devices have none.
    outputs : Outputs
        Voltages of the ports, then, with shunts, currents out of the devices.
    weights : Weights
        For one step.
    source_ratio : float
        Voltage of the node "source" over the source voltage as it is told.
    """

    dynamics: Dynamics
    shunts: tuple[str, ...]
    outputs: Outputs
    weights: Weights
    source_ratio: float

    @property
    def n_states(self) -> int:
        """Real states."""
        return len(self.weights.keep)

    def forced(self, v_source: complex) -> tuple[Turning, ...]:
        """What the ideal source holds by itself."""
        return self.dynamics.by_source(self.source_ratio * v_source)

    def toned(self, f_hz: float, amplitude: complex) -> Turning:
        """What a voltage in series between network and the first port's device holds, at a signed frequency (Hz)."""
        right = np.zeros(self.dynamics.system.at.n)
        if self.shunts:
            right[self._place(self.shunts[0])] = 1.0
        return self.dynamics.by_tone(2.0 * pi * f_hz, right * amplitude)

    def shown(self, turning: Turning) -> np.ndarray:
        """Outputs (o,), complex, of something forced."""
        return np.asarray(self.outputs.of_x @ turning.x)

    def entered(self, memory: Memory, forced: Sequence[Turning], time_s: float, v_source: complex) -> np.ndarray:
        """States (m,) of a memory: what deviates from the forced."""
        x = sum((each.at(time_s) for each in forced), np.zeros(self.dynamics.system.at.n, dtype=complex))
        held = self.dynamics.remembered(x, self.source_ratio * v_source)
        return self.dynamics.entered(memory.of(self.dynamics.names) - held, time_s)

    def left(
        self, states: np.ndarray, currents: np.ndarray, forced: Sequence[Turning], time_s: float, v_source: complex
    ) -> tuple[Memory, np.ndarray]:
        """Memory, and outputs (o,) but for tones at the ports themselves, of states and port currents (p,)."""
        x = self.dynamics.left(states, currents, time_s)
        x = sum((each.at(time_s) for each in forced), x)
        memory = Memory(self.dynamics.names, self.dynamics.remembered(x, self.source_ratio * v_source))
        return memory, self.outputs.of_x @ x + self.outputs.of_u @ currents

    def at_rest(self, v_source: complex, currents: np.ndarray) -> Memory:
        """The memory of steady currents (p,) and the source, in the dq frame."""
        (source,), (own,) = self.forced(v_source), self.dynamics.by_current(currents)
        x = source.x + own.x
        return Memory(self.dynamics.names, self.dynamics.remembered(x, self.source_ratio * v_source))

    def _place(self, branch: str) -> int:
        return self.dynamics.system.at.current[self.dynamics.names.index(branch)]


@lru_cache(maxsize=64)
def feeding_of(
    branches: tuple[Branch, ...],
    ports: tuple[str, ...],
    shunts: tuple[str, ...],
    w1_rad_s: float,
    step_s: float,
    source_ratio: float = 1.0,
    fault: Fault | None = None,
) -> Feeding:
    """The network of ``branches``, the devices' shunts among them, stepped by ``step_s``."""
    dynamics = dynamics_of(branches, ports, w1_rad_s, fault)
    outputs = _outputs(dynamics, shunts)
    return Feeding(dynamics, shunts, outputs, weights_of(dynamics, outputs, step_s), source_ratio)


def _outputs(dynamics: Dynamics, shunts: tuple[str, ...]) -> Outputs:
    at, names, ports = dynamics.system.at, dynamics.names, dynamics.ports
    of_x, of_u = np.zeros((len(ports) + len(shunts), at.n)), np.zeros((len(ports) + len(shunts), len(ports)))
    for k, port in enumerate(ports):
        of_x[k, at.node[port]] = 1.0
    for k, shunt in enumerate(shunts):
        of_x[len(ports) + k, at.current[names.index(shunt)]] = -1.0
        of_u[len(ports) + k, k] = 1.0
    return Outputs(of_x, of_u)
