"""A step function becomes a plant: ``step(state, v, dt) -> state, i``.

``v`` is the space vector of the terminal voltage (V, phase peak), held from the beginning of the step to
its end; ``i`` is the current into the device (A) *at the end* of the step. The state is a value: a number,
a tuple, an array that is made anew, never one that is written into. Plain Python works; a function under
``numba.njit`` is stepped by a compiled loop that releases the interpreter lock.

    from seqsweep.plant.boxes.step_function import plant_from_step

    def step(i, v, dt):
        i = i + dt / 5e-3 * (v - 2.0 * i)
        return i, i

    def load():
        return plant_from_step(step, 0j, dt_s=50e-6, voltage_v=400.0, power_va=10e3)

On a Thevenin source the voltage of a step is the one at which device and grid agree. The grid is integrated
by the trapezoidal rule over the step, the device's voltage being held:

    (e_k + e_k+1)/2 = v_k + R (i_k + i_k+1)/2 + L (i_k+1 - i_k)/h,      i_k+1 = step(state_k, v_k)

Newton's method on v_k, with the sensitivity of i_k+1 to v_k found by trying; a device that is linear over one
step takes two calls of it. No delay is put between the two, so no grid is too weak for the coupling.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf, pi, tan
from typing import Any

import numpy as np

from ..errors import SeqsweepError, in_words
from ..injection import series_tones
from ..protocol import Job, NotSettled, OperatingPoint, OperatingRange, Rating, Record, Source
from ..states.behind_grid import settled_behind
from ..states.steady_state import HOLDS, Clock, Patience, once, phase_peak, until_periodic, voltage_asked
from .box import Identity

AGREEMENT = 1e-12
"""Mismatch of the grid's equation that is accepted, in parts of its largest terms."""

MOST_TRIALS = 40

StepFunction = Callable[[Any, complex, float], tuple[Any, complex]]
LaneStepFunction = Callable[[Any, np.ndarray, float], tuple[Any, np.ndarray]]


class StepError(SeqsweepError):
    """A step function that cannot be stepped as it is, with the way out."""


def plant_from_step(
    step: StepFunction,
    initial_state: Any,
    *,
    dt_s: float,
    voltage_v: float,
    power_va: float,
    f1_hz: float = 50.0,
    active_power_w: tuple[float, float] = (-inf, inf),
    terminal_voltage_pu: tuple[float, float] = (0.5, 1.5),
    power_meaning: str = "as the step function takes it",
    settle_tolerance: float = 1e-8,
    patience_s: float = 30.0,
    hold: str = "start",
) -> StepPlant:
    """A plant around a step function; see the module's text for what it takes and returns.

    Parameters
    ----------
    step : callable
        ``step(state, v, dt) -> state, i``; plain or under ``numba.njit``.
    initial_state : value, or callable
        Where it begins, before any voltage; a callable is given the `OperatingPoint`.
    dt_s, f1_hz : float
        Step (s) and fundamental (Hz).
    voltage_v, power_va : float
        Rating: line-to-line RMS (V) and apparent power (VA).
    active_power_w, terminal_voltage_pu : (lowest, highest)
        Where it may be operated (W, pu).
    power_meaning : str
        One sentence for the table.
    settle_tolerance : float
        Change from one period to the next, over the peak, at which it counts as settled.
    patience_s : float
        Simulated time (s) it may take until then.
    hold : "start" or "mean"
        What ``step`` is given of the source's voltage: its value at the start of the step, which comes half a step
        late, or its mean over the step, which does not. The mean is known on an ideal source alone.

    Raises
    ------
    SeqsweepError
        If the step leaves fewer than ten samples per period, or a rating is not above 0.
    """
    identity = _identity(step, dt_s, voltage_v, power_va, f1_hz, active_power_w, terminal_voltage_pu, power_meaning)
    return StepPlant(step, initial_state, identity, Patience(settle_tolerance, patience_s), hold)


