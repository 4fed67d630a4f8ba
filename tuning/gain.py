"""The gain k of the resonance damping control: the paper's formula, what it predicts, and the search for the truth.

The formula takes the whole device as seeing the reshaped voltage; a real one gives less. What it returns is a
starting value, to be confirmed by sweeping the device with damping in place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..plant.errors import SeqsweepError
from .crossings import Admittance, Crossing, bode_crossings, critical_crossing
from .grids.words import in_ohm
from .siso import Grid, SeriesRL, own_impedance

K_MAX = 2.0
"""Largest gain the search tries."""

WORTH_WHILE = 0.25
"""Part of its rate that a decay may lose, or must win, for half or double the gain."""

NOTCH_GAIN = 1.0
NOTCH_DAMPING = 0.01


@dataclass(frozen=True, slots=True)
class GainSearch:
    """The outcome of iterating k with a re-swept device.

    Attributes
    ----------
    k : float
        Smallest gain found that holds the required margin, or the one with the largest margin.
    margin_m : float
        Margin of the re-swept device at that gain.
    reached : bool
        Whether the required margin holds.
    trials : tuple of (float, float)
        Every (k, m) measured, in order.
    """

    k: float
    margin_m: float
    reached: bool
    trials: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class SignedSearch:
    """The outcome of a search for sign and size of k by the growth of the closed loop.

    Attributes
    ----------
    k : float
        The gain with the least growth.
    growth_per_s : float
        Largest growth rate of the closed loop with it (1/s); infinite where no gain could be judged.
    trials : tuple of (float, float)
        Every (k, growth) measured, in order.
    """

    k: float
    growth_per_s: float
    trials: tuple[tuple[float, float], ...]

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable with that gain."""
        return self.growth_per_s < 0.0


def search_signed(growth_at: Callable[[float], float], largest: float = 4.0) -> SignedSearch:
    """Sign and size of k by re-sweeps: both signs at one, then half and double of the better while that is worth it.

    Parameters
    ----------
    growth_at : callable
        k to the largest growth rate (1/s) of the re-swept closed loop; infinite where it could not be judged.
    largest : float
        Largest |k| tried.
    """
    trials = [(k, float(growth_at(k))) for k in (-1.0, 1.0)]
    best = min(trials, key=lambda trial: trial[1])
    if not np.isfinite(best[1]):
        return SignedSearch(*best, tuple(trials))
    for factor, sign in ((0.5, 1.0), (2.0, -1.0)):  # half may be a little slower, double must be a good deal faster
        while 0.1 <= abs(best[0] * factor) <= largest:
            trials.append((best[0] * factor, float(growth_at(best[0] * factor))))
            if not trials[-1][1] < best[1] + sign * WORTH_WHILE * max(-best[1], 0.0):
                break
            best = trials[-1]
    return SignedSearch(*best, tuple(trials))


class FirstGain(NamedTuple):
    """The gain by the formula.

    Attributes
    ----------
    k : float or None
        The gain; zero where none is due, None where none is proposed.
    f_r_hz : float or None
        Signed frequency of the component that damping control is set to (Hz).
    margin_m : float or None
        The m that it predicts; None if no crossing is left.
    refused : str
        Why none is proposed though the formula has one; empty otherwise.
    note : str
        Why damping control is not set to the resonance; empty where it is.
    """

    k: float | None
    f_r_hz: float | None = None
    margin_m: float | None = None
    refused: str = ""
    note: str = ""


