"""One experiment of a recording: fundamental, tones and mirrors out of one stretch of waveforms.

Nothing about the frequencies is taken on trust: f1 is estimated, followed where it drifts, and a tone whose clock
differs from the recorder's is found where it is. Lines that were there already (harmonics of both rotations, unbalance,
an offset) are part of the model, so they do not leak into what is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError
from .line_fit import (
    Line,
    Phases,
    Segments,
    Solution,
    Waveforms,
    constant,
    dirichlet,
    follow,
    from_segment,
    project,
    solve,
)

SEGMENTS = 48
"""Segments aimed at: their scatter is the uncertainty."""

FEWEST_SEGMENTS = 16
"""No more are left out as a transient than leave these."""

SEGMENT_S = (0.02, 0.25)
"""Shortest and longest segment (s)."""

SPECTRUM_SAMPLES = 1 << 16
"""Longest stretch in which lines of the background are looked for."""

ABOVE_NOISE = 6.0
"""A line of the background stands this much above the median of its neighbourhood."""

LEAST_LINE = 1e-5
"""Lines of the background smaller than this part of the tone do no harm."""

MOST_LINES = 40

APART = 0.75
"""Offset and unbalance are told from a tone this many cycles away over the whole stretch."""

DRIFT = 3.0
"""The fundamental drifts where its angle strays this much more than its noise does."""

HOLD = 1e-4
"""A tone is where it is said to be where its angle turns by less than this over the record (rad)."""

TRANSIENT = 6.0
"""Segments at the beginning that stray this much more than later ones are left out."""

F1_BAND_HZ = (10.0, 400.0)


class HearingError(SeqsweepError):
    """A stretch in which the experiment cannot be heard, with the reason."""


class Heard(NamedTuple):
    """One tone of one experiment.

    Attributes
    ----------
    f_hz : float
        Signed frequency of the tone (Hz).
    f1_hz, drift_hz : float
        Fundamental, and half the width of its wandering (Hz).
    v, i : (2,) complex
        Phasors at the tone and at its mirror 2 f1 - f (V, A; load direction).
    v_scatter, i_scatter : (m, 2) complex
        What each segment says beyond that; zero in the mean.
    phi1 : float
        Angle of the fundamental voltage at the time the phasors refer to (rad).
    v1, i1 : complex
        Phasors of the fundamental (V, A).
    background : (k, 2) complex
        Voltage of other lines (V), by ``background_hz``.
    background_hz : (k,) float
        Their frequencies as multiples of f1.
    window_s : float
        Length of what was used (s).
    residual : float
        Disagreement of the two halves of the window, relative.
    expected : float
        The disagreement that noise alone explains.
    notes : tuple of str
        What a person should know.
    """

    f_hz: float
    f1_hz: float
    drift_hz: float
    v: np.ndarray
    i: np.ndarray
    v_scatter: np.ndarray
    i_scatter: np.ndarray
    phi1: float
    v1: complex
    i1: complex
    background: np.ndarray
    background_hz: np.ndarray
    window_s: float
    residual: float
    expected: float
    notes: tuple[str, ...]


def fundamental(waveforms: Waveforms, start: int, stop: int) -> float:
    """Frequency (Hz) of the strongest forward line of the voltage, to a few thousandths of a bin.

    Raises
    ------
    HearingError
        If there is none between `F1_BAND_HZ`.
    """
    n = min(stop - start, SPECTRUM_SAMPLES, max(256, int(4.0 / waveforms.dt_s)))
    middle = (start + stop - n) // 2
    v = waveforms.record(middle, middle + n).v
    v = np.where(np.isfinite(v), v, 0.0)
    spectrum = np.abs(np.fft.fft((v - np.mean(v)) * np.hanning(n)))
    f_hz = np.fft.fftfreq(n, waveforms.dt_s)
    band = (f_hz >= F1_BAND_HZ[0]) & (f_hz <= F1_BAND_HZ[1])
    if not band.any() or not np.max(spectrum[band]) > 0.0:
        raise HearingError(f"no fundamental between {F1_BAND_HZ[0]:g} and {F1_BAND_HZ[1]:g} Hz in the voltage")
    peak = int(np.argmax(np.where(band, spectrum, 0.0)))
    return float(interpolated(spectrum, peak) / (n * waveforms.dt_s))


def interpolated(spectrum: np.ndarray, peak: int) -> float:
    """Bin of a line under a Hann taper between its two strongest bins."""
    n = len(spectrum)
    left, right = spectrum[(peak - 1) % n], spectrum[(peak + 1) % n]
    larger, sign = (right, 1.0) if right > left else (left, -1.0)
    ratio = larger / spectrum[peak]
    signed = peak if peak < n // 2 else peak - n
    return float(signed + sign * (2.0 * ratio - 1.0) / (1.0 + ratio))


def hear(
    waveforms: Waveforms, start: int, stop: int, tones_hz: tuple[float, ...], f1_hz: float | None = None
) -> list[Heard]:
    """Phasors of every tone and its mirror in samples ``start`` to ``stop``, with their scatter.

    Parameters
    ----------
    waveforms : Waveforms
        v (V) and i (A, load direction).
    start, stop : int
        A stretch in which the tones are on.
    tones_hz : tuple of float
        Signed frequencies that were injected together (Hz).
    f1_hz : float, optional
        The fundamental, where it is known exactly; None: estimated and followed.

    Raises
    ------
    HearingError
        If the stretch is too short to tell the lines apart, or holds too few valid samples.
    """
    first_f1 = fundamental(waveforms, start, stop) if f1_hz is None else f1_hz
    own = [Line(1, 0.0), *(line for f in tones_hz for line in (Line(0, f), Line(2, -f)))]
    lines = own + _background(waveforms, start, stop, own, first_f1)
    n_steps = _segment_steps((stop - start), waveforms.dt_s)
    try:
        at_hz = np.array([line.at(first_f1) for line in lines])
        segments = project(waveforms, start, stop, at_hz, n_steps)
        return _hear(segments, lines, len(tones_hz), first_f1, f1_hz is None)
    except np.linalg.LinAlgError:
        raise HearingError(
            f"{(stop - start) * waveforms.dt_s:.3g} s are too short to tell {', '.join(f'{f:g}' for f in tones_hz[:4])}"
            " Hz, the mirror and the fundamental apart: record longer"
        ) from None
    except HearingError:
        raise
    except ValueError as error:
        raise HearingError(str(error)) from None


def _segment_steps(n_samples: int, dt_s: float) -> int:
    length_s = min(max(n_samples * dt_s / SEGMENTS, SEGMENT_S[0]), SEGMENT_S[1])
    return max(8, round(length_s / dt_s))


def _hear(segments: Segments, lines: list[Line], n_tones: int, f1_hz: float, unknown_f1: bool) -> list[Heard]:
    notes: list[str] = []
    if segments.dropped:
        notes.append(
            f"{segments.dropped} of {len(segments.t_s) + segments.dropped} segments hold missing samples: left out"
        )
    phases, f1_hz, drift_hz = _fundamental_phases(segments, lines, f1_hz, unknown_f1)
    if n_tones == 1:
        found = _tone_as_it_is(segments, lines, phases)
        if found != lines and unknown_f1:
            phases, f1_hz, drift_hz = _fundamental_phases(segments, found, f1_hz, unknown_f1)
        lines = found
    before = len(segments.t_s)
    solution = solve(segments, lines, phases)
    while first := _first_steady(solution, 1 + 2 * n_tones):  # the transient was in the solution it is judged by
        segments, phases = from_segment(segments, first), Phases(phases.angle[first:], phases.speed[first:])
        solution = solve(segments, lines, phases)
    if len(segments.t_s) < before:
        left_out_s = (before - len(segments.t_s)) * segments.n_steps * segments.dt_s
        notes.append(f"the first {left_out_s:.3g} s are a transient: left out")
    if drift_hz > 0.0:
        notes.append(f"the fundamental wanders by +-{drift_hz:.3g} Hz about {f1_hz:.6g} Hz: followed")
    window_s = len(segments.t_s) * segments.n_steps * segments.dt_s
    return [
        _heard(solution, lines, tone, n_tones, (f1_hz, drift_hz, window_s), tuple(notes)) for tone in range(n_tones)
    ]


def _heard(
    solution: Solution,
    lines: list[Line],
    tone: int,
    n_tones: int,
    frame: tuple[float, float, float],
    notes: tuple[str, ...],
) -> Heard:
    f1_hz, drift_hz, window_s = frame
    pair = [1 + 2 * tone, 2 + 2 * tone]
    phasors, scatter = solution.a[pair], solution.scores[:, pair]
    half = len(scatter) // 2
    change = scatter[half:].mean(axis=0) - scatter[:half].mean(axis=0)
    spread = np.sqrt(np.mean(np.abs(scatter) ** 2, axis=0) * (1.0 / half + 1.0 / (len(scatter) - half)))
    size = np.linalg.norm(phasors, axis=0)
    others = slice(1 + 2 * n_tones, None)
    return Heard(
        f_hz=lines[pair[0]].at(f1_hz),
        f1_hz=f1_hz,
        drift_hz=drift_hz,
        v=phasors[:, 0],
        i=phasors[:, 1],
        v_scatter=scatter[:, :, 0],
        i_scatter=scatter[:, :, 1],
        phi1=float(np.angle(solution.a[0, 0])),
        v1=complex(solution.a[0, 0]),
        i1=complex(solution.a[0, 1]),
        background=solution.a[others, 0],
        background_hz=np.array([line.at(f1_hz) for line in lines[others]]),
        window_s=window_s,
        residual=float(np.max(np.linalg.norm(change, axis=0) / np.where(size > 0.0, size, 1.0))),
        expected=float(np.max(np.linalg.norm(spread, axis=0) / np.where(size > 0.0, size, 1.0))),
        notes=notes,
    )


# Frequencies


def _fundamental_phases(
    segments: Segments, lines: list[Line], f1_hz: float, unknown: bool
) -> tuple[Phases, float, float]:
    """Angle of the fundamental along the record, its frequency and half the width of its wandering (Hz)."""
    if not unknown:
        return constant(segments, f1_hz), f1_hz, 0.0
    length_s = float(np.ptp(segments.t_s))
    angle = np.zeros(len(segments.t_s))
    for _ in range(12):
        phases = constant(segments, f1_hz)
        angle = _angle(follow(segments, lines, phases, solve(segments, lines, phases), 0)[:, 0])
        slope = float(np.polyfit(segments.t_s, angle, 1)[0])
        f1_hz += slope / (2.0 * np.pi)
        if abs(slope) * length_s < 1e-9:
            break
    return _wandering(segments, lines, f1_hz, angle)


def _angle(phasors: np.ndarray) -> np.ndarray:
    """Angle (m,) of phasors against their first, turns counted (rad)."""
    return np.unwrap(np.angle(phasors * np.conj(phasors[0])))


def _wandering(segments: Segments, lines: list[Line], f1_hz: float, angle: np.ndarray) -> tuple[Phases, float, float]:
    """A constant frequency, or a smooth curve through the angles where they stray more than their noise does."""
    phases = constant(segments, f1_hz)
    strays, noise = np.std(angle - np.polyval(np.polyfit(segments.t_s, angle, 1), segments.t_s)), _roughness(angle)
    if not (strays > DRIFT * noise and strays > HOLD and len(angle) >= 12):
        return phases, f1_hz, 0.0
    for _ in range(3):
        curve = _smooth(segments.t_s, angle)
        speed = curve.deriv()(segments.t_s)
        phases = Phases(
            2.0 * np.pi * f1_hz * segments.t_s + curve(segments.t_s), 2.0 * np.pi * f1_hz + np.asarray(speed)
        )
        left = follow(segments, lines, phases, solve(segments, lines, phases), 0)[:, 0]
        angle = curve(segments.t_s) + _angle(left)
    mean_hz = f1_hz + float(np.mean(speed)) / (2.0 * np.pi)
    return phases, mean_hz, float(np.ptp(speed)) / (4.0 * np.pi)


def _roughness(angle: np.ndarray) -> float:
    """Standard deviation of the noise of a smooth curve, from its second differences."""
    return float(np.std(np.diff(angle, 2)) / np.sqrt(6.0)) if len(angle) > 4 else np.inf


def _smooth(t_s: np.ndarray, angle: np.ndarray) -> np.polynomial.Polynomial:
    """Polynomial of the degree that explains the angles best for its number of coefficients (BIC)."""
    n = len(t_s)
    floor = (0.1 * _roughness(angle)) ** 2 + 1e-24
    candidates = [np.polynomial.Polynomial.fit(t_s, angle, degree) for degree in range(1, min(24, n // 3) + 1)]
    scores = [n * np.log(np.mean((c(t_s) - angle) ** 2) + floor) + len(c.coef) * np.log(n) for c in candidates]
    return candidates[int(np.argmin(scores))]


def _tone_as_it_is(segments: Segments, lines: list[Line], phases: Phases) -> list[Line]:
    """The tone at the frequency at which its angle stands still; recorder and source have clocks of their own."""
    for _ in range(6):
        solution = solve(segments, lines, phases)
        followed = follow(segments, lines, phases, solution, 1)
        heard = np.abs(followed.mean(axis=0)) / (np.std(followed, axis=0) + 1e-300)
        x = followed[:, int(np.argmax(heard))]
        if not np.max(heard) > 0.3:
            break
        slope, noise = _turning(segments.t_s, x)
        if abs(slope) * np.ptp(segments.t_s) < max(HOLD, 5.0 * noise * np.ptp(segments.t_s)):
            break
        f_hz = lines[1].offset_hz + slope / (2.0 * np.pi)
        lines = [lines[0], Line(0, f_hz), Line(2, -f_hz), *lines[3:]]
    return lines


def _turning(t_s: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    """Slope of the angle of phasors along time, and its standard deviation (rad/s); x is about constant."""
    angle = np.imag(x / np.mean(x))
    spread = float(np.sum((t_s - t_s.mean()) ** 2))
    slope = float(np.sum((t_s - t_s.mean()) * angle)) / spread
    return slope, float(np.std(angle - slope * t_s)) / np.sqrt(spread)


# What was there already, and what has not settled yet


def _background(waveforms: Waveforms, start: int, stop: int, own: list[Line], f1_hz: float) -> list[Line]:
    """Offset, unbalance and every further line that stands above the noise, as multiples of f1 where they are."""
    n = min(stop - start, SPECTRUM_SAMPLES)
    record = waveforms.record(stop - n, stop)
    resolution = 1.0 / (n * waveforms.dt_s)
    apart_hz = APART / ((stop - start) * waveforms.dt_s)
    known = [line.at(f1_hz) for line in own]
    fixed = (Line(0, 0.0), Line(-1, 0.0))
    extra = [line for line in fixed if min(abs(line.at(f1_hz) - f) for f in known) > apart_hz]
    known += [line.at(f1_hz) for line in extra]
    for f_hz in _peaks((record.v, record.i), waveforms.dt_s, known, n):
        line = _named(f_hz, f1_hz, own, 1.5 * resolution)
        if min(abs(line.at(f1_hz) - f) for f in known) > 2.5 * resolution:
            extra.append(line)
            known.append(line.at(f1_hz))
    return extra


def _named(f_hz: float, f1_hz: float, own: list[Line], tolerance: float) -> Line:
    """A line as a multiple of f1, as what the device makes of a tone, or as it stands."""
    order = round(f_hz / f1_hz)
    if abs(f_hz - order * f1_hz) < tolerance + 1e-4 * abs(f_hz):
        return Line(order, 0.0)
    for tone in own[1::2]:
        for times in (-3, -2, 2, 3):
            order = round((f_hz - times * tone.offset_hz) / f1_hz)
            if abs(f_hz - times * tone.offset_hz - order * f1_hz) < tolerance:
                return Line(order, times * tone.offset_hz)
    return Line(0, f_hz)


def _peaks(channels: tuple[np.ndarray, ...], dt_s: float, known_hz: list[float], n: int) -> list[float]:
    """Frequencies of lines above the noise, strongest first, but for those known."""
    found: dict[float, float] = {}
    window = np.hanning(n) / (0.5 * n)
    basis, inverse_gram = line_basis(known_hz, dt_s, n)
    for x in channels:
        clean, lines = taken_off(np.where(np.isfinite(x), x, 0.0), basis, inverse_gram)
        size = np.abs(np.fft.fft(clean * window))
        tone = float(np.max(np.abs(lines[1:3]), initial=0.0))
        floor = np.maximum(ABOVE_NOISE * neighbourhood(size), LEAST_LINE * tone)
        top = (size > floor) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1))
        for k in np.flatnonzero(top):
            found[interpolated(size, int(k)) / (n * dt_s)] = float(size[k] / floor[k])
    return sorted(found, key=lambda f: -found[f])[:MOST_LINES]


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


def _first_steady(solution: Solution, n_own: int) -> int:
    """First segment from which on no segment of the first half strays more than those of the second half."""
    if len(solution.scores) < FEWEST_SEGMENTS:
        return 0
    scale = np.linalg.norm(solution.a[1:n_own], axis=0) + 1e-300
    strays = np.max(np.linalg.norm(solution.scores[:, 1:n_own], axis=1) / scale, axis=1)
    half = len(strays) // 2
    usual = np.median(strays[half:])
    wild = np.flatnonzero(strays[:half] > TRANSIENT * usual + HOLD)
    return int(wild[-1]) + 1 if len(wild) else 0
