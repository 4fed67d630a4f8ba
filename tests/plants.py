"""Plants that tests drive: sound ones without a capability, slow ones, and ones that fail on purpose."""

from __future__ import annotations

import os
import signal
import time
from math import nan
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from seqsweep.plant.branch import RLBranch
from seqsweep.plant.dpmsg import ReferenceTurbine
from seqsweep.plant.protocol import Job, Phasors, Record


class RecordingBranch(RLBranch):
    """The branch without `run_phasors`."""

    run_phasors = None


class RecordingTurbine(ReferenceTurbine):
    """The turbine without `run_phasors`."""

    run_phasors = None


class SlowBranch(RLBranch):
    """The branch, resting for a moment in every call: a campaign long enough to be interrupted."""

    def __init__(self, rest_s: float = 0.02):
        super().__init__()
        self.rest_s = rest_s

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        time.sleep(self.rest_s)
        return super().run_phasors(jobs, windows, block_steps, n_blocks)


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


class NoisyBranch(RLBranch):
    """The branch, measured with coloured noise: ``level`` is its rms over the peak of a rated waveform.

    A pole at ``corner_hz`` colours it; the same job hears the same noise, another job another.
    """

    run_phasors = None

    def __init__(self, level: float = 1e-3, corner_hz: float = 300.0, seed: int = 0):
        super().__init__()
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
        white = rng.normal(size=(n + 2000, 2)) @ [1.0, 1j]
        colour = lfilter([np.sqrt(0.5 * (1.0 - self.pole**2))], [1.0, -self.pole], white)
        return self.level * colour[2000:]
