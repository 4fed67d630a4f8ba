"""Many tones on a common grid of frequencies are one periodic waveform: a transform, not a sum at every step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..injection import turns

Spectrum = Sequence[tuple[float, Any]]
"""Tones by their signed frequency (Hz) and their phasor at time zero: one number, or (k,) of what they drive."""

FEWEST = 12
"""Tones below which a sum is cheaper."""

MOST_ROWS = 1 << 18
"""Samples of the longest waveform that is worth its memory."""

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


def waveform(spectrum: Spectrum, rate_hz: float, n_rows: int, first: int) -> np.ndarray:
    """Sum of the tones, (n_rows,) or (n_rows, k) complex, at ``rate_hz`` from sample ``first`` after time zero on."""
    lines = np.zeros((n_rows, *np.shape(spectrum[0][1])), complex)
    for f_hz, phasor in spectrum:
        lines[round(f_hz * n_rows / rate_hz) % n_rows] += phasor * turns(f_hz * first / rate_hz)
    return np.fft.ifft(lines, axis=0, norm="forward")
