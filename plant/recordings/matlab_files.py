"""MATLAB .mat: v5 to v7 through scipy, v7.3 through HDF5. Plain arrays, and Simulink's "structure with time".

Objects (timeseries, tables, classes) are opaque outside MATLAB and refused by name; nothing in a file is executed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .arrays import recording_of
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError

_NUMBERS = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_WAY_OUT = "save arrays with a vector 'time' instead, or 'Structure with time'"


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a MATLAB recording (see `read_recording`)."""
    with open(path, "rb") as file:
        head = file.read(1 << 10)
    if b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in head:
        from .hdf5_files import read as read_hdf5

        return read_hdf5(path, sample_rate_hz)
    return _read_v5(path, sample_rate_hz)


def _read_v5(path: Path, sample_rate_hz: float | None) -> Recording:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        listed = whosmat(path)
        wanted = [name for name, _, kind in listed if kind in (*_NUMBERS, "struct")]
        _refuse_large(path, listed)
        content = loadmat(path, variable_names=wanted, struct_as_record=False, squeeze_me=False) if wanted else {}
    except (MatReadError, ValueError, TypeError, OSError, KeyError, IndexError, NotImplementedError, EOFError) as error:
        if isinstance(error, RecordingError):
            raise
        words = f"{type(error).__name__}: {error}"[:160]
        raise RecordingError(f"{path}: not a MATLAB file, or a damaged one ({words})") from None
    except Exception as error:  # scipy's reader meets damaged bytes in many places (zlib.error, ...)
        raise RecordingError(f"{path}: damaged MATLAB file ({type(error).__name__}: {str(error)[:120]})") from None
    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name in wanted:
        if isinstance(content[name], np.ndarray) and content[name].dtype.kind in "fiu":
            arrays[name] = content[name]
        else:
            _structure_with_time(name, content[name], arrays, units)
    objects = [f"{name} ({kind})" for name, _, kind in listed if kind in ("opaque", "object", "function", "unknown")]
    if objects and not arrays:
        raise RecordingError(f"{path}: holds objects only: {', '.join(objects[:6])}; {_WAY_OUT}")
    notes = (f"objects are left out: {', '.join(objects[:6])}",) if objects else ()
    scalars = {name: float(array.ravel()[0]) for name, array in arrays.items() if array.size == 1}
    return recording_of(path, "MATLAB", arrays, scalars, units, sample_rate_hz, notes)


def _refuse_large(path: Path, listed: list[tuple[str, tuple[int, ...], str]]) -> None:
    """The size of a variable is known before it is decompressed."""
    n_bytes = {name: 8.0 * np.prod([float(n) for n in shape]) for name, shape, kind in listed if kind in _NUMBERS}
    if sum(n_bytes.values()) > TEXT_LIMIT_BYTES:
        worst = max(n_bytes, key=lambda name: n_bytes[name])
        raise RecordingError(
            f"{path}: {sum(n_bytes.values()) / 2**30:.3g} GB when decompressed (largest: {worst!r}); up to "
            f"{TEXT_LIMIT_BYTES / 2**30:.3g} GB are read: save it with -v7.3, or cut it into several files"
        )


def _structure_with_time(name: str, value: Any, arrays: dict[str, Any], units: dict[str, str]) -> None:
    """Add ``s.time`` and the signals of a Simulink log, ``s.signals(k).values`` called ``s.signals(k).label``."""
    record = value.ravel()[0] if isinstance(value, np.ndarray) and value.size == 1 else None
    time, signals = getattr(record, "time", None), getattr(record, "signals", None)
    if not isinstance(time, np.ndarray) or not isinstance(signals, np.ndarray) or time.dtype.kind not in "fiu":
        return
    arrays.setdefault("time", time)
    for k, signal in enumerate(signals.ravel()):
        values, label = getattr(signal, "values", None), getattr(signal, "label", None)
        if isinstance(values, np.ndarray) and values.dtype.kind in "fiu":
            written = str(np.asarray(label).ravel()[0]) if label is not None and np.size(label) else ""
            arrays[written.strip() or f"{name}_{k + 1}"] = values
