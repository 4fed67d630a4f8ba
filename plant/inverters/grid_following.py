"""``gfl-v1``: a grid-following inverter. Equations and parameters: docs/inverters.md."""

from __future__ import annotations

import numpy as np

from . import equilibrium as stationary
from .equilibrium import CircuitEquilibrium, References
from .inverter import Inverter
from .parameters import FollowingParameters


class GridFollowing(Inverter):
    """``gfl-v1``: PLL, current control, and loops for P or v_dc and for Q or |v|, by their weights."""

    id = "gfl-v1"
    _defaults = FollowingParameters()
    _control_slots = 10
    _friend = "on an ideal source or behind a stronger grid"

    def _control(self, circuit: CircuitEquilibrium) -> tuple[list[complex], References]:
        return stationary.following_equilibrium(self.parameters, circuit)

    def _turned_control(self, values: np.ndarray, angle_rad: float) -> None:
        from ..kernels import inverters as kernel

        values[kernel.DELTA] += angle_rad

    _kernel = "following"

    def _synchronisation(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from ..kernels import inverters as kernel

        return states[:, kernel.DELTA], np.full(len(states), np.nan)
