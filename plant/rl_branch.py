"""``branch-v1``: an R-L branch, the plant whose admittance is known in closed form.

    L di/dt = v_pcc - R i

Stepped by the trapezoidal rule, which replaces j w by the warped (2j/h) tan(w h/2): the plant's
admittance is exactly `admittance`, not only up to the step, whatever source feeds it.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite, pi, tan
from typing import NamedTuple

import numpy as np

from .errors import SeqsweepError
from .injection import check_source, series_tones, turns
from .operating_range import Asked, refuse_outside
from .protocol import (
    Job,
    OperatingPoint,
    OperatingRange,
    Phasors,
    Rating,
    Record,
    Source,
    Window,
)
from .space_vectors import PHASE_PEAK


@dataclass(frozen=True, slots=True)
class BranchState:
    """The branch's current and what feeds it; opaque to everybody else.

    Attributes
    ----------
    step : int
        Steps since time zero.
    time_s : float
        Time (s).
    i : complex
        Current into the branch (A, phase peak, stationary frame).
    v_source : complex
        Source voltage at time zero (V, phase peak).
    source : Source
        What feeds the PCC.
    """

    step: int
    time_s: float
    i: complex
    v_source: complex
    source: Source


class _Drive(NamedTuple):
    """One job's source and circuit, in the order in which the kernel takes them."""

    phasors: np.ndarray  # at the first sample
    rotations: np.ndarray  # per step
    r_ohm: float
    l_h: float
    r_grid_ohm: float
    l_grid_h: float
    dt_s: float