def plant_from_lanes(
    step: LaneStepFunction,
    initial_state: Any,
    *,
    settle_tolerance: float = 1e-8,
    patience_s: float = 30.0,
    **identity: Any,
) -> LanePlant:
    """A plant around a step function that takes many experiments at once, one in each lane.

    ``step(state, v, dt)`` is given ``v`` (n_lanes,) and a state whose last axis are the lanes, and returns a new
    state and ``i`` (n_lanes,); the lanes know nothing of each other. ``initial_state`` is that of one lane: a number
    or an array. An array script pays for its calls once for all lanes. Everything else is as in `plant_from_step`
    (``dt_s``, ``voltage_v``, ``power_va``, ...), but that it stands on an ideal source alone.
    """
    return LanePlant(step, initial_state, _identity(step, **identity), Patience(settle_tolerance, patience_s))


def _identity(
    step: Callable[..., Any],
    dt_s: float,
    voltage_v: float,
    power_va: float,
    f1_hz: float = 50.0,
    active_power_w: tuple[float, float] = (-inf, inf),
    terminal_voltage_pu: tuple[float, float] = (0.5, 1.5),
    power_meaning: str = "as the step function takes it",
) -> Identity:
    for name, value in {"dt_s": dt_s, "f1_hz": f1_hz, "voltage_v": voltage_v, "power_va": power_va}.items():
        if not 0.0 < value < inf:
            raise SeqsweepError(f"{name} is {value:g}; needed: a finite number above 0")
    if dt_s * f1_hz > 0.1:
        raise SeqsweepError(f"dt_s is {dt_s:g} s; needed: at most a tenth of a period, {0.1 / f1_hz:g} s")
    low, high = terminal_voltage_pu
    limits = OperatingRange(active_power_w, (low * voltage_v, high * voltage_v))
    name = f"python:{step.__module__}:{step.__name__}"
    return Identity(name, Clock(f1_hz, dt_s), Rating(voltage_v, power_va), limits, power_meaning)


@dataclass(frozen=True, slots=True)
class StepState:
    """Where the device is: its own state, its current (A), its last voltage (V), and what feeds it."""

    step: int
    time_s: float
    device: Any
    i: complex
    v: complex
    v_source: complex
    source: Source


