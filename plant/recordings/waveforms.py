"""A recording as space vectors, in load direction, any stretch of it when asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..protocol import Record, SourceDirection
from .apart import read_recording_apart
from .channels import Assignment, assign, in_words
from .recording import BLOCK, Recording, RecordingError
from .uneven import check_even

CLIPPED_CYCLE = 0.02
"""A channel that rests at its largest value for this part of a 50 Hz cycle is clipped."""


class Waveforms:
    """v and i of a recording; the one place where a generator's current is negated.

    Parameters
    ----------
    recording : Recording
        The file.
    assignment : Assignment
        Which channels are v and i.
    direction : "load" or "generator"
        How the current was recorded: positive into the device, or out of it.
    """

    def __init__(self, recording: Recording, assignment: Assignment, direction: SourceDirection):
        if direction not in ("load", "generator"):
            raise RecordingError(
                f"direction is {direction!r}; it is 'load' (into the device) or 'generator' (out of it)"
            )
        self.recording, self.assignment, self.direction = recording, assignment, direction
        self.n_samples, self.t0_s, self.dt_s = recording.n_samples, recording.t0_s, recording.dt_s
        self._columns = (*assignment.voltage.columns, *assignment.current.columns)

    def record(self, start: int, stop: int) -> Record:
        """Samples ``start`` to ``stop``; its ``f1_hz`` is what the file claims, NaN where it claims nothing."""
        samples = self.recording.samples(self._columns, start, stop)
        n_v = len(self.assignment.voltage.columns)
        i = self.assignment.current.of(samples[:, n_v:])
        return Record(
            t0_s=self.t0_s + start * self.dt_s,
            dt_s=self.dt_s,
            v=self.assignment.voltage.of(samples[:, :n_v]),
            i=-i if self.direction == "generator" else i,
            f1_hz=self.recording.header_f1_hz or np.nan,
            source_direction=self.direction,
            origin=self.recording.path.name,
        )

    def records(self) -> Sequence[Record]:
        """The whole of it in one piece (`RecordSource`); `record` does not need the memory."""
        return [self.record(0, self.n_samples)]

    def notes(self) -> tuple[str, ...]:
        """What a person should know: channels, what the reader and the physics had to say."""
        parts = self.assignment
        return (
            f"{self.recording.format}, {self.n_samples} samples, {1 / self.dt_s:.9g} Hz",
            in_words(self.recording, parts.voltage),
            f"{in_words(self.recording, parts.current)}, {self.direction} direction",
            *self.recording.notes,
            *parts.notes,
        )


class Defects(NamedTuple):
    """What is wrong with the samples themselves."""

    missing: int
    clipped: tuple[str, ...]


def open_waveforms(
    path: str | Path,
    direction: SourceDirection,
    *,
    channels: Mapping[str, str] | None = None,
    base: tuple[float, float] | None = None,
    sample_rate_hz: float | None = None,
    units: Mapping[str, str] | None = None,
) -> Waveforms:
    """Open a file in a process of its own and find v and i in it; `RecordingError` as `read_recording` and `assign`."""
    recording = read_recording_apart(path, sample_rate_hz=sample_rate_hz)
    try:
        assignment = assign(recording, channels, base, units)
    except RecordingError as error:
        raise RecordingError("; ".join([str(error), *recording.hints])) from None
    check_even(recording, assignment.voltage)
    return Waveforms(recording, assignment, direction)


def defects(waveforms: Waveforms, start: int, stop: int) -> Defects:
    """Missing samples and clipped channels between two samples.

    A sine rests at its peak for less than 1 % of a cycle even with 12 bits; a clipped one for longer.
    """
    columns = waveforms._columns
    longest = max(4, round(CLIPPED_CYCLE / 50.0 / waveforms.dt_s))
    missing, clipped = 0, set()
    for first in range(start, stop, BLOCK):
        block = waveforms.recording.samples(columns, first, min(first + BLOCK, stop))
        bad = ~np.isfinite(block)
        missing += int(np.count_nonzero(np.any(bad, axis=1))) if bad.any() else 0
        for extreme in (np.fmax.reduce(block), np.fmin.reduce(block)):
            at = block == extreme
            for k in np.flatnonzero(np.count_nonzero(at, axis=0) >= longest):
                if _longest_run(at[:, k]) >= longest:
                    clipped.add(waveforms.recording.channels[columns[k]].name)
    return Defects(missing, tuple(sorted(clipped)))


def _longest_run(flags: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[0::2], initial=0))
