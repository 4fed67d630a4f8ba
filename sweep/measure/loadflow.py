"""The operating point that belongs to a grid, found on the black box itself.

Behind a Thevenin source the device is settled there, on a source of known voltage. On an ideal source it is settled at
trial voltages and its fundamental current is read at the terminals; the voltage is right where
``|v_pcc + Z_grid i| = |v_g|``. No look inside, and it works where the closed loop is unstable.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from ...identify.fourier import line
from ...plant.protocol import Job, NotSettled, OperatingPoint, Plant, Source
from ...plant.space_vectors import LINE_RMS
from ..excitation.frequencies import coherent_block
from ..plan import Condition, Grid, operating_point

TOLERANCE = 1e-10
"""Mismatch of the source voltage accepted, relative."""

MAX_TRIALS = 30


def reached(plant: Plant, source: Source, condition: Condition) -> tuple[Source, OperatingPoint]:
    """Source and operating point for `Plant.settle`: a grid's voltage is turned into |v_pcc|.

    A Thevenin source of a condition with its own grid *is* that grid.

    Raises
    ------
    NotSettled
        If the grid cannot carry the power.
    """
    if condition.grid is None:
        return source, operating_point(condition)
    q_var = condition.reactive_power_var
    if source.kind != "ideal":  # the device finds its own voltage there, and never stands on an ideal source
        behind = replace(feeding(source, condition), voltage_v=condition.grid.voltage_v)
        return behind, OperatingPoint(condition.active_power_w, None, q_var)
    voltage_v = terminal_voltage(plant, condition.active_power_w, condition.grid, q_var)
    return source, OperatingPoint(condition.active_power_w, voltage_v, q_var)


def feeding(source: Source, condition: Condition) -> Source:
    """The source that feeds the PCC at ``condition``: a Thevenin source of one with its own grid *is* that grid."""
    if source.kind == "ideal" or condition.grid is None:
        return source
    grid = condition.grid
    kind: Literal["thevenin", "network"] = "thevenin" if grid.circuit is None else "network"
    return replace(source, kind=kind, r_ohm=grid.r_ohm, l_h=grid.l_h, circuit=grid.circuit)


def terminal_voltage(plant: Plant, active_power_w: float, grid: Grid, reactive_power_var: float = 0.0) -> float:
    """|v_pcc| (V, line-to-line RMS) at which the device is in equilibrium with ``grid``: the upper one.

    Secant steps from the top of the plant's range downwards.

    Raises
    ------
    NotSettled
        If no voltage in the plant's range satisfies the grid.
    """
    low, high = plant.operating_range.terminal_voltage_v
    source_v = grid.no_load * grid.voltage_v
    z = grid.r_ohm + 2j * np.pi * plant.f1_hz * grid.l_h

    def excess(v: float) -> float:
        point = OperatingPoint(active_power_w, v, reactive_power_var)
        return abs(v + z * _current(plant, point)) - source_v

    before, now = min(high, 1.02 * source_v), min(high, source_v) * 0.999
    f_before, f_now = excess(before), excess(now)
    for _ in range(MAX_TRIALS):
        if abs(f_now) <= TOLERANCE * source_v:
            return now
        slope = (f_now - f_before) / (now - before)
        if slope <= 0.0:
            break
        step = float(np.clip(-f_now / slope, -0.1 * now, 0.1 * now))
        before, f_before, now = now, f_now, min(high, now + step)
        if not low <= now or now == before:
            break
        f_now = excess(now)
    raise NotSettled(
        f"the grid of {z.real:.4g} + j{z.imag:.4g} ohm at {source_v:.4g} V has no operating point with "
        f"{active_power_w / 1e6:.4g} MW and |v_pcc| between {low:.4g} and {high:.4g} V"
    )


def _current(plant: Plant, point: OperatingPoint) -> complex:
    """Fundamental current (A, line-to-line-RMS convention, load direction), v_pcc at angle zero."""
    state = plant.settle(point, Source())
    steps = coherent_block(plant.f1_hz, plant.dt_s).steps
    ((_, record),) = plant.run([Job(state, None)], steps)
    v, i = (line(x, plant.f1_hz, record.t0_s, record.dt_s) for x in (record.v, record.i))
    return complex(LINE_RMS * i * abs(v) / v)
