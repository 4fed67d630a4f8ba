"""Many tones on a common grid of frequencies are one periodic waveform: a transform, not a sum at every step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..injection import turns
from ..protocol import Injection, Job, Source

Spectrum = Sequence[tuple[float, Any]]
"""Tones by their signed frequency (Hz) and their phasor at time zero: one number, or (k,) of what they drive."""

FEWEST = 12
"""Tones below which a sum is cheaper."""

MOST_ROWS = 1 << 18
"""Samples of the longest waveform that is worth its memory."""

PERIODS_KEPT = 8
"""Periods of waveforms that are kept: of the four plays of two operating points."""

_ON_THE_GRID = 1e-6
"""A tone further off its line, in lines, is on no common grid."""


class SourceTable(NamedTuple):
    """The waveforms of some jobs' sources side by side, for whoever plays the same again.

    Attributes
    ----------
    asked : list of (Injection, Source, complex)
        What each job is fed by, with the source's voltage as its state has it.
    begins : list of int
        Number of each job's first row since time zero.
    table : (n_rows, 4, n_lanes) array
        `side_by_side` of them.
    """

    asked: list[tuple[Injection | None, Source, complex]]
    begins: list[int]
    table: np.ndarray

    @classmethod
    def of(cls, jobs: Sequence[Job], begins: list[int], table: np.ndarray) -> SourceTable:
        """The table of some jobs, to be kept."""
        return cls(_fed_by(jobs), begins, table)

    def serves(self, jobs: Sequence[Job], begins: Sequence[int]) -> bool:
        """Whether it is the table of these jobs, too: of the same sources, whole periods later."""
        return (
            len(begins) == len(self.begins)
            and all((begin - known) % len(self.table) == 0 for begin, known in zip(begins, self.begins, strict=True))
            and self.asked == _fed_by(jobs)
        )


def _fed_by(jobs: Sequence[Job]) -> list[tuple[Injection | None, Source, complex]]:
    return [(job.injection, job.state.source, job.state.v_source) for job in jobs]


def pays(n_tones: int) -> bool:
    """Whether a table is cheaper than a sum of so many tones."""
    return n_tones >= FEWEST


def common_period(spectra: Iterable[Spectrum], rate_hz: float) -> int:
    """Samples at ``rate_hz`` after which all spectra repeat; 0 where a sum does as well.

    The tones are taken to lie on multiples of their smallest distance, zero included; where they do not, there is none.
    """
    spectra = list(spectra)
    if not pays(max(map(len, spectra))):
        return 0
    f_hz = np.array(sorted({0.0, *(f_hz for spectrum in spectra for f_hz, _ in spectrum)}))
    steps = np.diff(f_hz)
    n_rows = round(rate_hz / steps[steps > 1e-9].min())
    lines = f_hz * n_rows / rate_hz
    fits = n_rows <= MOST_ROWS and np.all(np.abs(lines - np.round(lines)) < _ON_THE_GRID)
    return n_rows if fits else 0


@lru_cache(maxsize=PERIODS_KEPT)
def period_of(forced: tuple[tuple[float, complex, complex], ...], rate_hz: float, n_rows: int) -> np.ndarray:
    """Two waveforms (n_rows, 2) from time zero on, of tones (Hz) and their phasors in each; it is not to be changed.

    A device is run under the same tones several times: until it has settled, and period by period.
    """
    wave = waveform([(f_hz, np.array(of_both)) for f_hz, *of_both in forced], rate_hz, n_rows, 0)
    wave.setflags(write=False)
    return wave


def side_by_side(periods: Sequence[tuple[np.ndarray, int]], n_lanes: int) -> np.ndarray:
    """Pairs of waveforms (n_rows, 2), each from a sample of its own on, as (n_rows, 4, n_lanes): re, im of the two.

    Idle lanes follow the first.
    """
    n_rows = len(periods[0][0])
    table = np.empty((n_rows, 4, n_lanes))
    for lane, (wave, first) in enumerate(periods):
        table[:, :, lane] = np.roll(wave.view(float), -first % n_rows, axis=0)
    table[:, :, len(periods) :] = table[:, :, :1]
    return table


def waveform(spectrum: Spectrum, rate_hz: float, n_rows: int, first: int) -> np.ndarray:
    """Sum of the tones, (n_rows,) or (n_rows, k) complex, at ``rate_hz`` from sample ``first`` after time zero on."""
    lines = np.zeros((n_rows, *np.shape(spectrum[0][1])), complex)
    for f_hz, phasor in spectrum:
        lines[round(f_hz * n_rows / rate_hz) % n_rows] += phasor * turns(f_hz * first / rate_hz)
    return np.fft.ifft(lines, axis=0, norm="forward")
