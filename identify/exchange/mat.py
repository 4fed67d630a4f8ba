"""MATLAB files: Y as 2x2xN beside its frequencies, ready for ``frd(Y, 2*pi*f_hz)``; and saved ``frd`` objects.

A `.mat` file can be a bomb: every compressed element is inflated piece by piece first, and refused
when it grows beyond bounds; the data sets of version 7.3 are summed up before one is read.
"""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..files import atomic_file
from ..table.format import QUALITY, std_of
from .convert import Outgoing, the_one
from .facts import (
    MAX_BYTES,
    SET_POINT,
    TABLE_FACTS,
    ExchangeError,
    Facts,
    Found,
    Sheet,
    agreed,
    check_file,
    extra,
    frequency_factor,
    need_all,
    texts,
    unit_factor,
)

_HEADER = b"MATLAB 5.0 MAT-file, written by seqsweep".ljust(116)
_COMPRESSED = 15
_PIECE = 2**20
_TEXTS = ("frame", "direction", "quantity", "unit", "frequency_unit", "q_axis", "power_meaning", "op_id")
_NUMBERS = ("f1_hz", "rated_voltage_v", "rated_power_va", *SET_POINT)
_FREQUENCIES = {
    **{"f_hz": "Hz", "freq_hz": "Hz", "frequency_hz": "Hz", "w": "rad/s", "omega": "rad/s", "w_rad_s": "rad/s"},
    **dict.fromkeys(("f", "freq", "freqs", "frequency", "frequencies")),
}

DEEPEST, MOST_ELEMENTS = 6, 64
"""Structures within structures, and elements of an array of them, that are looked into."""

_RESPONSES = ("ResponseData", "Response")
_UNIT_NAMES = ("FrequencyUnit", "FrequencyUnit_", "FreqUnits", "Units")


# Writing


def write_mat(path: str | Path, out: Outgoing) -> None:
    """Write one response as MATLAB version 5; the same response gives the same bytes.

    Variables: ``Y`` (2x2xN, S), ``f_hz`` (Nx1), ``Y_std`` (2x2xN, pn frame), ``status``, ``reason`` (cells),
    the quality columns, and the facts by their names.
    """
    response = the_one(out, "a .mat file")
    point = out.point(str(response.meta["op_id"]))
    variables: dict[str, Any] = {
        "Y": np.moveaxis(response.y, 0, -1),
        "f_hz": response.f_hz[:, np.newaxis],
        "status": np.array(response.status, dtype=object)[:, np.newaxis],
        "reason": np.array(response.reason, dtype=object)[:, np.newaxis],
        **{name: values[:, np.newaxis] for name, values in response.quality.items()},
        **out.facts,
        **{key: np.nan if point[key] is None else point[key] for key in SET_POINT if key in point},
        "op_id": point["op_id"],
    }
    if response.frame == "pn":
        variables["Y_std"] = np.moveaxis(std_of(np.asarray(response.covariance)).reshape(-1, 2, 2), 0, -1)
        variables["f_mirror_hz"] = response.f_mirror_hz[:, np.newaxis]
    with atomic_file(path) as file:
        file.write(mat_bytes(variables))


def mat_bytes(variables: Mapping[str, Any]) -> bytes:
    """A version 5 file; equal variables give equal bytes, for scipy's header, which holds the time, is replaced."""
    from scipy.io import savemat

    buffer = io.BytesIO()
    savemat(buffer, variables, do_compression=True)
    return _HEADER + buffer.getvalue()[len(_HEADER) :]


# Reading


def read_mat(path: str | Path, given: Facts) -> Found:
    """Read a matrix and its frequencies, or a saved ``frd`` object.

    Parameters
    ----------
    path : path
        Version 5 to 7.3. The matrix is 2x2xN or Nx2x2; ``given["variable"]`` names it where there are several.
    given : mapping
        Facts that the user knows.

    Raises
    ------
    ExchangeError
        If it is no such file, inflates beyond bounds, or the matrix, its frequencies or a fact is missing.
    """
    check_file(path)
    variables = _flattened(variables_of(path))
    objects = {name: value for name, value in variables.items() if hasattr(value, "properties")}
    chosen = given.get("variable")
    matrices = {name: value for name, value in variables.items() if _is_matrix(value)}
    candidates = {**matrices, **objects}
    if chosen is not None and chosen not in candidates:
        raise ExchangeError(f"{path} has no matrix {chosen!r}; it has {', '.join(candidates) or 'none'}")
    names = [chosen] if chosen else [name for name in matrices if not name.endswith("Y_std")] or list(objects)
    if len(names) != 1:
        raise ExchangeError(
            f"{path}: {'several' if names else 'no'} 2x2xN matrices or frd objects among {', '.join(variables)[:200]}; "
            "--variable NAME says which"
        )
    if names[0] in objects:
        return _frd(path, names[0], variables[names[0]], given)
    return _plain(path, names[0], variables, given)


