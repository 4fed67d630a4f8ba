"""The devices of a farm as they are judged: tables read and fitted once, each at its own operating point.

A device whose entry gives a power takes Y from the surrogate of its table at the terminal voltage of the load flow; one
whose entry names an operating point takes that point's rows, and what its terminal voltage is off by is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ...identify.fit.dq_data import to_dq
from ...identify.fit.model import fit_response
from ...identify.fit.pooled import Pool, Wanted
from ...identify.fit.rational import RationalModel
from ...identify.response import FrequencyResponse
from ...identify.surrogate.store import surrogate_of
from ...identify.surrogate.surrogate import Surrogate
from ...identify.table.read import Table
from ...plant.errors import nearest
from ..anchor import Anchor, anchor_of, recounted
from ..basis import Basis, basis_of
from ..objections import said_of_count, said_of_swept_grid
from ..rows import Rows, rows_of
from .entries import DeviceEntry, FarmEntry, FarmError
from .loadflow import Draw, LoadFlow, load_flow

FAR = 0.005
"""A terminal voltage further from that of the sweep than this part is warned about."""

KNOWN_TO = 0.3
"""A surrogate that is less sure of Y than this part of it says nothing about a farm."""

ReadTable = Callable[[str], Table]


class Library:
    """Tables, surrogates and fits, each made once however many farms are judged with them.

    Parameters
    ----------
    read : callable
        File name of a device's table to the table.
    """

    def __init__(self, read: ReadTable):
        self.table: ReadTable = cache(read)
        self._surrogates: dict[str, Surrogate] = {}
        self._proofs: dict[str, tuple[Rows, Anchor]] = {}
        self._bases: dict[str, Basis] = {}
        self._pool = Pool()

    def surrogate(self, name: str) -> Surrogate:
        """The surrogate of a table."""
        if name not in self._surrogates:
            self._surrogates[name] = surrogate_of(self.table(name))
        return self._surrogates[name]

    def fitted(self, responses: Mapping[str, FrequencyResponse]) -> dict[str, Fit]:
        """Models of the responses of one farm, and what they rest on.

        Rows that were measured are fitted together, as noise that hides a mode in one table does not in many; what a
        surrogate predicts has no noise that could be averaged.
        """
        for key, response in responses.items():
            if key not in self._proofs:
                self._proofs[key] = _proof(response)
        wanted = {key: Wanted(response, self._proofs[key][1].n_unstable) for key, response in responses.items()}
        measured = {key: each for key, each in wanted.items() if not each.response.meta.get("surrogate")}
        models = self._pool.models(measured)
        for key, each in wanted.items():
            if key not in measured:
                models |= self._pool.models({key: each})
        return {key: Fit(models[key], self._basis(key, response, models[key])) for key, response in responses.items()}

    def _basis(self, key: str, response: FrequencyResponse, model: RationalModel) -> Basis:
        if key not in self._bases:
            self._bases[key] = _basis(response, *self._proofs[key], model)
        return self._bases[key]


def library_of(read: ReadTable | Library) -> Library:
    """A library as it is, or one that reads with ``read``."""
    return read if isinstance(read, Library) else Library(read)


class Fit(NamedTuple):
    """Model of a device and what it rests on."""

    model: RationalModel
    basis: Basis


class Source(NamedTuple):
    """What a device's entry is served from: rows of one operating point, or a surrogate over many."""

    key: str
    response: FrequencyResponse | None
    surrogate: Surrogate | None
    bases: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Unit:
    """One device of the farm, fitted.

    Attributes
    ----------
    name, bus : str
        As in the farm file.
    table : str
        File of its table.
    key : str
        Table and operating point; units with the same key share one fit and its errors.
    setpoint : (3,) tuple of float
        P (MW), Q (Mvar) and |v| (pu) of one swept device, as the table gives them; NaN where it does not.
    model : RationalModel
        Y of the swept device in its own frame, d on its terminal voltage.
    factor : float
        What Y is multiplied with: rating times the number of equal devices in parallel.
    count : int
        Equal devices in parallel.
    n_unstable : int or None
        Unstable modes of one device's own; None if nothing was proved.
    angle_rad : float
        By how much its terminal voltage leads the source.
    voltage_v : float
        Its terminal voltage (V, line-to-line RMS).
    power_va : complex
        What it draws (VA).
    off : float
        By what part its terminal voltage differs from that of the sweep; NaN where the table does not say.
    rated_va : float
        Its rated power (VA), all parallel ones together; NaN where the table does not say.
    basis : Basis or None
        What its judgement rests on; None where Y is known by formula, as that of a grid-side damper.
    """

    name: str
    bus: str
    table: str
    key: str
    setpoint: tuple[float, float, float]
    model: RationalModel
    factor: float
    count: int
    n_unstable: int | None
    angle_rad: float
    voltage_v: float
    power_va: complex
    off: float
    rated_va: float
    basis: Basis | None = None

    @property
    def turn(self) -> np.ndarray:
        """(2, 2) rotation from the unit's frame to the common one."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.array([[c, -s], [s, c]])


def units_of(farm: FarmEntry, read: ReadTable | Library) -> tuple[tuple[Unit, ...], LoadFlow]:
    """Load flow of the farm, then every device fitted where it stands.

    Parameters
    ----------
    farm : FarmEntry
        The farm.
    read : callable or Library
        File name of a device's table to the table; or what was read and fitted before.

    Raises
    ------
    FarmError
        If a table does not fit its entry, or the load flow has no solution.
    """
    library = library_of(read)
    sources = sources_of(farm, library)
    flow = load_flow(farm, drawing(farm.devices, sources))
    return units_at(farm, library, sources, flow), flow


def units_at(farm: FarmEntry, library: Library, sources: Sequence[Source], flow: LoadFlow) -> tuple[Unit, ...]:
    """Every device fitted where a load flow has it."""
    there = [_response_at(*pair) for pair in zip(farm.devices, sources, np.abs(flow.voltage_v), strict=True)]
    fits = library.fitted({key: response for response, key in there})
    parts = zip(farm.devices, sources, there, flow.voltage_v, flow.power_va, strict=True)
    return tuple(_unit(fits, *part) for part in parts)


def flow_of(farm: FarmEntry, library: Library) -> LoadFlow:
    """The load flow alone."""
    return load_flow(farm, drawing(farm.devices, sources_of(farm, library)))


def sources_of(farm: FarmEntry, library: Library) -> list[Source]:
    """What every device is served from.

    Raises
    ------
    FarmError
        If a table does not fit its entry.
    """
    return [_source(entry, library, farm) for entry in farm.devices]


def _unit(
    fits: Mapping[str, Fit],
    entry: DeviceEntry,
    source: Source,
    there: tuple[FrequencyResponse, str],
    voltage_v: complex,
    power_va: complex,
) -> Unit:
    response, key = there
    fit = fits[key]
    return Unit(
        name=entry.name,
        bus=entry.bus,
        table=entry.table,
        key=key,
        setpoint=_setpoint(response),
        model=fit.model,
        factor=entry.factor,
        count=entry.count,
        n_unstable=fit.basis.anchor.n_unstable,
        angle_rad=float(np.angle(voltage_v)),
        voltage_v=float(abs(voltage_v)),
        power_va=complex(power_va),
        off=_off(response, source, float(abs(voltage_v))),
        rated_va=entry.factor * float(source.bases.get("rated_power_va", np.nan)),
        basis=fit.basis,
    )


def _setpoint(response: FrequencyResponse) -> tuple[float, float, float]:
    meta = response.meta
    given = (meta.get("active_power_mw"), meta.get("reactive_power_mvar", 0.0), meta.get("terminal_voltage_pu"))
    p, q, v = (float("nan") if value is None else float(value) for value in given)
    return p, q, v


def _source(entry: DeviceEntry, library: Library, farm: FarmEntry) -> Source:
    table = library.table(entry.table)
    f1_hz, bases = table.meta["f1_hz"], table.meta["bases"]
    if f1_hz != farm.f1_hz:
        raise FarmError(f"{entry.name}: the table's fundamental is {f1_hz:g} Hz, the farm's {farm.f1_hz:g} Hz")
    rated = bases.get("rated_voltage_v")
    ratio = farm.voltages_v[entry.bus] / rated if rated else 1.0
    if not 0.7 < ratio < 1.4:
        raise FarmError(
            f"{entry.name}: its table is of a device of {rated:g} V, bus {entry.bus!r} has "
            f"{farm.voltages_v[entry.bus]:g} V: the device stands behind a transformer, or kV and V are mixed up"
        )
    if entry.active_power_mw is not None:
        surrogate = library.surrogate(entry.table)
        middle = (surrogate.region.low[2] + surrogate.region.high[2]) / 2.0
        high = float(surrogate.region.high[0])
        if entry.active_power_mw > 100.0 * max(high, 1e-9):
            raise FarmError(
                f"{entry.name}: active_power_mw = {entry.active_power_mw:g}; its table ends at {high:g} MW: kW for MW?"
            )
        surrogate.check_inside([entry.active_power_mw, entry.reactive_power_mvar, middle], entry.name)
        return Source(entry.table, None, surrogate, bases)
    if entry.op is None and len(table.op_ids) > 1:
        raise FarmError(
            f"{entry.name}: {entry.table} holds {len(table.op_ids)} operating points; give op, or active_power_mw"
        )
    op = entry.op or table.op_ids[0]
    if op not in table.op_ids:
        raise FarmError(f"{entry.name}: no operating point {op!r} in {entry.table}{nearest(op, table.op_ids)}")
    return Source(f"{entry.table}:{op}", table.response(op), None, bases)


def drawing(devices: Sequence[DeviceEntry], sources: Sequence[Source]) -> Draw:
    """Complex power (n,) in VA that each device draws, as a function of all terminal voltages.

    Devices of one surrogate are asked for together: one by one they cost more than the load flow itself.
    """
    factor = np.array([entry.factor for entry in devices])
    fixed = np.array(
        [
            0.0 if source.response is None else _measured_power(entry, source, source.response)
            for entry, source in zip(devices, sources, strict=True)
        ],
        dtype=complex,
    )
    groups = by_surrogate(devices, sources)

    def drawn(voltage_v: np.ndarray) -> np.ndarray:
        power = fixed.copy()
        for group in groups:
            power[group.at] = _predicted_power(group, voltage_v[group.at])
        return factor * power

    return drawn


class Group(NamedTuple):
    """The devices ``at`` (k,) of one surrogate: their P and Q as points (k, 3), |v| left open, and their base."""

    at: np.ndarray
    surrogate: Surrogate
    points: np.ndarray
    rated_v: float

    def standing(self, voltage_v: np.ndarray) -> np.ndarray:
        """Operating points (k, 3) at terminal voltages (k,) in V."""
        points = self.points.copy()
        points[:, 2] = voltage_v / self.rated_v
        return points


def by_surrogate(devices: Sequence[DeviceEntry], sources: Sequence[Source]) -> list[Group]:
    """Devices that follow their voltage, by the surrogate that they share."""
    places: dict[int, list[int]] = {}
    for k, source in enumerate(sources):
        if source.surrogate is not None:
            places.setdefault(id(source.surrogate), []).append(k)
    found = []
    for at in places.values():
        surrogate = sources[at[0]].surrogate
        assert surrogate is not None
        points = np.array([[devices[k].active_power_mw, devices[k].reactive_power_mvar, np.nan] for k in at], float)
        found.append(Group(np.array(at), surrogate, points, float(sources[at[0]].bases["rated_voltage_v"])))
    return found


def _measured_power(entry: DeviceEntry, source: Source, response: FrequencyResponse) -> complex:
    """What one swept device draws at its operating point (VA)."""
    facts = response.meta.get("fundamental")
    if facts:
        return complex(facts["active_power_into_device_w"], facts["reactive_power_into_device_var"])
    power = response.meta.get("active_power_mw")
    if power is None:
        raise FarmError(f"{entry.name}: {source.key} does not say its power; sweep it again, or give active_power_mw")
    return complex(-1e6 * power, 0.0)


def _predicted_power(group: Group, voltage_v: np.ndarray) -> np.ndarray:
    """By the surrogate of the terminal current; beyond the region's voltages, on the way to a solution, by its end."""
    region = group.surrogate.region
    points = group.standing(voltage_v)
    points[:, 2] = np.clip(points[:, 2], region.low[2], region.high[2])
    current = group.surrogate.terminal_current(points)
    return np.asarray(-np.sqrt(3.0) * points[:, 2] * group.rated_v * current.conj())


