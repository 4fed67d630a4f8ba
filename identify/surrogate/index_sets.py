"""Which Chebyshev products a model over operating points is made of: downward-closed sets of multi-indices.

A multi-index (a, b, c) stands for T_a(x1) T_b(x2) T_c(x3) with the Chebyshev polynomials T of the coordinates, each
scaled to -1 ... 1. A set is downward-closed if with (a, b, c) it holds every index that is nowhere larger: no high
degree without the lower ones, so that a set can grow one index at a time along its border.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

Index = tuple[int, ...]


def chebyshev_products(x: np.ndarray, indices: Sequence[Index]) -> np.ndarray:
    """Values (m, k) of the products at points (m, d) in the unit box.

    Notes
    -----
    T_0 = 1, T_1 = x, T_{n+1} = 2 x T_n - T_{n-1}.
    """
    x = np.atleast_2d(np.asarray(x, dtype=float))
    if not indices:
        return np.zeros((len(x), 0))
    table = np.array(indices)
    degree = int(table.max(initial=0))
    t = np.ones((degree + 1, *x.shape))
    if degree:
        t[1] = x
    for n in range(2, degree + 1):
        t[n] = 2.0 * x * t[n - 1] - t[n - 2]
    values = np.ones((len(x), len(table)))
    for axis in range(x.shape[1]):
        values *= t[table[:, axis], :, axis].T
    return values


def border(indices: Iterable[Index], n_axes: int, most: int) -> list[Index]:
    """Indices that a downward-closed set can grow by, of total degree up to ``most``, lowest degree first."""
    held = set(indices) | {(0,) * n_axes}
    grown = {_raised(index, axis) for index in held for axis in range(n_axes)} - held
    return sorted((i for i in grown if sum(i) <= most and _is_supported(i, held)), key=lambda i: (sum(i), i))


def tips(indices: Iterable[Index]) -> list[Index]:
    """Indices that a downward-closed set can lose, one of them: all but the constant that no other one needs."""
    held = set(indices)
    return sorted(i for i in held if any(i) and not any(_raised(i, axis) in held for axis in range(len(i))))


def _raised(index: Index, axis: int) -> Index:
    return tuple(n + (k == axis) for k, n in enumerate(index))


def _is_supported(index: Index, held: set[Index]) -> bool:
    lowered = (tuple(n - (k == axis) for k, n in enumerate(index)) for axis, n in enumerate(index) if n > 0)
    return all(below in held for below in lowered)
