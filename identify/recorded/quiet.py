"""What stood at the place of a tone before the tone began.

A background is part of every record; while a tone is on, a line of the background at the tone's own frequency cannot be
told from it. Before the tone it can. A line at n f1 comes from the fundamental's own period and keeps its angle against
it, so the phasor b that was there in the quiet stretch, when the fundamental's angle was q, is

    b exp(j n (p - q))

when that angle is p. Voltage and current of the background obey the device and the network by themselves; what is left
when both are taken off is the answer to the tone alone. A line that is no multiple of f1 keeps no angle against
anything: it spoils the tone, and by how much is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .background import background_lines
from .fundamental import HearingError, found_frame, fundamental, known_frame
from .line_fit import Line, Waveforms, project, solve
from .tones import Doubt, Heard, segment_steps

LEAST_S = 0.1
"""A shorter stretch tells nothing of what was there before."""

SAME_BIN = 0.2
"""Part of a bin of the quiet stretch within which a line is the same."""

SIGNIFICANT = 3.0
"""A line is there where it is larger than this many of its standard deviations."""

LOCKED = 0.25
"""A tone is at a multiple of f1 where it stays with it to this part of a cycle over its window."""

FAINT = 5e-3
"""A line this much smaller than the tone may as well be the recorder's rounding, which a tone disperses."""

SPOILS = 0.01
"""A line of the background at the place of a tone, relative to the tone, that spoils it."""

UNCHANGED = 0.2
"""A line at the tone's place that changes by less than this part of itself when the tone begins: was it on already?"""


class Quiet(NamedTuple):
    """Lines of a stretch without tones.

    Attributes
    ----------
    lines : tuple of Line
        Multiples of the fundamental, and others.
    f1_hz, phi1 : float
        Frequency (Hz) and angle (rad) of the fundamental voltage at the time the phasors refer to.
    a : (k, 2) complex
        Phasors of v and i (V, A).
    scatter : (m, k, 2) complex
        What each segment says beyond that.
    freedom : (k,) float
        Degrees of freedom of the scatter.
    window_s : float
        Length of the stretch.
    """

    lines: tuple[Line, ...]
    f1_hz: float
    phi1: float
    a: np.ndarray
    scatter: np.ndarray
    freedom: np.ndarray
    window_s: float

    def at(self, f_hz: float, heard: Heard) -> int | None:
        """Number of the line at a place of a record; None where there is none.

        The place of a multiple of f1 is known exactly, that of another line to a part of a bin of this stretch.
        """
        for number, line in enumerate(self.lines[1:], 1):
            apart = abs(line.at(self.f1_hz) - self.f1_hz - (f_hz - heard.f1_hz))
            if apart < 1.0 / heard.window_s + (SAME_BIN / self.window_s if line.offset_hz != 0.0 else 0.0):
                return number
        return None

    def is_there(self, number: int) -> bool:
        """Whether a line stands above what its segments scatter by, in voltage or current."""
        m = len(self.scatter)
        spread = np.sqrt(np.sum(np.abs(self.scatter[:, number]) ** 2, axis=0) / (m * max(self.freedom[number], 1.0)))
        return bool(np.any(np.abs(self.a[number]) > SIGNIFICANT * spread))


def quiet_lines(
    waveforms: Waveforms, start: int, stop: int, heard: Sequence[Heard], f1_hz: float | None
) -> Quiet | None:
    """Lines of samples ``start`` to ``stop``, in which no tone is on; None where that is too short to tell.

    Every multiple of f1 at which a tone of ``heard`` or its mirror stands is among them, however faint it is.
    ``f1_hz`` is the fundamental where it is known (Hz).
    """
    if (stop - start) * waveforms.dt_s < LEAST_S:
        return None
    try:
        first_f1 = fundamental(waveforms, start, stop) if f1_hz is None else f1_hz
        own = [Line(1, 0.0)]
        own += [Line(order, 0.0) for order in _orders(heard)]
        lines = own + background_lines(waveforms, start, stop, own, first_f1)
        at_hz = np.array([line.at(first_f1) for line in lines])
        segments = project(waveforms, start, stop, at_hz, segment_steps(stop - start, waveforms.dt_s))
        frame = known_frame(segments, f1_hz) if f1_hz else found_frame(segments, lines, first_f1, 0)
        solution = solve(segments, lines, frame.phases)
    except (HearingError, np.linalg.LinAlgError, ValueError):
        return None
    return Quiet(
        tuple(lines),
        frame.f1_hz,
        float(np.angle(solution.a[0, 0])),
        solution.a,
        solution.scores,
        solution.freedom,
        (stop - start) * waveforms.dt_s,
    )


