"""What a file of waveforms holds, before anyone has said which channel is which."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SeqsweepError

BLOCK = 1 << 17
"""Samples read at a time: what a reader holds in memory beyond what its format forces upon it."""

TEXT_LIMIT_BYTES = 4 << 30
"""Largest text file, and largest array out of a compressed file, that is read into memory."""

Samples = Callable[[Sequence[int], int, int], np.ndarray]
"""``(columns, start, stop) -> (stop - start, len(columns)) float``; NaN where a sample is missing."""


class RecordingError(SeqsweepError):
    """A file that is no readable recording, or not one in which v and i are found; with the way out."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel as its file names it.

    Attributes
    ----------
    name, unit, phase : str
        As written; empty where the file says nothing.
    written : str
        What the file calls it, its unit perhaps included; empty where that is the name.
    limits : (low, high) or None
        Ends of the recorder's range, in ``unit``, where the file tells them.
    """

    name: str
    unit: str = ""
    phase: str = ""
    limits: tuple[float, float] | None = None
    written: str = ""


@dataclass(frozen=True, slots=True)
class Recording:
    """Named, uniformly sampled channels; samples are read when asked for.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        Its format, for people.
    channels : tuple of Channel
        In the order of the columns of ``samples``.
    n_samples : int
        Samples per channel.
    t0_s, dt_s : float
        Time of the first sample and the sampling step (s).
    samples : callable
        See `Samples`; values in the unit of the channel, on the primary side of its transformer.
    header_f1_hz : float or None
        The fundamental frequency the file claims (Hz). Never used as such.
    notes : tuple of str
        What a person should know about the file.
    hints : tuple of str
        Why a channel may be missing or go by another name: told where v or i is not found.
    """

    path: Path
    format: str
    channels: tuple[Channel, ...]
    n_samples: int
    t0_s: float
    dt_s: float
    samples: Samples
    header_f1_hz: float | None = None
    notes: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()

    def blocks(self, columns: Sequence[int]) -> Iterator[tuple[int, np.ndarray]]:
        """First sample and values (n, columns) of one block after another."""
        for start in range(0, self.n_samples, BLOCK):
            yield start, self.samples(columns, start, min(start + BLOCK, self.n_samples))

    def column(self, name: str) -> int:
        """Number of the channel called or written so (case ignored); `RecordingError` where there is none, or two."""
        wanted = name.strip().lower()
        found = [
            k
            for k, channel in enumerate(self.channels)
            if wanted in (channel.name.strip().lower(), channel.written.strip().lower())
        ]
        if len(found) == 1:
            return found[0]
        problem = "two channels are called" if found else "no channel is called"
        raise RecordingError(f"{self.path}: {problem} {name!r}; there are {names_of(self.channels)}")


def names_of(channels: Sequence[Channel], most: int = 24) -> str:
    """Names of channels for a message, not more than fit."""
    shown = ", ".join(repr(channel.name) for channel in channels[:most])
    return f"{shown} and {len(channels) - most} more" if len(channels) > most else shown or "none"


def in_memory(parts: Sequence[np.ndarray]) -> Samples:
    """`Samples` of arrays (n_k, columns) that follow one another; they are not joined, that would cost them twice."""
    ends = np.cumsum([len(part) for part in parts])

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        found = np.empty((stop - start, len(columns)))
        k = int(np.searchsorted(ends, start, side="right"))
        done = 0
        while done < len(found):
            first = start + done - (int(ends[k]) - len(parts[k]))
            piece = parts[k][first : first + len(found) - done]
            found[done : done + len(piece)] = piece[:, list(columns)]
            done += len(piece)
            k += 1
        return found

    return samples
