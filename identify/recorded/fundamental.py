"""The fundamental of a record: its frequency, and its angle along the record where it wanders.

Nothing about it is taken from a header. What may be concluded from it is bounded by what stands next to it: a tone at a
distance d from f1 turns the fundamental's phasor by itself, d times a second. A following of f1 that is fast enough to
turn as well would take the tone for a wandering of f1 and leave little of it. So the following is slower than every
tone, and where that leaves nothing to follow with, it is said (`Frame.doubt`).
"""

from __future__ import annotations

from math import inf, pi
from typing import NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError
from .background import SPECTRUM_SAMPLES, interpolated
from .line_fit import Line, Phases, Segments, Solution, Waveforms, constant, solve

F1_BAND_HZ = (10.0, 1000.0)
"""From railways of 16.7 Hz to aircraft of 800 Hz."""

DRIFT = 3.0
"""The fundamental drifts where its angle strays this much more than its noise does."""

HOLD = 1e-4
"""A line is where it is said to be where its angle turns by less than this over the record (rad)."""

CLOSE_CYCLES = 4.0
"""A tone fewer cycles away from the fundamental than this pays for the fundamental's frequency being unknown."""

FEWEST_CYCLES = 1.0
"""With fewer cycles of |f - f1| in a record a tone and a wandering of f1 look the same."""

HIGHEST_DEGREE = 24


class HearingError(SeqsweepError):
    """A stretch in which the experiment cannot be heard, with the reason."""


class Frame(NamedTuple):
    """The rotating frame of a record.

    Attributes
    ----------
    phases : Phases
        Angle and speed of the fundamental in every segment.
    f1_hz, drift_hz : float
        Its mean frequency, and half the width of its wandering (Hz).
    cycles : float
        Of |f - f1| in the record, of the tone that is closest to f1; infinite where f1 is known.
    doubt : str
        Why tone and fundamental cannot be told apart; empty where they can.
    """

    phases: Phases
    f1_hz: float
    drift_hz: float
    cycles: float
    doubt: str = ""


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


def known_frame(segments: Segments, f1_hz: float) -> Frame:
    """The frame of a fundamental that is known exactly."""
    return Frame(constant(segments, f1_hz), f1_hz, 0.0, inf)


def found_frame(segments: Segments, lines: list[Line], f1_hz: float, n_tones: int) -> Frame:
    """Estimate the fundamental, which is the first of ``lines``, and follow it where it wanders.

    Lines 1 to 2 n_tones are the tones and their mirrors. The estimate is Gauss-Newton's: with f1 off by d the record
    holds a_1 exp(2j pi d t) exp(j w1 t), about a_1 (1 + 2j pi d t) exp(j w1 t). A line that rises with time, solved for
    together with all others, therefore finds c = 2j pi d a_1, and d = Im(c / a_1) / (2 pi), tones and harmonics being
    taken into account, however close they are.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the record is too short to tell the lines apart.
    """
    length_s = float(np.ptp(segments.t_s)) + segments.n_steps * segments.dt_s
    for _ in range(12):
        solution = solve(segments, [*lines, RISING], constant(segments, f1_hz))
        speed = float(np.imag(solution.a[-1, 0] / solution.a[0, 0]))
        f1_hz += speed / (2.0 * pi)
        if abs(speed) * length_s < 1e-9:
            break
    distance_hz = min((abs(line.at(f1_hz) - f1_hz) for line in lines[1 : 1 + 2 * n_tones]), default=inf)
    return _wandering(segments, lines, f1_hz, distance_hz * length_s)


RISING = Line(1, 0.0, 1)
"""What an error of f1 adds to a record."""


def with_unknown_frequency(lines: list[Line], frame: Frame) -> list[Line]:
    """The lines to solve for: next to a fundamental of estimated frequency the tone pays for the estimate."""
    return [*lines, RISING] if frame.cycles < CLOSE_CYCLES else lines


