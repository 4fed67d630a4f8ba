"""The state from which the reference turbine can go on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..circuits.dynamics import Memory
from ..protocol import Source


@dataclass(frozen=True, slots=True, eq=False)
class TurbineState:
    """All states of the turbine and what it is connected to; opaque to everybody else.

    Attributes
    ----------
    step : int
        Steps since time zero.
    time_s : float
        Time (s).
    values : (21,) float
        The kernel's states, read-only; the last four are the notch's at the measurement port.
    wind_m_s : float
        Wind speed (m/s).
    i_q_ref_a : float
        Set-point of the reactive current (A, power-invariant), positive where it leads.
    v_source : complex
        Source voltage in the dq frame (V, power-invariant).
    source : Source
        What feeds the PCC.
    memory : Memory or None
        Currents and charges of its network, the turbine's own shunt last; None where there is none.
    """

    step: int
    time_s: float
    values: np.ndarray
    wind_m_s: float
    i_q_ref_a: float
    v_source: complex
    source: Source
    memory: Memory | None = None
