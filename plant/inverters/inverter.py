"""``gfl-v1`` and ``gfm-v1``: a grid-following and a grid-forming inverter in one circuit.

White to us, black to everything above this folder. Equations and parameters: docs/inverters.md. The plants work in
the dq frame at w1 and per unit; records leave them as phase-peak space vectors in load direction.
"""

from __future__ import annotations

import cmath
from abc import abstractmethod
from math import pi
from typing import Any, ClassVar

import numpy as np

from ..damping.control import compensation
from ..errors import SeqsweepError
from ..injection import check_source
from ..lanes import Chart, set_complex
from ..operating_range import Asked, refuse_outside
from ..protocol import (
    Job,
    NotSettled,
    OperatingPoint,
    OperatingRange,
    Rating,
    Source,
)
from . import equilibrium as stationary
from .behind_network import NetworkLanes, at_rest
from .driving import InverterState, LaneDriven
from .equilibrium import CircuitEquilibrium, References
from .parameters import FollowingParameters, FormingParameters

Parameters = FollowingParameters | FormingParameters

LONGEST_STEP_S = 1e-4
"""Beyond this the filter's resonance near 1 kHz is not resolved."""

DAMPING_RANGES = {
    "damping_gain": (-10.0, 10.0, ""),
    "damping_r_ohm": (0.0, 100.0, " ohm"),
    "damping_l_h": (0.0, 1.0, " H"),
    "damping_resonance_hz": (-1000.0, 1000.0, " Hz"),
}
"""Parameters of the damping control: lowest, highest, unit. A grid-forming device may need a gain below 0."""

DC_SOURCES = ("constant_power", "battery", "photovoltaic")

_RESIDUAL_LIMIT = 1e-9
"""Largest change over one period, per unit, of a certified steady state."""


