"""A campaign that was measured, as the responses and the metadata of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.table.format import QUALITY, unpack_covariance
from ...plant.protocol import Plant
from ...plant.registry import PlantCard
from ..excitation.adaptive_rounds import certificate_text
from ..measure.linearity import judged
from ..measure.proof import stable_on
from ..measure.rows import BatchResult, Row
from ..plan import Batch, Condition, Plan
from .store import Store


class Swept(NamedTuple):
    """A campaign that was measured: what its table is made of, one operating point in memory at a time.

    Attributes
    ----------
    plan, plant
        What was asked, and of whom.
    store : Store
        Where the results of the batches are.
    batches_at : callable
        The batches of an operating point; none where it is not in the table.
    certificates : mapping
        What the last round of an adaptive grid certifies, by op_id.
    """

    plan: Plan
    plant: Plant | PlantCard
    store: Store
    batches_at: Callable[[Condition], Sequence[Batch]]
    certificates: Mapping[str, dict[str, Any]]

    def responses(self) -> Iterator[FrequencyResponse]:
        """One for every operating point that has rows, in campaign order; its ``meta`` is its entry in the table."""
        for condition in self.plan.conditions:
            if results := self._results(condition):
                rows = judged(_ascending(results), self.plan.nonlinear_above)
                yield _response(self.plan, condition, rows, self._entry(condition, results[0].condition))

    def metadata(self) -> dict[str, Any]:
        """Metadata of the table with its operating points, but for what their rows prove."""
        found = ((condition, self._results(condition)) for condition in self.plan.conditions)
        points = [self._entry(condition, results[0].condition) for condition, results in found if results]
        return {**self.header(), "operating_points": points}

    def header(self) -> dict[str, Any]:
        """Metadata of the table but for its operating points, as `write_table` takes it with `responses`."""
        rating = self.plant.rating
        return {
            "f1_hz": self.plan.f1_hz,
            "bases": {"rated_voltage_v": rating.voltage_v, "rated_power_va": rating.power_va},
            "power_meaning": self.plant.power_meaning,
            "configuration": self.plan.configuration,
            "plant": self.plan.plant_fingerprint,
        }

    def _results(self, condition: Condition) -> list[BatchResult]:
        return [_kept(self.store, batch) for batch in self.batches_at(condition)]

    def _entry(self, condition: Condition, seen: dict[str, float]) -> dict[str, Any]:
        entry = _condition_metadata(condition, self.plant, seen)
        certified = self.certificates.get(condition.op_id)
        return entry if certified is None else {**entry, "interpolation": certified}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What an adaptive grid has to say of each operating point."""
        return tuple(f"{name}: {certificate_text(c, self.plan.f1_hz)}" for name, c in self.certificates.items())


def rows_of(store: Store, batches: Sequence[Batch]) -> list[Row]:
    """Rows of some batches, ascending in frequency."""
    return _ascending([_kept(store, batch) for batch in batches])


def _ascending(results: Sequence[BatchResult]) -> list[Row]:
    return sorted((row for result in results for row in result.rows), key=lambda row: row.f_hz)


def _kept(store: Store, batch: Batch) -> BatchResult:
    kept = store.read(batch)
    if kept is None:
        raise OSError(f"{store}: a shard was damaged or removed after it was written; run again to measure it anew")
    return kept


def response_of(plan: Plan, op_id: str, rows: Sequence[Row]) -> FrequencyResponse:
    """Rows of one operating point, ascending, as a response, with what its shots prove."""
    return _response(
        plan, next(condition for condition in plan.conditions if condition.op_id == op_id), rows, {"op_id": op_id}
    )


def _response(plan: Plan, condition: Condition, rows: Sequence[Row], entry: Mapping[str, Any]) -> FrequencyResponse:
    proof = stable_on(plan, condition, rows)
    parts = np.array([row.y for row in rows])
    return FrequencyResponse(
        f_hz=np.array([row.f_hz for row in rows]),
        y=(parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2),
        f1_hz=plan.f1_hz,
        covariance=unpack_covariance(np.array([row.cov for row in rows])),
        status=np.array([row.status for row in rows]),
        reason=np.array([row.reason for row in rows]),
        quality={name: np.array([getattr(row, name) for row in rows]) for name in QUALITY},
        meta=entry if proof is None else {**entry, "stable_on": proof},
    )


def _condition_metadata(condition: Condition, plant: Plant | PlantCard, seen: dict[str, float]) -> dict[str, Any]:
    """An operating point as the table tells of it; |v_pcc| is what was asked, else what was found."""
    fundamental = {key: value for key, value in seen.items() if key != "settle_residual"}
    voltage_v = condition.terminal_voltage_v or fundamental.get("voltage_v")
    entry: dict[str, Any] = {
        "op_id": condition.op_id,
        "active_power_mw": condition.active_power_w / 1e6,
        "terminal_voltage_pu": voltage_v / plant.rating.voltage_v if voltage_v else None,
    }
    if condition.reactive_power_var:
        entry["reactive_power_mvar"] = condition.reactive_power_var / 1e6
    if "settle_residual" in seen:
        entry["settle_residual"] = seen["settle_residual"]
    if fundamental:
        entry["fundamental"] = fundamental
    return entry
