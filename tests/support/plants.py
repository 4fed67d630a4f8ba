"""Plants that tests drive: sound ones without a capability, slow ones, and ones that fail on purpose."""

from __future__ import annotations

import os
import signal
import time
from math import nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqsweep.plant.protocol import Job, OperatingRange, Phasors, Rating, Record
from seqsweep.plant.rl_branch import RLBranch
from seqsweep.plant.turbine.reference import ReferenceTurbine


class RecordingBranch(RLBranch):
    """The branch without `run_phasors`."""

    run_phasors = None


class RecordingTurbine(ReferenceTurbine):
    """The turbine without `run_phasors`."""

    run_phasors = None


class SlowBranch(RLBranch):
    """The branch, resting for a moment in every call; where it is told to hold, a campaign waits to be interrupted."""

    def __init__(self, rest_s: float = 0.02):
        super().__init__()
        self.rest_s = rest_s

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        time.sleep(self.rest_s)
        _hold()
        return super().run_phasors(jobs, windows, block_steps, n_blocks)


def _hold():
    """Go no further where as many shards are kept as the environment says; see `commands.holding`."""
    n_shards, _, table = os.environ.get("SEQSWEEP_HOLD", "").partition(" ")
    if table and len(list(Path(f"{table}.parts").glob("?" * 64))) >= int(n_shards):
        held = Path(table).with_name("held")
        held.touch()
        while held.exists():
            time.sleep(0.02)


class SlowPythonBranch(SlowBranch):
    """As `SlowBranch`, for processes: it does not claim to release the interpreter lock."""

    releases_gil = False


class SuicidalBranch(SlowPythonBranch):
    """Kills its own process, once: the first to find no file at ``scar`` leaves one there and is gone."""

    def __init__(self, scar: str, rest_s: float = 0.02):
        super().__init__(rest_s)
        self.scar = scar

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        if not Path(self.scar).exists():
            Path(self.scar).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().run_phasors(jobs, windows, block_steps, n_blocks)


class KilledWhenMadeBranch(SlowPythonBranch):
    """Is killed while it is made: the first ``times`` of its processes, which leave a mark each in ``scars``."""

    def __init__(self, scars: str, times: int):
        super().__init__(0.0)
        marks = len(list(Path(scars).iterdir()))
        if marks < times:
            (Path(scars) / str(marks)).touch()
            os.kill(os.getpid(), signal.SIGKILL)


class FailingBranch(RLBranch):
    """Fails for tones between ``low_hz`` and ``high_hz`` in the way that ``how`` says."""

    def __init__(self, how: str = "raises", low_hz: float = 90.0, high_hz: float = 110.0):
        super().__init__()
        self.how, self.band_hz = how, (low_hz, high_hz)

    def meant(self, job):
        low, high = self.band_hz
        return job.injection is not None and any(low < tone.f_hz < high for tone in job.injection.tones)

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        meant = [self.meant(job) for job in jobs]
        if self.how == "raises" and any(meant):
            raise RuntimeError("the converter tripped")
        answers = super().run_phasors(jobs, windows, block_steps, n_blocks)
        return [self.spoilt(a) if m else a for a, m in zip(answers, meant, strict=True)]

    def spoilt(self, answer):
        end, phasors = answer
        if self.how == "nan":
            return end, Phasors(np.full_like(phasors.v, nan), np.full_like(phasors.i, nan))
        if self.how == "short":
            return end, Phasors(phasors.v[:-1], phasors.i[:-1])
        if self.how == "silent":
            return end, Phasors(0.0 * phasors.v, 0.0 * phasors.i)
        raise AssertionError(self.how)


class FailingRecordingBranch(FailingBranch):
    """The same faults in `run`, for the path by way of records."""

    run_phasors = None

    def run(self, jobs, n_steps):
        meant = [self.meant(job) for job in jobs]
        if self.how == "raises" and any(meant):
            raise RuntimeError("the converter tripped")
        answers = super().run(jobs, n_steps)
        if self.how == "few" and len(answers) > 1:
            return answers[:-1]
        return [self.spoilt(a) if m else a for a, m in zip(answers, meant, strict=True)]

    def spoilt(self, answer):
        end, record = answer
        if self.how == "nan":
            return end, self.with_current(record, np.full_like(record.i, nan))
        if self.how == "short":
            return end, Record(record.t0_s, record.dt_s, record.v[:-1], record.i[:-1], record.f1_hz)
        if self.how == "wrong step":
            return end, Record(record.t0_s, 2.0 * record.dt_s, record.v, record.i, record.f1_hz)
        raise AssertionError(self.how)

    def with_current(self, record, i):
        return Record(record.t0_s, record.dt_s, record.v, i, record.f1_hz)


