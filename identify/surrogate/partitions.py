"""Which split of the sweeps two smooth devices would explain best: the likelihood of Gaussian processes.

A Gaussian process with a squared exponential kernel stands for a smooth device; two of them that know nothing of each
other, one on either side, stand for a device that jumps. With the kernel's matrix C, its entries between the sides set
to zero, and the variance put at its best value, a split of m sweeps has ``-2 log L = log det C + m log(sum y' C^-1 y)``
but for a constant, for one output; admittances at several frequencies count as one, for they are alike. The process
only ranks splits, in milliseconds for hundreds of them; what is told about a side is the rational model's.
"""

from __future__ import annotations

import itertools

import numpy as np

from .sparse_rational import ELEMENTS, Data

LENGTHS = (0.7, 1.5, 4.0)
"""Over how much of the unit box, two long, the device changes; tried for every axis on its own.

Along four axes and more the middle one is left out: 16 processes are tried then in place of 81.
"""

TRUST = 3e-4
"""A smooth device may differ from the process by this part of its variation; noise adds to it."""

_LEVEL = 4.0  # variance of a side's own level against that of its changes


def evidence_of(data: Data, variance: np.ndarray | None, sides: np.ndarray) -> np.ndarray:
    """How much better each split explains the sweeps than one device does.

    Parameters
    ----------
    data : Data
        The sweeps at a few frequencies.
    variance : (f, m) float or None
        Relative variance of the rows.
    sides : (n, m) bool
        Splits.

    Returns
    -------
    (n,) float
        Twice the logarithm of the likelihood ratio; negative where one device is the better explanation.
    """
    y = _outputs(data)
    nugget = TRUST**2 + _noise_of(y, variance)
    whole = np.zeros((1, sides.shape[1]), dtype=bool)
    found = _deviance(data.x, y, np.concatenate([whole, sides]), nugget)
    return np.asarray(found[0] - found[1:])


def _outputs(data: Data) -> np.ndarray:
    """(m, k) real: all elements at all frequencies, each frequency in parts of its mean norm."""
    size = np.linalg.norm(data.y, axis=2).mean(axis=1)
    y = (data.y / np.maximum(size, 1e-300)[:, None, None]).transpose(1, 0, 2).reshape(len(data.x), -1)
    return np.hstack([y.real, y.imag])


def _noise_of(y: np.ndarray, variance: np.ndarray | None) -> float:
    """Variance of a row's noise, per real output, in parts of that of the outputs."""
    if variance is None:
        return 0.0
    spread = max(float(np.mean(np.var(y, axis=0))), 1e-300)
    return float(np.mean(variance)) / (2 * ELEMENTS) / spread


def _deviance(x: np.ndarray, y: np.ndarray, sides: np.ndarray, nugget: float) -> np.ndarray:
    """(n,) -2 log L of splits (n, m), at the best of the lengths."""
    m = len(x)
    same = sides[:, :, None] == sides[:, None, :]
    squared = (x[:, None] - x[None]) ** 2
    best = np.full(len(sides), np.inf)
    tried = LENGTHS if x.shape[1] <= 3 else LENGTHS[::2]
    for lengths in itertools.product(tried, repeat=x.shape[1]):
        kernel = _LEVEL + np.exp(-0.5 * (squared / np.square(lengths)).sum(axis=2))
        factor = np.linalg.cholesky(same * kernel + nugget * np.eye(m))
        left = np.linalg.solve(factor, np.broadcast_to(y, (len(sides), *y.shape)))
        determinant = 2.0 * np.log(np.einsum("nii->ni", factor)).sum(axis=1)
        best = np.minimum(best, determinant + m * np.log(np.sum(left**2, axis=(1, 2)) + 1e-300))
    return best
