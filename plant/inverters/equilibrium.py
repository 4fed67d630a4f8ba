"""Stationary operating points of the two inverters, in closed form, per unit.

The frame is that of v_pcc, which is real here. At rest every integrator's input vanishes and the controllers'
speed is nominal; what is left are the phasors of one circuit and a few subtractions.
"""

from __future__ import annotations

import cmath
from math import sqrt
from typing import NamedTuple

from ..errors import SeqsweepError
from .parameters import FollowingParameters, FormingParameters


class CircuitEquilibrium(NamedTuple):
    """Phasors at rest: v_pcc, i_g out of the device, capacitor branch v, capacitor v_c, converter i_c and e."""

    v_pcc: complex
    i_g: complex
    v: complex
    v_c: complex
    i_c: complex
    e: complex


class References(NamedTuple):
    """What the controls are asked for so that they rest there: P*, Q* at the capacitor, and V* (see the kernel)."""

    p: float
    q: float
    v: float


def circuit_equilibrium(
    p: FormingParameters | FollowingParameters, power: complex, voltage: float
) -> CircuitEquilibrium:
    """Circuit that gives ``power`` = P + j Q (out of the device, at the PCC) at |v_pcc| = ``voltage``.

    Notes
    -----
    i_g = conj(S / v_pcc), v = v_pcc + (r_g + j l_g) i_g, i_c = i_g + y v with y = j c_f / (1 + j c_f r_c),
    e = v + (r_f + j l_f) i_c.
    """
    i_g = (power / voltage).conjugate()
    v = voltage + complex(p.r_g_pu, p.l_g_pu) * i_g
    i_c = i_g + 1j * p.c_f_pu / (1.0 + 1j * p.c_f_pu * p.r_c_pu) * v
    return CircuitEquilibrium(
        v_pcc=complex(voltage),
        i_g=i_g,
        v=v,
        v_c=v - p.r_c_pu * (i_c - i_g),
        i_c=i_c,
        e=v + complex(p.r_f_pu, p.l_f_pu) * i_c,
    )


def source_voltage(c: CircuitEquilibrium, z: complex) -> complex:
    """Voltage of the source behind ``z``."""
    return c.v_pcc - z * c.i_g


def terminal_voltage(power: complex, z: complex, source: float) -> float:
    """|v_pcc| for a given |v_s| behind ``z``: the upper of the two solutions.

    Raises
    ------
    SeqsweepError
        If the grid cannot carry the power.

    Notes
    -----
    v_s = V - z conj(S) / V; its squared modulus times V^2 is a quadratic equation in V^2.
    """
    half = 0.5 * source**2 + (z * power.conjugate()).real
    discriminant = half**2 - abs(z * power) ** 2
    if half <= 0.0 or discriminant < 0.0:
        raise SeqsweepError(
            f"no equilibrium: {power.real:g} + j{power.imag:g} pu cannot be carried by {source:g} pu behind "
            f"{z.real:g} + j{z.imag:g} pu; lower the power or the impedance"
        )
    return sqrt(half + sqrt(discriminant))


def forming_equilibrium(p: FormingParameters, c: CircuitEquilibrium) -> tuple[list[complex], References]:
    """Control states at rest, in the kernel's order, and the references that hold them.

    Notes
    -----
    v = V* - (r_v + j l_v) i_g in the rotor's frame makes its angle that of v + (r_v + j l_v) i_g.
    """
    behind = c.v + complex(p.r_v_pu, p.l_v_pu) * c.i_g
    theta, theta_p = cmath.phase(behind), cmath.phase(c.v)
    back = cmath.exp(-1j * theta)
    xi = back * (c.i_c - 1j * p.c_f_pu * c.v - p.k_ffi * c.i_g) / p.k_iv
    gamma = back * (c.e - 1j * p.l_f_pu * c.i_c - p.k_ffv * c.v) / p.k_ic
    s = c.v * c.i_g.conjugate()
    states = [theta, 1.0, s.imag, complex(abs(c.v)), 0.0, theta_p, xi, gamma, back * c.v]
    return states, References(s.real, s.imag, abs(behind))


def following_equilibrium(p: FollowingParameters, c: CircuitEquilibrium) -> tuple[list[complex], References]:
    """Control states at rest, in the kernel's order, and the references that hold them."""
    delta = cmath.phase(c.v)
    back = cmath.exp(-1j * delta)
    i_dq, e_dq = back * c.i_c, back * c.e
    gamma = e_dq - 1j * p.k_rd * i_dq - p.k_ff * abs(c.v)
    s = c.v * c.i_g.conjugate()
    states = [delta, 0.0, i_dq.real, -i_dq.imag, s.real, s.imag, gamma, complex(abs(c.v))]
    return states, References(s.real, s.imag, abs(c.v))
