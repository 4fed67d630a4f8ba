"""Phasors of tapered, exactly coherent windows.

A window holds whole periods of the fundamental and of the line, so it holds whole periods of the
mirror too. Blackman's taper has exact zeros from the third line on: neighbours of a coherent window
do not leak, and slow transients are suppressed instead of averaged.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..plant.errors import SeqsweepError
from ..plant.protocol import Phasors, Record, Window

TAPER = (0.42, -0.5, 0.08)
"""Blackman's taper as coefficients of cos(0), cos(2 pi t/T) and cos(4 pi t/T)."""


def taper(n: int, first: int = 0, length: int | None = None) -> np.ndarray:
    """Blackman's taper of mean one: ``length`` samples from ``first`` on, period ``n``."""
    angle = 2.0 * np.pi * ((first + np.arange(n if length is None else length)) % n) / n
    return (TAPER[0] + TAPER[1] * np.cos(angle) + TAPER[2] * np.cos(2.0 * angle)) / TAPER[0]


def rotation(f_hz: float, t0_s: float, dt_s: float, n: int) -> np.ndarray:
    """``exp(-2j pi f t)`` (n,) at ``t = t0 + k dt``; whole turns are taken off before the exponential."""
    return np.exp(-2j * np.pi * ((f_hz * (t0_s + dt_s * np.arange(n))) % 1.0))


def line(x: np.ndarray, f_hz: float, t0_s: float, dt_s: float) -> complex:
    """Phasor of ``x`` (n,) at a signed frequency, without a taper: the mean of ``x exp(-2j pi f t)``.

    Exact where the n samples hold whole periods of every component of ``x``; that is for the caller
    to see to. A sum of products, not a matrix product: the same bytes in every thread.
    """
    return complex(np.sum(x * rotation(f_hz, t0_s, dt_s, len(x))) / len(x))


def block_phasors(record: Record, window: Window, block_steps: int) -> Phasors:
    """Block sums of a record, as a plant with `run_phasors` gives them: the slow, obvious twin.

    Parameters
    ----------
    record : Record
        Whole blocks of ``block_steps`` samples.
    window : Window
        Line (signed, Hz), window length and position in blocks.
    block_steps : int
        Samples of one block.

    Returns
    -------
    Phasors
        (n_blocks, 2) sums of v (V) and i (A) at f and at 2 f1 - f.

    Raises
    ------
    SeqsweepError
        If the record does not hold whole blocks.
    """
    n = len(record.v)
    if n % block_steps:
        raise SeqsweepError(f"the record holds {n} samples; whole blocks of {block_steps} are needed")
    length = window.n_blocks * block_steps
    weight = taper(length, window.first_block * block_steps, n) / length
    lines = (window.f_hz, 2.0 * record.f1_hz - window.f_hz)
    turns = [weight * rotation(f, record.t0_s, record.dt_s, n) for f in lines]
    v, i = (
        np.stack([(x * turn).reshape(-1, block_steps).sum(axis=1) for turn in turns], 1) for x in (record.v, record.i)
    )
    return Phasors(v, i)


def harmonics(x: np.ndarray, t0_s: float, dt_s: float) -> np.ndarray:
    """Phasors (n,) of one period ``x`` (n,) at the multiples k of its frequency, FFT order, absolute time."""
    n = len(x)
    k = np.fft.fftfreq(n, 1.0 / n)
    return np.fft.fft(x) / n * np.exp(-2j * np.pi * ((k * (t0_s / (n * dt_s))) % 1.0))


def periodic_window(
    lines: np.ndarray, n_cycles: int | np.ndarray, n_blocks: int | np.ndarray, start: float | np.ndarray = 0.0
) -> complex | np.ndarray:
    """What tapered windows hear, at their lines of ``n_cycles`` (whole cycles per window), of a signal that repeats
    every block.

    Parameters
    ----------
    lines : (..., n) complex
        `harmonics` of one block, of one signal or of many.
    n_cycles, n_blocks : int or (m,) int
        Signed cycles of the line in the window; blocks in the window. Of several windows the result is (..., m).
    start : float, (...,) float or (..., m) float
        Begin of the window, in windows since time zero: the taper begins there, the line at zero.

    Notes
    -----
    The signal has lines every ``n_blocks`` bins only; the taper hears those at most two bins away.
    """
    heard = np.zeros(lines.shape[:-1] + np.shape(n_cycles), complex)
    for distance, weight, harmonic in _heard(lines.shape[-1], n_cycles, n_blocks):
        x, turn = weight * lines[..., harmonic], np.exp(-2j * np.pi * ((distance * start) % 1.0))
        # by parts: numpy's product of complex arrays may round otherwise than that of two numbers
        heard.real += x.real * turn.real - x.imag * turn.imag
        heard.imag += x.real * turn.imag + x.imag * turn.real
    return heard[()]


def periodic_window_variance(variance: np.ndarray, n_cycles: int, n_blocks: int) -> float:
    """Variance of what `periodic_window` hears where the lines have ``variance`` (n,), independent of each other."""
    return float(sum(weight**2 * variance[k] for _, weight, k in _heard(len(variance), n_cycles, n_blocks)))


def _heard(
    n_lines: int, n_cycles: int | np.ndarray, n_blocks: int | np.ndarray
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Harmonics at most two bins from lines: (distance in bins, weight, number of the harmonic), no weight for none."""
    for distance in range(-2, 3):
        harmonic, rest = np.divmod(np.asarray(n_cycles) - distance, n_blocks)
        is_there = (rest == 0) & (np.abs(harmonic) < n_lines // 2)
        weight = 1.0 if distance == 0 else 0.5 * TAPER[abs(distance)] / TAPER[0]
        yield distance, np.where(is_there, weight, 0.0), np.where(is_there, harmonic, 0)
