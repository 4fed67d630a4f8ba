"""MATLAB .mat: v5 to v7 through scipy, v7.3 through HDF5. Arrays, structures of them, Simulink's "structure with time".

Objects (timeseries, tables, classes) are opaque outside MATLAB and refused by name; nothing in a file is executed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .arrays import SMALLEST, Named, is_numeric, recording_of
from .hdf5_files import LEAVES
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError

_NUMBERS = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_WAY_OUT = "save arrays with a vector 'time' instead, or 'Structure with time'"
_LABELS = ("label", "name", "title", "channel")
_UNITS = ("unit", "units")
DEEPEST = 16


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

    try:
        listed = whosmat(path)
        wanted = [name for name, _, kind in listed if kind in (*_NUMBERS, "struct", "cell")]
        _refuse_large(path, listed)
        content = loadmat(path, variable_names=wanted, struct_as_record=False, squeeze_me=False) if wanted else {}
        arrays = [named for name in wanted for named in _arrays(name, content[name], "", 0)]
    except RecordingError:
        raise
    except Exception as error:  # scipy's reader meets damaged bytes in many places (zlib.error, ...)
        words = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: not a MATLAB file, or a damaged one ({type(error).__name__}: {words})") from None
    objects = [f"{name} ({kind})" for name, _, kind in listed if kind in ("opaque", "object", "function", "unknown")]
    if objects and not arrays:
        raise RecordingError(f"{path}: holds objects only: {', '.join(objects[:6])}; {_WAY_OUT}")
    notes = (f"objects are left out: {', '.join(objects[:6])}",) if objects else ()
    scalars = {each.name: float(np.real(each.data.ravel()[0])) for each in arrays if each.data.size == 1}
    return recording_of(path, "MATLAB", _told_apart(arrays), scalars, sample_rate_hz, notes)


def _refuse_large(path: Path, listed: list[tuple[str, tuple[int, ...], str]]) -> None:
    """The size of a variable is known before it is decompressed."""
    n_bytes = {name: 8.0 * np.prod([float(n) for n in shape]) for name, shape, kind in listed if kind in _NUMBERS}
    if sum(n_bytes.values()) > TEXT_LIMIT_BYTES:
        worst = max(n_bytes, key=lambda name: n_bytes[name])
        raise RecordingError(
            f"{path}: {sum(n_bytes.values()) / 2**30:.3g} GB when decompressed (largest: {worst!r}); up to "
            f"{TEXT_LIMIT_BYTES / 2**30:.3g} GB are read: save it with -v7.3, or cut it into several files"
        )


# Structures


def _arrays(name: str, value: Any, parent: str, depth: int) -> list[Named]:
    """Arrays of numbers in a variable, by the names that people gave them."""
    if not isinstance(value, np.ndarray) or depth > DEEPEST:
        return []
    if is_numeric(value.dtype):
        return [Named(name, value, "", parent)] if value.size else []
    if value.dtype != object:
        return []
    elements = list(value.ravel())
    if elements and all(hasattr(each, "_fieldnames") for each in elements):
        return _of_structs(name, elements, depth)
    return [
        named
        for k, each in enumerate(elements, start=1)
        for named in _arrays(f"{name}{{{k}}}", each, f"{name}{{{k}}}", depth + 1)
    ]


def _of_structs(name: str, elements: list[Any], depth: int) -> list[Named]:
    """Arrays of a structure, of each of several, or of a structure per sample."""
    if len(elements) == 1:
        return _simulink(name, elements[0]) or _of_struct(name, elements[0], depth)
    fields = [str(field) for field in elements[0]._fieldnames]
    if len(elements) >= SMALLEST and all(
        _is_number(getattr(each, field, None)) for each in elements for field in fields
    ):
        return [
            Named(field, np.array([getattr(each, field).ravel()[0] for each in elements]), "", name) for field in fields
        ]
    return [named for k, each in enumerate(elements, start=1) for named in _of_struct(f"{name}({k})", each, depth)]


def _of_struct(name: str, element: Any, depth: int) -> list[Named]:
    """Arrays of one structure; the only long one in it goes by its label, or by the structure's own name."""
    found = [
        named
        for field in element._fieldnames
        for named in _arrays(str(field), getattr(element, field), name, depth + 1)
    ]
    unit = _said(element, _UNITS)
    label = _said(element, _LABELS) or name.rsplit(".", 1)[-1]
    return [
        named._replace(name=label, unit=named.unit or unit)
        if named.parent == name and named.name.lower() in LEAVES
        else named._replace(parent=f"{name}.{named.parent}" if named.parent != name else name)
        for named in found
    ]


def _simulink(name: str, record: Any) -> list[Named]:
    """``s.time`` and the signals of a Simulink log, ``s.signals(k).values`` called ``s.signals(k).label``."""
    time, signals = getattr(record, "time", None), getattr(record, "signals", None)
    if not isinstance(time, np.ndarray) or not isinstance(signals, np.ndarray) or time.dtype.kind not in "fiu":
        return []
    found = [Named("time", time, "", name)] if time.size else []
    for k, signal in enumerate(signals.ravel()):
        values = getattr(signal, "values", None)
        if isinstance(values, np.ndarray) and is_numeric(values.dtype):
            found.append(Named(_said(signal, _LABELS) or f"{name}_{k + 1}", values, "", name))
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size == 1


def _said(element: Any, names: tuple[str, ...]) -> str:
    """The text of the first such field that has one."""
    for field in element._fieldnames:
        value = getattr(element, field, None)
        if str(field).lower() in names and isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.size:
            return str(value.ravel()[0]).strip()
    return ""


def _told_apart(arrays: list[Named]) -> list[Named]:
    """Names that two structures share get the structure's; times may share theirs."""
    names = [each.name for each in arrays]
    return [
        each._replace(name=f"{each.parent}.{each.name}")
        if names.count(each.name) > 1 and each.parent and each.name.lower() not in ("time", "t")
        else each
        for each in arrays
    ]
