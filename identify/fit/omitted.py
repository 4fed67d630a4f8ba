"""What a model of few poles leaves out, as an error of its own: faint modes, and poles that stand for several.

The order is the one that BIC pays for. A mode that gains less than some hundred in chi-squared is left out, and poles
next to each other become one: what is left out moves the other poles, by several times what noise does. So the true Y
is the model, and beside it a sum of terms of unknown size:

- a pair of poles at each of some places over the band, for the modes that are missing;
- 1/(s - p)^2 in each element for each pole of the model whose residue has rank two, which stands for several modes, as
  one alone has rank one: with residues R_i at p + d_i their sum is, to first order, (sum R_i)/(s - p) and
  (sum R_i d_i)/(s - p)^2, and the second matrix need not be a multiple of the first, as it is where one pole moves.

Sizes are normal about zero with one variance for each of the two kinds, relative to Y (a Gaussian process beside the
model: M. C. Kennedy, A. O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63, 2001). Or nothing is
left that would have paid for a parameter of its own, for the order was chosen so: then the effect of a direction that
the rows see sharply is bounded by that charge, while many others may hold as much. Without the bound the few sharp
ones, in which nothing is found, would say that there is nothing in the others.

The variances are not known either. Every pair of them on a logarithmic grid, with and without the bound, counts as much
as the misfit makes it likely (restricted likelihood: what the fit has taken is left aside), so that rows which show
nothing beyond noise still leave room for what noise hides. What the model errs by is the second moment of these terms
about zero, as the model itself stays without them, and what they do to its parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .dq_data import ELEMENTS
from .least_squares import Linear, Problem, Trial, block_diagonal, charge_of_parameter, freedom_of, stacked
from .rational import Omitted, omitted_basis

_PLACES = 8  # pairs over the band
_DAMPING = 0.5  # of each
_LOWEST = 3e-3  # the first pair's place, in bands, where rows are as near to f1
_BAND = 1.5  # poles of the model further out than so many bands are not split
_SIZES = np.geomspace(1e-2, 1e6, 25)  # variance of the sizes against that of noise, in the sharpest direction
_WITHIN = 1e4  # with the bound, sizes up to this: where all directions are at it the misfit says no more of sizes
_RATIOS = (0.3, 1.0, 3.0, 10.0)  # size of split poles, in that of missing modes
_REGULAR = 1e-10  # directions of the sizes that the misfit shows less of, in the largest, are not seen


class _Seen(NamedTuple):
    """What the misfit shows of the terms.

    ``axes`` (q, j) are directions of their sizes, each of unit effect on the rows, and ``found`` (j,) what was found of
    them; ``effect`` (j,) is the squared effect of a size of one, ``rest`` the sum of squares in no direction, and
    ``freedom`` the number of weighted data less that of the fit's parameters.
    """

    axes: np.ndarray
    effect: np.ndarray
    found: np.ndarray
    rest: float
    freedom: int


def with_cut(omitted: Omitted, lost: np.ndarray) -> Omitted:
    """One term more: coefficients ``lost`` (4, c) that the cut of ranks took, which may be more than noise."""
    of_fit = np.append(np.zeros(len(omitted.by_fit) - lost.size), lost)
    return omitted._replace(
        by_fit=np.append(omitted.by_fit, of_fit[:, None], axis=1),
        coefficients=np.append(omitted.coefficients, np.zeros((len(omitted.coefficients), 1)), axis=1),
    )


def beside_the_model(
    problem: Problem, trial: Trial, linear: Linear, ranks: np.ndarray, response: np.ndarray, directions: np.ndarray
) -> Omitted:
    """Terms beside the model, and what they do to its parameters.

    ``directions`` (4, 2n, k) are orthonormal, and ``response`` (k, k) is what noise along them does to the parameters.
    """
    none = np.zeros((0, 0))
    several = (ranks[: len(trial.poles)] > 1) & (np.abs(trial.poles) < _BAND * abs(problem.s[-1]))
    split = trial.poles[several]
    terms = Omitted(_places(problem), split, none, none)
    rows = omitted_basis(terms, problem.s)
    size = np.sqrt(np.sum(np.abs(problem.y) ** 2, axis=0) / ELEMENTS)
    scale = 1.0 / np.max(np.abs(rows) / size[:, None], axis=0)
    columns = stacked((rows * scale) * problem.weight[:, :, None])
    taken = np.concatenate(list(np.swapaxes(directions, 1, 2) @ columns), axis=1)
    gram = block_diagonal(np.swapaxes(columns, 1, 2) @ columns) - taken.T @ taken
    left = linear.misfit - directions @ np.tensordot(directions, linear.misfit, axes=([0, 1], [0, 1]))
    shown = np.einsum("enj,en->ej", columns, left).ravel()
    freedom = max(freedom_of(trial, linear), ELEMENTS)
    is_split = np.tile(np.arange(len(scale)) >= 2 * len(terms.poles), ELEMENTS)
    most = charge_of_parameter(problem) / 3.0  # the variance of an effect that is anywhere up to its charge
    root = _sizes(gram, shown, is_split, linear.cost, freedom, most)
    return terms._replace(by_fit=response @ (taken @ root), coefficients=-np.tile(scale, ELEMENTS)[:, None] * root)


def _places(problem: Problem) -> np.ndarray:
    """Upper poles (8,) of the pairs (rad/s), from the lowest rows to a little beyond the band."""
    end = abs(problem.s[-1])
    sizes = np.geomspace(max(_LOWEST * end, 0.5 * abs(problem.s[0])), 1.3 * end, _PLACES)
    return sizes * complex(-_DAMPING, (1.0 - _DAMPING**2) ** 0.5)


def _sizes(
    gram: np.ndarray, shown: np.ndarray, is_split: np.ndarray, cost: float, freedom: int, most: float
) -> np.ndarray:
    """Root (q, q) of the second moment of the terms' sizes about zero, over all ratios of the two kinds."""
    roots, chances = [], []
    for ratio in _RATIOS:
        unit = np.where(is_split, ratio, 1.0)
        seen = _seen(unit[:, None] * gram * unit, unit * shown, cost, freedom)
        root, chance = _second_moment(seen, most)
        roots.append(unit[:, None] * (seen.axes @ root))
        chances.append(chance)
    share = np.exp(np.array(chances) - max(chances))
    share = np.sqrt(share / np.sum(share))
    every = np.concatenate([part * root for part, root in zip(share, roots, strict=True)], axis=1)
    triangle = np.asarray(np.linalg.qr(every.T, mode="r"))
    return np.asarray(np.where(np.diag(triangle) < 0.0, -1.0, 1.0) * triangle.T)  # unique, whatever the eigenvectors


