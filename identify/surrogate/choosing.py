"""Which products a sparse rational model is made of: those of the lowest leave-one-out error.

Of every size, so many products in the numerators and so many in the denominator, the best shape found so far is kept.
Products are added to each of them and taken away, one at a time, until none of them changes any more. All shapes of one
size that a step may lead to are fitted at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np

from .index_sets import Index, border, chebyshev_products, tips
from .sparse_rational import ELEMENTS, Data, Shape, try_shapes

MAX_NUMERATOR_DEGREE = 6
MAX_DENOMINATOR_DEGREE = 3

SMALLEST_WITHIN = 1.05
"""The smallest model whose leave-one-out error is within this factor of the least one is taken."""

RIVALS = 5
"""Next best models that are kept: their spread is part of the error."""

GUARD = 0.25
"""|d| over the region may not fall below this part of its least value at the sweeps: a pole would hide between them."""

ENOUGH = 1e-13
"""Left-out error, relative to ||Y||, from which on the arithmetic is all that is left to fit: growing ends."""

_SIZES = 16  # of which the best shape is grown and shrunk
_PASSES = 2  # of fits that only rank shapes; those that are kept are fitted anew


def choose_shapes(data: Data, region: np.ndarray) -> list[Shape]:
    """The best shape and its rivals.

    Parameters
    ----------
    data : Data
        Sweeps at the frequencies that decide (some thirty suffice).
    region : (p, d) float
        Points of the region over which |d| is guarded.

    Returns
    -------
    list of Shape
        Best first; at most ``1 + RIVALS``.

    Notes
    -----
    This is a floating search (Pudil, Novovicova and Kittler, Pattern Recognition Letters 15, 1994) that keeps the best
    shape of every size. A search that follows its last step alone loses good shapes: a product that helps no more
    once others have come stays, and one that gains nothing before its partner has come is never met.
    """
    tried: dict[Shape, float] = {}
    _try(data, _starts(data), tried, region)
    changed: set[Shape] = set()
    while min(tried.values()) > ENOUGH and (new := [s for s in _best_of_sizes(tried) if s not in changed]):
        changed.update(new)
        beside = {near for shape in new for near in (*larger(shape), *smaller(shape)) if _has_freedom(data, near)}
        _try(data, beside, tried, region)
    return _ranked(tried)


def _starts(data: Data) -> list[Shape]:
    """A constant, and where the sweeps allow it a linear numerator over a linear denominator.

    From the constant alone growing may end early: where no index helps alone, though more of them would.
    """
    n_axes = data.x.shape[1]
    constant = Shape(((0,) * n_axes,), ())
    first = tuple(sorted(border(constant.numerator, n_axes, 1)))
    linear = Shape((*constant.numerator, *first), first)
    return [constant, linear] if _has_freedom(data, linear) else [constant]


def _best_of_sizes(tried: dict[Shape, float]) -> list[Shape]:
    """The best shape of every size, for the `_SIZES` sizes that are best."""
    best: dict[tuple[int, int], Shape] = {}
    for shape in _ordered(tried):
        best.setdefault(_size(shape), shape)
    return list(best.values())[:_SIZES]


def larger(shape: Shape) -> list[Shape]:
    """Every shape of one index more."""
    n_axes = len(shape.numerator[0])
    upper = [
        Shape(tuple(sorted((*shape.numerator, i))), shape.denominator)
        for i in border(shape.numerator, n_axes, MAX_NUMERATOR_DEGREE)
    ]
    lower = [
        Shape(shape.numerator, tuple(sorted((*shape.denominator, i))))
        for i in border(shape.denominator, n_axes, MAX_DENOMINATOR_DEGREE)
    ]
    return upper + lower


def smaller(shape: Shape) -> list[Shape]:
    """Every shape of one index less."""
    lower = [Shape(rest, shape.denominator) for rest in _without_one(shape.numerator)]
    return lower + [Shape(shape.numerator, rest) for rest in _without_one(shape.denominator)]


def _without_one(indices: tuple[Index, ...]) -> list[tuple[Index, ...]]:
    """The sets without one index that no other one of them needs."""
    return [tuple(i for i in indices if i != index) for index in tips(indices)]


def _has_freedom(data: Data, shape: Shape) -> bool:
    """Whether the sweeps but one still determine the coefficients."""
    m = int(np.min(np.sum(data.weight > 0.0, axis=1)))
    return len(shape.numerator) < m and shape.size <= ELEMENTS * (m - 1)


def _by_size(shapes: Sequence[Shape]) -> list[list[Shape]]:
    """Shapes with as many products as one another, together."""
    return [list(alike) for _, alike in groupby(sorted(shapes, key=_size), key=_size)]


def _try(data: Data, shapes: Iterable[Shape], tried: dict[Shape, float], region: np.ndarray) -> None:
    """Enter the leave-one-out errors of shapes that were not tried yet."""
    for alike in _by_size([shape for shape in shapes if shape not in tried]):
        tried.update(_scored(data, alike, region))


def _size(shape: Shape) -> tuple[int, int]:
    return len(shape.numerator), len(shape.denominator)


def _scored(data: Data, shapes: Sequence[Shape], region: np.ndarray) -> Iterable[tuple[Shape, float]]:
    """Shapes of one size with their leave-one-out errors; infinite where a pole would hide in the region."""
    found = try_shapes(data, shapes, _PASSES)
    hidden = [_hides_pole(*each, data.x, region) for each in zip(shapes, found.denominators, strict=True)]
    usable = np.isfinite(found.scores) & ~np.array(hidden)
    return zip(shapes, np.where(usable, found.scores, np.inf).tolist(), strict=True)


def _hides_pole(shape: Shape, denominator: np.ndarray, x: np.ndarray, region: np.ndarray) -> bool:
    """Whether |d|, its coefficients (f, l), falls far below its least value at the sweeps x somewhere in the region."""
    if not shape.denominator:
        return False
    at_sweeps, elsewhere = (
        np.abs(1.0 + chebyshev_products(at, shape.denominator) @ denominator.T).min(axis=0) for at in (x, region)
    )
    return bool(np.any(elsewhere < GUARD * at_sweeps))


def _ordered(tried: dict[Shape, float]) -> list[Shape]:
    """Shapes that can be used, the best first."""
    return sorted((s for s in tried if np.isfinite(tried[s])), key=lambda s: (tried[s], s))


def _ranked(tried: dict[Shape, float]) -> list[Shape]:
    """The smallest shape within `SMALLEST_WITHIN` of the best, then the next best."""
    order = _ordered(tried)
    near = [s for s in order if tried[s] <= SMALLEST_WITHIN * tried[order[0]]]
    chosen = min(near, key=lambda s: (s.size, tried[s], s))
    return [chosen, *[s for s in order if s != chosen][:RIVALS]]
