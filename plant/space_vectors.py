"""Three phases and their space vector: phase peak, no zero sequence."""

from __future__ import annotations

from math import sqrt

import numpy as np

PHASE_PEAK = sqrt(2.0 / 3.0)
"""Phase peak of a symmetric voltage over its line-to-line RMS."""

LINE_RMS = sqrt(1.5)
"""Line-to-line RMS of a symmetric voltage over its phase peak."""

PHASES = np.exp(-2j * np.pi * np.arange(3) / 3.0)
"""a, b, c of a space vector x are the real parts of ``x * PHASES``."""


def abc_of(x: np.ndarray) -> np.ndarray:
    """Phase quantities (..., 3) of space vectors (...) complex."""
    return (np.asarray(x)[..., None] * PHASES).real


def vector_of(x_abc: np.ndarray) -> np.ndarray:
    """Space vectors (...) complex of phase quantities (..., 3); what all three have in common drops out."""
    return np.asarray(x_abc) @ (2.0 / 3.0 * PHASES.conj())