class Inverter(LaneDriven):
    """What the two inverters share: the circuit, the operating point and the driving of lanes.

    Parameters
    ----------
    dt_s : float
        Step (s) of the classical Runge-Kutta method of order four.
    damping_gain : float
        Signed gain k of the damping control at the measurement port; 0 is off.
    damping_r_ohm, damping_l_h : float
        Resistance (ohm) and inductance (H) that the gain multiplies: the grid's, or an impedance of its own.
    damping_resonance_hz : float
        Signed frequency w_r / 2 pi of the stronger resonance component (Hz).
    dc_source : "constant_power", "battery" or "photovoltaic"
        What feeds the DC link, where ``c_dc_s`` is finite: a constant power; a voltage behind ``dc_resistance_pu``; an
        array at its maximum power point, where dI/dV = -I/V: in the small signal the same as a constant power.
    dc_resistance_pu : float
        Resistance of the battery, per unit of U_dc^2 / S.
    **parameters : float
        Fields of the plant's parameters to replace.

    Raises
    ------
    SeqsweepError
        If a parameter is unknown or out of its range.
    """

    releases_gil = True
    power_meaning = "active and reactive power out of the device at the PCC"
    _defaults: ClassVar[Parameters]
    _control_slots: ClassVar[int]

    def __init__(
        self,
        dt_s: float = 25e-6,
        *,
        damping_gain: float = 0.0,
        damping_r_ohm: float = 0.0,
        damping_l_h: float = 0.0,
        damping_resonance_hz: float = 77.0,
        dc_source: str = "constant_power",
        dc_resistance_pu: float = 0.02,
        **parameters: float,
    ):
        self.parameters: Any = self._with(parameters)
        if not 0.0 < dt_s <= LONGEST_STEP_S:
            raise SeqsweepError(f"dt_s is {dt_s:g} s; {self.id} needs a step above 0 and up to {LONGEST_STEP_S:g} s")
        if dc_source not in DC_SOURCES:
            raise SeqsweepError(f"dc_source is {dc_source!r}; {self.id} has {', '.join(map(repr, DC_SOURCES))}")
        if not dc_resistance_pu > 0.0:
            raise SeqsweepError(f"dc_resistance_pu is {dc_resistance_pu:g}; a battery needs a resistance above 0")
        damping = (float(damping_gain), float(damping_r_ohm), float(damping_l_h), float(damping_resonance_hz))
        for (name, (low, high, unit)), value in zip(DAMPING_RANGES.items(), damping, strict=True):
            if not low <= value <= high:
                raise SeqsweepError(f"{name} is {value:g}{unit}; {self.id} takes {low:g} to {high:g}{unit}")
        self.compensation = compensation(*damping)
        self.dc_source, self.dc_resistance_pu = dc_source, float(dc_resistance_pu)
        self.dt_s = float(dt_s)
        self.f1_hz = self.parameters.w1_rad_s / (2.0 * pi)
        self.rating = Rating(self.parameters.u_rated_v, self.parameters.s_rated_va)
        u, s = self.rating.voltage_v, self.rating.power_va
        self.operating_range = OperatingRange((-s, s), (0.8 * u, 1.2 * u), (-s, s))

    @classmethod
    def _with(cls, parameters: dict[str, float]) -> Any:
        """The defaults with ``parameters`` replaced, each checked."""
        known = cls._defaults._fields
        unknown = sorted(set(parameters) - set(known))
        if unknown:
            others = (*DAMPING_RANGES, "dc_source", "dc_resistance_pu", *known)
            raise SeqsweepError(f"{cls.id} has no parameter {unknown[0]!r}; it has {', '.join(others)}")
        p = cls._defaults._replace(**{name: float(value) for name, value in parameters.items()})
        for name in (*cls._must_be_positive, "u_rated_v", "s_rated_va", "w1_rad_s", "c_dc_s", "i_limit_pu"):
            if not getattr(p, name) > 0.0:
                raise SeqsweepError(f"{name} is {getattr(p, name):g}; {cls.id} needs a value above 0")
        return p

    _must_be_positive: ClassVar[tuple[str, ...]] = ("l_f_pu", "c_f_pu", "l_g_pu")

    # ------------------------------------------------------------------ steady state

    @abstractmethod
    def _control(self, circuit: CircuitEquilibrium) -> tuple[list[complex], References]:
        """The control's states at rest, and its references."""

    @abstractmethod
    def _turned_control(self, values: np.ndarray, angle_rad: float) -> None:
        """Turn the angles among the states by ``angle_rad``, in place."""

    def settle(self, operating_point: OperatingPoint, source: Source) -> InverterState:
        """The equilibrium at ``operating_point``, certified over a period and found stable.

        Raises
        ------
        SeqsweepError
            If the operating point is outside `operating_range`, or says |v_pcc| twice or not at all.
        NotSettled
            If there is no equilibrium ("not_settled") or it is unstable ("diverged").
        """
        state = self.equilibrium(operating_point, source)
        self._certify(state)
        return state

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> InverterState:
        """The equilibrium at ``operating_point``, stable or not."""
        from ..kernels import inverters as kernel

        power = complex(operating_point.active_power_w, operating_point.reactive_power_var) / self.rating.power_va
        z = self._per_unit(source)
        voltage = self._terminal_voltage(operating_point, source, power, z)
        self._check_range(power, voltage)
        circuit = stationary.circuit_equilibrium(self.parameters, power, voltage)
        self._check_limits(circuit)
        states, references = self._control(circuit)
        v_source = stationary.source_voltage(circuit, z) / self._no_load_gain(source)
        angle = source.angle_rad - cmath.phase(v_source)
        turn = cmath.exp(1j * angle)
        values = np.zeros(kernel.N_STATES)
        for slot, phasor in ((kernel.I_C, circuit.i_c), (kernel.V_C, circuit.v_c), (kernel.I_G, circuit.i_g)):
            set_complex(values, slot, phasor * turn)
        values[kernel.V_DC] = 1.0
        flat = [x for state in states for x in ((state.real, state.imag) if isinstance(state, complex) else (state,))]
        values[kernel.V_DC + 1 : kernel.V_DC + 1 + len(flat)] = flat
        self._turned_control(values, angle)
        # The notch holds i_g back, and -1j i_g.
        set_complex(values, kernel.NOTCH_B, circuit.i_g * turn)
        set_complex(values, kernel.NOTCH_Q, -1j * circuit.i_g * turn)
        state = self._state(0, values, references, self._dc(circuit), v_source * turn, source)
        if source.circuit is None:
            return state
        return at_rest(state, self._bases, self.parameters.w1_rad_s, self.dt_s, circuit.i_g * turn)

    def linearise(self, state: InverterState) -> np.ndarray:
        """Poles of the small-signal system around ``state`` in the dq frame (rad/s), worst first.

        Central differences of the plant's own flow over ten steps: what the stepper does, not what
        the equations say. States that stand still whatever happens are left out, without compensation the notch.
        """
        from ..kernels import inverters as kernel

        n_steps = 10
        kept = [*range(kernel.V_DC + 1 + self._control_slots)]
        if self._compensated:
            kept += range(kernel.NOTCH_B, kernel.N_STATES)
        step = 1e-5
        chart = self._chart(state, kept)
        middle = chart.of(state)
        size = np.where(np.arange(len(middle)) < len(kept), 1.0, np.maximum(np.abs(middle), 1.0))
        moved = [chart.at(middle + sign * step * unit) for unit in np.diag(size) for sign in (1.0, -1.0)]
        ends = np.array([chart.of(end) for end, _ in self.run([Job(x, None) for x in moved], n_steps)])
        flow = ((ends[0::2] - ends[1::2]) / (2.0 * step * size[:, None])).T
        moving = ~np.all(np.abs(flow - np.eye(len(middle))) < 1e-9, axis=1)
        poles = np.log(np.linalg.eigvals(flow[np.ix_(moving, moving)]).astype(complex)) / (n_steps * self.dt_s)
        return poles[np.argsort(-poles.real)]

    def _chart(self, state: InverterState, kept: list[int]) -> Chart:
        if state.source.circuit is None:
            return Chart(state, kept, None)
        return Chart(state, kept, NetworkLanes([Job(state, None)], self._bases, self.parameters.w1_rad_s, self.dt_s))

    def _certify(self, state: InverterState) -> None:
        steps = max(1, round(1.0 / (self.f1_hz * self.dt_s)))
        ((end, _),) = self.run([Job(state, None)], steps)
        residual = np.max(np.abs(end.values - state.values))
        worst = self.linearise(state)[0]
        if worst.real > 0.0:
            where = "an ideal source" if state.source.kind == "ideal" else "this grid"
            raise NotSettled(
                f"on {where} the equilibrium is unstable: {worst.real:+.3g} rad/s at "
                f"{abs(worst.imag) / (2 * pi):.3g} Hz in the dq frame; "
                f"settle {self.id} where it is stable: {self._friend}",
                status="diverged",
            )
        if not residual <= _RESIDUAL_LIMIT:
            raise NotSettled(f"the state changes by {residual:.2g} over one period; {_RESIDUAL_LIMIT:g} is needed")

    _friend: ClassVar[str]

    def _terminal_voltage(self, point: OperatingPoint, source: Source, power: complex, z: complex) -> float:
        """|v_pcc| (pu)."""
        check_source(point, source, networks=True)
        u = self.rating.voltage_v
        if point.terminal_voltage_v is not None:
            return point.terminal_voltage_v / u
        assert source.voltage_v is not None
        if source.kind == "ideal":
            return source.voltage_v / u
        try:
            return stationary.terminal_voltage(power, z, abs(self._no_load_gain(source)) * source.voltage_v / u)
        except SeqsweepError as error:
            raise NotSettled(str(error)) from None

    def _check_range(self, power: complex, voltage: float) -> None:
        limits, u, s = self.operating_range, self.rating.voltage_v, self.rating.power_va
        asked = (
            Asked("active power", power.real * s, limits.active_power_w, 1e6, "MW"),
            Asked("reactive power", power.imag * s, limits.reactive_power_var, 1e6, "Mvar"),
            Asked("|v_pcc|", voltage * u, limits.terminal_voltage_v, u, "pu"),
        )
        refuse_outside(self.id, asked)

    def _check_limits(self, circuit: CircuitEquilibrium) -> None:
        limit = self.parameters.i_limit_pu
        if abs(circuit.i_c) > limit:
            raise NotSettled(
                f"the converter would need {abs(circuit.i_c):.3g} pu of current; its limit is {limit:g} pu"
            )

    def _dc(self, circuit: CircuitEquilibrium) -> tuple[float, float]:
        """Current into the DC link (pu) at rest, and its slope over v_dc."""
        i = (circuit.e * circuit.i_c.conjugate()).real
        return i, -1.0 / self.dc_resistance_pu if self.dc_source == "battery" else -i

    def _state(
        self,
        step: int,
        values: np.ndarray,
        references: References,
        dc: tuple[float, float],
        v_source: complex,
        source: Source,
    ) -> InverterState:
        values.setflags(write=False)
        return InverterState(step, step * self.dt_s, values, references, dc, v_source, source)
