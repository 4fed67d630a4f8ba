"""A real barycentric interpolant of matrix data: adaptive Antoulas-Anderson (AAA) in the dq frame.

    Y(s) = sum_j [w_j F_j / (s - z_j) + conj] / sum_j [w_j / (s - z_j) + conj],    z_j = 2 pi j nu_j

All elements share the weights, hence the poles; every node comes with its conjugate, so that the model
is that of a real system. Nodes are added where the misfit is largest. What it interpolates it believes:
it is the quickest way to the poles of data without noise, and only that (`adaptive` refits them).

Y. Nakatsukasa, O. Sete, L. N. Trefethen, "The AAA algorithm for rational approximation", 2018, with the
set-valued and conjugate-symmetric extensions.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .dq_data import DqData


class Barycentric(NamedTuple):
    """Nodes (m,) rad/s in the upper half-plane, values (m, 4) S, weights (m,), and the misfit elsewhere (relative)."""

    z: np.ndarray
    values: np.ndarray
    weights: np.ndarray
    misfit: float


def interpolants(data: DqData) -> Iterator[Barycentric]:
    """Interpolants of growing degree, as long as the data determine them.

    Parameters
    ----------
    data : DqData
        Folded rows, distinct frequencies above 0.

    Yields
    ------
    Barycentric
        Of 1, 2, ... nodes; type (2m - 1, 2m - 1).
    """
    s, y = 2j * np.pi * data.nu_hz, data.y.reshape(-1, 4)
    size = np.linalg.norm(y, axis=1)
    model = np.broadcast_to(y.mean(axis=0).real, y.shape)
    nodes: list[int] = []
    while True:
        misfit = np.linalg.norm(y - model, axis=1) / size
        misfit[nodes] = -1.0
        nodes.append(int(np.argmax(misfit)))
        others = np.setdiff1d(np.arange(len(s)), nodes)
        if 8 * len(others) < 2 * len(nodes):
            return
        found = Barycentric(s[nodes], y[nodes], _weights(s, y, size, nodes, others), 0.0)
        model = y.copy()
        model[others] = _evaluate(found, s[others])
        misfit = np.linalg.norm(y - model, axis=1) / size
        yield found._replace(misfit=float(np.max(misfit)))


def poles(model: Barycentric) -> np.ndarray:
    """All finite poles (rad/s), conjugates included: the zeros of the denominator."""
    from scipy.linalg import eigvals

    z, w = (np.concatenate([x, x.conj()]) for x in (model.z, model.weights))
    arrow = np.block([[np.zeros((1, 1)), w[None]], [np.ones((len(z), 1)), np.diag(z)]])
    unit = np.diag(np.append(0.0, np.ones(len(z))))
    found = eigvals(arrow, unit)
    found = found[np.isfinite(found)]
    return found[np.abs(found) < 1e3 * np.max(np.abs(model.z))]


def _weights(s: np.ndarray, y: np.ndarray, size: np.ndarray, nodes: list[int], others: np.ndarray) -> np.ndarray:
    """Weights (m,) of the smallest linearised misfit at ``others``: Y D - N = 0, relative to Y."""
    upper = (y[others, None] - y[nodes]) / (s[others, None] - s[nodes])[:, :, None]
    lower = (y[others, None] - y[nodes].conj()) / (s[others, None] - s[nodes].conj())[:, :, None]
    both = np.concatenate([upper + lower, 1j * (upper - lower)], axis=1) / size[others, None, None]
    rows = np.swapaxes(both, 1, 2).reshape(-1, 2 * len(nodes))
    rows = np.concatenate([rows.real, rows.imag])
    norm = np.linalg.norm(rows, axis=0)
    norm[norm == 0.0] = 1.0
    x = np.linalg.svd(rows / norm, full_matrices=False)[2][-1] / norm
    return np.asarray(x[: len(nodes)] + 1j * x[len(nodes) :])


def _evaluate(model: Barycentric, s: np.ndarray) -> np.ndarray:
    """(n, 4) S away from the nodes."""
    upper = model.weights / (s[:, None] - model.z)
    lower = model.weights.conj() / (s[:, None] - model.z.conj())
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (upper @ model.values + lower @ model.values.conj()) / (upper + lower).sum(axis=1)[:, None]
    return np.asarray(np.where(np.isfinite(ratio), ratio, 0.0))
