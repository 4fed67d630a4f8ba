"""MDF4 (measurement of ECUs), with the extra ``formats``: the channel group with most samples."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .recording import TEXT_LIMIT_BYTES, Channel, Recording, RecordingError
from .timebase import TimeBase, time_base


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open an MDF4 recording (see `read_recording`)."""
    try:
        from asammdf import MDF
    except ImportError:
        raise RecordingError(f"{path}: MDF4 needs the extra: pip install 'seqsweep[formats]'") from None
    try:
        file = MDF(path)
        counts = [group.channel_group.cycles_nr for group in file.groups]
        number = int(np.argmax(counts))
        if counts[number] * len(file.groups[number].channels) * 8 > TEXT_LIMIT_BYTES:
            raise RecordingError(f"{path}: {counts[number]} samples do not fit into memory; cut it into several files")
        signals = list(file.select([(None, number, k) for k in range(len(file.groups[number].channels))]))
    except RecordingError:
        raise
    except Exception as error:
        raise RecordingError(f"{path}: not an MDF4 file, or a damaged one ({type(error).__name__}: {error})") from None
    times = np.asarray(signals[0].timestamps, dtype=float) if signals else np.empty(0)
    base = TimeBase(0.0, 1.0 / sample_rate_hz) if sample_rate_hz else time_base(path, [times])
    used = [
        s
        for s in signals
        if s.samples.dtype.kind in "fiu" and s.samples.ndim == 1 and s.name.lower() not in ("t", "time")
    ]

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return np.array([np.asarray(used[k].samples[start:stop], dtype=float) for k in columns]).T

    channels = tuple(Channel(each.name, each.unit or "") for each in used)
    return Recording(path, "MDF4", channels, len(times), base.t0_s, base.dt_s, samples, notes=base.notes)
