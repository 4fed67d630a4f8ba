"""A parallel bank of R-L and R-L-C branches: a plant with many lightly damped resonances and a known admittance.

Every branch is stepped by the trapezoidal rule, which replaces j w by (2j/h) tan(w h/2): the plant's admittance is
exactly `ResonantBank.admittance`, not only up to the step. The source is ideal, so v_pcc is what is injected.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from math import inf, isnan, pi, sqrt

import numpy as np

from seqsweep.plant.protocol import NotSettled, OperatingRange, Rating, Record

TEN_HZ = (23.0, 37.0, 71.0, 110.0, 170.0, 250.0, 360.0, 480.0, 640.0, 860.0)
"""Series resonances of the bank, none of them near f1 (Hz)."""


@dataclass(frozen=True, slots=True)
class BankState:
    """Currents (A) and capacitor voltages (V) of every branch, and the fundamental's peak (V)."""

    step: int
    time_s: float
    x: np.ndarray
    peak_v: float


class ResonantBank:
    """R-L in parallel with a series R-L-C branch for each resonance.

    ``noise`` is the standard deviation of white measurement noise of the current, per sample and over the rated
    peak; it depends on the step and the injected frequency alone, so that the same job gives the same answer.
    """

    id = "resonant-bank"
    power_meaning = "ignored: passive"
    releases_gil = False
    f1_hz, dt_s = 50.0, 50e-6
    rating = Rating(690.0, 1e6)
    operating_range = OperatingRange((-inf, inf), (1.0, 2000.0))

    def __init__(self, damping=0.01, resonances_hz=TEN_HZ, noise=0.0):
        w = 2.0 * pi * np.asarray(resonances_hz, dtype=float)
        self.l_h = np.append(2e-3, 1e-3 * (1.0 + 0.3 * np.cos(np.arange(len(w)))))
        self.r_ohm = np.append(0.5, 2.0 * damping * w * self.l_h[1:])
        self.elastance = np.append(0.0, self.l_h[1:] * w**2)  # 1/C; none in the first branch
        self.noise = noise
        self._advance, self._drive = self._trapezoidal()

    def _trapezoidal(self):
        """x' = A x + b (v + v_next) of each branch, x = (i, v_C): (n, 2, 2) and (n, 2)."""
        zero, one = np.zeros_like(self.l_h), np.ones_like(self.l_h)
        a = np.array([[-self.r_ohm / self.l_h, -one / self.l_h], [self.elastance, zero]]).transpose(2, 0, 1)
        b = np.array([one / self.l_h, zero]).T
        half = 0.5 * self.dt_s
        left = np.linalg.inv(np.eye(2) - half * a)
        return left @ (np.eye(2) + half * a), np.einsum("nij,nj->ni", half * left, b)

    def branch_admittance(self, f_hz):
        """Scalar admittance of the stepped bank at signed frequencies (n,), in S."""
        s = 2j / self.dt_s * np.tan(pi * np.asarray(f_hz, dtype=float) * self.dt_s)[:, None]
        return np.sum(s / (s * self.r_ohm + s**2 * self.l_h + self.elastance), axis=1)

    def admittance(self, f_hz):
        """Sequence admittance (n, 2, 2) of the stepped bank, in S; no coupling."""
        f = np.asarray(f_hz, dtype=float)
        f = np.where(np.isin(f, (0.0, 2.0 * self.f1_hz)), f + 1e-9, f)  # s/s at DC
        y = np.zeros((len(f), 2, 2), complex)
        y[:, 0, 0] = self.branch_admittance(f)
        y[:, 1, 1] = self.branch_admittance(2.0 * self.f1_hz - f).conj()
        return y

    def settle(self, operating_point, source):
        """The periodic steady state of the stepped bank, in closed form."""
        if source.kind != "ideal":
            raise NotSettled("the bank is driven by an ideal source alone")
        low, high = self.operating_range.terminal_voltage_v
        if isnan(operating_point.active_power_w) or not low <= operating_point.terminal_voltage_v <= high:
            raise ValueError("the bank needs a number for its power, and a voltage in its range")
        peak_v = sqrt(2.0 / 3.0) * operating_point.terminal_voltage_v
        turn = cmath.exp(2j * pi * self.f1_hz * self.dt_s)
        drive = self._drive * (1.0 + turn) * peak_v
        x = np.linalg.solve(turn * np.eye(2) - self._advance, drive[:, :, None])[:, :, 0]
        return BankState(0, 0.0, x, peak_v)

    def run(self, jobs, n_steps):
        """Every job by itself."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job, n_steps):
        from scipy.signal import lfilter

        if job.injection and job.injection.kind != "series_voltage":
            raise ValueError("a shunt current cannot perturb an ideal source")
        state = job.state
        k = state.step + np.arange(n_steps + 1)
        tones = job.injection.tones if job.injection else ()
        v = sum(
            (t.amplitude * np.exp(1j * (2.0 * pi * t.f_hz * self.dt_s * k + t.phase_rad)) for t in tones),
            start=state.peak_v * np.exp(2j * pi * self.f1_hz * self.dt_s * k),
        )
        i, end = np.zeros(n_steps, complex), np.empty_like(state.x)
        for n, (advance, drive) in enumerate(zip(self._advance, self._drive, strict=True)):
            # (i, v_C) modally: two scalar recursions
            values, modes = np.linalg.eig(advance.astype(complex))
            z0, gain = np.linalg.solve(modes, state.x[n]), np.linalg.solve(modes, drive.astype(complex))
            forced = v[:-1] + v[1:]
            z = np.stack(
                [
                    np.append(z0[j], lfilter([gain[j]], [1.0, -values[j]], forced, zi=[values[j] * z0[j]])[0])
                    for j in range(2)
                ]
            )
            x = modes @ z
            i += x[0, :-1]
            end[n] = x[:, -1]
        step = state.step + n_steps
        i = i + self._noise(job, n_steps)
        record = Record(state.time_s, self.dt_s, v[:-1], i, self.f1_hz, "load", self.id)
        return BankState(step, step * self.dt_s, end, state.peak_v), record

    def _noise(self, job, n_steps):
        if not self.noise or job.injection is None:
            return 0.0
        seed = [job.state.step, *(round(1e6 * (t.f_hz + 1e5)) for t in job.injection.tones)]
        rng = np.random.default_rng(seed)
        white = rng.standard_normal(n_steps) + 1j * rng.standard_normal(n_steps)
        return self.noise * self.rating.peak_current_a * white / sqrt(2.0)
