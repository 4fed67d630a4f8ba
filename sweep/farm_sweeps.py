"""The devices of a farm swept again where they stand, with damping gains: what its advice on gains rests on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..identify.response import FrequencyResponse
from ..tuning.farm.farm import Farm
from ..tuning.farm.levers import GainLever, PowerLever, check_power_lever
from ..tuning.farm.restore import Advice, Demand, advise
from ..tuning.farm.units import Library, Unit
from ..tuning.gain import series_of
from ..tuning.network.assembly import port_impedance
from ..tuning.siso import SeriesRL
from .confirm import ConfirmError, swept_damped


@dataclass(frozen=True)
class FarmSweeps:
    """Sweeps of a farm's devices with damping gains, as `tuning.farm.levers.Resweep`.

    Attributes
    ----------
    library : Library
        Where the tables are, whose metadata hold the campaigns.
    behind : SeriesRL
        The impedance that a gain multiplies.
    resonance_hz : float
        What the damping control is set to (Hz, signed).
    jobs : int
        Threads.
    """

    library: Library
    behind: SeriesRL
    resonance_hz: float
    jobs: int

    def __call__(self, unit: Unit, k: float) -> FrequencyResponse:
        """The unit's device at its own power and terminal voltage on an ideal source."""
        data = self._campaign(unit)
        response = swept_damped(data, self.behind, k, self.resonance_hz, self.jobs)
        if np.count_nonzero(response.ok) < len(response) // 2:
            reason = next((str(text) for text in np.asarray(response.reason) if text), "")
            raise ConfirmError(f"{unit.name}: with k = {k:.3g} half of the rows cannot be measured ({reason})")
        return response

    def _campaign(self, unit: Unit) -> dict[str, Any]:
        data = dict(self.library.table(unit.table).meta.get("configuration", {}))
        if "plant" not in data:
            raise ConfirmError(
                f"{unit.name}: {unit.table} holds no campaign, its device cannot be swept again with damping control; "
                "gains need tables that were made by seqsweep run"
            )
        sweep = {key: value for key, value in data["sweep"].items() if key != "operating_points"}
        return {**data, "sweep": sweep, "source": {"kind": "ideal"}, "operating_point": [_point(unit)]}


def _point(unit: Unit) -> dict[str, Any]:
    p, q, v = unit.setpoint
    point = {"id": "p", "active_power_mw": p, "terminal_voltage_pu": v}
    return {**point, "reactive_power_mvar": q} if q else point


def virtual_impedance(farm: Farm) -> SeriesRL:
    """What a gain multiplies: as the farm file says, or the impedance at f1 that a swept device sees, all in step.

    When every device changes its current as one does, the voltage at terminal i moves by sum_j Z_ij times the current
    of device j; the mean of that over the devices, by their ratings.
    """
    entry = farm.entry
    if entry.damping.x_ohm is not None:
        return SeriesRL(entry.damping.r_ohm or 0.0, entry.damping.x_ohm, entry.f1_hz)
    ports = [unit.bus for unit in farm.units]
    z = port_impedance(entry.network, ports, np.array([2j * np.pi * entry.f1_hz]))[0]
    factors = np.array([unit.factor for unit in farm.units])
    seen = complex(factors @ (z @ factors) / factors.sum())
    return series_of(seen, entry.f1_hz)


def resonance_hz(farm: Farm) -> float:
    """What the damping control is set to: as the farm file says, or the critical mode's component above f1."""
    if farm.entry.damping.resonance_hz is not None:
        return farm.entry.damping.resonance_hz
    mode = farm.judgement.critical
    if mode is None or mode.pole.imag == 0.0:
        raise ConfirmError("the farm has no oscillating mode in the band: there is nothing to damp; give resonance_hz")
    return farm.entry.f1_hz + mode.pole.imag / (2.0 * np.pi)


def gain_advice(
    library: Library, farm: Farm, demand: Demand | None, jobs: int, say: Callable[[str], None] = lambda text: None
) -> Advice:
    """What damping gains do to the farm's modes, and with a demand the smallest that meet it, each swept.

    Raises
    ------
    ConfirmError
        If a device cannot be swept again with damping control, or the farm has nothing to damp.
    """
    sweeps = FarmSweeps(library, virtual_impedance(farm), resonance_hz(farm), jobs)
    return advise(GainLever(farm, sweeps, farm.entry.damping.k_max), demand, say)


def power_advice(
    library: Library, farm: Farm, demand: Demand | None, say: Callable[[str], None] = lambda text: None
) -> Advice:
    """What less power does to the farm's modes, and with a demand the smallest curtailment that meets it.

    Raises
    ------
    FarmError
        If no device has a table over several powers.
    """
    lever = PowerLever(farm.entry, library)
    check_power_lever(lever)
    return advise(lever, demand, say)
