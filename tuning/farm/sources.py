"""One farm on many source impedances: the farm is reduced to its source's bus once, every source is judged on that.

Closing the farm's admittance Y over a source Z makes the modes zeros of det(1 + Y Z). Its poles, the modes of the farm
on an ideal source, are the same for every Z: how many modes are unstable on Z is therefore how many are on a reference
source, where the whole farm was judged, plus the difference of the turns. Internal modes are counted by that as well.
The modes themselves are sought by Newton's method on the exact farm, for all sources at once, from where a rational
model of the whole has them; where they do not say the count that the locus does, the whole pencil judges the source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import erfc, sqrt
from typing import Literal

import numpy as np

from ...identify.fit.model import fit_response
from ...identify.fit.rational import RationalModel
from ..poles import EDGE, RESONANCE_FROM_HZ, closed_loop_poles
from ..probability import DECIDED
from ..siso import SeriesRL
from ..winding import about
from .entries import FarmEntry
from .farm import Farm, judged_with, seen_from_source
from .pairs import Pair, determinant, diagonal, eigenvalues, inverse, product, to_dq
from .tree import Tree, reduced, tree_behind_source

_STEP = 1e-6
_SAME = 1e-4  # rad/s: two roots closer are one
_FITTED = 140  # frequencies of the rational model of the whole
_TRACKED = 4  # modes that are sought on every source
_POLISH = 3  # steps of Newton's method on the exact farm
_NEAR = 0.02  # relative distance from the model's mode within which the exact one is expected
_AT_ONCE = 64  # sources followed together, so that memory stays flat
_FURTHER = 2.0 ** np.arange(-3, 4)  # band of the locus about each seed, in widths


@dataclass(frozen=True, slots=True)
class OnSource:
    """The farm on one source.

    Attributes
    ----------
    z_ohm : complex
        The source's impedance at f1.
    verdict : "stable", "unstable" or "undecided"
        What locus and modes say.
    probability : float or None
        Of being stable.
    n_unstable : int or None
        By the locus.
    pole : complex or None
        The mode with the largest real part (rad/s, dq).
    std : float
        Standard error of its real part (1/s).
    whole : bool
        Whether the whole pencil had to be solved.
    """

    z_ohm: complex
    verdict: Literal["stable", "unstable", "undecided"]
    probability: float | None
    n_unstable: int | None
    pole: complex | None
    std: float
    whole: bool


def judge_sources(farm: Farm, z_ohm: Sequence[complex]) -> tuple[OnSource, ...]:
    """A farm, judged on its own source, on other sources; its operating point is held.

    Parameters
    ----------
    farm : Farm
        Radial, with every device's own unstable modes known.
    z_ohm : sequence of complex
        Impedances of the source at f1 (ohm).

    Raises
    ------
    FarmError
        If the network has a loop.
    """
    tree = tree_behind_source(farm.entry)
    z = np.asarray(z_ohm, dtype=complex)
    poles = _modes(farm, tree, z)
    counts = _counts(farm, tree, z, poles)
    std = _errors(farm, tree, z, poles)
    return tuple(_one(farm, *parts) for parts in zip(z, counts, poles, std, strict=True))


def _source(entry: FarmEntry, z_ohm: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Z (ohm): R + s L + j X for v_d + j v_q and R + s L - j X for v_d - j v_q."""
    own, x = z_ohm.real + s * z_ohm.imag / (2.0 * np.pi * entry.f1_hz), z_ohm.imag
    return own + 1j * x, own - 1j * x


def _closed(entry: FarmEntry, y: Pair, z_ohm: np.ndarray, s: np.ndarray) -> Pair:
    """1 + Y Z; all of one shape, or broadcast."""
    one, other = _source(entry, z_ohm, s)
    return Pair(1.0 + y.pp * one, y.pn * other, y.np * one, 1.0 + y.nn * other)


# The modes -----------------------------------------------------------------------------------------------------------


def _modes(farm: Farm, tree: Tree, z_ohm: np.ndarray) -> np.ndarray:
    """(g, m) the rightmost oscillating modes on every source, NaN where there are fewer."""
    model = fit_response(seen_from_source(farm, farm.entry.f1_hz + np.geomspace(0.3, farm.system.end_hz, _FITTED)))
    rough = np.array([_rough(model, z, farm) for z in z_ohm])
    s = rough.copy()
    for _ in range(_POLISH):
        s = s - _newton_step(farm, tree, z_ohm, s)
    step = _newton_step(farm, tree, z_ohm, s)
    return np.where((np.abs(step) < _SAME) & (np.abs(s - rough) < _NEAR * np.abs(rough)), s - step, np.nan)