def first_gain(
    admittance: Admittance, grid: Grid, m_now: float, m_required: float, f_r_hz: float, band_hz: tuple[float, float]
) -> FirstGain:
    """k by the formula, refused where damping control cannot be set so, or where it is predicted to make m no larger.

    Parameters
    ----------
    admittance : callable
        Frequencies (n,) in Hz to Ypn (n, 2, 2) in S, without damping.
    grid : Grid
        What k multiplies the R and L of.
    m_now, m_required : float
        Magnitude margin at the critical crossing, and the one that is asked for.
    f_r_hz : float
        Signed frequency of the resonance component the control is set to (Hz).
    band_hz : (float, float)
        Where crossings are looked for (Hz).
    """
    k = gain_for_margin(m_now, m_required)
    capacitive = why_capacitive(grid, f_r_hz) if k > 0.0 else ""
    if capacitive:
        return FirstGain(None, f_r_hz, refused=capacitive)
    after = predicted_crossing(admittance, grid, k, f_r_hz, band_hz)
    if k > 0.0 and after is not None and after.m <= m_now:
        worse = f"with the formula's k = {k:.3g}, set to {f_r_hz:.4g} Hz, m is predicted to go from {m_now:.3g} to "
        return FirstGain(None, f_r_hz, refused=f"{worse}{after.m:.3g}, at {after.f_hz:.4g} Hz")
    return FirstGain(k, f_r_hz, None if after is None else after.m)


def gain_for_margin(m_now: float, m_required: float) -> float:
    """k = 1 - |Yg| / (m |Y|) = 1 - m_now / m_required, clipped at zero; paper eq. 13.

    Raises
    ------
    SeqsweepError
        If the required margin is no number above 0.
    """
    if not 0.0 < m_required < np.inf:
        raise SeqsweepError(f"the required margin m is {m_required:g}; needed is a number above 0, such as 1.4")
    return max(0.0, 1.0 - m_now / m_required)


def predicted_crossing(
    admittance: Admittance, grid: Grid, k: float, f_r_hz: float, band_hz: tuple[float, float]
) -> Crossing | None:
    """Critical crossing of the predicted reshaped response; None if none is left above f1."""
    crossings = bode_crossings(reshaped(admittance, grid, k, f_r_hz), grid, *band_hz)
    return critical_crossing(crossings, grid.f1_hz)


def reshaped(admittance: Admittance, grid: Grid, k: float, f_r_hz: float) -> Admittance:
    """Admittance with damping control if the whole device saw the reshaped voltage; paper eq. 11, for the 2x2.

    Parameters
    ----------
    admittance : callable
        Frequencies (n,) in Hz to Ypn (n, 2, 2) in S, without damping.
    grid : Grid
        The grid the virtual impedance is taken from: k Z at the resonance, for a series R-L grid Rv = k R, Lv = k L.
    k : float
        Gain.
    f_r_hz : float
        Signed frequency of the resonance component the control is set to (Hz).

    Notes
    -----
    v_r = v + H_NF H_FB i_g with H_FB = -(Rv + j w_r Lv) and i_g = -i gives Y_re = (1 - Y C)^-1 Y. C is diagonal: k
    (R + j w_r L) H_NF at f, and the conjugate of its value at the mirror for the second component.
    """
    z_r = k * own_impedance(grid, f_r_hz)

    def with_damping(f_hz: np.ndarray) -> np.ndarray:
        y = admittance(f_hz)
        c = np.zeros_like(y)
        c[:, 0, 0] = z_r * notch(f_hz, grid.f1_hz)
        c[:, 1, 1] = np.conj(z_r * notch(2.0 * grid.f1_hz - np.asarray(f_hz), grid.f1_hz))
        return np.linalg.solve(np.eye(2) - y @ c, y)

    return with_damping


def notch(f_hz: np.ndarray, f1_hz: float) -> np.ndarray:
    """H_NF = (s^2 + w0^2) / (s^2 + 2 xi w0 s + w0^2) at s = 2j pi f (n,), complex; paper eq. 5 with w0 = w1."""
    x = np.asarray(f_hz, dtype=float) / f1_hz
    return NOTCH_GAIN * (1.0 - x**2) / (1.0 - x**2 + 2j * NOTCH_DAMPING * x)


