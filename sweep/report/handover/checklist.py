"""What operators ask of a scan, and where this report answers it; an honest "not covered" for the rest."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from .inputs import Inputs


class Item(NamedTuple):
    """One demand: its words, its source, whether it is covered, and the answer."""

    text: str
    source: str
    covered: bool
    answer: str


def checked(inputs: Inputs) -> list[Item]:
    """Every demand of the profile with its answer."""
    text = files(__package__).joinpath("profiles", "scan.toml").read_text("utf-8")
    return [_item(demand, inputs) for demand in tomllib.loads(text)["demand"]]


def _item(demand: dict[str, str], inputs: Inputs) -> Item:
    answer = _ANSWERS[demand["answer"]](inputs) if "answer" in demand else ""
    covered = bool(answer)
    if "threshold" in demand and not demand["threshold"] and covered:
        answer += " No threshold is applied: its source could not be read."
    return Item(demand["text"], demand["source"], covered, answer or "Not covered by this report.")


def _matrix(inputs: Inputs) -> str:
    return "The table holds Ypp, Ypn, Ynp and Ynn of every row (section Admittance)."


def _band(inputs: Inputs) -> str:
    f = np.concatenate([response.f_hz for response in inputs.table.responses])
    return f"Swept from {f.min():.4g} to {f.max():.4g} Hz (section What was swept)."


def _operating_points(inputs: Inputs) -> str:
    n = len(inputs.table.responses)
    if n == 1:
        return ""
    return f"{n} operating points (section What was swept)."


def _settled(inputs: Inputs) -> str:
    status = np.concatenate([np.asarray(response.status) for response in inputs.table.responses])
    bad = int(np.sum(status == "not_settled"))
    return f"{bad} of {len(status)} rows are marked as not settled." if bad else "No row is marked as not settled."


def _linear(inputs: Inputs) -> str:
    found = [response.quality.get("linearity") for response in inputs.table.responses]
    values = np.concatenate([np.asarray(v) for v in found if v is not None]) if found else np.zeros(0)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return ""
    return f"Probes at half the amplitude changed Y by at most {values.max():.2g} (relative)."


def _uncertainty(inputs: Inputs) -> str:
    known = [np.isfinite(np.asarray(response.covariance)).all() for response in inputs.table.responses]
    return "Every row has a covariance; margins and modes have 95 % intervals." if all(known) else ""


def _verdict(inputs: Inputs) -> str:
    return "Section Verdict: winding number and closed-loop poles, which must agree." if _has(inputs, "tuning") else ""


def _damping(inputs: Inputs) -> str:
    return "Section Closed-loop modes." if _has(inputs, "tuning") else ""


def _bank(inputs: Inputs) -> str:
    return "Section Bank of grids." if _has(inputs, "bank") else ""


def _time_domain(inputs: Inputs) -> str:
    return "Section Confirmation in time." if _has(inputs, "verification") else ""


def _metrics(inputs: Inputs) -> str:
    return "Section Metrics." if _has(inputs, "metrics") else ""


def _provenance(inputs: Inputs) -> str:
    return "Section Provenance: hashes of all files, versions and the whole campaign."


def _has(inputs: Inputs, kind: str) -> bool:
    return kind in inputs.results


_ANSWERS: dict[str, Callable[[Inputs], str]] = {
    "matrix": _matrix,
    "band": _band,
    "operating_points": _operating_points,
    "settled": _settled,
    "linear": _linear,
    "uncertainty": _uncertainty,
    "verdict": _verdict,
    "damping": _damping,
    "bank": _bank,
    "time_domain": _time_domain,
    "metrics": _metrics,
    "provenance": _provenance,
}
