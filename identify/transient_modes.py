"""What is left of a transient in a period, from the difference of two periods.

Under a periodic excitation a linear device answers with a periodic signal and decaying exponentials. The difference of
two successive periods holds the exponentials alone: they are found by a subspace method, and continued into the later
period in closed form. A slow mode then costs its share of two periods, not the seconds it takes to die out.
"""

from __future__ import annotations

import numpy as np

SAMPLES = 100
"""Samples of a period after averaging: enough for the modes slow enough to outlast the settling."""

MAX_MODES = 12

ABOVE_REST = 10.0
"""A singular value so many times above the median of the others is a mode's."""

ROUNDING = 1e-10
"""What changes by less, relatively, repeats exactly."""

REPEATS = 0.02
"""A mode whose factor over a period is this close to one is a constant as far as two periods can tell."""


def transients(before: np.ndarray, after: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """The decaying parts of two successive periods.

    Parameters
    ----------
    before, after : (c, n) float
        Two successive periods of real channels that share their modes (the frame must be one in which the
        device is time-invariant and real: dq). A channel counts as much as it changes.
    dt_s : float
        Sampling step (s).

    Returns
    -------
    of_before, of_after : (c, n) float
        To be subtracted from the periods; zero where no mode stands out of the noise.

    Notes
    -----
    A mode exp(lambda t) of the earlier period shows as exp(lambda t) (g - 1) in the difference, g = exp(lambda T),
    and as exp(lambda t) g in the later one. Modes that grow, or hardly decay, are left alone.
    """
    difference = after - before
    if not np.linalg.norm(difference) > ROUNDING * np.linalg.norm(after):  # NaN, too
        return np.zeros_like(after), np.zeros_like(after)
    poles = _modes(difference, dt_s)
    factor = np.exp(poles * dt_s * after.shape[1])
    decays = (np.abs(factor) < 1.0) & (np.abs(factor - 1.0) > REPEATS)
    poles, factor = poles[decays], factor[decays]
    shapes = np.exp(np.multiply.outer(dt_s * np.arange(after.shape[1]), poles))
    shares = np.linalg.lstsq(shapes, difference.T.astype(complex), rcond=None)[0]
    of_before = shares / (factor - 1.0)[:, None]
    return (shapes @ of_before).real.T, (shapes @ (of_before * factor[:, None])).real.T


def _modes(x: np.ndarray, dt_s: float) -> np.ndarray:
    """Exponents (m,) in rad/s shared by the channels ``x`` (c, n): the rotational invariance of their subspace."""
    step = max(1, x.shape[1] // SAMPLES)
    whole = x.shape[1] // step * step
    averaged = x[:, :whole].reshape(len(x), -1, step).mean(axis=2)
    rows = averaged.shape[1] // 3
    stacked = np.concatenate([np.lib.stride_tricks.sliding_window_view(channel, rows) for channel in averaged])
    small = np.asarray(np.linalg.qr(stacked, mode="r")).T  # as many singular values and vectors, for less
    u, singular, _ = np.linalg.svd(small)
    order = int(np.sum(singular[:MAX_MODES] > ABOVE_REST * np.median(singular)))
    turn = np.linalg.lstsq(u[:-1, :order], u[1:, :order], rcond=None)[0]
    return np.log(np.linalg.eigvals(turn).astype(complex)) / (step * dt_s)
