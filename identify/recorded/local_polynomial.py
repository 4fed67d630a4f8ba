"""2x2 from one broadband or transient record: the local polynomial method.

Seen from the rotating frame, spectra of v and i around a frequency are tied by the admittance there and by one smooth
transient: within a few dozen bins both are polynomials. Least squares over those bins gives the 2x2 of one record
without any steady state, and its residual the uncertainty (Pintelon and Schoukens, System Identification, 2nd ed.,
chapter 7).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..uncertainty import real_covariance, student_factor
from .background import line_basis
from .fundamental import HearingError, fundamental
from .line_fit import Line, Waveforms, constant, project, solve

DEGREE = 2
"""Of the polynomials."""

BINS = 12
"""Bins on either side of a frequency; the unknowns are 3 (DEGREE + 1) = 9 of them."""

MOST_SAMPLES = 1 << 22
"""Longest record whose spectrum is taken as a whole."""

EXCITED = 1e-2
"""A frequency is excited where the voltage around it has this part of its largest density, besides the fundamental."""


class Local(NamedTuple):
    """Admittances of one record.

    Attributes
    ----------
    distance_hz : (n,) float
        Distance of every point from the fundamental (Hz).
    y : (n, 2, 2) complex
        Admittance (S) in components (p at f, conjugate of n at 2 f1 - f).
    covariance : (n, 8, 8) float
        Over (re, im) of pp, pn, np, nn (S^2).
    cond : (n,) float
        Condition number of the regression.
    f1_hz, v1, i1
        Fundamental (Hz; V, A).
    window_s : float
        Length of the record.
    """

    distance_hz: np.ndarray
    y: np.ndarray
    covariance: np.ndarray
    cond: np.ndarray
    f1_hz: float
    v1: complex
    i1: complex
    window_s: float


def local_polynomials(waveforms: Waveforms, distances_hz: np.ndarray) -> Local:
    """Admittance at those of ``distances_hz`` (n,) from the fundamental that the record excites.

    Raises
    ------
    HearingError
        If the record is too long for its spectrum, too short, has missing samples, or no fundamental.
    """
    n = waveforms.n_samples
    if n > MOST_SAMPLES:
        raise HearingError(f"{n} samples; a broadband record of at most {MOST_SAMPLES} is analysed as a whole: cut it")
    record = waveforms.record(0, n)
    if not (np.all(np.isfinite(record.v)) and np.all(np.isfinite(record.i))):
        raise HearingError("a broadband record with missing samples cannot be used: cut it before or after the gap")
    f1_hz, v1, i1 = _fundamental(waveforms)
    t = waveforms.dt_s * (np.arange(n) - 0.5 * (n - 1))
    turn = np.exp(-1j * (2.0 * np.pi * f1_hz * t + np.angle(v1)))
    spectra = [np.fft.fft(x) / np.sqrt(n) for x in _rotating(record.v, record.i, turn)]
    resolution = 1.0 / (n * waveforms.dt_s)
    bins = np.rint(distances_hz / resolution).astype(int)
    usable = (np.abs(bins) > 2 * BINS) & (np.abs(bins) + BINS < n // 2)
    excited = _excited(spectra[0], spectra[1], bins, usable)
    fits = [_fit(spectra, k) for k in bins[excited]]
    y, covariance, cond = (np.array([fit[part] for fit in fits]) for part in range(3))
    return Local(bins[excited] * resolution, y, covariance, cond, f1_hz, v1, i1, n * waveforms.dt_s)


def _fundamental(waveforms: Waveforms) -> tuple[float, complex, complex]:
    """Frequency (Hz) and phasors (V, A) of the fundamental over the whole record."""
    n = waveforms.n_samples
    f1_hz = fundamental(waveforms, 0, n)
    n_steps = max(8, min(n // 24, round(0.1 / waveforms.dt_s)))
    lines = [Line(1, 0.0), Line(0, 0.0), Line(-1, 0.0)]
    try:
        segments = project(waveforms, 0, n, np.array([line.at(f1_hz) for line in lines]), n_steps)
        for _ in range(8):
            x = solve(segments, lines, constant(segments, f1_hz)).followed(0)[:, 0]
            slope = float(np.polyfit(segments.t_s, np.unwrap(np.angle(x * np.conj(x[0]))), 1)[0])
            f1_hz += slope / (2.0 * np.pi)
    except (ValueError, np.linalg.LinAlgError):
        raise HearingError("the record is too short: some periods of the fundamental are needed") from None
    record = waveforms.record(0, n)
    basis, inverse = line_basis((f1_hz, 0.0, -f1_hz), waveforms.dt_s, n)
    v1, i1 = (complex((inverse @ np.einsum("kn,n->k", basis.conj(), x))[0]) for x in (record.v, record.i))
    return f1_hz, v1, i1


def _rotating(v: np.ndarray, i: np.ndarray, turn: np.ndarray) -> list[np.ndarray]:
    """v, its conjugate, i, its conjugate in the frame of the fundamental, which is taken off."""
    turned = [x * turn for x in (v, i)]
    free = [x - np.mean(x) for x in turned]
    return [free[0], free[0].conj(), free[1], free[1].conj()]


def _excited(u1: np.ndarray, u2: np.ndarray, bins: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(n,) bool: where the weaker of the two voltage components is there at all."""
    around = np.arange(-BINS, BINS + 1)
    n = len(u1)
    density = np.array(
        [min(np.mean(np.abs(u[(k + around[around + k != 0]) % n]) ** 2) for u in (u1, u2)) ** 0.5 for k in bins]
    )
    strongest = np.max(density[usable], initial=0.0)
    return np.asarray(usable & (density > EXCITED * strongest) & (density > 0.0))


def _fit(spectra: list[np.ndarray], k0: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Y (2, 2) at bin ``k0``, its covariance (8, 8), and the condition number of the regression."""
    r = np.arange(-BINS, BINS + 1)
    r = r[k0 + r != 0]
    u1, u2, o1, o2 = (x[(k0 + r) % len(x)] for x in spectra)
    powers = (r / BINS)[:, None] ** np.arange(DEGREE + 1)
    regressor = np.concatenate([u1[:, None] * powers, u2[:, None] * powers, powers], axis=1)
    scale = np.linalg.norm(regressor, axis=0)
    inverse = np.linalg.pinv(regressor / scale) / scale[:, None]
    outputs = np.stack([o1, o2], axis=1)
    theta = inverse @ outputs
    freedom = len(r) - regressor.shape[1]
    left = outputs - regressor @ theta
    noise = np.einsum("ka,kb->ab", left, left.conj()) / freedom * student_factor(freedom)
    at = [0, DEGREE + 1]
    spread = inverse[at] @ inverse[at].conj().T
    gamma = np.einsum("ac,bd->abcd", noise, spread).reshape(4, 4)
    return theta[at].T, real_covariance(gamma), float(np.linalg.cond(regressor / scale))
