"""The load flow of a farm: the voltage and the angle of every terminal, every device as it really feeds in.

With the network seen from the devices' terminals, V = V_oc - Z I(V), where V_oc is what the source alone gives, Z the
impedance matrix of the terminals at f1 and I the current that a device draws, power-invariant (|V| line-to-line RMS,
S = V conj(I)). Newton's method on real and imaginary parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..network.assembly import port_impedance
from .entries import FarmEntry, NoLoadFlow

Draw = Callable[[np.ndarray], np.ndarray]
"""Terminal voltages |V| (n,) in V to the complex power (n,) in VA that each device draws."""

_STEPS = 50
_SMALL = 1e-12


class LoadFlow(NamedTuple):
    """Where a farm stands.

    Attributes
    ----------
    voltage_v : (n,) complex
        Terminal voltage of every device (V, line-to-line RMS), its angle against the source.
    power_va : (n,) complex
        What each device draws (VA); a generator has a negative active power.
    """

    voltage_v: np.ndarray
    power_va: np.ndarray


def load_flow(farm: FarmEntry, drawn: Draw) -> LoadFlow:
    """Solve for the terminals of all devices.

    Raises
    ------
    NoLoadFlow
        If there is no solution; the largest part of the power that has one is said.
    """
    open_circuit, z = on_source(seen_at_f1(farm), farm.source_z_ohm, farm.source_z_ohm, farm.source_voltage_v)
    return solved(farm.name, open_circuit, z, drawn)


def solved(name: str, open_circuit: np.ndarray, z: np.ndarray, drawn: Draw) -> LoadFlow:
    """The terminals of devices that see V_oc (n,) in V behind Z (n, n) in ohm.

    Raises
    ------
    NoLoadFlow
        If there is no solution.
    """
    found = _newton(open_circuit, z, drawn, 1.0, open_circuit)
    if found is None:
        raise NoLoadFlow(
            f"{name}: the load flow has no solution: the network cannot carry the power; "
            f"{100.0 * _largest_part(open_circuit, z, drawn):.0f} % of it has one"
        )
    return LoadFlow(found, drawn(np.abs(found)))


def seen_at_f1(farm: FarmEntry) -> np.ndarray:
    """Impedance (n + 1, n + 1) in ohm at f1 of all terminals and, last, of the source's bus, the source in place."""
    ports = [*(device.bus for device in farm.devices), farm.source_bus]
    z: np.ndarray = port_impedance(farm.network, ports, np.array([2j * np.pi * farm.f1_hz]))[0]
    return z


def on_source(seen: np.ndarray, own_ohm: complex, z_ohm: complex, voltage_v: float) -> tuple[np.ndarray, np.ndarray]:
    """V_oc (n,) in V and Z (n, n) in ohm at f1 of the terminals, on a source of ``z_ohm`` in place of ``own_ohm``.

    Notes
    -----
    The source's admittance changes by 1/z - 1/z_own, which changes Z by a matrix of rank one.
    """
    other = 1.0 - z_ohm / own_ohm
    by_source = seen[:-1, -1] / (z_ohm + other * seen[-1, -1])
    return by_source * voltage_v, seen[:-1, :-1] - other * by_source[:, None] * seen[-1, :-1]


def _newton(open_circuit: np.ndarray, z: np.ndarray, drawn: Draw, part: float, start: np.ndarray) -> np.ndarray | None:
    """V with V - V_oc + Z conj(part S/V) = 0; None where the steps do not come to rest near the rated voltage."""
    v = start.astype(complex)
    for _ in range(_STEPS):
        s = part * drawn(np.abs(v))
        excess = v - open_circuit + z @ np.conj(s / v)
        other = -z * np.conj(s / v**2)[None]  # by conj(V), |V| held in S
        jacobian = _real_form(np.eye(len(v)), other)
        try:
            step = np.linalg.solve(jacobian, np.concatenate([excess.real, excess.imag]))
        except np.linalg.LinAlgError:
            return None
        v = v - (step[: len(v)] + 1j * step[len(v) :])
        if not np.all(np.isfinite(v)) or np.abs(v).min() < 0.2 * np.abs(open_circuit).min():
            return None
        if np.abs(step).max() < _SMALL * np.abs(v).max():
            return v
    return v if np.abs(step).max() < 1e-6 * np.abs(v).max() else None


def _real_form(by_v: np.ndarray, by_conjugate: np.ndarray) -> np.ndarray:
    """The real Jacobian of a function of V and conj(V)."""
    plus, minus = by_v + by_conjugate, by_v - by_conjugate
    return np.block([[plus.real, -minus.imag], [plus.imag, minus.real]])


def _largest_part(open_circuit: np.ndarray, z: np.ndarray, drawn: Draw) -> float:
    low, high, start = 0.0, 1.0, open_circuit
    for _ in range(20):
        middle = (low + high) / 2.0
        found = _newton(open_circuit, z, drawn, middle, start)
        low, high, start = (middle, high, found) if found is not None else (low, middle, start)
    return low


def angles(flow: LoadFlow) -> np.ndarray:
    """(n,) rad by which the terminals lead the source."""
    return np.angle(flow.voltage_v)


def distances(flow: LoadFlow, swept_v: Sequence[float | None]) -> np.ndarray:
    """(n,) relative difference between the terminal voltage and that of the sweep; NaN where the table says none."""
    swept = np.array([np.nan if v is None else v for v in swept_v])
    return np.abs(flow.voltage_v) / swept - 1.0
