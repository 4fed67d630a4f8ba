"""Driving a broadband signal: all points at once, along d and along q, each as a pair of opposite signs.

Half the difference of a pair is free of the unperturbed operation and of even-order distortion. What odd-order
distortion makes of the lines is heard on odd lines that are not played.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

import numpy as np

from ...identify.fourier import rotation
from ...identify.settling import NOISY_WINDOWS, Agreements, Settled, steady_mean
from ...identify.transient_modes import transients
from ...plant.protocol import Job, Plant, Record
from ..excitation.odd_lines import detection_lines
from ..plan import SETTLE_S, Batch
from .baseline import Baseline, run

NEAR = 5
"""Detection lines whose distortion speaks for a line that is played."""


SIGNIFICANT = 3.0
"""Power on silent lines below so many times that of the noise says nothing."""


class Heard(NamedTuple):
    """What the lines of a signal show.

    Attributes
    ----------
    pairs : list of (Settled, Settled)
        Per point of the batch: along d and along q.
    distortion : (n,) float
        Per point: odd-order distortion near it, relative to the response; NaN where nothing listens.
    """

    pairs: list[tuple[Settled, Settled]]
    distortion: np.ndarray


class Periods(NamedTuple):
    """What was heard so far, from the frame that rotates at f1.

    Attributes
    ----------
    t0_s : float
        Begin of the last period (s).
    v, i : (2, n_periods, n) complex
        Half the differences of the pairs, along d and along q (V, A).
    """

    t0_s: float
    v: np.ndarray
    i: np.ndarray


def drive_broadband(plant: Plant, batch: Batch, base: Baseline) -> Heard:
    """Run the four plays of ``batch`` period by period until every point is at rest, or their time is over.

    Raises
    ------
    PlantFault
        If the plant does not give what was asked.
    """
    period_blocks = batch.points[0].window_blocks
    period_s = period_blocks * batch.block.duration_s
    jobs = [Job(base.state, play.injection(base.phi1)) for play in batch.plays]
    jobs, _ = _advance(plant, batch, jobs, ceil(SETTLE_S / batch.block.duration_s))
    fewest = NOISY_WINDOWS + 1 if base.noisy else 2
    heard: list[Periods] = []
    while True:
        jobs, records = _advance(plant, batch, jobs, period_blocks)
        heard = [*(heard if base.noisy else heard[-1:]), _differences(records, batch)]
        if len(heard) < fewest:
            continue
        result = _judged(batch, base, heard)
        over = records[0].t0_s + 2.0 * period_s - base.t0_s > batch.limits.max_simulated_s
        if over or all(s.agreed or not np.isfinite(s.residual) for pair in result.pairs for s in pair):
            return result


def _advance(plant: Plant, batch: Batch, jobs: list[Job], n_blocks: int) -> tuple[list[Job], list[Record]]:
    answers = run(plant, jobs, n_blocks * batch.block.steps)
    after = [Job(state, job.injection) for (state, _), job in zip(answers, jobs, strict=True)]
    return after, [record for _, record in answers]


def _differences(records: Sequence[Record], batch: Batch) -> Periods:
    """One period: half the difference of each pair, turned into the frame at f1."""
    first = records[0]
    turn = 0.5 * rotation(batch.f1_hz, first.t0_s, batch.dt_s, len(first.v))
    plus_d, minus_d, plus_q, minus_q = records
    v = np.array([plus_d.v - minus_d.v, plus_q.v - minus_q.v])
    i = np.array([plus_d.i - minus_d.i, plus_q.i - minus_q.i])
    return Periods(first.t0_s, (turn * v)[:, None], (turn * i)[:, None])


def _judged(batch: Batch, base: Baseline, heard: Sequence[Periods]) -> Heard:
    v, i = (np.concatenate(parts, axis=1) for parts in ([p.v for p in heard], [p.i for p in heard]))
    if not base.noisy:
        v, i = _without_transients(v, i, batch.dt_s)
    spectra = Periods(heard[-1].t0_s, np.fft.fft(v) / v.shape[2], np.fft.fft(i) / i.shape[2])

    v, i = _phasors(batch, spectra.v, spectra.t0_s), _phasors(batch, spectra.i, spectra.t0_s)
    judge = _noisy if base.noisy else _quiet
    settled = judge(batch, v, i)
    return Heard(list(zip(settled[::2], settled[1::2], strict=True)), _distortion(batch, spectra.i))


def _noisy(batch: Batch, v: np.ndarray, i: np.ndarray) -> list[Settled]:
    """The judgement of every experiment from all its periods, (n, n_periods, 2)."""
    return [steady_mean(*of_one, batch.limits.uncertainty) for of_one in zip(v, i, strict=True)]


def _quiet(batch: Batch, v: np.ndarray, i: np.ndarray) -> list[Settled]:
    """The judgement of every experiment from its last two periods, (n, 2, 2)."""
    n, n_periods, _ = v.shape
    last = Agreements(np.ones(n, int), np.full(n, n_periods), np.full(n, batch.limits.tolerance))
    last.hear(np.arange(n), np.stack([v, i], axis=1), 0)
    return [last.settled(k) for k in range(n)]


def _without_transients(v: np.ndarray, i: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Two periods (2, 2, n) of v and i, less the modes that all their channels share."""
    channels = np.concatenate([v.real, v.imag, i.real, i.imag])
    of_both = np.stack(transients(channels[:, 0], channels[:, 1], dt_s), axis=1)
    v_re, v_im, i_re, i_im = np.split(channels - of_both, 4)
    return v_re + 1j * v_im, i_re + 1j * i_im


