"""The Bode margin of a farm at its source's bus, and how surely it is what it is.

The critical crossing is that of Q = Y1 Zg1 with the negative real axis, Y1 the farm's admittance of the positive
sequence with the mirror image closed through the source. A table's error dY moves Q by sum_ij w_ij dY_ij there; the
crossing moves along the frequency until Q is real again, and m = -1/Q with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...identify.frames import dq_to_pn
from ..crossings import Crossing, bode_crossings, critical_crossing
from ..siso import SeriesRL, impedance_pn, siso
from .farm import Farm, admittance_at_source, source_dq
from .system import system_of

_STEP = 1e-6  # relative step of the differences; their error is of its square


class Margin(NamedTuple):
    """The critical crossing, and the standard error of its m."""

    crossing: Crossing
    std: float


def crossing_at_source(farm: Farm) -> Crossing | None:
    """The critical crossing of Y1 of the whole farm with the source's admittance; None if there is none."""
    f1 = farm.entry.f1_hz
    found = bode_crossings(
        lambda f: admittance_at_source(farm, f), source_grid(farm), 1.0, f1 + 0.9 * farm.system.end_hz
    )
    return critical_crossing(found, f1)


def margin_at_source(farm: Farm) -> Margin | None:
    """The critical crossing with the standard error of m; errors add over tables."""
    crossing = crossing_at_source(farm)
    if crossing is None:
        return None
    f, h = crossing.f_hz, _STEP * crossing.f_hz
    slope = (_ratio(farm, f + h) - _ratio(farm, f - h)) / (2.0 * h)
    weights = {key: _weight(farm, f, key)[None] for key in farm.system.models}
    errors = farm.system.errors(np.array([2j * np.pi * (f - farm.entry.f1_hz)]), weights)[0]
    moved = errors.real - slope.real / slope.imag * errors.imag
    return Margin(crossing, crossing.m**2 * float(np.linalg.norm(moved)))


def source_grid(farm: Farm) -> SeriesRL:
    """The source's impedance as a grid."""
    z = farm.entry.source_z_ohm
    return SeriesRL(z.real, z.imag, farm.entry.f1_hz)


def _weight(farm: Farm, f_hz: float, key: str) -> np.ndarray:
    """dQ/dY (2, 2) of one table at a frequency."""
    weight = np.zeros((2, 2), dtype=complex)
    size = max(float(np.abs(unit.model.residues).max()) for unit in farm.system.units) * _STEP / 300.0
    for k in range(4):
        change = np.zeros((2, 2))
        change.flat[k] = size
        weight.flat[k] = (_ratio(farm, f_hz, {key: change}) - _ratio(farm, f_hz, {key: -change})) / (2.0 * size)
    return weight


def _ratio(farm: Farm, f_hz: float, changes: dict[str, np.ndarray] | None = None) -> complex:
    """Q = Y1 Zg1 at one frequency, tables' dq admittances changed by so much (2, 2)."""
    entry = farm.entry
    system = system_of(farm.system.units, entry.network, entry.f1_hz, [entry.source_bus])
    f = np.array([f_hz])
    s = 2j * np.pi * (f - entry.f1_hz)
    y = system.admittance(s)
    for unit in farm.system.units:
        if changes and unit.key in changes:
            place = system.place(unit)
            y[:, place, place] += unit.factor * unit.turn @ changes[unit.key] @ unit.turn.T
    z = system.impedance(s)
    total = np.linalg.solve(np.eye(z.shape[1]) + z @ y, z)
    at = 2 * system.ports.index(entry.source_bus)
    own = np.linalg.inv(total[:, at : at + 2, at : at + 2]) - np.linalg.inv(source_dq(entry, s))
    grid = source_grid(farm)
    return complex(siso(f, dq_to_pn(own), grid).y1[0] * impedance_pn(grid, f)[0][0])
