"""The surrogate: Y(f; P, Q, V) at any operating point inside the swept region, with a 95 % region of its error.

Operating points are given as the table gives them (set-points in MW, Mvar and pu of the terminal voltage, and plant
parameters where they are axes). The model's coordinates are the currents and the voltage they stand for, ``i_d = P/V``,
``i_q = -Q/V`` and V, each scaled to -1 to 1 over the swept points: in these a linearised converter is nearly polynomial
over one denominator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..fit.dq_data import to_dq
from ..frames import dq_to_pn
from ..response import FrequencyResponse
from .between import between
from .choosing import choose_shapes
from .index_sets import Index
from .jumps import Border, find_border
from .piece import Cautious, Piece, piece_of
from .region import (
    AXES,
    Region,
    Scale,
    SurrogateError,
    facts_of,
    name_of,
    parameters_of,
    points_of,
    scale_of,
)
from .sparse_rational import ELEMENTS, Data, Fitted, Shape, fit_shape, values

DECIDING = 24
"""Frequencies by which the products are chosen."""

_SAME = 1e-6  # |f - f1| closer than this, relatively, are one frequency


class Evaluation(NamedTuple):
    """Prediction at operating points.

    Attributes
    ----------
    y : (p, f, 2, 2) complex
        Admittance in the dq frame (S).
    radius : (p, f) float
        Radius of the 95 % region of Y in the Frobenius norm (S).
    """

    y: np.ndarray
    radius: np.ndarray

    @property
    def relative(self) -> np.ndarray:
        """(p, f) radius relative to ||Y||_F."""
        return self.radius / np.linalg.norm(self.y, axis=(2, 3))


@dataclass(frozen=True)
class Surrogate:
    """A model of the admittance over operating points.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    nu_hz : (f,) float
        Frequencies of the model in the dq frame, |f - f1| (Hz).
    region : Region
        Where it speaks.
    points : (m, d) float
        The swept operating points, along the axes of the region.
    scale : Scale
        From operating points to the unit box.
    pieces : tuple of Piece
        One device, or two where it changes at ``border``: below and above.
    border : Border or None
        Where the admittance jumps; nothing is said within its gap.
    suspected : Border or None
        Where it may jump, the sweeps saying too little yet; it is smooth there in this model.
    terminal : Fitted
        The fundamental current at the PCC, i_d + j i_q as the first element (A, RMS, out of the device, d on v_pcc).
    meta : mapping
        Metadata of the table it was built from.
    """

    f1_hz: float
    nu_hz: np.ndarray
    region: Region
    points: np.ndarray
    scale: Scale
    pieces: tuple[Piece | Cautious, ...]
    border: Border | None
    suspected: Border | None
    terminal: Fitted | None
    meta: Mapping[str, Any]

    def __repr__(self) -> str:
        spans = (
            f"{axis} {low:.4g} to {high:.4g}" if high > low else f"{axis} {low:.4g}"
            for axis, low, high in zip(self.region.axes, self.region.low, self.region.high, strict=True)
        )
        return f"<Surrogate of {len(self.points)} operating points, {len(self.nu_hz)} frequencies: {', '.join(spans)}>"

    def evaluate(self, points: np.ndarray) -> Evaluation:
        """Y at operating points (p, d) inside the region, in the dq frame; (p, 3) where no parameter is open.

        Raises
        ------
        SurrogateError
            If a point is outside the region, or a parameter's value is missing.
        """
        points = self._inside(points)
        x = self.scale.unit(points)
        y = np.empty((len(x), len(self.nu_hz), ELEMENTS), dtype=complex)
        relative = np.empty(y.shape[:2])
        side = np.zeros(len(x), dtype=int) if self.border is None else self.border.side(points)
        for number, piece in enumerate(self.pieces):
            if np.any(own := side == number):
                y[own], relative[own] = piece.evaluate(x[own])
        return Evaluation(y.reshape(*y.shape[:2], 2, 2), relative * np.linalg.norm(y, axis=2))

    def response(self, point: Sequence[float] | np.ndarray, f_hz: np.ndarray | None = None) -> FrequencyResponse:
        """One operating point as the response of a table, its error in the covariance.

        Parameters
        ----------
        point : (d,) float
            P (MW), Q (Mvar), |v| (pu), and the values of parameters that are axes.
        f_hz : (n,) float or None
            Frequencies (Hz) on either side of f1, between the model's own by interpolation; None: its own, above f1.

        Raises
        ------
        SurrogateError
            If the point is outside the region, or a frequency outside of the swept rows.

        Notes
        -----
        The error of a model is alike at neighbouring frequencies, and no fit averages it away: the covariance counts it
        `CORRELATED` times, so that as many rows with it say no more than one.
        """
        found = self.evaluate(np.atleast_2d(np.asarray(point, dtype=float)))
        f = self.f1_hz + self.nu_hz if f_hz is None else np.asarray(f_hz, dtype=float)
        told, radius = self._at(np.abs(f - self.f1_hz), found)
        y = np.where((f < self.f1_hz)[:, None, None], told.conj(), told)
        covariance = covariance_of(radius)
        whole = self.region.complete(np.asarray(point))[0]
        meta = {**facts_of(whole, self.region.parameters), "surrogate": True}
        return FrequencyResponse(f, dq_to_pn(y), self.f1_hz, covariance=covariance, meta={**self._facts(), **meta})

    def terminal_current(self, points: np.ndarray) -> np.ndarray:
        """(p,) complex fundamental current out of the device (A, RMS), d on v_pcc, at operating points (p, d).

        Raises
        ------
        SurrogateError
            If the table does not hold the measured fundamental of every operating point.
        """
        if self.terminal is None:
            raise SurrogateError(
                "the table lacks the measured fundamental of its operating points, from which |v| on a grid follows: "
                "sweep it again, or of an imported table name the operating point (`seqsweep surrogate --at P,Q,V`)"
            )
        return values(self.terminal, self.scale.unit(self.region.complete(points)))[:, 0, 0]

    @cached_property
    def cautious(self) -> Surrogate:
        """The same device with what its models may lack in its radii: what sweeps are placed by and certified with."""
        return replace(self, pieces=tuple(piece.cautious for piece in self.pieces))

    @cached_property
    def worst_bar(self) -> tuple[float, np.ndarray]:
        """Largest relative radius over the region, and the operating point (d,) where it stands."""
        points = self.samples(512)
        relative = self.evaluate(points).relative.max(axis=1)
        return float(relative.max()), points[int(np.argmax(relative))]

    def holds(self, points: np.ndarray) -> np.ndarray:
        """(p,) bool: operating points (p, d) at which it has something to say."""
        points = self.region.complete(points)
        inside = self.region.holds(points)
        if self.border is not None:
            inside &= self.border.side(np.nan_to_num(points, nan=1.0)) >= 0
        return inside

    def samples(self, n: int) -> np.ndarray:
        """Points (n', d) that fill the region evenly, but for the gap of a jump."""
        points = self.region.samples(n)
        return points[self.holds(points)]

    @property
    def models(self) -> tuple[Fitted, ...]:
        """Models of the device, or of what it is below the border."""
        return self.pieces[0].models

    def fixed(self, **values: float) -> Surrogate:
        """The same device with these values of its parameters, where the sweeps vary them: ``fixed(k_pp=0.08)``.

        Raises
        ------
        SurrogateError
            If one of them is no axis of the sweeps, or lies outside of what was swept.
        """
        return replace(self, region=self.region.fixed(values)) if values else self

    @property
    def contradiction(self) -> float:
        """By how much left-out sweeps are missed, relative to ||Y||, where they are too many for that; else zero."""
        each = len(self.points) / len(self.pieces) / (len(self.scale.axes) + 2)
        worst = max((piece.models[0] for piece in self.pieces), key=lambda model: model.score)
        if each >= ENOUGH_SWEEPS and worst.score > CONTRADICTS:
            return worst.score
        told = each >= MANY_SWEEPS and worst.score > CONTRADICTS_ALIKE and worst.coherence > COHERENT
        return worst.score if told else 0.0

    def check_inside(self, point: Sequence[float], name: str) -> None:
        """Refuse an operating point outside the region, in the name of what asked for it."""
        try:
            self._inside(np.asarray(point, dtype=float))
        except SurrogateError as error:
            raise SurrogateError(f"{name}: {error}") from None

    def check_power(self, power: Sequence[float], name: str) -> None:
        """Refuse a dispatch (P, Q) outside of what was swept at any |v|, in the name of what asked for it."""
        box = replace(self.region, hull=None)
        try:
            box.check(box.complete(np.array([*power, self.region.low[2]])))
        except SurrogateError as error:
            raise SurrogateError(f"{name}: {error}") from None

    def _inside(self, points: np.ndarray) -> np.ndarray:
        points = self.region.complete(points)
        self.region.check(points)
        self._check_gap(points)
        return points

    def _check_gap(self, points: np.ndarray) -> None:
        if self.border is not None and np.any(self.border.side(points) < 0):
            raise SurrogateError(
                f"the device changes between {self.border}: nothing is interpolated across that; sweep in between"
            )

    def _at(self, nu_hz: np.ndarray, found: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Y (n, 2, 2) and its radius (n,) of one evaluated point at |f - f1| (n,): of a row, or between rows."""
        at = np.abs(self.nu_hz[None] - nu_hz[:, None]).argmin(axis=1)
        y, radius = found.y[0, at], found.radius[0, at]
        off = np.abs(self.nu_hz[at] - nu_hz) > _SAME * nu_hz
        if np.any(off):
            y[off], radius[off] = between(self.nu_hz, found.y[0], found.radius[0], nu_hz[off])
        return y, radius

    def _facts(self) -> dict[str, Any]:
        return {"stable_on": self.meta["stable_on"]} if self.meta.get("stable_on") else {}


ENOUGH_SWEEPS, MANY_SWEEPS = 2.0, 2.5
"""Sweeps for every axis and for two more, from which on left-out errors speak against the sweeps, not their number."""

CONTRADICTS, CONTRADICTS_ALIKE = 0.1, 0.02
"""Sweeps that are missed by more when left out do not belong to one device that changes smoothly.

The second counts where there are more of them, and they are missed alike at neighbouring frequencies: `COHERENT`.
"""

COHERENT = 0.3
"""Turbines of two gains by lot in one table are missed with a coherence of 0.55 to 0.85, noise with less than 0.12."""

CORRELATED = 7.0
"""Neighbouring rows whose model error is one and the same."""

_RADIUS = 1.392  # root of the 95 % quantile of chi-squared with eight degrees, over eight: radius per standard error


def covariance_of(radius: np.ndarray) -> np.ndarray:
    """Covariance (n, 8, 8) of rows whose 95 % regions have these radii (n,), alike in all directions."""
    variance = CORRELATED * (radius / _RADIUS) ** 2 / (2.0 * ELEMENTS)
    return np.asarray(variance[:, None, None] * np.eye(2 * ELEMENTS))


class Chosen(NamedTuple):
    """What is chosen once: the border of a jump, and the products of each piece, best first."""

    border: Border | None
    shapes: tuple[tuple[Shape, ...], ...] = ()


def build_surrogate(
    responses: Sequence[FrequencyResponse],
    chosen: Chosen | None = None,
    region: Region | None = None,
    bases: Mapping[str, Any] | None = None,
) -> Surrogate:
    """A surrogate from the operating points of a table.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        One device, one fundamental, at `LEAST_SWEEPS` operating points or more.
    chosen : Chosen or None
        Products and border, where they were chosen before; None: chosen here.
    region : Region or None
        Where it is to speak; None: the box of the swept points.
    bases : mapping or None
        The device's rating, as a table tells it.

    Raises
    ------
    SurrogateError
        If there are too few operating points, two fundamentals, no common frequencies, or points on a line of the
        region that leave a direction unseen.
    """
    parameters = parameters_of(responses)
    points = points_of(responses, parameters)
    region = region or Region(points.min(axis=0), points.max(axis=0), parameters)
    scale = scale_of(points, region)
    nu_hz, data, noise = _data_of(responses, scale.unit(points))
    guarded = region.samples(64)
    suspected = None
    if chosen is None:
        border, suspected = find_border(points, data, scale.unit(guarded), noise, parameters)
        chosen = Chosen(border)
    sides = [np.ones(len(points), dtype=bool)]
    if chosen.border is not None:
        sides = [chosen.border.side(points) == number for number in (0, 1)]
    pieces = tuple(
        _piece(
            data, noise, side, chosen.shapes[k] if chosen.shapes else None, _unit_of(chosen.border, k, guarded, scale)
        )
        for k, side in enumerate(sides)
    )
    return Surrogate(
        f1_hz=responses[0].f1_hz,
        nu_hz=nu_hz,
        region=region,
        points=points,
        scale=scale,
        pieces=pieces,
        border=chosen.border,
        suspected=suspected,
        terminal=_terminal(responses, data.x),
        meta={**_common_facts(responses), "bases": dict(bases or {})},
    )


def _unit_of(border: Border | None, number: int, points: np.ndarray, scale: Scale) -> np.ndarray:
    """Of points (p, d) of the region those on one side of the border, in the unit box."""
    own = points if border is None else points[border.side(points) == number]
    return scale.unit(own if len(own) else points)


def _piece(
    data: Data, noise: np.ndarray | None, side: np.ndarray, shapes: Sequence[Shape] | None, region: np.ndarray
) -> Piece | Cautious:
    """The model of the sweeps on one side."""
    own = Data(data.x[side], data.y[:, side], data.weight[:, side])
    if shapes is None:
        every = np.linspace(0, len(data.y) - 1, min(DECIDING, len(data.y))).round().astype(int)
        shapes = choose_shapes(Data(own.x, own.y[every], own.weight[every]), region)
    fitted = tuple(fit_shape(own, shape) for shape in shapes)
    models = tuple(model for model in fitted if np.isfinite(model.score)) or fitted
    return piece_of(models, own, None if noise is None else noise[:, side])


# From a table --------------------------------------------------------------------------------------------------------


def _data_of(responses: Sequence[FrequencyResponse], x: np.ndarray) -> tuple[np.ndarray, Data, np.ndarray | None]:
    """Frequencies that most sweeps share, the sweeps at them, and the rows' relative variance where it is known."""
    folded = [to_dq(response) for response in responses]
    nu_hz = _shared([data.nu_hz for data in folded])
    shape = (len(nu_hz), len(folded))
    y, weight, noise = np.zeros((*shape, ELEMENTS), dtype=complex), np.zeros(shape), np.zeros(shape)
    for j, data in enumerate(folded):
        at = np.abs(data.nu_hz[None] - nu_hz[:, None]).argmin(axis=1)
        there = np.abs(data.nu_hz[at] - nu_hz) <= _SAME * nu_hz
        y[there, j] = data.y[at[there]].reshape(-1, ELEMENTS)
        size = np.linalg.norm(data.y[at], axis=(1, 2))
        weight[there, j] = 1.0 / size[there]
        if data.covariance is not None:
            noise[there, j] = (np.einsum("nii->n", data.covariance[at]) / size**2)[there]
    known = all(data.covariance is not None for data in folded)
    return nu_hz, Data(x, y, weight), noise if known else None


def _shared(grids: Sequence[np.ndarray]) -> np.ndarray:
    """Frequencies of the first grid that at least nine in ten of the others have too."""
    everything = np.sort(np.concatenate(grids))
    first = np.concatenate([[True], np.diff(everything) > _SAME * everything[1:]])
    start = np.flatnonzero(first)
    count = np.diff(np.append(start, len(everything)))
    shared = everything[start][count >= 0.9 * len(grids)]
    if len(shared) == 0:
        raise SurrogateError("the operating points share no frequencies: sweep them all on one grid of frequencies")
    return np.asarray(shared)


def _terminal(responses: Sequence[FrequencyResponse], x: np.ndarray) -> Fitted | None:
    """The fundamental current at the PCC over operating points, where every one was measured."""
    facts = [response.meta.get("fundamental") or {} for response in responses]
    if not all(facts):
        return None
    current = np.array([-f["current_a"] * np.exp(1j * f["current_angle_rad"]) for f in facts])
    y = np.zeros((1, len(x), ELEMENTS), dtype=complex)
    y[0, :, 0] = current
    data = Data(x, y, np.full((1, len(x)), 1.0 / max(np.abs(current).max(), 1e-30)))
    return fit_shape(data, choose_shapes(data, x)[0])


def _common_facts(responses: Sequence[FrequencyResponse]) -> dict[str, Any]:
    """What all operating points agree on: where the device was seen to be stable, the slowest bound of its growth."""
    facts = [response.meta.get("stable_on") or {} for response in responses]
    if not all(facts) or any(fact["grid"] != facts[0]["grid"] for fact in facts):
        return {}
    bounds = [fact.get("growth_bound_per_s") for fact in facts]
    known = [float(b) for b in bounds if b is not None]
    bound = max(known) if len(known) == len(bounds) else None
    return {"stable_on": {**facts[0], "growth_bound_per_s": bound}}


__all__ = ["AXES", "Evaluation", "Index", "Region", "Surrogate", "SurrogateError", "build_surrogate", "name_of"]
