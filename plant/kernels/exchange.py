"""Products of a network that joins devices in lanes: what each does to itself, and what all exchange.

See `plant.circuits.coupled` for the matrices. Widths are literals where these functions are called: the loops over
lanes and numbers of a place have constant lengths then, long enough for vectors.
"""

from __future__ import annotations

from .compiled import njit
from .lanes import FAST as _FAST
from .lanes import LANES


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def gather(s, t, coupling, x, first, n_half, extra):
    """The sums over ``n_half`` real parts of each place from slot ``first`` on, and the imaginary ones behind them.

    ``t`` becomes what is made of them and of ``extra``; ``s`` is room.
    """
    width, r = n_half * LANES, coupling.into.shape[0]
    for j in range(r):
        re, im = 0.0, 0.0
        for g in range(coupling.into.shape[1]):
            for k in range(width):
                re += coupling.into[j, g, k] * x[g, first * LANES + k]
                im += coupling.into[j, g, k] * x[g, first * LANES + width + k]
        s[j], s[r + j] = re, im
    for k in range(extra.shape[0]):
        s[2 * r + k] = extra[k]
    for row in range(coupling.core.shape[0]):
        total = 0.0
        for k in range(coupling.core.shape[1]):
            total += coupling.core[row, k] * s[k]
        t[row] = total


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def scatter(t, coupling, x, first, n_half, apart, extra, first_extra, n_extra):
    """What came of the sums is added to ``n_half`` real parts of each place from slot ``first`` on.

    The imaginary parts stand ``apart`` slots behind; ``n_extra`` numbers of ``extra`` have their part from
    ``first_extra`` on.
    """
    width = n_half * LANES
    q = (coupling.core.shape[0] - n_extra) // 2
    for k in range(n_extra):
        extra[first_extra + k] += t[2 * q + k]
    for g in range(coupling.out.shape[0]):
        for j in range(0, coupling.out.shape[1], 2):
            re_0, im_0, re_1, im_1 = t[j], t[q + j], t[j + 1], t[q + j + 1]
            for k in range(width):
                x[g, first * LANES + k] += coupling.out[g, j, k] * re_0 + coupling.out[g, j + 1, k] * re_1
            for k in range(width):
                x[g, (first + apart) * LANES + k] += coupling.out[g, j, k] * im_0 + coupling.out[g, j + 1, k] * im_1


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def from_2(x, at, lane, a):
    """Real parts of two numbers, then imaginary ones, by a place's own (4, 2) matrix, which begins at slot ``at``."""
    return (
        x[(at + 0) * LANES + lane] * a[0] + x[(at + 1) * LANES + lane] * a[1],
        x[(at + 2) * LANES + lane] * a[0] + x[(at + 3) * LANES + lane] * a[1],
        x[(at + 4) * LANES + lane] * a[0] + x[(at + 5) * LANES + lane] * a[1],
        x[(at + 6) * LANES + lane] * a[0] + x[(at + 7) * LANES + lane] * a[1],
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _row_4(x, at, lane, a):
    return (
        x[(at + 0) * LANES + lane] * a[0]
        + x[(at + 1) * LANES + lane] * a[1]
        + x[(at + 2) * LANES + lane] * a[2]
        + x[(at + 3) * LANES + lane] * a[3]
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def from_4(x, at, lane, a):
    """Four numbers by a place's own (4, 4) matrix."""
    return (
        _row_4(x, at, lane, a),
        _row_4(x, at + 4, lane, a),
        _row_4(x, at + 8, lane, a),
        _row_4(x, at + 12, lane, a),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _row_6(x, at, lane, a):
    return _row_4(x, at, lane, a) + x[(at + 4) * LANES + lane] * a[4] + x[(at + 5) * LANES + lane] * a[5]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def from_6(x, at, lane, a):
    """Four numbers by a place's own (4, 6) matrix."""
    return (
        _row_6(x, at, lane, a),
        _row_6(x, at + 6, lane, a),
        _row_6(x, at + 12, lane, a),
        _row_6(x, at + 18, lane, a),
    )
