"""A controller in the general inverter circuit, stepped: `SampledTurbine` with another circuit and operating point.

The operating point is P, Q and |v_pcc|, and so are the references that a controller may be told (``p_ref``, ``q_ref``,
``v_ref``). A controller that holds something else settles where it holds it; the table keeps the measured P, Q and |v|.
Behind a grid it is started there, or walked there from ``settle_on``; it never stands on an ideal source.
"""

from __future__ import annotations

import cmath
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import SeqsweepError
from ..kernels.compiled import Fixed
from ..protocol import Conditions, Job, NotSettled, OperatingPoint, OperatingRange, Source, Trace
from ..space_vectors import PHASE_PEAK
from ..states.behind_grid import settled_behind
from ..states.steady_state import voltage_asked
from . import circuit, inverter_circuit
from .inverter_circuit import InverterCircuit
from .state import GreyState
from .stepping import SampledTurbine

VOLTAGE_PU = (0.7, 1.3)


@lru_cache(maxsize=64)
def _network(p: InverterCircuit, source: Source, dt_s: float) -> Fixed:
    return Fixed(inverter_circuit.network(p, source, dt_s))


@lru_cache(maxsize=64)
def _moments(p: InverterCircuit, source: Source, dt_s: float) -> np.ndarray:
    return inverter_circuit.moments(p, source, dt_s)


class SampledInverter(SampledTurbine):
    """A controller in the general inverter circuit; `GreyInverter` is what users meet."""

    id = "inverter-grey-v1"
    power_meaning = "P and Q out of the device at the PCC, where its control holds the references it is told"

    parameters: InverterCircuit  # type: ignore[assignment]

    def _limits(self) -> OperatingRange:
        s, u = self.rating.power_va, self.rating.voltage_v
        return OperatingRange((-1.5 * s, 1.5 * s), (VOLTAGE_PU[0] * u, VOLTAGE_PU[1] * u), (-1.5 * s, 1.5 * s))

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """The periodic steady state, reached by running; see `Plant.settle`."""
        voltage_v = voltage_asked(operating_point, source, self.operating_range, self.rating, self.id)
        if source.kind == "thevenin":
            state: GreyState = settled_behind(self, operating_point, source)
        else:
            v_source = PHASE_PEAK * voltage_v * cmath.exp(1j * source.angle_rad)
            state = self.onwards(self.begun(operating_point, source, v_source))
        self._refuse_blocked()
        return state

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """As `settle`: what must be waited for has no other way."""
        return self.settle(operating_point, source)

    def begun(self, point: OperatingPoint, source: Source, v_source: complex) -> GreyState:
        """Circuit at the phasors of P, Q and |v_pcc|, controller as its library starts it."""
        voltage_v = point.terminal_voltage_v or source.voltage_v
        assert voltage_v is not None
        power = complex(point.active_power_w, point.reactive_power_var)
        rest = inverter_circuit.at_rest(self.parameters, power, voltage_v)
        behind = rest.v_pcc - circuit.impedance(source, self.f1_hz) * rest.i_g
        turn = PHASE_PEAK * cmath.exp(1j * (cmath.phase(v_source) - cmath.phase(behind)))
        command, i_g = rest.v_conv * turn, rest.i_g * turn
        x = np.array([rest.i_l * turn, rest.v_c * turn, i_g, command, *self._port_at_rest(i_g)])
        energy = 0.5 * self.parameters.c_dc_f * self.parameters.v_dc_ref_v**2
        state = GreyState(
            0, 0.0, x, energy, None, v_source, source, point.active_power_w, voltage_v, None, point.reactive_power_var
        )
        return replace(state, memory=self._begun(state, command))

    def onwards(self, state: GreyState) -> GreyState:
        """Until a period repeats, but not before `believed_from_s`."""
        if state.time_s < self.believed_from_s:
            n = int(np.ceil((self.believed_from_s - state.time_s) / self.dt_s))
            ((state, _),) = self.run([Job(state, None)], n)
        return self._periodic(state)

    believed_from_s = 0.0

    def fundamental(self, state: GreyState) -> tuple[GreyState, complex, complex]:
        """A period on: the state there, and phasors of v_pcc (V) and i (A, load direction) over it, at time zero."""
        n = round(1.0 / (self.f1_hz * self.dt_s))
        ((state, record),) = self.run([Job(state, None)], n)
        back = np.exp(-2j * np.pi * self.f1_hz * record.time_s)
        return state, complex(np.mean(record.v * back)), complex(np.mean(record.i * back))

    def put_behind(self, state: GreyState, source: Source, v_source: complex) -> GreyState:
        """The same device behind another source; its inductance keeps the current."""
        return replace(state, source=source, v_source=v_source)

    def grid_impedance(self, source: Source) -> complex:
        """Impedance of a source at f1 (ohm)."""
        return circuit.impedance(source, self.f1_hz)

    def _refuse_blocked(self) -> None:
        from ..kernels.grey import CELL_TYPES
        from .kernel_arguments import cells_of

        for port in self._map.gate:
            cells = cells_of(self.controller.outputs.cells)
            assert port.type in CELL_TYPES
            if getattr(cells, port.type)[port.first] == 0:
                raise NotSettled(
                    f"the controller keeps its bridge blocked (output {port.name!r} is 0): it waits for an enable, or "
                    "a protection has tripped"
                )

    # ------------------------------------------------------------------ driving

    def trace(self, state: GreyState, conditions: Conditions, n_steps: int) -> tuple[GreyState, Trace]:
        """As `SampledTurbine.trace`; a fault at the PCC is refused, for it lies between two inductances."""
        if any(conditions.fault_s):
            raise SeqsweepError(f"{self.id} has no fault at the PCC, which lies between two inductances: step the grid")
        return super().trace(state, conditions, n_steps)

    def _network(self, source: Source) -> Fixed:
        return _network(self.parameters, source, self.dt_s)

    def _moments(self, source: Source) -> np.ndarray:
        return _moments(self.parameters, source, self.dt_s)

    def _store(self, state: GreyState) -> Any:
        from ..kernels.grey import Store

        p = self.parameters
        if p.r_dc_ohm == 0.0:
            return Store(p.c_dc_f, state.power_w, self.dt_s, self._delay, 0.0, 0.0)
        e_v = p.v_dc_ref_v + p.r_dc_ohm * state.power_w / p.v_dc_ref_v
        return Store(p.c_dc_f, 0.0, self.dt_s, self._delay, e_v, 1.0 / p.r_dc_ohm)
