"""A farm on any grid, its load flow solved anew on each: there it is one device, with Y at its source's bus.

On a grid of impedance Z(f1) behind a voltage the terminals find new voltages and angles, so that every device has the
admittance of *its* P, Q and |v| there, from its surrogate. The radial network makes one 2x2 matrix of them. How many
unstable modes the farm has behind an ideal source, those between devices included, is counted once, where it stands on
its own source, by the turns of all factors but the root's. On another grid it is the same number where every factor,
divided by what it was, keeps its eigenvalues' angles small at all rows: neither then passes zero on the way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...identify.fit.model import fit_response
from ...identify.fit.rational import evaluate
from ...identify.frames import dq_to_pn
from ...identify.response import FrequencyResponse
from ...identify.surrogate.between import between
from ...identify.surrogate.region import SurrogateError
from ...identify.surrogate.surrogate import Surrogate, covariance_of
from ..anchor import Anchor
from .entries import FarmEntry, FarmError, NoLoadFlow
from .farm import judged
from .loadflow import LoadFlow, on_source, seen_at_f1, solved
from .locus import unstable_behind
from .pairs import Pair, determinant, eigenvalues, from_dq, inverse, plus, product, to_dq, turned
from .system import system_of
from .tree import Tree, factors, reduced, tree_behind_source
from .units import Group, Library, Source, Unit, by_surrogate, check_known, drawing, sources_of, units_at

ALIKE_DEG = 60.0
"""A factor that has turned by less than this at every row, against where it was counted, has the same count."""

_SAME = 1e-6  # relative difference of frequencies that are one
_SCALES = 2.0 ** -np.arange(8.0)  # multiples of the source's impedance on which a count is tried, the weakest first


@dataclass(frozen=True)
class Counted:
    """Where the unstable modes of the farm behind an ideal source were counted.

    Attributes
    ----------
    n_unstable : int or None
        How many there are; None where that is not known.
    factors : tuple of Pair of (f,) complex
        The factors of the tree at the rows, but for the root's.
    """

    n_unstable: int | None
    factors: tuple[Pair, ...]


@dataclass(frozen=True)
class Standing:
    """The farm where a load flow has it.

    Attributes
    ----------
    flow : LoadFlow
        Voltages and powers of the terminals.
    radius : (n, f) float
        Radius (S) of the 95 % region of every device's Y at the rows.
    by_bus : mapping of str to Pair of (f,) complex
        Admittance of the devices of every bus in the common frame (S).
    """

    flow: LoadFlow
    radius: np.ndarray
    by_bus: Mapping[str, Pair]


class OnGrid(NamedTuple):
    """The farm on one grid: its admittance there, and what is proved of it; ``problem`` says why it is not known."""

    response: FrequencyResponse
    proved: Anchor | None
    problem: str = ""


@dataclass(frozen=True)
class FarmOnGrids:
    """A radial farm whose devices follow their operating point; made by `farm_on_grids`.

    Attributes
    ----------
    entry : FarmEntry
        As its file has it.
    sources : tuple of Source
        What every device's admittance comes from.
    dampers : tuple of Unit
        Grid-side dampers, set on the file's own source.
    tree : Tree
        The network without its source.
    nu_hz : (f,) float
        Rows, |f - f1| (Hz).
    seen : (n + 1, n + 1) complex
        Impedance of the terminals and of the source's bus at f1 (ohm), on the file's own source.
    counted : Counted
        The count on the file's own source.
    """

    entry: FarmEntry
    sources: tuple[Source, ...]
    dampers: tuple[Unit, ...]
    tree: Tree
    nu_hz: np.ndarray
    seen: np.ndarray
    counted: Counted

    @property
    def bases(self) -> dict[str, float]:
        """Its rating as that of one device."""
        of_each = [source.bases.get("rated_power_va", np.nan) for source in self.sources]
        rated = sum(d.factor * va for d, va in zip(self.entry.devices, of_each, strict=True))
        return {"rated_voltage_v": self.entry.voltages_v[self.entry.source_bus], "rated_power_va": float(rated)}

    def on(self, z_ohm: complex, source_voltage_v: float) -> OnGrid:
        """The farm as a device, on a grid of ``z_ohm`` at f1 behind a voltage (V, line to line).

        Raises
        ------
        SeqsweepError
            If there is no load flow, or a device leaves what was swept of it.
        """
        standing = self._standing(self.flow(z_ohm, source_voltage_v))
        response = self._response(standing)
        n_unstable = self.counted.n_unstable
        if n_unstable is None:
            return OnGrid(response, None, "nothing proves how many unstable modes the farm has on an ideal source")
        if not _alike(self._factors(standing), self.counted.factors):
            return OnGrid(response, None, _FAR.format(self.entry.name))
        if not _all_seen(response, n_unstable):
            return OnGrid(response, None, _HIDDEN.format(n_unstable))
        return OnGrid(response, Anchor(n_unstable, None, "an ideal source", growth_bound_per_s=self._growth_bound))

    def flow(self, z_ohm: complex, source_voltage_v: float) -> LoadFlow:
        """Where the terminals stand on a grid.

        Raises
        ------
        NoLoadFlow
            If there is no solution.
        """
        open_circuit, z = on_source(self.seen, self.entry.source_z_ohm, z_ohm, source_voltage_v)
        return solved(self.entry.name, open_circuit, z, drawing(self.entry.devices, self.sources))

    @property
    def _growth_bound(self) -> float:
        """What grows more slowly (1/s) than the runs of any device tell."""
        facts = [group.surrogate.meta.get("stable_on") or {} for group in self._groups]
        return max((float(fact.get("growth_bound_per_s") or 0.0) for fact in facts), default=0.0)

    @property
    def _groups(self) -> list[Group]:
        return by_surrogate(self.entry.devices, self.sources)

    @property
    def _s(self) -> np.ndarray:
        return 2j * np.pi * self.nu_hz

    def _standing(self, flow: LoadFlow) -> Standing:
        """Every device's admittance where the load flow has it, from its surrogate."""
        radius = np.zeros((len(self.sources), len(self.nu_hz)))
        by_bus: dict[str, Pair] = {}
        for group in self._groups:
            names = [self.entry.devices[k].name for k in group.at]
            y, error = _predicted(group, np.abs(flow.voltage_v[group.at]), names, self.nu_hz)
            for k, own, own_error in zip(group.at, y, error, strict=True):
                device = self.entry.devices[k]
                radius[k] = device.factor * own_error
                _add(by_bus, device.bus, turned(from_dq(own), float(np.angle(flow.voltage_v[k])), device.factor))
        for unit in self.dampers:
            _add(by_bus, unit.bus, turned(from_dq(evaluate(unit.model, self._s)), unit.angle_rad, unit.factor))
        return Standing(flow, radius, by_bus)

    def _factors(self, standing: Standing) -> tuple[Pair, ...]:
        return tuple(factors(self.tree, self._s, standing.by_bus)[:-1])

    def _response(self, standing: Standing) -> FrequencyResponse:
        """Y at the source's bus, current into the farm, with its error.

        Notes
        -----
        A change dY of a device is L dY R at the source's bus, at most |L| |dY| |R|. The error of a surrogate is alike
        at neighbouring operating points: it is added over devices of one surrogate, its squares over surrogates.
        """
        seen = reduced(self.tree, self._s, standing.by_bus, with_ways=True)
        reach = [_norm(seen.left[d.bus]) * _norm(seen.right[d.bus]) for d in self.entry.devices]
        radius = np.sqrt(sum((np.array(reach) * standing.radius)[group.at].sum(axis=0) ** 2 for group in self._groups))
        power_w = -float(standing.flow.power_va.real.sum())
        meta = {"op_id": self.entry.name, "surrogate": True, "active_power_mw": power_w / 1e6}
        y, f1_hz = dq_to_pn(to_dq(seen.y)), self.entry.f1_hz
        return FrequencyResponse(f1_hz + self.nu_hz, y, f1_hz, covariance=covariance_of(radius), meta=meta)


