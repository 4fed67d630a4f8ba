"""The 2x2 solve: two independent experiments, the true mirror, the angle of the fundamental."""

from __future__ import annotations

import numpy as np


def solve_pn(v: np.ndarray, i: np.ndarray, phi1: float) -> tuple[np.ndarray, float]:
    """Sequence admittance at one frequency from two independent experiments; `solve_each` takes many at once.

    Parameters
    ----------
    v, i : (2, 2) complex
        Phasors of the perturbation alone (V, A; load direction): row = experiment, column = signed
        frequency f, 2 f1 - f.
    phi1 : float
        Angle of the fundamental voltage's space vector at time zero (rad).

    Returns
    -------
    y : (2, 2) complex
        Admittance in S; rows and columns (p at f, conjugate of n at 2 f1 - f).
    cond_v : float
        Condition number of the voltage matrix, each experiment scaled to unit length.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the experiments are exactly dependent.

    Notes
    -----
    ``[I(f), conj I(2 f1 - f)] = Y [V(f), conj V(2 f1 - f)]``, paper eq. (1); the second component
    is turned by ``exp(2j phi1)``, which refers it to the fundamental.
    """
    y, cond_v = solve_each(v[None], i[None], np.array([phi1]))
    return y[0], float(cond_v[0])


def solve_each(v: np.ndarray, i: np.ndarray, phi1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`solve_pn` of many frequencies: ``v`` and ``i`` (n, 2, 2), ``phi1`` (n,), to ``y`` (n, 2, 2) and ``cond_v`` (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the experiments of any of them are exactly dependent.
    """
    v_pn, i_pn = components(v, phi1), components(i, phi1)
    scale = np.linalg.norm(v_pn, axis=1)[:, None, :]
    if not np.all(scale > 0.0):
        raise np.linalg.LinAlgError("an experiment shows no voltage at its line")
    v_unit, i_unit = v_pn / scale, i_pn / scale
    y = np.linalg.solve(v_unit.transpose(0, 2, 1), i_unit.transpose(0, 2, 1)).transpose(0, 2, 1)
    return y, np.linalg.cond(v_unit)


def components(x: np.ndarray, phi1: float | np.ndarray) -> np.ndarray:
    """Phasors (..., n, 2) at f and 2 f1 - f as components (..., 2, n) of the pn frame.

    The second one is conjugated and turned by twice ``phi1`` (rad), one number for all or (...,), one for each.
    """
    turn = np.exp(2j * phi1)
    return np.stack([x[..., 0], np.conj(x[..., 1]) * turn[..., None]], axis=-2)