class StepPlant:
    """What `plant_from_step` makes."""

    def __init__(
        self,
        step: Callable[..., Any],
        initial_state: Any,
        identity: Identity,
        patience: Patience,
        hold: str = "start",
    ):
        if hold not in HOLDS:
            raise SeqsweepError(f"hold is {hold!r}; needed: {', '.join(HOLDS)}")
        self._hold = hold
        self.id, (self.f1_hz, self.dt_s), self.rating, self.operating_range, self.power_meaning = identity
        self._step, self._initial_state = step, initial_state
        self.contents = {"held_late_s": 0.5 * self.dt_s if hold == "start" else 0.0}
        self._clock, self._patience = identity.clock, patience
        self._settled: dict[tuple[OperatingPoint, Source], StepState | NotSettled] = {}

    @property
    def releases_gil(self) -> bool:
        """Whether the step function is compiled."""
        return hasattr(self._step, "py_func")

    @property
    def ideal_only(self) -> str:
        """Why it stands on an ideal source only, where it does."""
        return 'hold = "mean" is known there alone (hold = "start" and a small step are not)' * (self._hold == "mean")

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> StepState:
        """Run from the initial state until a period repeats; see `Plant.settle`.

        Raises
        ------
        SeqsweepError
            If the operating point is outside the range.
        NotSettled
            If the waveforms do not repeat within the patience.
        """
        voltage_v = voltage_asked(operating_point, source, self.operating_range, self.rating, self.id)
        settle = partial(self._settle, operating_point, source, voltage_v)
        return once(self._settled, (operating_point, source), settle)

    def _settle(self, point: OperatingPoint, source: Source, voltage_v: float) -> StepState:
        if source.kind != "ideal" and self._hold == "mean":
            raise SeqsweepError(
                f'{self.id} has hold = "mean", which is known on an ideal source alone: behind a grid take '
                'hold = "start" and a small step'
            )
        if source.kind == "ideal":
            return self.onwards(self.begun(point, source, phase_peak(voltage_v, source.angle_rad)))
        return settled_behind(self, point, source)

    def begun(self, point: OperatingPoint, source: Source, v_source: complex) -> StepState:
        """The initial state on a source of known voltage (V, phase peak, at time zero)."""
        device = self._initial_state(point) if callable(self._initial_state) else self._initial_state
        return StepState(0, 0.0, device, 0j, v_source, v_source, source)

    def put_behind(self, state: StepState, source: Source, v_source: complex) -> StepState:
        """The same device behind another source."""
        return replace(state, source=source, v_source=v_source)

    def onwards(self, state: StepState) -> StepState:
        """Run on until a period repeats."""

        def run(first_step: int, n_steps: int) -> np.ndarray:
            nonlocal state
            ((state, record),) = self.run([Job(state, None)], n_steps)
            return np.stack([record.v / self.rating.peak_voltage_v, record.i / self.rating.peak_current_a])

        until_periodic(run, self._clock, self._patience)
        return state

    def grid_impedance(self, source: Source) -> complex:
        """Impedance of the stepped grid at f1 (ohm)."""
        return self._grid_impedance(source, self.f1_hz)

    def fundamental(self, state: StepState) -> tuple[StepState, complex, complex]:
        """The state, and phasors of v (V) and i (A) over the period that follows it."""
        ((_, record),) = self.run([Job(state, None)], self._clock.period_steps)
        turns = np.exp(-2j * pi * self.f1_hz * record.time_s)
        return state, complex(np.mean(record.v * turns)), complex(np.mean(record.i * turns))

    def _grid_impedance(self, source: Source, f_hz: float) -> complex:
        """R + L (2j/h) tan(w h/2): the grid as the trapezoidal rule steps it (ohm)."""
        return source.r_ohm + source.l_h * 2j / self.dt_s * tan(pi * f_hz * self.dt_s)

    # ------------------------------------------------------------------ driving

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[StepState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job: Job, n_steps: int) -> tuple[StepState, Record]:
        state, source = job.state, job.state.source
        tones = series_tones(job.injection, source, lambda f_hz: self._grid_impedance(source, f_hz))
        phasors = ((self.f1_hz, state.v_source), *tones)
        e = self._clock.voltage(phasors, state.step, n_steps + 1)
        held = self._clock.held(self._hold, phasors, state.step, n_steps) if source.kind == "ideal" else None
        v, i = np.empty(n_steps, complex), np.empty(n_steps, complex)
        try:
            device, i_end, v_end, steps_done = self._advance(state, e, held, v, i)
        except StepError:
            raise
        except _typing_error() as error:
            raise StepError(
                f"{self.id} cannot be compiled: step must return a state of the type of the initial state, and a "
                f"complex current ({' '.join(str(error).split())[:200]})"
            ) from None
        except Exception as error:
            raise StepError(f"{self.id} failed: {told_where(error, self._step)}") from error
        if steps_done < n_steps:
            raise ArithmeticError(
                f"device and grid find no common voltage in step {state.step + steps_done}: the step function is "
                "not smooth enough for a grid of this impedance; an ideal source gives the same admittance"
            )
        return self._ended(state, device, i_end, v_end, v, i)

    def _ended(
        self, state: StepState, device: Any, i_end: complex, v_end: complex, v: np.ndarray, i: np.ndarray
    ) -> tuple[StepState, Record]:
        """The state behind the samples ``v`` and ``i``, and their record."""
        step = state.step + len(v)
        end = replace(state, step=step, time_s=step * self.dt_s, device=device, i=complex(i_end), v=complex(v_end))
        return end, Record(state.time_s, self.dt_s, v, i, self.f1_hz, "load", self.id)

    def _advance(
        self, state: StepState, e: np.ndarray, held: np.ndarray | None, v: np.ndarray, i: np.ndarray
    ) -> tuple[Any, complex, complex, int]:
        source = state.source
        if held is not None:
            v[:] = e[:-1]
            device, i_end = self._loop(_on_ideal_source)(
                self._step, state.device, state.i, self._given(held), self.dt_s, i
            )
            return device, i_end, e[-1], len(v)
        e_mean = self._given((e[:-1] + e[1:]) / 2.0)
        grid = (source.r_ohm, source.l_h)
        loop = self._loop(_behind_grid)
        return loop(self._step, state.device, state.i, state.v, e_mean, *grid, self.dt_s, AGREEMENT, v, i)

    def _loop(self, loop: Callable[..., Any]) -> Callable[..., Any]:
        return _compiled(loop) if self.releases_gil else loop

    def _given(self, x: np.ndarray) -> Any:
        """An array for a compiled loop; a list, whose numbers are quicker in Python, for a plain one."""
        return x if self.releases_gil else x.tolist()


