"""Comparison of two tables, against chi-squared's own statistics and known differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.comparison import compare
from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.errors import SeqsweepError

from ..support import oracle

F_HZ = 50.0 + np.geomspace(0.5, 900.0, 60)
Y = oracle.admittance_pn(F_HZ, 0.6e6, 690.0)
SIZE = np.linalg.norm(Y, axis=(1, 2))[:, None, None]


def measured(noise: float, seed: int, factor: complex = 1.0, rows=slice(None), stated: float | None = None):
    random = np.random.default_rng(seed)
    errors = random.normal(size=(2, *Y.shape)) * noise * SIZE / np.sqrt(8.0)
    covariance = ((noise if stated is None else stated) * SIZE) ** 2 / 8.0 * np.eye(8)
    y = factor * Y + errors[0] + 1j * errors[1]
    return FrequencyResponse(F_HZ[rows], y[rows], 50.0, covariance=covariance[rows], meta={"op_id": "p"})


def test_noise_alone_is_agreement_as_often_as_the_level_says():
    """Each band's probability is uniform: about one in ten below 0.1, and bands at 0.01 agree in all but a few."""
    found = [compare(measured(1e-2, 2 * k), measured(1e-2, 2 * k + 1)) for k in range(60)]
    chances = np.array([band.probability for each in found for band in each.bands])
    assert 0.04 < np.mean(chances < 0.1) < 0.17
    assert np.mean([each.agrees for each in found]) > 0.85


def test_a_difference_of_three_standard_errors_everywhere_is_found():
    assert not compare(measured(1e-3, 1), measured(1e-3, 2, factor=1.003)).agrees


def test_a_difference_below_the_tolerance_is_none_however_small_the_stated_errors_are():
    a, b = measured(1e-9, 1), measured(1e-9, 2, factor=1.0 + 5e-5)
    assert compare(a, b, tolerance=1e-4).agrees
    assert not compare(a, b, tolerance=1e-5).agrees


def test_decibels_and_degrees_are_those_of_the_factor():
    comparison = compare(measured(0.0, 1, factor=1.1 * np.exp(0.1j)), measured(0.0, 2), tolerance=0.0)
    assert max(band.largest_db for band in comparison.bands) == pytest.approx(20.0 * np.log10(1.1), rel=1e-9)
    assert max(band.largest_deg for band in comparison.bands) == pytest.approx(np.degrees(0.1), rel=1e-9)


def test_a_recorded_fundamental_is_the_nominal_one_up_to_what_a_record_tells():
    a, b = measured(1e-3, 1), measured(1e-3, 2)
    assert compare(a, replace(b, f1_hz=50.0 - 5e-7)).agrees
    with pytest.raises(SeqsweepError, match=r"the fundamentals are 50 and 50\.1 Hz"):
        compare(a, replace(b, f1_hz=50.1))


def test_rows_of_another_grid_are_held_against_the_interpolation():
    comparison = compare(measured(1e-5, 1, rows=slice(0, None, 3)), measured(1e-5, 2, rows=slice(1, None, 3)))
    assert comparison.interpolated.all()
    assert comparison.agrees
    assert comparison.relative.max() < 1e-3


def test_without_covariances_only_the_tolerance_speaks():
    bare = FrequencyResponse(F_HZ, Y, 50.0, meta={"op_id": "p"})
    other = FrequencyResponse(F_HZ, 1.01 * Y, 50.0, meta={"op_id": "p"})
    assert compare(bare, bare).agrees
    assert not compare(bare, other).agrees
    assert all(np.isnan(band.probability) for band in compare(bare, other).bands)


def test_tables_that_share_nothing_are_refused():
    low = FrequencyResponse(F_HZ[:5], Y[:5], 50.0, meta={"op_id": "p"})
    high = FrequencyResponse(F_HZ[-5:], Y[-5:], 50.0, meta={"op_id": "p"})
    with pytest.raises(ValueError, match="no frequencies in common"):
        compare(low, high)
    with pytest.raises(ValueError, match="not one device"):
        compare(low, FrequencyResponse(F_HZ[:5], Y[:5], 60.0))


def test_a_second_table_too_short_to_interpolate_is_refused_with_the_way_out():
    many, few = measured(1e-5, 1), measured(1e-5, 2, rows=slice(10, 50, 12))
    between = FrequencyResponse(few.f_hz * 1.001, few.y, 50.0, covariance=few.covariance, meta={"op_id": "p"})
    with pytest.raises(ValueError, match=r"second table has 4 usable rows.* name the table with more rows second"):
        compare(many, between)
    assert compare(between, many, tolerance=0.1).agrees
