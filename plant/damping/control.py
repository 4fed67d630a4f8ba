"""Damping control at the measurement port (the paper's ARDC): what it does, and when it acts.

It stands outside the controller: between the measurement of v and i at the point of common coupling
(PCC) and whatever uses it. The activation logic is values in, values out: `decide` takes a
`DampingState` and 2 ms of measurement, and gives the next state. docs/damping.md explains the rules.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan, pi
from statistics import median

import numpy as np

from ..errors import SeqsweepError
from ..protocol import Compensation
from .estimator import NO_RESONANCE, SAMPLE_S, WINDOW_S, Estimator, Resonance, matrix_pencil

NOTCH_XI = 0.01
"""Damping xi of the notch; its gain G0 is one."""

DAMPING_RANGES = {
    "damping_gain": (0.0, 2.0, ""),
    "damping_r_ohm": (0.0, 100.0, " ohm"),
    "damping_l_h": (0.0, 1.0, " H"),
    "damping_resonance_hz": (-1000.0, 1000.0, " Hz"),
}
"""Parameters of the damping control of a plant: lowest, highest, unit. Frequencies are signed."""

_N_CURRENTS = round(WINDOW_S / SAMPLE_S)

_VOLTAGE_WINDOW_S = 0.04
"""|v_pcc| is the fundamental's over two periods: a resonance of some 25 Hz beside it averages out."""

_N_VOLTAGES = round(_VOLTAGE_WINDOW_S / SAMPLE_S)

_SLOWEST_DECAY_PER_S = 0.5
"""What decays more slowly counts as not decaying: it would last for seconds."""


def compensation(k: float, r_ohm: float, l_h: float, resonance_hz: float) -> Compensation:
    """Rv + j w_r Lv with Rv = k R_grid and Lv = k L_grid; ``resonance_hz`` is signed. Eq. (7)."""
    return Compensation(k * r_ohm, k * 2.0 * pi * resonance_hz * l_h)


def checked_compensation(plant_id: str, values: Sequence[float]) -> Compensation:
    """`compensation` of a plant's parameters, in the order of `DAMPING_RANGES`; ValueError out of range."""
    for (name, (low, high, unit)), value in zip(DAMPING_RANGES.items(), values, strict=True):
        if not low <= value <= high:
            raise SeqsweepError(f"{name} is {value:g}{unit}; {plant_id} takes {low:g} to {high:g}{unit}")
    return compensation(*values)


def notch(f_hz: np.ndarray, f1_hz: float = 50.0) -> np.ndarray:
    """H_NF at signed frequencies (Hz), alpha and beta alike. Eq. (5)."""
    s, w0 = 2j * pi * np.asarray(f_hz, dtype=float), 2.0 * pi * f1_hz
    return (s**2 + w0**2) / (s**2 + 2.0 * NOTCH_XI * w0 * s + w0**2)


THRESHOLD = 0.03
"""Ratio of the resonance over the fundamental that is worth acting on, if nothing else is set."""


