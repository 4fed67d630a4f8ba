"""The grid's impedance as seen from the PCC, from one record while the device runs.

A known current is driven into the PCC; what of it the device does not take flows into the grid:

    i_grid = i_injected - i,        V(f) = Z_grid(f) I_grid(f) at every line but those of the grid's own voltage

A passive grid does not couple sequences, so every signed line f, the mirrors among them, is an equation of
its own, Z_grid(f) = R + 2j pi f L, and one experiment is enough. Nothing is asked of the device: it may be
nonlinear, and need not have come to rest.

Between the injected lines the window holds silent ones. They tell the noise: its power at every line, which
weighs the fit and gives the standard errors, and its correlation with itself, which would pull a fit on noisy
currents towards zero (errors in variables) and is taken off. Multiples of f1, where the grid's own voltages
are, are left out. What a finite window leaves of a transient in an R-L grid is a straight line over f, and is
estimated along.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..plant.errors import SeqsweepError
from ..plant.protocol import Injection, Record
from .fourier import rotation

NEIGHBOURS = 16
"""Silent lines from which the noise at an injected line is taken: the nearest."""

DISTURBED = 15.0
"""A silent line with this many times the usual noise power of its neighbours holds something else than noise."""

ROUNDS = 8
"""Rounds of weighing, fitting and estimating the transient; the last digits stand after four."""

COHERENT = 1e-6
"""Largest part of a cycle by which a window may miss whole cycles."""

SHORTEST = 0.5
"""A record is cut to the longest coherent window, down to this part of it."""

UNLIKELY = 1e-3
"""Probability below which the residual is not put down to noise."""

NOTEWORTHY = 0.01
"""Misfit, relative, up to which a grid still counts as R-L: it is told from noise earlier than it matters."""


class GridImpedanceError(SeqsweepError):
    """A record from which the grid's impedance cannot be told, with the way out."""


@dataclass(frozen=True, slots=True)
class GridImpedance:
    """R and L of a grid, and what they were fitted to.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    r_ohm, l_h : float
        Resistance (ohm) and inductance (H).
    r_std_ohm, l_std_h : float
        Their standard errors; the two are not correlated.
    f_hz : (n,) float
        Signed lines (Hz), ascending.
    z : (n,) complex
        Impedance at each line by itself (ohm).
    z_std : (n,) float
        Standard deviation of the complex ``z`` (ohm): half its square in the real and in the imaginary part,
        which are not correlated.
    misfit : float
        What of the residual voltage noise does not explain, relative to the voltage at the lines.
    p_value : float
        Probability of a residual as large as this if the grid is R-L and all else is noise.
    window_s : float
        Length of the window (s).
    """

    f1_hz: float
    r_ohm: float
    l_h: float
    r_std_ohm: float
    l_std_h: float
    f_hz: np.ndarray
    z: np.ndarray
    z_std: np.ndarray
    misfit: float
    p_value: float
    window_s: float

    @property
    def x_ohm(self) -> float:
        """Reactance at f1 (ohm)."""
        return 2.0 * np.pi * self.f1_hz * self.l_h

    @property
    def x_std_ohm(self) -> float:
        """Standard error of the reactance at f1 (ohm)."""
        return 2.0 * np.pi * self.f1_hz * self.l_std_h

    @property
    def is_rl(self) -> bool:
        """Whether one R and one L explain all lines."""
        return self.p_value >= UNLIKELY or self.misfit <= NOTEWORTHY

    def fitted(self, f_hz: np.ndarray) -> np.ndarray:
        """R + 2j pi f L at signed frequencies (Hz)."""
        return self.r_ohm + 2j * np.pi * np.asarray(f_hz) * self.l_h


class _Lines(NamedTuple):
    """Phasors (V, A) of the lines of a window that count, ascending in frequency, f1's multiples left out."""

    f_hz: np.ndarray
    v: np.ndarray
    i: np.ndarray
    injected: np.ndarray


