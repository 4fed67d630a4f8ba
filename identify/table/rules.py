"""What a conforming table satisfies beyond its columns: pure functions from values to violations."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..response import STATUSES
from .format import ELEMENTS, QUALITY, content_hash, std_of, unpack_covariance

Columns = Mapping[str, np.ndarray]

SCHEMA_FILE = Path(__file__).parents[1] / "schema" / "seqsweep-admittance-1.schema.json"

# A point that was never measured has no value; a measured one has, however doubtful. A singular V has none either.
MAY_BE_NAN = ("not_settled", "diverged", "failed", "ill_conditioned")

# Decimal text and another order of the sum may cost some last digits, never more.
RELATIVE_TOLERANCE = 1e-9


def metadata_violations(meta: Mapping[str, Any]) -> list[str]:
    """Violations of the JSON schema, names used twice, and a configuration that belies its hash."""
    import jsonschema

    validator = jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text(encoding="utf-8")))
    errors = sorted(validator.iter_errors(meta), key=lambda error: error.json_path)
    violations = [f"metadata {error.json_path}: {error.message[:200]}" for error in errors]
    if errors:
        return violations
    twice = [name for name, n in Counter(_op_ids(meta)).items() if n > 1]
    violations += [f"metadata: operating point {name!r} is listed twice" for name in twice]
    if content_hash(meta["configuration"]) != meta["configuration_sha256"]:
        violations.append("metadata: configuration_sha256 is not the hash of configuration")
    return violations


def row_violations(columns: Columns, meta: Mapping[str, Any]) -> list[str]:
    """Violations in the rows; one message per rule, naming the first row at fault and their number.

    Parameters
    ----------
    columns : mapping of str to (n,) arrays
        The columns of the table; ``cov`` is (n, 36).
    meta : mapping
        Its metadata; where ``f1_hz`` or ``operating_points`` are unusable their rules are left out.
    """
    return [
        *_operating_points(columns, meta),
        *_frequencies(columns, meta),
        *_statuses(columns),
        *_values(columns),
        *_covariances(columns),
        *_quality(columns),
    ]


def _op_ids(meta: Mapping[str, Any]) -> list[str]:
    """Names of the operating points in the metadata, as far as they are there."""
    points = meta.get("operating_points")
    named = [point for point in points if isinstance(point, dict)] if isinstance(points, list) else []
    return [str(point["op_id"]) for point in named if "op_id" in point]


def _operating_points(columns: Columns, meta: Mapping[str, Any]) -> list[str]:
    expected = _op_ids(meta)
    op_id = columns["op_id"]
    starts = np.flatnonzero(np.append(True, op_id[1:] != op_id[:-1])) if len(op_id) else np.array([], dtype=int)
    found = op_id[starts].tolist()
    counts = Counter(op_id.tolist())
    violations = [
        f"operating point {name!r} is in the metadata, not in the rows" for name in set(expected) - set(found)
    ]
    violations += [
        f"operating point {name!r} is in the rows, not in the metadata" for name in set(found) - set(expected)
    ]
    violations.sort()
    if not violations and found != expected:
        violations.append("rows are not in the order of the metadata's operating points, each in one piece")
    if len(set(counts.values())) > 1:
        sizes = ", ".join(f"{name} {n}" for name, n in list(counts.items())[:5])
        violations.append(f"operating points have different numbers of rows: {sizes}")
    return violations


def _frequencies(columns: Columns, meta: Mapping[str, Any]) -> list[str]:
    op_id, f_hz = columns["op_id"], columns["f_hz"]
    falling = np.append(False, (op_id[1:] == op_id[:-1]) & ~(np.diff(f_hz) > 0))
    positive = np.isfinite(f_hz) & (f_hz > 0)
    violations = _at_fault(columns, falling, "f_hz must increase strictly within an operating point")
    violations += _at_fault(columns, ~positive, "f_hz must be finite and above 0")
    f1_hz = meta.get("f1_hz")
    if not isinstance(f1_hz, int | float):
        return violations
    off = np.abs(columns["f_mirror_hz"] - (2.0 * f1_hz - f_hz))
    violations += _at_fault(
        columns, ~(off <= RELATIVE_TOLERANCE * (f1_hz + np.abs(f_hz))), "f_mirror_hz is not 2 f1 - f"
    )
    return violations + _at_fault(columns, f_hz == f1_hz, "the fundamental itself has no admittance")


def _at_fault(columns: Columns, rows: np.ndarray, text: str) -> list[str]:
    """No message if no row is at fault, else one: the first row, what is wrong, how many more."""
    found = np.flatnonzero(rows)
    if not len(found):
        return []
    first = found[0]
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return [f"{columns['op_id'][first]}, {columns['f_hz'][first]:g} Hz: {text}{more}"]


def _statuses(columns: Columns) -> list[str]:
    status = columns["status"]
    known = ", ".join(STATUSES)
    violations = _at_fault(columns, ~np.isin(status, STATUSES), f"unknown status; known: {known}")
    return violations + _at_fault(columns, (status != "ok") & (columns["reason"] == ""), "not ok, and no reason given")


def _values(columns: Columns) -> list[str]:
    parts = np.stack([columns[f"y_{element}_{part}"] for element in ELEMENTS for part in ("re", "im")], axis=1)
    may_be_nan = np.isin(columns["status"], MAY_BE_NAN)
    missing = np.any(~np.isfinite(parts), axis=1)
    partly = missing & ~np.all(np.isnan(parts), axis=1)
    violations = _at_fault(columns, missing & ~may_be_nan, f"y must be finite unless {', '.join(MAY_BE_NAN)}")
    return violations + _at_fault(columns, partly & may_be_nan, "y must be finite as a whole or NaN as a whole")


def _covariances(columns: Columns) -> list[str]:
    cov = columns["cov"]
    known = np.all(np.isfinite(cov), axis=1)
    unknown = np.all(np.isnan(cov), axis=1)
    violations = _at_fault(columns, ~known & ~unknown, "cov must be finite as a whole or NaN as a whole")
    violations += _at_fault(columns, ~_semidefinite(cov, known), "cov is no covariance: it has a negative eigenvalue")
    with np.errstate(invalid="ignore"):  # a negative variance is reported above
        expected = std_of(unpack_covariance(cov))
    stored = np.stack([columns[f"y_{element}_std"] for element in ELEMENTS], axis=1)
    agree = np.isclose(stored, expected, rtol=RELATIVE_TOLERANCE, atol=0.0, equal_nan=True)
    return violations + _at_fault(columns, ~np.all(agree, axis=1), "y_*_std is not sqrt(var re + var im) of cov")


def _semidefinite(cov: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(n,) bool: no eigenvalue below zero by more than rounding; unknown covariances pass."""
    passed = np.ones(len(cov), dtype=bool)
    if np.any(known):
        eigenvalues = np.linalg.eigvalsh(unpack_covariance(cov[known]))
        passed[known] = eigenvalues[:, 0] >= -RELATIVE_TOLERANCE * np.abs(eigenvalues).max(axis=1)
    return passed


def _quality(columns: Columns) -> list[str]:
    return [
        message
        for name in QUALITY
        for message in _at_fault(columns, columns[name] < 0, f"{name} must not be negative (NaN where unknown)")
    ]
