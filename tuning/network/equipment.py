"""Equipment as data sheets give it, as branches and lines of a network.

SI throughout, voltages line to line; each function takes the nodes it stands between.
"""

from __future__ import annotations

from itertools import pairwise
from math import inf, pi, sqrt

from .assembly import GROUND, Branch, Line


def between(a: str, b: str) -> dict[str, float]:
    """The ends of a branch from ``a`` to ``b``."""
    return {a: 1.0, b: -1.0}


def series(name: str, a: str, b: str, r_ohm: float, l_h: float) -> Branch:
    """A line, a reactor, a short-circuit impedance: R and L."""
    return Branch(name, between(a, b), r_ohm, l_h)


def series_capacitor(name: str, a: str, b: str, x_ohm: float, w1_rad_s: float, r_ohm: float = 0.0) -> Branch:
    """A capacitor of reactance ``x_ohm`` at the fundamental in the current's way."""
    return Branch(name, between(a, b), r_ohm, 0.0, 1.0 / (w1_rad_s * x_ohm))


def shunt_capacitor(name: str, node: str, c_f: float, r_ohm: float = 0.0) -> Branch:
    """A capacitor to ground."""
    return Branch(name, between(node, GROUND), r_ohm, 0.0, c_f)


def shunt_reactor(name: str, node: str, l_h: float, r_ohm: float = 0.0) -> Branch:
    """A reactor to ground."""
    return Branch(name, between(node, GROUND), r_ohm, l_h)


def shunt_resistor(name: str, node: str, r_ohm: float) -> Branch:
    """A resistor to ground, such as a passive load."""
    return Branch(name, between(node, GROUND), r_ohm)


def single_tuned(name: str, node: str, c_f: float, tuned_hz: float, quality: float) -> tuple[Branch, ...]:
    """C, L and R in series to ground; ``quality`` is w L / R at the tuned frequency."""
    w = 2.0 * pi * tuned_hz
    l_h = 1.0 / (w**2 * c_f)
    r_ohm = 0.0 if quality == inf else w * l_h / quality
    return (Branch(name, between(node, GROUND), r_ohm, l_h, c_f),)


def high_pass(name: str, node: str, c_f: float, tuned_hz: float, quality: float) -> tuple[Branch, ...]:
    """C in series with L and R in parallel to ground; ``quality`` is R / (w L) at the tuned frequency."""
    w = 2.0 * pi * tuned_hz
    l_h = 1.0 / (w**2 * c_f)
    inner = f"{name}.inner"
    return (
        Branch(f"{name}.c", between(node, inner), 0.0, 0.0, c_f),
        Branch(f"{name}.l", between(inner, GROUND), 0.0, l_h),
        Branch(f"{name}.r", between(inner, GROUND), quality * w * l_h),
    )


def pi_line(line: Line, sections: int) -> tuple[Branch, ...]:
    """``sections`` equal pi sections in place of a distributed line."""
    part = line.length_km / sections
    nodes = [line.a, *(f"{line.name}.{k}" for k in range(1, sections)), line.b]
    branches = []
    for k, (a, b) in enumerate(pairwise(nodes), start=1):
        branches.append(Branch(f"{line.name}.series{k}", between(a, b), line.r_ohm_km * part, line.l_h_km * part))
        branches += [half for node in (a, b) for half in _half_shunt(f"{line.name}.shunt{k}{node}", node, line, part)]
    return tuple(branches)


def _half_shunt(name: str, node: str, line: Line, part_km: float) -> list[Branch]:
    """Half a section's C and G to ground."""
    if node == GROUND:
        return []
    c_f, g_s = line.c_f_km * part_km / 2.0, line.g_s_km * part_km / 2.0
    shunts = [Branch(f"{name}.c", between(node, GROUND), c_f=c_f)] if c_f > 0.0 else []
    return [*shunts, *([Branch(f"{name}.g", between(node, GROUND), 1.0 / g_s)] if g_s > 0.0 else [])]


def transformer(
    name: str, low: str, high: str, ratio: float, rated_va: float, low_v: float, vk: float, vkr: float, w1_rad_s: float
) -> Branch:
    """Two windings with their leakage seen from the low-voltage side, magnetising current and vector group left out.

    Parameters
    ----------
    name, low, high : str
        Name and nodes.
    ratio : float
        Low over high voltage, the tap included.
    rated_va, low_v : float
        Rating (VA) and rated voltage of the low side (V).
    vk, vkr : float
        Short-circuit voltage and its resistive part, per unit.
    w1_rad_s : float
        Fundamental angular frequency (rad/s).

    Notes
    -----
    A phase shift by the vector group turns positive sequence and mirror image against each other and drops out of a
    network without loops between voltage levels.
    """
    base = low_v**2 / rated_va
    x_ohm = sqrt(vk**2 - vkr**2) * base
    return Branch(name, {low: 1.0, high: -ratio}, vkr * base, x_ohm / w1_rad_s)