class _Fit(NamedTuple):
    """R (ohm), L (H), what a transient leaves at every line (V), and the noise power at the injected ones (V^2)."""

    r_ohm: float
    l_h: float
    transient: np.ndarray
    noise: np.ndarray


def identify_grid(record: Record, injection: Injection) -> GridImpedance:
    """R and L of the grid from a record of the PCC under a known shunt injection.

    Parameters
    ----------
    record : Record
        v and i of the PCC, current into the device; an undisturbed fundamental may be there, and noise.
    injection : Injection
        The current driven into the PCC while the record was made: its tones in the record's time.

    Raises
    ------
    GridImpedanceError
        If the injection is no shunt current, or the record is not fit for its lines (`grid_impedance`).
    """
    if injection.kind != "shunt_current":
        raise GridImpedanceError(
            f"the grid is identified with an injection of kind 'shunt_current'; this one is {injection.kind!r}, "
            "which stands between the PCC and the grid"
        )
    lines_hz = np.array([tone.f_hz for tone in injection.tones])
    return grid_impedance(record.v, injected_current(record, injection) - record.i, record.dt_s, record.f1_hz, lines_hz)


def injected_current(record: Record, injection: Injection) -> np.ndarray:
    """The current (n,) that the tones of an injection drive into the PCC, at the samples of a record (A)."""
    n = len(record.v)
    current = np.zeros(n, complex)
    for tone in injection.tones:
        turned = np.conj(rotation(tone.f_hz, record.t0_s, record.dt_s, n))
        current += tone.amplitude * np.exp(1j * tone.phase_rad) * turned
    return current


def grid_impedance(v: np.ndarray, i_grid: np.ndarray, dt_s: float, f1_hz: float, lines_hz: np.ndarray) -> GridImpedance:
    """R and L of the grid from voltage and current at the PCC.

    Parameters
    ----------
    v, i_grid : (n,) complex
        Space vectors of the PCC's voltage (V) and of the current *into the grid* (A), phase peak; for
        recordings that measure it, the current's own channel.
    dt_s, f1_hz : float
        Sampling step (s) and fundamental frequency (Hz).
    lines_hz : (m,) float
        Signed frequencies that were injected (Hz), in whole cycles per window as f1 is; the record is cut
        to the longest window that holds whole cycles of all.

    Returns
    -------
    GridImpedance
        With every line's own impedance.

    Raises
    ------
    GridImpedanceError
        If no such window exists, or there is no line, or too few silent lines beside them.

    Notes
    -----
    With weights 1/s^2(f), s^2 the noise power of V - Z I among the silent neighbours, R and L are

        R = sum Re<conj(I) V> / s^2 / sum <|I|^2> / s^2,    L = sum w Im<conj(I) V> / s^2 / sum w <w |I|^2> / s^2

    where <> is the product at the line less its mean over the silent neighbours, which is the noise's own. Re and
    Im do not mix, so R and L are not correlated.
    """
    if len(v) != len(i_grid) or not (np.all(np.isfinite(v)) and np.all(np.isfinite(i_grid))):
        raise GridImpedanceError(f"{len(v)} and {len(i_grid)} samples of v and i_grid; as many finite ones are needed")
    n = _coherent_samples(len(v), dt_s, f1_hz, lines_hz)
    lines = _lines(v[:n], i_grid[:n], dt_s, f1_hz, lines_hz)
    neighbours = _silent_neighbours(lines)
    fit = _fit(lines, neighbours)
    at = lines.injected
    w, current = 2.0 * np.pi * lines.f_hz[at], np.abs(lines.i[at]) ** 2
    misfit, p_value = _judge(lines, fit)
    r_std, l_std = (_standard_error(lines, neighbours, fit.noise, scale) for scale in (np.ones(len(w)), w))
    if p_value < UNLIKELY:  # what noise does not explain (a step's warping, another circuit) is an error as well
        w1 = 2.0 * np.pi * f1_hz
        unexplained = misfit * np.hypot(fit.r_ohm, w1 * fit.l_h)
        r_std, l_std = float(np.hypot(r_std, unexplained)), float(np.hypot(l_std, unexplained / w1))
    return GridImpedance(
        f1_hz=f1_hz,
        r_ohm=fit.r_ohm,
        l_h=fit.l_h,
        r_std_ohm=r_std,
        l_std_h=l_std,
        f_hz=lines.f_hz[at],
        z=(lines.v - fit.transient)[at] / lines.i[at],
        z_std=np.sqrt(fit.noise / current),
        misfit=misfit,
        p_value=p_value,
        window_s=n * dt_s,
    )


