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
from math import ceil, hypot, log2, pi
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
    moved = over_a_step(a, converter, dt_s)
    if source.kind == "ideal":
        v_pcc, i_g = np.zeros(3), np.array([1.0, 1.0 / p.r_f_ohm, 0.0])
        return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 1.0, -1.0 / p.r_f_ohm, v_pcc, 1.0)
    share = _share(p, g_s)
    v_pcc = share * np.array([p.r_f_ohm, 1.0, -p.r_f_ohm])
    i_g = np.array([1.0 - share, (1.0 - share) / p.r_f_ohm, share])
    return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 0.0, 0.0, v_pcc, 0.0)


def moments(p: TurbineParameters, source: Source, dt_s: float, g_s: float = 0.0) -> np.ndarray:
    """What powers of the time in a step, as source voltages, add over it; see `moments_over_a_step`."""
    a, _, driven = _dynamics(p, source, g_s)
    return moments_over_a_step(a, driven, dt_s)


def forcing(of_powers: np.ndarray, f_hz: Any, dt_s: float) -> np.ndarray:
    """What one volt of the source at signed frequencies adds over a step to i_L, v_C, i_g and the integral of i_L.

    Parameters
    ----------
    of_powers : (N_MOMENTS, 4) float
        The source's `moments`.
    f_hz : float or (n,) float
        Below the sampling frequency.

    Returns
    -------
    (4,) or (n, 4) complex
        Per volt at the start of the step.
    """
    half_turns = 2j * dt_s * np.asarray(f_hz)[..., None]
    total = np.zeros((*np.shape(f_hz), 4), complex)
    for of_power in of_powers[::-1]:
        total = total * half_turns + of_power
    return total


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
    f_along, f_across = (forcing(moments(p, source, dt_s, g_s), [f_hz], dt_s) for g_s in (mean + half, mean - half))
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


N_MOMENTS = 40
"""Powers of the time in a step that make up a tone: parts in 1e27 are left out at half the sampling frequency."""


def over_a_step(a: np.ndarray, column: np.ndarray, dt_s: float) -> np.ndarray:
    """exp of (states, integral of i_L, a constant input) over a step: its first four rows, (4, 5)."""
    return exponential(_augmented(a, column, dt_s, 1))[:4]


def moments_over_a_step(a: np.ndarray, column: np.ndarray, dt_s: float) -> np.ndarray:
    """What inputs (pi t / dt)^m / m!, m = 0, 1, ... add over a step to the states and the integral of i_L.

    Returns
    -------
    (N_MOMENTS, 4) float
        pi^m dt phi_(m+1)(dt A) column (Al-Mohy and Higham 2011, theorem 2.1). A tone of s = j w is the sum of these,
        times (s dt / pi)^m: none of these powers is large below half the sampling frequency.
    """
    return exponential(_augmented(a, column, dt_s, N_MOMENTS))[:4, 4:].T.copy()


def _augmented(a: np.ndarray, column: np.ndarray, dt_s: float, n_powers: int) -> np.ndarray:
    """A step of states, integral of i_L and powers of the time in it, each of which drives the one before."""
    whole = np.zeros((4 + n_powers, 4 + n_powers))
    whole[:3, :3], whole[3, 0], whole[:3, 4] = dt_s * a, dt_s, dt_s * column
    whole[4:, 4:] = pi * np.eye(n_powers, k=1)
    return whole


def exponential(matrix: np.ndarray) -> np.ndarray:
    """exp of a small real matrix (n, n): its Taylor series, of a part of it that is squared again and again.

    scipy's would do, but importing scipy takes a process longer than to simulate ten seconds.
    """
    squarings = max(0, ceil(log2(max(float(np.abs(matrix).sum(axis=0).max()), 1e-300))) + 1)
    part = matrix / 2.0**squarings  # its norm is at most a half: 17 terms are exact
    total = term = np.eye(len(matrix))
    for k in range(1, 18):
        term = term @ part / k
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total