class RLBranch:
    """A resistor and an inductor in series, on an ideal or a Thevenin source.

    Parameters
    ----------
    r_ohm, l_h : float
        Resistance (ohm) and inductance (H), both > 0.
    voltage_v, power_va : float
        Rating: line-to-line RMS (V) and apparent power (VA).
    dt_s : float
        Step (s).
    f1_hz : float
        Fundamental frequency (Hz).

    Raises
    ------
    SeqsweepError
        If a parameter is not positive, or the step leaves fewer than ten samples per period.
    """

    id = "branch-v1"
    power_meaning = "ignored: the branch takes what |v_pcc| drives through it, whatever active power is asked for"
    releases_gil = True

    def __init__(
        self,
        r_ohm: float = 0.1,
        l_h: float = 1e-3,
        voltage_v: float = 690.0,
        power_va: float = 1e6,
        dt_s: float = 50e-6,
        f1_hz: float = 50.0,
    ):
        given = {
            "r_ohm": float(r_ohm),
            "l_h": float(l_h),
            "voltage_v": float(voltage_v),
            "power_va": float(power_va),
            "dt_s": float(dt_s),
            "f1_hz": float(f1_hz),
        }
        for name, value in given.items():
            if not (value > 0.0 and isfinite(value)):
                raise SeqsweepError(f"{name} is {value:g}; {self.id} needs a finite number above 0")
        if given["dt_s"] * given["f1_hz"] > 0.1:
            raise SeqsweepError(f"dt_s is {dt_s:g} s; {self.id} needs at most a tenth of a period, {0.1 / f1_hz:g} s")
        self.r_ohm, self.l_h = given["r_ohm"], given["l_h"]
        self.dt_s, self.f1_hz = given["dt_s"], given["f1_hz"]
        self.rating = Rating(given["voltage_v"], given["power_va"])
        self.operating_range = OperatingRange((-inf, inf), (0.1 * self.rating.voltage_v, 2.0 * self.rating.voltage_v))

    # ------------------------------------------------------------------ steady state

    def settle(self, operating_point: OperatingPoint, source: Source) -> BranchState:
        """The periodic steady state of the stepped branch, in closed form; only |v_pcc| matters.

        Raises
        ------
        SeqsweepError
            If |v_pcc| is outside `operating_range`, or is said twice or not at all.
        """
        check_source(operating_point, source)
        z = self.impedance(self.f1_hz)
        z_loop = z + self._grid_impedance(source, self.f1_hz)
        v_source_rms = self._source_voltage(operating_point, source, abs(z_loop / z))
        v_source = PHASE_PEAK * v_source_rms * cmath.exp(1j * source.angle_rad)
        return BranchState(0, 0.0, v_source / z_loop, v_source, source)

    def _source_voltage(self, operating_point: OperatingPoint, source: Source, ratio: float) -> float:
        """Source voltage (V, line-to-line RMS) where it is ``ratio`` times |v_pcc|; refuses wrong calls."""
        given = operating_point.terminal_voltage_v
        terminal_voltage_v = source.voltage_v / ratio if source.voltage_v is not None else given
        assert terminal_voltage_v is not None
        limits = self.operating_range.terminal_voltage_v
        refuse_outside(self.id, [Asked("|v_pcc|", terminal_voltage_v, limits, self.rating.voltage_v, "pu")])
        if operating_point.active_power_w != operating_point.active_power_w:
            raise SeqsweepError(f"active power is not a number; {self.id} ignores it, but needs one")
        return terminal_voltage_v * ratio

    def impedance(self, f_hz: float) -> complex:
        """Impedance of the stepped branch at a signed frequency (ohm)."""
        return self.r_ohm + self.l_h * self._warped_jw(f_hz)

    def _grid_impedance(self, source: Source, f_hz: float) -> complex:
        if source.kind == "ideal":
            return 0j
        return source.r_ohm + source.l_h * self._warped_jw(f_hz)

    def _warped_jw(self, f_hz: float) -> complex:
        return 2j / self.dt_s * tan(pi * f_hz * self.dt_s)

    # ------------------------------------------------------------------ driving

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[BranchState, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job: Job, n_steps: int) -> tuple[BranchState, Record]:
        from .kernels import branch as kernel

        drive, state = self._drive(job), job.state
        v, i = np.empty(n_steps, complex), np.empty(n_steps, complex)
        current = np.array([state.i], complex)
        kernel.advance_recording(current, *drive, v, i)
        return self._end(state, current[0], n_steps), Record(state.time_s, self.dt_s, v, i, self.f1_hz, "load", self.id)

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[BranchState, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        return [
            self._run_one_blocks(job, window, block_steps, n_blocks) for job, window in zip(jobs, windows, strict=True)
        ]

    def _run_one_blocks(self, job: Job, window: Window, block_steps: int, n_blocks: int) -> tuple[BranchState, Phasors]:
        from .kernels import branch as kernel

        drive, state = self._drive(job), job.state
        steps_per_window = window.n_blocks * block_steps
        lines_hz = (window.f_hz, 2.0 * self.f1_hz - window.f_hz)
        sums = np.empty((n_blocks, 4), complex)
        current = np.array([state.i], complex)
        kernel.advance_blocks(
            current,
            *drive,
            np.array([turns(-f_hz * state.step * self.dt_s) for f_hz in lines_hz]),
            np.array([turns(-f_hz * self.dt_s) for f_hz in lines_hz]),
            turns((window.first_block % window.n_blocks) / window.n_blocks),
            turns(1.0 / steps_per_window),
            block_steps,
            sums,
        )
        sums /= kernel.TAPER_MEAN * steps_per_window
        return self._end(state, current[0], n_blocks * block_steps), Phasors(sums[:, :2].copy(), sums[:, 2:].copy())

    def _drive(self, job: Job) -> _Drive:
        """The source as seen behind Z_grid: the fundamental, then every tone."""
        state, source = job.state, job.state.source
        tones = [
            (self.f1_hz, state.v_source),
            *series_tones(job.injection, source, partial(self._grid_impedance, source)),
        ]
        time_s = state.step * self.dt_s
        thevenin = source.kind == "thevenin"
        return _Drive(
            np.array([amplitude * turns(f_hz * time_s) for f_hz, amplitude in tones]),
            np.array([turns(f_hz * self.dt_s) for f_hz, _ in tones]),
            self.r_ohm,
            self.l_h,
            source.r_ohm if thevenin else 0.0,
            source.l_h if thevenin else 0.0,
            self.dt_s,
        )

    def _end(self, state: BranchState, i: complex, n_steps: int) -> BranchState:
        step = state.step + n_steps
        return BranchState(step, step * self.dt_s, complex(i), state.v_source, state.source)


def admittance(branch: RLBranch, f_hz: float | np.ndarray) -> np.ndarray:
    """Sequence admittance of the stepped branch: what a perfect sweep of the plant finds.

    Parameters
    ----------
    branch : RLBranch
        The branch.
    f_hz : float or (n,) float
        Frequency of the first component (Hz).

    Returns
    -------
    (2, 2) or (n, 2, 2) complex
        Y in S, 1/(R + L (2j/h) tan(w h/2)) at f and, conjugated, at 2 f1 - f; no coupling.
    """
    return _diagonal(branch, f_hz, lambda f: 2.0 / branch.dt_s * np.tan(pi * f * branch.dt_s))


def continuous_admittance(branch: RLBranch, f_hz: float | np.ndarray) -> np.ndarray:
    """Sequence admittance of the branch itself, 1/(R + j w L); as `admittance` but for the step's warping."""
    return _diagonal(branch, f_hz, lambda f: 2.0 * pi * f)


def _diagonal(branch: RLBranch, f_hz: float | np.ndarray, angular: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    f = np.asarray(f_hz, float)
    y = np.zeros((*f.shape, 2, 2), complex)
    y[..., 0, 0] = 1.0 / (branch.r_ohm + 1j * branch.l_h * angular(f))
    y[..., 1, 1] = 1.0 / (branch.r_ohm - 1j * branch.l_h * angular(2.0 * branch.f1_hz - f))
    return y
