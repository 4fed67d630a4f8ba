"""Regions of Z: a verdict for all of them, or undecided; and members drawn at random that never contradict it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.rational import RationalModel
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.grids.exclusion import critical_growth, exclusion
from seqsweep.tuning.grids.hull import distance_of_zero, passive_part, zero_outside
from seqsweep.tuning.grids.regions import RegionGrid, regions_grid
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


def test_the_distance_is_that_of_the_nearest_member_and_growth_ends_where_an_unstable_one_comes_in(
    model: RationalModel,
) -> None:
    """No member, corner or not, has a smaller |det(1 + Y Z)| where the device is active, |f - f1| below 28 Hz."""
    regions = regions_grid({**boxes(0.08, 0.12), "member": {"r_ohm": 0.012, "x_ohm": 0.1}}, F1_HZ)
    distance = exclusion(model, regions).distance
    assert 0.0 < distance < 1.0
    rng, nu = np.random.default_rng(3), np.geomspace(1.0, 28.0, 200)
    y = oracle.admittance_pn(F1_HZ + nu, 0.65e6, 690.0)
    least = np.inf
    for _ in range(100):
        z = [np.array([inside(regions, abs(f), rng) for f in F1_HZ + sign * nu]) for sign in (1.0, -1.0)]
        z1, z2 = z[0], np.where(nu < F1_HZ, z[1].conj(), z[1])
        value = (1.0 + y[:, 0, 0] * z1) * (1.0 + y[:, 1, 1] * z2) - y[:, 0, 1] * y[:, 1, 0] * z1 * z2
        least = min(least, float(np.abs(value).min()))
    assert distance <= least + 1e-3  # the model's own error
    growth = critical_growth(model, regions)
    assert growth is not None
    assert growth > 1.0
    assert exclusion(model, replace(regions, growth=growth)).excluded
    assert not exclusion(model, replace(regions, growth=1.02 * growth)).excluded
    edge = next(x for x in np.arange(0.1, 1.0, 0.002) if is_unstable(model, x))
    assert growth < (edge - 0.1) / 0.02  # a line that is unstable lies in regions grown so far


def inside(regions: RegionGrid, f_hz: float, rng: np.random.Generator) -> complex:
    """Some impedance that the regions allow."""
    corners = regions.corners_at(f_hz)
    assert corners is not None
    return complex(rng.dirichlet(np.full(len(corners), 0.5)) @ corners)


def is_unstable(model: RationalModel, x_ohm: float) -> bool:
    """By the poles of the device on a line of 0.012 ohm and so much reactance."""
    return bool(closed_loop_poles(model, SeriesRL(0.012, float(x_ohm), F1_HZ)).real.max() > 0.0)


def test_a_region_across_the_edge_is_decided_where_it_is_smaller(model: RationalModel) -> None:
    regions = regions_grid({**boxes(0.2, 0.45), "member": {"r_ohm": 0.012, "x_ohm": 0.25}}, F1_HZ)
    growth = critical_growth(model, regions)
    assert growth is not None
    assert 0.0 < growth < 1.0
    assert exclusion(model, regions).distance == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_the_passive_part_of_a_hull_holds_every_passive_point_of_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.standard_normal(7) + 0.5 + 1j * rng.standard_normal(7)
    part = passive_part(corners)
    assert part.real.min() >= 0.0
    for _ in range(50):
        point = rng.dirichlet(np.ones(7)) @ corners
        if point.real > 0.0:
            assert not zero_outside(part - point)[0] or distance_of_zero(part - point) < 1e-12


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
        ({"region": [{"order": 1, "circle": [0.1, 0.2]}]}, r"circle = \[0.1, 0.2\]: needed are 3 numbers"),
        ({"region": [{"order": 1, "r_ohm": [0.1, "x"], "x_ohm": [0.1, 0.2]}]}, "r_ohm = .* needed are 2 numbers"),
        ({"region": [{"order": 1, "r_ohm": [0.0, 0.1]}]}, "x_ohm is missing"),
        ({"region": [{"order": 1, "points": [[0.1, 0.2], [0.1]]}]}, r"points: \[0.1\] is no corner"),
        ({"region": [{"f_min_hz": 0, "f_max_hz": 2500, "r_ohm": [0, 0.1], "x_ohm": [0.1, 0.2]}]}, r"give a \[member\]"),
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
