"""``dpmsg-grey-v1``: the circuit of the reference turbine around somebody else's controller.

Everything of the reference turbine but its grid-side control: machine side, DC link, converter, filter
Lc, shunt Rf-Cf, PCC, ideal or Thevenin source. The control is a sampled black box, called every sample
time; its outputs are held in between, late by a sample if asked. How it is wired is said by a signal
map (`wiring`). docs/cigre.md is the page for users.

The machine side answers to its rotor alone, whatever the grid side does: at a settled operating point
its power into the DC link is constant, and that is how it appears here.
"""

from __future__ import annotations

import cmath
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from . import dpmsg_equilibrium as stationary
from . import grey_circuit as circuit
from .cigre import Controller, ControllerFault, ControllerMemory
from .cigre_abi import CigreError, Library
from .dpmsg_parameters import TABLE_I
from .protocol import (
    Injection,
    Job,
    NotSettled,
    OperatingPoint,
    OperatingRange,
    Phasors,
    Rating,
    Record,
    Source,
    Window,
)
from .sources import check_source, series_tones, turns
from .wiring import Map, wire

_PHASE_PEAK = sqrt(2.0 / 3.0)
"""Power-invariant (line-to-line RMS) to phase peak."""

CIRCUIT = ("u_rated_v", "s_rated_va", "w1_rad_s", "l_c_h", "r_f_ohm", "c_f_f", "c_dc_f", "v_dc_ref_v")
"""Fields of `TurbineParameters` that belong to the circuit."""

PERIODIC = 1e-10
"""Change over one period, relative to the peak, at which the search for the steady state stops."""

SETTLED = 1e-6
"""Largest such change that is called settled: a box of single precision or with a dither stays above `PERIODIC`."""

DIVERGED_PU = 10.0
"""A current this many times the rated peak will not come back."""

ROUND = 25
"""Periods between two looks at whether it is periodic."""


@dataclass(frozen=True, slots=True, eq=False)
class GreyState:
    """Circuit and controller at one sample; opaque to everybody else.

    Attributes
    ----------
    step : int
        Samples since the controller was started.
    time_s : float
        Time (s).
    x : (4,) complex
        i_L, v_C, i_g (A, V; phase peak, stationary frame) and the command that waits.
    energy : float
        Of the DC link (J).
    memory : ControllerMemory
        What the controller declares it remembers.
    v_source : complex
        Source voltage at time zero (V, phase peak).
    source : Source
        What feeds the PCC.
    power_w, voltage_v : float
        References of the operating point: P_machine (W) and |v_pcc| (V, line-to-line RMS).
    """

    step: int
    time_s: float
    x: np.ndarray
    energy: float
    memory: ControllerMemory
    v_source: complex
    source: Source
    power_w: float
    voltage_v: float


