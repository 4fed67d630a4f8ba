"""The circuit between a device's terminals and an ideal source: a grid that has a time domain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any, NamedTuple

import numpy as np

from .branches import Branch, Places, nodes_of, places_of, stamped

PCC, SOURCE = "pcc", "source"


class Descriptor(NamedTuple):
    """E x' = A x + B u + S v_s + S' v_s' in the phase frame: what one phase of a symmetric network does.

    Attributes
    ----------
    e, a : (n, n) float
        May be singular pencils of index two: cut sets of inductors.
    b : (n, p) float
        Currents ``u`` fed into the network at the ports.
    by_source, by_slope : (n,) float
        Of the source voltage and of its derivative.
    at : Places
        Where the unknowns stand, the source's node left out.
    """

    e: np.ndarray
    a: np.ndarray
    b: np.ndarray
    by_source: np.ndarray
    by_slope: np.ndarray
    at: Places


@dataclass(frozen=True, slots=True)
class Circuit:
    """Branches between the nodes "pcc", "source", "ground" and any others.

    Attributes
    ----------
    branches : tuple of Branch
        Every impedance in ohm at its own voltage level; transformers are branches with a ratio.
    source_ratio : float
        Rated voltage at the source over that at the PCC: a source voltage is told as the PCC has it.
    label : str
        For messages.
    """

    branches: tuple[Branch, ...]
    source_ratio: float = 1.0
    label: str = ""

    def scaled(self, factor: float) -> Circuit:
        """The same with every impedance multiplied: R, L and 1/C."""
        return replace(self, branches=tuple(scaled_branch(branch, factor) for branch in self.branches))

    def seen_at(self, s: complex) -> tuple[complex, complex]:
        """Impedance of the PCC (ohm) and its voltage over that of the source, at ``s`` (rad/s) of the phase frame."""
        system = descriptor_of(self.branches, [PCC])
        right = np.stack([system.b[:, 0], system.by_source + s * system.by_slope], axis=1)
        z, gain = np.linalg.solve(s * system.e - system.a, right)[system.at.node[PCC]]
        return complex(z), complex(self.source_ratio * gain)

    def facts(self) -> dict[str, Any]:
        """Everything a result depends on, as plain JSON values."""
        return {
            "source_ratio": self.source_ratio,
            "branches": [
                [b.name, dict(b.ends), b.r_ohm, b.l_h, None if b.c_f == inf else b.c_f] for b in self.branches
            ],
        }


def scaled_branch(branch: Branch, factor: float) -> Branch:
    """A branch with its impedance multiplied."""
    return replace(branch, r_ohm=factor * branch.r_ohm, l_h=factor * branch.l_h, c_f=branch.c_f / factor)


def descriptor_of(branches: Sequence[Branch], ports: Sequence[str]) -> Descriptor:
    """The equations of branches with currents fed in at ``ports``; the voltage of the node "source" is given."""
    nodes = nodes_of(branches)
    at = places_of(branches, nodes)
    e, a = stamped(branches, at)
    b = np.zeros((at.n, len(ports)))
    for column, port in enumerate(ports):
        b[at.node[port], column] = 1.0
    if SOURCE not in at.node:
        return Descriptor(e, a, b, np.zeros(at.n), np.zeros(at.n), at)
    gone = at.node[SOURCE]
    kept = np.delete(np.arange(at.n), gone)
    inner = np.ix_(kept, kept)
    return Descriptor(e[inner], a[inner], b[kept], a[kept, gone], -e[kept, gone], _without(at, gone))


def _without(at: Places, gone: int) -> Places:
    """The places with one node taken out."""

    def moved(places: dict[Any, int]) -> dict[Any, int]:
        return {key: place - (place > gone) for key, place in places.items() if place != gone}

    return Places(moved(at.node), moved(at.current), moved(at.capacitor), at.n - 1)


def series_circuit(r_ohm: float, l_h: float) -> Circuit:
    """R and L between PCC and source."""
    return Circuit((Branch("line", {PCC: 1.0, SOURCE: -1.0}, r_ohm, l_h),), label=f"{r_ohm:g} ohm + {l_h:g} H")
