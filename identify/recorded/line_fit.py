"""Joint least squares of many lines over a long record, in one pass and bounded memory.

A record is cut into short segments; each is projected onto exponentials near its lines, and what is left of it are a
few numbers per segment. Everything after that (solving for all lines at once, refining frequencies, following a
drifting fundamental, the scatter of the segments) works on those numbers, exactly: a line of any frequency seen through
an exponential of another is a Dirichlet kernel.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ...plant.errors import SeqsweepError
from ...plant.protocol import Record

RANK = 1e-12
"""Directions of a segment's exponentials weaker than this are not told apart within one segment."""

PORTION = 1 << 16
"""Samples in work at a time."""


class Waveforms(Protocol):
    """A long record, any stretch of it when asked."""

    @property
    def n_samples(self) -> int: ...
    @property
    def t0_s(self) -> float: ...
    @property
    def dt_s(self) -> float: ...
    def record(self, start: int, stop: int) -> Record: ...


class Line(NamedTuple):
    """A line at ``order * f1 + offset_hz``: (1, 0) the fundamental, (0, f) a tone, (2, -f) its mirror."""

    order: int
    offset_hz: float

    def at(self, f1_hz: float) -> float:
        """Its signed frequency (Hz)."""
        return self.order * f1_hz + self.offset_hz


class Segments(NamedTuple):
    """What is left of a record.

    Attributes
    ----------
    z : (m, l, 2) complex
        Sums of v and i (V, A) against the conjugate exponentials, per segment; phase zero at its centre.
    t_s : (m,) float
        Centres of the segments, from ``centre_s`` on (s).
    lines_hz : (l,) float
        Frequencies of the exponentials.
    n_steps : int
        Samples of a segment.
    dt_s : float
        Sampling step (s).
    centre_s : float
        Time zero of ``t_s``, in the time of the record (s).
    dropped : int
        Segments left out because a sample was missing.
    """

    z: np.ndarray
    t_s: np.ndarray
    lines_hz: np.ndarray
    n_steps: int
    dt_s: float
    centre_s: float
    dropped: int


class Phases(NamedTuple):
    """Angle and angular frequency of the fundamental at the centre of every segment (rad, rad/s), both (m,)."""

    angle: np.ndarray
    speed: np.ndarray


class Solution(NamedTuple):
    """All lines at once.

    Attributes
    ----------
    a : (k, 2) complex
        Phasors of v and i (V, A), phase zero at the centre of the record.
    scores : (m, k, 2) complex
        How far each segment alone would move ``a``; zero in the mean. Their scatter is its uncertainty.
    """

    a: np.ndarray
    scores: np.ndarray


