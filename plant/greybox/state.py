"""Where the turbine's circuit and the controller in it stand: a value, opaque to everybody else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..protocol import Source


class Sight(NamedTuple):
    """v_pcc over the source voltage, smoothed (`stepping.SIGHT_S`), and its angle (rad), not wrapped."""

    ratio: complex
    angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class GreyState:
    """Circuit and controller at one sample; opaque to everybody else.

    Attributes
    ----------
    step : int
        Samples since the controller was started.
    time_s : float
        Time (s).
    x : (6,) complex
        i_L, v_C, i_g (A, V; phase peak, stationary frame), the command that waits, the band pass at the port.
    energy : float
        Of the DC link (J).
    memory : object
        What the controller declares it remembers; see `Sealed`.
    v_source : complex
        Source voltage at time zero (V, phase peak).
    source : Source
        What feeds the PCC.
    power_w, voltage_v : float
        References of the operating point: P_machine (W) and |v_pcc| (V, line-to-line RMS).
    sight : Sight or None
        How v_pcc was last seen from the source; None where nobody has been watching.
    reactive_var : float
        Reference of reactive power (var).
    """

    step: int
    time_s: float
    x: np.ndarray
    energy: float
    memory: Any
    v_source: complex
    source: Source
    power_w: float
    voltage_v: float
    sight: Sight | None = None
    reactive_var: float = 0.0
