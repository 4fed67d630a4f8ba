"""A grid made of elements: exact, by modified nodal analysis; a distributed cable by its closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...plant.circuits.branches import GROUND, Branch
from ...plant.circuits.circuit import Circuit
from ..network.assembly import Network, assemble, port_impedance
from ..network.descriptor import Descriptor, Triangular, transfer, transfer_slope, triangular
from .document import KINDS, PCC, SOURCE, elements_of, in_service, network_of
from .errors import GridError
from .promise import OnePort
from .rational import RationalGrid
from .scalar_fit import fit_closed_form
from .words import in_ohm

PER_RESONANCE = 10.0
"""Frequencies at which a distributed line is evaluated from one of its resonances to the next."""

CABLE_BAND_HZ = (0.05, 5000.0)
"""Band (Hz) in which a network with distributed lines is represented."""

LONGEST_DELAY_S = 10e-3
"""Delay of all distributed lines together: some 3000 km of overhead line or 1000 km of cable, over a hundred resonances
below the end of the band."""

CABLE_MISFIT = 1e-7
"""Largest relative error with which the states of such a network may give its closed form."""


class Lumped(OnePort):
    """A network of lumped branches: descriptor, triangular form and ``scale`` are what its subclasses bring."""

    __slots__ = ()

    scale: float
    _system: Descriptor
    _form: Triangular

    def _assemble(self, network: Network) -> None:
        """Prepare the network; refuse one with a node that nothing holds."""
        system = assemble(network, [PCC])
        for name, value in (("_system", system), ("_form", triangular(system))):
            object.__setattr__(self, name, value)
        probe = self.impedance(np.array([20.0 + 1j * self.w1_rad_s]))
        if not np.all(np.isfinite(probe)):
            raise GridError("the elements leave the PCC, or a node, without a path to the source or to ground")

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """z in ohm; infinite at a pole."""
        return -self.scale * transfer(self._form, np.asarray(s, dtype=complex))

    def slope(self, s: np.ndarray) -> np.ndarray:
        """dz/ds in ohm s."""
        return -self.scale * transfer_slope(self._form, np.asarray(s, dtype=complex))

    @property
    def phase_modes(self) -> np.ndarray:
        """Own modes with the PCC open, phase frame (rad/s)."""
        return self._form.poles

    def phase_descriptor(self) -> Descriptor:
        """The network's states."""
        e, a, b, c = self._system
        return Descriptor(e, a, b, self.scale * c)


@dataclass(frozen=True, slots=True)
class ElementsGrid(Lumped):
    """Lumped elements between PCC and source.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    document : mapping
        The elements as `document` has them.
    scale : float
        Multiplies the impedance.
    name : str
        For people.
    """

    f1_hz: float
    document: Mapping[str, Any]
    scale: float = 1.0
    name: str = ""
    network: Network = field(init=False, repr=False, compare=False)
    _system: Descriptor = field(init=False, repr=False, compare=False)
    _form: Triangular = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        network = network_of(self.document, self.f1_hz)
        if network.lines:
            raise GridError("distributed lines have no finite number of states: `elements_grid` takes them")
        object.__setattr__(self, "network", network)
        self._assemble(network)

    @property
    def label(self) -> str:
        """Name, elements and z at the fundamental."""
        return _label(self)

    def scaled(self, scale: float) -> ElementsGrid:
        """The same elements, the impedance multiplied."""
        return replace(self, scale=self.scale * scale)

    def described(self) -> dict[str, Any]:
        """The document, and z at the fundamental."""
        return _described(self)


@dataclass(frozen=True, slots=True)
class CircuitGrid(Lumped):
    """The circuit that is simulated, as a grid: what a device is on while elements are switched.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    circuit : Circuit
        Branches between "pcc" and "source".
    scale : float
        Multiplies the impedance.
    """

    f1_hz: float
    circuit: Circuit
    scale: float = 1.0
    _system: Descriptor = field(init=False, repr=False, compare=False)
    _form: Triangular = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._assemble(Network(tuple(_grounded(branch) for branch in self.circuit.branches)))

    @property
    def label(self) -> str:
        """The circuit's, and z at the fundamental."""
        z = self.at_f1
        return f"{self.circuit.label}, {in_ohm(z)} ohm at {self.f1_hz:g} Hz"

    def scaled(self, scale: float) -> CircuitGrid:
        """The same circuit, the impedance multiplied."""
        return replace(self, scale=self.scale * scale)

    def described(self) -> dict[str, Any]:
        """Its branches, and z at the fundamental."""
        z = self.at_f1
        facts = {"r_ohm": z.real, "x_ohm": z.imag, "f1_hz": self.f1_hz, "scale": self.scale}
        return {"kind": "circuit", **facts, "circuit": self.circuit.facts()}


def _grounded(branch: Branch) -> Branch:
    """A branch for which the ideal source does not answer."""
    return replace(branch, ends={GROUND if end == SOURCE else end: ratio for end, ratio in branch.ends.items()})


