"""Lanes side by side in one flat array, and the step of a linear network behind each of them."""

from __future__ import annotations

from .compiled import njit

LANES = 8
"""Lanes of one flat array: one 512-bit or two 256-bit vectors of doubles."""

FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
"""What arithmetic may assume. No "nnan" and no "ninf": a diverged lane must be seen."""


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def show_free(x, free, xi, seen):
    """What networks show at start, middle and end of a step if nothing is fed in.

    Parameters
    ----------
    x : flat array
        Everything of the lanes; receives the answer from slot ``free`` on, first all of the start, then of the middle.
    free : int
        First slot of the answer.
    xi : (m, LANES) array
        States of the networks.
    seen : (3, n, m) array
        What the states show, n numbers each time.
    """
    n_rows = seen.shape[1]
    for place in range(3):
        for row in range(n_rows):
            at = (free + n_rows * place + row) * LANES
            for lane in range(LANES):
                x[at + lane] = 0.0
            for k in range(xi.shape[0]):
                weight = seen[place, row, k]
                for lane in range(LANES):
                    x[at + lane] += weight * xi[k, lane]


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def feed(x, fed, xi, work, net):
    """Networks go one step, driven by what was fed in.

    Parameters
    ----------
    x : flat array
        Everything of the lanes; what is fed in stands from slot ``fed`` on: re, im at start, middle and end.
    fed : int
        First slot of it.
    xi, work : (m, LANES) array
        States of the networks, replaced; room for new ones.
    net : NamedTuple
        ``keep`` (m, m) of the states, ``start``, ``middle`` and ``end`` (m, 2) of what is fed in.
    """
    for k in range(xi.shape[0]):
        for lane in range(LANES):
            work[k, lane] = (
                net.start[k, 0] * x[(fed + 0) * LANES + lane]
                + net.start[k, 1] * x[(fed + 1) * LANES + lane]
                + net.middle[k, 0] * x[(fed + 2) * LANES + lane]
                + net.middle[k, 1] * x[(fed + 3) * LANES + lane]
                + net.end[k, 0] * x[(fed + 4) * LANES + lane]
                + net.end[k, 1] * x[(fed + 5) * LANES + lane]
            )
        for j in range(xi.shape[0]):
            weight = net.keep[k, j]
            for lane in range(LANES):
                work[k, lane] += weight * xi[j, lane]
    for k in range(xi.shape[0]):
        for lane in range(LANES):
            xi[k, lane] = work[k, lane]