def _wandering(segments: Segments, lines: list[Line], f1_hz: float, cycles: float) -> Frame:
    """A constant frequency, or a smooth curve through the angles where they stray more than their noise does."""
    frame = Frame(constant(segments, f1_hz), f1_hz, 0.0, cycles)
    if cycles < FEWEST_CYCLES:
        return frame._replace(doubt=_too_few(cycles, f1_hz))
    angle = _angle(solve(segments, with_unknown_frequency(lines, frame), frame.phases))
    strays, noise = float(np.std(angle - np.polyval(np.polyfit(segments.t_s, angle, 1), segments.t_s))), _noise(angle)
    if not (strays > DRIFT * noise and strays > HOLD and len(angle) >= 12):
        return frame
    degree = min(HIGHEST_DEGREE, len(angle) // 3, int(0.5 * pi * min(cycles, 1e3)))
    if degree < 2:
        return frame._replace(doubt=_wanders_beside(cycles, strays))
    for _ in range(3):
        curve = _smooth(segments.t_s, angle, degree)
        speed = 2.0 * pi * f1_hz + np.asarray(curve.deriv()(segments.t_s))
        phases = Phases(2.0 * pi * f1_hz * segments.t_s + curve(segments.t_s), speed)
        angle = curve(segments.t_s) + _angle(solve(segments, lines, phases))
    left = float(np.std(angle - curve(segments.t_s)))
    doubt = _wanders_beside(cycles, left) if left > max(DRIFT * noise, HOLD) else ""
    return Frame(phases, float(np.mean(speed)) / (2.0 * pi), float(np.ptp(speed)) / (4.0 * pi), cycles, doubt)


def _too_few(cycles: float, f1_hz: float) -> str:
    return (
        f"{cycles:.2g} cycles of |f - f1| in the window: a tone that close to the fundamental looks like a wandering "
        f"of f1 = {f1_hz:.6g} Hz; record {FEWEST_CYCLES / cycles:.2g} times as long, or give --f1 where it is known "
        "exactly"
    )


def _wanders_beside(cycles: float, strays: float) -> str:
    return (
        f"the fundamental wanders (by {strays:.2g} rad), and with {cycles:.2g} cycles of |f - f1| in the window it "
        "cannot be followed closely without following the tone: record longer"
    )


def _angle(solution: Solution) -> np.ndarray:
    """Angle (m,) of the fundamental of the voltage in every segment against the first, turns counted (rad)."""
    phasors = solution.followed(0)[:, 0]
    return np.unwrap(np.angle(phasors * np.conj(phasors[0])))


def _noise(angle: np.ndarray) -> float:
    """Standard deviation of the noise on a smooth curve: a second difference of white noise has six times its variance,
    1 + 4 + 1, and next to nothing of the curve.
    """
    return float(np.std(np.diff(angle, 2)) / np.sqrt(6.0)) if len(angle) > 4 else inf


def _smooth(t_s: np.ndarray, angle: np.ndarray, highest: int) -> np.polynomial.Polynomial:
    """Polynomial of the degree that explains the angles best for its number of coefficients.

    With errors of unknown variance the likelihood of a fit of n angles that leaves the mean square s^2 has
    -2 log L = n log s^2 + const, and Schwarz's criterion adds log n for each of its p coefficients:
    BIC = n log s^2 + p log n. A tenth of the noise is added to s, so that rounding is not modelled. A polynomial of
    degree D over a length T turns at most D / (pi T) times a second in its middle (Chebyshev's of degree D is
    cos(D arccos x), whose phase there has the slope D per T / 2): ``highest`` keeps it below half of the tone's
    distance from f1.
    """
    n = len(t_s)
    floor = (0.1 * _noise(angle)) ** 2 + 1e-24
    candidates = [np.polynomial.Polynomial.fit(t_s, angle, degree) for degree in range(1, highest + 1)]
    scores = [n * np.log(np.mean((c(t_s) - angle) ** 2) + floor) + len(c.coef) * np.log(n) for c in candidates]
    return candidates[int(np.argmin(scores))]
