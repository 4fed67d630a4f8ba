"""Metrics as text and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from ..identify.files import write_json as write_whole
from ..identify.views.html import html_table
from .intervals import NORMAL_95
from .layout import labelled, wrapped
from .metrics import MISFIT_LIMIT, SUB_TRANSIENT_HZ, Least, Metrics, Response, Swing

_UNITS = {
    "voltage": "pu of rated line-to-line RMS",
    "power": "pu of rated apparent power, out of the device",
    "nu_hz": "Hz, |f - f1|",
    "angle": "rad",
}


def format_report(m: Metrics, width: int = 80) -> str:
    """One operating point in lines no wider than ``width``."""
    where = "at its own terminals" if m.behind is None else f"from the source behind {m.behind}"
    low, high = SUB_TRANSIENT_HZ
    band = f"{low:g} to {high:g} Hz"
    rows = [
        (f"  least |dP/dtheta| from {band}", _least_text(m.p_stiffness, "pu/rad")),
        (f"  least |dQ/dV| from {band}", _least_text(m.q_stiffness, "pu/pu")),
        (f"  least voltage stiffness from {band}", _least_text(m.voltage_stiffness_db, "dB")),
        *_swing_rows(m.swing),
        ("  passive where nu is", _bands_text(m)),
    ]
    head = wrapped(f"{m.op_id}: {point_text(m)}, {where}", width)
    return "\n".join([*head, labelled(rows, width)])


def as_html(m: Metrics) -> str:
    """One operating point as a small HTML table, for a notebook."""
    rows = [
        ("least |dP/dtheta|", _least_text(m.p_stiffness, "pu/rad")),
        ("least |dQ/dV|", _least_text(m.q_stiffness, "pu/pu")),
        ("least voltage stiffness", _least_text(m.voltage_stiffness_db, "dB")),
        *((name.strip(), text) for name, text in _swing_rows(m.swing)),
        ("passive where |f - f1| is", _bands_text(m)),
    ]
    return html_table(f"{m.op_id}: {point_text(m)}", ("metric", "value"), rows)


def point_text(m: Metrics) -> str:
    """P, Q and |v| in per unit; what is nothing but rounding is zero."""
    p, q, v = (round(x, 9) + 0.0 for x in m.point)
    return f"P {p:.4g} pu, Q {q:.4g} pu, |v| {v:.4g} pu"


def _swing_rows(swing: Swing | str) -> list[tuple[str, str]]:
    name = "  swing equation"
    if isinstance(swing, str):
        return [(name, f"not fitted: {swing}")]
    fitted = f"{swing.n_rows} rows, nu from {swing.band_hz[0]:.3g} to {swing.band_hz[1]:.3g} Hz"
    if not swing.is_swing:
        return [
            (name, f"withheld: the misfit is {100 * swing.misfit:.3g} %, above {100 * MISFIT_LIMIT:g} % ({fitted})")
        ]
    k, m_s, d = (_with_doubt(x, std) for x, std in zip((swing.k, swing.m_s, swing.d), swing.std, strict=True))
    return [
        (name, f"M = {m_s} s, D = {d} pu, K = {k} pu/rad"),
        ("", f"misfit {100 * swing.misfit:.2g} %, {fitted}"),
    ]


def _least_text(least: Least | None, unit: str) -> str:
    if least is None:
        return "- (no row in that band)"
    return f"{_with_doubt(least.value, least.std)} {unit} at {least.at_hz:.4g} Hz"


def _with_doubt(value: float, std: float) -> str:
    """A number, and its 95 % interval where that shows in four digits."""
    if not isfinite(std) or NORMAL_95 * std < 5e-4 * abs(value):
        return f"{value:.4g}"
    return f"{value:.4g} +- {NORMAL_95 * std:.2g}"


def _bands_text(m: Metrics) -> str:
    if not m.passive_bands_hz:
        return "nowhere"
    return ", ".join(f"{low:.4g} to {high:.4g} Hz" for low, high in m.passive_bands_hz)


def write_json(found: Sequence[Metrics], meta: Mapping[str, Any], path: str | Path) -> None:
    """The document of ``seqsweep metrics -o``, atomically; see the schema seqsweep-metrics-1."""
    write_whole(path, to_json(found, meta))


def to_json(found: Sequence[Metrics], meta: Mapping[str, Any]) -> dict[str, Any]:
    """The document as plain values; ``meta`` is that of the table."""
    return {
        "format": "seqsweep-metrics",
        "version": "1.0.0",
        "units": _UNITS,
        "f1_hz": meta["f1_hz"],
        "provenance": {"table_sha256": meta.get("sha256"), "plant": meta.get("plant"), "tool": meta.get("tool")},
        "operating_points": [_point_json(each) for each in found],
    }


def schema() -> dict[str, Any]:
    """The JSON schema of the document."""
    text = files(__package__).joinpath("schema/seqsweep-metrics-1.schema.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def _point_json(m: Metrics) -> dict[str, Any]:
    return {
        "op_id": m.op_id,
        "active_power_pu": m.point.p,
        "reactive_power_pu": m.point.q,
        "voltage_pu": m.point.v,
        "behind": m.behind,
        "nu_hz": m.nu_hz.tolist(),
        "dp_dtheta": _response_json(m.p_theta),
        "dp_dv": _response_json(m.p_v),
        "dq_dtheta": _response_json(m.q_theta),
        "dq_dv": _response_json(m.q_v),
        "network_frequency_perturbation": _response_json(m.nfp),
        "swing": _swing_json(m.swing),
        "dp_dtheta_least": _least_json(m.p_stiffness),
        "dq_dv_least": _least_json(m.q_stiffness),
        "voltage_stiffness_least_db": _least_json(m.voltage_stiffness_db),
        "passivity_index_pu": _numbers(m.passivity),
        "passivity_index_std_pu": _numbers(m.passivity_std),
        "passive_bands_hz": [list(band) for band in m.passive_bands_hz],
    }


def _response_json(of: Response) -> dict[str, Any]:
    return {
        "magnitude_pu": _numbers(np.abs(of.value)),
        "magnitude_std_pu": _numbers(of.magnitude_std),
        "phase_deg": _numbers(np.degrees(np.angle(of.value))),
        "phase_std_deg": _numbers(of.phase_std_deg),
    }


def _swing_json(swing: Swing | str) -> dict[str, Any]:
    if isinstance(swing, str):
        return {"fitted": False, "reason": swing}
    facts: dict[str, Any] = {
        "fitted": True,
        "misfit": swing.misfit,
        "from_hz": swing.band_hz[0],
        "to_hz": swing.band_hz[1],
        "rows": swing.n_rows,
        "withheld": not swing.is_swing,
    }
    if swing.is_swing:
        names = ("k_pu_per_rad", "m_s", "d_pu")
        facts |= dict(zip(names, (swing.k, swing.m_s, swing.d), strict=True))
        facts |= {f"{name}_std": _number(x) for name, x in zip(names, swing.std, strict=True)}
    return facts


def _least_json(least: Least | None) -> dict[str, Any] | None:
    return None if least is None else {"value": least.value, "at_hz": least.at_hz, "std": _number(least.std)}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [_number(x) for x in values]


def _number(x: float) -> float | None:
    return float(x) if isfinite(x) else None
