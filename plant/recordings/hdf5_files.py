"""HDF5, and so MATLAB v7.3: datasets are channels, sliced from the file when asked.

Links to other files are not followed. A unit is taken from a dataset's attribute ``unit`` or ``units``. MATLAB's struct
arrays, which are references there, are followed within the file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import Named, is_numeric, recording_of
from .recording import TEXT_LIMIT_BYTES, Recording, RecordingError

MOST_OBJECTS, MOST_REFERENCES = 10_000, 100_000
DEEPEST = 32
"""Groups within groups: a file that goes deeper goes in circles."""

MOST_COMPRESSED, SMALL_BYTES = 1100, 1 << 20
"""Bytes that one stored byte may stand for (deflate: 1032), and bytes that nobody counts."""

LEAVES = ("data", "value", "values", "signal", "samples", "y")
"""Names that say nothing: the group's is taken."""

_UNITS = ("unit", "units", "unit_string", "uom")
_LABELS = ("label", "name", "title", "channel")


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open an HDF5 recording (see `read_recording`)."""
    import h5py

    try:
        file = h5py.File(path, "r")
        found = _Collected(file)
        arrays, scalars = found.arrays(), found.scalars()
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        words = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: not an HDF5 file, or a damaged one ({words})") from None
    if not arrays and (found.skipped or found.others):
        raise RecordingError(
            f"{path}: no arrays of numbers, only {', '.join([*found.skipped, *found.others][:6])}: MATLAB objects "
            "(timeseries, tables) are opaque; save arrays with a vector 'time' instead"
        )
    _refuse_large_chunks(path, arrays)
    notes = (f"left out: {', '.join(found.skipped[:6])}",) if found.skipped else ()
    return recording_of(path, "HDF5", arrays, scalars, sample_rate_hz, notes)


class _Collected:
    """Datasets of a file by path; what lives in other files, and MATLAB's own bookkeeping, is skipped."""

    def __init__(self, file: Any):
        self._file = file
        self.numbers: dict[str, Any] = {}
        self.labels: dict[str, str] = {}
        self.others: list[str] = []
        self.skipped: list[str] = []
        self._groups: set[Any] = set()
        self._collect(file, "", 0)

    def _collect(self, group: Any, prefix: str, depth: int) -> None:
        import h5py

        where = h5py.h5o.get_info(group.id).addr
        if where in self._groups or depth > DEEPEST:
            return
        self._groups.add(where)
        for name in group:
            if name.startswith("#") or len(self.numbers) + len(self.skipped) > MOST_OBJECTS:
                continue
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                self.skipped.append(f"{prefix}{name} (a link)")
                continue
            item = group[name]
            if isinstance(item, h5py.Group):
                self._collect(item, f"{prefix}{name}/", depth + 1)
            elif isinstance(item, h5py.Dataset):
                self._take(item, f"{prefix}{name}", depth)

    def _take(self, item: Any, name: str, depth: int) -> None:
        """A dataset, or what its references refer to."""
        kind = _text(item.attrs.get("MATLAB_class", ""))
        outside = item.external is not None or item.is_virtual
        if outside or "MATLAB_object_decode" in item.attrs:
            self.skipped.append(f"{name} ({'data in another file' if outside else 'a MATLAB object ' + kind})")
        elif kind == "char":
            self.labels[name] = _characters(item)
        elif item.shape is None or "MATLAB_empty" in item.attrs:
            return
        elif is_numeric(item.dtype):
            self.numbers[name] = item
        elif item.dtype.kind == "O" and item.dtype.metadata and "ref" in item.dtype.metadata:
            self._follow(item, name, depth)
        elif item.dtype.kind in "SO" and item.shape == ():
            self.labels[name] = _text(item[()])
        else:
            self.others.append(name)

    def _follow(self, references: Any, name: str, depth: int) -> None:
        """Elements of a struct array or a cell: field f of element k is called prefix(k)/f."""
        import h5py

        if references.size > MOST_REFERENCES or depth > DEEPEST:
            self.others.append(name)
            return
        prefix, _, field = name.rpartition("/")
        for k, reference in enumerate(np.ravel(references[()]), start=1):
            item = self._file[reference] if reference else None
            place = f"{prefix}({k})/{field}" if prefix else f"{field}({k})"
            if isinstance(item, h5py.Group):
                self._collect(item, f"{place}/", depth + 1)
            elif isinstance(item, h5py.Dataset):
                self._take(item, place, depth + 1)

    def arrays(self) -> list[Named]:
        """Waveforms under names for people."""
        names = self._short_names()
        joined, single = _records({name: each for name, each in self.numbers.items() if each.size == 1})
        long = [
            Named(names[name], each, _unit(each), name.rpartition("/")[0])
            for name, each in self.numbers.items()
            if each.shape and name not in joined
        ]
        return [*long, *single]

    def scalars(self) -> dict[str, float]:
        """Numbers that stand alone, and attributes of the file and its datasets."""
        found = {
            name: float(np.ravel(each[()])[0])
            for name, each in self.numbers.items()
            if each.size == 1 and each.dtype.kind in "fiu"
        }
        for holder in (*self.numbers.values(), self._file):
            for key in holder.attrs:
                if key.lower() not in _UNITS and _is_scalar(value := holder.attrs[key]):
                    found[str(key)] = float(np.ravel(value)[0])
        return found

    def _short_names(self) -> dict[str, str]:
        """Labels, else the last part of a path where it says something and is the only one of that name."""
        leaves = Counter(
            name.rpartition("/")[0]
            for name, each in self.numbers.items()
            if each.size > 1 and name.rpartition("/")[2].lower() in LEAVES
        )
        names = {name: self._short_name(name, leaves) for name in self.numbers}
        given = Counter(names.values())
        shared = {short for short, n in given.items() if n > 1 and short.lower() not in ("time", "t")}
        return {name: name if short in shared else short for name, short in names.items()}

    def _short_name(self, name: str, leaves: Mapping[str, int]) -> str:
        group, _, last = name.rpartition("/")
        if last.lower() not in LEAVES or not group:
            return last
        label = next((self.labels[f"{group}/{key}"] for key in _LABELS if f"{group}/{key}" in self.labels), "")
        return label if label and leaves[group] == 1 else group.rpartition("/")[2]


