"""What operators ask of a scan, and where this report answers it; an honest "not covered" for the rest.

A profile is a data file (`profiles/*.toml`, or a user's own): demands with their sources, the section that answers
them, a quantity and a threshold. What a report can answer and compute stands in `_ANSWERS` and `QUANTITIES`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....plant.errors import SeqsweepError, nearest
from ....plant.foreign.toml_file import read_toml
from .inputs import Inputs
from .quantities import QUANTITIES

DEFAULT = ("scan",)
"""The profile of a report that asks for none."""

_KEYS = {"id", "text", "source", "answer", "quantity", "threshold"}
_NEEDED = ("id", "text", "source")


class ProfileError(SeqsweepError):
    """A profile that cannot be read as one, with the way out."""


class Item(NamedTuple):
    """One demand with its answer, as the table of the report has it."""

    id: str
    text: str
    source: str
    covered: bool
    found: str
    threshold: str
    met: str
    answer: str


@dataclass(frozen=True)
class Checklist:
    """A profile held against a report."""

    title: str
    about: str
    items: tuple[Item, ...]

    @property
    def summary(self) -> str:
        """How many demands are covered, and how many thresholds are met."""
        covered = sum(item.covered for item in self.items)
        missed = [item.id for item in self.items if item.met == "no"]
        held = sum(item.met in ("yes", "no") for item in self.items)
        thresholds = f"; {held - len(missed)} of {held} thresholds met" if held else "; no threshold is applied"
        return f"{covered} of {len(self.items)} demands are covered{thresholds}"


def shipped() -> list[str]:
    """Names of the profiles that come with the package."""
    folder = files(__package__).joinpath("profiles")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def read_profiles(names: Sequence[str]) -> list[Mapping[str, Any]]:
    """Profiles by the name of a shipped one or the path of a file; `DEFAULT` where none is named.

    Raises
    ------
    ProfileError
        If there is no such profile, or a demand of it cannot be answered as it stands.
    """
    return [_read(name) for name in names or DEFAULT]


def checked(inputs: Inputs, profile: Mapping[str, Any]) -> Checklist:
    """Every demand of a profile with its answer."""
    items = tuple(_item(demand, inputs) for demand in profile["demand"])
    return Checklist(str(profile.get("title", "Requirements")), str(profile.get("about", "")), items)


def _read(name: str) -> Mapping[str, Any]:
    known = shipped()
    if name in known:
        return tomllib.loads(files(__package__).joinpath("profiles", f"{name}.toml").read_text("utf-8"))
    path = Path(name)
    if not path.is_file():
        raise ProfileError(
            f"--profile {name}: neither a file nor one of the profiles {', '.join(known)}{nearest(name, known)}"
        )
    profile = read_toml(path, ProfileError)
    _check(profile, path)
    return profile


def _check(profile: Mapping[str, Any], path: Path) -> None:
    demands = profile.get("demand")
    if not isinstance(demands, list) or not demands:
        raise ProfileError(f"{path}: a profile has at least one [[demand]] with {', '.join(_NEEDED)}")
    for number, demand in enumerate(demands, 1):
        _check_demand(demand, f"{path}: demand {number}" + (f" ({demand['id']})" if "id" in demand else ""))


def _check_demand(demand: Mapping[str, Any], place: str) -> None:
    if missing := [key for key in _NEEDED if not isinstance(demand.get(key), str)]:
        raise ProfileError(f"{place}: needed is text for {', '.join(missing)}")
    for key in demand:
        if key not in _KEYS:
            raise ProfileError(f"{place}: unknown key {key!r}{nearest(key, sorted(_KEYS))}")
    for key, known in (("answer", _ANSWERS), ("quantity", QUANTITIES)):
        given = demand.get(key)
        if given is not None and given not in known:
            raise ProfileError(f"{place}: {key} {given!r} is none of {', '.join(known)}{nearest(str(given), known)}")
    threshold = demand.get("threshold", "")
    if threshold != "" and (isinstance(threshold, bool) or not isinstance(threshold, int | float)):
        raise ProfileError(
            f'{place}: threshold {threshold!r} is no number; write "" where its source could not be read'
        )
    if threshold != "" and "quantity" not in demand:
        raise ProfileError(f"{place}: a threshold needs the quantity that it is held against")


def _item(demand: Mapping[str, Any], inputs: Inputs) -> Item:
    answer = _ANSWERS[demand["answer"]](inputs) if "answer" in demand else ""
    found, threshold, met = _held(demand, inputs)
    covered = bool(answer or found)
    texts = [answer] if answer else []
    if "quantity" in demand and demand.get("threshold", "") == "" and covered:
        texts.append("No threshold is applied: its source could not be read.")
    if not covered:
        texts.append("Not covered by this report.")
    return Item(demand["id"], demand["text"], demand["source"], covered, found, threshold, met, " ".join(texts))


def _held(demand: Mapping[str, Any], inputs: Inputs) -> tuple[str, str, str]:
    """What was found of the quantity of a demand, its threshold, and whether it is met; empty where there is none."""
    if "quantity" not in demand:
        return "", "", ""
    quantity = QUANTITIES[demand["quantity"]]
    value, threshold = quantity.value(inputs), demand.get("threshold", "")
    asked = "not read" if threshold == "" else f"{quantity.sense} {_with_unit(threshold, quantity.unit)}"
    if value is None:
        return "", asked, ""
    met = "" if threshold == "" else "yes" if quantity.met(value, threshold) else "no"
    return _with_unit(value, quantity.unit), asked, met


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.4g}" + (f" {unit}" if unit else "")


# Answers -------------------------------------------------------------------------------------------------------------


def _matrix(inputs: Inputs) -> str:
    return "The table holds Ypp, Ypn, Ynp and Ynn of every row (section Admittance)."


def _band(inputs: Inputs) -> str:
    f = np.concatenate([response.f_hz for response in inputs.table.responses])
    return f"Swept from {f.min():.4g} to {f.max():.4g} Hz (section What was swept)."


def _resolution(inputs: Inputs) -> str:
    """An adaptive grid answers; a logarithmic one is stated."""
    certified = [r.meta["interpolation"] for r in inputs.table.responses if r.meta.get("interpolation")]
    counts = [len(response) for response in inputs.table.responses]
    many = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    if certified:
        return f"{many} points per operating point, placed where the interpolation was unsure until it was certified."
    return f"{many} points per operating point, with no check of what lies between them."


def _operating_points(inputs: Inputs) -> str:
    n = len(inputs.table.responses)
    if "surrogate" in inputs.results:
        return f"{n} operating points, and a surrogate between them (section Any operating point)."
    return f"{n} operating points (section What was swept)." if n > 1 else ""


def _settled(inputs: Inputs) -> str:
    status = np.concatenate([np.asarray(response.status) for response in inputs.table.responses])
    bad = int(np.sum(status == "not_settled"))
    return f"{bad} of {len(status)} rows are marked as not settled." if bad else "No row is marked as not settled."


def _convention(inputs: Inputs) -> str:
    bases = inputs.table.meta.get("bases") or {}
    if not {"rated_voltage_v", "rated_power_va"} <= set(bases):
        return ""
    return (
        f"Admittance in S, current positive into the device, rows and columns p at f and the conjugate at 2 f1 - f; "
        f"base {bases['rated_voltage_v']:g} V line to line and {bases['rated_power_va'] / 1e6:g} MVA."
    )


def _linear(inputs: Inputs) -> str:
    found = [response.quality.get("linearity") for response in inputs.table.responses]
    values = np.concatenate([np.asarray(v) for v in found if v is not None]) if found else np.zeros(0)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return ""
    return f"Probes at half the amplitude changed Y by at most {values.max():.2g} (relative)."


def _uncertainty(inputs: Inputs) -> str:
    known = [np.isfinite(np.asarray(r.covariance)[r.ok]).all() for r in inputs.table.responses]
    return "Every row that is ok has a covariance; margins and modes have 95 % intervals." if all(known) else ""


def _section(kind: str, text: str) -> Callable[[Inputs], str]:
    """An answer that stands in the section of a result, where the report has that result."""
    return lambda inputs: text if kind in inputs.results else ""


_ANSWERS: dict[str, Callable[[Inputs], str]] = {
    "matrix": _matrix,
    "band": _band,
    "resolution": _resolution,
    "operating_points": _operating_points,
    "settled": _settled,
    "convention": _convention,
    "linear": _linear,
    "uncertainty": _uncertainty,
    "verdict": _section("tuning", "Section Verdict: winding number and closed-loop poles, which must agree."),
    "damping": _section("tuning", "Section Closed-loop modes."),
    "bank": _section("bank", "Section Bank of grids."),
    "farm": _section("farm", "Section Farm."),
    "time_domain": _section("verification", "Section Confirmation in time."),
    "metrics": _section("metrics", "Section Metrics."),
    "provenance": lambda inputs: "Section Provenance: hashes of all files, versions and the whole campaign.",
}
"""Every answer by the name that a profile uses."""
