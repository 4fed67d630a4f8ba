"""The reference turbine as a device: the linearisation of the tests, which shares nothing with the plant."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from .linear import Bases, Linear

BASES = Bases(690.0, 1.632e6, 50.0)


def oracle() -> Any:
    """The module of the tests that linearises the turbine."""
    folder = str(Path(__file__).resolve().parents[2] / "tests" / "support")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    import oracle as module

    return module


def linear_turbine(power_mw: float, voltage_pu: float) -> Linear:
    """The turbine at its machine's power (MW) and |v_pcc| (pu)."""
    found = oracle().linearise(power_mw * 1e6, voltage_pu * BASES.voltage_v)
    return Linear(found.A, found.B, found.C, found.D, 0.0, BASES.w1)


def draw_turbine(rng: np.random.Generator) -> tuple[Linear, str, tuple[float, float]]:
    """A random operating point: device, text, (MW, pu)."""
    point = (round(float(rng.uniform(0.05, 1.35)), 4), round(float(rng.uniform(0.85, 1.1)), 4))
    return linear_turbine(*point), f"dpmsg-v1 at {point[0]:g} MW, {point[1]:g} pu", point
