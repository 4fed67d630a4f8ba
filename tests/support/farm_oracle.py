"""N reference turbines behind transformers on one collector bus, linearised as one explicit set of equations.

Nothing is shared with the product but the turbine's own linearisation in `oracle` and the parameters' values. All
vectors are power-invariant dq pairs in the frame of the source; turbine i's own frame leads it by d_i.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import oracle

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
W1 = 2.0 * np.pi * 50.0
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Star:
    """Each turbine behind z_t (ohm at 690 V) on a bus with a capacitor C (F), the source behind z_s."""

    z_t: complex
    c_f: float
    z_s: complex
    source_v: float = 690.0


def operating_point(star: Star, powers_w: list[float]) -> tuple[np.ndarray, complex]:
    """Terminal voltages (n,) complex and the bus voltage, by fixed-point iteration on the exact turbine's current."""
    v = np.full(len(powers_w), 690.0 + 0j)
    p = oracle.TABLE_I
    y_shunt = 1.0 / (p.r_f_ohm + 1.0 / (1j * W1 * p.c_f_f))
    bus = 690.0 + 0j
    for _ in range(2000):
        i = np.conj(np.array(powers_w) / v) - y_shunt * v  # out of each turbine
        total = np.sum(i) - 1j * W1 * star.c_f * bus
        bus = bus + 0.2 * (star.source_v + star.z_s * total - bus)
        v = v + 0.2 * (bus + star.z_t * i - v)
    return v, complex(bus)


def _plain(k: int, power_w: float, voltage_v: float) -> System:
    m = oracle.linearise(power_w, voltage_v)
    return m.A, m.B, m.C, m.D


def closed_loop(
    star: Star,
    powers_w: list[float],
    system: Callable[[int, float, float], System] = _plain,
    at_bus: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Poles of turbines and network (rad/s, dq), and the turbines' terminal voltages (n,) complex (V).

    ``system`` gives A, B, C, D of turbine k at a power (W) and a terminal voltage (V); ``at_bus`` is A, B, C of
    something that draws a current i = C x from the collector bus.
    """
    v, _ = operating_point(star, powers_w)
    n = len(powers_w)
    systems = [system(k, power, abs(v[k])) for k, power in enumerate(powers_w)]
    own = len(systems[0][0])
    size = own * n + 2 * n + 4
    a = np.zeros((size, size))
    bus, source = slice(size - 4, size - 2), slice(size - 2, size)
    a[bus, bus] = -W1 * J
    l_t, l_s = star.z_t.imag / W1, star.z_s.imag / W1
    for k, (m_a, m_b, m_c, m_d) in enumerate(systems):
        c, s = np.cos(np.angle(v[k])), np.sin(np.angle(v[k]))
        turn = np.array([[c, -s], [s, c]])
        x, i = slice(own * k, own * k + own), slice(own * n + 2 * k, own * n + 2 * k + 2)
        d_inverse = np.linalg.inv(turn @ m_d @ turn.T)
        # the turbine draws C x + D v = -i_t; so v = -D^-1 (C x + i_t)
        by_x, by_i = -d_inverse @ turn @ m_c, -d_inverse
        a[x, x] = m_a + m_b @ turn.T @ by_x
        a[x, i] = m_b @ turn.T @ by_i
        a[i, x] = by_x / l_t
        a[i, i] = (by_i - star.z_t.real * np.eye(2)) / l_t - W1 * J
        a[i, bus] = -np.eye(2) / l_t
        a[bus, i] = np.eye(2) / star.c_f
    a[bus, source] = -np.eye(2) / star.c_f
    a[source, bus] = np.eye(2) / l_s
    a[source, source] = -star.z_s.real / l_s * np.eye(2) - W1 * J
    if at_bus is not None:
        a = _with_another(a, bus, star.c_f, at_bus)
    return np.linalg.eigvals(a), v


def _with_another(
    a: np.ndarray, bus: slice, c_f: float, other: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    own, by_bus, current = other
    grown = np.zeros((len(a) + len(own),) * 2)
    grown[: len(a), : len(a)], grown[len(a) :, len(a) :] = a, own
    grown[len(a) :, bus], grown[bus, len(a) :] = by_bus, -current / c_f
    return grown
