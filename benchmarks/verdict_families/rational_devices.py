"""Random stable devices of order 4 to 24 with lightly damped modes: partial fractions with real coefficients."""

from __future__ import annotations

import numpy as np

from .linear import Bases, Linear, behind_inductor, in_si


def draw_rational(rng: np.random.Generator, bases: Bases) -> tuple[Linear, str]:
    """Modes of rank one or two, resistance at the end of the band; half of them stand behind an inductor."""
    order = int(rng.integers(2, 13)) * 2
    a, b, c, left = [], [], [], order
    while left > 0:
        rank = 2 if left >= 4 and rng.random() < 0.3 else 1
        oscillates = left >= 2 * rank and rng.random() < 0.85
        pole = _pole(rng, oscillates)
        size = abs(pole.real) * np.exp(rng.normal(-0.5, 0.8))
        for _ in range(rank):
            a.append(_block(pole))
            b.append(_random_rows(rng, len(a[-1])))
            c.append(size * _random_rows(rng, len(a[-1])).T)
            left -= len(a[-1])
    from scipy.linalg import block_diag

    d = float(np.exp(rng.uniform(np.log(0.05), np.log(1.0)))) * np.eye(2)
    device = in_si(block_diag(*a), np.vstack(b), np.hstack(c), d, 0.0, bases)
    text = f"random device of order {order}"
    if rng.random() < 0.5:
        return device, text
    x = rng.uniform(0.05, 0.2) * bases.z_ohm
    return behind_inductor(device, 0.05 * x, x), f"{text} behind an inductor"


def _pole(rng: np.random.Generator, oscillates: bool) -> complex:
    w = 2.0 * np.pi * float(np.exp(rng.uniform(np.log(1.0), np.log(700.0))))
    if not oscillates:
        return complex(-w)
    zeta = float(np.exp(rng.uniform(np.log(0.005), np.log(0.4))))
    return complex(-zeta * w, w * np.sqrt(1.0 - zeta**2))


def _block(pole: complex) -> np.ndarray:
    if pole.imag == 0.0:
        return np.array([[pole.real]])
    return np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])


def _random_rows(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 2) of about unit size."""
    x = rng.normal(size=(n, 2))
    return x / np.sqrt(2.0)
