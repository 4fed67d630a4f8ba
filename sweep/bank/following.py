"""Devices and farms whose operating point follows from each grid of a bank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.surrogate.surrogate import Surrogate
from ...plant.errors import SeqsweepError
from ...tuning.bank.entries import BankEntry
from ...tuning.farm.on_grids import FarmOnGrids
from ...tuning.grids.regions import member_of
from ...tuning.region.loadflow import Situation, named, predicted_on
from ...tuning.tune import Device, fitted


@runtime_checkable
class Follows(Protocol):
    """What stands elsewhere on each grid: its names, and what it is on a grid."""

    @property
    def names(self) -> list[str]: ...

    def __len__(self) -> int: ...

    def device(self, op: int, entry: BankEntry) -> Device:
        """As it is judged on a grid; with the reason why there is none, where there is none."""
        ...


@dataclass(frozen=True, slots=True)
class Following:
    """Powers over a surrogate; |v_pcc| is the load flow's.

    Attributes
    ----------
    surrogate : Surrogate
        Y over the region.
    powers : tuple of (float, float)
        P (MW) and Q (Mvar).
    source_voltage_pu : float or None
        Behind every grid whose file does not say it.
    """

    surrogate: Surrogate
    powers: tuple[tuple[float, float], ...]
    source_voltage_pu: float | None

    def __len__(self) -> int:
        return len(self.powers)

    @property
    def f1_hz(self) -> float:
        """Fundamental frequency (Hz)."""
        return self.surrogate.f1_hz

    @property
    def names(self) -> list[str]:
        """A name for each dispatch."""
        return [named(power) for power in self.powers]

    def device(self, op: int, entry: BankEntry) -> Device:
        """The device at a dispatch on a grid; with the reason why there is none, where there is none."""
        try:
            member = member_of(entry.open(self.f1_hz))
            rated = self._bases.get("rated_voltage_v")
            situation = Situation(entry.grid_id, member, entry.source_voltage_pu(self.source_voltage_pu), rated)
            return fitted(predicted_on(self.surrogate, self.powers[op], situation))
        except SeqsweepError as error:
            return Device(_nowhere(self.names[op], self.f1_hz, self.surrogate.nu_hz), problem=str(error))

    @property
    def _bases(self) -> Mapping[str, Any]:
        return self.surrogate.meta.get("bases") or {}


@dataclass(frozen=True, slots=True)
class FarmFollowing:
    """A farm, its load flow solved anew on each grid.

    Attributes
    ----------
    farm : FarmOnGrids
        Ready for any grid.
    """

    farm: FarmOnGrids

    def __len__(self) -> int:
        return 1

    @property
    def names(self) -> list[str]:
        """The farm's."""
        return [self.farm.entry.name]

    def device(self, op: int, entry: BankEntry) -> Device:
        """The farm on a grid; with the reason why it does not stand there, where it does not."""
        farm = self.farm.entry
        try:
            z_ohm, own_pu = member_of(entry.open(farm.f1_hz)).at_f1, entry.source_voltage_pu(None)
            voltage_v = farm.source_voltage_v if own_pu is None else own_pu * farm.voltages_v[farm.source_bus]
            found = self.farm.on(z_ohm, voltage_v)
        except SeqsweepError as error:
            return Device(_nowhere(self.names[op], farm.f1_hz, self.farm.nu_hz), problem=str(error))
        if found.proved is None:
            return Device(found.response, problem=found.problem)
        return fitted(found.response, found.proved)


def _nowhere(name: str, f1_hz: float, nu_hz: np.ndarray) -> FrequencyResponse:
    """A response that carries a name and nothing to judge."""
    return FrequencyResponse(f1_hz + nu_hz, np.zeros((len(nu_hz), 2, 2), complex), f1_hz, meta={"op_id": name})