_FAR = (
    "the operating point of {} is far from that on its file's own source, where modes between its devices were "
    "counted: write this grid as the source of the farm file and judge that"
)
_HIDDEN = "{} unstable modes between the devices, which the source's bus does not show: judge the farm by its file"


def farm_on_grids(entry: FarmEntry, library: Library) -> FarmOnGrids:
    """Prepare a farm for any grid.

    Parameters
    ----------
    entry : FarmEntry
        Radial; every device with ``active_power_mw``, its table over several voltages.
    library : Library
        Tables, surrogates and fits.

    Raises
    ------
    FarmError
        If a device has one operating point only, the network has a loop, or the farm stands nowhere.
    """
    for device in entry.devices:
        if device.active_power_mw is None:
            raise FarmError(
                f"{device.name} has one operating point of {device.table}; on other grids its terminal voltage is "
                "another: give active_power_mw, and a table over several voltages (seqsweep run with a region)"
            )
    tree = tree_behind_source(entry)
    sources = tuple(sources_of(entry, library))
    dampers = tuple(damper.unit for damper in judged(entry, library).dampers) if entry.dampers else ()
    nu_hz = _rows([group.surrogate for group in by_surrogate(entry.devices, sources)])
    uncounted = FarmOnGrids(entry, sources, dampers, tree, nu_hz, seen_at_f1(entry), Counted(None, ()))
    return replace(uncounted, counted=_counted(uncounted, library))


