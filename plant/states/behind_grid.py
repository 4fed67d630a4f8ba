"""A device that comes to rest by waiting, settled behind a grid without ever standing on an ideal source.

Not every device likes an ideal source: a stiff grid-forming inverter is unstable there. So it is started behind the
grid it is asked for, or behind a friendlier one (``settle_on``), from which it is walked to the asked one: the grid
moves in small steps, and after each the device is waited for. The source's voltage follows |v_pcc| where that is asked.
"""

from __future__ import annotations

import cmath
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from ..protocol import NotSettled, OperatingPoint, Source
from .steady_state import phase_peak

S = TypeVar("S")

WALK = 8
"""Steps of a walk from one grid to another."""

VOLTAGE_REACHED = 1e-6
"""How near |v_pcc| comes to what was asked behind a grid, relative."""

MOST_TRIALS = 40

LARGEST_STEP = 0.1
"""Largest relative change of the source's voltage at a time."""


class Waiting(Protocol[S]):
    """A device that is started cold and waited for."""

    def begun(self, point: OperatingPoint, source: Source, v_source: complex) -> S:
        """Cold, on a source of known voltage (V, phase peak, at time zero)."""
        ...

    def onwards(self, state: S) -> S:
        """Until a period repeats; `NotSettled` where none does."""
        ...

    def fundamental(self, state: S) -> tuple[S, complex, complex]:
        """Phasors of v_pcc (V) and i (A, load direction), phase peak at time zero, and the state to go on from.

        A device that cannot go back is a period further on by then.
        """
        ...

    def put_behind(self, state: S, source: Source, v_source: complex) -> S:
        """The same device behind another source."""
        ...

    def grid_impedance(self, source: Source) -> complex:
        """Impedance (ohm) of a source at f1 as the device's own stepper has it."""
        ...


def settled_behind(device: Waiting[Any], point: OperatingPoint, source: Source) -> Any:
    """The periodic state behind ``source``, which has either a voltage of its own or holds ``point``'s |v_pcc|.

    Raises
    ------
    NotSettled
        If the device finds no rest where it starts, or loses it on the way; the message says where.
    """
    start = source if source.settle_on is None else _friendly(source)
    state = device.onwards(device.begun(point, start, _first_voltage(device, point, start)))
    for k in range(1, WALK + 1 if source.settle_on is not None else 1):
        state = _stepped(device, state, _between(start, source, k / WALK), point)
    return _held(device, state, source, point)


def _friendly(source: Source) -> Source:
    assert source.settle_on is not None
    r_ohm, l_h = source.settle_on
    return replace(source, r_ohm=r_ohm, l_h=l_h, settle_on=None)


def _between(start: Source, end: Source, share: float) -> Source:
    r_ohm, l_h = ((1.0 - share) * a + share * b for a, b in ((start.r_ohm, end.r_ohm), (start.l_h, end.l_h)))
    return replace(end, r_ohm=r_ohm, l_h=l_h)


def _first_voltage(device: Waiting[Any], point: OperatingPoint, source: Source) -> complex:
    """Source voltage that would give |v_pcc| if the device carried exactly P and Q."""
    if source.voltage_v is not None:
        return phase_peak(source.voltage_v, source.angle_rad)
    assert point.terminal_voltage_v is not None
    v = phase_peak(point.terminal_voltage_v)
    power = complex(point.active_power_w, point.reactive_power_var)
    i_out = (2.0 / 3.0 * power / v).conjugate()
    return abs(v - device.grid_impedance(source) * i_out) * cmath.exp(1j * source.angle_rad)


def _stepped(device: Waiting[Any], state: Any, source: Source, point: OperatingPoint) -> Any:
    """Behind the next grid of a walk, at rest again."""
    if source.voltage_v is not None:
        size = _first_voltage(device, point, source)
    else:
        state, size = _as_it_is(device, state, source)
    try:
        return device.onwards(device.put_behind(state, source, size))
    except NotSettled as refusal:
        z = device.grid_impedance(source)
        raise NotSettled(
            f"on the way from settle_on the device was lost at {z.real:.4g} + j{z.imag:.4g} ohm: {refusal}",
            refusal.status,
        ) from None


def _as_it_is(device: Waiting[Any], state: Any, source: Source) -> tuple[Any, complex]:
    """Source voltage, at the source's own angle, that leaves |v_pcc| about where it is."""
    state, v, i = device.fundamental(state)
    return state, abs(v + device.grid_impedance(source) * i) * cmath.exp(1j * source.angle_rad)


def _held(device: Waiting[Any], state: Any, source: Source, point: OperatingPoint) -> Any:
    """At rest with the source's voltage such that |v_pcc| is the operating point's, where that is what is asked.

    Secant steps: a device that holds its voltage hardly follows the source's.
    """
    if source.voltage_v is not None:
        return state
    assert point.terminal_voltage_v is not None
    wanted = abs(phase_peak(point.terminal_voltage_v))
    v_source, slope, step, before = state.v_source, 1.0, 0.0, None
    for _ in range(MOST_TRIALS):
        state, v, _ = device.fundamental(state)
        excess = abs(v) / wanted - 1.0
        if abs(excess) <= VOLTAGE_REACHED:
            return state
        if before is not None and (excess - before) * step > 0.0:
            slope = (excess - before) / step
        step = max(-LARGEST_STEP, min(LARGEST_STEP, -excess / slope))
        before, v_source = excess, v_source * (1.0 + step)
        state = device.onwards(device.put_behind(state, source, v_source))
    raise NotSettled(f"no source voltage brings |v_pcc| to {point.terminal_voltage_v:g} V behind this grid")
