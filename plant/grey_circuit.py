"""The circuit between a controller and its source, as matrices for one exact step.

Stationary frame, phase peak, currents as in the reference turbine: i_L out of the converter, i_g out
of the device::

    Lc di_L/dt = v_conv - v_pcc        Cf dv_C/dt = i_L - i_g        v_pcc = v_C + Rf (i_L - i_g)
    Lg di_g/dt = v_pcc - v_g - Rg i_g

An ideal source holds v_pcc itself: i_g then follows from the shunt, Rf Cf dv_C/dt = v_pcc - v_C. With
v_conv constant over a step and v_g a sum of rotating phasors, the step is a matrix exponential; no
integrator is involved, and no step is too long for it.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from .dpmsg_parameters import TurbineParameters
from .protocol import Source

if TYPE_CHECKING:
    from .kernels.grey import Network


def network(p: TurbineParameters, source: Source, dt_s: float) -> Network:
    """The step of ``dt_s`` (s) behind ``source``, and what is measured; see the kernel's `Network`."""
    from .kernels.grey import Network

    a, converter, _ = _dynamics(p, source)
    moved = _over_a_step(a, converter, 0.0, dt_s).real
    if source.kind == "ideal":
        v_pcc, i_g = np.zeros(3), np.array([1.0, 1.0 / p.r_f_ohm, 0.0])
        return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 1.0, -1.0 / p.r_f_ohm)
    v_pcc, i_g = np.array([p.r_f_ohm, 1.0, -p.r_f_ohm]), np.array([0.0, 0.0, 1.0])
    return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 0.0, 0.0)


def forcing(p: TurbineParameters, source: Source, f_hz: float, dt_s: float) -> np.ndarray:
    """What one volt of the source at a signed frequency adds over a step to i_L, v_C, i_g and the integral of i_L."""
    a, _, driven = _dynamics(p, source)
    return _over_a_step(a, driven, 2j * pi * f_hz, dt_s)[:, 4].copy()


def impedance(source: Source, f_hz: float) -> complex:
    """Z_grid (ohm) at a signed frequency."""
    return source.r_ohm + 2j * pi * f_hz * source.l_h


def _dynamics(p: TurbineParameters, source: Source) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (3, 3) and the columns (3,) of converter and source voltage."""
    l_c, r_f, c_f = p.l_c_h, p.r_f_ohm, p.c_f_f
    if source.kind == "ideal":
        a = np.diag([0.0, -1.0 / (r_f * c_f), 0.0])
        return a, np.array([1.0 / l_c, 0.0, 0.0]), np.array([-1.0 / l_c, 1.0 / (r_f * c_f), 0.0])
    l_g, r_g = source.l_h, source.r_ohm
    a = np.array(
        [
            [-r_f / l_c, -1.0 / l_c, r_f / l_c],
            [1.0 / c_f, 0.0, -1.0 / c_f],
            [r_f / l_g, 1.0 / l_g, -(r_f + r_g) / l_g],
        ]
    )
    return a, np.array([1.0 / l_c, 0.0, 0.0]), np.array([0.0, 0.0, -1.0 / l_g])


def _over_a_step(a: np.ndarray, column: np.ndarray, s: complex, dt_s: float) -> np.ndarray:
    """exp of (states, integral of i_L, an input that goes as exp(s t)) over a step: its first four rows."""
    from scipy.linalg import expm

    whole = np.zeros((5, 5), complex)
    whole[:3, :3] = a
    whole[3, 0] = 1.0
    whole[:3, 4] = column
    whole[4, 4] = s
    return expm(whole * dt_s)[:4]
