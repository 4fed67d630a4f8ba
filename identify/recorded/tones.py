"""One experiment of a recording: fundamental, tones and mirrors out of one stretch of waveforms.

Nothing about the frequencies is taken on trust: f1 is estimated and followed where it drifts (`fundamental`), and a
tone whose clock differs from the recorder's is found where it is. Lines that were there already (harmonics of both
rotations, unbalance, an offset) are part of the model, so they do not leak into what is asked (`background`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .background import background_lines
from .fundamental import (
    HOLD,
    Frame,
    HearingError,
    found_frame,
    fundamental,
    known_frame,
    with_unknown_frequency,
)
from .line_fit import Line, Phases, Segments, Solution, Waveforms, from_segment, project, solve

SEGMENTS = 48
"""Segments aimed at: their scatter is the uncertainty."""

FEWEST_SEGMENTS = 16
"""No more are left out as a transient than leave these."""

SEGMENT_S = (0.02, 0.25)
"""Shortest and longest segment (s)."""

TRANSIENT = 6.0
"""Segments at the beginning that stray this much more than later ones are left out."""

SURER = 0.85
"""Segments are left out where that makes the variance of the mean at least so much smaller."""

LEAST_FREEDOM = 3.0
"""With fewer degrees of freedom the scatter of the segments tells nothing."""

RETUNED_CYCLES = 2.0
"""A tone at least this many cycles away from the fundamental is looked for where its own clock has it."""

__all__ = ["Doubt", "Heard", "HearingError", "fundamental", "hear", "segment_steps"]


class Doubt(NamedTuple):
    """Why a tone cannot be trusted: the status of its row, and the reason."""

    status: str
    reason: str


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
    freedom : float
        Degrees of freedom of the scatter.
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
    doubt : Doubt or None
        Why the tone cannot be trusted, although it has a value.
    place_known : bool
        Whether a quiet stretch of the record has shown what stands at the tone's place without it.
    """

    f_hz: float
    f1_hz: float
    drift_hz: float
    v: np.ndarray
    i: np.ndarray
    v_scatter: np.ndarray
    i_scatter: np.ndarray
    freedom: float
    phi1: float
    v1: complex
    i1: complex
    background: np.ndarray
    background_hz: np.ndarray
    window_s: float
    residual: float
    expected: float
    notes: tuple[str, ...]
    doubt: Doubt | None = None
    place_known: bool = False


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
    lines = own + background_lines(waveforms, start, stop, own, first_f1)
    n_steps = segment_steps((stop - start), waveforms.dt_s)
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


def segment_steps(n_samples: int, dt_s: float) -> int:
    """Samples of a segment of a stretch: some fifty segments, neither too short nor too long."""
    length_s = min(max(n_samples * dt_s / SEGMENTS, SEGMENT_S[0]), SEGMENT_S[1])
    return max(8, round(length_s / dt_s))


def _hear(segments: Segments, lines: list[Line], n_tones: int, f1_hz: float, unknown_f1: bool) -> list[Heard]:
    notes: list[str] = []
    if segments.dropped:
        notes.append(
            f"{segments.dropped} of {len(segments.t_s) + segments.dropped} segments hold missing samples: left out"
        )
    frame = found_frame(segments, lines, f1_hz, n_tones) if unknown_f1 else known_frame(segments, f1_hz)
    found = _tones_as_they_are(segments, lines, frame, n_tones)
    if found != lines and unknown_f1:
        frame = found_frame(segments, found, frame.f1_hz, n_tones)
    lines = with_unknown_frequency(found, frame)
    segments, solution = _steady(segments, lines, frame.phases, n_tones)
    if len(segments.t_s) < len(frame.phases.angle):
        left_out_s = (len(frame.phases.angle) - len(segments.t_s)) * segments.n_steps * segments.dt_s
        notes.append(f"the first {left_out_s:.3g} s are a transient: left out")
    if frame.drift_hz > 0.0:
        notes.append(f"the fundamental wanders by +-{frame.drift_hz:.3g} Hz about {frame.f1_hz:.6g} Hz: followed")
    window_s = len(segments.t_s) * segments.n_steps * segments.dt_s
    return [_heard(solution, lines, tone, n_tones, frame, window_s, tuple(notes)) for tone in range(n_tones)]


def _steady(segments: Segments, lines: list[Line], phases: Phases, n_tones: int) -> tuple[Segments, Solution]:
    """The segments from which on the device is at rest, and the solution of those."""
    solution = solve(segments, lines, phases)
    while first := _first_steady(solution, 1 + 2 * n_tones):  # the transient was in the solution it is judged by
        segments, phases = from_segment(segments, first), Phases(phases.angle[first:], phases.speed[first:])
        solution = solve(segments, lines, phases)
    return segments, solution


