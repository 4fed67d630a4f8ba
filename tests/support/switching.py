"""Devices whose admittance jumps over the operating points: a current limit, a mode switch, and none."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.design import WIDTH, first_points, gap_of, next_point
from seqsweep.identify.surrogate.surrogate import AXES, Region, Surrogate, build_surrogate, name_of
from seqsweep.plant.turbine.parameters import TABLE_I, TurbineParameters

from . import oracle
from .regions import U_V, unseen

F_HZ = 50.0 + np.logspace(0.0, np.log10(950.0), 16)

Rule = Callable[[np.ndarray], TurbineParameters]
"""The parameters that the device works with at an operating point."""


def limited(limit: float) -> Rule:
    """Above a current of ``limit`` (MVA/pu) the DC voltage control has no say."""
    frozen = TABLE_I._replace(k_dcp=0.02, k_dci=0.05)
    return lambda point: frozen if np.hypot(point[0], point[1]) / point[2] >= limit else TABLE_I


def switched(axis: int, at: float) -> Rule:
    """Above ``at`` along an axis of the operating point the current control and the PLL are other ones."""
    other = TABLE_I._replace(k_p=0.16, k_i=200.0, k_pp=0.05)
    return lambda point: other if point[axis] >= at else TABLE_I


def smooth(random: np.random.Generator) -> Rule:
    """One device, its gains drawn."""
    gains = {key: getattr(TABLE_I, key) * random.uniform(0.6, 1.5) for key in ("k_p", "k_i", "k_pp", "k_dcp")}
    own = TABLE_I._replace(**gains)
    return lambda point: own


def swept(point: np.ndarray, rule: Rule, noise: float = 1e-6) -> FrequencyResponse:
    """The device at an operating point."""
    y = oracle.admittance_pn(F_HZ, point[0] * 1e6, point[2] * U_V, rule(point), q_var=point[1] * 1e6)
    random = np.random.default_rng(np.frombuffer(np.asarray(point).tobytes(), dtype=np.uint32))
    size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
    errors = random.normal(size=(2, *y.shape))
    y = y + noise * size / np.sqrt(8.0) * (errors[0] + 1j * errors[1])
    meta = {"op_id": name_of(point), **dict(zip(AXES, map(float, point), strict=True))}
    return FrequencyResponse(F_HZ, y, 50.0, covariance=(noise**2 / 8.0 * size**2) * np.eye(8), meta=meta)


def explored(region: Region, rule: Rule, seed: int, most: int) -> Surrogate:
    """A surrogate by the campaign's own choice of points, until a border is located or ``most`` points are swept."""
    responses = [swept(point, rule) for point in first_points(region, seed)]
    while True:
        surrogate = build_surrogate(responses, region=region)
        _, middle = gap_of(surrogate)
        if len(responses) >= most or (surrogate.border is not None and middle is None):
            return surrogate
        responses.append(swept(next_point(surrogate, region)[0] if middle is None else middle, rule))


KINDS = {"limit": 40, "mode": 40, "smooth": 20}
"""What is placed at random, and the sweeps that a campaign may take of it."""


class Placed(NamedTuple):
    """What a campaign found of one device.

    Attributes
    ----------
    at : float or None
        Where it changes, in the unit of what it changes by; None: nowhere.
    found : str
        The border that was found, in words.
    sweeps : int
        Operating points that were swept.
    wrong : str
        What is wrong with the border; empty where it is right.
    """

    at: float | None
    found: str
    sweeps: int
    wrong: str


def placed(kind: str, region: Region, seed: int, most: int) -> Placed:
    """One random placement of a kind, found by a campaign of at most so many sweeps."""
    rule, at = drawn(kind, region, np.random.default_rng(seed))
    surrogate = explored(region, rule, seed, most)
    return Placed(at, str(surrogate.border), len(surrogate.points), _wrong(surrogate, region, rule, at))


def drawn(kind: str, region: Region, random: np.random.Generator) -> tuple[Rule, float | None]:
    """A device of a kind, and where it changes."""
    if kind == "limit":
        at = float(random.uniform(0.55, 1.1))
        return limited(at), at
    if kind == "smooth":
        return smooth(random), None
    axis = int(random.choice(np.flatnonzero(region.varies)))
    at = float(region.low[axis] + random.uniform(0.3, 0.7) * (region.high - region.low)[axis])
    return switched(axis, at), at


def _wrong(surrogate: Surrogate, region: Region, rule: Rule, at: float | None) -> str:
    """The border tells the right side at every point where it tells one, and leaves no wider gap than asked."""
    border = surrogate.border
    if at is None:
        return "" if border is None else f"a border that is none, {border}"
    if border is None:
        return "no border"
    width = border.width(region.samples(512))
    if width > WIDTH:
        return f"{width} of the range"
    points = unseen(region, 2000, 1)
    side, changed = border.side(points), np.array([rule(point) != TABLE_I for point in points])
    told = side >= 0
    wrong = min(np.sum(side[told] != changed[told]), np.sum(side[told] == changed[told]))
    return f"{wrong} of 2000 points on the wrong side of {border}, it is at {at}" if wrong else ""
