"""Resonance beside the fundamental, from 150 ms of a space vector: two estimators, one answer.

Both take block means of the alpha-beta current (or voltage) at some 500 Hz, as a device sampling at
10 kHz would form them: see `block_means`. Frequencies are signed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from ..errors import SeqsweepError

SAMPLE_S = 2e-3
"""Step of the block means (s)."""

WINDOW_S = 0.15
"""Length of the window (s); 75 block means."""

_NEAR_F1_HZ = 3.0
"""Closer to the fundamental nothing can be told apart from it in 150 ms."""

_FFT_NEAR_PERIODS = 1.9
"""The same for the FFT, in lines: Hann's taper spreads the fundamental over its neighbours."""

_FAINTEST = 1e-5
"""Less than this of the fundamental is rounding, not a resonance."""

_FASTEST_GROWTH_PER_S = 80.0
"""What grows or decays faster is a transient, not a resonance."""


@dataclass(frozen=True, slots=True)
class Resonance:
    """The stronger resonance component and the fundamental at the end of a window.

    Attributes
    ----------
    f_hz : float
        Signed frequency (Hz); NaN if there is none.
    amplitude : float
        A_r, in the unit of the samples; 0 if there is none.
    growth_per_s : float
        Real part of the pole (1/s), positive for growth; NaN if there is none.
    fundamental : float
        A_0, in the unit of the samples.
    mirror : float
        Amplitude of the weaker component at 2 f1 - f; 0 if there is none.
    """

    f_hz: float
    amplitude: float
    growth_per_s: float
    fundamental: float
    mirror: float

    @property
    def ratio(self) -> float:
        """r = A_r / A_0, eq. (13); NaN without a fundamental."""
        return self.amplitude / self.fundamental if self.fundamental > 0.0 else float("nan")


NO_RESONANCE = Resonance(*[float("nan")] * 5)
"""The answer to a window that cannot be judged."""

Estimator = Callable[[np.ndarray, float, float], Resonance]
"""(block means, their step in s, f1 in Hz) to the resonance at the end of the last block."""


def block_means(x: np.ndarray, n_block: int) -> np.ndarray:
    """Means of consecutive blocks of ``n_block`` samples; a rest at the *beginning* is left out."""
    n = len(x) // n_block
    return x[len(x) - n * n_block :].reshape(n, n_block).mean(axis=1)


def matrix_pencil(x: np.ndarray, step_s: float = SAMPLE_S, f1_hz: float = 50.0, order: int = 6) -> Resonance:
    """Resonance by the complex matrix pencil.

    Parameters
    ----------
    x : (n,) complex
        Block means of the alpha-beta signal; n >= 4 order.
    step_s : float
        Their step (s).
    f1_hz : float
        Nominal fundamental (Hz); the true one is found with the rest.
    order : int
        Number of exponentials: fundamental, resonance pair, two harmonics, one to spare.

    Returns
    -------
    Resonance
        At the end of the last block. `NO_RESONANCE` if samples are not finite.
    """
    if len(x) < 4 * order:
        raise SeqsweepError(f"{len(x)} samples given; a pencil of order {order} needs {4 * order} or more")
    if not np.all(np.isfinite(x)):
        return NO_RESONANCE
    poles = _poles(x, order) / step_s
    poles = poles[np.abs(poles.real) < _FASTEST_GROWTH_PER_S]
    f_hz = poles.imag / (2.0 * pi)
    if not np.any(np.abs(f_hz - f1_hz) < _NEAR_F1_HZ):
        poles, f_hz = np.append(poles, 2j * pi * f1_hz), np.append(f_hz, f1_hz)
    at_end = _amplitudes_at_end(x, poles, step_s)
    fundamental = abs(np.sum(at_end[np.abs(f_hz - f1_hz) < _NEAR_F1_HZ]))
    magnitude = np.where(_in_resonance_band(f_hz, f1_hz, _NEAR_F1_HZ), np.abs(at_end), 0.0)
    strongest = np.argmax(magnitude)
    at_mirror = np.abs(f_hz - (2.0 * f1_hz - f_hz[strongest])) < _NEAR_F1_HZ
    mirror = np.max(np.where(at_mirror, magnitude, 0.0))
    return _found(f_hz[strongest], magnitude[strongest], poles[strongest].real, fundamental, mirror)


