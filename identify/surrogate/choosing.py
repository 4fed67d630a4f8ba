"""Which products a sparse rational model is made of: grown greedily by the lowest leave-one-out error.

An index is added to the numerators or to the denominator, or two at a time where one alone gains nothing. All shapes of
one size that a step may lead to are fitted at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np

from .index_sets import border, chebyshev_products
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

_PATIENCE = 6  # growth steps without gain until growing ends
_PASSES = 2  # of fits that only rank shapes; those that are kept are fitted anew
_THINNED, _PROMISING = 4, 8
"""Of two indices at a time, so many shapes are fitted as a whole that are the best at every fourth frequency."""


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
    """
    tried: dict[Shape, float] = {}
    for start in _starts(data):
        _grow(data, start, tried, region)
    return _ranked(tried)


def _starts(data: Data) -> list[Shape]:
    """A constant, and where the sweeps allow it a linear numerator over a linear denominator.

    From the constant alone growing may end early: where no one or two indices help, though more of them would.
    """
    n_axes = data.x.shape[1]
    constant = Shape(((0,) * n_axes,), ())
    first = tuple(sorted(border(constant.numerator, n_axes, 1)))
    linear = Shape((*constant.numerator, *first), first)
    return [constant, linear] if _has_freedom(data, linear) else [constant]


def _grow(data: Data, shape: Shape, tried: dict[Shape, float], region: np.ndarray) -> None:
    """Grow a shape until nothing is gained; every shape on the way is tried."""
    _best_of(data, [shape], tried, region)
    best, idle = tried[shape], 0
    while idle < _PATIENCE and best > ENOUGH:
        found = _grown(data, shape, tried, region)
        if found is None:
            break
        shape = found
        idle = 0 if tried[shape] < best / SMALLEST_WITHIN else idle + 1
        best = min(best, tried[shape])


def _grown(data: Data, shape: Shape, tried: dict[Shape, float], region: np.ndarray) -> Shape | None:
    """The best shape one index larger, or two where one alone gains nothing; None where no freedom is left."""
    singles = [s for s in larger(shape) if _has_freedom(data, s)]
    found = _best_of(data, singles, tried, region)
    if found is not None and tried[found] < tried[shape] / SMALLEST_WITHIN:
        return found
    pairs = {two for one in singles for two in larger(one) if two.denominator != shape.denominator}
    second = _best_of(data, _promising(data, sorted(s for s in pairs if _has_freedom(data, s))), tried, region)
    both = [s for s in (found, second) if s is not None]
    return min(both, key=lambda s: (tried[s], s), default=None)


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


def _has_freedom(data: Data, shape: Shape) -> bool:
    """Whether the sweeps but one still determine the coefficients."""
    m = int(np.min(np.sum(data.weight > 0.0, axis=1)))
    return len(shape.numerator) < m and shape.size <= ELEMENTS * (m - 1)


def _promising(data: Data, shapes: Sequence[Shape]) -> list[Shape]:
    """Of many shapes those that are the best at a few frequencies."""
    if len(shapes) <= _PROMISING:
        return list(shapes)
    few = Data(data.x, data.y[::_THINNED], data.weight[::_THINNED])
    worth = {shape: score for alike in _by_size(shapes) for shape, score in _worth(few, alike)}
    return sorted(shapes, key=lambda s: (worth[s], s))[:_PROMISING]


def _worth(data: Data, shapes: Sequence[Shape]) -> Iterable[tuple[Shape, float]]:
    return zip(shapes, try_shapes(data, shapes, _PASSES).scores.tolist(), strict=True)


def _by_size(shapes: Sequence[Shape]) -> list[list[Shape]]:
    """Shapes with as many products as one another, together."""
    return [list(alike) for _, alike in groupby(sorted(shapes, key=_size), key=_size)]


def _best_of(data: Data, shapes: Sequence[Shape], tried: dict[Shape, float], region: np.ndarray) -> Shape | None:
    for alike in _by_size([shape for shape in shapes if shape not in tried]):
        tried.update(_scored(data, alike, region))
    return min(shapes, key=lambda s: (tried[s], s), default=None)


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


def _ranked(tried: dict[Shape, float]) -> list[Shape]:
    """The smallest shape within `SMALLEST_WITHIN` of the best, then the next best."""
    order = sorted((s for s in tried if np.isfinite(tried[s])), key=lambda s: (tried[s], s))
    near = [s for s in order if tried[s] <= SMALLEST_WITHIN * tried[order[0]]]
    chosen = min(near, key=lambda s: (s.size, tried[s], s))
    return [chosen, *[s for s in order if s != chosen][:RIVALS]]
