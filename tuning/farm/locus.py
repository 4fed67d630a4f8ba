"""The turns of det(1 + Y Z) over all terminals, followed so that equal devices cannot hide whole turns.

The determinant of many terminals is a product of many factors, and n equal devices turn it by n times the angle of one:
a step of the product may be whole turns longer than it looks. So the ratio of neighbouring matrices M(a)^-1 M(b) is
followed instead. Its eigenvalues stay near one, and the angle of a step is the sum of their angles, each unmistakable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..winding import about
from .system import PASSED_RAD_S, System

MAX_STEP_DEG = 40.0
"""A step is halved until no eigenvalue of the ratio turns further than this."""

_MOST = 20000
_AT_ONCE = 256  # matrices evaluated together, so that memory stays flat


class Followed(NamedTuple):
    """The half axis from |f - f1| = 0 on.

    Attributes
    ----------
    nu_hz : (n,) float
        Where the matrix was looked at (Hz), up to the band's end.
    turns : (n,) float
        Counter-clockwise turns of the determinant up to there.
    closing : float
        Turns from the band's end to infinity, the loop gain falling off: no eigenvalue of Y Z then passes -1.
    trusted : bool
        Whether every step came below `MAX_STEP_DEG`.
    """

    nu_hz: np.ndarray
    turns: np.ndarray
    closing: float
    trusted: bool

    @property
    def total(self) -> float:
        """Turns of the half axis, a whole or half number."""
        return float(self.turns[-1]) + self.closing


def follow(system: System, poles: np.ndarray) -> Followed:
    """Follow the determinant; closed-loop ``poles`` and all other modes tell where to look first."""
    nu = _seeds(system, poles)
    matrices = _evaluated(system, nu)
    while True:
        turned, widest = _steps(matrices)
        wide = np.flatnonzero((widest > np.radians(MAX_STEP_DEG)) & (np.diff(nu) > 1e-10 * np.maximum(1.0, nu[1:])))
        if len(wide) == 0 or len(nu) + len(wide) > _MOST:
            break
        middle = (nu[wide] + nu[wide + 1]) / 2.0
        matrices = np.insert(matrices, wide + 1, _evaluated(system, middle), axis=0)
        nu = np.insert(nu, wide + 1, middle)
    turns = np.concatenate([[0.0], np.cumsum(turned)]) / (2.0 * np.pi)
    closing = -np.sum(np.angle(np.linalg.eigvals(matrices[-1])))
    trusted = bool(widest.max(initial=0.0) <= np.radians(MAX_STEP_DEG))
    return Followed(nu, turns, float(closing) / (2.0 * np.pi), trusted)


def _seeds(system: System, poles: np.ndarray) -> np.ndarray:
    own = np.concatenate([unit.model.poles for unit in system.units])
    rows = np.concatenate([unit.model.nu_hz for unit in system.units])
    near_f1 = system.f1_hz * np.array([0.98, 1.0, 1.02])
    past = system.axis_rad_s[:, None] + PASSED_RAD_S * np.cos(np.linspace(0.0, np.pi, 13))
    seeds = np.concatenate(
        [past.ravel() / (2.0 * np.pi), about(poles), about(own), about(system.network_modes), rows, near_f1]
    )
    inside = seeds[(seeds > 0.0) & (seeds < system.end_hz)]
    return np.unique(np.concatenate([[0.0, system.end_hz], inside]))


def _evaluated(system: System, nu_hz: np.ndarray) -> np.ndarray:
    parts = [system.loop(nu_hz[k : k + _AT_ONCE]) for k in range(0, len(nu_hz), _AT_ONCE)]
    return np.concatenate(parts)


def _steps(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n - 1,) that every step turns the determinant by, and the widest of its eigenvalues' angles."""
    angles = np.angle(np.linalg.eigvals(np.linalg.solve(matrices[:-1], matrices[1:])))
    return angles.sum(axis=1), np.abs(angles).max(axis=1)
