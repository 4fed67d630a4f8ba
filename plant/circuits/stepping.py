"""Matrices by which a kernel takes a network exactly through one step, port currents a parabola over it.

Real throughout: a complex number is a pair. With xi the states at the start and u_0, u_1, u_2, u_3 the port currents
that a classical Runge-Kutta step meets (at its start, twice in its middle, at its end), outputs are seen as ::

    o_0 = S_0 xi + D u_0
    o_1 = S_1 xi + A u_0 + D u_1
    o_2 = S_1 xi + A u_0 + B (u_1 - u_0) + D u_2
    o_3 = S_2 xi + F u_0 + H (u_2 - u_0) + D u_3

and xi goes to E xi + P_0 u_0 + P_1 (u_1 + u_2)/2 + P_2 u_3: the exponential Runge-Kutta method of order four of
Krogstad (J. Comput. Phys. 203, 2005), which is the classical one for a network that hardly moves, exact for the network
whatever its speed, and leaves every equilibrium where it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .dynamics import Dynamics


class Weights(NamedTuple):
    """See the module; pairs throughout.

    Attributes
    ----------
    seen : (3, o, m)
        S_0, S_1, S_2.
    direct : (o, p)
        D.
    by_start, by_first, by_whole, by_second : (o, p)
        A, B, F, H.
    keep : (m, m)
        E.
    start, middle, end : (m, p)
        P_0, P_1, P_2.
    turn : (2,)
        Cosine and sine by which the network's frame turns against the dq frame in half a step.
    """

    seen: np.ndarray
    direct: np.ndarray
    by_start: np.ndarray
    by_first: np.ndarray
    by_whole: np.ndarray
    by_second: np.ndarray
    keep: np.ndarray
    start: np.ndarray
    middle: np.ndarray
    end: np.ndarray
    turn: np.ndarray


class Outputs(NamedTuple):
    """What is looked at: o = of_x x + of_u u of one phase, of_x (o, n), of_u (o, p)."""

    of_x: np.ndarray
    of_u: np.ndarray


def weights_of(dynamics: Dynamics, outputs: Outputs, step_s: float) -> Weights:
    """The matrices for one step of ``step_s`` (s)."""
    f, g, c, d = _in_frame(dynamics, outputs)
    half, one_half, two_half, _ = exponentials(f, g, 0.5 * step_s)
    whole, one, two, three = exponentials(f, g, step_s)
    w = dynamics.w1_rad_s if dynamics.frame == "stationary" else 0.0
    matrices = (
        np.stack([c, c @ half, c @ whole]),
        d,
        c @ one_half,
        2.0 * c @ two_half,
        c @ one,
        2.0 * c @ two,
        whole,
        one - 3.0 * two + 4.0 * three,
        4.0 * two - 8.0 * three,
        4.0 * three - two,
    )
    turn = np.array([np.cos(0.5 * w * step_s), np.sin(0.5 * w * step_s)])
    return Weights._make([*(np.ascontiguousarray(_paired(matrix, dynamics)) for matrix in matrices), turn])


def rates_of(dynamics: Dynamics, outputs: Outputs) -> np.ndarray:
    """(o, p) pairs: what the outputs have of the time derivatives of the port currents, in the network's frame."""
    direct = outputs.of_x @ dynamics.finite.k if dynamics.frame == "dq" else outputs_pairs(outputs) @ dynamics.finite.k
    return np.ascontiguousarray(_paired(direct + 0j if dynamics.frame == "dq" else direct, dynamics))


def outputs_pairs(outputs: Outputs) -> np.ndarray:
    """``of_x`` of alpha and beta in pairs."""
    return np.kron(outputs.of_x, np.eye(2))


def exponentials(f: np.ndarray, g: np.ndarray, h: float) -> tuple[np.ndarray, ...]:
    """exp(h F), h phi_1(h F) G, h phi_2(h F) G, h phi_3(h F) G, by one exponential of a larger matrix."""
    from scipy.linalg import expm

    n, p = g.shape
    large = np.zeros((n + 3 * p, n + 3 * p), dtype=np.result_type(f, g))
    large[:n, :n], large[:n, n : n + p] = h * f, h * g
    large[n : n + p, n + p : n + 2 * p] = large[n + p : n + 2 * p, n + 2 * p :] = np.eye(p)
    found = expm(large)[:n]
    return found[:, :n], found[:, n : n + p], found[:, n + p : n + 2 * p], found[:, n + 2 * p :]


def _in_frame(dynamics: Dynamics, outputs: Outputs) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """F, G, C, D of the frame: complex in dq, real pairs in the stationary one."""
    finite = dynamics.finite
    if dynamics.frame == "stationary":
        of_x, of_u = (np.kron(matrix, np.eye(2)) for matrix in outputs)
        return finite.f, finite.g, of_x @ finite.v, of_x @ finite.d + of_u
    turning = 1j * dynamics.w1_rad_s
    of_x, of_u = outputs
    direct = of_x @ (finite.d + turning * finite.k) + of_u
    return finite.f - turning * np.eye(len(finite.f)), finite.g + 0j, of_x @ finite.v + 0j, direct


def _paired(matrix: np.ndarray, dynamics: Dynamics) -> np.ndarray:
    """A matrix (..., r, c) of complex numbers as one of pairs; real pairs as they are."""
    if dynamics.frame == "stationary":
        return matrix
    pairs = np.stack(
        [np.stack([matrix.real, -matrix.imag], axis=-1), np.stack([matrix.imag, matrix.real], axis=-1)], axis=-3
    )
    return pairs.reshape(*matrix.shape[:-2], 2 * matrix.shape[-2], 2 * matrix.shape[-1])
