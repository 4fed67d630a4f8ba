"""Do table and grid belong together? A remark, never a change of the verdict.

A table holds the device at one active power and one |v_pcc|. On another grid the same source gives another |v_pcc|,
and the device another admittance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .grids.errors import GridError
from .grids.in_time import grid_of_fact
from .grids.voltages import check_device
from .grids.words import in_ohm
from .siso import Grid

if TYPE_CHECKING:
    from ..identify.response import FrequencyResponse

SAME_GRID = 0.005
"""Relative difference of impedances up to which two grids count as one."""

PLAUSIBLE_SCR = (0.3, 1000.0)
"""Short-circuit ratios of grids that somebody connects a converter to."""

SOURCE_TOLERANCE_PU = 0.07
"""Where a table does not tell the device's reactive power: that much of source voltage is left open (pu)."""

MEASURED_TOLERANCE_PU = 0.05
"""Where it does: so far from one the source voltage is worth a word (pu)."""


def check_belongs(response: FrequencyResponse, bases: Mapping[str, Any], grid: Grid) -> None:
    """Refuse a grid that cannot be this device's: at another voltage, or scanned at none of the device's frequencies.

    Raises
    ------
    GridError
        With what the two files say.
    """
    document = getattr(grid, "document", None) or {}
    name = getattr(grid, "name", "") or "the grid"
    check_device(name, document.get("voltage_kv"), bases.get("rated_voltage_v"))
    rows_hz = getattr(grid, "rows_hz", None)
    if rows_hz is None or not len(response.f_hz):
        return
    low, high = np.abs(response.f_hz).min(), np.abs(response.f_hz).max()
    if rows_hz[-1] < low or rows_hz[0] > high:
        raise GridError(
            f"{name}: its rows reach from {rows_hz[0]:.4g} to {rows_hz[-1]:.4g} Hz, "
            f"those of the device from {low:.4g} to {high:.4g} Hz: they have no frequency in common. Is the unit of "
            "its frequencies the one meant? Touchstone without an option line means GHz"
        )


def grid_warnings(point: Mapping[str, Any], bases: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """Remarks on an operating point of the table and the grid it is tuned for.

    Parameters
    ----------
    point : mapping
        ``active_power_mw``, ``terminal_voltage_pu`` and, where the source voltage was fixed in the sweep, ``grid``
        with ``r_ohm``, ``x_ohm``, ``voltage_pu``, ``scale``. Unknown values are None or missing.
    bases : mapping
        ``rated_voltage_v`` (line-to-line RMS), ``rated_power_va``.
    grid : Grid
        The grid of the tuning.
    """
    if grid.couples:
        return ()  # a converter sets its own voltage: no load flow of a line tells it
    swept = point.get("grid")
    load_flow = _no_operating_point(point, bases, grid)
    if not load_flow:
        load_flow = _against_swept_grid(swept, grid) if swept else _source(point, bases, grid)
    return (*_implausible(bases, grid), *load_flow)


def _implausible(bases: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """A short-circuit ratio that no grid has, as when milliohm are taken for ohm."""
    if not (bases.get("rated_voltage_v") and bases.get("rated_power_va")):
        return ()
    scr = bases["rated_voltage_v"] ** 2 / (bases["rated_power_va"] * grid.size_ohm)
    if PLAUSIBLE_SCR[0] <= scr <= PLAUSIBLE_SCR[1]:
        return ()
    return (f"the grid's short-circuit ratio is {scr:.2g}: R + jX is in ohm at f1, is that its unit?",)


def _no_operating_point(point: Mapping[str, Any], bases: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """A power that the grid cannot carry from |v_pcc| of the table to a source at 1 pu, whatever the reactive power."""
    voltage_pu, rated_v = point.get("terminal_voltage_pu") or 1.0, bases.get("rated_voltage_v")
    power_va, _ = _power_out(point)
    if power_va is None or not rated_v:
        return ()
    least, most = power_limits_w(voltage_pu * rated_v, rated_v, grid)
    if least <= power_va.real <= most:
        return ()
    limit = most if power_va.real > 0.0 else least
    return (
        f"no operating point exists on this grid with a source at 1 pu: from |v_pcc| = {voltage_pu:.4g} pu it carries "
        f"at most {abs(limit) / 1e6:.3g} MW, with whatever reactive power; the table's point is "
        f"{power_va.real / 1e6:.4g} MW",
    )


def power_limits_w(terminal_voltage_v: float, source_voltage_v: float, grid: Grid) -> tuple[float, float]:
    """Least and largest P (W) out of a device at |v_pcc| into a source of |v_g| (V) behind the grid, over all angles.

    P = Re(v conj((v - v_g)/Z)) = |v|^2 R/|Z|^2 - |v| |v_g|/|Z| cos(angle): Kundur, 1994, section 6.4.
    """
    z = grid.at_f1
    own = terminal_voltage_v**2 * z.real / abs(z) ** 2
    across = terminal_voltage_v * source_voltage_v / abs(z)
    return own - across, own + across


def _source(point: Mapping[str, Any], bases: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """The source voltage that |v_pcc| of the table would take, where it is far from one."""
    voltage_pu, rated_v = point.get("terminal_voltage_pu"), bases.get("rated_voltage_v")
    if not (voltage_pu and rated_v):
        return ()
    power_va, tolerance_pu = _power_out(point)
    if power_va is None:
        return ()
    source_pu = source_voltage_v(power_va, voltage_pu * rated_v, grid) / rated_v
    if abs(source_pu - 1.0) <= tolerance_pu:
        return ()
    neglected = "" if tolerance_pu == MEASURED_TOLERANCE_PU else " (reactive power neglected)"
    return (
        f"the table was swept at |v_pcc| = {voltage_pu:.4g} pu; on this grid that takes a source of about "
        f"{source_pu:.3g} pu{neglected}. If the source is at 1 pu, sweep at the voltage that belongs "
        "to it: grid = { r_ohm, x_ohm, voltage_pu } in the operating point",
    )


def _power_out(point: Mapping[str, Any]) -> tuple[complex | None, float]:
    """Power out of the device (VA), measured or asked for, and from which difference (pu) on a source is told."""
    measured = point.get("fundamental")
    if measured is not None:
        into = complex(measured["active_power_into_device_w"], measured["reactive_power_into_device_var"])
        return -into, MEASURED_TOLERANCE_PU
    power_mw = point.get("active_power_mw")
    return None if power_mw is None else power_mw * 1e6, SOURCE_TOLERANCE_PU


def source_voltage_v(power_va: complex, terminal_voltage_v: float, grid: Grid) -> float:
    """|v_g| (V) behind the grid for a complex power out of the device (VA) at |v_pcc| (V, line-to-line RMS)."""
    current = np.conj(power_va) / terminal_voltage_v
    return float(np.abs(terminal_voltage_v - grid.at_f1 * current))


def _against_swept_grid(swept: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    z = grid_of_fact(swept, grid.f1_hz).at_f1
    if np.abs(z - grid.at_f1) <= SAME_GRID * grid.size_ohm:
        return ()
    return (
        f"the table was swept with the PCC voltage that belongs to {in_ohm(z)} ohm, not to "
        f"{in_ohm(grid.at_f1)} ohm: the device will work at another voltage there; sweep "
        "again with this grid in the operating point",
    )