def _flattened(variables: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Variables, and the fields of structures by their paths, such as ``Z.ZDQ`` or ``scan(2).Y``."""
    found: dict[str, Any] = {}
    for key, value in variables.items():
        name = f"{prefix}{key}"
        found[name] = value
        if not (isinstance(value, np.ndarray) and value.dtype.names) or depth >= DEEPEST:
            continue
        elements = value.ravel()[:MOST_ELEMENTS]
        for number, element in enumerate(elements, start=1):
            fields = {field: element[field] for field in value.dtype.names}
            path = f"{name}." if len(elements) == 1 else f"{name}({number})."
            found |= _flattened(fields, path, depth + 1)
    return found


def _around(variables: Mapping[str, Any], name: str) -> dict[str, Any]:
    """What stands beside a variable in its structure, and beside that, by bare names."""
    found: dict[str, Any] = {}
    parent = name.rpartition(".")[0]
    prefixes = [""]
    while parent:
        prefixes.insert(1, f"{parent}.")
        parent = parent.rpartition(".")[0]
    for prefix in prefixes:
        inside = {key.removeprefix(prefix): value for key, value in variables.items() if key.startswith(prefix)}
        found |= {key: value for key, value in inside.items() if "." not in key}
    return found


def _plain(path: str | Path, name: str, variables: Mapping[str, Any], given: Facts) -> Found:
    variables = _around(variables, name)
    name = name.rpartition(".")[2]
    said: dict[str, Any] = {key: _text(variables[key]) for key in _TEXTS if key in variables}
    said |= {key: _number(variables[key]) for key in _NUMBERS if key in variables}
    if "quantity" not in said and name[:1].lower() in ("y", "z"):
        said["quantity"] = {"y": "admittance", "z": "impedance"}[name[0].lower()]
    matrix = _frequency_first(path, name, np.asarray(variables[name], dtype=complex))
    found = [key for key in variables if key.lower() in _FREQUENCIES and np.size(variables[key]) == len(matrix)]
    if len(found) != 1:
        known = ", ".join(_FREQUENCIES)
        raise ExchangeError(
            f"{path}: {len(found)} vectors of {len(matrix)} frequencies; needed: one of the names {known}"
        )
    named = _FREQUENCIES[found[0].lower()]
    facts = agreed({**said, "frequency_unit": named} if named else said, given, path)
    need_all(facts, (*TABLE_FACTS, "frequency_unit", "unit"), path)
    factor = frequency_factor(facts["frequency_unit"], path)
    f_hz = np.asarray(variables[found[0]], dtype=float).ravel() * factor
    scale = unit_factor(facts["unit"], facts, path)
    status, reason = (_texts(path, variables.get(key), len(matrix)) for key in ("status", "reason"))
    quality = {key: np.asarray(variables[key], dtype=float).ravel() for key in QUALITY if key in variables}
    return Found((Sheet(f_hz, matrix * scale, said, status, reason, quality),), facts)


def _frd(path: str | Path, name: str, model: Any, given: Facts) -> Found:
    """A saved object: some part of it has the response and the frequencies, some part their unit.

    MATLAB keeps what it shows as ``ResponseData`` in an inner object, as ``Response``; a property that
    was never set may not be in the file at all.
    """
    parts = list(_parts(model))
    key, data = next(((key, part) for part in parts for key in _RESPONSES if key in part), ("", {}))
    if not key or "Frequency" not in data:
        raise ExchangeError(f"{path}: {name} is an object without frequency response; needed: an frd, or Y and f_hz")
    if any(_has_delay(part["Delay"]) for part in parts if "Delay" in part):
        raise ExchangeError(f"{path}: {name} keeps delays apart from its response: save absorbDelay({name})")
    unit = next((_text(part[unit]) for part in parts for unit in _UNIT_NAMES if unit in part), None)
    facts = agreed({"frequency_unit": {"rad/TimeUnit": "rad/s"}.get(unit or "", unit)}, given, path)
    matrix = _frequency_first(path, name, np.asarray(data[key], dtype=complex))
    f_hz = np.asarray(data["Frequency"], dtype=float).ravel()
    need_all(facts, (*TABLE_FACTS, "frequency_unit", "unit"), path)
    f_hz = f_hz * frequency_factor(facts["frequency_unit"], path)
    return Found((Sheet(f_hz, matrix * unit_factor(facts["unit"], facts, path)),), facts)


def _has_delay(value: Any) -> bool:
    """Whether a number in a structure, however deep, is not zero."""
    if isinstance(value, Mapping):
        return any(_has_delay(inner) for inner in value.values())
    if isinstance(value, np.ndarray) and value.dtype.names:
        return any(_has_delay(value[name]) for name in value.dtype.names)
    if isinstance(value, np.ndarray) and value.dtype == object:
        return any(_has_delay(inner) for inner in value.ravel())
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and bool(np.any(value != 0))


def _parts(value: Any) -> Iterator[Mapping[str, Any]]:
    """Properties of an object and of the objects inside it."""
    if hasattr(value, "properties") and isinstance(value.properties, Mapping):
        yield value.properties
        for inner in value.properties.values():
            yield from _parts(inner)
    elif isinstance(value, np.ndarray) and value.dtype == object and value.size <= 16:
        for inner in value.ravel():
            yield from _parts(inner)


def _is_matrix(value: Any) -> bool:
    numeric = isinstance(value, np.ndarray) and value.dtype.kind in "fc"
    return numeric and (value.shape == (2, 2) or (value.ndim == 3 and (2, 2) in (value.shape[:2], value.shape[1:])))


def _frequency_first(path: str | Path, name: str, matrix: np.ndarray) -> np.ndarray:
    """(n, 2, 2) of 2x2xN, as MATLAB has it, or of Nx2x2; MATLAB drops the third dimension where N is one."""
    if not _is_matrix(matrix):
        raise ExchangeError(f"{path}: {name} is {'x'.join(map(str, matrix.shape))}; needed: 2x2xN")
    if matrix.ndim == 2:
        return matrix[np.newaxis]
    return np.moveaxis(matrix, -1, 0) if matrix.shape[:2] == (2, 2) else matrix


def _text(value: Any) -> str:
    return str(np.asarray(value).ravel()[0]) if np.size(value) else ""


def _number(value: Any) -> float | None:
    number = float(np.asarray(value, dtype=float).ravel()[0]) if np.size(value) else np.nan
    return None if np.isnan(number) else number


def _texts(path: str | Path, cells: Any, n: int) -> np.ndarray | None:
    """A cell of texts (n,), None where there is none; an empty text is an empty array there."""
    if cells is None:
        return None
    found = [_text(cell) for cell in np.asarray(cells).ravel()]
    return texts(found + [""] * (n - len(found)), path)


# Files


def variables_of(path: str | Path) -> dict[str, Any]:
    """Variables by name; objects keep their ``properties``."""
    from scipy.io import loadmat

    with open(path, "rb") as file:
        head = file.read(520)
    try:
        if head.startswith(b"\x89HDF") or head[512:516] == b"\x89HDF":
            _check_data_sets(path)
            return _public(_load_any(path))
        if not head.startswith(b"MATLAB 5.0 MAT-file"):
            raise ExchangeError(f"{path}: not a .mat file of version 5 to 7.3; --format says what it is")
        _check_inflated(path)
        if head[116:124].strip(b"\0 "):  # where the objects of the file are kept
            return _public(_load_any(path))
        return _public(loadmat(path))
    except ExchangeError:
        raise
    except Exception as error:  # readers raise whatever they trip over in a damaged file
        raise ExchangeError(f"{path}: damaged, or not a .mat file ({str(error).partition(chr(10))[0][:200]})") from None


def _load_any(path: str | Path) -> dict[str, Any]:
    """Everything, objects included, as far as their properties; nothing of them is built anew."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # mat-io sets an option that pandas deprecates
        return dict(extra("matio", "mat-io").load_from_mat(str(path), raw_data=True))


def _public(variables: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _check_inflated(path: str | Path) -> None:
    """Refuse a version 5 file whose compressed elements grow beyond `MAX_BYTES` in sum."""
    total = 0
    with open(path, "rb") as file:
        order = "<" if file.read(128)[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind == _COMPRESSED:
                total += _inflated(path, file, size, MAX_BYTES - total)
            file.seek(end)


def _inflated(path: str | Path, file: Any, size: int, room: int) -> int:
    """Bytes of one compressed element, counted piece by piece and thrown away."""
    inflate, total = zlib.decompressobj(), 0
    while size > 0:
        piece = file.read(min(size, _PIECE))
        if not piece:
            raise ExchangeError(f"{path}: truncated")
        size -= len(piece)
        while piece:
            total += len(inflate.decompress(piece, _PIECE))
            piece = inflate.unconsumed_tail
            if total > room:
                raise ExchangeError(f"{path} inflates to more than {MAX_BYTES / 2**20:.0f} MiB: it is not read")
    return total


def _check_data_sets(path: str | Path) -> None:
    """Refuse a version 7.3 file whose data sets are larger than `MAX_BYTES` in sum."""
    import h5py

    total = 0

    def add(name: str, item: Any) -> None:
        nonlocal total
        if isinstance(item, h5py.Dataset):
            total += item.size * item.dtype.itemsize if item.shape is not None else 0

    with h5py.File(path, "r") as file:
        file.visititems(add)
    if total > MAX_BYTES:
        raise ExchangeError(f"{path} holds {total / 2**20:.0f} MiB; at most {MAX_BYTES / 2**20:.0f} MiB are read")