def _heard(
    solution: Solution,
    lines: list[Line],
    tone: int,
    n_tones: int,
    frame: Frame,
    window_s: float,
    notes: tuple[str, ...],
) -> Heard:
    pair = [1 + 2 * tone, 2 + 2 * tone]
    phasors, scatter = solution.a[pair], solution.scores[:, pair]
    half = len(scatter) // 2
    change = scatter[half:].mean(axis=0) - scatter[:half].mean(axis=0)
    spread = np.sqrt(np.mean(np.abs(scatter) ** 2, axis=0) * (1.0 / half + 1.0 / (len(scatter) - half)))
    size = np.linalg.norm(phasors, axis=0)
    others = [k for k in range(1 + 2 * n_tones, len(lines)) if lines[k].power == 0]
    freedom = float(np.min(solution.freedom[pair]))
    if freedom < LEAST_FREEDOM:
        raise HearingError(
            f"{len(lines)} lines in {window_s:.3g} s leave nothing to tell the noise by: record longer, or fewer lines "
            "at a time"
        )
    return Heard(
        f_hz=lines[pair[0]].at(frame.f1_hz),
        f1_hz=frame.f1_hz,
        drift_hz=frame.drift_hz,
        v=phasors[:, 0],
        i=phasors[:, 1],
        v_scatter=scatter[:, :, 0],
        i_scatter=scatter[:, :, 1],
        freedom=freedom,
        phi1=float(np.angle(solution.a[0, 0])),
        v1=complex(solution.a[0, 0]),
        i1=complex(solution.a[0, 1]),
        background=solution.a[others, 0],
        background_hz=np.array([lines[k].at(frame.f1_hz) for k in others]),
        window_s=window_s,
        residual=float(np.max(np.linalg.norm(change, axis=0) / np.where(size > 0.0, size, 1.0))),
        expected=float(np.max(np.linalg.norm(spread, axis=0) / np.where(size > 0.0, size, 1.0))),
        notes=notes,
        doubt=_doubt_of(lines[pair[0]], frame, window_s),
    )


def _doubt_of(tone: Line, frame: Frame, window_s: float) -> Doubt | None:
    """Doubts of the frame concern the tones next to the fundamental, not those far away."""
    close = abs(tone.at(frame.f1_hz) - frame.f1_hz) * window_s < 2.0 * RETUNED_CYCLES
    return Doubt("ill_conditioned", frame.doubt) if frame.doubt and close else None


# Tones whose generator has a clock of its own


def _tones_as_they_are(segments: Segments, lines: list[Line], frame: Frame, n_tones: int) -> list[Line]:
    """Every tone at the frequency at which its angle stands still; recorder and source have clocks of their own.

    A tone that is d off turns as exp(2j pi d t) against its line; the slope of its angle from segment to segment is
    2 pi d. All tones are moved at once, then solved for again.
    """
    length_s = float(np.ptp(segments.t_s))
    for _ in range(6):
        solution = solve(segments, with_unknown_frequency(lines, frame), frame.phases)
        moves = [_move(segments, lines, solution, frame, 1 + 2 * tone, length_s) for tone in range(n_tones)]
        if not any(moves):
            break
        for tone, move in enumerate(moves):
            f_hz = lines[1 + 2 * tone].offset_hz + move
            lines = [*lines[: 1 + 2 * tone], Line(0, f_hz), Line(2, -f_hz), *lines[3 + 2 * tone :]]
    return lines


def _move(
    segments: Segments, lines: list[Line], solution: Solution, frame: Frame, number: int, length_s: float
) -> float:
    """How far a tone is off (Hz); 0 where its angle stands still, or where nothing of it is heard."""
    if abs(lines[number].at(frame.f1_hz) - frame.f1_hz) * length_s < RETUNED_CYCLES:
        return 0.0
    followed = solution.followed(number)
    heard = np.abs(followed.mean(axis=0)) / (np.std(followed, axis=0) + 1e-300)
    if not np.max(heard) > 0.3:
        return 0.0
    slope, noise = _turning(segments.t_s, followed[:, int(np.argmax(heard))])
    return 0.0 if abs(slope) * length_s < max(HOLD, 5.0 * noise * length_s) else slope / (2.0 * np.pi)


def _turning(t_s: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    """Slope of the angle of phasors along time, and its standard deviation (rad/s); x is about constant."""
    angle = np.imag(x / np.mean(x))
    spread = float(np.sum((t_s - t_s.mean()) ** 2))
    slope = float(np.sum((t_s - t_s.mean()) * angle)) / spread
    return slope, float(np.std(angle - slope * t_s)) / np.sqrt(spread)


# What has not settled yet


def _first_steady(solution: Solution, n_own: int) -> int:
    """First segment to be used: what has not settled makes the mean worse than fewer segments would.

    A segment of the first half is wild where it strays several times more than those of the second half usually do. A
    transient that dies slowly is cut where the mean of the rest is surest: with e_j the squared scatter of segment j
    the variance of the mean of segments d to m is about sum_(j >= d) e_j / (m - d)^2, least at some d (White's MSER);
    of noise alone it is least at 0, but for chance, which does not make it less by a seventh.
    """
    m = len(solution.scores)
    if m < FEWEST_SEGMENTS:
        return 0
    scale = np.linalg.norm(solution.a[1:n_own], axis=0) + 1e-300
    strays = np.max(np.linalg.norm(solution.scores[:, 1:n_own], axis=1) / scale, axis=1)
    half = m // 2
    wild = np.flatnonzero(strays[:half] > TRANSIENT * np.median(strays[half:]) + HOLD)
    if len(wild):
        return int(wild[-1]) + 1
    left = np.cumsum(strays[::-1] ** 2)[::-1]
    variance = left[:half] / (m - np.arange(half)) ** 2
    best = int(np.argmin(variance))
    return best if np.sqrt(variance[0]) > HOLD / m and variance[best] < SURER * variance[0] else 0
