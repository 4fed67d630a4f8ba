"""``amplitude_pu = "auto"``: per band of frequencies the amplitude at which noise and distortion balance.

A few pilot points are swept at a ladder of amplitudes below the user's limit. At each step of it the noise is what the
covariance says (on a quiet device: the agreement asked), and the distortion what Y changes by from one step to the
next. The largest amplitude whose distortion its own noise covers is taken; where none is, the one with the least of
both together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..excitation.frequencies import Frequency
from ..measure.linearity import covariance_of
from ..measure.rows import Row
from ..plan import Plan

STEPS = 6
RATIO = 2.5
"""Of the ladder: 0.02, 0.008, 0.0032, ... for a limit of 0.02 pu."""

BANDS = 6
"""Bands that are told apart, of about equally many points."""

Levels = Mapping[str, tuple[float, ...]]
"""Amplitude (pu) of every band, by operating point."""


class Pilots(NamedTuple):
    """What is swept before the amplitudes are known.

    Attributes
    ----------
    bands : tuple of tuple of Frequency
        The points, ascending, cut into bands.
    points : tuple of Frequency
        One of each band; all of them where they are played together.
    plans : tuple of Plan
        One for every step of the ladder, largest amplitude first.
    """

    bands: tuple[tuple[Frequency, ...], ...]
    points: tuple[Frequency, ...]
    plans: tuple[Plan, ...]


def pilots(plan: Plan) -> Pilots:
    """Pilot sweeps of a plan whose ``amplitude_pu`` is the limit."""
    n_bands = 1 if plan.signal is not None else min(BANDS, len(plan.points))
    cut = np.array_split(np.arange(len(plan.points)), n_bands)
    bands = tuple(tuple(plan.points[k] for k in band) for band in cut)
    points = plan.points if plan.signal is not None else tuple(_handiest(band) for band in bands)
    ladder = tuple(
        replace(plan.at(plan.amplitude_pu / RATIO**step), points=points, probes=frozenset()) for step in range(STEPS)
    )
    return Pilots(bands, points, ladder)


def chosen(asked: Pilots, ladder: Sequence[Mapping[str, Sequence[Row]]]) -> Levels:
    """Amplitudes from the pilots' rows.

    Parameters
    ----------
    asked : Pilots
        What was swept.
    ladder : sequence of mapping of str to rows
        Per step of the ladder the rows of every operating point, ascending in frequency.
    """
    steps = [part.amplitude_pu for part in asked.plans]
    return {op_id: tuple(_of_bands(asked, steps, [rows[op_id] for rows in ladder])) for op_id in ladder[0]}


def parts(plan: Plan, points: Sequence[Frequency], asked: Pilots, levels: Levels) -> list[Plan]:
    """The plan of ``points`` as plans of one operating point and one amplitude each."""
    ends = [band[-1].f_hz for band in asked.bands[:-1]]
    band_of = np.searchsorted(ends, [point.f_hz for point in points])
    found = []
    for condition in plan.conditions:
        own = levels[condition.op_id]
        for level in sorted(set(own), reverse=True):
            at_level = tuple(p for p, band in zip(points, band_of, strict=True) if own[band] == level)
            if at_level:
                found.append(replace(plan.at(level), conditions=(condition,), points=at_level))
    return found


def _handiest(band: tuple[Frequency, ...]) -> Frequency:
    """The point of a band with the shortest window, the middle one of those."""
    shortest = min(point.window_blocks for point in band)
    short = [point for point in band if point.window_blocks == shortest]
    return short[len(short) // 2]


def _of_bands(asked: Pilots, steps: Sequence[float], ladder: Sequence[Sequence[Row]]) -> list[float]:
    if len(asked.bands) == 1:
        return [_balanced(steps, ladder)]
    return [_balanced(steps, [[rows[k]] for rows in ladder]) for k in range(len(asked.bands))]


def _balanced(steps: Sequence[float], ladder: Sequence[Sequence[Row]]) -> float:
    """The amplitude (pu) for one band, from its rows at every step of the ladder."""
    noise = np.array([_median([_noise(row) for row in rows]) for rows in ladder])
    changes = [
        _median([_change(above, below) for above, below in zip(*step, strict=True)]) for step in pairwise(ladder)
    ]
    distortion = np.array([*changes, changes[-1]])
    covered = np.flatnonzero(distortion <= noise)
    if len(covered):
        return steps[int(covered[0])]
    together = np.where(np.isfinite(noise + distortion), np.hypot(noise, distortion), np.inf)
    return steps[int(np.argmin(together))]


def _noise(row: Row) -> float:
    """Relative standard error of a row."""
    return float(np.sqrt(np.trace(covariance_of(row))) / np.linalg.norm(row.admittance))


def _change(above: Row, below: Row) -> float:
    """Relative change of Y between two amplitudes beyond what their noise makes of it."""
    squared = np.linalg.norm(above.admittance - below.admittance) ** 2
    excess = squared - np.trace(covariance_of(above)) - np.trace(covariance_of(below))
    return float(np.sqrt(max(excess, 0.0)) / np.linalg.norm(above.admittance)) if np.isfinite(excess) else np.nan


def _median(values: Sequence[float]) -> float:
    known = [x for x in values if np.isfinite(x)]
    return float(np.median(known)) if known else np.nan