def _response_at(entry: DeviceEntry, source: Source, voltage_v: float) -> tuple[FrequencyResponse, str]:
    if source.surrogate is None:
        assert source.response is not None
        return source.response, source.key
    v_pu = float(voltage_v) / source.bases["rated_voltage_v"]
    point = [entry.active_power_mw or 0.0, entry.reactive_power_mvar, v_pu]
    check_known(entry.name, point, float(np.median(source.surrogate.evaluate(np.array(point)).relative)))
    response = source.surrogate.response(point)
    return response, f"{source.key}:{response.meta['op_id']}"


def check_known(name: str, point: Sequence[float] | np.ndarray, known_to: float) -> None:
    """Refuse a device where its surrogate knows Y only to ``known_to`` of it, if that is too little."""
    if known_to > KNOWN_TO:
        raise FarmError(
            f"{name}: at {point[0]:g} MW and {point[2]:.4g} pu the surrogate of its table knows Y only to "
            f"{100.0 * known_to:.0f} %: sweep more operating points about there"
        )


def fitted(response: FrequencyResponse) -> Fit:
    """Model of one response, and what it rests on."""
    rows, anchor = _proof(response)
    model = fit_response(response, n_unstable=anchor.n_unstable)
    return Fit(model, _basis(response, rows, anchor, model))


def _proof(response: FrequencyResponse) -> tuple[Rows, Anchor]:
    """Rows of a response, and what is proved of its device."""
    rows = rows_of(to_dq(response))
    return rows, anchor_of(response.meta, rows, response.f1_hz)


def _basis(response: FrequencyResponse, rows: Rows, anchor: Anchor, model: RationalModel) -> Basis:
    """What a fit rests on; its problem may also be that it contradicts what was proved of the device."""
    again = anchor if anchor.n_unstable == model.n_unstable else recounted(anchor, rows, model)
    basis = basis_of(response, rows, again if again.n_unstable == model.n_unstable else anchor, model)
    contradicts = said_of_count(model, basis.anchor) or said_of_swept_grid(model, basis.anchor)
    return basis._replace(problem=basis.problem or contradicts)


def _off(response: FrequencyResponse, source: Source, voltage_v: float) -> float:
    swept = response.meta.get("terminal_voltage_pu")
    rated = source.bases.get("rated_voltage_v")
    return voltage_v / (swept * rated) - 1.0 if swept and rated else float("nan")
