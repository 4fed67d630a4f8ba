"""Where a surrogate speaks: operating points, the box they fill, and how they become the unit box.

An operating point is (P, Q, |v|) and the values of plant parameters that are axes too, in alphabetical order. The
model's coordinates are the currents and the voltage that P, Q and |v| stand for, ``i_d = P/V``, ``i_q = -Q/V`` and V,
and the parameters as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError, nearest
from ..response import FrequencyResponse

AXES = ("active_power_mw", "reactive_power_mvar", "terminal_voltage_pu")
"""What an operating point is given by; a table without a reactive power has zero."""

LEAST_SWEEPS = 4
"""Fewest operating points that a surrogate is built from."""

_SPREAD = 1e-9  # an axis that varies by less, relatively, does not vary
_BESIDE = 1e-9  # how far outside the region rounding may put a point

_OUT_OF_HULL = (
    "is outside of the convex hull of the listed operating points, though each value is within its range: a surrogate "
    "says nothing there; sweep operating points about there"
)


class SurrogateError(SeqsweepError):
    """Sweeps that no surrogate can be built from, or a point where it has nothing to say, with the way out."""


@dataclass(frozen=True, slots=True)
class Region:
    """The swept operating points: the box that they fill, or within it their convex hull.

    Attributes
    ----------
    low, high : (d,) float
        Its ends, in the units of `AXES`, and in those of the parameters.
    parameters : tuple of str
        Plant parameters that are axes besides `AXES`.
    hull : (k, d + 1) float or None
        Planes of the convex hull: normals outwards, in parts of the box, and offsets. Inside, n . point + offset is not
        positive. None: the whole box.
    """

    low: np.ndarray
    high: np.ndarray
    parameters: tuple[str, ...] = ()
    hull: np.ndarray | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """(d,) names of all axes."""
        return (*AXES, *self.parameters)

    @property
    def varies(self) -> np.ndarray:
        """(d,) bool: which axes the sweeps differ along."""
        return self.high - self.low > _SPREAD * np.maximum(np.abs(self.high), 1.0)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """(p,) bool: points (p, d) inside."""
        room = _BESIDE * np.maximum(np.abs(self.high), 1.0)
        inside = ((points >= self.low - room) & (points <= self.high + room)).all(axis=1)
        if self.hull is not None:
            inside &= (points @ self.hull[:, :-1].T + self.hull[:, -1] <= _BESIDE).all(axis=1)
        return np.asarray(inside)

    def check(self, points: np.ndarray) -> None:
        """Refuse the first of points (p, d) outside the region, by the axis that it leaves.

        Raises
        ------
        SurrogateError
            If there is one.
        """
        outside = ~self.holds(points)
        if outside.any():
            first = points[outside.argmax()]
            ends = zip(self.axes, first, self.low, self.high, strict=True)
            beyond = (outside_text(*end) for end in ends if not end[2] <= end[1] <= end[3])
            raise SurrogateError(next(beyond, f"{told(first, self.parameters)} {_OUT_OF_HULL}"))

    def samples(self, n: int) -> np.ndarray:
        """Points (n', d) that fill the box evenly, its corners among them; always the same."""
        from scipy.stats import qmc

        at = np.flatnonzero(self.varies)
        inside = qmc.Sobol(len(at), scramble=False).random(1 << max(n - 1, 1).bit_length())
        corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * len(at)), axis=-1).reshape(-1, len(at))
        unit = np.zeros((len(inside) + len(corners), len(self.low)))
        unit[:, at] = np.concatenate([corners, inside])
        return self.low + unit * (self.high - self.low)

    def complete(self, points: np.ndarray) -> np.ndarray:
        """Points (p, d); of points (p, 3) the parameters are added, where each has one value.

        Raises
        ------
        SurrogateError
            If a parameter is an axis and its value is not given.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        if points.shape[1] == len(self.low):
            return points
        free = [name for name, varies in zip(self.axes[3:], self.varies[3:], strict=True) if varies]
        if points.shape[1] != len(AXES) or free:
            raise SurrogateError(
                f"an operating point has {len(self.low)} values, {', '.join(self.axes)}; given are {points.shape[1]}: "
                f"say which value {' and '.join(free) or 'each'} has"
            )
        return np.hstack([points, np.tile(self.low[3:], (len(points), 1))])

    def fixed(self, values: Mapping[str, float]) -> Region:
        """The part of the region where parameters have these values.

        Raises
        ------
        SurrogateError
            If one of them is no axis, or the value is outside of what was swept.
        """
        low, high = self.low.copy(), self.high.copy()
        for name, value in values.items():
            if name not in self.parameters:
                known = ", ".join(self.parameters) or "none"
                raise SurrogateError(
                    f"{name} is no parameter of this surrogate{nearest(name, self.parameters)}; known: {known}"
                )
            at = self.axes.index(name)
            if not self.low[at] <= value <= self.high[at]:
                raise SurrogateError(outside_text(name, value, self.low[at], self.high[at]))
            low[at] = high[at] = value
        return replace(self, low=low, high=high)


class Scale(NamedTuple):
    """How coordinates (i_d, i_q, V, parameters) become the unit box; ``axes`` are those that vary."""

    axes: tuple[int, ...]
    middle: np.ndarray
    half: np.ndarray

    def unit(self, points: np.ndarray) -> np.ndarray:
        """(p, d') coordinates of operating points (p, d)."""
        return (_coordinates(points)[:, self.axes] - self.middle) / self.half


def hulled(points: np.ndarray, region: Region) -> Region:
    """The region within the convex hull of points (m, d); along one axis, or of points on a line, the box itself."""
    from scipy.spatial import ConvexHull, QhullError

    axes = np.flatnonzero(region.varies)
    if len(axes) < 2:
        return region
    size = (region.high - region.low)[axes]
    try:
        planes = ConvexHull((points[:, axes] - region.low[axes]) / size).equations
    except QhullError:
        return region
    hull = np.zeros((len(planes), points.shape[1] + 1))
    hull[:, axes] = planes[:, :-1] / size
    hull[:, -1] = planes[:, -1] - hull[:, axes] @ region.low[axes]
    return replace(region, hull=hull)


def scale_of(points: np.ndarray, region: Region) -> Scale:
    """The scale of swept points (m, d).

    Raises
    ------
    SurrogateError
        If they are all the same, or lie on a line of the region that leaves a direction unseen.
    """
    axes = tuple(int(axis) for axis in np.flatnonzero(region.varies))
    if not axes:
        raise SurrogateError("all operating points are the same: there is nothing to interpolate between")
    x = _coordinates(points)[:, axes]
    low, high = x.min(axis=0), x.max(axis=0)
    scale = Scale(axes, (low + high) / 2.0, (high - low) / 2.0)
    asked = (points[:, axes] - region.low[list(axes)]) / (region.high - region.low)[list(axes)]
    spread = np.linalg.svd(asked - asked.mean(axis=0), compute_uv=False)
    if spread[-1] < 1e-3 * spread[0]:
        raise SurrogateError(
            "the operating points lie on a line of the region: what happens beside it cannot be told; sweep points "
            f"that vary {' and '.join(region.axes[axis] for axis in axes)} independently"
        )
    return scale


def _coordinates(points: np.ndarray) -> np.ndarray:
    """(p, d) i_d = P/V, i_q = -Q/V (MW and Mvar over pu), V (pu) and the parameters."""
    p, q, v = points[:, :3].T
    return np.column_stack([p / v, -q / v, v, points[:, 3:]])


# Operating points of a table ------------------------------------------------------------------------------------------


def parameters_of(responses: Sequence[FrequencyResponse]) -> tuple[str, ...]:
    """Names of the plant parameters that operating points were swept with, each at a value of its own.

    Raises
    ------
    SurrogateError
        If they are not the same everywhere.
    """
    names = {tuple(sorted(response.meta.get("parameters") or {})) for response in responses}
    if len(names) > 1:
        raise SurrogateError("the operating points were swept with different sets of parameters: keep those of one set")
    return next(iter(names), ())


def points_of(responses: Sequence[FrequencyResponse], parameters: Sequence[str] = ()) -> np.ndarray:
    """(m, d) operating points as the table gives them.

    Raises
    ------
    SurrogateError
        If there are too few, two fundamentals, one point twice, or a value is missing.
    """
    if len(responses) < LEAST_SWEEPS:
        raise SurrogateError(
            f"the table holds {len(responses)} of the at least {LEAST_SWEEPS} operating points that a surrogate needs: "
            "sweep more of them"
        )
    if len({response.f1_hz for response in responses}) > 1:
        raise SurrogateError("the table holds several fundamentals; a surrogate is of one device at one fundamental")
    points = np.array([point_of(response, parameters) for response in responses])
    if len(np.unique(points, axis=0)) < len(points):
        raise SurrogateError("an operating point is there twice: two devices, or one that was swept again; keep one")
    return points


def point_of(response: FrequencyResponse, parameters: Sequence[str] = ()) -> list[float]:
    """One operating point; |v_pcc| that a grid decided is taken as it was measured."""
    own = response.meta.get("parameters") or {}
    return [*(_value(response, axis) for axis in AXES), *(float(own[name]) for name in parameters)]


def _value(response: FrequencyResponse, axis: str) -> float:
    value = response.meta.get(axis)
    if value is None and axis == "terminal_voltage_pu":
        value = response.meta.get("fundamental", {}).get("voltage_pu")
    if value is None and axis == "reactive_power_mvar":
        return 0.0
    if value is None or not np.isfinite(value):
        raise SurrogateError(f"{response.meta.get('op_id')}: the table does not say its {axis}")
    return float(value)


def facts_of(point: Sequence[float] | np.ndarray, parameters: Sequence[str] = ()) -> dict[str, object]:
    """An operating point as a table's metadata has it: its name, `AXES`, and ``parameters`` where there are any."""
    values = list(map(float, point))
    facts: dict[str, object] = {"op_id": name_of(values, parameters), **dict(zip(AXES, values[:3], strict=True))}
    return {**facts, "parameters": dict(zip(parameters, values[3:], strict=True))} if parameters else facts


def name_of(point: Sequence[float] | np.ndarray, parameters: Sequence[str] = ()) -> str:
    """Name of an operating point in a predicted table."""
    p, q, v, *others = point
    further = "".join(f"_{name}{value:g}" for name, value in zip(parameters, others, strict=True))
    return f"p{p:g}_q{q:g}_v{v:g}{further}"


def told(point: Sequence[float] | np.ndarray, parameters: Sequence[str] = (), digits: str = ".4g") -> str:
    """An operating point in words."""
    values = [format(float(value), digits) for value in point]
    further = "".join(f", {name} = {value}" for name, value in zip(parameters, values[3:], strict=True))
    return f"(P, Q, |v|) = ({', '.join(values[:3])}){further}"


def outside_text(axis: str, value: float, low: float, high: float) -> str:
    """Why a value outside the region has no answer."""
    return (
        f"{axis} = {value:g} is outside the swept region, {low:g} to {high:g}: a surrogate says nothing there; "
        "sweep operating points beyond it"
    )