@dataclass(frozen=True, slots=True)
class CableGrid(OnePort):
    """Elements with distributed lines: z by the closed form, states by a rational function that equals it in a band.

    Attributes
    ----------
    f1_hz, document, scale, name
        As of `ElementsGrid`.
    """

    f1_hz: float
    document: Mapping[str, Any]
    scale: float = 1.0
    name: str = ""
    network: Network = field(init=False, repr=False, compare=False)
    _states: RationalGrid = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        network = network_of(self.document, self.f1_hz)
        object.__setattr__(self, "network", network)
        self._check_length(network)
        f_hz = _cable_frequencies(network)
        z = self.closed_form(2j * np.pi * f_hz) / self.scale
        states = fit_closed_form(f_hz, z, self.f1_hz)
        if not states.misfit < CABLE_MISFIT:
            raise GridError(
                f"{self.name or 'grid'}: its distributed lines have too many resonances below {f_hz[-1]:g} Hz for a "
                f"rational function (misfit {states.misfit:.1e}); give model = 'pi' and sections"
            )
        object.__setattr__(self, "_states", states)

    def _check_length(self, network: Network) -> None:
        if (delay_s := _delay_s(network)) > LONGEST_DELAY_S:
            longest = max(network.lines, key=lambda line: line.length_km)
            raise GridError(
                f"{self.name or 'grid'}: a wave takes {delay_s * 1e3:.3g} ms through its distributed lines, the "
                f"longest being {longest.name} of {longest.length_km:g} km; needed is {LONGEST_DELAY_S * 1e3:g} ms or "
                "less, some 3000 km of overhead line: length_km in m, or c_nf_per_km in another unit?"
            )

    def closed_form(self, s: np.ndarray) -> np.ndarray:
        """z (n,) in ohm by the line equations, at complex ``s`` (n,) in rad/s."""
        return self.scale * port_impedance(self.network, [PCC], s)[:, 0, 0]

    @property
    def misfit(self) -> float:
        """Largest relative difference between states and closed form in the band."""
        return self._states.misfit

    @property
    def label(self) -> str:
        """Name, elements and z at the fundamental."""
        return _label(self)

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """z in ohm."""
        return self.scale * self._states.impedance(s)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """dz/ds in ohm s."""
        return self.scale * self._states.slope(s)

    @property
    def phase_modes(self) -> np.ndarray:
        """Own modes inside the band, phase frame (rad/s)."""
        return self._states.phase_modes

    def phase_descriptor(self) -> Descriptor:
        """The states of the rational function."""
        e, a, b, c = self._states.phase_descriptor()
        return Descriptor(e, a, b, self.scale * c)

    def scaled(self, scale: float) -> CableGrid:
        """The same elements, the impedance multiplied."""
        copy = object.__new__(CableGrid)
        for name in ("f1_hz", "document", "name", "network", "_states"):
            object.__setattr__(copy, name, getattr(self, name))
        object.__setattr__(copy, "scale", self.scale * scale)
        return copy

    def described(self) -> dict[str, Any]:
        """The document, and z at the fundamental."""
        return _described(self)


def elements_grid(document: Mapping[str, Any], f1_hz: float, name: str = "") -> ElementsGrid | CableGrid:
    """The grid of a document, exact where all elements are lumped.

    Raises
    ------
    GridError
        If the document is not one of a grid.
    """
    name = name or str(document.get("name", ""))
    if network_of(document, f1_hz).lines:
        return CableGrid(f1_hz, document, name=name)
    return ElementsGrid(f1_hz, document, name=name)


def strengths(document: Mapping[str, Any], f1_hz: float) -> dict[str, tuple[int, str, float]]:
    """What of each element can be varied: name to (its place in the document, its key, its value)."""
    kept = in_service(document)
    places = [k for k, entry in enumerate(document["element"]) if any(entry is each for each in kept)]
    found = {}
    for k, element in zip(places, elements_of(document, f1_hz), strict=True):
        key = next((key for key in KINDS[element.kind].strength if element.values.get(key, 0.0) > 0.0), None)
        if key is not None:
            found[element.name] = (k, key, float(element.values[key]))
    return found


def varied(document: Mapping[str, Any], at: int, key: str, value: float) -> dict[str, Any]:
    """The document with one number of one element replaced."""
    entries = [dict(entry) for entry in document["element"]]
    entries[at][key] = value
    return {**document, "element": entries}


def _delay_s(network: Network) -> float:
    """Time (s) that a wave takes through all distributed lines, one after another."""
    return float(sum(line.length_km * np.sqrt(line.l_h_km * line.c_f_km) for line in network.lines))


def _cable_frequencies(network: Network) -> np.ndarray:
    """Rows close enough to resolve every resonance of the lines, which lie half a wave apart."""
    low, high = CABLE_BAND_HZ
    step = 1.0 / (PER_RESONANCE * 2.0 * _delay_s(network))
    linear = step * np.arange(1, 1 + int(np.ceil(high / step)))
    return np.unique(np.concatenate([np.geomspace(low, high, 160), linear[linear < high]]))


def _label(grid: ElementsGrid | CableGrid) -> str:
    kinds = ", ".join(str(entry["kind"]) for entry in in_service(grid.document))
    scale = "" if grid.scale == 1.0 else f" times {grid.scale:.4g}"
    z = grid.at_f1
    name = f"{grid.name}: " if grid.name else ""
    return f"{name}{kinds}{scale}, {in_ohm(z)} ohm at {grid.f1_hz:g} Hz"


def _described(grid: ElementsGrid | CableGrid) -> dict[str, Any]:
    z = grid.at_f1
    return {
        "kind": "elements",
        "name": grid.name,
        "r_ohm": z.real,
        "x_ohm": z.imag,
        "f1_hz": grid.f1_hz,
        "scale": grid.scale,
        "document": dict(grid.document),
    }
