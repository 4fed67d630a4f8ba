"""Damping control at the measurement port (the paper's ARDC): what it does, and when it acts.

It stands outside the controller: between the measurement of v and i at the point of common coupling
(PCC) and whatever uses it. Signs: conventions of docs/damping.md; the current of the compensation is
positive *out of* the device.
"""

from __future__ import annotations

from math import pi

from .protocol import Compensation

NOTCH_XI = 0.01
"""Damping xi of the notch; its gain G0 is one."""


def compensation(k: float, r_ohm: float, l_h: float, resonance_hz: float) -> Compensation:
    """Rv + j w_r Lv with Rv = k R_grid and Lv = k L_grid; ``resonance_hz`` is signed. Eq. (7)."""
    return Compensation(k * r_ohm, k * 2.0 * pi * resonance_hz * l_h)
