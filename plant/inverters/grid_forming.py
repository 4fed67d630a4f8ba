"""``gfm-v1``: a grid-forming inverter. Equations and parameters: docs/inverters.md."""

from __future__ import annotations

import numpy as np

from . import equilibrium as stationary
from .equilibrium import CircuitEquilibrium, References
from .inverter import Inverter
from .parameters import FormingParameters


class GridForming(Inverter):
    """``gfm-v1``: a virtual synchronous machine; droop and power synchronisation are other numbers of it."""

    id = "gfm-v1"
    _defaults = FormingParameters()
    _control_slots = 13
    _must_be_positive = (*Inverter._must_be_positive, "t_a_s", "k_iv", "k_ic")
    _friend = (
        'behind a weaker grid, with [source] kind = "thevenin", or with more reactance before its terminals '
        "(l_g_pu, l_v_pu)"
    )

    def _control(self, circuit: CircuitEquilibrium) -> tuple[list[complex], References]:
        return stationary.forming_equilibrium(self.parameters, circuit)

    def _turned_control(self, values: np.ndarray, angle_rad: float) -> None:
        from ..kernels import inverters as kernel

        values[kernel.THETA] += angle_rad
        values[kernel.THETA_P] += angle_rad

    _kernel = "forming"

    def _synchronisation(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from ..kernels import inverters as kernel

        return states[:, kernel.THETA], self.parameters.w1_rad_s * states[:, kernel.OMEGA]