def project(waveforms: Waveforms, start: int, stop: int, lines_hz: np.ndarray, n_steps: int) -> Segments:
    """Cut samples ``start`` to ``stop`` into segments of ``n_steps`` and project each onto ``lines_hz`` (l,).

    Samples beyond the last whole segment are left out, and so are segments with a missing sample.

    Raises
    ------
    SeqsweepError
        If fewer than two whole segments remain.
    """
    n_segments = (stop - start) // n_steps
    local_s = (np.arange(n_steps) - 0.5 * (n_steps - 1)) * waveforms.dt_s
    basis = np.exp(-2j * np.pi * np.outer(lines_hz, local_s))
    together = max(1, PORTION // n_steps)
    z = np.empty((n_segments, len(lines_hz), 2), dtype=complex)
    for first in range(0, n_segments, together):
        last = min(first + together, n_segments)
        record = waveforms.record(start + first * n_steps, start + last * n_steps)
        for channel, x in enumerate((record.v, record.i)):
            z[first:last, :, channel] = np.einsum("ln,mn->ml", basis, x.reshape(last - first, n_steps))
    begin_s = waveforms.t0_s + start * waveforms.dt_s
    centre_s = begin_s + 0.5 * (n_segments * n_steps - 1) * waveforms.dt_s
    t_s = (np.arange(n_segments) - 0.5 * (n_segments - 1)) * n_steps * waveforms.dt_s
    whole = np.all(np.isfinite(z), axis=(1, 2))
    if np.count_nonzero(whole) < 2:
        raise SeqsweepError(f"{np.count_nonzero(whole)} whole segments of {n_steps} samples; two are needed at least")
    dropped = int(np.count_nonzero(~whole))
    return Segments(z[whole], t_s[whole], np.asarray(lines_hz), n_steps, waveforms.dt_s, centre_s, dropped)


def from_segment(segments: Segments, first: int) -> Segments:
    """The same without the segments before ``first``; time zero stays where it was."""
    return segments._replace(z=segments.z[first:], t_s=segments.t_s[first:])


def constant(segments: Segments, f1_hz: float) -> Phases:
    """A fundamental of constant frequency, phase zero at the centre."""
    speed = 2.0 * np.pi * f1_hz
    return Phases(speed * segments.t_s, np.full(len(segments.t_s), speed))


def solve(segments: Segments, lines: list[Line], phases: Phases) -> Solution:
    """Least squares of all ``lines`` over all segments.

    Raises
    ------
    numpy.linalg.LinAlgError
        If two lines cannot be told apart in the whole record.
    """
    turn, model = _model(segments, lines, phases)
    heard = np.einsum("mlk,mlc->mkc", model, segments.z) * turn.conj()[:, :, None]
    kernel = _kernel(segments, lines, phases)
    gram = np.einsum("mlk,mlj->mkj", model, kernel) * turn.conj()[:, :, None] * turn[:, None, :]
    total = gram.sum(axis=0)
    scale = np.sqrt(np.real(np.diagonal(total)))
    scaled = total / np.outer(scale, scale)
    if np.linalg.cond(scaled) > 1e10:
        raise np.linalg.LinAlgError("two lines are closer than the record can tell apart")
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
    a = np.einsum("kj,jc->kc", inverse, heard.sum(axis=0))
    left = heard - np.einsum("mkj,jc->mkc", gram, a)
    return Solution(a, len(segments.t_s) * np.einsum("kj,mjc->mkc", inverse, left))


def follow(segments: Segments, lines: list[Line], phases: Phases, solution: Solution, number: int) -> np.ndarray:
    """Phasor (m, 2) of one line in every segment, the others taken as solved; its mean is about ``solution.a``."""
    turn, model = _model(segments, lines, phases)
    kernel = _kernel(segments, lines, phases)
    others = np.einsum("mlk,mk,kc->mlc", kernel, turn, _without(solution.a, number))
    weight = np.einsum("ml,ml->m", model[:, :, number], kernel[:, :, number])
    mine = np.einsum("ml,mlc->mc", model[:, :, number], segments.z - others) / weight[:, None]
    return np.asarray(mine * turn.conj()[:, number, None])


def _without(a: np.ndarray, number: int) -> np.ndarray:
    return np.where((np.arange(len(a)) == number)[:, None], 0.0, a)


def _speeds(lines: list[Line], phases: Phases) -> np.ndarray:
    """Angular frequency (m, k) of every line in every segment."""
    orders, offsets = np.array([line.order for line in lines]), np.array([line.offset_hz for line in lines])
    return np.asarray(np.outer(phases.speed, orders) + 2.0 * np.pi * offsets)


def _kernel(segments: Segments, lines: list[Line], phases: Phases) -> np.ndarray:
    """What a unit line (m, k) leaves in the projections: (m, l, k) float."""
    apart = _speeds(lines, phases)[:, None, :] - 2.0 * np.pi * segments.lines_hz[None, :, None]
    return dirichlet(0.5 * apart * segments.dt_s, segments.n_steps)


def dirichlet(half_angle: np.ndarray, n: int) -> np.ndarray:
    """``sum_k exp(2j x (k - (n - 1)/2))`` = sin(n x) / sin(x)."""
    small = np.abs(np.sin(half_angle)) < 1e-12
    safe = np.where(small, 0.5, half_angle)
    return np.asarray(np.where(small, float(n) * np.cos((n - 1) * half_angle), np.sin(n * safe) / np.sin(safe)))


def _model(segments: Segments, lines: list[Line], phases: Phases) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (m, k) of every line to the centre of every segment, and what to weigh projections with (m, l, k)."""
    offsets = np.array([line.offset_hz for line in lines])
    orders = np.array([line.order for line in lines])
    angle = np.outer(phases.angle, orders) + 2.0 * np.pi * ((np.outer(segments.t_s, offsets)) % 1.0)
    own = np.subtract.outer(segments.lines_hz, segments.lines_hz) * np.pi * segments.dt_s
    weight = np.linalg.pinv(dirichlet(own, segments.n_steps), rcond=RANK, hermitian=True)
    return np.exp(1j * angle), np.einsum("lj,mjk->mlk", weight, _kernel(segments, lines, phases))
