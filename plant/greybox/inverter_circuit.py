"""The general circuit of an inverter between a controller and its source, as matrices for one exact step.

Choke L_f R_f, capacitor C_f with R_c in series and R_p across the branch, grid-side L_g R_g, the PCC, the source's
r and l. Stationary frame, phase peak, i_L out of the converter, i_g out of the device::

    Lf di_L/dt = v_conv - v_f - Rf i_L        Cf dv_C/dt = i_L - i_g - v_f / Rp
    (Lg + l) di_g/dt = v_f - e - (Rg + r) i_g       v_f = (v_C + Rc (i_L - i_g)) / (1 + Rc / Rp)
    v_pcc = e + r i_g + l di_g/dt

The ideal source is r = l = 0: L_g alone keeps its voltage from the capacitor, so all sources have the same states.
"""

from __future__ import annotations

from math import inf, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..protocol import Source
from .circuit import moments_over_a_step, over_a_step

if TYPE_CHECKING:
    from ..kernels.grey import Network


class InverterCircuit(NamedTuple):
    """Parameters of the circuit; SI.

    Attributes
    ----------
    u_rated_v, s_rated_va, f1_hz : float
        Rated line-to-line RMS voltage (V), apparent power (VA), fundamental (Hz).
    l_f_h, r_f_ohm : float
        Choke of the converter.
    c_f_f, r_c_ohm, r_p_ohm : float
        Capacitor, the resistor in series with it and the one across both (infinite: none).
    l_g_h, r_g_ohm : float
        Grid-side inductance, such as a transformer's.
    c_dc_f, v_dc_ref_v : float
        DC link, and the voltage at which it starts.
    r_dc_ohm : float
        Resistance of a battery that feeds the DC link; 0: a constant power feeds it.
    """

    u_rated_v: float = 690.0
    s_rated_va: float = 1.0e6
    f1_hz: float = 50.0
    l_f_h: float = 0.15e-3
    r_f_ohm: float = 1.5e-3
    c_f_f: float = 500e-6
    r_c_ohm: float = 0.02
    r_p_ohm: float = inf
    l_g_h: float = 0.1e-3
    r_g_ohm: float = 1.5e-3
    c_dc_f: float = 0.15
    v_dc_ref_v: float = 1200.0
    r_dc_ohm: float = 0.0

    @property
    def w1_rad_s(self) -> float:
        """Fundamental angular frequency (rad/s)."""
        return 2.0 * pi * self.f1_hz


def network(p: InverterCircuit, source: Source, dt_s: float) -> Network:
    """The step of ``dt_s`` (s) behind ``source``, and what is measured; see the kernel's `Network`."""
    from ..kernels.grey import Network

    a, converter, _ = _dynamics(p, source)
    moved = over_a_step(a, converter, dt_s)
    shunt = _shunt(p)
    part = source.l_h / (p.l_g_h + source.l_h)
    v_pcc = part * shunt + np.array([0.0, 0.0, source.r_ohm - part * (p.r_g_ohm + source.r_ohm)])
    i_g = np.array([0.0, 0.0, 1.0])
    return Network(moved[:, :3].copy(), moved[:, 4].copy(), v_pcc, i_g, 1.0 - part, 0.0, shunt, 0.0)


def moments(p: InverterCircuit, source: Source, dt_s: float) -> np.ndarray:
    """What powers of the time in a step, as source voltages, add over it; see `moments_over_a_step`."""
    a, _, driven = _dynamics(p, source)
    return moments_over_a_step(a, driven, dt_s)


class Rest(NamedTuple):
    """Phasors at rest, in the frame of v_pcc: V and A, in whatever size ``voltage`` has."""

    i_l: complex
    v_c: complex
    i_g: complex
    v_conv: complex
    v_pcc: complex


def at_rest(p: InverterCircuit, power_va: complex, voltage: float) -> Rest:
    """Circuit that gives P + jQ (VA) at |v_pcc| (V, line-to-line RMS; quantities power-invariant)."""
    w = p.w1_rad_s
    i_g = (power_va / voltage).conjugate()
    v_f = voltage + complex(p.r_g_ohm, w * p.l_g_h) * i_g
    i_c = v_f * 1j * w * p.c_f_f / (1.0 + 1j * w * p.c_f_f * p.r_c_ohm)
    i_l = i_g + i_c + v_f / p.r_p_ohm
    return Rest(i_l, v_f - p.r_c_ohm * i_c, i_g, v_f + complex(p.r_f_ohm, w * p.l_f_h) * i_l, complex(voltage))


def _shunt(p: InverterCircuit) -> np.ndarray:
    """From the states to v_f."""
    return np.array([p.r_c_ohm, 1.0, -p.r_c_ohm]) / (1.0 + p.r_c_ohm / p.r_p_ohm)


def _dynamics(p: InverterCircuit, source: Source) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (3, 3) and the columns (3,) of converter and source voltage."""
    shunt, l_g, r_g = _shunt(p), p.l_g_h + source.l_h, p.r_g_ohm + source.r_ohm
    a = np.array(
        [
            (-shunt - [p.r_f_ohm, 0.0, 0.0]) / p.l_f_h,
            ([1.0, 0.0, -1.0] - shunt / p.r_p_ohm) / p.c_f_f,
            (shunt - [0.0, 0.0, r_g]) / l_g,
        ]
    )
    return a, np.array([1.0 / p.l_f_h, 0.0, 0.0]), np.array([0.0, 0.0, -1.0 / l_g])
