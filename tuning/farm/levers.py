"""What can be changed on a device, and what it does to a mode: its damping gain, or the power that it gives up.

A lever makes the changed farm from real data, a device swept again or a surrogate at another operating point, and says
d(pole)/dx for every device. The gain's slope is at constant operating point: the notch of the damping control leaves
the fundamental alone. Less power moves the voltages and angles of all devices, and the slope counts that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from ...identify.fit.dq_data import to_dq
from ...identify.fit.model import fit_poles
from ...identify.fit.rational import RationalModel, evaluate
from ...identify.response import FrequencyResponse
from ..network.descriptor import J
from .entries import DeviceEntry, FarmEntry, FarmError
from .farm import Farm, judged, judged_with
from .loadflow import LoadFlow
from .participation import moved_by, null_vectors
from .units import Fit, Library, Unit, fitted, flow_of

STEP_K = 0.02
"""Gain by which a device is swept again for the slope."""

Resweep = Callable[[Unit, float], FrequencyResponse]
"""A device where it stands, swept with a damping gain k."""


class Lever(Protocol):
    """Something of n devices that can be changed by x between 0 and `most`.

    Attributes
    ----------
    what, unit : str
        What it is and its unit, for texts.
    names : tuple of str
        The devices.
    most : (n,) float
        Largest change of each.
    """

    @property
    def what(self) -> str: ...

    @property
    def unit(self) -> str: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def most(self) -> np.ndarray: ...

    def changed(self, x: np.ndarray) -> Farm:
        """The farm with the changes x (n,)."""
        ...

    def slopes(self, farm: Farm, x: np.ndarray, poles: Sequence[complex]) -> np.ndarray:
        """(m, n) d(pole)/dx_i in the farm that `changed` gave."""
        ...


# The damping gain ----------------------------------------------------------------------------------------------------


@dataclass
class GainLever:
    """The damping gain k of every device, each value a sweep.

    Attributes
    ----------
    farm : Farm
        Without damping.
    resweep : callable
        Sweeps a device where it stands, with a gain.
    k_max : float
        Largest gain of a device.
    """

    farm: Farm
    resweep: Resweep
    k_max: float = 2.0
    what: str = "damping gain k"
    unit: str = ""
    _fits: dict[tuple[str, float], Fit] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(unit.name for unit in self.farm.units)

    @property
    def most(self) -> np.ndarray:
        return np.full(len(self.farm.units), self.k_max)

    def changed(self, x: np.ndarray) -> Farm:
        units = [self._unit(unit, float(k)) for unit, k in zip(self.farm.units, x, strict=True)]
        return judged_with(self.farm.entry, units, self.farm.dampers)

    def slopes(self, farm: Farm, x: np.ndarray, poles: Sequence[complex]) -> np.ndarray:
        return np.array([self._row(farm, x, pole) for pole in poles])

    def _row(self, farm: Farm, x: np.ndarray, pole: complex) -> np.ndarray:
        steps = [self._difference(unit, float(k), pole) for unit, k in zip(farm.units, x, strict=True)]
        return moved_by(farm.system, null_vectors(farm.system, pole), steps)

    def _difference(self, unit: Unit, k: float, s: complex) -> np.ndarray:
        """dY/dk in the common frame: forwards from zero, as a gain is never negative, centred elsewhere."""
        low, high = (0.0, STEP_K) if k < STEP_K else (k - STEP_K, k)
        if k >= STEP_K and k < self.k_max - STEP_K:
            high = k + STEP_K
        ends = [evaluate(self._fit(unit, value).model, np.array([s]))[0] for value in (low, high)]
        return unit.factor * unit.turn @ ((ends[1] - ends[0]) / (high - low)) @ unit.turn.T

    def _unit(self, unit: Unit, k: float) -> Unit:
        model, basis = self._fit(unit, k)
        n_unstable = basis.anchor.n_unstable
        return replace(unit, model=model, n_unstable=n_unstable, basis=basis, key=f"{unit.key}, k = {k:.4g}")

    def _fit(self, unit: Unit, k: float) -> Fit:
        key = (unit.key.split(", k = ")[0], round(k, 6))
        if key not in self._fits:
            self._fits[key] = fitted(self.resweep(unit, key[1]))
        return self._fits[key]


# Less power ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PowerLever:
    """Active power (MW) that the devices with a surrogate give up.

    Attributes
    ----------
    entry : FarmEntry
        The farm as it is.
    library : Library
        Its tables and surrogates.
    """

    entry: FarmEntry
    library: Library
    what: str = "power given up"
    unit: str = "MW"

    @property
    def at(self) -> tuple[int, ...]:
        """Indices of the devices whose power can be changed."""
        return tuple(k for k, device in enumerate(self.entry.devices) if device.active_power_mw is not None)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.entry.devices[k].name for k in self.at)

    @property
    def most(self) -> np.ndarray:
        return np.array([self._room(self.entry.devices[k]) for k in self.at])

    def changed(self, x: np.ndarray) -> Farm:
        return judged(self._with(self.entry, x), self.library)

    def slopes(self, farm: Farm, x: np.ndarray, poles: Sequence[complex]) -> np.ndarray:
        points = [self._by_point(farm.entry.devices[k], farm.units[k]) for k in range(len(farm.units))]
        flows = [self._flow_slope(farm.entry, j) for j in range(len(self.at))]
        return np.array([self._row(farm, points, flows, pole) for pole in poles])

    def _room(self, device: DeviceEntry) -> float:
        low = self.library.surrogate(device.table).region.low[0]
        return max(0.0, ((device.active_power_mw or 0.0) - low) * device.factor)

    def _with(self, entry: FarmEntry, x: np.ndarray) -> FarmEntry:
        devices = list(entry.devices)
        for k, less in zip(self.at, x, strict=True):
            device = devices[k]
            power = (device.active_power_mw or 0.0) - float(less) / device.factor
            devices[k] = replace(device, active_power_mw=power)
        return replace(entry, devices=tuple(devices))

    def _flow_slope(self, entry: FarmEntry, j: int) -> LoadFlow:
        """d(voltages)/dx_j of all devices, their magnitudes in V and angles in rad as real and imaginary part."""
        h = 1e-4 * max(1e-3, float(self.most[j]))
        change = h * np.eye(len(self.at))[j]
        ends = [flow_of(self._with(entry, sign * change), self.library).voltage_v for sign in (1.0, -1.0)]
        by_size = (np.abs(ends[0]) - np.abs(ends[1])) / (2.0 * h)
        by_angle = np.angle(ends[0] / ends[1]) / (2.0 * h)
        return LoadFlow(by_size + 1j * by_angle, np.zeros(len(by_size)))

    def _by_point(self, device: DeviceEntry, unit: Unit) -> tuple[_Pair, _Pair] | None:
        """Models about a device's point: by its power (MW) and by its voltage (V); None without a surrogate."""
        if device.active_power_mw is None:
            return None
        surrogate = self.library.surrogate(device.table)
        rated = self.library.table(device.table).meta["bases"]["rated_voltage_v"]
        low, high = surrogate.region.low, surrogate.region.high

        def ends(axis: int, scale: float) -> _Pair:
            h = _STEP * max(high[axis] - low[axis], 1e-9)
            values = [np.clip(unit.setpoint[axis] + s * h, low[axis], high[axis]) for s in (1.0, -1.0)]
            models = []
            for value in values:
                point = list(unit.setpoint)
                point[axis] = float(value)
                response = surrogate.response(point)
                data = to_dq(response)
                models.append(fit_poles(data, unit.model.poles, f1_hz=response.f1_hz, noise_floor=1e-9))
            return _Pair(models[0], models[1], (values[0] - values[1]) * scale)

        return ends(0, 1.0), ends(2, rated)

    def _row(
        self,
        farm: Farm,
        points: Sequence[tuple[_Pair, _Pair] | None],
        flows: Sequence[LoadFlow],
        pole: complex,
    ) -> np.ndarray:
        shape, units = null_vectors(farm.system, pole), farm.units
        by_power = [_zero() if p is None else _turned(u, p[0].slope(pole)) for u, p in zip(units, points, strict=True)]
        by_volt = [_zero() if p is None else _turned(u, p[1].slope(pole)) for u, p in zip(units, points, strict=True)]
        own = [_turned(u, evaluate(u.model, np.array([pole]))[0]) for u in units]
        by_angle = [J @ y - y @ J for y in own]
        row = []
        for j, flow in enumerate(flows):
            k, device = self.at[j], farm.entry.devices[self.at[j]]
            change = [
                v * flow.voltage_v[i].real + a * flow.voltage_v[i].imag
                for i, (v, a) in enumerate(zip(by_volt, by_angle, strict=True))
            ]
            change[k] = change[k] - by_power[k] / device.factor
            row.append(np.sum(moved_by(farm.system, shape, change)))
        return np.array(row)


_STEP = 0.01  # part of the region that a surrogate is asked beside its point


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two models of a device beside its operating point, and how far apart they are."""

    above: RationalModel
    below: RationalModel
    apart: float

    def slope(self, s: complex) -> np.ndarray:
        at = np.array([s])
        return np.asarray((evaluate(self.above, at)[0] - evaluate(self.below, at)[0]) / self.apart)


def _turned(unit: Unit, y: np.ndarray) -> np.ndarray:
    return np.asarray(unit.factor * unit.turn @ y @ unit.turn.T)


def _zero() -> np.ndarray:
    return np.zeros((2, 2))


def check_power_lever(lever: PowerLever) -> None:
    """Refuse where no device has a surrogate."""
    if not lever.at:
        raise FarmError(
            "no device of the farm has a table over several powers (active_power_mw): what less power would do is not "
            "known; sweep a region, [sweep.operating_points], and give active_power_mw in place of op"
        )
