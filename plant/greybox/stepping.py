"""The turbine's circuit stepped with a controller in it: states in hand, as far as the controller declares its own.

Between two samples the circuit is advanced exactly (`circuit`); the controller is called by its
address from a compiled loop (`kernels.grey`). A state is put back before every job, so jobs may come in any
order where the controller declares all that it remembers; else they must follow one another.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import exp, isfinite, pi, sqrt
from typing import Any

import numpy as np

from ..controllers.interface import ControllerFault, Sealed
from ..controllers.signal_map import wire
from ..errors import SeqsweepError
from ..injection import turns
from ..kernels.compiled import Fixed
from ..operating_range import Asked, refuse_outside
from ..protocol import (
    Compensation,
    Conditions,
    Job,
    NotSettled,
    OperatingPoint,
    OperatingRange,
    Phasors,
    Rating,
    Record,
    Source,
    Trace,
    Window,
)
from ..space_vectors import PHASE_PEAK
from ..states.steady_state import Clock, Patience, until_periodic, voltage_asked
from ..turbine import equilibrium as stationary
from ..turbine.parameters import TurbineParameters
from . import circuit
from .kernel_arguments import Signals, cached_fault, cached_moments, cached_network, cells_of, port_of, wiring_of
from .state import GreyState, Sight

POWER_W = (0.05e6, 1.35e6)
"""Active power that the machine side can deliver: that of the reference turbine."""

VOLTAGE_PU = (0.85, 1.15)

HELD = 1e-9
"""Mismatch of |v_pcc| behind a grid that is accepted, relative."""

HELD_TRIALS = 20

CALM_S = 0.5
"""After this time a loop that swings up shows it."""

SIGHT_S = 2e-3
"""Time constant with which v_pcc is seen from the source: negative sequence is no slip, half a turn is not missed."""


class SampledTurbine:
    """A controller in the turbine's circuit; `GreyTurbine` is what users meet.

    Parameters
    ----------
    open_controller : callable
        Makes the controller; it is loaded into this process.
    inputs, outputs : mapping
        The signal map.
    parameters : TurbineParameters
        Those of the circuit.
    dt_s : float
        Sample time (s).
    delay : 0 or 1
        Samples by which the converter follows late.
    patience : Patience
        When it counts as settled.
    block : Compensation
        What stands at the measurement port, between v_pcc and the controller.
    """

    id = "dpmsg-grey-v1"
    power_meaning = (
        "P_machine: constant power into the DC link, which the lossless converter carries at rest where its control "
        "holds v_dc; not of the PCC"
    )

    def __init__(
        self,
        open_controller: Callable[[], Sealed],
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        parameters: TurbineParameters,
        dt_s: float,
        delay: int,
        patience: Patience,
        block: Compensation,
    ):
        self.parameters, self.dt_s = parameters, dt_s
        self.f1_hz = parameters.w1_rad_s / (2.0 * pi)
        self.rating = Rating(parameters.u_rated_v, parameters.s_rated_va)
        self.operating_range = self._limits()
        self._delay, self._patience = delay, patience
        self.compensation = block
        self._port = port_of(block, parameters.w1_rad_s, dt_s)
        self._signals = Signals(self.f1_hz, dt_s)
        self.controller = open_controller()
        self._map = wire(self.controller.input_terminals, self.controller.output_terminals, inputs, outputs)
        self._box = self._as_box()

    def _limits(self) -> OperatingRange:
        low, high = VOLTAGE_PU
        return OperatingRange(POWER_W, (low * self.rating.voltage_v, high * self.rating.voltage_v))

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """The periodic steady state, reached by running; see `Plant.settle`.

        The circuit starts at the reference turbine's equilibrium, the controller as its library starts it, told the
        outputs that belong there.
        """
        voltage_v = voltage_asked(operating_point, source, self.operating_range, self.rating, self.id)
        if source.kind == "ideal":
            return self._periodic(self._start(operating_point.active_power_w, voltage_v, source))
        if source.voltage_v is None:
            state = self._periodic(self._start(operating_point.active_power_w, voltage_v, source))
            return self._held(state, self._at_pcc)
        voltage_v = self._terminal_voltage(operating_point.active_power_w, source)
        return self._periodic(self._start(operating_point.active_power_w, voltage_v, source))

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """The periodic state, stable or not, but for what the hold between samples moves; see `calmed`.

        What a device does depends on the voltage at its PCC alone. So it is settled on an ideal source there, and
        then put behind the grid and the source that would give the same voltage. A controller that holds the voltage
        itself finds no rest on an ideal source; it is settled behind the grid.

        Raises
        ------
        SeqsweepError
            As `settle`.
        NotSettled
            If it comes to rest neither way.
        """
        if source.kind == "ideal":
            return self.settle(operating_point, source)
        try:
            return self._put_behind(operating_point, source)
        except NotSettled as first:
            try:
                return self.settle(operating_point, source)
            except NotSettled as second:
                words = str(second) if str(second) == str(first) else f"{second}; on an ideal source: {first}"
                raise NotSettled(
                    f"{words}; begin on a stiffer grid (scale), or with less power (active_power_mw)", second.status
                ) from None

    def calmed(self, state: GreyState) -> GreyState:
        """Onwards until the waveforms repeat, as after `settle`.

        Between samples a voltage behind a grid moves as it does not on an ideal source: by parts in 1e5 at 20 us.

        Raises
        ------
        NotSettled
            If they do not: the closed loop is unstable.
        """
        state, before = self._changing(state)
        ((state, _),) = self.run([Job(state, None)], round(CALM_S / self.dt_s))
        state, after = self._changing(state)
        if not after <= max(before, self._patience.tolerance):
            raise NotSettled("the closed loop swings up")
        return self._periodic(state)

    def _changing(self, state: GreyState) -> tuple[GreyState, float]:
        """Two periods on, and how much the current changed from one to the other, over its peak."""
        n = Clock(self.f1_hz, self.dt_s).period_steps
        ((state, record),) = self.run([Job(state, None)], 2 * n)
        turn = turns(self.f1_hz * n * self.dt_s)
        return state, float(np.max(np.abs(record.i[n:] - turn * record.i[:n])) / np.max(np.abs(record.i)))

    def _put_behind(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """Settled on an ideal source, and put behind the grid."""
        power_w = operating_point.active_power_w
        voltage_v = voltage_asked(operating_point, source, self.operating_range, self.rating, self.id)
        wanted = cmath.exp(1j * source.angle_rad)
        if source.voltage_v is not None:
            wanted *= PHASE_PEAK * source.voltage_v
            voltage_v = self._terminal_voltage(power_w, source)
        ahead = stationary.thevenin_voltage(self.parameters, power_w, voltage_v, source.r_ohm, source.l_h)
        at_pcc = Source("ideal", angle_rad=source.angle_rad - cmath.phase(ahead))

        def ratio(state: GreyState) -> tuple[GreyState, complex]:
            found = self._source_behind(state, source) / wanted
            return state, found if source.voltage_v is not None else found / abs(found)

        state = self._held(self._periodic(self._start(power_w, voltage_v, at_pcc)), ratio)
        x = state.x.copy()
        _, x[2] = self._terminals(state)
        return replace(state, x=x, source=source, v_source=self._source_behind(state, source))

    def _source_behind(self, state: GreyState, source: Source) -> complex:
        """Voltage (V, phase peak) at time zero of the source that gives v_pcc as it is, behind its impedance."""
        v, i_g = self._terminals(state)
        return (v - circuit.impedance(source, self.f1_hz) * i_g) * turns(-self.f1_hz * state.step * self.dt_s)

    def _terminals(self, state: GreyState) -> tuple[complex, complex]:
        """v_pcc and i_g."""
        network = self._network(state.source).argument
        e = state.v_source * turns(self.f1_hz * state.step * self.dt_s)
        v, i_g = network.v_states @ state.x[:3], network.i_states @ state.x[:3]
        return complex(v + network.v_source * e), complex(i_g + network.i_source * e)

    def _terminal_voltage(self, power_w: float, source: Source) -> float:
        """|v_pcc| (V, line-to-line RMS) behind a source of fixed voltage, as the reference turbine would have it."""
        assert source.voltage_v is not None
        try:
            return stationary.terminal_voltage_for_source(
                self.parameters, power_w, source.voltage_v, source.r_ohm, source.l_h
            )
        except ValueError as error:
            raise NotSettled(str(error)) from None

    def _at_pcc(self, state: GreyState) -> tuple[GreyState, complex]:
        """A period on, and |v_pcc| over what was asked."""
        ((state, record),) = self.run([Job(state, None)], Clock(self.f1_hz, self.dt_s).period_steps)
        found = abs(np.mean(record.v * np.exp(-2j * pi * self.f1_hz * record.time_s)))
        return state, complex(found / (PHASE_PEAK * state.voltage_v))

    def _held(self, state: GreyState, ratio_of: Callable[[GreyState], tuple[GreyState, complex]]) -> GreyState:
        """Onwards to the source voltage at which a ratio is one: its size by secant steps, its angle by turning."""
        factor, before, held = 1.0, None, max(HELD, self._patience.tolerance)
        for _ in range(HELD_TRIALS):
            state, ratio = ratio_of(state)
            excess, step = abs(ratio) - 1.0, 0.0
            if abs(ratio - 1.0) <= held:
                return state
            if abs(excess) > held:
                slope = 1.0 if before is None else (excess - before[1]) / (factor - before[0])
                if not slope > 0.0:
                    break
                before, step = (factor, excess), max(-0.05, min(0.05, -excess / slope))
            turn = cmath.exp(-1j * cmath.phase(ratio))
            state = self._periodic(replace(state, v_source=state.v_source * turn * (factor + step) / factor))
            factor += step
        raise NotSettled(
            f"|v_pcc| or the source voltage stays {excess:+.2g} away from what is asked, whatever the other: the "
            "grid cannot carry the power, or the controller holds the voltage itself"
        )

    def _start(self, power_w: float, voltage_v: float, source: Source) -> GreyState:
        """Circuit and controller at time zero."""
        p = self.parameters
        rest = stationary.grid_side_equilibrium(p, power_w, voltage_v)
        v_source = rest.v_pcc
        if source.kind == "thevenin":
            v_source = stationary.thevenin_voltage(p, power_w, voltage_v, source.r_ohm, source.l_h)
        turn = PHASE_PEAK * cmath.exp(1j * (source.angle_rad - cmath.phase(v_source)))
        command = rest.v_conv * turn
        i_g = rest.i_g * turn
        x = np.array([rest.i_l * turn, rest.v_c * turn, i_g, command, *self._port_at_rest(i_g)])
        energy = 0.5 * p.c_dc_f * p.v_dc_ref_v**2
        state = GreyState(0, 0.0, x, energy, None, v_source * turn, source, power_w, voltage_v)
        return replace(state, memory=self._begun(state, command))

    def _begun(self, state: GreyState, command: complex) -> Any:
        """What the controller remembers, begun anew in ``state`` with the outputs that make ``command``."""
        from ..kernels import grey as kernel

        self.controller = controller = self.controller.renewed()
        self._box = self._as_box()
        network, store, quantities = self._surroundings(state)
        box = self._box.argument
        kernel.inform(box, network, store, quantities, state.x, state.v_source, state.energy)
        per = 0.5 * quantities[kernel.V_DC] if self._map.modulated else 1.0
        for part in self._map.outputs:
            value = (command * part.direction.conjugate()).real * part.gain / per
            getattr(box.outputs, part.type)[part.cell] = value
        controller.start()
        return controller.memory()

    def _periodic(self, state: GreyState) -> GreyState:
        def run(first_step: int, n_steps: int) -> np.ndarray:
            nonlocal state
            ((state, record),) = self.run([Job(state, None)], n_steps)
            v_dc = sqrt(2.0 * state.energy / p.c_dc_f) / p.v_dc_ref_v  # a wave that turns with the others
            dc = v_dc * np.exp(2j * pi * self.f1_hz * record.time_s)
            return np.stack([record.v / self.rating.peak_voltage_v, record.i / self.rating.peak_current_a, dc])

        p = self.parameters
        try:
            until_periodic(run, Clock(self.f1_hz, self.dt_s), self._patience)
        except NotSettled as refusal:
            advice = (
                "the closed loop is unstable, or a sign, a unit or a base of the signal map is wrong"
                if refusal.status == "diverged"
                else "patience_s sets the time, settle_tolerance the change: 1e-6 for a controller in single precision"
            )
            raise NotSettled(f"{refusal} ({advice})", refusal.status) from None
        return state

    # ------------------------------------------------------------------ driving

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[GreyState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [self._run_one(job, n_steps) for job in jobs]

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[GreyState, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        return [self._listen_one(job, window, block_steps, n_blocks) for job, window in zip(jobs, windows, strict=True)]

    def trace(self, state: GreyState, conditions: Conditions, n_steps: int) -> tuple[GreyState, Trace]:
        """Go on under ``conditions``; see `MeasuredPlant.trace`.

        Raises
        ------
        SeqsweepError
            If the state's source is ideal, or the conditions ask for wind or for a power out of range.

        Notes
        -----
        ``power_scale`` multiplies the power into the DC link, and the reference that the controller may be told.
        ``rotor_rad_s`` is NaN: no rotor moves here. What a controller synchronises by is its own secret, so
        ``sync_rad`` is the angle of v_pcc, smoothed by `SIGHT_S`, counted for as long as one trace follows another.
        """
        from ..kernels import grey as kernel

        start = self._surrounded(state, conditions)
        block = self.compensation if conditions.compensation is None else conditions.compensation
        port = self._port._replace(r_ohm=block.r_ohm, x_ohm=block.x_ohm)
        v, i, v_dc = np.full(n_steps, np.nan, complex), np.full(n_steps, np.nan, complex), np.full(n_steps, np.nan)
        seen, share = np.full(n_steps + 1, np.nan, complex), 1.0 - exp(-self.dt_s / SIGHT_S)
        seen[0], angle_rad = state.sight or self._sight(state)

        def go_on(box: Any, source: Any, network: Any, *others: Any) -> None:
            skew = None
            if any(conditions.fault_s):
                fault = self.parameters, start.source, self.f1_hz, self.dt_s, conditions.fault_s
                network, forcing, skew = cached_fault(*fault)
                source = source._replace(forcing=forcing)
            kernel.advance_tracing(box.argument._replace(port=port), source, network, skew, *others)

        end = self._advance(Job(start, None), n_steps, go_on, v, i, v_dc, seen, share)
        sync = np.unwrap(np.append(angle_rad, np.angle(seen[1:])))[1:]
        end = replace(end, power_w=state.power_w, sight=Sight(seen[-1], angle_rad if n_steps == 0 else sync[-1]))
        record = Record(state.time_s, self.dt_s, v, -i, self.f1_hz, "load", self.id)
        return end, Trace(record, v_dc, np.full(n_steps, np.nan), sync)

    def _surrounded(self, state: GreyState, conditions: Conditions) -> GreyState:
        """The state with the conditions' grid and power."""
        if state.source.kind != "thevenin":
            raise SeqsweepError("trace needs a state behind a thevenin source; this one has an ideal source")
        if conditions.wind_m_s is not None:
            raise SeqsweepError(
                f"{self.id} has no wind: the power into its DC link is what is asked; give a power step "
                "(power_step, active_power_mw) in place of the wind step"
            )
        if not (conditions.r_ohm >= 0.0 and conditions.l_h > 0.0):
            raise SeqsweepError(
                f"a grid needs r_ohm >= 0 and l_h > 0; got {conditions.r_ohm:g} ohm, {conditions.l_h:g} H"
            )
        power_w = state.power_w * conditions.power_scale
        limits = self.operating_range.active_power_w
        refuse_outside(self.id, [Asked("active power", power_w, limits, 1e6, "MW")])
        source = replace(state.source, r_ohm=conditions.r_ohm, l_h=conditions.l_h)
        return replace(state, source=source, power_w=power_w)

    def _sight(self, state: GreyState) -> Sight:
        """How v_pcc is seen at first: as it is."""
        v, _ = self._terminals(state)
        ratio = v / (state.v_source * turns(self.f1_hz * state.step * self.dt_s))
        return Sight(ratio, cmath.phase(ratio))

    def _run_one(self, job: Job, n_steps: int) -> tuple[GreyState, Record]:
        from ..kernels import grey as kernel

        v, i = np.full(n_steps, np.nan, complex), np.full(n_steps, np.nan, complex)
        end = self._advance(job, n_steps, kernel.advance_recording, v, i)
        return end, Record(job.state.time_s, self.dt_s, v, -i, self.f1_hz, "load", self.id)

    def _listen_one(self, job: Job, window: Window, block_steps: int, n_blocks: int) -> tuple[GreyState, Phasors]:
        from ..kernels import grey as kernel

        lines_hz, first_s = (window.f_hz, 2.0 * self.f1_hz - window.f_hz), job.state.step * self.dt_s
        steps_per_window = window.n_blocks * block_steps
        sums = np.zeros((n_blocks, 4), complex)
        end = self._advance(
            job,
            n_blocks * block_steps,
            kernel.advance_blocks,
            np.array([turns(-f_hz * first_s) for f_hz in lines_hz]),
            np.array([turns(-f_hz * self.dt_s) for f_hz in lines_hz]),
            turns((window.first_block % window.n_blocks) / window.n_blocks),
            turns(1.0 / steps_per_window),
            block_steps,
            sums,
        )
        if not isfinite(end.energy):
            sums[:] = np.nan
        sums /= kernel.TAPER_MEAN * steps_per_window
        return end, Phasors(sums[:, :2].copy(), -sums[:, 2:])

    def _advance(self, job: Job, n_steps: int, kernel_of: Any, *listening: Any) -> GreyState:
        """Put everything back to the job's state, go on, and keep where it ended."""
        from ..kernels import grey as kernel

        state, controller = job.state, self.controller
        controller.restore(state.memory)
        x = state.x.copy()
        network, store, quantities = self._surroundings(state)
        ending = np.array([state.energy, kernel.DONE])
        kernel_of(self._box, self._tones(job), network, store, state.step, quantities, x, ending, *listening)
        energy, how = ending.tolist()
        controller.check()
        if how == kernel.REFUSED:
            raise controller.refusal()
        if how == kernel.NOT_A_NUMBER:
            raise ControllerFault(f"{self._silent_port()} is not a finite number at {controller.time[0]:.6g} s")
        if how == kernel.EMPTY:
            energy = np.nan  # the DC link is empty: nothing is left to go on from
        step = state.step + n_steps
        time_s, memory = step * self.dt_s, controller.memory()
        return replace(state, step=step, time_s=time_s, x=x, energy=energy, memory=memory, sight=None)

    def _as_box(self) -> Fixed:
        """The controller as the kernel takes it."""
        from ..kernels import grey as kernel

        controller = self.controller
        inputs, outputs = cells_of(controller.inputs.cells), cells_of(controller.outputs.cells)
        box = kernel.Box(controller.addresses, controller.time, inputs, outputs, wiring_of(self._map), self._port)
        return Fixed(box)

    def _port_at_rest(self, i_g: complex) -> tuple[complex, complex]:
        """States of the band pass that lets the fundamental ``i_g`` through whole."""
        port = self._port
        before = i_g * turns(-self.f1_hz * self.dt_s)
        return (1.0 - port.gain) * i_g, -(port.gain + port.a_2) * before

    def _surroundings(self, state: GreyState) -> tuple[Any, Any, np.ndarray]:
        """Network, DC link and references, as the kernel takes them."""
        from ..kernels import grey as kernel

        quantities = np.zeros(kernel.N_QUANTITIES)
        quantities[kernel.P_REF], quantities[kernel.V_REF], quantities[kernel.ONE] = state.power_w, state.voltage_v, 1.0
        store = self._store(state)
        quantities[kernel.Q_REF] = state.reactive_var
        return self._network(state.source), store, quantities

    def _network(self, source: Source) -> Fixed:
        return cached_network(self.parameters, source, self.dt_s)

    def _moments(self, source: Source) -> np.ndarray:
        return cached_moments(self.parameters, source, self.dt_s)

    def _forcing(self, source: Source, f_hz: Any) -> np.ndarray:
        return circuit.forcing(self._moments(source), f_hz, self.dt_s)

    def _store(self, state: GreyState) -> Any:
        """DC link and rhythm, as the kernel takes them."""
        from ..kernels.grey import Store

        return Store(self.parameters.c_dc_f, state.power_w, self.dt_s, self._delay, 0.0, 0.0)

    def _tones(self, job: Job) -> Any:
        """The source as the kernel takes it, the fundamental first."""
        from ..kernels import grey as kernel

        state, first_s = job.state, job.state.step * self.dt_s
        played = self._signals.of(job.injection, state.source, self._forcing)
        volts = [state.v_source, *played.volts]
        phasors = np.array([v * turns(f_hz * first_s) for f_hz, v in zip(played.f_hz, volts, strict=True)])
        return kernel.Tones(phasors, played.rotations, played.forcing, played.table)

    def _silent_port(self) -> str:
        """The first wired output that is not finite, in words."""
        cells = cells_of(self.controller.outputs.cells)
        for part in self._map.outputs:
            if not isfinite(getattr(cells, part.type)[part.cell]):
                for port in self.controller.output_terminals:
                    if port.type == part.type and port.first <= part.cell < port.first + port.width:
                        return f"output port {port.name!r}"
        return "an output"
