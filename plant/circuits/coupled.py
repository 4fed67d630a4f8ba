"""A network between many places, split for a kernel: what each place does to itself, and what all exchange.

The matrices of `stepping` are dense, their work grows with the square of the number of places. But places hang on the
rest of the network by few wires. In coordinates that belong to them, a capacitor's voltage and a branch's current each,
a matrix is ::

    M = L + U K V

with L the answer of each place with the rest of the network short-circuited, and U K V all else: V sums over the places
what they exchange, K is small, U tells them what becomes of it. For a star of any size these sums are a few. L is the
network of a place alone, the sums are found by singular values down to rounding: nothing is left out, and a network
that has no such structure merely has many sums. Real and imaginary parts (alpha and beta) are summed alike, so U and V
are real matrices of one of them.

`split` is the way in. Below it stand the coordinates that belong to places, the matrices of the step in them, and the
factors of what is exchanged.

Quantities of a place: its two states, a voltage and a current, and the current it feeds in, which is that of one device
of which it has ``factor``; then what it sees, a voltage and a current. First all real parts, then the imaginary ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .branches import GROUND
from .dynamics import Dynamics, Finite, dynamics_of
from .stepping import Outputs, Weights, rates_of, weights_of

STATES, FED, SEEN = 4, 2, 4
"""Numbers of a place: two states, its current, what it sees."""

LOCAL = 136
"""Numbers of the parts that a place does to itself, in the order of `Coupled`."""

_ROUNDING = 1e-13  # singular values up to this are none: entries are of the size of one by then
_NOTHING = 1e-2  # least scale of a row or column, as a part of the largest: what is smaller may be rounding alone
_INDEPENDENT = 1e-7  # part of a row that must be left without those before, or it says nothing new


@dataclass(frozen=True, slots=True)
class Place:
    """Where a device hangs on the network.

    Attributes
    ----------
    node : str
        Its terminals.
    shunt : str
        The branch that belongs to the device itself, with a resistor and a capacitor.
    factor : float
        Equal devices there.
    """

    node: str
    shunt: str
    factor: float


class Coupling(NamedTuple):
    """What all exchange: s = (into re x, into im x, e), t = core s, then re y += out t, im y += out t', f += t".

    Attributes
    ----------
    into : (r, groups, n_in / 2 lanes) float
        Sums over what the places have, lane by lane.
    core : (2 q + n_f, 2 r + n_e) float
        From the sums, and what belongs to no place, to the like.
    out : (groups, q', n_out / 2 lanes) float
        Into what the places see or become; q' is the next multiple of two.
    """

    into: np.ndarray
    core: np.ndarray
    out: np.ndarray


class Coupled(NamedTuple):
    """What takes places and the rest of the network through a step.

    With differences d_s = u_s - u_0 of the currents fed in, a quarter of a step each:

    Attributes
    ----------
    at_start : Coupling
        States and u_0 to what is seen at the start, then to what is watched.
    by_start : Coupling
        The same to what is held for the middle and the end, and to the states' own part of the next ones.
    direct : Coupling
        A difference to what is seen at once.
    by_first, by_second : Coupling
        d_1 to what is seen next, d_2 to what is seen at the end.
    at_end : Coupling
        (d_1 + d_2) / 2 and d_3 to the states at the end.
    by_rates : (f, 2 d) float
        What the extra outputs have of the rates of currents that belong to no place.
    rates_seen : (groups, 2 d, 4 lanes) float
        The same of what the places see.
    turn : (2,) float
        As of `Weights`.
    """

    at_start: Coupling
    by_start: Coupling
    direct: Coupling
    by_first: Coupling
    by_second: Coupling
    at_end: Coupling
    by_rates: np.ndarray
    rates_seen: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True, eq=False)
class Split:
    """A network split into places and the rest.

    Attributes
    ----------
    local : (n, LOCAL) float
        What each place does to itself.
    coupled : Coupled
        What they exchange.
    basis, inverse : (m, m) float
        The states of `Dynamics` to those used here and back.
    own : (n, 4) int
        Which of these are a place's; -1 for none.
    rest : (q,) int
        Those of no place.
    """

    local: np.ndarray
    coupled: Coupled
    basis: np.ndarray
    inverse: np.ndarray
    own: np.ndarray
    rest: np.ndarray

    def spread(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 4) of the places, real parts first, and (q,) of the rest, from the states (m,) of `Dynamics`."""
        x = self.basis @ states
        return np.where(self.own >= 0, x[self.own], 0.0), x[self.rest]

    def gathered(self, places: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """The states (m,) of `Dynamics` again."""
        x = np.empty(len(self.basis))
        x[self.own[self.own >= 0]] = places[self.own >= 0]
        x[self.rest] = rest
        found: np.ndarray = self.inverse @ x
        return found


class _Maps(NamedTuple):
    """The step as six matrices, from pairs of states and port currents to outputs and states."""

    at_start: np.ndarray
    by_start: np.ndarray
    direct: np.ndarray
    by_first: np.ndarray
    by_second: np.ndarray
    at_end: np.ndarray


def split(
    dynamics: Dynamics, outputs: Outputs, step_s: float, places: Sequence[Place], n_dampers: int, lanes: int
) -> Split:
    """Split a network whose outputs are voltages of the ports, currents of the places, and what is watched."""
    n = len(places)
    basis, own = _basis(dynamics, places)
    inverse = np.linalg.inv(basis)
    rest = np.setdiff1d(np.arange(len(basis)), own)
    factors = np.array([place.factor for place in places])
    scaled = _per_device(weights_of(dynamics, outputs, step_s), factors, n_dampers)
    maps = _maps(scaled, basis, inverse)
    local = np.array([_local(dynamics, place, step_s) for place in places])
    layout = _Layout(n, n_dampers, len(outputs.of_x) - 2 * n - n_dampers, own, rest, lanes)
    borders = np.cumsum([kind.n_in * kind.n_out for kind in _KINDS])[:-1]
    parts = np.split(local, borders, axis=1)
    coupled = [_coupling(matrix, part, kind, layout) for kind, matrix, part in zip(_KINDS, maps, parts, strict=True)]
    rates = _scaled_rows(rates_of(dynamics, outputs), factors, n_dampers)[:, 2 * n :]
    extra = np.concatenate([rates[r] for r in (layout.damper_rows, layout.watched_rows)])
    seen = layout.in_lanes(rates[layout.seen_rows].transpose(0, 2, 1)).transpose(1, 0, 2)
    exchanged: list[Any] = [*coupled, extra, np.ascontiguousarray(seen), scaled.turn]
    return Split(local, Coupled(*exchanged), basis, inverse, own, rest)


# ---------------------------------------------------------------------- coordinates


def _basis(dynamics: Dynamics, places: Sequence[Place]) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (m, m) that are the network's memory, the places' own first, and which are whose (n, 4)."""
    of_x, _ = dynamics.readout
    v = dynamics.finite.v
    rows = np.kron(of_x, np.eye(2)) @ (v if dynamics.frame == "stationary" else np.kron(v, np.eye(2)))
    chosen = _Independent(rows.shape[1])
    own = np.full((len(places), STATES), -1)
    taken: set[int] = set()
    for k, place in enumerate(places):
        for slot, entry in enumerate(_entries_of(dynamics, place, taken)):
            for part in range(2):
                own[k, slot + 2 * part] = chosen.add(rows[2 * entry + part])
    for row in rows:
        chosen.add(row)
    return np.array(chosen.rows), own


def _entries_of(dynamics: Dynamics, place: Place, taken: set[int]) -> list[int]:
    """Places in the memory of a device's own capacitor and of the first branch from its terminals that is free."""
    shunt = dynamics.names.index(place.shunt)
    found = [2 * shunt + 1]
    for k, branch in enumerate(dynamics.branches):
        if place.node in branch.ends and branch.l_h > 0.0 and k not in taken:
            taken.add(k)
            return [*found, 2 * k]
    return found


class _Independent:
    """Rows, each independent of those before."""

    def __init__(self, n: int):
        self.rows: list[np.ndarray] = []
        self._unit = np.zeros((n, n))

    def add(self, row: np.ndarray) -> int:
        """Its number if it says something new, else -1."""
        size = np.linalg.norm(row)
        if size == 0.0 or len(self.rows) == len(self._unit):
            return -1
        left = row / size
        for _ in range(2):
            left = left - self._unit.T @ (self._unit @ left)
        new = np.linalg.norm(left)
        if new < _INDEPENDENT:
            return -1
        self._unit[len(self.rows)] = left / new
        self.rows.append(row)
        return len(self.rows) - 1


# ---------------------------------------------------------------------- matrices


def _per_device(w: Weights, factors: np.ndarray, n_dampers: int) -> Weights:
    """The weights with currents of places counted for one device."""
    fed = np.repeat(np.concatenate([factors, np.ones(n_dampers)]), 2)
    by_current = ("direct", "by_start", "by_first", "by_whole", "by_second")
    seen = {name: _scaled_rows(getattr(w, name), factors, n_dampers) * fed for name in by_current}
    held = np.stack([_scaled_rows(matrix, factors, n_dampers) for matrix in w.seen])
    return w._replace(seen=held, start=w.start * fed, middle=w.middle * fed, end=w.end * fed, **seen)


def _scaled_rows(matrix: np.ndarray, factors: np.ndarray, n_dampers: int) -> np.ndarray:
    """A matrix (2 o, any) with the currents that places see counted for one device."""
    n = len(factors)
    scale = np.ones(len(matrix))
    first = 2 * (n + n_dampers)
    scale[first : first + 2 * n] = np.repeat(1.0 / factors, 2)
    return matrix * scale[:, None]


def _maps(w: Weights, basis: np.ndarray, inverse: np.ndarray) -> _Maps:
    seen = w.seen @ inverse
    keep = basis @ w.keep @ inverse
    start, middle, end = (basis @ matrix for matrix in (w.start, w.middle, w.end))
    held = [
        np.hstack([seen[1], w.by_start + w.direct]),
        np.hstack([seen[2], w.by_whole + w.direct]),
        np.hstack([keep, start + middle + end]),
    ]
    at_start = np.hstack([seen[0], w.direct])
    return _Maps(at_start, np.vstack(held), w.direct, w.by_first, w.by_second, np.hstack([middle, end]))


def _local(dynamics: Dynamics, place: Place, step_s: float) -> np.ndarray:
    """(LOCAL,) of a place alone, all nodes but its own short-circuited."""
    cell = tuple(
        replace(branch, ends={place.node: branch.ends[place.node], GROUND: 0.0})
        for branch in dynamics.branches
        if place.node in branch.ends
    )
    alone = _framed(dynamics_of(cell, (place.node,), dynamics.w1_rad_s), dynamics.frame)
    at, shunt = alone.system.at, alone.names.index(place.shunt)
    of_x = np.zeros((2, at.n))
    of_x[0, at.node[place.node]], of_x[1, at.current[shunt]] = 1.0, -1.0
    outputs = Outputs(of_x, np.array([[0.0], [1.0]]))
    basis, own = _basis(alone, [place])
    weights = _per_device(weights_of(alone, outputs, step_s), np.array([place.factor]), 0)
    maps = _maps(weights, basis, np.linalg.inv(basis))
    layout = _Layout(1, 0, 0, own, np.setdiff1d(np.arange(len(basis)), own), 1)
    found = []
    for kind, matrix in zip(_KINDS, maps, strict=True):
        rows, columns = _by_fours(layout.rows(kind)[0][0]), layout.columns(kind)[0][0]
        found.append(_picked(matrix, rows, columns).ravel())
    return np.concatenate(found)


def _by_fours(rows: np.ndarray) -> np.ndarray:
    """Rows, all real parts before the imaginary ones, as a place's own have them: two real, then two imaginary."""
    return rows.reshape(2, -1, 2).transpose(1, 0, 2).ravel()


def _framed(dynamics: Dynamics, frame: str) -> Dynamics:
    """The same network with states of that frame."""
    if frame == "dq":
        return dynamics
    pairs = Finite(*(np.kron(matrix, np.eye(2)) for matrix in dynamics.finite))
    return replace(dynamics, frame="stationary", finite=pairs)


def _picked(matrix: np.ndarray, rows: ArrayLike, columns: ArrayLike) -> np.ndarray:
    """Rows and columns of a matrix; zero where a number is negative."""
    down, across = np.asarray(rows), np.asarray(columns)
    found = np.zeros((len(down), len(across)))
    inside = np.ix_(down >= 0, across >= 0)
    found[inside] = matrix[np.ix_(down[down >= 0], across[across >= 0])]
    return found


# ---------------------------------------------------------------------- what is exchanged


class _Kind(NamedTuple):
    """A map's name, and its numbers per place."""

    name: str
    n_in: int
    n_out: int


_KINDS = (
    _Kind("at_start", STATES + FED, SEEN),
    _Kind("by_start", STATES + FED, 2 * SEEN + STATES),
    _Kind("direct", FED, SEEN),
    _Kind("by_first", FED, SEEN),
    _Kind("by_second", FED, SEEN),
    _Kind("at_end", 2 * FED, STATES),
)


class _Layout:
    """Where the numbers of places, dampers, watched things and other states stand in rows and columns."""

    def __init__(self, n: int, n_dampers: int, n_watched: int, own: np.ndarray, rest: np.ndarray, lanes: int):
        self.n, self.lanes, self.own, self.rest = n, lanes, own, rest
        ports = n + n_dampers
        k = 2 * np.arange(n)[:, None]
        self.seen_rows = np.hstack([k, 2 * ports + k, k + 1, 2 * ports + k + 1])
        self.damper_rows = 2 * n + np.arange(2 * n_dampers)
        self.watched_rows = 2 * (ports + n) + np.arange(2 * n_watched)
        self.fed, self.damper_fed = np.hstack([k, k + 1]), self.damper_rows
        self.n_outputs, self.n_fed = 2 * (ports + n + n_watched), 2 * ports
        self.n_states = int(np.sum(own >= 0)) + len(rest)

    def columns(self, kind: _Kind) -> tuple[np.ndarray, np.ndarray]:
        """Of places (n, n_in), and of what belongs to none."""
        if kind.n_in == STATES + FED:
            places = _beside(self.own, self.n_states + self.fed)
            return places, np.concatenate([self.rest, self.n_states + self.damper_fed])
        if kind.n_in == FED:
            return self.fed, self.damper_fed
        places = _beside(self.fed, self.n_fed + self.fed)
        return places, np.concatenate([self.damper_fed, self.n_fed + self.damper_fed])

    def rows(self, kind: _Kind) -> tuple[np.ndarray, np.ndarray]:
        """Of places (n, n_out), and of what belongs to none."""
        if kind.name == "at_start":
            return self.seen_rows, np.concatenate([self.damper_rows, self.watched_rows])
        if kind.name == "at_end":
            return self.own, self.rest
        if kind.name != "by_start":
            return self.seen_rows, self.damper_rows
        shift = 2 * self.n_outputs
        own = np.where(self.own >= 0, shift + self.own, -1)
        places = _beside(self.seen_rows, self.n_outputs + self.seen_rows, own)
        extra = [self.damper_rows, self.n_outputs + self.damper_rows, shift + self.rest]
        return places, np.concatenate(extra)

    def in_lanes(self, values: np.ndarray) -> np.ndarray:
        """(n, k, r) of places as (groups, r, k lanes); lanes beyond are as the first place."""
        groups = -(-self.n // self.lanes)
        padded = np.concatenate([values, np.repeat(values[:1], groups * self.lanes - self.n, axis=0)])
        k, r = padded.shape[1:]
        by_group = padded.reshape(groups, self.lanes, k, r).transpose(0, 3, 2, 1)
        return np.ascontiguousarray(by_group).reshape(groups, r, k * self.lanes)


def _beside(*numbers: np.ndarray) -> np.ndarray:
    """Columns (n, k), real parts before imaginary ones, of several such."""
    halves = [np.split(each, 2, axis=1) for each in numbers]
    return np.hstack([half[part] for part in range(2) for half in halves])


def _coupling(matrix: np.ndarray, local: np.ndarray, kind: _Kind, layout: _Layout) -> Coupling:
    """The remainder of a matrix without what the places do to themselves."""
    columns, more_columns = layout.columns(kind)
    rows, more_rows = layout.rows(kind)
    rest = matrix.copy()
    for part, to, of in zip(local.reshape(-1, kind.n_out, kind.n_in), rows, columns, strict=True):
        to = _by_fours(to)
        rest[np.ix_(to[to >= 0], of[of >= 0])] -= part[np.ix_(to >= 0, of >= 0)]
    n, wide, high = layout.n, kind.n_in // 2, kind.n_out // 2
    inner = _Inner.of(matrix, rest, (_halves(rows), more_rows), (_halves(columns), more_columns))
    into = layout.in_lanes(inner.into.T.reshape(n, wide, -1))
    used = n - (len(into) - 1) * layout.lanes  # lanes of the last group; the idle ones beside them add nothing
    into.reshape(len(into), len(inner.into), wide, layout.lanes)[-1, :, :, used:] = 0.0
    odd = inner.out.shape[1] % 2
    out = np.pad(inner.out, ((0, 0), (0, odd))).reshape(n, high, -1)
    return Coupling(np.ascontiguousarray(into.transpose(1, 0, 2)), inner.core, layout.in_lanes(out))


def _halves(numbers: np.ndarray) -> np.ndarray:
    """(2, n k / 2) of numbers (n, k) of places: real parts, imaginary parts."""
    return np.stack([half.ravel() for half in np.split(numbers, 2, axis=1)])


class _Inner(NamedTuple):
    """``out`` (rows, q), ``core``, ``into`` (r, columns) of a remainder, one part of the places' rows and columns."""

    out: np.ndarray
    core: np.ndarray
    into: np.ndarray

    @classmethod
    def of(
        cls,
        whole: np.ndarray,
        rest: np.ndarray,
        rows: tuple[np.ndarray, np.ndarray],
        columns: tuple[np.ndarray, np.ndarray],
    ) -> _Inner:
        """Of ``rest`` to the rounding of ``whole``; rows and columns of the places (2, k), and of no place."""
        to, more_to = _sizes(whole, rows, 1)
        by_row = _spread(to, more_to, rows, len(whole))[:, None]
        of, more_of = _sizes(whole / by_row, columns, 0)
        unit = rest / by_row / _spread(of, more_of, columns, whole.shape[1])
        all_rows, all_columns = np.append(rows[0].ravel(), rows[1]), np.append(columns[0].ravel(), columns[1])
        u = _space(np.hstack([_picked(unit, part, all_columns) for part in rows[0]]))
        v = _space(np.hstack([_picked(unit, all_rows, part).T for part in columns[0]]))
        picked = _picked(unit, all_rows, all_columns)
        core = _both(u, len(rows[1])).T @ picked @ _both(v, len(columns[1]))
        q, r = 2 * u.shape[1], 2 * v.shape[1]
        core[q:] *= more_to[:, None]
        core[:, r:] *= more_of
        return cls(u * to[:, None], np.ascontiguousarray(core), np.ascontiguousarray((v * of[:, None]).T))


def _space(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of columns, down to rounding."""
    u, values, _ = np.linalg.svd(columns, full_matrices=False)
    found: np.ndarray = u[:, values > _ROUNDING]
    return found


def _both(basis: np.ndarray, more: int) -> np.ndarray:
    """The basis for real and imaginary parts, and ``more`` numbers as they are."""
    n, r = basis.shape
    found = np.zeros((2 * n + more, 2 * r + more))
    found[:n, :r], found[n : 2 * n, r : 2 * r] = basis, basis
    found[2 * n :, 2 * r :] = np.eye(more)
    return found


def _sizes(matrix: np.ndarray, numbers: tuple[np.ndarray, np.ndarray], axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest entries of rows (axis 1) or columns: of both parts of the places', and of those of no place.

    What is small beside the largest of all is rounding, and counts as larger.
    """
    size = np.abs(matrix).max(axis=axis, initial=0.0)
    size = np.maximum(size, _NOTHING * max(float(size.max(initial=0.0)), 1e-300))
    of_places = np.where(numbers[0] >= 0, size[numbers[0]], 0.0).max(axis=0, initial=0.0)
    return np.where(of_places > 0.0, of_places, 1.0), size[numbers[1]]


def _spread(places: np.ndarray, others: np.ndarray, numbers: tuple[np.ndarray, np.ndarray], n: int) -> np.ndarray:
    """(n,) of rows or columns from what is the same for both parts of the places'."""
    found = np.ones(n)
    for part in numbers[0]:
        found[part[part >= 0]] = places[part >= 0]
    found[numbers[1]] = others
    return found
