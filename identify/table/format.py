"""The format ``seqsweep-admittance``: its columns, its metadata with their hashes, and how covariances are packed.

``docs/table-format.md`` is the contract, ``schema/`` holds the JSON schema of the metadata and
`rules` what a conforming table must satisfy.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from typing import Any, NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError

FORMAT = "seqsweep-admittance"
VERSION = "1.1.0"
METADATA_KEY = b"seqsweep"

MIRROR = "f_mirror_hz = 2 f1_hz - f_hz, signed; the second component is the conjugate of the phasor found there"
DIRECTION = "current positive into the device under test (load direction)"
AMPLITUDE_PU = "peak over rated peak: sqrt(2/3) U for a voltage, sqrt(2) S / (sqrt(3) U) for a current"

ELEMENTS = ("pp", "pn", "np", "nn")
QUALITY = ("amplitude_pu", "n_periods", "window_s", "cond_v", "linearity", "residual")
UPPER = np.triu_indices(8)  # where the 36 entries of `cov` stand in the 8x8 matrix, row after row
N_COV = len(UPPER[0])

# Rows are regrouped to this size whatever the caller's portions, so that they leave no trace in the bytes.
ROW_GROUP_ROWS = 8192

_REQUIRED = {"f1_hz", "bases", "power_meaning", "operating_points", "configuration", "plant"}
_FIXED = {"format": FORMAT, "version": VERSION, "frame": "pn", "mirror": MIRROR, "direction": DIRECTION}
_BASES = {"rated_voltage_v", "rated_power_va"}
_POINT = {"op_id", "active_power_mw", "terminal_voltage_pu"}
CARRIED = ("stable_on", "fundamental")
"""Facts of an operating point that a response may carry in its ``meta``."""

_OPTIONAL = {*_FIXED, "configuration_sha256", "tool", "seeds", "region", "surrogate", "merged_from", "sha256"}


class TableError(SeqsweepError):
    """A file that is not a readable table, or rows and metadata that cannot become one."""


class Column(NamedTuple):
    """A column of the table; ``kind`` is "string", "double" or "list of double"."""

    name: str
    kind: str
    unit: str


COLUMNS = (
    Column("op_id", "string", ""),
    Column("f_hz", "double", "Hz"),
    Column("f_mirror_hz", "double", "Hz"),
    *(Column(f"y_{element}_{part}", "double", "S") for element in ELEMENTS for part in ("re", "im")),
    *(Column(f"y_{element}_std", "double", "S") for element in ELEMENTS),
    Column("cov", "list of double", "S^2"),
    Column("status", "string", ""),
    Column("reason", "string", ""),
    Column("amplitude_pu", "double", "pu"),
    Column("n_periods", "double", "1"),
    Column("window_s", "double", "s"),
    Column("cond_v", "double", "1"),
    Column("linearity", "double", "1"),
    Column("residual", "double", "1"),
)


# Metadata


def complete_metadata(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata as it is stored: definitions, tool version and hashes added to what the caller knows.

    Raises
    ------
    TableError
        If a required key is missing, a key is unknown, a fixed one differs, or a value is not JSON.
    """
    _check_keys(meta, _REQUIRED)
    _check_points(meta["operating_points"])
    completed = _completed(meta)
    return {**json.loads(canonical_json(completed)), "sha256": metadata_hash(completed)}


def complete_header(meta: Mapping[str, Any]) -> dict[str, Any]:
    """`complete_metadata` without the operating points, which come with their rows, and without the hash of all."""
    _check_keys(meta, _REQUIRED - {"operating_points"})
    return _completed(meta)


def _check_keys(meta: Mapping[str, Any], required: Set[str]) -> None:
    if missing := sorted(required - set(meta)):
        raise TableError(f"metadata lacks {', '.join(missing)}")
    if unknown := sorted(set(meta) - _REQUIRED - _OPTIONAL):
        raise TableError(f"metadata has no place for {', '.join(unknown)}; put it into configuration or plant")
    for key, value in _FIXED.items():
        if meta.get(key, value) != value:
            raise TableError(f"metadata {key} is {meta[key]!r}; this version of the format has {value!r}")
    if set(meta["bases"]) - {"amplitude_pu"} != _BASES:
        raise TableError(f"metadata bases are {', '.join(sorted(_BASES))}; given {', '.join(sorted(meta['bases']))}")


def _completed(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Definitions, tool version and the hash of the configuration added."""
    completed: dict[str, Any] = {"seeds": {}, "tool": _tool(), **meta, **_FIXED}
    completed["bases"] = {**meta["bases"], "amplitude_pu": AMPLITUDE_PU}
    completed["configuration_sha256"] = content_hash(meta["configuration"])
    return completed


def _check_points(points: Sequence[Mapping[str, Any]]) -> None:
    """Refuse operating points without name, power or voltage, and names used twice."""
    if not points:
        raise TableError("metadata has no operating points")
    for number, point in enumerate(points, start=1):
        check_point(point, number)
    counts = Counter(point["op_id"] for point in points)
    if twice := [name for name, n in counts.items() if n > 1]:
        raise TableError(f"operating point {twice[0]!r} is listed twice in the metadata")


def check_point(point: Mapping[str, Any], number: int) -> None:
    """Refuse an operating point without name, power or voltage."""
    if missing := sorted(_POINT - set(point)):
        raise TableError(f"operating point {number} of the metadata lacks {', '.join(missing)}")


def metadata_hash(meta: Mapping[str, Any]) -> str:
    """Hash of the metadata without the hash itself: Parquet checksums its pages, not its footer."""
    return content_hash({key: value for key, value in meta.items() if key != "sha256"})


def content_hash(value: Any) -> str:
    """sha256 (hexadecimal) of the canonical JSON of ``value``."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no blanks: equal values give equal text.

    Raises
    ------
    TableError
        If ``value`` holds something JSON does not know, NaN and infinity included.
    """
    try:
        return json.dumps(
            value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_plain
        )
    except (TypeError, ValueError) as error:
        raise TableError(f"metadata must be JSON: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} {value!r} has no JSON form")


def _tool() -> dict[str, str]:
    from importlib.metadata import version

    return {"name": "seqsweep", "version": version("seqsweep")}


# Columns as arrays


def pack_covariance(covariance: np.ndarray) -> np.ndarray:
    """Upper triangles (n, 36) of symmetric matrices (n, 8, 8), row after row (S^2)."""
    return covariance[:, UPPER[0], UPPER[1]]


def unpack_covariance(cov: np.ndarray) -> np.ndarray:
    """Symmetric matrices (n, 8, 8) from their upper triangles (n, 36) (S^2)."""
    covariance = np.empty((len(cov), 8, 8))
    covariance[:, UPPER[0], UPPER[1]] = cov
    covariance[:, UPPER[1], UPPER[0]] = cov
    return covariance


def std_of(covariance: np.ndarray) -> np.ndarray:
    """Standard deviations (n, 4) of the complex pp, pn, np, nn: sqrt(var re + var im) (S)."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.sqrt(variance[:, 0::2] + variance[:, 1::2])


def joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Columns of several parts, one after the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
