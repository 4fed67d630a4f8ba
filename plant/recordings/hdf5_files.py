"""HDF5, and so MATLAB v7.3: datasets are channels, sliced from the file when asked.

Links to other files are not followed. A unit is taken from a dataset's attribute ``unit`` or ``units``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .arrays import recording_of
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError

MOST_OBJECTS = 10_000


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open an HDF5 recording (see `read_recording`)."""
    import h5py

    try:
        file = h5py.File(path, "r")
        found: dict[str, Any] = {}
        skipped: list[str] = []
        _collect(file, "", found, skipped)
    except (OSError, RuntimeError, KeyError) as error:
        raise RecordingError(f"{path}: not an HDF5 file, or a damaged one ({str(error)[:120]})") from None
    numbers = {name: each for name, each in found.items() if each.dtype.kind in "fiu"}
    if not numbers and (skipped or found):
        raise RecordingError(
            f"{path}: no arrays of numbers, only {', '.join([*skipped, *found][:6])}: MATLAB objects (timeseries, "
            "tables) are opaque; save arrays with a vector 'time' instead"
        )
    _refuse_large_chunks(path, numbers)
    short = {name: _short_name(name, numbers) for name in numbers}
    units = {short[name]: _unit(each) for name, each in numbers.items()}
    scalars = {
        short[name]: float(each[()].ravel()[0]) for name, each in numbers.items() if each.size == 1 and each.shape
    }
    scalars |= {short[name]: float(each[()]) for name, each in numbers.items() if each.shape == ()}
    scalars |= {str(key): float(value) for key, value in file.attrs.items() if _is_scalar(value)}
    notes = (f"left out: {', '.join(skipped[:6])}",) if skipped else ()
    arrays = {short[name]: each for name, each in numbers.items() if each.shape}
    return recording_of(path, "HDF5", arrays, scalars, units, sample_rate_hz, notes)


def _collect(group: Any, prefix: str, found: dict[str, Any], skipped: list[str]) -> None:
    """Datasets below a group by path; what lives in other files, and MATLAB's own bookkeeping, is skipped."""
    import h5py

    for name in group:
        if name.startswith("#") or len(found) + len(skipped) > MOST_OBJECTS:
            continue
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            skipped.append(f"{prefix}{name} (a link)")
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            _collect(item, f"{prefix}{name}/", found, skipped)
        elif isinstance(item, h5py.Dataset):
            outside = item.external is not None or item.is_virtual
            kind = str(item.attrs.get("MATLAB_class", b""))
            if outside or "MATLAB_object_decode" in item.attrs:
                skipped.append(f"{prefix}{name} ({'data in another file' if outside else 'a MATLAB object ' + kind})")
            else:
                found[f"{prefix}{name}"] = item


def _short_name(name: str, among: dict[str, Any]) -> str:
    """The last part of a path where it is the only one of that name."""
    last = name.rsplit("/", 1)[-1]
    return last if sum(other.rsplit("/", 1)[-1] == last for other in among) == 1 else name


def _unit(dataset: Any) -> str:
    value = dataset.attrs.get("unit", dataset.attrs.get("units", ""))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _is_scalar(value: Any) -> bool:
    return np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"


def _refuse_large_chunks(path: Path, datasets: dict[str, Any]) -> None:
    """A chunk is the least that can be decompressed."""
    for name, each in datasets.items():
        if each.chunks and np.prod([float(n) for n in each.chunks]) * each.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise RecordingError(f"{path}: a chunk of {name!r} does not fit into memory; write smaller chunks")