class LateBranch(RLBranch):
    """Finds its steady state by waiting: its time is not zero then, nor a whole number of periods."""

    def settle(self, operating_point, source):
        ((late, _),) = self.run([Job(super().settle(operating_point, source), None)], 4321)
        return late


class DriftingBranch(RLBranch):
    """A device that never comes to rest: its current goes on changing after it was called settled."""

    def run(self, jobs, n_steps):
        return [(end, self.drifted(record)) for end, record in super().run(jobs, n_steps)]

    def drifted(self, record):
        return Record(record.t0_s, record.dt_s, record.v, record.i * (1.0 + 1e-3 * record.time_s), record.f1_hz)


class GrowingBranch(RLBranch):
    """Its response to a perturbation grows for ever; unperturbed it is at rest."""

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        answers = super().run_phasors(jobs, windows, block_steps, n_blocks)
        return [(end, self.grown(job, phasors)) for job, (end, phasors) in zip(jobs, answers, strict=True)]

    def grown(self, job, phasors):
        seconds = job.state.time_s + self.dt_s * 400 * np.arange(len(phasors.i))
        growth = np.exp(seconds)[:, None]
        return Phasors(phasors.v * growth, phasors.i * growth)


class UnwillingBranch(RLBranch):
    """Raises as soon as it is asked to settle."""

    def settle(self, operating_point, source):
        raise RuntimeError("no licence server found")


class Noisy:
    """A plant measured with coloured noise: ``level`` is its rms over the peak of a rated waveform.

    A pole at ``corner_hz`` colours it; the same job hears the same noise, another job another.
    """

    run_phasors = None

    def __init__(self, level: float = 1e-3, corner_hz: float = 300.0, seed: int = 0, dt_s: float = 50e-6):
        super().__init__(dt_s=dt_s)
        self.level, self.pole, self.seed = level, float(np.exp(-2.0 * np.pi * corner_hz * self.dt_s)), seed

    def run(self, jobs, n_steps):
        return [
            (end, self.heard(job, record)) for job, (end, record) in zip(jobs, super().run(jobs, n_steps), strict=True)
        ]

    def heard(self, job, record):
        tones = job.injection.tones if job.injection else ()
        key = [self.seed, job.state.step, *(abs(hash((tone.f_hz, tone.amplitude, tone.phase_rad))) for tone in tones)]
        rng = np.random.default_rng(key)
        v, i = (x + size * self.noise(rng, len(x)) for x, size in self.sizes(record))
        return Record(record.t0_s, record.dt_s, v, i, record.f1_hz)

    def sizes(self, record):
        return (record.v, self.rating.peak_voltage_v), (record.i, self.rating.peak_current_a)

    def noise(self, rng, n):
        from scipy.signal import lfilter  # takes longer than all else here: not for every process with such a plant

        white = rng.normal(size=(n + 2000, 2)) @ [1.0, 1j]
        colour = lfilter([np.sqrt(0.5 * (1.0 - self.pole**2))], [1.0, -self.pole], white)
        return self.level * colour[2000:]


class NoisyBranch(Noisy, RLBranch):
    """The branch, measured with noise."""


class NoisyTurbine(Noisy, ReferenceTurbine):
    """The turbine, measured with noise."""


class BentBranch(RLBranch):
    """The branch, its current bent as a function of how far v_pcc is from its operating point.

    ``dead_band``: nothing is answered below ``limit_pu``. ``saturation``: no more is answered above it.
    """

    run_phasors = None

    def __init__(self, how: str = "saturation", limit_pu: float = 4e-4):
        super().__init__()
        self.how, self.limit_pu = how, limit_pu

    def run(self, jobs, n_steps):
        return [
            (end, self.bent(job.state, record))
            for job, (end, record) in zip(jobs, super().run(jobs, n_steps), strict=True)
        ]

    def bent(self, state, record):
        limit = self.limit_pu * self.rating.peak_voltage_v
        away = record.v - state.v_source * np.exp(2j * np.pi * self.f1_hz * record.time_s)
        size = np.maximum(np.abs(away), 1e-12)
        share = np.minimum(1.0, limit / size) if self.how == "saturation" else np.maximum(0.0, 1.0 - limit / size)
        return Record(record.t0_s, record.dt_s, record.v, record.i + 5.0 * share * away, record.f1_hz)


class RippledBranch(RLBranch):
    """The branch with a ripple on its current that is not synchronous with f1, as of a modulator."""

    run_phasors = None

    def __init__(self, size_pu: float = 0.02, f_ripple_hz: float = 2437.3):
        super().__init__()
        self.size_pu, self.f_ripple_hz = size_pu, f_ripple_hz

    def run(self, jobs, n_steps):
        return [(end, self.rippled(record)) for end, record in super().run(jobs, n_steps)]

    def rippled(self, record):
        ripple = self.size_pu * self.rating.peak_current_a * np.exp(2j * np.pi * self.f_ripple_hz * record.time_s)
        return Record(record.t0_s, record.dt_s, record.v, record.i + ripple, record.f1_hz)


