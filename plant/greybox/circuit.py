"""The circuit between a controller and its source, as matrices for one exact step.

Stationary frame, phase peak, currents as in the reference turbine: i_L out of the converter, i_g out
of the device::

    Lc di_L/dt = v_conv - v_pcc        Cf dv_C/dt = i_L - i_g        v_pcc = v_C + Rf (i_L - i_g)
    Lg di_g/dt = v_pcc - v_g - Rg i_g

An ideal source holds v_pcc itself: i_g then follows from the shunt, Rf Cf dv_C/dt = v_pcc - v_C. With
v_conv constant over a step and v_g a sum of rotating phasors, the step is a matrix exponential; no
integrator is involved, and no step is too long for it.

A fault is a symmetric 2 x 2 conductance at the PCC. Along each of its two axes the network is one of real
numbers with a conductance g there, v_pcc = (v_C + Rf (i_L - i)) / (1 + Rf g), where i is now the line's
current and i_g = i + g v_pcc; both together are half their sum on x and half their difference on conj(x).
"""

from __future__ import annotations

import cmath
from math import hypot, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from ..protocol import Source
from ..turbine.parameters import TurbineParameters

if TYPE_CHECKING:
    from ..kernels.grey import Network, Skew


def network(p: TurbineParameters, source: Source, dt_s: float, g_s: float = 0.0) -> Network:
    """The step of ``dt_s`` (s) behind ``source``, and what is measured; see the kernel's `Network`.

    ``g_s`` is a conductance at the PCC (S); only behind a grid.
    """
    from ..kernels.grey import Network

    a, converter, _ = _dynamics(p, source, g_s)
    moved = over_a_step(a, converter, 0.0, dt_s).real
    if source.kind == "ideal":
        v_pcc, i_g = np.zeros(3), np.array([1.0, 1.0 / p.r_f_ohm, 0.0])
        return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 1.0, -1.0 / p.r_f_ohm, v_pcc, 1.0)
    share = _share(p, g_s)
    v_pcc = share * np.array([p.r_f_ohm, 1.0, -p.r_f_ohm])
    i_g = np.array([1.0 - share, (1.0 - share) / p.r_f_ohm, share])
    return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 0.0, 0.0, v_pcc, 0.0)


def forcing(p: TurbineParameters, source: Source, f_hz: float, dt_s: float, g_s: float = 0.0) -> np.ndarray:
    """What one volt of the source at a signed frequency adds over a step to i_L, v_C, i_g and the integral of i_L."""
    a, _, driven = _dynamics(p, source, g_s)
    return over_a_step(a, driven, 2j * pi * f_hz, dt_s)[:, 4].copy()


def faulted(
    p: TurbineParameters, source: Source, f_hz: float, dt_s: float, fault_s: tuple[float, float, float]
) -> tuple[Network, np.ndarray, Skew | None]:
    """Network, forcing (1, 4) at ``f_hz`` and, where the phases differ, `Skew`, with a fault at the PCC.

    Parameters
    ----------
    p, source, f_hz, dt_s
        As above; the source is a Thevenin source.
    fault_s : (3,) float
        Conductance (S): alpha-alpha, alpha-beta, beta-beta.
    """
    from ..kernels.grey import Skew

    aa, ab, bb = fault_s
    mean, half = 0.5 * (aa + bb), hypot(0.5 * (aa - bb), ab)
    along, across = (network(p, source, dt_s, g_s) for g_s in (mean + half, mean - half))
    f_along, f_across = (forcing(p, source, f_hz, dt_s, g_s)[None, :] for g_s in (mean + half, mean - half))
    if half == 0.0:
        return along, f_along, None
    turn = cmath.exp(1j * cmath.phase(complex(0.5 * (aa - bb), ab)))
    skew = Skew(_combined(along, across, -1.0), 0.5 * (f_along - f_across), turn)
    return _combined(along, across, 1.0), 0.5 * (f_along + f_across), skew


def _combined(along: Network, across: Network, sign: float) -> Network:
    """Half of one and ``sign`` times half of the other."""
    pairs: list[tuple[Any, Any]] = list(zip(along, across, strict=True))
    return type(along)(*(0.5 * (one + sign * other) for one, other in pairs))


def impedance(source: Source, f_hz: float) -> complex:
    """Z_grid (ohm) at a signed frequency."""
    return source.r_ohm + 2j * pi * f_hz * source.l_h


def _share(p: TurbineParameters, g_s: float) -> float:
    """What a conductance at the PCC leaves of the voltage there, states given."""
    return 1.0 / (1.0 + p.r_f_ohm * g_s)


def _dynamics(p: TurbineParameters, source: Source, g_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (3, 3) and the columns (3,) of converter and source voltage."""
    l_c, r_f, c_f = p.l_c_h, p.r_f_ohm, p.c_f_f
    if source.kind == "ideal":
        a = np.diag([0.0, -1.0 / (r_f * c_f), 0.0])
        return a, np.array([1.0 / l_c, 0.0, 0.0]), np.array([-1.0 / l_c, 1.0 / (r_f * c_f), 0.0])
    l_g, r_g, share = source.l_h, source.r_ohm, _share(p, g_s)
    a = np.array(
        [
            [-share * r_f / l_c, -share / l_c, share * r_f / l_c],
            [share / c_f, (share - 1.0) / (r_f * c_f), -share / c_f],
            [share * r_f / l_g, share / l_g, -(share * r_f + r_g) / l_g],
        ]
    )
    return a, np.array([1.0 / l_c, 0.0, 0.0]), np.array([0.0, 0.0, -1.0 / l_g])


def over_a_step(a: np.ndarray, column: np.ndarray, s: complex, dt_s: float) -> np.ndarray:
    """exp of (states, integral of i_L, an input that goes as exp(s t)) over a step: its first four rows."""
    from scipy.linalg import expm

    whole = np.zeros((5, 5), complex)
    whole[:3, :3] = a
    whole[3, 0] = 1.0
    whole[:3, 4] = column
    whole[4, 4] = s
    return expm(whole * dt_s)[:4]