def _seen(gram: np.ndarray, shown: np.ndarray, cost: float, freedom: int) -> _Seen:
    """Directions that the rows see, the others of which the fit's own parameters make up for."""
    effect, axes = np.linalg.eigh(gram)
    clear = effect > _REGULAR * effect[-1]
    effect, axes = effect[clear], axes[:, clear] / np.sqrt(effect[clear])
    found = axes.T @ shown
    return _Seen(axes, effect, found, max(cost - float(found @ found), _REGULAR * cost), freedom)


def _second_moment(seen: _Seen, most: float) -> tuple[np.ndarray, float]:
    """Root (j, k) of the sizes' second moment about zero, along directions of unit effect, and the log likelihood.

    An effect may have any variance, in that of noise, or none above ``most``.
    """
    free = (_SIZES / seen.effect[-1])[:, None] * seen.effect
    damped = 1.0 + np.concatenate([free, (free / (1.0 + free / most))[_SIZES <= _WITHIN]])
    variance = (seen.rest + np.sum(seen.found**2 / damped, axis=1)) / seen.freedom
    chance = -0.5 * (seen.freedom * np.log(variance) + np.sum(np.log(damped), axis=1))
    share = np.exp(chance - chance.max())
    likely = float(np.log(np.sum(share)) + chance.max())
    share = share / np.sum(share)
    known = 1.0 - 1.0 / damped
    mean = known * seen.found
    around = np.diag(np.sqrt((share * variance) @ known))
    return np.concatenate([around, (np.sqrt(share)[:, None] * mean).T], axis=1), likely
