"""From sequence (pn) to synchronous (dq) admittances and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..plant.errors import SeqsweepError
from .response import Frame, FrequencyResponse

T = np.array([[1.0, 1.0j], [1.0, -1.0j]])
"""``Ypn(s) = T Ydq(s - j w1) T^-1``."""

T_INVERSE = np.linalg.inv(T)


def pn_to_dq(y: np.ndarray) -> np.ndarray:
    """``T^-1 Y T`` of an admittance (..., 2, 2) in S; it then belongs to the frequency f - f1."""
    return T_INVERSE @ y @ T


def dq_to_pn(y: np.ndarray) -> np.ndarray:
    """``T Y T^-1`` of an admittance (..., 2, 2) in S; it then belongs to the frequency f + f1."""
    return T @ y @ T_INVERSE


def to_frame(response: FrequencyResponse, frame: Frame) -> FrequencyResponse:
    """The response in ``frame`` ("pn" or "dq"); frequencies move by f1 and covariances are lost.

    Raises
    ------
    SeqsweepError
        If the frame is unknown.
    """
    if frame not in ("pn", "dq"):
        raise SeqsweepError(f"frame is {frame!r}; known: 'pn', 'dq'")
    if frame == response.frame:
        return response
    convert, shift = (pn_to_dq, -response.f1_hz) if frame == "dq" else (dq_to_pn, response.f1_hz)
    return replace(response, f_hz=response.f_hz + shift, y=convert(response.y), frame=frame, covariance=None)
