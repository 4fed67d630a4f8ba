"""How the inverters are driven: jobs into the kernel's lanes, samples, phasors and traces out of them.

The kernel works per unit in the dq frame at w1; what leaves it is a phase-peak space vector in load direction.
"""

from __future__ import annotations

import cmath
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from math import isfinite, pi
from typing import Any

import numpy as np

from ..circuits.circuit import Circuit
from ..circuits.dynamics import Memory
from ..circuits.feeding import Feeding
from ..damping.control import NOTCH_XI
from ..errors import SeqsweepError
from ..injection import series_tones
from ..kernels.compiled import each
from ..lanes import n_tones_of, phasors_of, set_complex
from ..protocol import Compensation, Conditions, Job, PhasorRun, Phasors, Rating, Record, Source, Trace, Window
from ..turbine.tone_table import common_period, pays, waveform
from ..under_way import Clockwork, LanesUnderWay, Places, Rider, in_lanes, of_each, standing
from .behind_network import Bases, NetworkLanes, bases_of, direct_line, feeding, no_load
from .equilibrium import References

_CHUNK_STEPS = 4000
"""Steps of a trace whose states are kept at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class InverterState:
    """All states of an inverter and what it is connected to; opaque to everybody else.

    Attributes
    ----------
    step : int
        Steps since time zero.
    time_s : float
        Time (s).
    values : (24,) float
        The kernel's states, read-only.
    references : References
        What the controls are asked for (pu).
    dc : tuple of float
        Current into the DC link at rated voltage (pu), and its slope over that voltage.
    v_source : complex
        Source voltage in the dq frame (pu).
    source : Source
        What feeds the PCC.
    memory : Memory or None
        Currents and charges of its network, power-invariant; None where there is none.
    """

    step: int
    time_s: float
    values: np.ndarray
    references: References
    dc: tuple[float, float]
    v_source: complex
    source: Source
    memory: Memory | None = None


class LaneDriven(ABC):
    """Jobs in lanes, eight at a time; what a device is, its class says."""

    id: str
    f1_hz: float
    dt_s: float
    rating: Rating
    parameters: Any
    compensation: Compensation

    _kernel: str

    def _advance(self, ending: str) -> Callable[..., None]:
        """The kernel for this device, by the ``ending`` of its name."""
        from ..kernels import inverters as kernel

        linked = "_linked" if isfinite(self.parameters.c_dc_s) else ""
        found: Callable[..., None] = getattr(kernel, f"advance_{self._kernel}{linked}{ending}")
        return found

    def _stepper(self, jobs: list[Job], port: bool) -> tuple[Callable[..., None], NetworkLanes | None]:
        """What steps jobs with one circuit, or none; their networks."""
        if jobs[0].state.source.circuit is None:
            return self._advance("_compensated" if port else ""), None
        networks = NetworkLanes(jobs, self._bases, self.parameters.w1_rad_s, self.dt_s)
        kernel = self._advance("_network")
        return lambda *arguments: kernel(
            *arguments, networks.xi, np.empty_like(networks.xi), networks.weights
        ), networks

    @property
    def _bases(self) -> Bases:
        return bases_of(self.rating)

    @abstractmethod
    def _synchronisation(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (rad) and speed (rad/s; NaN where there is none) of states (n, 24)."""

    @property
    def base_impedance_ohm(self) -> float:
        """What one per unit of impedance means, U^2 / S (ohm)."""
        return self.rating.voltage_v**2 / self.rating.power_va

    def _per_unit(self, source: Source) -> complex:
        """Impedance of the source at f1 (pu)."""
        if source.kind == "ideal":
            return 0j
        if source.circuit is not None:
            return source.circuit.seen_at(1j * self.parameters.w1_rad_s)[0] / self.base_impedance_ohm
        return complex(source.r_ohm, self.parameters.w1_rad_s * source.l_h) / self.base_impedance_ohm

    def _no_load_gain(self, source: Source) -> complex:
        """PCC voltage over the source's where nothing is fed in."""
        return 1.0 + 0j if source.circuit is None else source.circuit.seen_at(1j * self.parameters.w1_rad_s)[1]

    @property
    def _compensated(self) -> bool:
        return self.compensation != Compensation()

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[InverterState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        from ..kernels import inverters as kernel

        results: list[tuple[InverterState, Record]] = []
        for lanes, members, table, tones in self._batches(jobs, [Window(0.0, 1)] * len(jobs), 1):
            samples = np.empty((n_steps, 4, kernel.LANES))
            advance, networks = self._stepper(members, self._compensated)
            advance(table, lanes, tones, self.parameters, self.dt_s, 1, kernel.V_RE, samples)
            ends = self._ends(lanes, members, n_steps, networks)
            results += [
                (end, self._record(job.state, samples[:, :, lane]))
                for lane, (job, end) in enumerate(zip(members, ends, strict=True))
            ]
        return results

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[InverterState, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        from ..kernels import inverters as kernel

        results: list[tuple[InverterState, Phasors]] = []
        v_unit, i_unit = self.rating.peak_voltage_v, -self.rating.peak_current_a
        for lanes, members, table, tones in self._batches(jobs, windows, block_steps):
            sums = np.empty((n_blocks, 8, kernel.LANES))
            advance, networks = self._stepper(members, self._compensated)
            advance(table, lanes, tones, self.parameters, self.dt_s, block_steps, kernel.SUM_V, sums)
            ends = self._ends(lanes, members, block_steps * n_blocks, networks)
            results += zip(ends, phasors_of(sums, v_unit, i_unit), strict=False)
        return results

    def phasor_run(self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int) -> PhasorRun | None:
        """Jobs on their way together; see `LanePlant`."""
        from ..kernels import inverters as kernel

        n_tones = max(n_tones_of(job.injection) for job in jobs)
        own = getattr(self.run_phasors, "__func__", None) is LaneDriven.run_phasors  # an heir's is asked instead
        if not own or pays(n_tones) or any(job.state.source.circuit is not None for job in jobs):
            return None
        columns, clockwork = self._columns(jobs, windows, block_steps, n_tones)
        step, table = self._advance("_compensated" if self._compensated else ""), np.zeros((0, 2, kernel.LANES))

        def advance(lanes: np.ndarray, sums: np.ndarray) -> None:
            each(step, [table, lanes, n_tones, self.parameters, self.dt_s, block_steps, kernel.SUM_V, sums], (1, 7))

        units = self.rating.peak_voltage_v, -self.rating.peak_current_a
        return LanesUnderWay(columns, clockwork, np.zeros(len(jobs), int), [advance], kernel.N_STATES, units)

    def trace(self, state: InverterState, conditions: Conditions, n_steps: int) -> tuple[InverterState, Trace]:
        """Go on under ``conditions``, with everything worth seeing; see `MeasuredPlant.trace`.

        Raises
        ------
        SeqsweepError
            If the state's source is ideal, or the conditions hold a fault or a wind.
        """
        self._refuse_impossible(state, conditions)
        block = self.compensation if conditions.compensation is None else conditions.compensation
        start = replace(
            state,
            source=replace(
                state.source,
                r_ohm=conditions.r_ohm,
                l_h=conditions.l_h,
                circuit=conditions.circuit or state.source.circuit,
            ),
            references=state.references._replace(p=state.references.p * conditions.power_scale),
        )
        now, kept = start, []
        for first in range(0, n_steps, _CHUNK_STEPS):
            now, of_chunk = self._traced(now, block, min(_CHUNK_STEPS, n_steps - first))
            kept.append(of_chunk)
        trace = self._trace_of(start, np.concatenate(kept) if kept else np.empty((0, 0)))
        return replace(now, references=state.references), trace

    def _refuse_impossible(self, state: InverterState, conditions: Conditions) -> None:
        if state.source.kind == "ideal":
            raise SeqsweepError("trace needs a state behind a thevenin source; this one has an ideal source")
        if any(conditions.fault_s):
            raise SeqsweepError(f"{self.id} has no fault at the PCC, which lies between two inductances: step the grid")
        if conditions.wind_m_s is not None:
            raise SeqsweepError(f"{self.id} has no wind: change its active power")

    def _traced(self, state: InverterState, block: Compensation, n_steps: int) -> tuple[InverterState, np.ndarray]:
        """States (24) and sample (4) of one lane before each of ``n_steps`` steps, with ``block`` at the port."""
        from ..kernels import inverters as kernel

        ((lanes, members, table, tones),) = self._batches([Job(state, None)], [Window(0.0, 1)], 1)
        slots = lanes.reshape(-1, kernel.LANES)
        slots[kernel.COMP], slots[kernel.COMP + 1] = (x / self.base_impedance_ohm for x in block)
        kept = np.empty((n_steps, kernel.I_IM + 1, kernel.LANES))
        advance, networks = self._stepper(members, True)
        advance(table, lanes, tones, self.parameters, self.dt_s, 1, 0, kept)
        (end,) = self._ends(lanes, members, n_steps, networks)
        states = np.concatenate([state.values[None], kept[:-1, : kernel.N_STATES, 0]])
        return end, np.concatenate([states, kept[:, kernel.V_RE : kernel.I_IM + 1, 0]], axis=1)

    def _trace_of(self, start: InverterState, kept: np.ndarray) -> Trace:
        from ..kernels import inverters as kernel

        states = kept[:, : kernel.N_STATES]
        angle, speed = self._synchronisation(states)
        record = self._record(start, kept[:, kernel.N_STATES :])
        return Trace(record, states[:, kernel.V_DC], speed, angle - cmath.phase(start.v_source))

    def _batches(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int
    ) -> Iterator[tuple[np.ndarray, list[Job], np.ndarray, int]]:
        """Flat arrays of up to LANES jobs, in their order: (array, jobs, source table, tones)."""
        from ..kernels.inverters import LANES

        for members in _alike(jobs, LANES):
            table = self._source_table(members)
            tones = 0 if len(table) else max(n_tones_of(job.injection) for job in members)
            columns, _ = self._columns(members, windows[: len(members)], block_steps, tones)
            (lanes,) = in_lanes(columns, np.arange(len(members)))
            windows = windows[len(members) :]
            yield lanes.ravel(), members, table, tones

    def _columns(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, tones: int
    ) -> tuple[np.ndarray, Clockwork]:
        """The jobs' columns of the flat array, (n_slots, n), and what turns in them."""
        from ..kernels import inverters as kernel

        x = standing([job.state for job in jobs], partial(self._column, kernel.array_slots(max(tones, 1))))
        riders = [
            Rider(job.state.step, window, window.f_hz - self.f1_hz, of_tones)
            for job, window, of_tones in zip(jobs, windows, of_each(jobs, self._tones), strict=True)
        ]
        mean_taper = kernel.TAPER_0 + 0.5 * kernel.TAPER_2
        places = Places(kernel.LINE, kernel.TAPER, kernel.TONES, kernel.N_TONE_SLOTS, mean_taper)
        clockwork = Clockwork(riders, places, tones, block_steps, self.dt_s)
        clockwork.set_rotations(x)
        clockwork.set_phasors(x, np.arange(len(jobs)))
        return x, clockwork

    def _column(self, n_slots: int, state: InverterState) -> np.ndarray:
        """What stands still in the column of a job from ``state``, (n_slots,)."""
        from ..kernels import inverters as kernel

        x = np.zeros(n_slots)
        x[: kernel.N_STATES] = state.values
        set_complex(x, kernel.V_S, self._behind_line(state))
        x[kernel.LINE_R], x[kernel.LINE_L] = self._line(state.source)
        x[kernel.P_REF], x[kernel.Q_REF], x[kernel.V_REF] = state.references
        x[kernel.DC_I], x[kernel.DC_SLOPE] = state.dc
        set_complex(x, kernel.COMP, complex(*self.compensation) / self.base_impedance_ohm)
        x[kernel.NOTCH_WIDTH] = 2.0 * NOTCH_XI * self.parameters.w1_rad_s
        return x

    def _tones(self, job: Job) -> list[tuple[float, complex]]:
        """Tones of a job as (frequency in the dq frame in Hz, voltage at time zero in pu)."""
        return [
            (f_hz - self.f1_hz, v / self.rating.peak_voltage_v)
            for f_hz, v in series_tones(job.injection, job.state.source)
        ]

    def _feeding(self, circuit: Circuit) -> Feeding:
        return feeding(circuit, self.parameters.w1_rad_s, self.dt_s)

    def _line(self, source: Source) -> tuple[float, float]:
        """R and X (pu) of the line before the device; of a network, of what it lets through at once."""
        if source.circuit is None:
            z = self._per_unit(source)
            return z.real, z.imag
        r_ohm, l_h = direct_line(self._feeding(source.circuit))
        return r_ohm / self.base_impedance_ohm, self.parameters.w1_rad_s * l_h / self.base_impedance_ohm

    def _behind_line(self, state: InverterState) -> complex:
        """The voltage (pu) that the source holds behind that line."""
        if state.source.circuit is None:
            return state.v_source
        return no_load(self._feeding(state.source.circuit), state.v_source)  # linear: per unit in, per unit out

    def _source_table(self, jobs: list[Job]) -> np.ndarray:
        """The jobs' sources over a period as the kernel's table, (n, 2, LANES); of no rows where tones are cheaper."""
        from ..kernels.inverters import LANES

        rows_per_s = 2.0 / self.dt_s
        spectra = [self._tones(job) for job in jobs]
        n_rows = common_period(spectra, rows_per_s)
        table = np.zeros((n_rows, 2, LANES))
        for lane in range(LANES if n_rows else 0):
            member = lane if lane < len(jobs) else 0  # idle lanes follow the first
            state = jobs[member].state
            wave = waveform([(0.0, self._behind_line(state)), *spectra[member]], rows_per_s, n_rows, 2 * state.step)
            table[:, 0, lane], table[:, 1, lane] = wave.real, wave.imag
        return table

    def _ends(
        self, lanes: np.ndarray, jobs: list[Job], n_steps: int, networks: NetworkLanes | None
    ) -> list[InverterState]:
        from ..kernels.inverters import LANES, N_STATES

        values = lanes.reshape(-1, LANES)[:N_STATES].T.copy()
        values.setflags(write=False)
        steps = [job.state.step + n_steps for job in jobs]
        ends = [
            replace(job.state, step=step, time_s=step * self.dt_s, values=x)
            for job, step, x in zip(jobs, steps, values, strict=False)
        ]
        return ends if networks is None else networks.finished(ends)

    def _record(self, state: InverterState, samples: np.ndarray) -> Record:
        time_s = (state.step + np.arange(len(samples))) * self.dt_s
        to_stationary = np.exp(2j * pi * ((self.f1_hz * time_s) % 1.0))
        v = (samples[:, 0] + 1j * samples[:, 1]) * to_stationary * self.rating.peak_voltage_v
        i = -(samples[:, 2] + 1j * samples[:, 3]) * to_stationary * self.rating.peak_current_a
        return Record(state.time_s, self.dt_s, v, i, self.f1_hz, "load", self.id)


def _alike(jobs: Sequence[Job], most: int) -> Iterator[list[Job]]:
    """Neighbours with one circuit, or none, up to ``most`` at a time."""
    for _, group in groupby(jobs, key=lambda job: job.state.source.circuit):
        members = list(group)
        for first in range(0, len(members), most):
            yield members[first : first + most]