# From samples to lines


def _coherent_samples(n_samples: int, dt_s: float, f1_hz: float, lines_hz: np.ndarray) -> int:
    """Samples of the longest window with whole cycles of f1 and of every line."""
    if not len(lines_hz):
        raise GridImpedanceError("no line was injected; the grid shows itself only where a current is driven into it")
    whole = np.arange(n_samples, int(SHORTEST * n_samples), -1)
    for f_hz in np.unique([f1_hz, *np.abs(lines_hz)]):
        cycles = f_hz * dt_s * whole
        whole = whole[np.abs(cycles - np.round(cycles)) <= COHERENT]
        if not len(whole):
            raise GridImpedanceError(
                f"no window of {SHORTEST * n_samples * dt_s:g} to {n_samples * dt_s:g} s holds whole cycles of "
                f"f1 = {f1_hz:g} Hz and of all {len(lines_hz)} lines in steps of {dt_s:g} s: record at least one whole "
                "period of the injection, with a step that divides it"
            )
    return int(whole[0])


def _lines(v: np.ndarray, i: np.ndarray, dt_s: float, f1_hz: float, lines_hz: np.ndarray) -> _Lines:
    """Lines from the lowest to the highest injected one, without the multiples of f1."""
    n = len(v)
    cycles = np.round(np.fft.fftfreq(n, 1.0 / n)).astype(int)
    asked = np.round(lines_hz * n * dt_s).astype(int)
    own = round(f1_hz * n * dt_s)
    if 2 * np.max(np.abs(asked)) >= n:
        raise GridImpedanceError(
            f"a line at {np.max(np.abs(lines_hz)):g} Hz needs more than two samples per cycle; the step is {dt_s:g} s"
        )
    margin = min(own, 2 * NEIGHBOURS)
    kept = (cycles >= asked.min() - margin) & (cycles <= asked.max() + margin) & (cycles % own != 0)
    order = np.argsort(cycles[kept])
    f_hz, phasors_v, phasors_i = (x[kept][order] for x in (cycles / (n * dt_s), np.fft.fft(v) / n, np.fft.fft(i) / n))
    lines = _Lines(f_hz, phasors_v, phasors_i, np.isin(cycles[kept][order], asked))
    if not np.any(lines.injected):
        raise GridImpedanceError(
            f"every injected line is a multiple of f1 = {f1_hz:g} Hz, where the grid's own voltages are"
        )
    if np.sum(~lines.injected) < 2 * NEIGHBOURS:
        raise GridImpedanceError(
            f"a window of {n * dt_s:g} s has {np.sum(~lines.injected)} silent lines between {np.sum(lines.injected)} "
            f"injected ones; {2 * NEIGHBOURS} are needed to tell the noise: record two periods of the injection, or "
            "leave every second line out (odd = True)"
        )
    return lines


def _silent_neighbours(lines: _Lines) -> np.ndarray:
    """Indices (n_injected, NEIGHBOURS) of the silent lines nearest to every injected one, on both sides."""
    silent, injected = np.flatnonzero(~lines.injected), np.flatnonzero(lines.injected)
    first = np.searchsorted(silent, injected) - NEIGHBOURS // 2
    first = np.clip(first, 0, len(silent) - NEIGHBOURS)
    neighbours = silent[first[:, None] + np.arange(NEIGHBOURS)]
    power = np.abs(lines.i) ** 2
    if not np.sum(power[injected]) > np.sum(np.mean(power[neighbours], axis=1)):
        raise GridImpedanceError(
            "the current into the grid is no larger at the injected lines than beside them: the record does not hold "
            "the injection, or its lines are others"
        )
    return neighbours


