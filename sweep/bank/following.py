"""Dispatches of a device whose operating point follows from each grid of a bank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.surrogate.surrogate import Surrogate
from ...plant.errors import SeqsweepError
from ...tuning.bank.entries import BankEntry
from ...tuning.grids.regions import RegionGrid
from ...tuning.region.loadflow import Situation, named, predicted_on
from ...tuning.tune import Device, fitted


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
            grid = entry.open(self.f1_hz)
            member = grid.member if isinstance(grid, RegionGrid) else grid
            rated = self._bases.get("rated_voltage_v")
            situation = Situation(entry.grid_id, member, entry.source_voltage_pu(self.source_voltage_pu), rated)
            return fitted(predicted_on(self.surrogate, self.powers[op], situation))
        except SeqsweepError as error:
            return Device(self._nowhere(op), problem=str(error))

    @property
    def _bases(self) -> Mapping[str, Any]:
        return self.surrogate.meta.get("bases") or {}

    def _nowhere(self, op: int) -> FrequencyResponse:
        """A response that carries the dispatch's name and nothing to judge."""
        f_hz = self.f1_hz + self.surrogate.nu_hz
        return FrequencyResponse(f_hz, np.zeros((len(f_hz), 2, 2), complex), self.f1_hz, meta={"op_id": self.names[op]})
