"""judge.parquet: one row per pair of grid and operating point, worst first (format ``seqsweep-judge``)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...identify.files import atomic_file
from ...tuning.bank.judgement import PairVerdict

FORMAT, VERSION = "seqsweep-judge", "1.1.0"

COLUMNS: dict[str, tuple[str, str, str]] = {
    "grid_id": ("string", "", "the grid: file, table or member of the family"),
    "op_id": ("string", "", "operating point of the device"),
    "status": ("string", "", "ok, or failed: the grid could not be read"),
    "verdict": ("string", "", "stable, unstable or undecided"),
    "probability": ("float64", "1", "probability that the loop is stable"),
    "reason": ("string", "", "why"),
    "grid": ("string", "", "the grid in one line"),
    "r_ohm": ("float64", "ohm", "resistance of the grid at the fundamental"),
    "x_ohm": ("float64", "ohm", "reactance of the grid at the fundamental"),
    "n_unstable": ("int64", "1", "unstable closed-loop modes, conjugates counted"),
    "margin_m": ("float64", "1", "m at the critical crossing"),
    "mode_lower_hz": ("float64", "Hz", "the deciding mode in phase quantities: f1 - |Im|/2pi"),
    "mode_upper_hz": ("float64", "Hz", "the same: f1 + |Im|/2pi"),
    "re_rad_s": ("float64", "rad/s", "real part of the deciding pole"),
    "im_rad_s": ("float64", "rad/s", "imaginary part of it, dq frame"),
    "re_std_rad_s": ("float64", "rad/s", "standard error of its real part, device and grid together"),
    "damping": ("float64", "1", "damping ratio of the deciding mode, -Re/|pole|"),
    "critical_scale": ("float64", "1", "multiplier of the grid's impedance at the edge of stability"),
    "region_distance": ("float64", "1", "of a region: distance of zero from det(1 + Y Z) of all members, 1: no grid"),
    "region_growth": ("float64", "1", "of a region: multiple of its extent at which it is no longer decided"),
    "missing_f_min_hz": ("float64", "Hz", "band in which the grid was to be measured, lower end"),
    "missing_f_max_hz": ("float64", "Hz", "the same, upper end"),
    "elements": ("elements", "", "critical value of each element, the others unchanged"),
    "parameters": ("string", "", "what the family varied, as JSON"),
    "warnings": ("strings", "", "what the reader should know"),
}
"""Every column: kind, unit, meaning."""


ROW_GROUP = 4096
"""Pairs that are in memory at a time, and in one row group of the file."""


def write_judge(verdicts: Sequence[PairVerdict], f1_hz: float, path: Path, provenance: Mapping[str, Any]) -> None:
    """Write the pairs in the order given, atomically; the same pairs give the same bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    about = {"format": FORMAT, "version": VERSION, "f1_hz": f1_hz, "provenance": dict(provenance)}
    schema = pa.schema(
        [
            pa.field(name, _kinds(pa)[kind], metadata={"unit": unit, "meaning": meaning})
            for name, (kind, unit, meaning) in COLUMNS.items()
        ],
        metadata={"seqsweep": json.dumps(about, sort_keys=True)},
    )
    with (
        atomic_file(path) as file,
        pq.ParquetWriter(file, schema, compression="zstd", write_page_checksum=True) as writer,
    ):
        for first in range(0, max(len(verdicts), 1), ROW_GROUP):
            rows = [row_of(verdict, f1_hz) for verdict in verdicts[first : first + ROW_GROUP]]
            writer.write_table(pa.Table.from_pylist(rows, schema=schema))


def row_of(verdict: PairVerdict, f1_hz: float) -> dict[str, Any]:
    """One pair as the columns have it."""
    nu = None if verdict.im_rad_s is None else abs(verdict.im_rad_s) / (2.0 * 3.141592653589793)
    low, high = verdict.missing_hz or (None, None)
    plain = {name: getattr(verdict, name) for name in COLUMNS if hasattr(verdict, name)}
    return {
        **plain,
        "mode_lower_hz": None if nu is None else f1_hz - nu,
        "mode_upper_hz": None if nu is None else f1_hz + nu,
        "missing_f_min_hz": low,
        "missing_f_max_hz": high,
        "elements": [edge._asdict() for edge in verdict.elements],
        "parameters": json.dumps(dict(verdict.parameters), sort_keys=True) if verdict.parameters else "",
        "warnings": list(verdict.warnings),
    }


def _kinds(pa: Any) -> dict[str, Any]:
    edge = pa.struct(
        [("element", pa.string()), ("key", pa.string()), ("value", pa.float64()), ("critical", pa.float64())]
    )
    return {
        "string": pa.string(),
        "float64": pa.float64(),
        "int64": pa.int64(),
        "elements": pa.list_(edge),
        "strings": pa.list_(pa.string()),
    }
