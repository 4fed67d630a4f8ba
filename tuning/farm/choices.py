"""Which devices change, and by how much: three ways to meet linear demands on modes with changes between 0 and a most.

The demands are ``slopes @ x <= wanted``, one row for each mode, x the changes (n,) of the devices: gains, or powers
given up. Where they cannot be met together, what comes nearest is returned; the caller judges the changed farm anyhow.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Choose = Callable[[np.ndarray, np.ndarray | float, np.ndarray | float], np.ndarray]
"""Slopes (n,) or (m, n), wanted (m,) and most (n,) to changes (n,)."""

_SIZES = 4001  # equal changes that are looked at; between two of them the excess is a straight line

_OPEN = 1e-9  # a residual of the dual that small says that the demands contradict each other


def least_norm(slopes: np.ndarray, wanted: np.ndarray | float, most: np.ndarray | float) -> np.ndarray:
    """The changes (n,) of least sum of squares.

    Parameters
    ----------
    slopes : (n,) or (m, n) float
        Change of a mode's real part, or of what is demanded of it, per unit change of a device.
    wanted : float or (m,) float
        Asked change, at most; negative where the mode must move to the left.
    most : float or (n,) float
        Largest change of a device.

    Notes
    -----
    Least distance programming: the dual is one non-negative least-squares problem (Lawson and Hanson, 1974, ch. 23).
    """
    from scipy.optimize import nnls

    a, b, top = _shaped(slopes, wanted, most)
    n = len(top)
    size = np.maximum(np.linalg.norm(a, axis=1), 1e-300)
    g = np.concatenate([-a / size[:, None], np.eye(n), -np.eye(n)])
    h = np.concatenate([-b / size, np.zeros(n), -top])
    unit = max(float(np.abs(h).max()), 1e-300)  # so that the dual's residual is of the order of one
    e, f = np.append(g.T, h[None] / unit, axis=0), np.append(np.zeros(n), 1.0)
    residual = e @ nnls(e, f)[0] - f
    if abs(residual[-1]) < _OPEN:
        return nearest_possible(a, b, top)
    return np.clip(-residual[:-1] / residual[-1] * unit, 0.0, top)


def fewest(slopes: np.ndarray, wanted: np.ndarray | float, most: np.ndarray | float) -> np.ndarray:
    """Changes (n,) of as few devices as possible, and of those the least sum."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    a, b, top = _shaped(slopes, wanted, most)
    n = len(top)
    scaled = a * top  # in parts of each device's most, so that the sum below stays under one device
    size = np.maximum(np.abs(scaled).max(axis=1), 1e-300)
    demands = LinearConstraint(np.append(scaled / size[:, None], np.zeros((len(b), n)), axis=1), ub=b / size)
    switched = LinearConstraint(np.append(np.eye(n), -np.eye(n), axis=1), ub=np.zeros(n))
    cost = np.concatenate([np.full(n, 0.5 / n), np.ones(n)])
    whole = np.concatenate([np.zeros(n), np.ones(n)])
    found = milp(cost, constraints=(demands, switched), integrality=whole, bounds=Bounds(0.0, 1.0))
    if found.x is None:
        return nearest_possible(a, b, top)
    return np.where(found.x[n:] > 0.5, np.clip(found.x[:n], 0.0, 1.0) * top, 0.0)


def uniform(slopes: np.ndarray, wanted: np.ndarray | float, most: np.ndarray | float) -> np.ndarray:
    """The same change (n,) for every device, as far as its most allows; the least that meets the demands.

    A mode may gain while another one loses: the changes that meet all demands are looked for from zero upwards.
    """
    a, b, top = _shaped(slopes, wanted, most)
    sizes = np.linspace(0.0, float(top.max()), _SIZES)
    excess = np.max(a @ np.minimum(sizes, top[:, None]) - b[:, None], axis=0)
    meets = np.flatnonzero(excess <= 0.0)
    if len(meets) == 0:
        return np.minimum(sizes[int(np.argmin(excess))], top)
    if meets[0] == 0:
        return np.zeros(len(top))
    before, at = excess[meets[0] - 1 : meets[0] + 1]
    return np.minimum(sizes[meets[0]] - (sizes[1] - sizes[0]) * at / (at - before), top)


def nearest_possible(a: np.ndarray, b: np.ndarray, top: np.ndarray) -> np.ndarray:
    """Changes (n,) with the least largest excess over the demands."""
    from scipy.optimize import linprog

    m, n = a.shape
    cost = np.append(np.zeros(n), 1.0)
    found = linprog(cost, np.append(a, -np.ones((m, 1)), axis=1), b, bounds=[*((0.0, t) for t in top), (None, None)])
    return np.clip(found.x[:n], 0.0, top) if found.x is not None else np.zeros(n)


def _shaped(
    slopes: np.ndarray, wanted: np.ndarray | float, most: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a = np.atleast_2d(np.asarray(slopes, dtype=float))
    b = np.broadcast_to(np.asarray(wanted, dtype=float), len(a))
    return a, b, np.broadcast_to(np.asarray(most, dtype=float), a.shape[1])


WAYS: dict[str, Choose] = {"least norm": least_norm, "fewest": fewest, "uniform": uniform}
"""The ways by the words that they are told in."""
