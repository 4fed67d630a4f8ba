"""The turns of det(1 + Y Z) over all terminals, followed so that equal devices cannot hide whole turns.

The determinant of many terminals is a product of many factors, and n equal devices turn it by n times the angle of one:
a step of the product may be whole turns longer than it looks. So the ratio of neighbouring matrices M(a)^-1 M(b) is
followed instead. Its eigenvalues stay near one, and the angle of a step is the sum of their angles, each unmistakable.
"""

from __future__ import annotations

from collections.abc import Callable
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
    """Follow the determinant; closed-loop ``poles`` and all other modes tell where to look first.

    On a radial network it is a product of determinants of 2x2 matrices, each followed by itself.
    """
    nu = _seeds(system, poles)
    if system.tree is not None:
        found = _followed(lambda at: system.tree_factors(at), nu)
        if found.trusted:
            return found
    return _followed(lambda at: system.loop(at)[:, None, None], nu)


def _followed(matrices_at: Callable[[np.ndarray], np.ndarray], nu: np.ndarray) -> Followed:
    """Follow a product of determinants (n, 1 or 2, k, m, m) over one of others, refined until no step is wide."""
    matrices = _evaluated(matrices_at, nu)
    turned, widest = _steps(matrices)
    while True:
        wide = np.flatnonzero((widest > np.radians(MAX_STEP_DEG)) & (np.diff(nu) > 1e-10 * np.maximum(1.0, nu[1:])))
        if len(wide) == 0 or len(nu) + len(wide) > _MOST:
            break
        middle = (nu[wide] + nu[wide + 1]) / 2.0
        between = _evaluated(matrices_at, middle)
        before, after = _steps_between(matrices[wide], between), _steps_between(between, matrices[wide + 1])
        turned, widest = (_split(old, wide, *new) for old, *new in zip((turned, widest), before, after, strict=True))
        matrices = np.insert(matrices, wide + 1, between, axis=0)
        nu = np.insert(nu, wide + 1, middle)
    turns = np.concatenate([[0.0], np.cumsum(turned)]) / (2.0 * np.pi)
    closing = -float(_signed(np.angle(np.linalg.eigvals(matrices[-1:])))[0])
    trusted = bool(widest.max(initial=0.0) <= np.radians(MAX_STEP_DEG))
    return Followed(nu, turns, closing / (2.0 * np.pi), trusted)


def _split(old: np.ndarray, at: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Values of steps, those at ``at`` replaced by two each."""
    replaced = old.copy()
    replaced[at] = before
    return np.insert(replaced, at + 1, after)


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


def _evaluated(matrices_at: Callable[[np.ndarray], np.ndarray], nu_hz: np.ndarray) -> np.ndarray:
    parts = [matrices_at(nu_hz[k : k + _AT_ONCE]) for k in range(0, len(nu_hz), _AT_ONCE)]
    return np.concatenate(parts)


def _steps(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _steps_between(matrices[:-1], matrices[1:])


def _steps_between(here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n,) that every step turns the product by, and the widest of its eigenvalues' angles."""
    angles = np.angle(np.linalg.eigvals(np.linalg.solve(here, there)))
    return _signed(angles), np.abs(angles).max(axis=(1, 2, 3))


def _signed(angles: np.ndarray) -> np.ndarray:
    """(n,) sums of angles (n, 1 or 2, k, m): those of the first product less those of the second."""
    sums = angles.sum(axis=(2, 3))
    return np.asarray(sums[:, 0] - sums[:, 1] if sums.shape[1] > 1 else sums[:, 0])
