"""A campaign that was measured, as the responses and the metadata of its table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

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
from .shards import Store

T = TypeVar("T")


class Swept(NamedTuple):
    """A campaign that was measured: what its table is made of, one operating point in memory at a time.

    Attributes
    ----------
    plan, plant
        What was asked, and of whom.
    store : Store
        Where the results of the batches are.
    batches : list of Batch
        All of them.
    certificates : mapping
        What the last round of an adaptive grid certifies, by op_id.
    """

    plan: Plan
    plant: Plant | PlantCard
    store: Store
    batches: list[Batch]
    certificates: Mapping[str, dict[str, Any]]

    def responses(self) -> Iterator[FrequencyResponse]:
        """One for every operating point that has rows, in campaign order."""
        return responses_of(self.plan, self.batches, self.store)

    def metadata(self) -> dict[str, Any]:
        """Metadata of the table, as `write_table` takes it."""
        by_condition = batches_by_condition(self.plan, self.batches)
        meta = _metadata(self.plan, self.plant, by_condition, self.store)
        for entry in meta["operating_points"]:
            if entry["op_id"] in self.certificates:
                entry["interpolation"] = self.certificates[entry["op_id"]]
        return meta

    @property
    def remarks(self) -> tuple[str, ...]:
        """What an adaptive grid has to say of each operating point."""
        return tuple(f"{name}: {certificate_text(c, self.plan.f1_hz)}" for name, c in self.certificates.items())


def responses_of(plan: Plan, batches: Sequence[Batch], store: Store) -> Iterator[FrequencyResponse]:
    for own in batches_by_condition(plan, batches).values():
        if own:
            yield _response(plan, own[0].condition, judged(rows_of(store, own), plan.nonlinear_above))


def batches_by_condition(plan: Plan, batches: Sequence[Batch]) -> dict[str, list[Batch]]:
    found: dict[str, list[Batch]] = {condition.op_id: [] for condition in plan.conditions}
    for batch in batches:
        found[batch.condition.op_id].append(batch)
    return found


def rows_of(store: Store, batches: Sequence[Batch]) -> list[Row]:
    """Rows of some batches, ascending in frequency."""
    return sorted((row for batch in batches for row in _kept(store, batch).rows), key=lambda row: row.f_hz)


def _kept(store: Store, batch: Batch) -> BatchResult:
    return _there(store, store.read(batch))


def _there(store: Store, content: T | None) -> T:
    if content is None:
        raise OSError(f"{store}: a shard was damaged or removed after it was written; run again to measure it anew")
    return content


def response_of(plan: Plan, op_id: str, rows: Sequence[Row]) -> FrequencyResponse:
    """Rows of one operating point, ascending, as a response, with what its shots prove."""
    return _response(plan, next(condition for condition in plan.conditions if condition.op_id == op_id), rows)


def _response(plan: Plan, condition: Condition, rows: Sequence[Row]) -> FrequencyResponse:
    op_id, proof = condition.op_id, stable_on(plan, condition, rows)
    parts = np.array([row.y for row in rows])
    return FrequencyResponse(
        f_hz=np.array([row.f_hz for row in rows]),
        y=(parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2),
        f1_hz=plan.f1_hz,
        covariance=unpack_covariance(np.array([row.cov for row in rows])),
        status=np.array([row.status for row in rows]),
        reason=np.array([row.reason for row in rows]),
        quality={name: np.array([getattr(row, name) for row in rows]) for name in QUALITY},
        meta={"op_id": op_id} if proof is None else {"op_id": op_id, "stable_on": proof},
    )


def _metadata(
    plan: Plan, plant: Plant | PlantCard, by_condition: dict[str, list[Batch]], store: Store
) -> dict[str, Any]:
    return {
        "f1_hz": plan.f1_hz,
        "bases": {"rated_voltage_v": plant.rating.voltage_v, "rated_power_va": plant.rating.power_va},
        "power_meaning": plant.power_meaning,
        "operating_points": [
            _condition_metadata(condition, plant, _seen(store, by_condition[condition.op_id][0]))
            for condition in plan.conditions
            if by_condition[condition.op_id]
        ],
        "configuration": dict(plan.configuration),
        "plant": dict(plan.plant_fingerprint),
    }


def _seen(store: Store, batch: Batch) -> dict[str, float]:
    return _there(store, store.condition(batch))


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
