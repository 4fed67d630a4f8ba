"""What a run in time says: when it resonates, how fast that grows or decays, and how it ends."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...plant.damping.estimator import SAMPLE_S, WINDOW_S
from ...plant.damping.events import Trajectory

_GROWS = 0.1  # 1/s; a slope of ln A_r that is more than what the reading of a steady oscillation wavers by
_FAINT = 2e-3
_LARGE = 0.5
"""Rates are read where r lies between these: below the estimate is noise, above nothing is linear."""


class Happening(Protocol):
    """An event: what counts is when."""

    @property
    def time_s(self) -> float: ...


@dataclass(frozen=True, slots=True)
class WindowReport:
    """The current between two times: pair of frequencies (Hz), magnitudes (A, phase peak), r, growth (1/s), power (MW).

    What cannot be told is NaN: blocked, no resonance, synchronism lost.
    """

    from_s: float
    to_s: float
    f_hz: float
    f_mirror_hz: float
    amplitude_a: float
    mirror_a: float
    ratio: float
    growth_per_s: float
    power_mw: float
    power_swing_mw: float


@dataclass(frozen=True, slots=True)
class RunReport:
    """One run in words and numbers.

    Attributes
    ----------
    outcome : str
        In a few words.
    largest_ratio, last_ratio : float
        r, highest and last known.
    above_s, calm_s : float or None
        When r passed the threshold for the first time, and from when on it stayed below (s).
    rate_per_s : float or None
        Growth (+) or decay (-) of the resonance after the last change of anything (1/s).
    started_s, stopped_s : tuple of float
        When damping control started and stopped (s).
    lost_s : float or None
        When synchronism was lost (s).
    windows : tuple of WindowReport
        150 ms each, from the first event on.
    """

    outcome: str
    largest_ratio: float
    last_ratio: float
    above_s: float | None
    calm_s: float | None
    rate_per_s: float | None
    started_s: tuple[float, ...]
    stopped_s: tuple[float, ...]
    lost_s: float | None
    windows: tuple[WindowReport, ...]


def report(trajectory: Trajectory, events: Sequence[Happening], threshold: float) -> RunReport:
    """Read one trajectory; nothing counts after synchronism is lost."""
    t, ratio = trajectory.decision_s, trajectory.ratio
    seen = t <= _end_s(trajectory)
    known = ratio[seen & np.isfinite(ratio)]
    last_ratio = float(known[-1]) if len(known) else float("nan")
    rate_per_s = _rate_per_s(trajectory, events)
    grows = grows_at_the_end(rate_per_s, last_ratio)
    above = t[seen & (ratio > threshold)]
    above_s = float(above[0]) if len(above) else None
    calm_s = _calm_s(t, ratio, threshold) if trajectory.lost_s is None else None
    return RunReport(
        outcome=_outcome(trajectory, above_s, calm_s, grows),
        largest_ratio=float(np.nanmax(ratio[seen], initial=0.0)),
        last_ratio=last_ratio,
        above_s=above_s,
        calm_s=calm_s,
        rate_per_s=rate_per_s,
        started_s=trajectory.started_s,
        stopped_s=trajectory.stopped_s,
        lost_s=trajectory.lost_s,
        windows=tuple(_windows(trajectory, events)),
    )


def _end_s(trajectory: Trajectory) -> float:
    return np.inf if trajectory.lost_s is None else trajectory.lost_s


def _calm_s(t: np.ndarray, ratio: np.ndarray, threshold: float) -> float | None:
    """From when on r stays below the threshold to the end; unknown is not calm. None if it does not."""
    restless = np.flatnonzero(~(ratio < threshold))
    if len(restless) == 0:
        return 0.0
    return None if restless[-1] + 1 == len(t) else float(t[restless[-1] + 1])


def grows_at_the_end(rate_per_s: float | None, last_ratio: float) -> bool:
    """Whether a resonance that can be seen grows when the run ends, be it below the threshold or not."""
    return rate_per_s is not None and rate_per_s > _GROWS and last_ratio > _FAINT


def _outcome(trajectory: Trajectory, above_s: float | None, calm_s: float | None, grows: bool) -> str:
    if trajectory.lost_s is not None:
        return f"synchronism lost at {trajectory.lost_s:.2f} s"
    if calm_s is None:
        return "still resonating at the end"
    if grows:
        return "below the threshold, and growing"
    return "no resonance above the threshold" if above_s is None else f"calm from {calm_s:.2f} s on"


def _rate_per_s(trajectory: Trajectory, events: Sequence[Happening]) -> float | None:
    """Slope of ln A_r over the time in which nothing changes any more and r is neither faint nor large."""
    changes = [event.time_s + getattr(event, "duration_s", 0.0) for event in events]
    settled_s = max([0.0, *changes, *trajectory.started_s, *trajectory.stopped_s]) + WINDOW_S
    t, ratio, size = trajectory.decision_s, trajectory.ratio, trajectory.resonance_a
    inside = (t >= settled_s) & (t <= _end_s(trajectory)) & (ratio > _FAINT) & (ratio < _LARGE)
    if np.count_nonzero(inside) * SAMPLE_S < 0.05:
        return None
    return float(np.polyfit(t[inside], np.log(size[inside]), 1)[0])


def _windows(trajectory: Trajectory, events: Sequence[Happening]) -> Iterable[WindowReport]:
    """Windows as long as the estimator's, from the first event on."""
    first = min((event.time_s for event in events), default=0.0)
    n = round(WINDOW_S / SAMPLE_S)
    begin = round(first / SAMPLE_S)
    for last in range(begin + n - 1, len(trajectory.decision_s), n):
        to_s = float(trajectory.decision_s[last])
        yield _window(trajectory, to_s - WINDOW_S, to_s, last)


def _window(trajectory: Trajectory, from_s: float, to_s: float, decision: int) -> WindowReport:
    if to_s > _end_s(trajectory):
        return WindowReport(from_s, to_s, *[float("nan")] * 8)
    found = trajectory.resonance[decision]
    inside = (trajectory.time_s >= from_s - 1e-9) & (trajectory.time_s < to_s - 1e-9)
    power_mw = trajectory.p_w[inside] / 1e6
    return WindowReport(
        from_s=from_s,
        to_s=to_s,
        f_hz=found.f_hz,
        f_mirror_hz=2.0 * trajectory.f1_hz - found.f_hz,
        amplitude_a=found.amplitude,
        mirror_a=found.mirror,
        ratio=found.ratio,
        growth_per_s=found.growth_per_s,
        power_mw=float(np.mean(power_mw)),
        power_swing_mw=float(np.ptp(power_mw)),
    )