def _orders(heard: Sequence[Heard]) -> list[int]:
    """Multiples of f1 at which tones or their mirrors stand."""
    places = [(place, each) for each in heard for place in _places(each)]
    return sorted({round(place / each.f1_hz) for place, each in places if _is_multiple(place, each)} - {1})


def _places(heard: Heard) -> tuple[float, float]:
    return heard.f_hz, 2.0 * heard.f1_hz - heard.f_hz


def _is_multiple(place: float, heard: Heard) -> bool:
    return abs(place - round(place / heard.f1_hz) * heard.f1_hz) * heard.window_s < LOCKED


def without_background(heard: Heard, quiet: Quiet) -> Heard:
    """A tone without what the quiet stretch has at its place and at its mirror's, or with a doubt about it."""
    found = [(side, place, quiet.at(place, heard)) for side, place in enumerate(_places(heard))]
    heard = heard._replace(place_known=True)
    for side, place, number in found:
        if number is not None and quiet.is_there(number):
            heard = _taken_off(heard, quiet, side, place, number)
    return heard


def _taken_off(heard: Heard, quiet: Quiet, side: int, place: float, number: int) -> Heard:
    """The tone without a line that was there before, with its uncertainty; a faint one only widens the region."""
    line = quiet.lines[number]
    there = quiet.a[number] * np.exp(1j * line.order * (heard.phi1 - quiet.phi1))
    size, share = abs(there[0]), float(abs(there[0]) / np.linalg.norm(heard.v))
    if line.offset_hz != 0.0 or not _is_multiple(place, heard):
        return heard if share < SPOILS else _spoiled(heard, size, place, share, "it is no multiple of f1")
    if side == 0 and share > SPOILS and abs(heard.v[0] - there[0]) < UNCHANGED * size:
        return _spoiled(heard, size, place, share, "it hardly changes when the tone begins")
    if np.all(np.abs(there) < FAINT * np.linalg.norm([heard.v, heard.i], axis=1)):
        return _with_scatter(heard, there[None, :], side, 1.0, heard.freedom)
    scatter = quiet.scatter[:, number] * np.exp(1j * line.order * (heard.phi1 - quiet.phi1))
    freedom = float(quiet.freedom[number])
    heard = _with_scatter(heard, scatter, side, freedom, min(heard.freedom, freedom))
    off = np.where(np.arange(2) == side, 1.0, 0.0)
    said = f"a line of {size:.3g} V at {place:.6g} Hz was there before the tone ({share:.2g} of it): taken off"
    return heard._replace(v=heard.v - off * there[0], i=heard.i - off * there[1], notes=(*heard.notes, said))


def _with_scatter(heard: Heard, more: np.ndarray, side: int, freedom: float, left: float) -> Heard:
    """A tone with further scatter (n, 2) of v and i at one of its places; ``left`` degrees of freedom remain.

    The covariance of a scatter s of m rows with nu degrees of freedom is s^H s / (m nu). The covariances of both add
    up where the rows are scaled so that each gives its own when all are divided by (m + n) times what remains.
    """
    m, n = len(heard.v_scatter), len(more)
    common = (m + n) * left
    beside = np.zeros((2, n, 2), dtype=complex)
    beside[:, :, side] = more.T * np.sqrt(common / (n * freedom))
    mine = np.sqrt(common / (m * heard.freedom))
    v, i = (np.concatenate([mine * x, y]) for x, y in zip((heard.v_scatter, heard.i_scatter), beside, strict=True))
    return heard._replace(v_scatter=v, i_scatter=i, freedom=left)


def _spoiled(heard: Heard, size: float, place: float, share: float, why: str) -> Heard:
    reason = (
        f"a line of {size:.3g} V at {place:.6g} Hz was there before the tone ({share:.1%} of it), and {why}: choose a "
        "frequency beside it"
    )
    return heard._replace(doubt=Doubt("noisy", reason))