def _rough(model: RationalModel, z_ohm: complex, farm: Farm) -> np.ndarray:
    """Modes of a rational model of the whole farm on one source: where the exact ones are sought."""
    poles = closed_loop_poles(model, SeriesRL(z_ohm.real, z_ohm.imag, farm.entry.f1_hz))
    low, high = 2.0 * np.pi * RESONANCE_FROM_HZ, 2.0 * np.pi * EDGE * farm.system.end_hz
    upper = poles[(poles.imag > low) & (poles.imag < high)]
    chosen = upper[np.argsort(-upper.real)][:_TRACKED]
    return np.append(chosen, np.full(_TRACKED - len(chosen), np.nan))


def _newton_step(farm: Farm, tree: Tree, z_ohm: np.ndarray, s: np.ndarray) -> np.ndarray:
    """det(1 + Y Z) over its slope at s (g, m), the slope by a difference in the complex plane; NaN stays."""
    z = np.repeat(z_ohm, s.shape[1])
    flat, step = s.ravel(), np.full(s.size, np.nan + 0j)
    live = np.flatnonzero(np.isfinite(flat))
    h = _STEP * np.abs(flat[live])
    here, ahead = (_determinant(farm, tree, z[live], flat[live] + k * h) for k in (0.0, 1.0))
    step[live] = here * h / (ahead - here)
    return step.reshape(s.shape)


def _determinant(farm: Farm, tree: Tree, z_ohm: np.ndarray, s: np.ndarray) -> np.ndarray:
    return determinant(_closed(farm.entry, reduced(tree, s, farm.system.by_bus(s)).y, z_ohm, s))


# The count -----------------------------------------------------------------------------------------------------------


def _counts(farm: Farm, tree: Tree, z_ohm: np.ndarray, poles: np.ndarray) -> list[int | None]:
    """Unstable modes on every source by the turns, against those on the farm's own; None where they cannot be told."""
    known = farm.judgement.n_unstable_locus
    if known is None:
        return [None] * len(z_ohm)
    nu = _contour(farm)
    own, *turns = _on(farm, tree, nu, np.append(farm.entry.source_z_ohm, z_ohm))
    for k in np.flatnonzero(np.isnan(turns)):  # a mode beside the axis, between two points
        closer = about(poles[k][np.isfinite(poles[k])])
        (turns[k],) = _on(farm, tree, np.unique(np.append(nu, closer[closer < nu[-1]])), z_ohm[k : k + 1])
    return [None if np.isnan(t) else known - round(2.0 * (t - own)) for t in turns]


def _on(farm: Farm, tree: Tree, nu_hz: np.ndarray, z_ohm: np.ndarray) -> np.ndarray:
    s = farm.system.contour(nu_hz)
    return _turns(farm, reduced(tree, s, farm.system.by_bus(s)).y, s, z_ohm)


def _turns(farm: Farm, y: Pair, s: np.ndarray, z_ohm: np.ndarray) -> np.ndarray:
    """(g,) turns of det(1 + Y Z) over the half axis, closed at its end; NaN where a step is too wide to be told."""
    found = [_turned(farm, y, s, z_ohm[k : k + _AT_ONCE]) for k in range(0, len(z_ohm), _AT_ONCE)]
    return np.concatenate([*found, np.empty(0)])


def _turned(farm: Farm, y: Pair, s: np.ndarray, z_ohm: np.ndarray) -> np.ndarray:
    m = _closed(farm.entry, y, z_ohm[:, None], s)
    here, there = (Pair(*(x[:, part] for x in m)) for part in (slice(None, -1), slice(1, None)))
    steps = _angles(product(inverse(here), there))
    closing = _angles(Pair(*(x[:, -1] for x in m))).sum(axis=0)
    turns = (steps.sum(axis=(0, 2)) - closing) / (2.0 * np.pi)
    return np.where(np.abs(steps).max(axis=(0, 2)) > 0.9 * np.pi, np.nan, turns)


def _angles(m: Pair) -> np.ndarray:
    """(2, ...) of both eigenvalues."""
    return np.angle(np.stack(eigenvalues(m)))


