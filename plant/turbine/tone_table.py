"""Many tones on a common grid of frequencies are one periodic waveform: a transform, not a sum at every step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ..injection import turns

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


def common_period(spectra: Iterable[Spectrum], rate_hz: float) -> int:
    """Samples at ``rate_hz`` after which all spectra repeat; 0 where a sum does as well.

    The tones are taken to lie on multiples of their smallest distance, zero included; where they do not, there is none.
    """
    spectra = list(spectra)
    if max(map(len, spectra)) < FEWEST:
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
