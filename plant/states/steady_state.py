"""A steady state found by waiting: a device is run until a period repeats, and that is certified.

For devices that nobody can look into. What is certified is the change from one period to the next, in parts of the
waveform's peak (at least `LEAST_PEAK_PU` of rated), twice in a row; it says nothing of modes slower than the patience.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import NamedTuple, TypeVar

import numpy as np

from ..injection import check_source
from ..operating_range import Asked, refuse_outside
from ..protocol import NotSettled, OperatingPoint, OperatingRange, Rating, Source
from ..space_vectors import PHASE_PEAK

K = TypeVar("K")
V = TypeVar("V")

LEAST_PEAK_PU = 0.01
"""A smaller waveform is judged as if it had this peak: an idle device has a current of nothing but rounding."""

LARGEST_PU = 1e3
"""A waveform beyond this many times the rated peak is not going to come back."""


class Patience(NamedTuple):
    """When a device counts as settled (change per period over the peak), and how long it may take (s)."""

    tolerance: float
    longest_s: float


HOLDS = ("start", "mean")
"""What a box is told of the source's voltage in a step: its value at the start, or its mean."""


class Clock(NamedTuple):
    """Fundamental (Hz) and step (s) of a device."""

    f1_hz: float
    dt_s: float

    @property
    def period_steps(self) -> int:
        """Steps of the whole number nearest to a fundamental period."""
        return round(1.0 / (self.f1_hz * self.dt_s))

    def voltage(self, tones: tuple[tuple[float, complex], ...], first_step: int, n_steps: int) -> np.ndarray:
        """Sum (n_steps,) of rotating phasors (signed Hz, value at time zero), from ``first_step`` on."""
        steps = np.arange(first_step, first_step + n_steps)
        v = np.zeros(n_steps, complex)
        for f_hz, phasor in tones:
            v += phasor * np.exp(2j * np.pi * ((f_hz * self.dt_s * steps) % 1.0))
        return v

    def mean_voltage(self, tones: tuple[tuple[float, complex], ...], first_step: int, n_steps: int) -> np.ndarray:
        """The same, each the mean over the step that begins there."""
        means = tuple(
            (f_hz, phasor * np.sinc(f_hz * self.dt_s) * np.exp(1j * np.pi * f_hz * self.dt_s)) for f_hz, phasor in tones
        )
        return self.voltage(means, first_step, n_steps)

    def held(self, hold: str, tones: tuple[tuple[float, complex], ...], first_step: int, n_steps: int) -> np.ndarray:
        """What is held in each step: one of `HOLDS`."""
        return (self.mean_voltage if hold == "mean" else self.voltage)(tones, first_step, n_steps)


def until_periodic(run: Callable[[int, int], np.ndarray], clock: Clock, patience: Patience) -> tuple[int, float]:
    """Run period by period until the waveforms repeat twice in a row.

    Parameters
    ----------
    run : callable
        ``run(first_step, n_steps)`` goes on and returns waveforms (m, n_steps) in per unit.
    clock, patience
        Of the device.

    Returns
    -------
    steps : int
        Steps taken.
    residual : float
        The last change over a period, over the peak of its waveform.

    Raises
    ------
    NotSettled
        If the waveforms leave all bounds, or still change when the patience is over.
    """
    n = clock.period_steps
    turn = np.exp(2j * np.pi * clock.f1_hz * n * clock.dt_s)  # 1 where whole steps fit the period
    before, residual, agreed = run(0, n), inf, 0
    periods = max(3, round(patience.longest_s * clock.f1_hz))
    for k in range(1, periods):
        now = run(k * n, n)
        if not np.all(np.abs(now) <= LARGEST_PU):
            raise NotSettled(f"the waveforms leave all bounds after {(k + 1) * n * clock.dt_s:.3g} s", "diverged")
        peak = np.maximum(np.max(np.abs(now), axis=1), LEAST_PEAK_PU)
        residual = float(np.max(np.max(np.abs(now - turn * before), axis=1) / peak))
        agreed = agreed + 1 if residual <= patience.tolerance else 0
        if agreed == 2:
            return (k + 1) * n, residual
        before = now
    raise NotSettled(
        f"the waveforms still change by {residual:.2g} of their peak from one period to the next after "
        f"{patience.longest_s:g} s; {patience.tolerance:g} is asked"
    )


def once(known: dict[K, V | NotSettled], key: K, settle: Callable[[], V]) -> V:
    """What ``settle`` gave for ``key``, or its refusal again: waiting is long, and comes to the same every time."""
    if key not in known:
        try:
            known[key] = settle()
        except NotSettled as refusal:
            known[key] = refusal
    found = known[key]
    if isinstance(found, NotSettled):
        raise NotSettled(str(found), found.status)
    return found


def voltage_asked(point: OperatingPoint, source: Source, limits: OperatingRange, rating: Rating, name: str) -> float:
    """|v_pcc| or, where the source fixes its own, the source's voltage (V, line-to-line RMS).

    Raises
    ------
    SeqsweepError
        If it, or the active power, is outside ``limits`` or not a number, or is said twice or not at all.
    """
    check_source(point, source)
    voltage_v = point.terminal_voltage_v if source.voltage_v is None else source.voltage_v
    assert voltage_v is not None
    power = Asked("active power", point.active_power_w, limits.active_power_w, 1.0, "W")
    voltage = Asked("voltage", voltage_v, limits.terminal_voltage_v, rating.voltage_v, "pu")
    refuse_outside(name, (power, voltage))
    return voltage_v


def phase_peak(voltage_v: float, angle_rad: float = 0.0) -> complex:
    """Space vector (V, phase peak) of a line-to-line RMS voltage at an angle."""
    return complex(PHASE_PEAK * voltage_v * np.exp(1j * angle_rad))
