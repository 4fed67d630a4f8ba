"""Which |v_pcc| a device of given power has on a grid: the load flow of the surrogate's own terminal current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.surrogate.surrogate import Surrogate
from ...plant.errors import SeqsweepError
from ..siso import Grid

_HALVINGS = 50
_VOLTAGE = 2  # its place in an operating point


@dataclass(frozen=True, slots=True)
class Situation:
    """A grid with the source behind it.

    Attributes
    ----------
    name : str
        What it is called in an answer.
    grid : Grid
        The grid.
    source_voltage_pu : float or None
        |v_g| over the rated voltage; None: not known, and |v_pcc| is free within the region.
    rated_voltage_v : float or None
        Base of the voltages (V, line-to-line RMS); needed with ``source_voltage_pu``.
    """

    name: str
    grid: Grid
    source_voltage_pu: float | None = None
    rated_voltage_v: float | None = None

    def place(self, surrogate: Surrogate, points: np.ndarray) -> np.ndarray:
        """Operating points (p, d) as they are on this grid: |v_pcc| by load flow, NaN where there is none."""
        if self.source_voltage_pu is None:
            return points
        if self.rated_voltage_v is None:
            raise SeqsweepError("a load flow needs the rated voltage (V, line-to-line RMS) that per unit refers to")
        return on_grid(surrogate, self.grid, points, self.source_voltage_pu, self.rated_voltage_v)


def on_grid(
    surrogate: Surrogate, grid: Grid, points: np.ndarray, source_voltage_pu: float, rated_voltage_v: float
) -> np.ndarray:
    """Operating points (p, d) with |v_pcc| from the load flow of the surrogate's own terminal current.

    Notes
    -----
    |V - Z(f1) i| = E for the source voltage E, i out of the device, V real; bisection on V over the region. Where the
    region holds no solution |v_pcc| is NaN.
    """
    z = grid.at_f1
    found = points.copy()
    lower, upper = np.full(len(points), surrogate.region.low[2]), np.full(len(points), surrogate.region.high[2])
    at_low, at_high = (
        _source_excess(surrogate, points, v, z, source_voltage_pu, rated_voltage_v) for v in (lower, upper)
    )
    for _ in range(_HALVINGS):
        middle = (lower + upper) / 2.0
        below = _source_excess(surrogate, points, middle, z, source_voltage_pu, rated_voltage_v) < 0.0
        lower, upper = np.where(below, middle, lower), np.where(below, upper, middle)
    found[:, 2] = np.where((at_low <= 0.0) & (at_high >= 0.0), (lower + upper) / 2.0, np.nan)
    return found


def covering_on(surrogate: Surrogate, situation: Situation, n: int) -> np.ndarray:
    """Operating points (p, d) that cover what a grid with a known source makes of the region, its borders included.

    A lattice of about ``n`` powers, and parameters where they are axes, with their load flow; and the border where
    |v_pcc| is at an end of the region: there one power follows from the others.
    """
    assert situation.source_voltage_pu is not None
    axes = [int(a) for a in np.flatnonzero(surrogate.region.varies) if a != _VOLTAGE]
    levels = max(2, round(n ** (1.0 / max(len(axes), 1))))
    lattice = _lattice(surrogate, axes, levels)
    powers = [axis for axis in axes if axis < _VOLTAGE]
    borders = [_border(surrogate, situation, axes, axis, end, 2 * levels) for axis in powers for end in (0, 1)]
    return np.vstack([situation.place(surrogate, lattice), *borders])


def admissible(surrogate: Surrogate, situation: Situation, covering: np.ndarray) -> np.ndarray:
    """The points at which the device can be on a grid: of a covering, or of what the load flow makes of the region."""
    points = covering
    if situation.source_voltage_pu is not None:
        points = covering_on(surrogate, situation, len(covering))
    return points[surrogate.holds(points)]


def _lattice(surrogate: Surrogate, axes: Sequence[int], levels: int) -> np.ndarray:
    region = surrogate.region
    each = np.meshgrid(*[np.linspace(region.low[a], region.high[a], levels) for a in axes], indexing="ij")
    points = np.tile(region.low, (levels ** len(axes), 1))
    for axis, values in zip(axes, each, strict=True):
        points[:, axis] = values.ravel()
    return points


def _border(
    surrogate: Surrogate, situation: Situation, axes: Sequence[int], axis: int, end: int, levels: int
) -> np.ndarray:
    """Points with |v_pcc| at an end of the region; the power ``axis`` solves the load flow, where it can."""
    region = surrogate.region
    points = _lattice(surrogate, [a for a in axes if a != axis], levels)
    points[:, 2] = (region.low, region.high)[end][2]

    def excess(power: np.ndarray) -> np.ndarray:
        points[:, axis] = power
        assert situation.source_voltage_pu is not None
        assert situation.rated_voltage_v is not None
        z, source, rated = situation.grid.at_f1, situation.source_voltage_pu, situation.rated_voltage_v
        return _source_excess(surrogate, points, points[:, 2], z, source, rated)

    low, high = np.full(len(points), region.low[axis]), np.full(len(points), region.high[axis])
    at_low, at_high = excess(low), excess(high)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        like_low = (excess(middle) > 0.0) == (at_low > 0.0)
        low, high = np.where(like_low, middle, low), np.where(like_low, high, middle)
    points[:, axis] = np.where((at_low > 0.0) != (at_high > 0.0), (low + high) / 2.0, np.nan)
    return points


def _source_excess(
    surrogate: Surrogate, points: np.ndarray, v_pu: np.ndarray, z: complex, source_pu: float, rated_v: float
) -> np.ndarray:
    at = points.copy()
    at[:, _VOLTAGE] = v_pu
    v = v_pu * rated_v
    return np.asarray(np.abs(v - z * np.sqrt(3.0) * surrogate.terminal_current(at)) - source_pu * rated_v)


def dispatches(surrogate: Surrogate) -> list[tuple[float, float]]:
    """(P, Q) that an operator asks about where none is named: least, middle and greatest of each."""
    low, high = surrogate.region.low[:2], surrogate.region.high[:2]
    levels = [
        np.unique([a, (a + b) / 2.0, b]) if varies else np.array([a])
        for a, b, varies in zip(low, high, surrogate.region.varies[:2], strict=True)
    ]
    return [(float(p), float(q)) for p in levels[0] for q in levels[1]]


def named(power: Sequence[float]) -> str:
    """Name of a dispatch (P, Q) in an answer."""
    return f"p{power[0]:g}_q{power[1]:g}"


def predicted_on(surrogate: Surrogate, power: Sequence[float], situation: Situation) -> FrequencyResponse:
    """The device at a dispatch (P, Q) on a grid, as the surrogate predicts it there.

    Raises
    ------
    SeqsweepError
        If the source's voltage is not known and the region has several voltages, or if |v_pcc| would leave the region.
    """
    low, high = surrogate.region.low[2], surrogate.region.high[2]
    if situation.source_voltage_pu is None and surrogate.region.varies[2]:
        raise SeqsweepError(
            f"|v_pcc| lies between {low:g} and {high:g} pu; which it is follows from the grid: give --source-voltage"
        )
    surrogate.check_power(power, named(power))
    point = situation.place(surrogate, surrogate.region.complete(np.array([[*power, low]])))
    if not np.isfinite(point[0, 2]):
        raise SeqsweepError(
            f"{named(power)}: no operating point of the swept region exists on this grid: |v_pcc| would leave "
            f"{low:g} to {high:g} pu, or the grid cannot carry the power"
        )
    surrogate.check_inside(point[0], named(power))
    response = surrogate.response(point[0])
    meta: dict[str, Any] = {**response.meta, "op_id": named(power), **_fundamental(surrogate, point)}
    return replace(response, meta=meta)


def _fundamental(surrogate: Surrogate, point: np.ndarray) -> dict[str, Any]:
    """Measured facts of the point, as far as the surrogate knows them: what warnings of a grid rest on."""
    rated = (surrogate.meta.get("bases") or {}).get("rated_voltage_v")
    if surrogate.terminal is None or not rated:
        return {}
    voltage_v = float(point[0, 2]) * rated
    out_va = np.sqrt(3.0) * voltage_v * complex(surrogate.terminal_current(point)[0]).conjugate()
    return {
        "fundamental": {
            "active_power_into_device_w": -out_va.real,
            "reactive_power_into_device_var": -out_va.imag,
            "voltage_v": voltage_v,
        }
    }


__all__ = ["Situation", "admissible", "dispatches", "named", "on_grid", "predicted_on"]
