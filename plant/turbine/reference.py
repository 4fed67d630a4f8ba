"""``dpmsg-v1``: the reference wind turbine (D-PMSG with back-to-back converters) of the paper.

White to us, black to everything above this folder. Equations and parameters: docs/turbine.md. The
plant works in the dq frame at w1 and in power-invariant quantities; records leave it as phase-peak
space vectors in load direction.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ..circuits.dynamics import SOUND
from ..damping.control import DAMPING_RANGES, NOTCH_XI, checked_compensation
from ..damping.grid_side import GridSideDamper
from ..errors import SeqsweepError
from ..injection import check_source, series_tones, turns
from ..lanes import Chart, n_tones_of, phasors_of, set_complex
from ..operating_range import Asked, refuse_outside
from ..protocol import (
    Compensation,
    Conditions,
    Job,
    Member,
    NotSettled,
    OperatingPoint,
    OperatingRange,
    PhasorRun,
    Phasors,
    Rating,
    Record,
    Source,
    Trace,
    Window,
)
from ..space_vectors import PHASE_PEAK
from ..under_way import Clockwork, in_lanes, of_each, standing
from . import behind_network as network
from . import equilibrium as stationary
from .asked import Kind, checked_integrator, is_reactive, kinds_of, left_to_d, order_of, power_of
from .flow import poles_apart, poles_of
from .parameters import LINE_L_H, LINE_R_OHM, TABLE_I, TurbineParameters
from .state import TurbineState
from .steps import Steps, of_fourth_order, of_second_order
from .tone_table import SourceTable, common_period, pays, period_of, side_by_side
from .under_way import clockwork_of, lanes_under_way

if TYPE_CHECKING:
    from .farm import TurbineFarm

_RESIDUAL_LIMIT = 1e-9
"""Largest change over one period, relative to rated, of a certified steady state."""


class ReferenceTurbine:
    """The complete D-PMSG of Table I on an ideal or a Thevenin source.

    Parameters
    ----------
    dt_s : float
        Step (s); the classical Runge-Kutta method of order four is stable to about 0.5 ms.
    damping_gain : float
        Gain k of the damping control at the measurement port, 0 (off) to 2.
    damping_r_ohm, damping_l_h : float
        R_grid (ohm) and L_grid (H) of the damping control; those of the line of Table I by default.
    damping_resonance_hz : float
        Signed frequency w_r / 2 pi of the stronger resonance component (Hz).
    integrator : "rk4" or "emt"
        The classical Runge-Kutta method, or a second-order step at half its price; see docs/turbine.md. ``trace``
        is Runge-Kutta's always.
    **parameters : float
        Fields of `TurbineParameters` to replace, e.g. ``k_pp=0.1``.

    Raises
    ------
    SeqsweepError
        If a parameter is unknown or out of its range, or damping control is asked of the integrator "emt".
    """

    id = "dpmsg-v1"
    releases_gil = True
    power_meaning = "P_machine = Re(v_conv conj(i_L)): power of the lossless converters, not of the PCC"

    def __init__(
        self,
        dt_s: float = 50e-6,
        *,
        damping_gain: float = 0.0,
        damping_r_ohm: float = LINE_R_OHM,
        damping_l_h: float = LINE_L_H,
        damping_resonance_hz: float = 77.0,
        integrator: str = "rk4",
        **parameters: float,
    ):
        unknown = sorted(set(parameters) - set(TurbineParameters._fields))
        if unknown:
            known = (*DAMPING_RANGES, "integrator", *TurbineParameters._fields)
            raise SeqsweepError(f"{self.id} has no parameter {unknown[0]!r}; it has {', '.join(known)}")
        damping = [float(x) for x in (damping_gain, damping_r_ohm, damping_l_h, damping_resonance_hz)]
        if not 0.0 < dt_s <= 5e-4:
            raise SeqsweepError(f"dt_s is {dt_s:g} s; {self.id} needs a step above 0 and up to 5e-4 s")
        self.parameters = TABLE_I._replace(**{name: float(value) for name, value in parameters.items()})
        self.compensation = checked_compensation(self.id, damping)
        self.integrator = checked_integrator(integrator, self.compensation)
        self.dt_s = float(dt_s)
        self.f1_hz = self.parameters.w1_rad_s / (2.0 * pi)
        self.rating = Rating(self.parameters.u_rated_v, self.parameters.s_rated_va)
        # the batches of an operating point settle one after the other
        self._settled: tuple[tuple[OperatingPoint, Source], TurbineState] | None = None
        self._table: SourceTable | None = None  # a signal is played period by period
        u = self.parameters.u_rated_v
        self.operating_range = OperatingRange((0.05e6, 1.35e6), (0.85 * u, 1.15 * u), (-0.6e6, 0.6e6))

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> TurbineState:
        """The equilibrium at ``operating_point``, certified over a period and found stable.

        Raises
        ------
        SeqsweepError
            If the operating point is outside `operating_range`, or says |v_pcc| twice or not at all.
        NotSettled
            If there is no equilibrium ("not_settled") or it is unstable ("diverged").
        """
        asked, known = (operating_point, source), self._settled
        if known is not None and known[0] == asked:
            return known[1]
        state = self.equilibrium(*asked)
        self._certify(state)
        self._settled = asked, state
        return state

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> TurbineState:
        """The equilibrium at ``operating_point``, stable or not."""
        p = self.parameters
        power_va, terminal_voltage_v = power_of(operating_point), self._terminal_voltage(operating_point, source)
        self._check_range(power_va, terminal_voltage_v)
        machine = stationary.machine_equilibrium(p, power_va.real)
        grid_side = stationary.grid_side_equilibrium(p, power_va, terminal_voltage_v)
        self._check_limits(grid_side)
        v_source = grid_side.v_pcc
        if source.kind != "ideal":
            grid = network.thevenin_of(source, p.w1_rad_s)
            v_source = stationary.thevenin_voltage(p, power_va, terminal_voltage_v, grid.r_ohm, grid.l_h) / grid.gain
        turn = cmath.exp(1j * (source.angle_rad - cmath.phase(v_source)))
        i_l, v_c, i_g = grid_side.i_l * turn, grid_side.v_c * turn, grid_side.i_g * turn
        values = np.array(
            [
                *(i_l.real, i_l.imag, cmath.phase(turn), 0.0),
                *(grid_side.xi_dc, grid_side.xi_d, grid_side.xi_q, p.v_dc_ref_v),
                *(machine.i_d, machine.i_q, machine.xi_d, machine.xi_q, machine.w_m),
                *(v_c.real, v_c.imag, i_g.real, i_g.imag),
                *(i_g.real, i_g.imag, i_g.imag, -i_g.real),  # the notch holds i_g back, and -1j i_g
            ]
        )
        values.setflags(write=False)
        state = TurbineState(0, 0.0, values, machine.wind_speed_m_s, grid_side.i_q_ref, v_source * turn, source)
        return state if source.circuit is None else network.at_rest(state, p, self.dt_s)

    def linearise(self, state: TurbineState) -> np.ndarray:
        """Poles of the small-signal system around ``state`` in the dq frame (rad/s), worst first.

        Central differences of the plant's own flow over ten steps: what the stepper does, not what
        the equations say. With an ideal source the shunt (1e5 rad/s) and the unused line are left out,
        without compensation its notch; the states of a network are its own.
        """
        from ..kernels import turbine as kernel

        behind = state.source.kind
        kept = [*range(kernel.NOTCH if behind == "thevenin" else kernel.V_C_RE)]
        if self._compensated:
            kept += range(kernel.NOTCH, kernel.N_STATES)
        around = network.surroundings(Job(state, None), self.parameters, self.dt_s) if behind == "network" else None
        chart, (kind,) = Chart(state, kept, around), kinds_of([Job(state, None)], self.parameters)
        if kind.calm and around is None and self.integrator == "rk4":
            return poles_apart(self._stepped, chart, self.parameters, self.dt_s)
        return poles_of(self._stepped, chart, self.dt_s)

    def _certify(self, state: TurbineState) -> None:
        steps = max(1, round(1.0 / (self.f1_hz * self.dt_s)))
        ((end, _),) = self._stepped([Job(state, None)], steps)
        residual = np.max(np.abs(end.values - state.values) / np.maximum(np.abs(state.values), 1.0))
        worst = self.linearise(state)[0]
        if worst.real > 0.0:
            ideal = state.source.kind == "ideal"
            way_out = "change its parameters" if ideal else "use an ideal source to sweep it, or a stronger grid"
            raise NotSettled(
                f"the equilibrium is unstable: {worst.real:+.3g} rad/s at {abs(worst.imag) / (2 * pi):.3g} Hz in the "
                f"dq frame; {way_out}",
                status="diverged",
            )
        if not residual <= _RESIDUAL_LIMIT:
            raise NotSettled(f"the state changes by {residual:.2g} over one period; {_RESIDUAL_LIMIT:g} is needed")

    def _terminal_voltage(self, operating_point: OperatingPoint, source: Source) -> float:
        check_source(operating_point, source, networks=self.integrator == "rk4")
        if operating_point.terminal_voltage_v is not None:
            return operating_point.terminal_voltage_v
        assert source.voltage_v is not None
        if source.kind == "ideal":
            return source.voltage_v
        grid = network.thevenin_of(source, self.parameters.w1_rad_s)
        try:
            return stationary.terminal_voltage_for_source(
                self.parameters, power_of(operating_point), abs(grid.gain) * source.voltage_v, grid.r_ohm, grid.l_h
            )
        except SeqsweepError as error:
            raise NotSettled(str(error)) from None

    def _check_range(self, power_va: complex, terminal_voltage_v: float) -> None:
        limits = self.operating_range
        power = Asked("active power", power_va.real, limits.active_power_w, 1e6, "MW")
        reactive = Asked("reactive power", power_va.imag, limits.reactive_power_var, 1e6, "Mvar")
        voltage = Asked("|v_pcc|", terminal_voltage_v, limits.terminal_voltage_v, self.rating.voltage_v, "pu")
        refuse_outside(self.id, (power, reactive, voltage))

    def _check_limits(self, grid_side: stationary.GridSideEquilibrium) -> None:
        p = self.parameters
        if abs(grid_side.v_conv) > p.v_dc_ref_v / sqrt(2.0):
            raise NotSettled(
                f"the converter would need {abs(grid_side.v_conv):.0f} V; its limit is {p.v_dc_ref_v / sqrt(2):.0f} V"
            )
        if abs(grid_side.i_l) > p.i_limit_a:
            raise NotSettled(f"the converter would need {abs(grid_side.i_l):.0f} A; its limit is {p.i_limit_a:.0f} A")

    def _moved(self, state: TurbineState, steps: int, values: np.ndarray) -> TurbineState:
        """The state ``steps`` further, with other ``values``."""
        values.setflags(write=False)
        step = state.step + steps
        return replace(state, step=step, time_s=step * self.dt_s, values=values)

    # ------------------------------------------------------------------ driving

    @property
    def _compensated(self) -> bool:
        return self.compensation != Compensation()

    def steps_of(self, kind: Kind, table: np.ndarray) -> Steps:
        """What steps jobs of a kind on a source or behind a line, told their table; only that one is compiled."""
        of = of_second_order if self.integrator == "emt" else of_fourth_order
        return of(kind, self._compensated, table)

    def tones_of(self, job: Job) -> list[tuple[float, complex]]:
        """Tones of a job as (frequency in the dq frame in Hz, power-invariant voltage at time zero in V)."""
        return [(f_hz - self.f1_hz, v / PHASE_PEAK) for f_hz, v in series_tones(job.injection, job.state.source)]

    def _source_table(self, jobs: list[Job]) -> np.ndarray:
        """The jobs' sources over a period as the kernel's table, (n, 4, LANES); of no rows where tones are cheaper."""
        from ..kernels.turbine import LANES

        if self.integrator == "emt" or not pays(max(n_tones_of(job.injection) for job in jobs)):
            return np.zeros((0, 4, LANES))
        known, begins = self._table, [2 * job.state.step for job in jobs]
        if known is not None and known.serves(jobs, begins):
            return known.table
        rows_per_s = 2.0 / self.dt_s
        n_rows = common_period([self.tones_of(job) for job in jobs], rows_per_s)
        if not n_rows:
            return np.zeros((0, 4, LANES))
        periods = [period_of(tuple(self._forced(job)), rows_per_s, n_rows) for job in jobs]
        table = side_by_side(list(zip(periods, begins, strict=True)), LANES)
        self._table = SourceTable.of(jobs, begins, table)
        return table

    def _forced(self, job: Job) -> list[network.Forced]:
        """What the source and the tones of a job force: the PCC's voltage, and the shunt's or, of a network, i_g."""
        if job.state.source.circuit is not None:
            return network.surroundings(job, self.parameters, self.dt_s).forced(self.f1_hz)
        tones = series_tones(job.injection, job.state.source)
        voltages = [(0.0, job.state.v_source), *((f_hz - self.f1_hz, v / PHASE_PEAK) for f_hz, v in tones)]
        return [network.Forced(f, v, self._shunt_voltage_ratio(f + self.f1_hz) * v) for f, v in voltages]

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[TurbineState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        turning = {step: self._turning(step, n_steps) for step in {job.state.step for job in jobs}}
        stepped = zip(jobs, self._stepped(jobs, n_steps), strict=True)
        return [(end, self._record(job.state, samples, turning[job.state.step])) for job, (end, samples) in stepped]

    def _stepped(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[TurbineState, np.ndarray]]:
        """Every job ``n_steps`` further, and its samples (n_steps, 4) on the way."""
        from ..kernels import turbine as kernel

        results: list[tuple[TurbineState, np.ndarray]] = [None] * len(jobs)  # type: ignore[list-item]
        for lanes, members, advance, n_tones in self._batches(jobs, [Window(0.0, 1)] * len(jobs), 1):
            samples = np.empty((n_steps, 4, kernel.LANES))
            advance(lanes, n_tones, self.parameters, self.dt_s, 1, kernel.V_RE, samples)
            ends = self._ends(lanes, [jobs[m] for m in members], n_steps, advance)
            for member, end, of_lane in zip(members, ends, samples.T[: len(members)].copy(), strict=True):
                results[member] = end, of_lane.T
        return results

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[TurbineState, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        from ..kernels import turbine as kernel

        results: list[tuple[TurbineState, Phasors]] = [None] * len(jobs)  # type: ignore[list-item]
        for lanes, members, advance, n_tones in self._batches(jobs, windows, block_steps):
            sums = np.empty((n_blocks, 8, kernel.LANES))
            advance(lanes, n_tones, self.parameters, self.dt_s, block_steps, kernel.SUM_V, sums)
            ends = self._ends(lanes, [jobs[m] for m in members], block_steps * n_blocks, advance)
            for member, end, phasors in zip(members, ends, phasors_of(sums, PHASE_PEAK, -PHASE_PEAK), strict=False):
                results[member] = end, phasors
        return results

    def phasor_run(self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int) -> PhasorRun | None:
        """Jobs on their way together; see `LanePlant`."""
        own = getattr(self.run_phasors, "__func__", None) is ReferenceTurbine.run_phasors  # an heir's is asked instead
        return lanes_under_way(self, jobs, windows, block_steps) if own else None

    def trace(self, state: TurbineState, conditions: Conditions, n_steps: int) -> tuple[TurbineState, Trace]:
        """Go on under ``conditions``, with everything worth seeing; see `MeasuredPlant.trace`.

        Raises
        ------
        SeqsweepError
            If the state's source is ideal: faults and grid steps need a grid.

        Notes
        -----
        A bolted fault leaves the shunt its own time constant Rf Cf (10 us): steps are cut to that.
        """
        if state.source.kind == "ideal":
            raise SeqsweepError("trace needs a state behind a thevenin source; this one has an ideal source")
        start = self._surrounded(state, conditions)
        of_scaled_law = self.parameters._replace(k_opt=self.parameters.k_opt * conditions.power_scale)
        along = self._traced if start.source.circuit is None else self._traced_in_network
        end, samples = along(start, conditions, of_scaled_law, n_steps)
        sync = samples[:, 6] - cmath.phase(state.v_source)
        turning = self._turning(start.step, n_steps)
        return end, Trace(self._record(start, samples, turning), samples[:, 4], samples[:, 5], sync)

    def _traced(
        self, start: TurbineState, conditions: Conditions, p: TurbineParameters, n_steps: int
    ) -> tuple[TurbineState, np.ndarray]:
        """State and samples (n_steps, 7) behind R and L."""
        from ..kernels import turbine as kernel

        lane = self.columns([Job(start, None)], [Window(0.0, 1)], 1, 0)[0][:, 0]
        self._set_port(lane, start, conditions)
        lanes = np.repeat(lane, kernel.LANES)
        cut = ceil(self.dt_s / (p.r_f_ohm * p.c_f_f) * (1.0 - 1e-9))
        samples = np.empty((n_steps, 7))
        kernel.advance_tracing(is_reactive(start) or None, lanes, p, self.dt_s / cut, cut, samples)
        (end,) = self._ends(lanes, [Job(start, None)], n_steps)
        return end, samples

    def _traced_in_network(
        self, start: TurbineState, conditions: Conditions, p: TurbineParameters, n_steps: int
    ) -> tuple[TurbineState, np.ndarray]:
        """State and samples (n_steps, 7) behind a network, a fault being a part of it."""
        job = Job(start, None)
        lane = self.columns([job], [Window(0.0, 1)], 1, 1)[0][:, 0]
        self._set_port(lane, start, replace(conditions, fault_s=SOUND))
        lanes, samples, after = network.traced(lane, job, is_reactive(start), p, self.dt_s, conditions.fault_s, n_steps)
        (end,) = self._ends(lanes, [job], n_steps)
        return after(end), samples

    def _surrounded(self, state: TurbineState, conditions: Conditions) -> TurbineState:
        """The state with the conditions' grid and wind."""
        return replace(
            state,
            source=replace(
                state.source,
                r_ohm=conditions.r_ohm,
                l_h=conditions.l_h,
                circuit=conditions.circuit or state.source.circuit,
            ),
            wind_m_s=state.wind_m_s if conditions.wind_m_s is None else conditions.wind_m_s,
        )

    def _set_port(self, lane: np.ndarray, state: TurbineState, conditions: Conditions) -> None:
        """Compensation and fault into one lane's column."""
        from ..kernels import turbine as kernel

        compensation = self.compensation if conditions.compensation is None else conditions.compensation
        lane[kernel.COMP_R], lane[kernel.COMP_X] = compensation
        share, skew = _fault_division(self.parameters.r_f_ohm, conditions.fault_s)
        lane[kernel.FAULT_SHARE] = share
        set_complex(lane, kernel.FAULT_SKEW_RE, skew * turns(-2.0 * self.f1_hz * state.step * self.dt_s))

    def _batches(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int
    ) -> Iterator[tuple[np.ndarray, list[int], Callable[..., None], int]]:
        """Flat arrays of up to LANES jobs of one kind: (array, job indices, kernel, tones).

        A job ends with the same bytes whatever it is run together with.
        """
        from ..kernels.turbine import LANES

        kinds = kinds_of(jobs, self.parameters)
        for kind in sorted(set(kinds), key=order_of):
            of_kind = [m for m, own in enumerate(kinds) if own == kind]
            for first in range(0, len(of_kind), LANES):
                members = of_kind[first : first + LANES]
                together = [jobs[m] for m in members]
                table = self._source_table(together)
                n_tones = 0 if len(table) else max(n_tones_of(job.injection) for job in together)
                columns, _ = self.columns(together, [windows[m] for m in members], block_steps, n_tones)
                (lanes,) = in_lanes(columns, np.arange(len(together)))
                if kind.circuit is None:
                    advance: Callable[..., None] = self.steps_of(kind, table)
                else:
                    advance = network.NetworkKernel(together, kind.reactive, table, self.parameters, self.dt_s)
                yield lanes.ravel(), members, advance, n_tones

    def columns(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_tones: int
    ) -> tuple[np.ndarray, Clockwork]:
        """The jobs' columns of the flat array, (n_slots, n), and what turns in them."""
        from ..kernels import turbine as kernel

        x = standing([job.state for job in jobs], partial(self._column, kernel.array_slots(n_tones)))
        clockwork = clockwork_of(self, jobs, windows, block_steps, n_tones)
        clockwork.set_rotations(x)
        clockwork.set_phasors(x, np.arange(len(jobs)))
        of_jobs = of_each(jobs, self._shunt_voltage_ratios) if n_tones else [[]] * len(jobs)
        for lane, (job, ratios) in enumerate(zip(jobs, of_jobs, strict=True)):
            if job.state.source.circuit is not None:
                network.set_sources(x[:, lane], self._forced(job), n_tones, job.state.time_s, 0.5 * self.dt_s)
                continue
            for tone, ratio in enumerate(ratios[:n_tones]):
                set_complex(x[:, lane], kernel.TONES + kernel.N_TONE_SLOTS * tone + 4, ratio)
        return x, clockwork

    def _column(self, n_slots: int, state: TurbineState) -> np.ndarray:
        """What stands still in the column of a job from ``state``, (n_slots,)."""
        from ..kernels import turbine as kernel

        x, source = np.zeros(n_slots), state.source
        x[: kernel.N_STATES] = state.values
        self.set_asked(x, state)
        set_complex(x, kernel.V_S_RE, state.v_source)
        set_complex(x, kernel.V_CS_RE, self._shunt_voltage_ratio(self.f1_hz) * state.v_source)
        x[kernel.COMP_R], x[kernel.COMP_X] = self.compensation
        x[kernel.NOTCH_W0] = self.parameters.w1_rad_s
        x[kernel.NOTCH_WIDTH] = 2.0 * NOTCH_XI * self.parameters.w1_rad_s
        x[kernel.FAULT_SHARE] = 1.0
        x[kernel.GRID_R] = source.r_ohm
        x[kernel.GRID_1_L] = 1.0 / source.l_h if source.kind == "thevenin" else 0.0
        return x

    def set_asked(self, x: np.ndarray, state: TurbineState) -> None:
        """What a turbine is asked for into its lane's column: wind, reactive current, what that leaves to i_d."""
        from ..kernels import turbine as kernel

        x[kernel.WIND], x[kernel.I_Q_REF] = state.wind_m_s, state.i_q_ref_a
        x[kernel.I_D_LIMIT] = left_to_d(self.parameters.i_limit_a, state.i_q_ref_a)

    def together(self, members: Sequence[Member], dampers: Sequence[tuple[str, GridSideDamper]] = ()) -> TurbineFarm:
        """Many of it on one network; see `FarmPlant`."""
        from .farm import TurbineFarm

        return TurbineFarm(self, members, dampers)

    def _shunt_voltage_ratios(self, job: Job) -> list[complex]:
        """v_C / v_pcc at the tones of a job."""
        return [self._shunt_voltage_ratio(f_hz) for f_hz, _ in series_tones(job.injection, job.state.source)]

    def _shunt_voltage_ratio(self, f_hz: float) -> complex:
        """v_C / v_pcc of the shunt branch at a signed stationary frequency."""
        p = self.parameters
        return 1.0 / (1.0 + 2j * pi * f_hz * p.r_f_ohm * p.c_f_f)

    def _ends(
        self, lanes: np.ndarray, jobs: list[Job], n_steps: int, advance: Callable[..., None] | None = None
    ) -> list[TurbineState]:
        """The turbines' states after ``advance``, which knows those of their networks."""
        from ..kernels.turbine import LANES, N_STATES

        values = lanes.reshape(-1, LANES)[:N_STATES].T.copy()
        ends = [self._moved(job.state, n_steps, x) for job, x in zip(jobs, values, strict=False)]
        return advance.finished(ends) if isinstance(advance, network.NetworkKernel) else ends

    def _turning(self, step: int, n_steps: int) -> np.ndarray:
        """From the dq frame to the stationary one at so many steps from ``step`` on, in phase peaks."""
        time_s = (step + np.arange(n_steps)) * self.dt_s
        return np.asarray(PHASE_PEAK * np.exp(2j * pi * ((self.f1_hz * time_s) % 1.0)))

    def _record(self, state: TurbineState, samples: np.ndarray, to_stationary: np.ndarray) -> Record:
        v = (samples[:, 0] + 1j * samples[:, 1]) * to_stationary
        i = -(samples[:, 2] + 1j * samples[:, 3]) * to_stationary
        return Record(state.time_s, self.dt_s, v, i, self.f1_hz, "load", self.id)


def _fault_division(r_f_ohm: float, fault_s: tuple[float, float, float]) -> tuple[float, complex]:
    """(share, skew) of (1 + Rf G)^-1 v = share v + skew conj(v), for a symmetric G on (alpha, beta)."""
    aa, ab, bb = fault_s
    inverse = np.linalg.inv(np.eye(2) + r_f_ohm * np.array([[aa, ab], [ab, bb]]))
    return 0.5 * (inverse[0, 0] + inverse[1, 1]), complex(0.5 * (inverse[0, 0] - inverse[1, 1]), inverse[0, 1])
