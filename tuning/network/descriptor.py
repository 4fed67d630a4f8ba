"""Linear descriptor systems E x' = A x + B u, y = C x: a network before anything is solved for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

J = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Multiplication by j of a (d, q) pair."""

_INFINITE = 1e9
"""Eigenvalues beyond (rad/s) are the infinite ones of a pencil."""


class Descriptor(NamedTuple):
    """E x' = A x + B u, y = C x, all real.

    Attributes
    ----------
    e, a : (n, n) float
        E may be singular: nodes without a capacitor, branches without an inductor.
    b : (n, p) float
        Inputs: currents drawn out of the network at its ports (A).
    c : (p, n) float
        Outputs: voltages of the ports (V).
    """

    e: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def rotating(phase: Descriptor, w1_rad_s: float) -> Descriptor:
    """The same symmetric network in the dq frame: one phase, written twice and turning with w1.

    With x = (x_d + j x_q) exp(j w1 t), E x' = A x becomes E (x) 1 x' = (A (x) 1 - w1 E (x) J) x.
    """
    one = np.eye(2)
    turned = _kronecker(phase.a, one) - w1_rad_s * _kronecker(phase.e, J)
    return Descriptor(_kronecker(phase.e, one), turned, _kronecker(phase.b, one), _kronecker(phase.c, one))


def _kronecker(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`numpy.kron` of two matrices, without what it spends on arrays of any shape."""
    return (a[:, None, :, None] * b[:, None, :]).reshape(a.shape[0] * b.shape[0], a.shape[1] * b.shape[1])


class Triangular(NamedTuple):
    """Q^H (s E - A) Z = s S - T of a descriptor with one port: its transfer function costs one back-substitution.

    Attributes
    ----------
    t, s : (n, n) complex
        Upper triangles of the generalised Schur form of (A, E).
    b : (n,) complex
        Q^H B.
    c : (n,) complex
        C Z.
    poles : (m,) complex
        Finite eigenvalues of the pencil (rad/s).
    """

    t: np.ndarray
    s: np.ndarray
    b: np.ndarray
    c: np.ndarray
    poles: np.ndarray


def triangular(system: Descriptor) -> Triangular:
    """Generalised Schur form of a descriptor with one input and one output, rows and columns scaled to one size."""
    from scipy.linalg import qz

    e, a, b, c = system
    rows = 1.0 / np.maximum(np.abs(a).max(axis=1), np.abs(e).max(axis=1) * 300.0)
    e, a, b = e * rows[:, None], a * rows[:, None], b * rows[:, None]
    columns = 1.0 / np.maximum(np.abs(a).max(axis=0), np.abs(e).max(axis=0) * 300.0)
    e, a, c = e * columns, a * columns, c * columns
    t, s, q, z = qz(a, e, output="complex")
    finite = np.abs(np.diagonal(s)) * _INFINITE > np.abs(np.diagonal(t))
    poles = np.diagonal(t)[finite] / np.diagonal(s)[finite]
    return Triangular(t, s, q.conj().T @ b[:, 0], c[0] @ z, poles)


def transfer(form: Triangular, s: np.ndarray) -> np.ndarray:
    """y(s) = C (s E - A)^-1 B, (k,), at complex ``s`` (k,) in rad/s."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return form.c @ _solved(form, s, np.broadcast_to(form.b[:, None], (len(form.b), len(s))))


def transfer_slope(form: Triangular, s: np.ndarray) -> np.ndarray:
    """Derivative of `transfer` by s, (k,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        x = _solved(form, s, np.broadcast_to(form.b[:, None], (len(form.b), len(s))))
        return -form.c @ _solved(form, s, form.s @ x)


def _solved(form: Triangular, s: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(s S - T)^-1 right, (n, k), for every s (k,) at once."""
    x = np.array(right, dtype=complex)
    for row in range(len(x) - 1, -1, -1):
        after = slice(row + 1, None)
        x[row] -= s * (form.s[row, after] @ x[after]) - form.t[row, after] @ x[after]
        x[row] /= s * form.s[row, row] - form.t[row, row]
    return x
