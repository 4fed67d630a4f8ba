"""2x2 matrices by their four elements, for many frequencies at once, in the basis of the two sequences.

In (v_d + j v_q, v_d - j v_q) a symmetric passive element is diagonal and the turning of a frame is two phases, so that
products and inverses cost a few operations on arrays; `numpy.linalg` would spend ten times that on each small matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Pair(NamedTuple):
    """The elements (n,) of (n, 2, 2): row, then column, p for v_d + j v_q and n for v_d - j v_q."""

    pp: np.ndarray
    pn: np.ndarray
    np: np.ndarray
    nn: np.ndarray


def from_dq(y: np.ndarray) -> Pair:
    """T Y T^-1 of (n, 2, 2) in dq."""
    dd, dq, qd, qq = y[..., 0, 0], y[..., 0, 1], y[..., 1, 0], y[..., 1, 1]
    own, turned = (dd + qq) / 2.0, (qd - dq) / 2.0
    uneven, crossed = (dd - qq) / 2.0, (qd + dq) / 2.0
    return Pair(own + 1j * turned, uneven + 1j * crossed, uneven - 1j * crossed, own - 1j * turned)


def to_dq(y: Pair) -> np.ndarray:
    """T^-1 Y T, (n, 2, 2) in dq."""
    own, turned = (y.pp + y.nn) / 2.0, (y.pp - y.nn) / 2j
    uneven, crossed = (y.pn + y.np) / 2.0, (y.pn - y.np) / 2j
    rows = (own + uneven, crossed - turned), (turned + crossed, own - uneven)
    return np.stack([np.stack(row, -1) for row in rows], -2)


def diagonal(p: np.ndarray, n: np.ndarray) -> Pair:
    """What acts on each sequence alone."""
    nothing = np.zeros(np.shape(p), dtype=complex)
    return Pair(p, nothing, nothing, n)


def everywhere(value: complex, n: int) -> Pair:
    """``value`` times the unit matrix, n times."""
    return diagonal(*(np.full(n, value, dtype=complex),) * 2)


def turned(y: Pair, angle_rad: float, factor: float = 1.0) -> Pair:
    """factor R(d) Y R(-d)."""
    phase = np.exp(2j * angle_rad)
    return Pair(factor * y.pp, factor * phase * y.pn, factor / phase * y.np, factor * y.nn)


def plus(a: Pair, b: Pair) -> Pair:
    """A + B."""
    return Pair(*(x + y for x, y in zip(a, b, strict=True)))


def scaled(factor: float | np.ndarray, a: Pair) -> Pair:
    """factor A."""
    return Pair(*(factor * x for x in a))


def product(a: Pair, b: Pair) -> Pair:
    """A B."""
    return Pair(
        a.pp * b.pp + a.pn * b.np, a.pp * b.pn + a.pn * b.nn, a.np * b.pp + a.nn * b.np, a.np * b.pn + a.nn * b.nn
    )


def determinant(a: Pair) -> np.ndarray:
    """det A (n,)."""
    return a.pp * a.nn - a.pn * a.np


def inverse(a: Pair) -> Pair:
    """A^-1."""
    one = 1.0 / determinant(a)
    return Pair(one * a.nn, -one * a.pn, -one * a.np, one * a.pp)


def eigenvalues(a: Pair) -> tuple[np.ndarray, np.ndarray]:
    """Both eigenvalues, each (n,)."""
    middle = (a.pp + a.nn) / 2.0
    root = np.sqrt(((a.pp - a.nn) / 2.0) ** 2 + a.pn * a.np)
    return middle + root, middle - root
