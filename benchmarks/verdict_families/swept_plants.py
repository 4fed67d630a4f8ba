"""The families as plants: what the product's runner sweeps. Every response is a sum of exponentials, exactly.

A linear device answers a tone by two rotating phasors (the tone's and its mirror's) and by its modes, which die out. No
integrator stands between the device and its truth: what a swept row is wrong by are windows that end before the modes
have died out, noise, and the device's own cubic nonlinearity. A tone of amplitude a (pu) meets
Y + bend a^2 Y Y^H Y / (1 + ||Y||^2), Y in pu: what a third-order kernel leaves at the tone. It is no rational function
with the poles of Y: on the axis Y^H is Y(-s)^T, whose poles lie on the right. Swept rows put false poles there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from seqsweep.plant.protocol import Job, OperatingPoint, OperatingRange, Phasors, Rating, Record, Source, Window

from .linear import Bases, Linear
from .sampled_devices import Sampled

TAPER = np.array([0.04, -0.25, 0.42, -0.25, 0.04]) / 0.42
"""Blackman's taper as coefficients of exp(2j pi m t/T), m = -2 ... 2."""


@dataclass(frozen=True, slots=True)
class State:
    """Time as steps, deviation ``x`` of the device's state from the operating point, and what feeds it."""

    step: int
    time_s: float
    x: np.ndarray
    source: Source


