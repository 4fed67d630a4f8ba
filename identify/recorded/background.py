"""What a record holds beside the tones that were asked for: lines of its spectrum that stand above the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .line_fit import Line, Waveforms, dirichlet

SPECTRUM_SAMPLES = 1 << 16
"""Longest stretch in which lines of the background are looked for."""

PORTION = 1 << 12
"""Samples whose exponentials are held at a time."""

ROUNDS = 3

ABOVE_NOISE = 6.0
"""A line of the background stands this much above the median of its neighbourhood."""

LEAST_LINE = 1e-5
"""Lines of the background smaller than this part of the tone do no harm."""

MOST_LINES = 160

APART = 0.75
"""Offset and unbalance are told from a tone this many cycles away over the whole stretch."""


def background_lines(waveforms: Waveforms, start: int, stop: int, own: list[Line], f1_hz: float) -> list[Line]:
    """Offset, unbalance and every further line that stands above the noise, as multiples of f1 where they are.

    What several tones make of one another stands in every gap between them; there it is looked for again when the
    strongest lines are off.
    """
    n = min(stop - start, SPECTRUM_SAMPLES)
    record = waveforms.record(stop - n, stop)
    channels = tuple(np.where(np.isfinite(x), x, 0.0) for x in (record.v, record.i))
    resolution = 1.0 / (n * waveforms.dt_s)
    apart_hz = APART / ((stop - start) * waveforms.dt_s)
    known = [line.at(f1_hz) for line in own]
    fixed = (Line(0, 0.0), Line(-1, 0.0))
    extra = [line for line in fixed if min(abs(line.at(f1_hz) - f) for f in known) > apart_hz]
    known += [line.at(f1_hz) for line in extra]
    for _ in range(ROUNDS if len(own) > 3 else 1):
        before = len(extra)
        for f_hz in _peaks(channels, waveforms.dt_s, known, n):
            line = _named(f_hz, f1_hz, own, 1.5 * resolution)
            apart = np.min(np.abs(line.at(f1_hz) - np.array(known)))
            if apart > 2.5 * resolution and len(extra) < MOST_LINES:
                extra.append(line)
                known.append(line.at(f1_hz))
        if len(extra) == before:
            break
    return extra


def _named(f_hz: float, f1_hz: float, own: list[Line], tolerance: float) -> Line:
    """A line as a multiple of f1, as what the device makes of a tone, or as it stands."""
    order = round(f_hz / f1_hz)
    if abs(f_hz - order * f1_hz) < tolerance + 1e-4 * abs(f_hz):
        return Line(order, 0.0)
    for tone in own[1::2] if len(own) == 3 else ():  # of several tones some combination is near anything
        for times in (-3, -2, 2, 3):
            order = round((f_hz - times * tone.offset_hz) / f1_hz)
            if abs(f_hz - times * tone.offset_hz - order * f1_hz) < tolerance:
                return Line(order, times * tone.offset_hz)
    return Line(0, f_hz)


def _peaks(channels: tuple[np.ndarray, ...], dt_s: float, known_hz: list[float], n: int) -> list[float]:
    """Frequencies of lines above the noise, strongest first, but for those known."""
    found: dict[float, float] = {}
    window = np.hanning(n) / (0.5 * n)
    for x in channels:
        clean, lines = _without_lines(x, known_hz, dt_s)
        size = np.abs(np.fft.fft(clean * window))
        tone = float(np.max(np.abs(lines[1:3]), initial=0.0))
        floor = np.maximum(ABOVE_NOISE * neighbourhood(size), LEAST_LINE * tone)
        top = (size > floor) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1))
        for k in np.flatnonzero(top):
            found[interpolated(size, int(k)) / (n * dt_s)] = float(size[k] / floor[k])
    return sorted(found, key=lambda f: -found[f])[:MOST_LINES]


def _without_lines(x: np.ndarray, lines_hz: Sequence[float], dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """`taken_off` with exponentials of ``lines_hz`` (k,), a portion of them at a time."""
    n, portions = len(x), range(0, len(x), PORTION)
    shift = [first + 0.5 * (min(PORTION, n - first) - 1) - 0.5 * (n - 1) for first in portions]
    turn = [np.exp(2j * np.pi * dt_s * s * np.asarray(lines_hz)) for s in shift]  # to the middle of a portion
    local = [np.array([_exponential(f, dt_s, m) for f in lines_hz]) for m in {PORTION, n - portions[-1]}]
    basis = {each.shape[1]: each for each in local}
    heard = np.zeros(len(lines_hz), dtype=complex)
    for first, t in zip(portions, turn, strict=True):
        part = x[first : first + PORTION]
        heard += t.conj() * np.einsum("kn,n->k", basis[len(part)], part.conj()).conj()
    gram = dirichlet(np.pi * dt_s * np.subtract.outer(lines_hz, lines_hz), n)
    a = np.einsum("kj,j->k", np.linalg.pinv(gram, rcond=1e-12, hermitian=True), heard)
    left = [
        x[first : first + PORTION] - np.einsum("k,kn->n", a * t, basis[min(PORTION, n - first)])
        for first, t in zip(portions, turn, strict=True)
    ]
    return np.concatenate(left), a


def line_basis(lines_hz: Sequence[float], dt_s: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Exponentials (k, n) at ``lines_hz``, phase zero in the middle, and the inverse of their Gram matrix (k, k)."""
    basis = np.array([_exponential(f, dt_s, n) for f in lines_hz])
    gram = dirichlet(np.pi * dt_s * np.subtract.outer(lines_hz, lines_hz), n)
    return basis, np.linalg.pinv(gram, rcond=1e-12, hermitian=True)


def _exponential(f_hz: float, dt_s: float, n: int, width: int = 256) -> np.ndarray:
    """``exp(2j pi f t)`` (n,), phase zero in the middle, as an outer product: few exponentials, many products."""
    turn = 2j * np.pi * f_hz * dt_s
    coarse = np.exp(turn * (width * np.arange(-(-n // width)) - 0.5 * (n - 1)))
    return np.multiply.outer(coarse, np.exp(turn * np.arange(width))).ravel()[:n]


def taken_off(x: np.ndarray, basis: np.ndarray, inverse_gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``x`` (n,) without its least-squares part in the rows of ``basis`` (k, n), and that part's coefficients (k,).

    Sums of products, not matrix products: the same bytes in every thread.
    """
    a = np.einsum("kj,j->k", inverse_gram, np.einsum("kn,n->k", basis, x.conj()).conj())
    return x - np.einsum("k,kn->n", a, basis), a


def neighbourhood(size: np.ndarray, width: int = 64) -> np.ndarray:
    """Median of ``size`` (n,) in portions of ``width`` bins, per bin; the last portion is the one before continued."""
    n = len(size)
    width = min(width, n)
    medians = np.median(size[: n // width * width].reshape(-1, width), axis=1)
    return medians[np.minimum(np.arange(n) // width, len(medians) - 1)]


def interpolated(spectrum: np.ndarray, peak: int) -> float:
    """Bin of a line under a Hann taper between its two strongest bins."""
    n = len(spectrum)
    left, right = spectrum[(peak - 1) % n], spectrum[(peak + 1) % n]
    larger, sign = (right, 1.0) if right > left else (left, -1.0)
    ratio = larger / spectrum[peak]
    signed = peak if peak < n // 2 else peak - n
    return float(signed + sign * (2.0 * ratio - 1.0) / (1.0 + ratio))