class QuantisedConverter:
    """A current-controlled converter on an ideal source whose sampled controller never rests.

    L di/dt = v - R i - v_conv in the frame at f1, by the exact step; every ``dt_s`` the controller rounds the
    current to ``step_a`` and sets v_conv for the next interval: the rounding keeps a limit cycle alive.
    """

    id = "quantised-v1"
    power_meaning = "power at the PCC"
    f1_hz = 50.0

    def __init__(self, step_a: float = 5.0, dt_s: float = 1e-4):
        self.dt_s, self.step_a = dt_s, step_a
        self.rating = Rating(690.0, 1e6)
        self.operating_range = OperatingRange((0.0, 1e6), (600.0, 760.0))
        pole = -(0.01 + 2j * np.pi * self.f1_hz * 3e-4) / 3e-4
        self.keeps, self.takes = np.exp(pole * dt_s), np.expm1(pole * dt_s) / (pole * 3e-4)

    def settle(self, operating_point, source):
        v = np.sqrt(2.0 / 3.0) * operating_point.terminal_voltage_v
        i_ref = -operating_point.active_power_w / (1.5 * v)
        start = SampledState(0, 0.0, complex(i_ref), v - (0.01 + 2j * np.pi * 50.0 * 3e-4) * i_ref, v, i_ref)
        ((state, _),) = self.run([Job(start, None)], 4000)
        return state

    def run(self, jobs, n_steps):
        time_s = np.array([job.state.time_s for job in jobs])
        i, hold = (np.array([getattr(job.state, name) for job in jobs]) for name in ("i", "hold"))
        v_0, i_ref = (np.array([getattr(job.state, name) for job in jobs]) for name in ("v_0", "i_ref"))
        v = v_0[:, None] + np.array([self.perturbation(job, n_steps) for job in jobs])
        answer = np.empty((len(jobs), n_steps), complex)
        for k in range(n_steps):
            answer[:, k] = i
            error = self.step_a * (np.rint(i.real / self.step_a) + 1j * np.rint(i.imag / self.step_a)) - i_ref
            i, hold = self.keeps * i + self.takes * (v[:, k] - hold - 0.6 * error), hold + 0.02 * error
        results = []
        for m, job in enumerate(jobs):
            times = time_s[m] + self.dt_s * np.arange(n_steps)
            turn = np.exp(2j * np.pi * ((self.f1_hz * times) % 1.0))
            step = job.state.step + n_steps
            end = SampledState(step, step * self.dt_s, complex(i[m]), complex(hold[m]), v_0[m], i_ref[m])
            results.append((end, Record(time_s[m], self.dt_s, v[m] * turn, answer[m] * turn, self.f1_hz)))
        return results

    def perturbation(self, job, n_steps):
        """Series voltage in the frame at f1, the first sample of each interval standing for all of it."""
        times = job.state.time_s + self.dt_s * np.arange(n_steps)
        u = np.zeros(n_steps, complex)
        for tone in job.injection.tones if job.injection else ():
            turns = ((tone.f_hz - self.f1_hz) * times) % 1.0
            u += tone.amplitude * np.exp(1j * (2.0 * np.pi * turns + tone.phase_rad))
        return u

    def exact(self, f_hz):
        """Admittance (n, 2, 2) of the sampled loop without the rounding, between samples."""
        y = np.zeros((len(f_hz), 2, 2), complex)
        y[:, 0, 0] = self._loop(np.exp(2j * np.pi * (f_hz - self.f1_hz) * self.dt_s))
        y[:, 1, 1] = np.conj(self._loop(np.exp(2j * np.pi * (self.f1_hz - f_hz) * self.dt_s)))
        return y

    def _loop(self, z):
        return self.takes / (z - self.keeps + self.takes * (0.6 + 0.02 / (z - 1.0)))


class SampledState(NamedTuple):
    """Step, time (s), current (A) and held integral (V) in the frame at f1; |v_pcc| peak (V) and reference (A)."""

    step: int
    time_s: float
    i: complex
    hold: complex
    v_0: float
    i_ref: float


class NoisyBentBranch(NoisyBranch):
    """Noise and a saturation: small tones drown, large ones are bent."""

    def __init__(self, level: float = 1e-3, limit_pu: float = 4e-3, seed: int = 0, dt_s: float = 200e-6):
        super().__init__(level, seed=seed, dt_s=dt_s)
        self.bend = BentBranch("saturation", limit_pu)

    def heard(self, job, record):
        return super().heard(job, self.bend.bent(job.state, record))
