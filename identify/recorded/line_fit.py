"""Joint least squares of many lines over a long record, in one pass and bounded memory.

A record is cut into short segments; each is projected onto exponentials near its lines, and what is left of it are a
few numbers per segment. Everything after that (solving for all lines at once, refining frequencies, following a
drifting fundamental, the scatter of the segments) works on those numbers, exactly: a line of any frequency seen through
an exponential of another is a Dirichlet kernel.

Derivation. Let E (n, l) be the exponentials of one segment of n samples, time zero at its centre, and x_m the samples
of segment m. `project` keeps z_m = E^H x_m. Line k has phasor a_k at the centre of the record, angle theta_mk and
angular speed w_mk in segment m, so that the record is

    x_m = sum_k a_k exp(j theta_mk) e_k + noise,     e_k = exp(j w_mk tau), tau from the centre of the segment.

Within the span of E the squared error of segment m is ||P (x_m - sum_k a_k exp(j theta_mk) e_k)||^2 with the projector
P = E W E^H, W = (E^H E)^+. With the kernel K_lk = E_l^H e_k, a real Dirichlet sum because tau is symmetric, setting its
derivative by conj(a_k), summed over m, to zero gives the normal equations

    sum_j S_kj a_j = sum_m h_mk,    h_mk = exp(-j theta_mk) (K^T W z_m)_k,
    S_kj = sum_m exp(-j theta_mk) G_kj exp(j theta_mj),    G = K^T W K.

Where the frequencies are those of E, P e_k = e_k and this is least squares over all samples, to the last digit. What
segment m says beyond the solution is r_mk = h_mk - sum_j exp(-j theta_mk) G_kj exp(j theta_mj) a_j; it sums to zero
over m. Segment m alone would move the solution by S^-1 r_m, the mean of M such scores M S^-1 r_m has the covariance
sum_m score score^H / (M nu). In white noise E[r_m r_m^H] = G_m - G_m S^-1 G_m: each line that was solved for takes away
from a segment what it cannot tell from line k. With S nearly diagonal that leaves nu_k of M degrees of freedom,

    nu_k = M - sum_j G_kj^2 / (G_kk G_jj),

which is M - 1 for a line that stands alone.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ...plant.errors import SeqsweepError
from ...plant.protocol import Record

RANK = 1e-12
"""Directions of a segment's exponentials weaker than this are not told apart within one segment."""

WORST_CONDITION = 1e10
"""Of the normal equations, scaled: beyond it two lines are one."""

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
    """A line at ``order * f1 + offset_hz``: (1, 0) the fundamental, (0, f) a tone, (2, -f) its mirror.

    With ``power`` 1 its amplitude rises in proportion to time (from segment to segment): the derivative of a line by
    its angular frequency, but for a factor of j.
    """

    order: int
    offset_hz: float
    power: int = 0

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
    own : (m, k, 2) complex
        What each segment has of a line beyond ``a``, the other lines taken as solved.
    freedom : (k,) float
        Degrees of freedom of the scatter (nu in the derivation above).
    """

    a: np.ndarray
    scores: np.ndarray
    own: np.ndarray
    freedom: np.ndarray

    def followed(self, number: int) -> np.ndarray:
        """Phasor (m, 2) of one line in every segment, the others taken as solved; its mean is about ``a``."""
        return np.asarray(self.a[number] + self.own[:, number])


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
    """Least squares of all ``lines`` over all segments; the equations are at the head of this module.

    Raises
    ------
    numpy.linalg.LinAlgError
        If two lines cannot be told apart in the whole record.
    """
    m = len(segments.t_s)
    turn, kernel = _turns(segments, lines, phases), _kernel(segments, lines, phases)
    weighted = np.einsum("lj,mjk->mlk", _weight(segments), kernel)
    gram = np.einsum("mlk,mlj->mkj", weighted, kernel)  # G: one for all segments where no frequency changes
    heard = _applied(weighted, segments.z) * turn.conj()[:, :, None]
    total = _sum_over_segments(gram, turn)
    scale = np.sqrt(np.real(np.diagonal(total)))
    scaled = total / np.outer(scale, scale)
    if not np.linalg.cond(scaled) <= WORST_CONDITION:
        raise np.linalg.LinAlgError("two lines are closer than the record can tell apart")
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
    a = np.einsum("kj,jc->kc", inverse, heard.sum(axis=0))
    left = heard - _applied(gram, turn[:, :, None] * a) * turn.conj()[:, :, None]
    own = left / _positive(np.diagonal(gram, axis1=1, axis2=2) * np.abs(turn) ** 2)[:, :, None]
    return Solution(a, m * np.einsum("kj,mjc->mkc", inverse, left), own, m - _shared(gram))


def _applied(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``matrix`` (m or 1, a, b) transposed, times x (m, a, c): (m, b, c)."""
    if len(matrix) == 1:
        return np.asarray(np.einsum("ab,mac->mbc", matrix[0], x))
    return np.asarray(np.einsum("mab,mac->mbc", matrix, x))


