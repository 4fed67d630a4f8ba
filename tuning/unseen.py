"""What may hide between the rows: a mode narrower than their distance that would make a stable loop unstable.

Rows say nothing of what lies between them, but a mode there shows in the rows beside it, by ``|R| / |s - p|``. A mode
with pole p and residue R moves Y by up to ``|R| / |Re p|``, and no change of Y smaller than ``1 / |(Y + Yg)^-1|``
changes the number of unstable modes (small gain). So a mode between two rows matters only if its residue is at least
``|Re p| / |(Y + Yg)^-1|``, and of such residues only those matter that push the mode towards the right: device and grid
have it at ``p - tr(R (Y + Yg)^-1)``. What such a residue would do to the rows is held against what they leave
unexplained: the likelihood of the best such mode, every parameter of the fit moving with it, against the likelihood of
none.

A device that was seen to be stable on a grid, and not on an ideal source, may hide a mode that grows by itself and that
this grid holds. Such a mode matters wherever that grid could hold it, however stiff the grid is on which it is judged.

The narrowest mode looked for is damped by half a per cent, and dies away within seconds: one that lasted longer would
not have come to rest in the runs of the sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..identify.fit.dq_data import ELEMENTS, DqData
from ..identify.fit.order import LASTING, NARROWEST
from ..identify.fit.rational import RationalModel, evaluate, row_slopes
from .siso import Impedance

SHOWN = 24.0
"""Evidence from which on the rows ask for a mode: noise on eight numbers a row hardly ever does."""

EXCLUDED = -9.0
"""Evidence below which they exclude it: three standard errors."""

HARMFUL = 0.06
"""How often a loop is unstable that the fit calls stable and whose rows do not exclude such a mode. Counted: 15 of 259
(`benchmarks/verdicts.py --swept 0`, seeds 501 and 502, 500 tables each), when any residue large enough was taken to
matter, and 8 of 147 since only those do that point the right way (seed 502), however loudly the rows ask for one. Most
of what rows leave open is no mode."""

DENSE = 1.3
"""Neighbouring |f - f1| no further apart than this ratio leave no gap."""

_PLACES = np.array([0.05, 0.2, 0.5, 0.8, 0.95])  # of a mode between two rows
_ENDS = np.array([0.01, 0.125, 0.35, 0.65, 0.875, 1.0])  # of the part of the gap for which each place stands
_AT_A_GLANCE = 200.0  # chi-squared that a mode must cause in the two rows beside it to be excluded without a fit of it
_MOST = 40  # places at which a mode is fitted
_STATED = 0.3  # part of the stated errors below which a misfit is no evidence, as in the fit itself


class Unseen(NamedTuple):
    """The mode between rows that is the hardest to exclude, of those that would change the verdict.

    Attributes
    ----------
    nu_hz : float
        Its |f - f1| (Hz).
    evidence : float
        Twice the log of its likelihood over that of no mode there.
    in_gap : bool
        Whether the rows around it leave a gap.
    """

    nu_hz: float
    evidence: float
    in_gap: bool

    @property
    def excess(self) -> float:
        """Evidence beyond what is let pass: between close rows what noise brings about, in a gap what rows exclude."""
        return self.evidence - (EXCLUDED if self.in_gap else SHOWN)

    @property
    def is_shown(self) -> bool:
        """Whether the rows ask for it; in a gap, whether they do not exclude it."""
        return self.excess > 0.0

    @property
    def harmless(self) -> float:
        """Probability that no such mode is there, 99 % where the evidence is just let pass, or that it does no harm."""
        absent = 1.0 / (1.0 + 0.01 * float(np.exp(min(self.excess, 100.0) / 2.0)))
        return 1.0 - HARMFUL * (1.0 - absent)


class _Places(NamedTuple):
    """Possible modes (g,): |f - f1| (Hz), pole (rad/s), the least residue that matters (S rad/s), whether in a gap, and
    |f - f1| (g, 3) there and at both ends of the part of the gap for which the place stands."""

    nu_hz: np.ndarray
    pole: np.ndarray
    residue: np.ndarray
    in_gap: np.ndarray
    around_hz: np.ndarray


class _Harm(NamedTuple):
    """Residues r (8,) that matter: those with ``push`` (g, k, 8) r of at least ``needed`` (g, k), rad/s, for any k."""

    push: np.ndarray
    needed: np.ndarray


class _Left(NamedTuple):
    """What the fit leaves of the rows: weighted misfits (n, 8), their sum of squares (at least the floor's)."""

    misfit: np.ndarray
    cost: float


def unseen(model: RationalModel, data: DqData, grids: Sequence[Impedance], crowded: np.ndarray) -> Unseen | None:
    """The worst mode that may hide between the rows of ``data``; None where all are excluded at a glance.

    ``grids`` are the one that is judged and, if there is one, the one on which the device was seen to be stable.
    In gaps that are ``crowded`` (n,) by modes of the fit, these take up what a further mode would do to the rows, and
    no glance excludes one. In the hole around f1 the rows have to exclude it; elsewhere they must not ask for it.
    """
    places, left = _places(model, grids), _left(model, data)
    glance, gap = _glance(model, left, places), np.searchsorted(model.nu_hz, places.nu_hz)
    asked = crowded[gap] & (glance >= _AT_A_GLANCE)
    glance = np.where(asked, 0.0, glance)
    places = places._replace(in_gap=places.in_gap & ~(asked & (gap > 0)))
    doubtful = np.argsort(glance)[: min(_MOST, int(np.sum(glance < _AT_A_GLANCE)))]
    if len(doubtful) == 0:
        return None
    places = _Places(*(column[doubtful] for column in places))
    evidence = _evidence(model, left, places, _harm(model, grids, places))
    found = [Unseen(*one) for one in zip(places.nu_hz.tolist(), evidence.tolist(), places.in_gap.tolist(), strict=True)]
    return max(found, key=lambda one: one.excess)


def overruled(model: RationalModel, left_out: DqData, grid: Impedance) -> float | None:
    """|f - f1| (Hz) of a row left out that would change the verdict if it were right; None if there is none."""
    s = 2j * np.pi * left_out.nu_hz
    moved = np.linalg.norm(left_out.y - evaluate(model, s), 2, axis=(1, 2)) * mutual_impedance(model, grid, s)
    return float(left_out.nu_hz[np.argmax(moved)]) if np.any(moved > 1.0) else None


def _places(model: RationalModel, grids: Sequence[Impedance]) -> _Places:
    """Where modes may hide: between rows that are further apart than such a mode is wide."""
    edges = np.append(0.0, model.nu_hz)
    nu = edges[:-1, None] + np.diff(edges)[:, None] * _PLACES
    w = 2.0 * np.pi * nu
    width = np.maximum(NARROWEST * w, LASTING)
    apart = np.where(edges[:-1] > 0.0, np.diff(edges), 2.0 * edges[1])[:, None]
    hides = 2.0 * np.pi * apart > 2.0 * width
    in_gap = np.broadcast_to((edges[1:] > DENSE * edges[:-1])[:, None], nu.shape)
    w, width = w[hides], width[hides]
    shown = np.max([mutual_impedance(model, grid, 1j * w) for grid in grids], axis=0)
    size = np.diff(edges)[:, None, None] * np.stack([_PLACES, _ENDS[:-1], _ENDS[1:]], axis=1)
    around = edges[:-1, None, None] + size
    return _Places(nu[hides], -width + 1j * w, width / shown, in_gap[hides], around[hides])


def mutual_impedance(model: RationalModel, grid: Impedance, s: np.ndarray) -> np.ndarray:
    """|(Y + Yg)^-1| (n,): the impedance (ohm) that device and grid show each other."""
    return _largest(_mutual(model, grid, s))


def _largest(x: np.ndarray) -> np.ndarray:
    """Larger singular value (n,) of matrices (n, 2, 2), in closed form."""
    square, area = np.sum(np.abs(x) ** 2, axis=(1, 2)), np.abs(np.linalg.det(x))
    return np.asarray(np.sqrt((square + np.sqrt(np.maximum(square**2 - 4.0 * area**2, 0.0))) / 2.0))


def _mutual(model: RationalModel, grid: Impedance, s: np.ndarray) -> np.ndarray:
    """(Y + Yg)^-1 (n, 2, 2) in ohm."""
    z = grid.impedance_dq(s)
    return np.asarray(z @ np.linalg.inv(np.eye(2) + evaluate(model, s) @ z))


def _harm(model: RationalModel, grids: Sequence[Impedance], places: _Places) -> _Harm:
    """Which residues make device and grid unstable, or hold on the second grid a mode that grows by itself.

    To first order a mode stands at p - tr(R H), H = (Y + Yg)^-1: it crosses the axis where Re tr(R H) is as large as
    Re p, and of its sign. Nearer to f1 than all rows it may meet its conjugate, and cross as a real one, where
    Re(p* tr(R H)) = |p|^2 / 2; one wider than its distance from f1 is real already. H turns from one place to the next,
    so that it is asked at both ends of the part of the gap as well.
    """
    pushes, needed = [], []
    for grid, sign in zip(grids, (1.0, -1.0), strict=False):  # a mode that decays, and one that grows by itself
        pole = places.pole.real * sign + 1j * places.pole.imag
        for nu_hz in places.around_hz.T:
            mutual = np.swapaxes(_mutual(model, grid, 2j * np.pi * nu_hz), 1, 2).reshape(-1, ELEMENTS)
            for towards, least in (_as_pair(pole), _as_real(pole, places.nu_hz < model.nu_hz[0])):
                along = towards.conj()[:, None] * mutual
                pushes.append(np.stack([along.real, -along.imag], axis=2).reshape(-1, 2 * ELEMENTS))
                needed.append(least)
    return _Harm(np.stack(pushes, axis=1), np.stack(needed, axis=1))


def _as_pair(pole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which way (g,) tr(R H) has to point, and how far (rad/s), for a pair to cross the axis at its own frequency."""
    return np.sign(pole.real) + 0j, np.abs(pole.real)


def _as_real(pole: np.ndarray, may_meet: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for one that crosses at f1; infinitely far where a pair cannot meet there."""
    is_pair = pole.imag > np.abs(pole.real)
    towards = np.where(is_pair, pole / np.abs(pole), np.sign(pole.real))
    return towards, np.where(may_meet, np.abs(pole) / 2.0, np.inf)


def _left(model: RationalModel, data: DqData) -> _Left:
    """Misfits of the fitted rows; a misfit that the fit itself takes for none is lifted to its floor."""
    row = np.arange(len(data.nu_hz)) if len(data.nu_hz) == len(model.nu_hz) else _nearest(data.nu_hz, model.nu_hz)
    apart = (data.y[row] - evaluate(model, 2j * np.pi * model.nu_hz)).reshape(-1, ELEMENTS) * model.weight
    misfit = np.concatenate([apart.real, apart.imag], axis=1)
    floor = _STATED if model.weighting == "covariance" else model.noise_floor
    return _Left(misfit, max(float(np.sum(misfit**2)), misfit.size * floor**2))


def _nearest(nu_hz: np.ndarray, places_hz: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(nu_hz[:, None] - places_hz).argmin(axis=0))


def _glance(model: RationalModel, left: _Left, places: _Places) -> np.ndarray:
    """Chi-squared (g,) that the least mode that matters causes in the two rows beside it, less what these leave open.

    Of its effect the fit takes up the share that its parameters are of the data, and four times that to be sure.
    """
    n, freedom = len(model.nu_hz), _freedom(model, left)
    above = np.searchsorted(model.nu_hz, places.nu_hz)
    beside = np.stack([np.maximum(above - 1, 0), np.minimum(above, n - 1)])
    away = np.abs(2j * np.pi * model.nu_hz[beside] - places.pole)
    effect = np.sum((places.residue / away * model.weight.min(axis=1)[beside]) ** 2, axis=0)
    unexplained = np.sum(left.misfit[beside] ** 2, axis=(0, 2))
    return (0.25 * (freedom / left.misfit.size) ** 2 * effect - unexplained) * freedom / left.cost


def _evidence(model: RationalModel, left: _Left, places: _Places, harm: _Harm) -> np.ndarray:
    """Twice the log likelihood ratio (g,) of the best mode that matters at each place.

    The residue that the rows ask for is estimated with the fit's own parameters free. Where it does not matter, it
    costs likelihood to move it, along the direction that the rows know the least, to where it does.
    """
    taken = _taken(model)
    columns = _columns(model, places.pole)
    columns = columns - taken @ (taken.T @ columns)
    curvature = np.swapaxes(columns, 1, 2) @ columns
    pull = np.einsum("gdr,d->gr", columns, left.misfit.ravel())
    known, axes = np.linalg.eigh(curvature)
    known = np.maximum(known, 1e-12 * known[:, -1:] + 1e-300)
    along = np.einsum("grk,gr->gk", axes, pull)
    gain = np.minimum(np.sum(along**2 / known, axis=1), (1.0 - 1e-9) * left.cost)
    push = harm.push @ axes
    missing = np.maximum(harm.needed - np.einsum("gnk,gk->gn", push, along / known), 0.0)
    move = np.min(missing**2 / np.maximum(np.sum(push**2 / known[:, None, :], axis=2), 1e-300), axis=1)
    return -_freedom(model, left) * np.log((left.cost - gain + move) / left.cost)


def _freedom(model: RationalModel, left: _Left) -> int:
    """Numbers that the rows hold beyond the parameters of the fit."""
    return max(left.misfit.size - len(model.covariance_root), ELEMENTS)


def _taken(model: RationalModel) -> np.ndarray:
    """Orthonormal directions (8 n, k) of the weighted rows in which the fit's parameters move it."""
    jacobian = row_slopes(model)
    size = np.linalg.norm(jacobian, axis=0)
    return np.asarray(np.linalg.qr(jacobian / np.where(size > 0.0, size, 1.0))[0])


def _columns(model: RationalModel, pole: np.ndarray) -> np.ndarray:
    """What real and imaginary parts of the four residues of a pair do to the weighted rows: (g, 8 n, 8)."""
    s = 2j * np.pi * model.nu_hz
    upper, lower = 1.0 / (s - pole[:, None]), 1.0 / (s - pole.conj()[:, None])
    parts = np.stack([upper + lower, 1j * (upper - lower)], axis=2)  # (g, n, 2)
    by_element = np.eye(ELEMENTS)[None, None, :, :, None] * parts[:, :, None, None, :]
    weighted = by_element * model.weight[None, :, :, None, None]
    weighted = np.concatenate([weighted.real, weighted.imag], axis=2)
    return weighted.reshape(len(pole), -1, 2 * ELEMENTS)