def _records(singles: dict[str, Any]) -> tuple[set[str], list[Named]]:
    """A struct with one number per field and sample, s(1)/va, s(2)/va, ...: one waveform per field."""
    fields: dict[str, list[str]] = {}
    for name in singles:
        if found := re.fullmatch(r"(.*)\((\d+)\)/([^/]+)", name):
            fields.setdefault(f"{found[1]}/{found[3]}", []).append(name)
    taken: set[str] = set()
    waveforms = []
    for field, names in fields.items():
        if len(names) > 15:
            taken.update(names)
            values = np.array([np.ravel(singles[name][()])[0] for name in names])
            waveforms.append(Named(field.rpartition("/")[2], values, "", field.rpartition("/")[0]))
    return taken, waveforms


def _text(value: Any) -> str:
    """A text, or the first of an array of texts."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else ""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _characters(item: Any) -> str:
    """MATLAB's texts are arrays of numbers."""
    if item.size > 1000 or item.dtype.kind != "u":
        return ""
    return "".join(chr(int(code)) for code in np.ravel(item[()]) if code)


def _unit(dataset: Any) -> str:
    known = {key.lower(): key for key in dataset.attrs}
    return next((_text(dataset.attrs[known[name]]) for name in _UNITS if name in known), "").strip()


def _is_scalar(value: Any) -> bool:
    return np.size(value) == 1 and np.asarray(value).dtype.kind in "fiu"


def _refuse_large_chunks(path: Path, arrays: list[Named]) -> None:
    """A chunk is the least that can be decompressed; and no compression makes a thousandth of numbers."""
    for each in arrays:
        chunks = getattr(each.data, "chunks", None)
        if chunks and np.prod([float(n) for n in chunks]) * each.data.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise RecordingError(f"{path}: a chunk of {each.name!r} does not fit into memory; write smaller chunks")
        stored = each.data.id.get_storage_size() if hasattr(each.data, "id") else each.data.nbytes
        announced = float(each.data.size) * each.data.dtype.itemsize
        if announced > MOST_COMPRESSED * stored + SMALL_BYTES:
            raise RecordingError(
                f"{path}: {each.name!r} announces {announced / 2**20:.3g} MB, of which the file holds {stored} bytes: "
                "damaged, or never written"
            )