def _phasors(batch: Batch, spectra: np.ndarray, t0_s: float) -> np.ndarray:
    """Phasors (2 n, n_periods, 2) at f and 2 f1 - f of every point, along d and along q, in absolute time."""
    period_s = batch.points[0].window_blocks * batch.block.duration_s
    cycles = np.array([point.n_periods for point in batch.points]) - round(batch.f1_hz * period_s)
    begin = np.exp(-2j * np.pi * ((cycles / period_s * t0_s) % 1.0))
    at, turn = np.stack([cycles, -cycles], axis=1), np.stack([begin, np.conj(begin)], axis=1)
    heard = spectra[:, :, at] * turn
    return heard.transpose(2, 0, 1, 3).reshape(-1, *heard.shape[1::2])


def _distortion(batch: Batch, spectra: np.ndarray) -> np.ndarray:
    """Odd-order distortion (n,) near every point, relative to its response; what scatters as noise is taken off."""
    played = batch.plays[0].signal.cycles
    _, silent = detection_lines(played)
    if len(silent) < NEAR:
        return np.full(len(batch.points), np.nan)
    response, _ = _powers(spectra, played)
    distortion, noise = _powers(spectra, silent)
    period_s = batch.points[0].window_blocks * batch.block.duration_s
    cycles = np.abs(np.array([point.n_periods for point in batch.points]) - round(batch.f1_hz * period_s))
    near = np.argsort(np.abs(np.log(silent / cycles[:, None])), axis=1, kind="stable")[:, :NEAR]
    heard, of_noise = distortion[near].mean(axis=1), noise[near].mean(axis=1)
    response = response[np.searchsorted(played, cycles)]
    return np.sqrt(np.where(heard > SIGNIFICANT * of_noise, (heard - of_noise) / response, 0.0))


def _powers(spectra: np.ndarray, cycles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power (n,) of the last periods' mean at both sides of f1, both plays together, and what noise adds to it."""
    both = np.stack([spectra[:, -NOISY_WINDOWS:, cycles], spectra[:, -NOISY_WINDOWS:, -cycles]])
    power = np.sum(np.abs(both.mean(axis=2)) ** 2, axis=(0, 1))
    if spectra.shape[1] <= 2:
        return power, np.zeros(len(cycles))
    return power, np.sum(np.var(both, axis=2, ddof=1), axis=(0, 1)) / both.shape[2]