def _turning(step_rad: float, n: int) -> np.ndarray:
    """exp(j step k) (n,), as products of two: exponentials of complex numbers are dear."""
    coarse = 1024
    rows = np.exp(1j * step_rad * coarse * np.arange(-(-n // coarse)))
    return np.outer(rows, np.exp(1j * step_rad * np.arange(coarse))).ravel()[:n]


class _Fed:
    """What all of them share: bases, operating point, tones as phasors of the dq frame."""

    power_meaning = "out of the device, as the benchmark says"
    releases_gil = True

    def __init__(self, bases: Bases, dt_s: float):
        self.id, self.f1_hz, self.dt_s = "verdict-family-v1", bases.f1_hz, dt_s
        self.rating = Rating(bases.voltage_v, bases.power_va)
        self.operating_range = OperatingRange((-np.inf, np.inf), (0.1 * bases.voltage_v, 2.0 * bases.voltage_v))
        self._i0 = complex(-0.5 * self.rating.peak_current_a)
        self._w1 = bases.w1

    def _record(self, state: State, v: np.ndarray, i: np.ndarray) -> Record:
        """Deviations in the dq frame become waveforms."""
        begin = np.exp(2j * np.pi * ((self.f1_hz * state.time_s) % 1.0))
        turn = begin * _turning(2.0 * np.pi * self.f1_hz * self.dt_s, len(v))
        return Record(
            state.time_s, self.dt_s, (self.rating.peak_voltage_v + v) * turn, (self._i0 + i) * turn, self.f1_hz
        )

    def _tones(self, job: Job) -> list[tuple[float, complex]]:
        """(signed frequency in the dq frame (rad/s), phasor at the state's time)."""
        tones = job.injection.tones if job.injection else ()
        return [
            (
                2.0 * np.pi * (tone.f_hz - self.f1_hz),
                tone.amplitude
                * np.exp(1j * (2.0 * np.pi * (((tone.f_hz - self.f1_hz) * job.state.time_s) % 1.0) + tone.phase_rad)),
            )
            for tone in tones
        ]

    def _later(self, state: State, x: np.ndarray, n_steps: int) -> State:
        step = state.step + n_steps
        return replace(state, step=step, time_s=step * self.dt_s, x=x)


class LinearPlant(_Fed):
    """A `Linear` on an ideal source, or behind the grid that its source names; a `PhasorPlant`."""

    def __init__(self, device: Linear, bases: Bases, bend: float = 0.0, dt_s: float = 1e-4):
        super().__init__(bases, dt_s * 50.0 / bases.f1_hz)
        self._device, self._bend, self._z_ohm = device, bend, bases.z_ohm
        self._systems: dict[Source, _Modal] = {}

    def settle(self, operating_point: OperatingPoint | None, source: Source) -> State:
        """At once: the operating point is the one about which the device was linearised."""
        return State(0, 0.0, np.zeros(len(self._system(source).a)), source)

    def _system(self, source: Source) -> _Modal:
        if source not in self._systems:
            self._systems[source] = _modal(self._device, source, self._w1)
        return self._systems[source]

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[State, Record]]:
        """Waveforms: one matrix product over all exponentials of a job."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job: Job, n_steps: int) -> tuple[State, Record]:
        rates, amplitudes, end = self._exponentials(job, n_steps)
        coarse = 64
        n_rows = -(-n_steps // coarse)
        fine = np.exp(np.outer(rates, self.dt_s * np.arange(coarse)))
        rows = np.exp(np.outer(rates, self.dt_s * coarse * np.arange(n_rows)))
        v, i = ((a[:, None] * rows).T @ fine for a in amplitudes)
        return end, self._record(job.state, v.ravel()[:n_steps], i.ravel()[:n_steps])

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[State, Phasors]]:
        """Tapered sums in closed form: geometric series."""
        found = []
        for job, window in zip(jobs, windows, strict=True):
            rates, (v, i), end = self._exponentials(job, block_steps * n_blocks)
            rates = np.append(rates, 0.0)
            v, i = np.append(v, self.rating.peak_voltage_v), np.append(i, self._i0)
            v, i = (a * np.exp(2j * np.pi * ((self.f1_hz * job.state.time_s) % 1.0)) for a in (v, i))
            lines = (window.f_hz, 2.0 * self.f1_hz - window.f_hz)
            sums = [
                self._sums(rates + 1j * self._w1, f, job.state.time_s, window, block_steps, n_blocks) for f in lines
            ]
            found.append((end, Phasors(np.stack([v @ s for s in sums], 1), np.stack([i @ s for s in sums], 1))))
        return found

    def _sums(
        self, rates: np.ndarray, f_hz: float, t0_s: float, window: Window, block_steps: int, n_blocks: int
    ) -> np.ndarray:
        """(exponentials, blocks): sums of taper times exp(rate (t - t0) - 2j pi f t) over each block."""
        length = window.n_blocks * block_steps
        m = np.arange(-2, 3)
        per_step = (rates[:, None] - 2j * np.pi * f_hz) * self.dt_s + 2j * np.pi * m / length
        per_step = per_step.real + 1j * (np.mod(per_step.imag + np.pi, 2.0 * np.pi) - np.pi)
        still = np.abs(per_step) < 1e-13
        safe = np.where(still, 1.0, per_step)
        one_block = np.where(still, block_steps, np.expm1(block_steps * safe) / np.expm1(safe))
        begin = TAPER / length * np.exp(2j * np.pi * m * ((window.first_block % window.n_blocks) / window.n_blocks))
        to_block = np.exp(block_steps * per_step[:, :, None] * np.arange(n_blocks))
        phase = np.exp(-2j * np.pi * ((f_hz * t0_s) % 1.0))
        return np.einsum("em,m,emb->eb", one_block, begin, to_block) * phase

    def _exponentials(self, job: Job, n_steps: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], State]:
        """Rates (rad/s, dq frame) and amplitudes of v and i at the state's time, and the state at the end."""
        system = self._system(job.state.source)
        rates, v, i = [], [], []
        steady, steady_end = np.zeros(len(system.a)), np.zeros(len(system.a))
        duration = n_steps * self.dt_s
        for w, phasor in self._tones(job):
            u = phasor * np.array([1.0, -1j])
            x = np.linalg.solve(1j * w * np.eye(len(system.a)) - system.a, system.b @ u)
            steady = steady + x.real
            steady_end = steady_end + (x * np.exp(1j * w * duration)).real
            v_steady = system.c_v @ x + system.d_v @ u
            i_steady = self._bent(w, v_steady, system.c_i @ x + (system.d_i + 1j * w * system.e) @ u)
            for out, y in ((v, v_steady), (i, i_steady)):
                out += [(y[0] + 1j * y[1]) / 2.0, np.conj(y[0] - 1j * y[1]) / 2.0]
            rates += [1j * w, -1j * w]
        modes = system.inverse @ (job.state.x - steady)
        left = (system.vectors @ (modes * np.exp(system.poles * duration))).real
        turn = np.array([1.0, 1j])
        rates = np.concatenate([np.array(rates, complex), system.poles])
        v = np.concatenate([np.array(v, complex), (turn @ system.c_v @ system.vectors) * modes])
        i = np.concatenate([np.array(i, complex), (turn @ system.c_i @ system.vectors) * modes])
        return rates, (v, i), self._later(job.state, steady_end + left, n_steps)

    def _bent(self, w: float, v: np.ndarray, i: np.ndarray) -> np.ndarray:
        """The current with its cubic part; v and i phasors of dq pairs."""
        if self._bend == 0.0:
            return i
        y = self._device.admittance(np.array([w / (2.0 * np.pi)]))[0] * self._z_ohm
        size = np.linalg.norm(v) / (np.sqrt(2.0) * self.rating.peak_voltage_v)
        return i + self._bend * size**2 / (1.0 + np.linalg.norm(y) ** 2) * y @ y.conj().T @ i


@dataclass(frozen=True)
class _Modal:
    """x' = A x + B u, v and i of it, and the eigenvectors of A."""

    a: np.ndarray
    b: np.ndarray
    c_v: np.ndarray
    d_v: np.ndarray
    c_i: np.ndarray
    d_i: np.ndarray
    e: np.ndarray
    poles: np.ndarray
    vectors: np.ndarray
    inverse: np.ndarray


def _modal(device: Linear, source: Source, w1: float) -> _Modal:
    if source.kind == "ideal":
        a, b, c, d = device.a, device.b, device.c, device.d
        c_v, d_v, e = np.zeros_like(c), np.eye(2), device.e * np.eye(2)
    else:
        a, b, c, d, c_v, d_v = device.on_grid(source.r_ohm, source.l_h * w1)
        e = np.zeros((2, 2))
    poles, vectors = np.linalg.eig(a)
    if np.linalg.cond(vectors) > 1e11:  # a double pole: move it by what does not show
        a = a + 1e-9 * np.abs(a).max() * np.diag(np.linspace(-1.0, 1.0, len(a)))
        poles, vectors = np.linalg.eig(a)
    return _Modal(a, b, c_v, d_v, c, d, e, poles, vectors, np.linalg.inv(vectors))


class NoisyPlant(LinearPlant):
    """The same, measured with noise: ``level`` is its rms over the rated peak, falling from ``corner_hz`` on."""

    run_phasors = None  # type: ignore[assignment]

    def __init__(self, device: Linear, bases: Bases, bend: float, level: float, corner_hz: float, seed: int):
        super().__init__(device, bases, bend)
        self._level, self._corner_hz, self._seed = level, corner_hz, seed

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[State, Record]]:
        """Another job hears another noise, the same job the same."""
        found = []
        for job in jobs:
            end, record = self._run_one(job, n_steps)
            tones = job.injection.tones if job.injection else ()
            key = [round(1e6 * abs(x)) for tone in tones[:2] for x in (tone.f_hz + 1e4, tone.amplitude, tone.phase_rad)]
            rng = np.random.default_rng([self._seed, job.state.step, *key])
            v = record.v + self.rating.peak_voltage_v * self._noise(rng, n_steps)
            i = record.i + self.rating.peak_current_a * self._noise(rng, n_steps)
            found.append((end, replace(record, v=v, i=i)))
        return found

    def _noise(self, rng: np.random.Generator, n: int) -> np.ndarray:
        from scipy.signal import lfilter

        pole = float(np.exp(-2.0 * np.pi * self._corner_hz * self.dt_s))
        white = rng.normal(size=(n + 2000, 2)) @ [1.0, 1j]
        return self._level * lfilter([np.sqrt(0.5 * (1.0 - pole**2))], [1.0, -pole], white)[2000:]


class SampledPlant(_Fed):
    """A `Sampled` device on an ideal source; several samples of the record in one interval of the controller."""

    PER_INTERVAL = 8

    def __init__(self, device: Sampled):
        super().__init__(device.bases, device.control.t_s / self.PER_INTERVAL)
        from scipy.linalg import expm

        self._law = tuple(np.ascontiguousarray(part) for part in device.law)
        a, b = device.circuit(0.0, 0.0)
        self._a, self._b, self._ampere = a, b, 1.0 / device.bases.z_ohm
        self._phi = expm(a * self.dt_s)
        self._by_e = np.linalg.solve(a, (self._phi - np.eye(2)) @ b)

    def settle(self, operating_point: OperatingPoint | None, source: Source) -> State:
        """At once. The state: i, e now, x of the controller; volts of the source are its unit of voltage."""
        if source.kind != "ideal":
            raise ValueError("a sampled device of the benchmark stands on an ideal source")
        return State(0, 0.0, np.zeros(9), source)

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[State, Record]]:
        """Step by step, compiled; a run begins and ends with an interval of the controller."""
        return [self._run_one(job, n_steps) for job in jobs]

    def _run_one(self, job: Job, n_steps: int) -> tuple[State, Record]:
        if n_steps % self.PER_INTERVAL or job.state.step % self.PER_INTERVAL:
            raise ValueError("runs of a sampled device hold whole intervals of its controller")
        dt = self.dt_s
        u, forced = np.zeros(n_steps, complex), np.zeros((n_steps, 2))
        mean = np.zeros(n_steps // self.PER_INTERVAL, complex)
        t_s = self.PER_INTERVAL * dt
        for w, phasor in self._tones(job):
            rotating = phasor * _turning(w * dt, n_steps)
            u += rotating
            per_volt = np.linalg.solve(
                1j * w * np.eye(2) - self._a, (np.exp(1j * w * dt) * np.eye(2) - self._phi) @ self._b
            )
            forced += (rotating[:, None] * (per_volt @ np.array([1.0, -1j]))).real
            mean += rotating[:: self.PER_INTERVAL] * (1.0 - np.exp(-1j * w * t_s)) / (1j * w * t_s)
        i = np.empty((n_steps, 2))
        x = job.state.x.copy()
        seen = np.stack([mean.real, mean.imag], axis=1)
        _advance(x, self._phi, self._by_e, forced, seen, *self._law, self.PER_INTERVAL, i)
        current = (i[:, 0] + 1j * i[:, 1]) * self._ampere
        return self._later(job.state, x, n_steps), self._record(job.state, u, current)


def _advance(*arguments: Any) -> None:
    """The loop of `SampledPlant`, compiled when it is first needed."""
    _compiled()(*arguments)


_loops: list[Any] = []


def _compiled() -> Any:
    if not _loops:
        from numba import njit

        _loops.append(njit(nogil=True, cache=True)(_loop))
    return _loops[0]


def _loop(x, phi, by_e, forced, seen, f, g, h, k, per_interval, out):  # type: ignore[no-untyped-def]
    i, e, own = x[0:2].copy(), x[2:4].copy(), x[4:9].copy()
    measured = np.empty(4)
    after = np.zeros(2)
    for n in range(len(out)):
        if n % per_interval == 0:
            measured[0:2], measured[2:4] = i, seen[n // per_interval]
            after = h @ own + k @ measured
            own = f @ own + g @ measured
        out[n] = i
        d = phi[0, 0] * i[0] + phi[0, 1] * i[1] - by_e[0, 0] * e[0] - by_e[0, 1] * e[1]  # products of such small
        q = phi[1, 0] * i[0] + phi[1, 1] * i[1] - by_e[1, 0] * e[0] - by_e[1, 1] * e[1]  # matrices cost ten times that
        i[0], i[1] = d + forced[n, 0], q + forced[n, 1]
        if n % per_interval == per_interval - 1:
            e[:] = after
    x[0:2], x[2:4], x[4:9] = i, e, own
