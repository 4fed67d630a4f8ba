"""Regions of Z: a verdict for all of them, or undecided; and members drawn at random that never contradict it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.rational import RationalModel
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.grids.regions import exclusion, regions_grid
from seqsweep.tuning.grids.series import SeriesRL
from seqsweep.tuning.poles import closed_loop_poles
from tests.support import oracle

F1_HZ = 50.0
NU = np.geomspace(0.4, 1950.0, 100)


@pytest.fixture(scope="module")
def model() -> RationalModel:
    y = oracle.admittance_pn(F1_HZ + NU, 0.65e6, 690.0)
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", "basis": "shots"}}
    return fit_response(FrequencyResponse(F1_HZ + NU, y, F1_HZ, meta=meta))


def boxes(x_low: float, x_high: float, r_low: float = 0.005, r_high: float = 0.03) -> dict:
    """Boxes for narrow bands up to 200 Hz, X growing with f, between two reactances at the fundamental."""
    edges = np.append(0.0, np.geomspace(2.0, 200.0, 60))
    return {
        "region": [
            {
                "f_min_hz": float(low),
                "f_max_hz": float(high),
                "r_ohm": [r_low, r_high],
                "x_ohm": [x_low * low / F1_HZ, x_high * high / F1_HZ],
            }
            for low, high in pairwise(edges)
        ]
    }


def test_a_region_of_strong_grids_is_stable_as_a_whole(model: RationalModel) -> None:
    """Every series R-L inside is stable by its own poles, as the exclusion of zero says without looking at them."""
    regions = regions_grid(boxes(0.08, 0.12), F1_HZ)
    assert exclusion(model, regions).excluded
    rng = np.random.default_rng(1)
    for _ in range(50):
        line = SeriesRL(rng.uniform(0.005, 0.03), rng.uniform(0.08, 0.12), F1_HZ)
        assert closed_loop_poles(model, line).real.max() < 0.0
    assert closed_loop_poles(model, regions.member).real.max() < 0.0


def test_a_region_across_the_edge_is_not_excluded(model: RationalModel) -> None:
    """X from 0.2 to 0.45 ohm holds stable and unstable grids."""
    found = exclusion(model, regions_grid(boxes(0.2, 0.45), F1_HZ))
    assert not found.excluded
    assert "Hz" in found.reason


def test_corners_alone_prove_nothing(model: RationalModel) -> None:
    """Zero lies in the hull of values at four pairs of corners none of which is near it."""
    found = exclusion(model, regions_grid(boxes(0.15, 0.4), F1_HZ))
    assert not found.excluded


def test_where_a_region_says_nothing_and_the_device_is_active_the_band_is_named(model: RationalModel) -> None:
    document = boxes(0.08, 0.12)
    document["region"] = [r for r in document["region"] if not 60.0 < r["f_min_hz"] < 80.0]
    found = exclusion(model, regions_grid({**document, "member": {"r_ohm": 0.012, "x_ohm": 0.1}}, F1_HZ))
    assert not found.excluded
    assert "no region is given" in found.reason


@pytest.mark.parametrize(
    ("shape", "member"),
    [
        ({"points": [[0.01, 0.2], [0.05, 0.2], [0.03, 0.3]]}, (0.03, 0.24)),
        ({"circle": [0.1, 0.3, 0.08]}, (0.1, 0.3)),
        ({"magnitude_ohm": [0.2, 0.3], "angle_deg": [70.0, 88.0]}, (0.05, 0.25)),
        ({"r_ohm": [0.0, 0.1], "x_ohm": [0.2, 0.3]}, (0.01, 0.25)),
    ],
)
def test_every_shape_is_read_and_knows_what_is_inside(shape: dict, member: tuple[float, float]) -> None:
    inside = {"r_ohm": member[0], "x_ohm": member[1]}
    grid = regions_grid({"region": [{"f_min_hz": 49.0, "f_max_hz": 51.0, **shape}], "member": inside}, F1_HZ)
    assert grid.corners_at(50.0) is not None
    assert grid.corners_at(500.0) is None
    with pytest.raises(GridError, match="outside the region"):
        regions_grid({"region": [{"f_min_hz": 49.0, "f_max_hz": 51.0, **shape}], "member": {"x_ohm": 0.9}}, F1_HZ)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({}, r"no \[\[region\]\]"),
        ({"region": [{"order": 1}]}, "needed are order"),
        ({"region": [{"f_min_hz": 9.0, "f_max_hz": 2.0, "points": [[0, 1]]}]}, "is no region"),
        ({"region": [{"order": 1, "points": [[-1.0, 1.0], [1.0, 1.0], [0.0, 2.0]]}]}, "negative resistance"),
        (
            {"region": [{"order": 1, "r_ohm": [0, 0.1], "x_ohm": [0.1, 0.2]}], "member": {"r_ohm": 0.1, "x_ohm": 5.0}},
            "outside the region",
        ),
    ],
)
def test_regions_that_are_none_are_refused(document: dict, words: str) -> None:
    with pytest.raises(GridError, match=words):
        regions_grid(document, F1_HZ)
