"""TDMS (LabVIEW), with the extra ``formats``: the channels with most samples, read into memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .number_table import refuse_too_large
from .recording import Channel, Recording, RecordingError


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a TDMS recording (see `read_recording`)."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise RecordingError(f"{path}: TDMS needs the extra: pip install 'seqsweep[formats]'") from None
    refuse_too_large(path, path.stat().st_size)
    try:
        file = TdmsFile.read(path)
        found = [
            each for group in file.groups() for each in group.channels() if len(each) > 1 and each.dtype.kind in "fiu"
        ]
    except Exception as error:
        raise RecordingError(f"{path}: not a TDMS file, or a damaged one ({type(error).__name__}: {error})") from None
    n = max((len(each) for each in found), default=0)
    used = [each for each in found if len(each) == n]
    steps = {float(each.properties.get("wf_increment", 0.0)) for each in used}
    dt_s = 1.0 / sample_rate_hz if sample_rate_hz else (steps.pop() if len(steps) == 1 else 0.0)
    if used and not dt_s > 0.0:
        raise RecordingError(f"{path}: channels without a common step (wf_increment): give --sample-rate HZ")

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        return np.array([np.asarray(used[k][start:stop], dtype=float) for k in columns]).T

    units = [str(each.properties.get("unit_string", each.properties.get("NI_UnitDescription", ""))) for each in used]
    channels = tuple(Channel(each.name, unit) for each, unit in zip(used, units, strict=True))
    return Recording(path, "TDMS", channels, n, 0.0, dt_s, samples)
