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
from .pairs import Pair, eigenvalues, inverse, product
from .system import PASSED_RAD_S, System

MAX_STEP_DEG = 40.0
"""A step is halved until no eigenvalue of the ratio turns further than this."""

_MOST = 20000
_CLOSE = 0.25  # of its width: places nearer than that to one that is looked at tell nothing more
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


class Chain(NamedTuple):
    """A product of determinants: its matrices at |f - f1| (n,), the matrices of a step, and their signed angles (n, k).

    Angles of the determinants below the line are negative.
    """

    at: Callable[[np.ndarray], np.ndarray]
    ratio: Callable[[np.ndarray, np.ndarray], np.ndarray]
    angles: Callable[[np.ndarray], np.ndarray]


def follow(system: System, poles: np.ndarray) -> Followed:
    """Follow the determinant; closed-loop ``poles`` and all other modes tell where to look first.

    On a radial network it is a product of determinants of 2x2 matrices, each followed by itself.
    """
    nu = _seeds(system, poles)
    if system.tree is not None:
        found = _followed(Chain(system.tree_factors, _tree_ratio, _tree_angles), nu)
        if found.trusted:
            return found
    return _followed(Chain(system.loop, np.linalg.solve, lambda m: np.angle(np.linalg.eigvals(m))), nu)


def unstable_by(system: System, locus: Followed) -> int | None:
    """Unstable modes by the locus; the other half of the axis is its conjugate, so that a turn counts twice.

    None where the locus is not trusted, or a device's own modes are not known.
    """
    if not locus.trusted or any(unit.n_unstable is None for unit in system.units):
        return None
    return sum(unit.count * (unit.n_unstable or 0) for unit in system.units) - round(2.0 * locus.total)


def unstable_behind(system: System) -> int | None:
    """Unstable modes of a radial farm on an ideal source at its root, by the turns of all factors but the root's."""
    chain = Chain(lambda nu: system.tree_factors(nu)[:, :-1], _tree_ratio, _tree_angles)
    return unstable_by(system, _followed(chain, _seeds(system, np.zeros(0, dtype=complex))))


def _tree_ratio(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    step = product(inverse(Pair(*np.moveaxis(here[..., :4], -1, 0))), Pair(*np.moveaxis(there[..., :4], -1, 0)))
    alone = there[..., 4:] / here[..., 4:]
    return np.stack([*step, alone[..., 0], alone[..., 1]], -1)


def _tree_angles(matrices: np.ndarray) -> np.ndarray:
    first, second = eigenvalues(Pair(*np.moveaxis(matrices[..., :4], -1, 0)))
    signed = [np.angle(first), np.angle(second), -np.angle(matrices[..., 4]), -np.angle(matrices[..., 5])]
    return np.concatenate(signed, axis=1)


def _followed(chain: Chain, nu: np.ndarray) -> Followed:
    """Follow a product of determinants, refined until no step is wide."""
    matrices = _evaluated(chain.at, nu)
    turned, widest = _steps_between(chain, matrices[:-1], matrices[1:])
    while True:
        wide = np.flatnonzero((widest > np.radians(MAX_STEP_DEG)) & (np.diff(nu) > 1e-10 * np.maximum(1.0, nu[1:])))
        if len(wide) == 0 or len(nu) + len(wide) > _MOST:
            break
        middle = (nu[wide] + nu[wide + 1]) / 2.0
        between = _evaluated(chain.at, middle)
        before = _steps_between(chain, matrices[wide], between)
        after = _steps_between(chain, between, matrices[wide + 1])
        turned, widest = (_split(old, wide, *new) for old, *new in zip((turned, widest), before, after, strict=True))
        matrices = np.insert(matrices, wide + 1, between, axis=0)
        nu = np.insert(nu, wide + 1, middle)
    turns = np.concatenate([[0.0], np.cumsum(turned)]) / (2.0 * np.pi)
    closing = -float(chain.angles(matrices[-1:]).sum())
    trusted = bool(widest.max(initial=0.0) <= np.radians(MAX_STEP_DEG))
    return Followed(nu, turns, closing / (2.0 * np.pi), trusted)


def _split(old: np.ndarray, at: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Values of steps, those at ``at`` replaced by two each."""
    replaced = old.copy()
    replaced[at] = before
    return np.insert(replaced, at + 1, after)


def _seeds(system: System, poles: np.ndarray) -> np.ndarray:
    models = {id(unit.model): unit.model for unit in system.units}.values()
    modes = np.concatenate([poles, system.network_modes, *(model.poles for model in models)])
    past = system.axis_rad_s[:, None] + PASSED_RAD_S * np.cos(np.linspace(0.0, np.pi, 13))
    near_f1 = system.f1_hz * np.array([0.98, 1.0, 1.02])
    fixed = [past.ravel() / (2.0 * np.pi), near_f1, *(model.nu_hz for model in models)]
    seeds = np.concatenate([*fixed, _thinned(modes)])
    inside = seeds[(seeds > 0.0) & (seeds < system.end_hz)]
    return np.unique(np.concatenate([[0.0, system.end_hz], inside]))


def _thinned(modes: np.ndarray) -> np.ndarray:
    """|f - f1| (Hz) about modes (m,) in rad/s, without places that have a kept one within `_CLOSE` of their width.

    Many devices have as many modes in one place; looked at once, they are seen as well. Widths count as powers of two.
    """
    nu_hz = about(modes)
    width_hz = np.repeat(np.abs(modes.real), len(nu_hz) // max(len(modes), 1)) / (2.0 * np.pi)
    cell = 2.0 ** np.floor(np.log2(np.maximum(_CLOSE * width_hz, 1e-9)))
    _, first = np.unique(np.stack([cell, np.round(nu_hz / cell)]), axis=1, return_index=True)
    return np.asarray(nu_hz[first])


def _evaluated(matrices_at: Callable[[np.ndarray], np.ndarray], nu_hz: np.ndarray) -> np.ndarray:
    parts = [matrices_at(nu_hz[k : k + _AT_ONCE]) for k in range(0, len(nu_hz), _AT_ONCE)]
    return np.concatenate(parts)


def _steps_between(chain: Chain, here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n,) that every step turns the product by, and the widest of its eigenvalues' angles."""
    if len(here) == 0:
        return np.zeros(0), np.zeros(0)
    angles = chain.angles(chain.ratio(here, there))
    return angles.sum(axis=1), np.abs(angles).max(axis=1)
