"""Convex hulls of points in the complex plane, as far as regions of impedances need them."""

from __future__ import annotations

import numpy as np


def passive_part(corners: np.ndarray) -> np.ndarray:
    """Corners (k,) of what the convex hull of impedances has on the side of Re z >= 0; none where it has nothing.

    The hull meets the imaginary axis in one interval: its ends are the outermost of the points in which segments
    between corners of either side cross the axis.
    """
    left, right = corners[corners.real < 0.0], corners[corners.real >= 0.0]
    if not len(left) or not len(right):
        return right
    a, b = left[:, None], right[None, :]
    crossing = (a.imag * b.real - b.imag * a.real) / (b.real - a.real)
    return np.concatenate([right, 1j * np.array([crossing.min(), crossing.max()])])


def zero_outside(points: np.ndarray) -> tuple[bool, float]:
    """Whether zero is outside the convex hull of points (k,), and its distance from the hull."""
    angles = np.sort(np.angle(points))
    gaps = np.append(np.diff(angles), angles[0] + 2.0 * np.pi - angles[-1])
    widest = int(np.argmax(gaps))
    if gaps[widest] <= np.pi:
        return False, 0.0
    return True, distance_of_zero(points)


def distance_of_zero(points: np.ndarray) -> float:
    """Least distance of zero from the segments between points, which the hull's edges are among."""
    a, b = points[:, None], points[None, :]
    along = b - a
    part = np.clip(-(a * along.conj()).real / np.maximum(np.abs(along) ** 2, 1e-300), 0.0, 1.0)
    return float(np.abs(a + part * along).min())