def _contour(farm: Farm) -> np.ndarray:
    """|f - f1| (Hz) of the half axis: where the farm's own locus was followed, and more about every mode."""
    poles = np.array([mode.pole for mode in farm.judgement.modes])
    more = [about(poles.real * width + 1j * poles.imag * shift) for width in _FURTHER for shift in (0.8, 1.0, 1.2)]
    dense = np.geomspace(0.05, farm.system.end_hz, 300)
    nu = np.concatenate([farm.judgement.turns_hz, dense, *more])
    return np.unique(nu[(nu >= 0.0) & (nu <= farm.system.end_hz)])


# Errors and verdicts -------------------------------------------------------------------------------------------------


def _errors(farm: Farm, tree: Tree, z_ohm: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """(g,) standard error of the real part of each source's rightmost mode; errors add over tables."""
    at = _rightmost(poles)
    s, there = poles[np.arange(len(z_ohm)), at], np.isfinite(poles[np.arange(len(z_ohm)), at])
    std = np.full(len(z_ohm), np.nan)
    if not np.any(there):
        return std
    s, z = s[there], z_ohm[there]
    seen = reduced(tree, s, farm.system.by_bus(s), with_ways=True)
    behind = to_dq(diagonal(*_source(farm.entry, z, s)))
    u, _, vh = np.linalg.svd(to_dq(_closed(farm.entry, seen.y, z, s)))
    left, right = u[:, :, 1].conj(), (behind @ vh[:, 1].conj()[:, :, None])[:, :, 0]
    slope = np.einsum("ni,nij,nj->n", left, _matrix_slope(farm, tree, z, s), vh[:, 1].conj())
    weights: dict[str, np.ndarray] = {}
    for unit in farm.system.units:
        l = np.einsum("ni,nij->nj", left, to_dq(seen.left[unit.bus])) @ unit.turn  # noqa: E741
        r = np.einsum("nij,nj->ni", to_dq(seen.right[unit.bus]), right) @ unit.turn
        weight = -unit.factor * l[:, :, None] * r[:, None, :] / slope[:, None, None]
        weights[unit.key] = weights.get(unit.key, 0.0) + weight
    std[there] = np.linalg.norm(farm.system.errors(s, weights).real, axis=1)
    return std


def _matrix_slope(farm: Farm, tree: Tree, z_ohm: np.ndarray, s: np.ndarray) -> np.ndarray:
    h = _STEP * np.abs(s)
    at = [s + sign * h for sign in (1.0, -1.0)]
    ahead, behind = (to_dq(_closed(farm.entry, reduced(tree, x, farm.system.by_bus(x)).y, z_ohm, x)) for x in at)
    return (ahead - behind) / (2.0 * h)[:, None, None]


def _rightmost(poles: np.ndarray) -> np.ndarray:
    return np.argmax(np.where(np.isfinite(poles), poles.real, -np.inf), axis=1)


def _one(farm: Farm, z_ohm: complex, count: int | None, poles: np.ndarray, std: float) -> OnSource:
    roots = poles[np.isfinite(poles) & (poles.imag > 0.0)]
    distinct = [pole for k, pole in enumerate(roots) if np.all(np.abs(roots[:k] - pole) > _SAME)]
    unstable = 2 * sum(pole.real > 0.0 for pole in distinct)
    if count is None or count < 0 or unstable != count:
        return _whole(farm, z_ohm)
    pole = max(distinct, key=lambda pole: pole.real)
    chance = 0.5 * erfc(pole.real / (sqrt(2.0) * max(std, 1e-12)))
    if max(chance, 1.0 - chance) < DECIDED:
        return OnSource(z_ohm, "undecided", chance, count, pole, std, False)
    return OnSource(z_ohm, "unstable" if count else "stable", chance, count, pole, std, False)


def _whole(farm: Farm, z_ohm: complex) -> OnSource:
    """By the whole pencil and the locus over all terminals."""
    entry = with_source(farm.entry, z_ohm)
    found = judged_with(entry, farm.units, farm.dampers).judgement
    mode = found.critical
    pole, std = (None, 0.0) if mode is None else (mode.pole, mode.std.real)
    return OnSource(z_ohm, found.verdict, found.probability, found.n_unstable_locus, pole, std, True)


def with_source(entry: FarmEntry, z_ohm: complex) -> FarmEntry:
    """The farm on another source impedance, its operating point untouched."""
    *others, source = entry.network.branches
    w1 = 2.0 * np.pi * entry.f1_hz
    branch = replace(source, r_ohm=z_ohm.real, l_h=z_ohm.imag / w1)
    return replace(entry, network=type(entry.network)((*others, branch)), source_z_ohm=z_ohm)
