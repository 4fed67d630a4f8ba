"""Both ends of the stable range: a droop-controlled unit is unstable on strong grids, by exact eigenvalues."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.registry import make_plant
from seqsweep.tuning.margins import StableRange
from seqsweep.tuning.result import to_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.text import format_table
from seqsweep.tuning.tune import tune

from ..support import inverter_oracle as oracle
from ..sweep.test_inverters import STIFF
from .test_tuning import F_HZ, on_grid

STABLE_Z_PU = 0.02 + 0.2j
"""SCR 5: the stiff droop unit is stable here."""


@pytest.fixture(scope="module")
def unit():
    """Rows of the unit, exact, its base impedance (ohm), and the rightmost closed-loop pole at a scale (rad/s)."""
    plant = make_plant("gfm-v1", STIFF)
    model = oracle.linearise(plant.parameters, "forming", 0.5 + 0.0j, 1.0)
    base_ohm = plant.base_impedance_ohm
    meta = {"op_id": "droop", "stable_on": _behind(STABLE_Z_PU * base_ohm)}
    response = FrequencyResponse(F_HZ, oracle.admittance_pn(model, F_HZ) / base_ohm, 50.0, meta=meta)
    return response, base_ohm, lambda scale: oracle.behind(plant.parameters, model, scale * STABLE_Z_PU).real.max()


def _behind(z_ohm: complex) -> dict[str, object]:
    return {"grid": {"r_ohm": z_ohm.real, "x_ohm": z_ohm.imag}, "basis": "stated"}


def _exact_edge(rightmost, stable: float, unstable: float) -> float:
    for _ in range(60):
        middle = np.sqrt(stable * unstable)
        stable, unstable = (middle, unstable) if rightmost(middle) < 0.0 else (stable, middle)
    return stable


def test_the_strongest_grid_is_found_and_no_k_is_proposed(unit) -> None:
    response, base_ohm, rightmost = unit
    grid = SeriesRL(STABLE_Z_PU.real * base_ohm, STABLE_Z_PU.imag * base_ohm, 50.0)
    assert rightmost(1.0) < 0.0 < rightmost(0.05)
    exact = _exact_edge(rightmost, 1.0, 0.05)
    scales = (1.0, 1.05 * exact, 0.95 * exact)
    result = tune([response], grid, scales=scales)
    assert [point.verdict for point in result.points] == ["stable", "stable", "unstable"]
    for point, scale in zip(result.points, scales, strict=True):
        assert point.stable_range is not None
        assert point.stable_range.low == pytest.approx(exact / scale, rel=1e-4)
        assert point.critical_scale == point.stable_range.low
        assert point.k is None
    entry = json.loads(json.dumps(to_json(result), allow_nan=False))["operating_points"][0]
    assert entry["stable_scales"][0] == pytest.approx(exact, rel=1e-4)
    assert "side of strong grids" in entry["missing"]["k"]
    text = format_table(result, 200)
    assert f"> x{exact:.3f}" in text
    assert "Z crit: > x is a lower end" in text
    assert "so that none is proposed; --confirm looks for its sign and size" in " ".join(text.split())


def test_a_device_that_only_fears_weak_grids_has_no_lower_end() -> None:
    (point,) = tune([on_grid(0.3e6)], SeriesRL(0.012, 0.25, 50.0)).points
    assert point.stable_range is not None
    assert point.stable_range.low is None
    assert point.stable_range.high == point.critical_scale
    assert not point.stable_range.averse


def test_the_nearest_end_is_nearest_by_its_ratio() -> None:
    assert StableRange(0.5, 1.9).nearest == 1.9
    assert StableRange(0.5, 2.1).averse
    assert StableRange(None, None).nearest is None
    both = replace(tune([on_grid(0.3e6)], SeriesRL(0.012, 0.25, 50.0)).points[0], stable_range=StableRange(0.5, 1.9))
    assert both.stable_range == (0.5, 1.9)
