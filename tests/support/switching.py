"""Devices whose admittance jumps over the operating points: a current limit, a mode switch, and none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.design import first_points, gap_of, next_point
from seqsweep.identify.surrogate.surrogate import AXES, Region, Surrogate, build_surrogate, name_of
from seqsweep.plant.turbine.parameters import TABLE_I, TurbineParameters

from . import oracle
from .regions import U_V

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


def explored(region: Region, rule: Rule, seed: int, most: int, width: float = 0.02) -> Surrogate:
    """A surrogate by the campaign's own choice of points, until a border is located or ``most`` points are swept."""
    responses = [swept(point, rule) for point in first_points(region, seed)]
    while True:
        surrogate = build_surrogate(responses, region=region)
        _, middle = gap_of(surrogate)
        if len(responses) >= most or (surrogate.border is not None and middle is None):
            return surrogate
        responses.append(swept(next_point(surrogate, region)[0] if middle is None else middle, rule))