def _sum_over_segments(gram: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """S (k, k): the Gram matrices of all segments, turned to one time."""
    if len(gram) == 1:
        return np.asarray(gram[0] * np.einsum("mk,mj->kj", turn.conj(), turn))
    return np.asarray(sum(each * np.outer(t.conj(), t) for each, t in zip(gram, turn, strict=True)))


def _shared(gram: np.ndarray) -> np.ndarray:
    """Degrees of freedom (k,) that all lines take from the scatter of each."""
    mean = gram.mean(axis=0)
    own = _positive(np.diagonal(mean))
    return np.asarray(np.sum(mean**2 / np.outer(own, own), axis=1))


def _positive(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 1e-300)


def _speeds(lines: list[Line], phases: Phases) -> np.ndarray:
    """Angular frequency (m, k) of every line in every segment; (1, k) where the fundamental keeps its own."""
    orders, offsets = np.array([line.order for line in lines]), np.array([line.offset_hz for line in lines])
    speed = phases.speed[:1] if np.ptp(phases.speed) == 0.0 else phases.speed
    return np.asarray(np.outer(speed, orders) + 2.0 * np.pi * offsets)


def _kernel(segments: Segments, lines: list[Line], phases: Phases) -> np.ndarray:
    """K: what a unit line (m or 1, k) leaves in the projections: (m or 1, l, k) float."""
    apart = _speeds(lines, phases)[:, None, :] - 2.0 * np.pi * segments.lines_hz[None, :, None]
    return dirichlet(0.5 * apart * segments.dt_s, segments.n_steps)


def dirichlet(half_angle: np.ndarray, n: int) -> np.ndarray:
    """``sum_k exp(2j x (k - (n - 1)/2))`` = sin(n x) / sin(x)."""
    small = np.abs(np.sin(half_angle)) < 1e-12
    safe = np.where(small, 0.5, half_angle)
    return np.asarray(np.where(small, float(n) * np.cos((n - 1) * half_angle), np.sin(n * safe) / np.sin(safe)))


def _weight(segments: Segments) -> np.ndarray:
    """W (l, l): (E^H E)^+, whose entries are Dirichlet kernels too."""
    own = np.subtract.outer(segments.lines_hz, segments.lines_hz) * np.pi * segments.dt_s
    return np.asarray(np.linalg.pinv(dirichlet(own, segments.n_steps), rcond=RANK, hermitian=True))


def _turns(segments: Segments, lines: list[Line], phases: Phases) -> np.ndarray:
    """exp(j theta) (m, k) of every line at the centre of every segment, times the power of time that it has (s)."""
    offsets = np.array([line.offset_hz for line in lines])
    orders = np.array([line.order for line in lines])
    angle = np.outer(phases.angle, orders) + 2.0 * np.pi * ((np.outer(segments.t_s, offsets)) % 1.0)
    return np.asarray(np.exp(1j * angle) * segments.t_s[:, None] ** np.array([line.power for line in lines]))