def _counted(farm: FarmOnGrids, library: Library) -> Counted:
    """The count on the file's own source, or, where nothing stands there, on the nearest stronger one."""
    entry, refusal = farm.entry, None
    for scale in _SCALES:
        try:
            standing = farm._standing(farm.flow(scale * entry.source_z_ohm, entry.source_voltage_v))
        except (NoLoadFlow, SurrogateError) as error:
            refusal = refusal or error
            continue
        units = units_at(entry, library, farm.sources, standing.flow)
        n_unstable = unstable_behind(system_of((*units, *farm.dampers), entry.network, entry.f1_hz))
        return Counted(n_unstable, farm._factors(standing))
    assert refusal is not None
    raise refusal


def _rows(surrogates: Sequence[Surrogate]) -> np.ndarray:
    """|f - f1| (Hz) of the first surrogate's rows, as far as all others reach."""
    low = max(float(each.nu_hz[0]) for each in surrogates)
    high = min(float(each.nu_hz[-1]) for each in surrogates)
    nu_hz = surrogates[0].nu_hz
    return np.asarray(nu_hz[(nu_hz >= low * (1.0 - _SAME)) & (nu_hz <= high * (1.0 + _SAME))])


def _predicted(
    group: Group, voltage_v: np.ndarray, names: Sequence[str], nu_hz: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Ydq (k, f, 2, 2) in S and the radius (k, f) of its 95 % region, of the devices of one surrogate.

    Raises
    ------
    SeqsweepError
        If a device leaves the region, or the surrogate does not know it there.
    """
    points = group.standing(voltage_v)
    for k in np.flatnonzero(~group.surrogate.holds(points)).tolist():
        group.surrogate.check_inside(points[k], names[k])
    found = group.surrogate.evaluate(points)
    for name, point, relative in zip(names, points, np.median(found.relative, axis=1), strict=True):
        check_known(name, point, relative)
    own_hz = group.surrogate.nu_hz
    at = np.abs(own_hz[None] - nu_hz[:, None]).argmin(axis=1)
    if np.all(np.abs(own_hz[at] - nu_hz) <= _SAME * nu_hz):
        return found.y[:, at], found.radius[:, at]
    parts = [between(own_hz, y, radius, nu_hz) for y, radius in zip(found.y, found.radius, strict=True)]
    return np.array([y for y, _ in parts]), np.array([radius for _, radius in parts])


def _add(by_bus: dict[str, Pair], bus: str, y: Pair) -> None:
    by_bus[bus] = plus(by_bus[bus], y) if bus in by_bus else y


def _norm(a: Pair) -> np.ndarray:
    """The largest singular value (f,): of a 2x2 matrix, from its length and its determinant."""
    length = sum(np.abs(x) ** 2 for x in a)
    return np.asarray(np.sqrt((length + np.sqrt(np.maximum(length**2 - 4.0 * np.abs(determinant(a)) ** 2, 0.0))) / 2.0))


def _alike(now: Sequence[Pair], before: Sequence[Pair]) -> bool:
    """Whether no factor can have turned about zero another number of times."""
    turns = (np.abs(np.angle(eigenvalues(product(inverse(b), a)))).max() for a, b in zip(now, before, strict=True))
    return bool(max(turns, default=0.0) < np.radians(ALIKE_DEG))


def _all_seen(response: FrequencyResponse, n_unstable: int) -> bool:
    """Whether a fit that nothing holds finds as many unstable modes at the source's bus as were counted."""
    return n_unstable == 0 or fit_response(response).n_unstable == n_unstable
