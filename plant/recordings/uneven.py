"""Whether times that look rounded are: samples that were really taken at uneven instants betray themselves.

Times printed with few digits have steps of, say, 200 and 300 us in turn where the samples are 250 us apart; a recorder
that really waits 200 and 300 us in turn prints the same. The samples tell the two apart: taken late and early by d in
turn, a fundamental of w1 is modulated in phase by w1 d at a period of two samples, which puts an image of the relative
size w1 d at f1 + fs / 2. A pattern of P samples has its images at f1 + k fs / P.
"""

from __future__ import annotations

import numpy as np

from .recording import Recording, RecordingError
from .sequences import SpaceVector, fundamental_hz, probe
from .timebase import ROUNDED

LONGEST_PATTERN = 8
IMAGE = 1e-3
"""Size of an image, relative to the fundamental, from which on samples are not evenly spaced."""

NOISE = 8.0
"""And so many times the median of the spectrum."""


def check_even(recording: Recording, voltage: SpaceVector) -> None:
    """Refuse a recording whose times are uneven (and were taken for rounded) and whose samples are so, too."""
    if not any(note.startswith(ROUNDED) for note in recording.notes):
        return
    x = voltage.of(np.nan_to_num(probe(recording, voltage.columns)))
    f1_hz = fundamental_hz(x, recording.dt_s)
    taper = np.hanning(len(x))
    typical = float(np.median(np.abs(np.fft.fft(x * taper))))
    own = _size(x * taper, f1_hz, recording.dt_s)
    for period in range(2, LONGEST_PATTERN + 1):
        for k in range(1, period):
            image = _size(x * taper, f1_hz + k / (period * recording.dt_s), recording.dt_s)
            if image > max(IMAGE * own, NOISE * typical):
                raise RecordingError(
                    f"{recording.path}: the steps of time vary in a pattern of {period} samples, and so do the "
                    f"samples: the fundamental has an image of {image / own:.2%} that evenly spaced ones would not "
                    "show; save at a fixed step"
                )


def _size(tapered: np.ndarray, f_hz: float, dt_s: float) -> float:
    return float(abs(np.sum(tapered * np.exp(-2j * np.pi * f_hz * dt_s * np.arange(len(tapered))))))