def search_gain(
    margin_at: Callable[[float], float], m_required: float, k_start: float, *, max_trials: int = 12
) -> GainSearch:
    """Smallest k in 0 ... 2 whose *measured* margin is the required one, to 0.5 % above it.

    Parameters
    ----------
    margin_at : callable
        k to the margin of the device re-swept with damping; NaN where it could not be measured.
    m_required : float
        Required margin.
    k_start : float
        Starting value, from `gain_for_margin`.
    max_trials : int
        Most re-sweeps.

    Notes
    -----
    Secant steps inside a bracket, and steps outwards before there is one. Where the margin never holds, the best one
    measured is returned.
    """
    trials: list[tuple[float, float]] = []
    k = float(np.clip(k_start, 0.0, K_MAX))
    while len(trials) < max_trials:
        trials.append((k, float(margin_at(k))))
        proposal = _next_gain(sorted(trials), m_required)
        if proposal is None or any(abs(proposal - tried) < 1e-4 for tried, _ in trials):
            break
        k = proposal
    holding = [t for t in trials if t[1] >= m_required]
    measured = [t for t in trials if np.isfinite(t[1])]
    best = min(holding, default=max(measured, key=lambda t: t[1], default=(k, float("nan"))))
    return GainSearch(best[0], best[1], bool(holding), tuple(trials))


def _next_gain(trials: list[tuple[float, float]], required: float) -> float | None:
    """The next gain to try, from the trials in ascending order; None when the answer is good enough."""
    holding = [t for t in trials if t[1] >= required]
    if not holding:
        k, m = trials[-1]
        below = trials[-2] if len(trials) > 1 else None
        if k >= K_MAX:
            return None
        slope = (m - below[1]) / (k - below[0]) if below is not None else np.nan
        step = (1.005 * required - m) / slope if slope > 0.0 else max(0.5, k)
        return float(min(K_MAX, k + np.clip(step, 0.05, 1.0)))
    k, m = holding[0]
    short = [t for t in trials if t[0] < k and np.isfinite(t[1])]
    if k == 0.0 or m <= 1.005 * required:
        return None
    low_k, low_m = short[-1] if short else (0.0, np.nan)
    if not short:
        return 0.0
    part = (1.0025 * required - low_m) / (m - low_m)
    return float(low_k + np.clip(part, 0.05, 0.95) * (k - low_k))


def virtual_impedance(grid: Grid, f_r_hz: float) -> SeriesRL:
    """R and L that have the grid's impedance at the resonance (signed, Hz): what damping control multiplies by k.

    Raises
    ------
    SeqsweepError
        If the grid is capacitive there.
    """
    if isinstance(grid, SeriesRL):
        return grid
    capacitive = why_capacitive(grid, f_r_hz)
    if capacitive:
        raise SeqsweepError(capacitive)
    z = own_impedance(grid, f_r_hz)
    return SeriesRL(max(z.real, 0.0), z.imag * grid.f1_hz / f_r_hz, grid.f1_hz)


def series_of(z_ohm: complex, f1_hz: float) -> SeriesRL:
    """R and L that have ``z_ohm`` at f1, which is what a farm's devices see: their gains multiply it.

    Raises
    ------
    SeqsweepError
        If it is capacitive.
    """
    if not z_ohm.imag > 0.0:
        raise SeqsweepError(
            "damping control is set by an R and an L, and what a device of the farm sees at f1, when all change their "
            f"current in step, is capacitive ({in_ohm(z_ohm)} ohm); [damping] of the farm file "
            "can give r_ohm and x_ohm of its own"
        )
    return SeriesRL(max(z_ohm.real, 0.0), z_ohm.imag, f1_hz)


def why_capacitive(grid: Grid, f_r_hz: float) -> str:
    """In words that the grid is capacitive at the resonance (signed, Hz); empty where it is inductive."""
    z = own_impedance(grid, f_r_hz)
    if z.imag / f_r_hz > 0.0:
        return ""
    return (
        f"at {f_r_hz:.4g} Hz the grid ({grid.label}) is capacitive ({in_ohm(z)} ohm), and damping "
        "control is set by an R and an L"
    )
