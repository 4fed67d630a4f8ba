"""Numbers that a requirement may set a threshold on, each computed from what the report holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from .inputs import Inputs


class Quantity(NamedTuple):
    """A number of the report.

    Attributes
    ----------
    unit : str
        Its unit.
    sense : "at least" or "at most"
        Which side of a threshold is good.
    value : callable
        The number, the worst one where there are several; None where the report does not hold it.
    """

    unit: str
    sense: Literal["at least", "at most"]
    value: Callable[[Inputs], float | None]

    def met(self, value: float, threshold: float) -> bool:
        """Whether ``value`` is on the good side of ``threshold``; what rounding makes of it does not count."""
        room = 1e-9 * abs(threshold)
        return value >= threshold - room if self.sense == "at least" else value <= threshold + room


def _cases(inputs: Inputs) -> Iterator[Mapping[str, Any]]:
    yield from inputs.results.get("tuning", {}).get("operating_points", [])


def _least(values: Iterator[float | None]) -> float | None:
    known = [value for value in values if value is not None and value == value]
    return min(known) if known else None


def _lowest_hz(inputs: Inputs) -> float | None:
    return max(float(r.f_hz[0]) for r in inputs.table.responses)


def _highest_hz(inputs: Inputs) -> float | None:
    return min(float(r.f_hz[-1]) for r in inputs.table.responses)


def _highest_harmonic(inputs: Inputs) -> float | None:
    return min(float(r.f_hz[-1]) / r.f1_hz for r in inputs.table.responses)


def _operating_points(inputs: Inputs) -> float | None:
    return float(len(inputs.table.responses))


def _rows_ok(inputs: Inputs) -> float | None:
    ok = np.concatenate([np.asarray(r.ok) for r in inputs.table.responses])
    return 100.0 * float(ok.mean())


def _error(inputs: Inputs) -> float | None:
    from ....identify.uncertainty import relative_uncertainty

    found = np.concatenate([relative_uncertainty(r)[r.ok] for r in inputs.table.responses])
    found = found[np.isfinite(found)]
    return 100.0 * float(found.max()) if len(found) else None


def _nonlinearity(inputs: Inputs) -> float | None:
    columns = [np.asarray(r.quality["linearity"]) for r in inputs.table.responses if "linearity" in r.quality]
    found = np.concatenate(columns) if columns else np.zeros(0)
    found = found[np.isfinite(found)]
    return 100.0 * float(found.max()) if len(found) else None


def _damping(inputs: Inputs) -> float | None:
    """Least damping of an oscillating mode inside the band, of all cases and of the bank."""
    of_cases = (
        100.0 * pole["damping"]
        for case in _cases(inputs)
        for pole in case.get("poles") or []
        if pole["kind"] != "beyond" and pole["im_rad_s"] > 0.0
    )
    bank = inputs.results.get("bank")
    of_bank = iter(()) if bank is None else iter((100.0 * bank.columns["damping"]).tolist())
    return _least(value for part in (of_cases, of_bank) for value in part)


def _margin(inputs: Inputs) -> float | None:
    return _least(case.get("margin_m") for case in _cases(inputs))


def _phase_margin(inputs: Inputs) -> float | None:
    """Least phase margin of the locus; zero where a case is unstable, which has none."""
    return _least(
        0.0 if case["verdict"] == "unstable" else (case.get("margins") or {}).get("phase_deg")
        for case in _cases(inputs)
    )


def _probability(inputs: Inputs) -> float | None:
    bank = inputs.results.get("bank")
    of_bank = [] if bank is None else bank.columns["probability"].tolist()
    return _least(iter([*(case.get("probability") for case in _cases(inputs)), *of_bank]))


def _grids(inputs: Inputs) -> float | None:
    bank = inputs.results.get("bank")
    return None if bank is None else float(len(np.unique(bank.columns["grid_id"])))


def _stable_share(inputs: Inputs) -> float | None:
    bank = inputs.results.get("bank")
    return None if bank is None else 100.0 * bank.counts.get("stable", 0) / len(bank)


QUANTITIES: dict[str, Quantity] = {
    "lowest_frequency_hz": Quantity("Hz", "at most", _lowest_hz),
    "highest_frequency_hz": Quantity("Hz", "at least", _highest_hz),
    "highest_harmonic": Quantity("times f1", "at least", _highest_harmonic),
    "operating_points": Quantity("", "at least", _operating_points),
    "rows_ok_percent": Quantity("%", "at least", _rows_ok),
    "error_percent": Quantity("%", "at most", _error),
    "nonlinearity_percent": Quantity("%", "at most", _nonlinearity),
    "damping_percent": Quantity("%", "at least", _damping),
    "margin_m": Quantity("", "at least", _margin),
    "phase_margin_deg": Quantity("\N{DEGREE SIGN}", "at least", _phase_margin),
    "probability": Quantity("", "at least", _probability),
    "grids": Quantity("", "at least", _grids),
    "stable_percent": Quantity("%", "at least", _stable_share),
}
"""Every quantity by the name that a profile uses."""
