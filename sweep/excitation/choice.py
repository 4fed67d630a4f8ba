"""From the configuration to a broadband signal and the points it can serve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..config.sections import PERIOD_S
from .frequencies import LISTED_SHIFT, Frequency
from .odd_lines import SignalError, odd_lines
from .signals import Signal, chirp, coherent_blocks, multisine, prbs, qrb, register_order, residue_length

if TYPE_CHECKING:
    from ..config.sections import InjectionSection, SweepSection

MIN_PER_LINE = 1e-7
"""Smallest amplitude of a line (pu): below, what rounding leaves of the steady state is heard as well."""


def broadband(
    sweep: SweepSection, injection: InjectionSection, f1_hz: float, dt_s: float
) -> tuple[Signal, list[Frequency], list[str]]:
    """The signal that is asked for, its points in ascending order, and what the user should know.

    Raises
    ------
    SignalError
        If the signal cannot resolve or reach what is asked, with the way out.
    """
    period_s, wanted = injection.period_s or PERIOD_S, _wanted(sweep)
    if np.any(np.abs(wanted - f1_hz) <= 1e-9 * f1_hz):
        raise SignalError(f"{f1_hz:g} Hz is the fundamental itself: the perturbation cannot be told from it there")
    if injection.signal == "multisine":
        cycles = _odd(wanted, sweep, period_s, f1_hz)
        signal = multisine(np.unique(np.abs(cycles)), period_s)
    else:
        signal = _dense(injection.signal, period_s, np.abs(wanted - f1_hz))
        cycles = _nearest((wanted - f1_hz) * period_s, signal)
    blocks = coherent_blocks(signal, f1_hz, dt_s)
    if injection.largest_pu * signal.weakest < MIN_PER_LINE:
        raise SignalError(
            f"a peak of {injection.largest_pu:g} pu leaves {injection.largest_pu * signal.weakest:.1g} pu for a line "
            f"of the {injection.signal}; {MIN_PER_LINE:g} pu is needed: raise the amplitude, or ask for fewer points"
        )
    f1_cycles = round(f1_hz * period_s)
    points = [Frequency(float((k + f1_cycles) / period_s), blocks, int(k) + f1_cycles) for k in cycles]
    return signal, points, _remarks(sweep, wanted, points, period_s)


def _wanted(sweep: SweepSection) -> np.ndarray:
    if sweep.f_hz is not None:
        return np.array(sweep.f_hz)
    assert sweep.f_min_hz is not None
    assert sweep.f_max_hz is not None
    assert sweep.points is not None
    space = np.geomspace if sweep.spacing == "log" else np.linspace
    return space(sweep.f_min_hz, sweep.f_max_hz, sweep.points)


def _odd(wanted: np.ndarray, sweep: SweepSection, period_s: float, f1_hz: float) -> np.ndarray:
    """Signed odd cycles of every point; listed frequencies move by 0.1 % at most."""
    if sweep.f_hz is None:
        nu = wanted - f1_hz
        nearest = np.copysign(1.0 / period_s, nu)  # what is nearer to f1 has no line of its own
        return odd_lines(np.sort(np.where(np.abs(nu) < 1.0 / period_s, nearest, nu)), period_s).cycles
    cycles = 2 * np.floor((wanted - f1_hz) * period_s / 2.0).astype(int) + 1
    moved = np.abs(cycles / period_s + f1_hz - wanted) > LISTED_SHIFT * wanted
    if np.any(moved):
        f = wanted[moved][0]
        raise SignalError(
            f"{f:g} Hz is no odd multiple of {1 / period_s:g} Hz away from f1 = {f1_hz:g} Hz, where the lines of a "
            f"multisine of {period_s:g} s are: use {_around(f, period_s, f1_hz)}, another injection.period_s, or tones"
        )
    if len(np.unique(cycles)) < len(cycles):
        raise SignalError(f"two listed frequencies share a line, {2 / period_s:g} Hz apart: list them further apart")
    return cycles


def _around(f_hz: float, period_s: float, f1_hz: float) -> str:
    below = 2 * np.floor(((f_hz - f1_hz) * period_s - 1.0) / 2.0) + 1
    return " or ".join(f"{f1_hz + k / period_s:g}" for k in (below, below + 2)) + " Hz"


def _dense(kind: str, period_s: float, nu_hz: np.ndarray) -> Signal:
    """A signal with every line of the band: the lowest and the highest wanted |f - f1|."""
    band = max(float(nu_hz.min()), 1.0 / period_s), float(nu_hz.max())
    if kind == "chirp":
        return chirp(period_s, band)
    if kind == "qrb":
        length = residue_length(period_s, band[1])
        return qrb(length, length / period_s, band)
    order = register_order(period_s, band[1])
    return prbs(order, (2**order - 1) / period_s, band)


def _nearest(wanted: np.ndarray, signal: Signal) -> np.ndarray:
    """Signed cycles of the lines nearest to the wanted ones, ascending, without doubles."""
    lines = np.concatenate([-signal.cycles[::-1], signal.cycles])
    return np.unique(lines[np.argmin(np.abs(wanted[:, None] - lines), axis=1)])


def _remarks(sweep: SweepSection, wanted: np.ndarray, points: list[Frequency], period_s: float) -> list[str]:
    remarks = []
    if len(points) < len(wanted):
        remarks.append(
            f"the grid has {len(points)} points instead of {len(wanted)}: a period of {period_s:g} s has no more lines "
            "of its own for them; raise injection.period_s"
        )
    if sweep.f_hz is not None and len(points) == len(wanted):
        remarks += [
            f"{f:.9g} Hz moved to {point.f_hz:.9g} Hz, where the signal has a line"
            for f, point in zip(wanted, points, strict=True)
            if abs(point.f_hz - f) > 1e-9 * f
        ]
    return remarks