@dataclass(frozen=True, slots=True)
class DampingSettings:
    """Damping control as it is set on site.

    Attributes
    ----------
    k : float
        Gain, signed; what a device takes is its own to say (the turbine: 0 to 2).
    r_ohm, l_h : float
        R_grid (ohm) and L_grid (H) that the gain multiplies.
    resonance_hz : float or None
        Preset w_r / 2 pi (Hz), signed: that of the smallest margin. None: the estimate at the start.
    threshold : float
        Ratio r = A_r / A_0 of the current above which a resonance is worth acting on.
    delay_s : float
        How long r must stay above it without decaying (s).
    block_below_pu : float
        Blocked while |v_pcc| is less (per unit of rated).
    estimator : callable
        `estimator.matrix_pencil` or `estimator.sliding_fft`.
    f1_hz : float
        Fundamental (Hz).
    """

    k: float
    r_ohm: float
    l_h: float
    resonance_hz: float | None
    threshold: float = THRESHOLD
    delay_s: float = 0.15
    block_below_pu: float = 0.8
    estimator: Estimator = matrix_pencil
    f1_hz: float = 50.0

    def __post_init__(self) -> None:
        needed = {
            "k": (self.k, -10.0, 10.0),
            "r_ohm": (self.r_ohm, 0.0, float("inf")),
            "l_h": (self.l_h, 0.0, float("inf")),
            "threshold": (self.threshold, 0.0, 1.0),
            "delay_s": (self.delay_s, 0.0, 60.0),
            "block_below_pu": (self.block_below_pu, 0.0, 1.0),
            "resonance_hz": (0.0 if self.resonance_hz is None else self.resonance_hz, -1000.0, 1000.0),
        }
        for name, (value, low, high) in needed.items():
            if not low <= value <= high:
                raise SeqsweepError(f"{name} of the damping control is {value:g}; needed: {low:g} to {high:g}")


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the port saw in the last 2 ms.

    Attributes
    ----------
    time_s : float
        End of the 2 ms (s).
    v_pu : complex
        Mean of the PCC voltage's space vector, per unit of the rated phase peak.
    i : complex
        Mean of the current's space vector (A); its direction does not matter.
    cause_gone : bool
        Whether somebody who knows grid and admittance finds the device stable without damping.
    """

    time_s: float
    v_pu: complex
    i: complex
    cause_gone: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class DampingState:
    """Memory of the damping control.

    Attributes
    ----------
    currents : (75,) complex
        Analysis buffer: 150 ms of current (A), latest last; zero where there is nothing.
    n_currents : int
        How many of them are filled.
    voltages : (20,) complex
        40 ms of voltage (pu), seen from the frame that rotates at f1.
    resonance : Resonance
        Latest estimate; `NO_RESONANCE` while the buffer fills.
    growths_per_s : tuple of float
        Latest growths, up to five, since r is above the threshold (1/s).
    ringing_since_s : float or None
        Since when r is above the threshold without decaying (s).
    active, blocked : bool
        Started and not yet stopped; |v_pcc| too low to act. It acts when active and not blocked.
    resonance_hz : float
        w_r / 2 pi in use (Hz); NaN while not active.
    """

    currents: np.ndarray
    n_currents: int
    voltages: np.ndarray
    resonance: Resonance = NO_RESONANCE
    growths_per_s: tuple[float, ...] = ()
    ringing_since_s: float | None = None
    active: bool = False
    blocked: bool = False
    resonance_hz: float = nan

    @property
    def acts(self) -> bool:
        return self.active and not self.blocked


def at_rest(time_s: float, v_pu: complex, i: complex, f1_hz: float = 50.0) -> DampingState:
    """State after a long time at the fundamental phasors ``v_pu`` and ``i`` (A, at time zero)."""
    middle_s = time_s + (np.arange(-_N_CURRENTS, 0) + 0.5) * SAMPLE_S
    currents = i * _mean_over_sample(f1_hz) * np.exp(2j * pi * f1_hz * middle_s)
    voltages = np.full(_N_VOLTAGES, v_pu * _mean_over_sample(f1_hz))
    return DampingState(currents, _N_CURRENTS, voltages)


def decide(settings: DampingSettings, state: DampingState, measurement: Measurement) -> DampingState:
    """The next state, 2 ms later.

    Notes
    -----
    - Blocked while |v_pcc| is low; the analysis buffer is then zero, and judged again when full.
    - Starts when r > threshold and the estimated growth says "not decaying" throughout ``delay_s``.
      The window is as long as the delay: what an event left in it has gone when the delay ends.
      The growth that counts is the median of the last 10 ms: single estimates slip.
    - Stops, and does not start, while the cause is said to be gone.
    """
    state = _listen(settings, state, measurement)
    time_s, found = measurement.time_s, state.resonance
    growths = (*state.growths_per_s[-4:], found.growth_per_s) if found.ratio > settings.threshold else ()
    ringing = bool(growths) and median(growths) > -_SLOWEST_DECAY_PER_S
    since_s = (time_s if state.ringing_since_s is None else state.ringing_since_s) if ringing else None
    due = since_s is not None and time_s - since_s >= settings.delay_s - 1e-9
    active = (state.active or due) and not measurement.cause_gone
    resonance_hz = state.resonance_hz if active else nan
    if active and not state.active:
        resonance_hz = found.f_hz if settings.resonance_hz is None else settings.resonance_hz
    return replace(state, growths_per_s=growths, ringing_since_s=since_s, active=active, resonance_hz=resonance_hz)


def output(settings: DampingSettings, state: DampingState) -> Compensation:
    """What the port is told to do until the next decision."""
    if not state.acts:
        return Compensation()
    return compensation(settings.k, settings.r_ohm, settings.l_h, state.resonance_hz)


def _listen(settings: DampingSettings, state: DampingState, measurement: Measurement) -> DampingState:
    """Buffers and estimate, 2 ms later."""
    middle_s = measurement.time_s - 0.5 * SAMPLE_S
    turn = cmath.exp(-2j * pi * ((settings.f1_hz * middle_s) % 1.0))
    voltages = np.append(state.voltages[1:], measurement.v_pu * turn)
    magnitude_pu = abs(np.mean(voltages)) / _mean_over_sample(settings.f1_hz)
    blocked = not magnitude_pu >= settings.block_below_pu
    if blocked:
        currents, n_currents = np.zeros(_N_CURRENTS, complex), 0
    else:
        currents, n_currents = np.append(state.currents[1:], measurement.i), min(state.n_currents + 1, _N_CURRENTS)
    full = n_currents == _N_CURRENTS
    resonance = settings.estimator(currents, SAMPLE_S, settings.f1_hz) if full else NO_RESONANCE
    return replace(
        state, currents=currents, n_currents=n_currents, voltages=voltages, resonance=resonance, blocked=blocked
    )


def _mean_over_sample(f1_hz: float) -> float:
    """What a mean over one sample leaves of the fundamental."""
    return float(np.sinc(f1_hz * SAMPLE_S))