class GreyTurbine:
    """The reference turbine's circuit with a real-code controller in it.

    Parameters
    ----------
    controller : str
        ``cigre:FILE``, a TB 958 library; it is loaded into this process.
    inputs, outputs : mapping
        The signal map: what each port of the controller is.
    settings : mapping
        Parameters of the controller by name; the others have its defaults.
    sample_time_s : float
        Sample time (s) of a controller that does not say its own.
    delay_samples : 0 or 1
        Samples by which the converter follows late.
    settle_s : float
        Simulated time (s) that the search for a steady state may take.
    **parameters : float
        Fields of `TurbineParameters` named in `CIRCUIT` to replace, e.g. ``l_c_h=0.2e-3``.

    Raises
    ------
    ValueError
        If the library cannot be used, the map does not fit its ports, or a parameter is unknown or out of its range.
    """

    id = "dpmsg-grey-v1"
    power_meaning = (
        "P_machine: constant power into the DC link; the converter carries it at rest, if its control holds v_dc"
    )

    def __init__(
        self,
        controller: str,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        settings: Mapping[str, Any] | None = None,
        *,
        sample_time_s: float | None = None,
        delay_samples: int = 0,
        settle_s: float = 60.0,
        **parameters: float,
    ):
        unknown = sorted(set(parameters) - set(CIRCUIT))
        if unknown:
            raise ValueError(f"{self.id} has no parameter {unknown[0]!r}; its circuit has {', '.join(CIRCUIT)}")
        for name, value in {**parameters, "settle_s": settle_s}.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not (value > 0.0 and isfinite(value)):
                raise ValueError(f"{name} is {value!r}; {self.id} needs a finite number above 0")
        if delay_samples not in (0, 1) or isinstance(delay_samples, bool):
            raise ValueError(f"delay_samples is {delay_samples!r}; {self.id} takes 0 or 1")
        self.parameters = TABLE_I._replace(**{name: float(value) for name, value in parameters.items()})
        self.library = Library(_path(controller))
        self.contents = {"controller": _fingerprint(self.library)}
        self.dt_s = _sample_time(self.library, sample_time_s)
        self.f1_hz = self.parameters.w1_rad_s / (2.0 * pi)
        u = self.parameters.u_rated_v
        self.rating = Rating(u, self.parameters.s_rated_va)
        self.operating_range = OperatingRange((0.05e6, 1.35e6), (0.85 * u, 1.15 * u))
        self._settings = dict(settings or {})
        self._delay, self._settle_s = delay_samples, settle_s
        self._controller = Controller(self.library, self._settings)
        self._map = wire(self._controller.input_terminals, self._controller.output_terminals, inputs, outputs)
        self._settled: dict[tuple[OperatingPoint, Source], GreyState] = {}

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        """The periodic steady state, reached by running; certified by the change over its last period.

        The circuit starts at the reference turbine's equilibrium, the controller as its library starts it, told the
        outputs that belong there.

        Raises
        ------
        ValueError
            If the operating point is outside `operating_range`, or says |v_pcc| twice or not at all.
        NotSettled
            If the waveforms do not become periodic within ``settle_s``, or run away ("diverged").
        """
        check_source(operating_point, source)
        key = operating_point, source
        if key not in self._settled:
            self._settled[key] = self._periodic(self._start(operating_point, source))
        return self._settled[key]

    def _start(self, operating_point: OperatingPoint, source: Source) -> GreyState:
        p, power_w = self.parameters, operating_point.active_power_w
        voltage_v = operating_point.terminal_voltage_v or source.voltage_v
        assert voltage_v is not None
        rest = stationary.grid_side_equilibrium(p, power_w, voltage_v)
        v_source = rest.v_pcc
        if source.kind == "thevenin":
            v_source = stationary.thevenin_voltage(p, power_w, voltage_v, source.r_ohm, source.l_h)
        turn = _PHASE_PEAK * cmath.exp(1j * (source.angle_rad - cmath.phase(v_source)))
        command = rest.v_conv * turn
        x = np.array([rest.i_l * turn, rest.v_c * turn, rest.i_g * turn, command])
        energy = 0.5 * p.c_dc_f * p.v_dc_ref_v**2
        nothing = ControllerMemory(b"", b"", b"", b"", b"")
        state = GreyState(0, 0.0, x, energy, nothing, v_source * turn, source, power_w, voltage_v)
        return replace(state, memory=self._begun(state, command))

    def _begun(self, state: GreyState, command: complex) -> ControllerMemory:
        """The controller, begun anew in ``state`` with the outputs that make ``command``."""
        from .kernels import grey as kernel

        self._controller = controller = Controller(self.library, self._settings)
        inputs, outputs, wiring, net, store, quantities = self._surroundings(state)
        v_dc = kernel.inform(inputs, wiring, net, store, quantities, state.x, state.v_source, state.energy)
        per = 0.5 * v_dc if self._map.modulated else 1.0
        for part in self._map.outputs:
            cells = getattr(outputs, part.type)
            cells[part.cell] = (command * part.direction.conjugate()).real * part.gain / per
        controller.start()
        return controller.memory()

    def _periodic(self, state: GreyState) -> GreyState:
        steps = round(1.0 / (self.f1_hz * self.dt_s))
        change, v, i = np.inf, 0j, 0j
        while state.time_s < self._settle_s:
            ((state, record),) = self.run([Job(state, None)], ROUND * steps)
            v, i = record.v[-2 * steps :], record.i[-2 * steps :]
            size = np.max(np.abs(i)) / self.rating.peak_current_a
            if not size <= DIVERGED_PU:
                raise NotSettled(
                    f"the current reaches {size:.3g} times the rated peak {state.time_s:.3g} s after the controller was "
                    "started: the closed loop is unstable, or a sign in the signal map is wrong",
                    status="diverged",
                )
            change = max(np.max(np.abs(x[steps:] - x[:steps])) / np.max(np.abs(x)) for x in (v, i))
            if change <= PERIODIC:
                return state
        if change <= SETTLED:
            return state
        raise NotSettled(
            f"waveforms still change by {change:.2g} of their peak over a period, {self._settle_s:g} s after the "
            f"controller was started; {SETTLED:g} is needed (settle_s sets the time, delay_samples and the signal map "
            "decide whether it can settle at all)"
        )

    # ------------------------------------------------------------------ driving

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[GreyState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [self._run_one(job, n_steps) for job in jobs]

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[GreyState, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        return [self._listen_one(job, window, block_steps, n_blocks) for job, window in zip(jobs, windows, strict=True)]

    def _run_one(self, job: Job, n_steps: int) -> tuple[GreyState, Record]:
        from .kernels import grey as kernel

        v, i = np.full(n_steps, np.nan, complex), np.full(n_steps, np.nan, complex)
        end = self._advance(job, n_steps, kernel.advance_recording, v, i)
        return end, Record(job.state.time_s, self.dt_s, v, -i, self.f1_hz, "load", self.id)

    def _listen_one(self, job: Job, window: Window, block_steps: int, n_blocks: int) -> tuple[GreyState, Phasors]:
        from .kernels import grey as kernel

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
        from .kernels import grey as kernel

        state, controller = job.state, self._controller
        controller.restore(state.memory)
        x = state.x.copy()
        energy, taken, how = kernel_of(
            controller.addresses,
            controller.time,
            state.step,
            *self._surroundings(state),
            x,
            state.energy,
            *self._tones(job),
            *listening,
        )
        controller.check()
        if how == kernel.REFUSED:
            raise controller.refusal("Model_Outputs")
        if how == kernel.NOT_A_NUMBER:
            raise ControllerFault(f"{self._silent_port()} is not a finite number at {controller.time[0]:.6g} s")
        if how == kernel.EMPTY:
            energy = np.nan  # the DC link is empty: nothing is left to go on from
        step = state.step + n_steps
        return replace(state, step=step, time_s=step * self.dt_s, x=x, energy=energy, memory=controller.memory())

    def _surroundings(self, state: GreyState) -> tuple[Any, ...]:
        """Memory, wiring, network, DC link and references, as the kernel takes them."""
        from .kernels import grey as kernel

        quantities = np.zeros(kernel.N_QUANTITIES)
        quantities[kernel.P_REF], quantities[kernel.V_REF], quantities[kernel.ONE] = state.power_w, state.voltage_v, 1.0
        store = kernel.Store(self.parameters.c_dc_f, state.power_w, self.dt_s, self._delay)
        return (
            _cells(self._controller.inputs.cells),
            _cells(self._controller.outputs.cells),
            _wiring(self._map),
            circuit.network(self.parameters, state.source, self.dt_s),
            store,
            quantities,
        )

    def _tones(self, job: Job) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The source's phasors, fundamental first, their turns per step and what they force."""
        state, source = job.state, job.state.source
        tones = [
            (self.f1_hz, state.v_source),
            *series_tones(job.injection, source, lambda f_hz: circuit.impedance(source, f_hz)),
        ]
        first_s = state.step * self.dt_s
        return (
            np.array([amplitude * turns(f_hz * first_s) for f_hz, amplitude in tones]),
            np.array([turns(f_hz * self.dt_s) for f_hz, _ in tones]),
            np.array([circuit.forcing(self.parameters, source, f_hz, self.dt_s) for f_hz, _ in tones]),
        )

    def _silent_port(self) -> str:
        """The first wired output that is not finite, in words."""
        cells = _cells(self._controller.outputs.cells)
        for part in self._map.outputs:
            if not isfinite(getattr(cells, part.type)[part.cell]):
                for port in self._controller.output_terminals:
                    if port.type == part.type and port.first <= part.cell < port.first + port.width:
                        return f"output port {port.name!r}"
        return "an output"


def around_library(path: str, **parameters: Any) -> GreyTurbine:
    """``cigre:FILE``: `GreyTurbine` with that library; parameters pass through."""
    return GreyTurbine(f"cigre:{path}", **parameters)


def _path(controller: str) -> Path:
    kind, colon, rest = controller.partition(":")
    if not (colon and kind == "cigre" and rest):
        raise CigreError(f"controller is {controller!r}; it must read cigre:FILE, the path of a TB 958 library")
    return Path(rest)


def _fingerprint(library: Library) -> dict[str, str]:
    """What tells this controller from the next one under the same name."""
    digest = hashlib.sha256(library.path.read_bytes()).hexdigest()
    return {"name": library.info.name, "version": library.info.version, "sha256": digest}


def _sample_time(library: Library, given: float | None) -> float:
    own = library.info.sample_time_s
    if library.info.emt_rms == 2:
        raise CigreError(
            f"{library.path} is a model for RMS programs; its control cannot be sampled in a circuit in time"
        )
    if given is None and own == 0.0:
        raise CigreError(f"{library.path} names no sample time: give sample_time_s, in s")
    if given is None:
        return own
    if not (isinstance(given, float) and 0.0 < given <= 1e-3):
        raise CigreError(f"sample_time_s is {given!r}; needed: a number above 0 and up to 1e-3, in s")
    if own and abs(given - own) > 1e-9 * own:
        raise CigreError(f"sample_time_s is {given:g} s, but {library.path} is sampled every {own:g} s: leave it away")
    return given


def _cells(memory: np.ndarray) -> Any:
    from .kernels.grey import CELL_TYPES, Cells

    return Cells(*(memory.view(kind) for kind in CELL_TYPES))


def _wiring(signals: Map) -> Any:
    from .kernels import grey as kernel

    kinds = {name: kind for kind, name in enumerate(kernel.CELL_TYPES)}
    inputs, outputs = signals.inputs, signals.outputs
    return kernel.Wiring(
        np.array([kinds[part.type] for part in inputs], np.int64),
        np.array([part.cell for part in inputs], np.int64),
        np.array([getattr(kernel, part.quantity) for part in inputs], np.int64),
        np.array([part.gain for part in inputs], float).reshape(-1, 2),
        np.array([kinds[part.type] for part in outputs], np.int64),
        np.array([part.cell for part in outputs], np.int64),
        np.array([part.weight for part in outputs], complex),
        signals.modulated,
    )
