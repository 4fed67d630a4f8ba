"""Frequency grids whose windows are exactly coherent: whole periods fit whole steps.

Time is cut into blocks, the shortest stretch of whole steps that holds whole fundamental periods. A
frequency is usable where some number of blocks holds a whole number of its periods; then it holds
whole periods of the mirror 2 f1 - f too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor

import numpy as np

from ...plant.errors import SeqsweepError

MIN_WINDOW_S = 0.3
"""Shortest window (s): the fast modes of a converter die out within one."""

MIN_CYCLES = 5.0
"""Cycles of the difference frequency |f - f1| in a window: keeps slow modes off the line."""

MAX_WINDOW_S = 10.0
"""Longest coherent window (s) that is tried; it sets the finest resolution, 1 / MAX_WINDOW_S."""

LISTED_SHIFT = 1e-3
"""Largest relative move of a listed frequency."""

GENERATED_SHIFT = 1.0 / 3.0
"""Largest move of a generated frequency, in parts of the distance to its neighbour."""


class GridError(SeqsweepError):
    """Frequencies that cannot be swept, with the way out."""


@dataclass(frozen=True, slots=True)
class Block:
    """``steps`` steps that hold exactly ``periods`` fundamental periods, ``duration_s`` long."""

    steps: int
    periods: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Frequency:
    """A point of the grid.

    Attributes
    ----------
    f_hz : float
        Frequency (Hz).
    window_blocks : int
        Blocks of its window.
    n_periods : int
        Whole periods of ``f_hz`` in the window.
    """

    f_hz: float
    window_blocks: int
    n_periods: int


def coherent_block(f1_hz: float, dt_s: float) -> Block:
    """The shortest block of a plant with fundamental ``f1_hz`` (Hz) and step ``dt_s`` (s).

    Raises
    ------
    GridError
        If no block of up to one second exists.
    """
    periods_per_step = Fraction(f1_hz * dt_s).limit_denominator(round(1.0 / dt_s))
    if abs(float(periods_per_step) - f1_hz * dt_s) > 1e-12 * f1_hz * dt_s:
        better = 1.0 / (f1_hz * round(1.0 / (f1_hz * dt_s)))
        raise GridError(
            f"no whole number of steps of {dt_s:g} s holds whole periods of {f1_hz:g} Hz within 1 s: "
            f"use a step such as {better!r} s"
        )
    steps, periods = periods_per_step.denominator, periods_per_step.numerator
    return Block(steps, periods, periods / f1_hz)


def generated(
    f_min_hz: float, f_max_hz: float, points: int, spacing: str, f1_hz: float, dt_s: float
) -> list[Frequency]:
    """A snapped grid from ``f_min_hz`` to ``f_max_hz`` (Hz), strictly increasing, without f1.

    Points move by up to a third of the distance to their neighbours, to where the shortest window
    is; the ends stay where the step allows it. What coincides after snapping is kept once.
    """
    space = np.geomspace if spacing == "log" else np.linspace
    wanted = space(f_min_hz, f_max_hz, points)
    check_band(wanted, f1_hz, dt_s)
    block = coherent_block(f1_hz, dt_s)
    room = GENERATED_SHIFT * np.minimum(np.diff(wanted, prepend=-np.inf), np.diff(wanted, append=np.inf))
    found = [exact_or_nearby(f, move, f1_hz, block) for f, move in zip(wanted[[0, -1]], room[[0, -1]], strict=True)]
    inner = [nearby(f, move, f1_hz, block) for f, move in zip(wanted[1:-1], room[1:-1], strict=True)]
    unique = {point.f_hz: point for point in [found[0], *inner, found[1]] if point is not None}
    if not unique:
        raise GridError(f"no usable frequency between {f_min_hz:g} and {f_max_hz:g} Hz; widen the band")
    return [unique[f] for f in sorted(unique)]


def listed(f_hz: Sequence[float], f1_hz: float, dt_s: float) -> tuple[list[Frequency], list[str]]:
    """Listed frequencies, kept where the step allows it exactly, else moved by up to 0.1 %.

    Returns
    -------
    points : list of Frequency
        In the order given.
    warnings : list of str
        One for each frequency that was moved.

    Raises
    ------
    GridError
        For f1 itself, a frequency above Nyquist, or one that cannot be reached.
    """
    wanted = np.asarray(f_hz, dtype=float)
    check_band(wanted, f1_hz, dt_s)
    block = coherent_block(f1_hz, dt_s)
    points, warnings = [], []
    for f in wanted:
        point = exact_or_nearby(f, LISTED_SHIFT * f, f1_hz, block)
        if point is None:
            raise GridError(
                f"{f:g} Hz: no window of up to {MAX_WINDOW_S:g} s holds whole periods of it (or of anything within "
                f"0.1 %) and of f1 = {f1_hz:g} Hz; usable are multiples of {1 / MAX_WINDOW_S:g} Hz"
            )
        if point.f_hz != f:
            warnings.append(f"{f:.9g} Hz moved to {point.f_hz:.9g} Hz, where whole periods fit whole steps")
        points.append(point)
    chosen = [point.f_hz for point in points]
    if len(set(chosen)) < len(chosen):
        raise GridError("two listed frequencies are moved to the same value; list frequencies further apart")
    return points, warnings


def check_band(wanted: np.ndarray, f1_hz: float, dt_s: float) -> None:
    """Refuse f1 itself and what is above Nyquist (`GridError`)."""
    at_f1 = np.abs(wanted - f1_hz) <= 1e-9 * f1_hz
    if len(wanted) and np.any(at_f1):
        raise GridError(
            f"{f1_hz:g} Hz is the fundamental itself: the perturbation cannot be told from the operating point there. "
            f"Use a frequency beside it, such as {f1_hz - 1:g} or {f1_hz + 1:g} Hz"
        )
    nyquist = 0.5 / dt_s
    highest = np.max(np.maximum(np.abs(wanted), np.abs(2.0 * f1_hz - wanted)))
    if highest >= nyquist:
        raise GridError(
            f"{np.max(wanted):g} Hz and its mirror at {2 * f1_hz - np.max(wanted):g} Hz must be below the Nyquist "
            f"frequency of {nyquist:g} Hz (step {dt_s:g} s): lower the frequency or the plant's step"
        )


def exact_or_nearby(f: float, move_hz: float, f1_hz: float, block: Block) -> Frequency | None:
    """``f`` itself where some window holds whole periods of it, else as `nearby`."""
    return _exact(f, f1_hz, block) or nearby(f, move_hz, f1_hz, block)


def _exact(f: float, f1_hz: float, block: Block) -> Frequency | None:
    """``f`` itself, if some window of up to MAX_WINDOW_S holds whole periods of it."""
    for n_blocks in range(1, _most_blocks(block) + 1):
        periods = f * n_blocks * block.duration_s
        if round(periods) > 0 and abs(periods - round(periods)) <= 1e-9 * periods:
            return _with_window(float(f), n_blocks, round(periods), f1_hz, block)
    return None


def nearby(f: float, move_hz: float, f1_hz: float, block: Block) -> Frequency | None:
    """The frequency within ``move_hz`` of ``f`` that has the shortest window; the nearest of those."""
    found: list[tuple[int, float, int, int]] = []
    for n_blocks in range(1, _most_blocks(block) + 1):
        window_s = n_blocks * block.duration_s
        lowest, highest = ceil((f - move_hz) * window_s - 1e-9), floor((f + move_hz) * window_s + 1e-9)
        for periods in range(max(lowest, 1), highest + 1):
            if periods != n_blocks * block.periods:  # f1 itself
                whole = _whole_window(periods / window_s, n_blocks, f1_hz, block)
                found.append((whole, abs(periods / window_s - f), n_blocks, periods))
        if found and n_blocks * block.duration_s > MIN_WINDOW_S and n_blocks > min(found)[0]:
            break
    if not found:
        return None
    _, _, n_blocks, periods = min(found)
    return _with_window(f1_hz * periods / (n_blocks * block.periods), n_blocks, periods, f1_hz, block)


def _most_blocks(block: Block) -> int:
    return max(1, floor(MAX_WINDOW_S / block.duration_s + 1e-9))


def _whole_window(f: float, n_blocks: int, f1_hz: float, block: Block) -> int:
    """Blocks of the window: a multiple of the coherent one, long enough for the transients."""
    needed_s = max(MIN_WINDOW_S, MIN_CYCLES / abs(f - f1_hz))
    return n_blocks * max(1, ceil(needed_s / (n_blocks * block.duration_s) - 1e-9))


def _with_window(f: float, n_blocks: int, periods: int, f1_hz: float, block: Block) -> Frequency:
    whole = _whole_window(f, n_blocks, f1_hz, block)
    return Frequency(f, whole, periods * (whole // n_blocks))