# From lines to R and L


def _fit(lines: _Lines, neighbours: np.ndarray) -> _Fit:
    at, w, power = lines.injected, 2.0 * np.pi * lines.f_hz, np.abs(lines.i) ** 2
    transient, noise = np.zeros(len(w), complex), np.ones(len(neighbours))
    undisturbed = np.ones(neighbours.shape, bool)
    rounding = (np.finfo(float).eps * np.max(np.abs(lines.v))) ** 2
    for _ in range(ROUNDS):
        product, current, steep = (
            x[at] - np.mean(x[neighbours], axis=1, where=undisturbed)
            for x in (np.conj(lines.i) * (lines.v - transient), power, w * power)
        )
        r_ohm = float(np.sum(product.real / noise) / np.sum(current / noise))
        l_h = float(np.sum(w[at] * product.imag / noise) / np.sum(w[at] * steep / noise))
        rest = lines.v - (r_ohm + 1j * w * l_h) * lines.i
        scattered = np.abs(rest - transient)[neighbours] ** 2
        usual = np.median(scattered, axis=1, keepdims=True) / np.log(2.0)  # power is distributed exponentially
        undisturbed = scattered <= DISTURBED * usual
        transient = _transient(w, rest, np.unique(neighbours[undisturbed]))
        noise = np.mean(np.abs(rest - transient)[neighbours] ** 2, axis=1, where=undisturbed)
        noise = np.maximum(noise, rounding)
    return _Fit(r_ohm, l_h, transient, noise)


def _transient(w: np.ndarray, rest: np.ndarray, quiet: np.ndarray) -> np.ndarray:
    """What a transient leaves at every line (n,): a + j w b, fitted to the lines at the indices ``quiet``.

    Integrating L di/dt over the window leaves L (i(T) - i(0))/T at every line alike; summing samples
    instead of integrating leaves half a sample of the jump, which j w L turns into the second term.
    """
    basis = np.stack([np.ones(len(w), complex), 1j * w / np.max(np.abs(w))], 1)
    return basis @ np.linalg.lstsq(basis[quiet], rest[quiet], rcond=None)[0]


def _standard_error(lines: _Lines, neighbours: np.ndarray, noise: np.ndarray, scale: np.ndarray) -> float:
    """Standard error of R (scale 1) or L (scale w).

    The last factor is what weights taken from NEIGHBOURS lines cost: E[s^-4] / E[s^-2]^2 of the estimated
    noise power, and the bias of E[s^-2].
    """
    at = lines.injected
    power = np.abs(lines.i[at]) ** 2
    beside = np.mean(np.abs(lines.i[neighbours]) ** 2, axis=1)
    heard = power + beside * np.sum(at) / np.sum(~at)  # the means over the silent lines scatter, too
    signal = np.sum(scale**2 * (power - beside) / noise)
    variance = 0.5 * np.sum(scale**2 * heard / noise) / signal**2
    return float(np.sqrt(variance * NEIGHBOURS / (NEIGHBOURS - 2)))


def _judge(lines: _Lines, fit: _Fit) -> tuple[float, float]:
    """Relative misfit beyond the noise, and the probability that noise alone leaves such a residual."""
    from scipy.stats import f as f_distribution

    at = lines.injected
    z = fit.r_ohm + 2j * np.pi * lines.f_hz[at] * fit.l_h
    residual = np.abs((lines.v - fit.transient)[at] - z * lines.i[at]) ** 2
    excess = max(0.0, float(np.sum(residual - fit.noise))) / float(np.sum(np.abs(z * lines.i[at]) ** 2))
    ratio = np.mean(residual / fit.noise) * (NEIGHBOURS - 1) / NEIGHBOURS
    freedom = 2 * np.sum(at) - 2, 2 * np.sum(~at)
    return float(np.sqrt(excess)), float(f_distribution.sf(ratio, *freedom))