class LanePlant(StepPlant):
    """What `plant_from_lanes` makes."""

    def settle(self, operating_point: OperatingPoint, source: Source) -> StepState:
        """As `StepPlant.settle`; an ideal source alone."""
        if source.kind != "ideal":
            raise SeqsweepError(
                f"{self.id} takes many experiments at once: it stands on an ideal source, where its admittance is the "
                "same; plant_from_step stands on a grid, too"
            )
        return super().settle(operating_point, source)

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[StepState, Record]]:
        """Run every job ``n_steps`` further, each in its lane; see `Plant.run`."""
        if not jobs:
            return []
        states = [job.state for job in jobs]
        v = np.stack([self._source_voltage(job, n_steps) for job in jobs], axis=1)
        device = np.stack([np.asarray(state.device) for state in states], axis=-1)
        i = np.empty(v.shape, complex)
        loop = self._loop(_on_ideal_source)
        device, i_end = loop(self._step, device, np.array([state.i for state in states]), v, self.dt_s, i)
        return [
            self._ended(job.state, device[..., k].copy(), i_end[k], v[-1, k], v[:, k].copy(), i[:, k].copy())
            for k, job in enumerate(jobs)
        ]

    def _source_voltage(self, job: Job, n_steps: int) -> np.ndarray:
        tones = series_tones(job.injection, job.state.source, lambda f_hz: 0j)
        return self._clock.voltage(((self.f1_hz, job.state.v_source), *tones), job.state.step, n_steps)


# The loops: plain Python, compiled where the step function is


def _on_ideal_source(step, device, i, v, dt_s, i_out):  # type: ignore[no-untyped-def]
    """Fill ``i_out`` with the current before each step; return device and current after the last."""
    for k in range(len(v)):
        i_out[k] = i
        device, i = step(device, v[k], dt_s)
    return device, i


def _behind_grid(step, device, i, v, e_mean, r_ohm, l_h, dt_s, tolerance, v_out, i_out):  # type: ignore[no-untyped-def]
    """As above, behind R and L; also return the last voltage and the steps done, fewer where no voltage fits.

    i_next = i_0 + p v + q conj(v) near v; p and q are tried out where the last ones do not lead home.
    """
    now, before = r_ohm / 2.0 + l_h / dt_s, r_ohm / 2.0 - l_h / dt_s
    p, q, known = 0j, 0j, False
    for k in range(len(e_mean)):
        i_out[k] = i
        for trial in range(MOST_TRIALS):
            then, i_next = step(device, v, dt_s)
            mismatch = v + now * i_next + before * i - e_mean[k]
            if abs(mismatch) <= tolerance * (abs(e_mean[k]) + now * abs(i_next)):
                break
            if not known or trial % 4 == 3:
                size = 1e-6 * (abs(v) + abs(e_mean[k]))
                _, i_d = step(device, v + size, dt_s)
                _, i_q = step(device, v + 1j * size, dt_s)
                along, across = (i_d - i_next) / size, (i_q - i_next) / (1j * size)
                p, q, known = (along + across) / 2.0, (along - across) / 2.0, True
            a, b = 1.0 + now * p, now * q
            v = v - (a.conjugate() * mismatch - b * mismatch.conjugate()) / (abs(a) ** 2 - abs(b) ** 2)
        else:
            return device, i, v, k
        v_out[k] = v
        device, i = then, i_next
    return device, i, v, len(e_mean)


@cache
def _compiled(loop: Callable[..., Any]) -> Callable[..., Any]:
    from numba import njit

    return njit(nogil=True)(loop)


def told_where(error: Exception, step: Callable[..., Any]) -> str:
    """An error of a user's function in words, with the file and line of the user's own code where it has one."""
    code = getattr(getattr(step, "py_func", step), "__code__", None)
    frames = traceback.extract_tb(error.__traceback__)
    if code is None:
        return in_words(error)
    own = [frame for frame in frames if frame.filename == code.co_filename]
    if not own:
        return f"{in_words(error)} (in {step.__name__}, {code.co_filename}, line {code.co_firstlineno})"
    return f"{in_words(error)} ({own[-1].filename}, line {own[-1].lineno}: {own[-1].line})"


def _typing_error() -> type[Exception]:
    from numba.core.errors import NumbaError

    return NumbaError
