"""Grid-side damping converters in a farm: aimed at its critical mode from their buses, and sized by the eigenvalues.

A damper is linear below its current limit, so that the assembly takes it as one more unit, in the common frame. What
the limit does is a matter of size: with an oscillation of amplitude v at its bus the converter gives the current that
it is asked for up to limit / |y|, and from there on a part limit / (|y| v) of it. `held_amplitude` is the largest
oscillation from which the mode still decays, by that describing function.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np

from ...identify.fit.rational import RationalModel
from ...plant.damping.grid_side import GridSideDamper, aimed_at
from ..poles import BEYOND
from .entries import DamperEntry, FarmEntry, FarmError
from .participation import null_vectors
from .system import system_of
from .units import Unit

TRIED = 14
"""Sizes that are tried for the best damping, each twice the one before."""


@dataclass(frozen=True, slots=True)
class Damper:
    """A grid-side damping converter as it is set, and as a unit of the assembly."""

    entry: DamperEntry
    device: GridSideDamper
    unit: Unit

    @property
    def size_s(self) -> float:
        """Largest admittance (S) that it asks for at the mode."""
        at = np.array([1j * self.device.nu_rad_s, -1j * self.device.nu_rad_s])
        return float(np.abs(self.device.positive(at)).max())


def dampers_of(entry: FarmEntry, units: tuple[Unit, ...], pole: complex | None) -> tuple[Damper, ...]:
    """The dampers of a farm, each aimed at the mode that ``units`` and network have without them.

    Parameters
    ----------
    entry : FarmEntry
        The farm.
    units : tuple of Unit
        Its devices.
    pole : complex or None
        The critical mode (rad/s, dq).

    Raises
    ------
    FarmError
        If there is no mode to aim at.
    """
    if not entry.dampers:
        return ()
    if pole is None or not pole.imag > 0.0:
        raise FarmError("the farm has no oscillating mode in the band that a [[damper]] could be set to")
    found: tuple[Damper, ...] = ()
    for damper in entry.dampers:
        found = (*found, _aimed(entry, damper, units, found, pole))
    return found


def _aimed(
    entry: FarmEntry, damper: DamperEntry, units: tuple[Unit, ...], others: tuple[Damper, ...], pole: complex
) -> Damper:
    plus, minus = seen_from(entry, damper.bus, units, pole)
    limit = damper.share * rating_va(units) / entry.voltages_v[damper.bus]
    washout = 2.0 * pi * damper.washout_hz

    def sized(size_s: float) -> Damper:
        return _placed(damper, aimed_at(pole, plus, minus, size_s, limit, washout_rad_s=washout))

    if damper.size_s is not None:
        return sized(damper.size_s)
    first = 2.0 / float(np.hypot(abs(plus), abs(minus)))  # moves the mode by 2 1/s, to first order
    tried = [sized(first * 2.0**k) for k in range(TRIED)]
    worst = [largest_growth(entry, (*units, *(o.unit for o in others), one.unit)) for one in tried]
    best = int(np.argmin(worst))
    between = [_placed(damper, tried[best].device.scaled(factor)) for factor in (0.7, 0.85, 1.2, 1.4)]
    finer = [largest_growth(entry, (*units, *(o.unit for o in others), one.unit)) for one in between]
    return between[int(np.argmin(finer))] if min(finer) < worst[best] else tried[best]


def seen_from(entry: FarmEntry, bus: str, units: tuple[Unit, ...], pole: complex) -> tuple[complex, complex]:
    """What a mode sees of a bus, for a current of the positive component there and of its mirror (rad/s per S)."""
    system = system_of(units, entry.network, entry.f1_hz, [bus])
    shape = null_vectors(system, pole)
    at = 2 * system.ports.index(bus)
    (l_d, l_q), (r_d, r_q) = shape.left[at : at + 2], shape.right[at : at + 2]
    plus = (l_d - 1j * l_q) * (r_d + 1j * r_q) / (2.0 * shape.slope)
    minus = (l_d + 1j * l_q) * (r_d - 1j * r_q) / (2.0 * shape.slope)
    return complex(plus), complex(minus)


def rating_va(units: tuple[Unit, ...]) -> float:
    """Rated power of all devices (VA); infinite where a table does not say it."""
    total = sum(unit.rated_va for unit in units)
    return total if np.isfinite(total) else inf


def largest_growth(entry: FarmEntry, units: tuple[Unit, ...]) -> float:
    """Largest real part (1/s) of the oscillating modes up to 2 f1 in dq, or of any mode that is unstable."""
    system = system_of(units, entry.network, entry.f1_hz)
    poles = system.poles()
    poles = poles[np.abs(poles) <= BEYOND * 2.0 * np.pi * system.end_hz]
    near = (np.abs(poles.imag) < 4.0 * np.pi * entry.f1_hz) & (np.abs(poles.imag) > 2.0 * np.pi * 5.0)
    return float(poles.real[near | (poles.real > 0.0)].max(initial=-inf))


def held_amplitude(entry: FarmEntry, units: tuple[Unit, ...], damper: Damper, steps: int = 24) -> float:
    """Largest oscillation (V) of the bus's voltage from which the critical mode decays with this one damper.

    Infinite where the farm is stable without it, zero where it is unstable with all of it. The devices are linear here:
    where they leave their own limits or lose synchronism first, less is held.
    """

    def growth(part: float) -> float:
        scaled = _placed(damper.entry, damper.device.scaled(part))
        return largest_growth(entry, (*units, scaled.unit))

    if largest_growth(entry, units) < 0.0:
        return inf
    if growth(1.0) >= 0.0:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(steps):
        middle = (low + high) / 2.0
        low, high = (low, middle) if growth(middle) < 0.0 else (middle, high)
    return damper.device.limit_a / (damper.size_s * high)


# As a unit -----------------------------------------------------------------------------------------------------------


def _placed(damper: DamperEntry, device: GridSideDamper) -> Damper:
    unit = Unit(
        name=damper.name,
        bus=damper.bus,
        table="",
        key=f"damper {damper.name}",
        setpoint=(float("nan"),) * 3,
        model=model_of(device),
        factor=1.0,
        count=1,
        n_unstable=0,
        angle_rad=0.0,
        voltage_v=float("nan"),
        power_va=0j,
        off=float("nan"),
        rated_va=0.0,
    )
    return Damper(damper, device, unit)


def model_of(device: GridSideDamper) -> RationalModel:
    """The damper's Ydq in partial fractions, exactly.

    A pole p of G with residue g is one of Y with g/2 [[1, j], [-j, 1]], by the positive component, and its conjugate
    has the conjugate matrix, by the other one; where p and the conjugate of another pole meet their matrices add.
    """
    nu, w_b, w_w, lag = device.nu_rad_s, device.bandwidth_rad_s, device.washout_rad_s, device.lag_s
    of_g = np.array([-w_w, -1.0 / lag, 1j * nu - w_b, -1j * nu - w_b], dtype=complex)
    of_g = of_g if w_w else of_g[1:]
    g = np.array([_residue(device, k, of_g) for k in range(len(of_g))])
    turn = np.array([[1.0, 1j], [-1j, 1.0]])
    upper = (g[-2] * turn + np.conj(g[-1] * turn)) / 2.0
    real = [np.real(residue * turn).astype(complex) for residue in g[:-2]]
    poles = np.array([*of_g[:-2], of_g[-2], of_g[-2].conjugate()])
    residues = np.stack([*real, upper, upper.conj()])
    ranks = np.array([*[2] * len(real), *[_rank(upper)] * 2])
    nothing = np.zeros((2, 2))
    return RationalModel(
        f1_hz=50.0,
        poles=poles,
        residues=residues,
        d=nothing,
        e=nothing,
        tail=0,
        ranks=ranks,
        bic=0.0,
        residual=0.0,
        noise_floor=0.0,
        weighting="relative",
        nu_hz=np.array([nu / (2.0 * np.pi), 1e9]),
        weight=np.ones((2, 4)),
        covariance_root=np.zeros((5 * len(poles), 1)),
        rival=None,
        omitted=None,
        pole_std=np.zeros(len(poles), dtype=complex),
    )


def _residue(device: GridSideDamper, k: int, poles: np.ndarray) -> complex:
    """Residue of G at its k-th pole, from its factors."""
    p, others = poles[k], np.delete(poles, k)
    nu, w_b = 1j * device.nu_rad_s, device.bandwidth_rad_s
    above = device.y_mode * (p + nu + w_b) + device.y_mirror * (p - nu + w_b)
    washed = p if device.washout_rad_s else 1.0
    return complex(washed * w_b * above / device.lag_s / np.prod(p - others))


def _rank(matrix: np.ndarray) -> int:
    singular = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(singular > 1e-12 * max(float(singular[0]), 1e-300)))