def sliding_fft(x: np.ndarray, step_s: float = SAMPLE_S, f1_hz: float = 50.0) -> Resonance:
    """Resonance as the highest line of an FFT, the paper's way.

    Hann's taper over the last whole number of fundamental periods, so that the fundamental stays in
    its three lines. The frequency is a line's: 150 ms hold 7 periods, lines are 7 Hz apart, and within
    14 Hz of the fundamental nothing is seen. Growth compares the two halves; amplitudes are means over
    the window, not its end. Parameters and result: see `matrix_pencil`.
    """
    n_periods = int(len(x) * step_s * f1_hz + 1e-9)
    n = round(n_periods / (f1_hz * step_s))
    if n_periods < 4:
        raise SeqsweepError(f"{len(x)} samples of {step_s:g} s hold {n_periods} periods of {f1_hz:g} Hz; 4 are needed")
    if not np.all(np.isfinite(x)):
        return NO_RESONANCE
    x = x[len(x) - n :]
    f_hz = np.fft.fftfreq(n, step_s)
    spectrum = np.abs(np.fft.fft(x * _hann(n))) / np.sum(_hann(n))
    spectrum /= np.abs(_block_gain(2j * pi * f_hz, step_s))
    near_hz = _FFT_NEAR_PERIODS * f1_hz / n_periods
    line = int(np.argmax(np.where(_in_resonance_band(f_hz, f1_hz, near_hz), spectrum, 0.0)))
    fundamental = float(spectrum[np.argmin(np.abs(f_hz - f1_hz))])
    half = n // 2
    early, late = (_line_magnitude(part, f_hz[line], step_s) for part in (x[:half], x[n - half :]))
    growth = np.log(late / early) / ((n - half) * step_s) if early > 0.0 and late > 0.0 else float("nan")
    mirror = spectrum[np.argmin(np.abs(f_hz - (2.0 * f1_hz - f_hz[line])))]
    return _found(f_hz[line], spectrum[line], growth, fundamental, mirror)


# ---------------------------------------------------------------------- pieces


def _found(f_hz: float, amplitude: float, growth_per_s: float, fundamental: float, mirror: float) -> Resonance:
    if not amplitude > _FAINTEST * fundamental:
        return Resonance(float("nan"), 0.0, float("nan"), float(fundamental), 0.0)
    return Resonance(float(f_hz), float(amplitude), float(growth_per_s), float(fundamental), float(mirror))


def _in_resonance_band(f_hz: np.ndarray, f1_hz: float, near_hz: float) -> np.ndarray:
    """Resonance pairs lie within (0, 2 f1), away from the fundamental and from direct current."""
    distance = np.abs(f_hz - f1_hz)
    return (distance > near_hz) & (distance < f1_hz - 1.0)


def _poles(x: np.ndarray, order: int) -> np.ndarray:
    """Logarithms of the ``order`` strongest exponentials per sample, by the shift of their row space."""
    hankel = np.lib.stride_tricks.sliding_window_view(x, 2 * len(x) // 5 + 1)
    rows = np.linalg.svd(hankel, full_matrices=False)[2][:order].T
    shift = np.linalg.lstsq(rows[:-1], rows[1:], rcond=None)[0]
    z = np.linalg.eigvals(shift)
    return np.log(np.where(np.abs(z) > 1e-12, z, 1e-12))


def _amplitudes_at_end(x: np.ndarray, poles: np.ndarray, step_s: float) -> np.ndarray:
    """Complex amplitudes of the exponentials at the end of the last block, what the means took away restored."""
    centre_s = (np.arange(len(x)) - len(x) + 0.5) * step_s
    basis = np.exp(np.outer(centre_s, poles)) * _block_gain(poles, step_s)
    return np.linalg.lstsq(basis, x, rcond=None)[0]


def _block_gain(s: np.ndarray, step_s: float) -> np.ndarray:
    """Mean of exp(s t) over a block about its centre: sinh(s T/2) / (s T/2)."""
    half = 0.5 * step_s * s
    return np.sinh(half) / np.where(half == 0.0, 1.0, half) + (half == 0.0)


def _hann(n: int) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(2.0 * pi * np.arange(n) / n)


def _line_magnitude(x: np.ndarray, f_hz: float, step_s: float) -> float:
    return float(abs(np.sum(_hann(len(x)) * x * np.exp(-2j * pi * f_hz * step_s * np.arange(len(x))))))
