"""The surrogate over operating points, against the exact linearisation of the reference turbine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.choosing import larger, smaller
from seqsweep.identify.surrogate.design import first_points, next_point
from seqsweep.identify.surrogate.index_sets import border, chebyshev_products, tips
from seqsweep.identify.surrogate.region import hulled
from seqsweep.identify.surrogate.sparse_rational import Data, Shape, fit_shape, predict
from seqsweep.identify.surrogate.store import (
    left_out,
    read_surrogate,
    surrogate_of,
    voltages_in_kv,
    write_surrogate,
)
from seqsweep.identify.surrogate.surrogate import (
    AXES,
    CONTRADICTS_ALIKE,
    Region,
    SurrogateError,
    build_surrogate,
    name_of,
)
from seqsweep.identify.table.read import Table, read_table
from seqsweep.identify.table.write import write_table
from seqsweep.tuning.region.loadflow import Situation, predicted_on
from seqsweep.tuning.siso import SeriesRL

from ..support import oracle, switching
from ..support.regions import BASES, TURBINE

F_HZ = 50.0 + np.logspace(-0.3, 2.9, 24)
REGION = Region(np.array([0.2, 0.0, 0.9]), np.array([1.3, 0.0, 1.1]))


@cache
def exact(power_mw: float, voltage_pu: float) -> np.ndarray:
    return oracle.admittance_pn(F_HZ, power_mw * 1e6, voltage_pu * 690.0)


def swept(points: np.ndarray, noise: float = 0.0, seed: int = 0) -> list[FrequencyResponse]:
    """Operating points as a sweep would find them, with relative ``noise`` and the covariance that says so."""
    random = np.random.default_rng(seed)
    return [_noisy(point, noise, random) for point in points]


def _noisy(point: np.ndarray, noise: float, random: np.random.Generator) -> FrequencyResponse:
    y = exact(point[0], point[2])
    size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
    errors = random.normal(size=(2, *y.shape))
    y = y + noise * size / np.sqrt(8.0) * (errors[0] + 1j * errors[1])
    covariance = (noise**2 / 8.0 * size**2) * np.eye(8)
    meta = {"op_id": name_of(point), **dict(zip(AXES, map(float, point), strict=True))}
    return FrequencyResponse(F_HZ, y, 50.0, covariance=covariance, meta=meta)


def relative_errors(surrogate, points: np.ndarray) -> np.ndarray:
    """(p, f) true errors relative to ||Y||; the surrogate is asked in the pn frame, as users are."""
    found = np.array([surrogate.response(point, F_HZ).y for point in points])
    truth = np.array([exact(point[0], point[2]) for point in points])
    return np.linalg.norm(found - truth, axis=(2, 3)) / np.linalg.norm(truth, axis=(2, 3))


def unseen(n: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return REGION.low + random.random((n, 3)) * (REGION.high - REGION.low)


def test_products_are_chebyshev_s():
    x = np.linspace(-1.0, 1.0, 7)
    found = chebyshev_products(np.column_stack([x, x]), [(0, 0), (3, 0), (2, 4)])
    angle = np.arccos(x)
    np.testing.assert_allclose(found[:, 1], np.cos(3 * angle), atol=1e-12)
    np.testing.assert_allclose(found[:, 2], np.cos(2 * angle) * np.cos(4 * angle), atol=1e-12)


def test_a_set_grows_along_its_border_alone():
    assert border([(0, 0), (1, 0)], 2, most=5) == [(0, 1), (2, 0)]


def test_a_set_loses_what_no_other_index_needs_and_never_its_constant():
    assert tips([(0, 0), (1, 0), (2, 0), (0, 1)]) == [(0, 1), (2, 0)]
    assert tips([(0, 0)]) == []


def test_a_shape_has_those_that_it_grew_from_among_its_smaller_ones():
    shape = Shape(((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 0)))
    assert len(larger(shape)) == 6
    assert all(shape in smaller(grown) for grown in larger(shape))


def test_left_out_errors_are_those_of_fits_without_the_sweep():
    """The closed form against the slow twin that really leaves each sweep out; a polynomial has equal weights."""
    random = np.random.default_rng(3)
    x = random.uniform(-1.0, 1.0, (9, 2))
    y = random.normal(size=(2, 9, 4)) + 1j * random.normal(size=(2, 9, 4))
    data = Data(x, y, 1.0 / np.linalg.norm(y, axis=2))
    shape = Shape(((0, 0), (0, 1), (1, 0)), ())
    fitted = fit_shape(data, shape)
    for j in range(9):
        rest = np.delete(np.arange(9), j)
        without = fit_shape(Data(x[rest], y[:, rest], data.weight[:, rest]), shape)
        missed = (y[:, j] - predict(without, x[j : j + 1]).y[0]) * data.weight[:, j, None]
        np.testing.assert_allclose(np.abs(fitted.left_out[:, j]), np.abs(missed), rtol=1e-6)


def test_a_rational_function_of_its_own_kind_is_found_to_rounding():
    random = np.random.default_rng(5)
    x = random.uniform(-1.0, 1.0, (14, 2))
    numerator = random.normal(size=(2, 3, 4)) + 1j * random.normal(size=(2, 3, 4))
    shape = Shape(((0, 0), (0, 1), (1, 0)), ((1, 0),))
    truth = np.einsum("mk,fke->fme", chebyshev_products(x, shape.numerator), numerator)
    truth = truth / (1.0 + (0.3 - 0.2j) * x[:, :1])
    fitted = fit_shape(Data(x, truth, 1.0 / np.linalg.norm(truth, axis=2)), shape)
    np.testing.assert_allclose(fitted.denominator, 0.3 - 0.2j, atol=1e-10)


def test_twelve_sweeps_predict_the_turbine_to_a_hundredth_of_a_per_cent():
    surrogate = build_surrogate(swept(np.vstack([first_points(REGION, 1), unseen(6, 2)])), region=REGION)
    assert relative_errors(surrogate, unseen(60, 7)).max() < 1e-4


@pytest.mark.parametrize("noise", [pytest.param(1e-4, marks=pytest.mark.evidence), 1e-2])
def test_regions_hold_the_truth_as_often_as_they_say(noise):
    held = []
    for seed in range(3):
        points = np.vstack([first_points(REGION, seed), unseen(6, 50 + seed)])
        surrogate = build_surrogate(swept(points, noise, seed), region=REGION)
        at = unseen(40, 100 + seed)
        held.append(np.mean(relative_errors(surrogate, at) <= surrogate.evaluate(at).relative))
    assert np.mean(held) > 0.9
    assert min(held) > 0.85


def test_the_next_point_is_where_the_bar_is_largest_and_sweeping_it_helps():
    points = first_points(REGION, 0)
    surrogate = build_surrogate(swept(points), region=REGION)
    at, bar = next_point(surrogate, REGION)
    assert surrogate.evaluate(at).relative.max() > 0.3 * bar
    after = build_surrogate(swept(np.vstack([points, at])), region=REGION)
    assert after.evaluate(at).relative.max() < 0.3 * surrogate.evaluate(at).relative.max()


def test_first_points_fill_their_levels_and_come_again_for_the_same_seed():
    points = first_points(REGION, 4)
    assert len(np.unique(points[:, 0])) == len(points)
    np.testing.assert_array_equal(points, first_points(REGION, 4))
    assert not np.array_equal(points, first_points(REGION, 5))


def test_a_point_outside_is_refused_by_its_axis():
    surrogate = build_surrogate(swept(first_points(REGION, 1)), region=REGION)
    with pytest.raises(SurrogateError, match=r"active_power_mw = 1.4 is outside the swept region, 0.2 to 1.3"):
        surrogate.evaluate(np.array([1.4, 0.0, 1.0]))


def test_between_the_rows_the_region_holds_the_truth():
    """At 200 frequencies on both sides of f1, and nothing beyond the rows."""
    surrogate = build_surrogate(swept(np.vstack([first_points(REGION, 1), unseen(6, 2)])), region=REGION)
    random = np.random.default_rng(6)
    nu = np.exp(random.uniform(np.log(surrogate.nu_hz[0]), np.log(surrogate.nu_hz[-1]), 200))
    f_hz = 50.0 + nu * random.choice([-1.0, 1.0], 200)
    f_hz = np.sort(f_hz)
    told = surrogate.response([0.6, 0.0, 1.0], f_hz)
    truth = oracle.admittance_pn(f_hz, 0.6e6, 690.0)
    off = np.linalg.norm(told.y - truth, axis=(1, 2))
    radius = 1.392 * np.sqrt(np.einsum("nii->n", np.asarray(told.covariance)) / 7.0)
    assert np.mean(off <= radius) > 0.95
    assert (off / np.linalg.norm(truth, axis=(1, 2))).max() < 0.05
    with pytest.raises(SurrogateError, match=r"\|f - f1\| = 2000 Hz lies outside of the swept rows"):
        surrogate.response([0.6, 0.0, 1.0], np.array([2050.0]))


def test_listed_points_speak_within_their_hull_and_a_box_does_throughout():
    points = np.vstack([first_points(REGION, 1), unseen(6, 2)])
    box = Region(points.min(axis=0), points.max(axis=0))
    hull = hulled(points, box)
    at = box.low + np.random.default_rng(3).random((400, 3)) * (box.high - box.low)
    inside = Delaunay(points[:, [0, 2]]).find_simplex(at[:, [0, 2]]) >= 0
    assert 0.3 < inside.mean() < 0.95
    np.testing.assert_array_equal(hull.holds(at), inside)
    assert box.holds(at).all()
    assert hull.holds(points).all()
    surrogate = build_surrogate(swept(points), region=hull)
    with pytest.raises(SurrogateError, match="outside of the convex hull of the listed operating points"):
        surrogate.evaluate(at[~inside])


def test_a_dispatch_of_listed_points_is_asked_for_at_the_voltage_that_the_grid_makes():
    """The hull does not reach 0.4 MW at the lowest voltage, where the load flow begins to search."""
    ends = [[0.3, 0.0, 1.0], [1.2, 0.0, 1.0], [0.7, 0.0, 0.9], [0.7, 0.0, 1.1]]
    diamond = np.array([*ends, [0.5, 0.0, 1.02], [0.9, 0.0, 0.97]])
    table = [TURBINE.swept(point, f_hz=F_HZ) for point in diamond]
    region = hulled(diamond, Region(diamond.min(axis=0), diamond.max(axis=0)))
    surrogate = build_surrogate(table, region=region, bases=BASES)
    grid = SeriesRL(0.01, 0.06, 50.0)
    found = predicted_on(surrogate, (0.4, 0.0), Situation("grid", grid, 1.0, 690.0))
    truth_v = oracle.terminal_voltage(0.4e6, grid.r_ohm, grid.l_h, 690.0)
    assert found.meta["terminal_voltage_pu"] == pytest.approx(truth_v / 690.0, abs=1e-3)
    with pytest.raises(SurrogateError, match=r"p2_q0: active_power_mw = 2 is outside the swept region"):
        predicted_on(surrogate, (2.0, 0.0), Situation("grid", grid, 1.0, 690.0))
    with pytest.raises(SurrogateError, match=r"p0.32_q0: \(P, Q, \|v\|\) = .* is outside of the convex hull"):
        predicted_on(surrogate, (0.32, 0.0), Situation("grid", grid, 1.05, 690.0))


BAD = {
    "too few": (lambda: swept(first_points(REGION, 1)[:3]), "holds 3 of the at least 4 operating points"),
    "twice": (lambda: swept(np.vstack([first_points(REGION, 1), first_points(REGION, 1)[:1]])), "is there twice"),
    "on a line": (
        lambda: swept(np.column_stack([np.linspace(0.3, 1.2, 6), np.zeros(6), np.linspace(0.9, 1.1, 6)])),
        "on a line of the region",
    ),
}


@pytest.mark.parametrize(("made", "words"), BAD.values(), ids=BAD)
def test_sweeps_that_say_too_little_are_refused(made, words):
    with pytest.raises(SurrogateError, match=words):
        build_surrogate(made())


@pytest.mark.parametrize(
    ("axis", "factor", "words"),
    [(0, 1000.0, "is it in kW"), (1, 1000.0, "is it in kvar"), (2, 690.0, "is it in V"), (2, 0.0, "is it in V")],
)
def test_operating_points_in_other_units_are_refused(axis, factor, words):
    responses = [
        replace(response, meta={**response.meta, AXES[axis]: factor * (response.meta[AXES[axis]] or 0.3)})
        for response in swept(first_points(REGION, 1))
    ]
    table = SimpleNamespace(responses=responses, meta={"bases": {"rated_power_va": 1.632e6}})
    with pytest.raises(SurrogateError, match=words):
        surrogate_of(table)


@pytest.mark.parametrize(
    ("rated_v", "voltages", "told"),
    [
        (690.0, (0.62, 0.66, 0.69, 0.75), "0.62 to 0.75 on a device of 0.69 kV: is it in kV"),
        (3300.0, (3.0, 3.3, 3.5, 3.6), "3 to 3.6 on a device of 3.3 kV: is it in kV"),
        (690.0, (0.6, 0.7, 0.8, 0.9), ""),  # a dip that ends near 1 pu
        (1000.0, (0.95, 1.0, 1.0, 1.05), ""),  # one number in both units
        (0.0, (0.62, 0.66, 0.69, 0.75), ""),
    ],
)
def test_terminal_voltages_that_look_like_kv_are_told(rated_v, voltages, told):
    responses = [SimpleNamespace(meta={"terminal_voltage_pu": v}) for v in voltages]
    said = voltages_in_kv(SimpleNamespace(responses=responses, meta={"bases": {"rated_voltage_v": rated_v}}))
    assert told in said if told else said == ""


def test_operating_points_without_a_usable_row_are_told_with_their_reason():
    responses = swept(first_points(REGION, 1))
    status, reason = np.full(len(F_HZ), "diverged"), np.full(len(F_HZ), "no steady state")
    for k in range(4):
        bad = FrequencyResponse(F_HZ, responses[k].y, 50.0, status=status, reason=reason, meta=responses[k].meta)
        responses[k] = bad
        table = SimpleNamespace(responses=responses, meta={})
        assert left_out(table).endswith("without a usable row (diverged: no steady state)")
    with pytest.raises(
        SurrogateError, match=r"2 operating points have usable rows, a surrogate needs 4; p0.2.*no steady"
    ):
        surrogate_of(table)
    assert left_out(SimpleNamespace(responses=swept(first_points(REGION, 1)), meta={})) == ""


def test_two_devices_in_one_table_contradict_each_other():
    points = np.vstack([first_points(REGION, 1), unseen(8, 2)])
    one = swept(points)
    assert build_surrogate(one, region=REGION).contradiction == 0.0
    other = [replace(r, y=r.y * (1.6 - 0.4j)) if k % 2 else r for k, r in enumerate(one)]
    assert build_surrogate(other, region=REGION).contradiction > 0.1


def test_devices_of_one_kind_with_other_gains_are_told_and_noise_is_not():
    """Left out, a sweep is missed by 5 % in the one table and by 3 % in the other."""
    points, gains = unseen(20, 2), [switching.smooth(np.random.default_rng(seed)) for seed in (2, 1002)]
    two = [switching.swept(point, gains[k % 2]) for k, point in enumerate(points)]
    noisy = [switching.swept(point, gains[0], noise=0.03) for point in points]
    assert build_surrogate(two).contradiction > CONTRADICTS_ALIKE
    told = build_surrogate(noisy)
    assert told.models[0].score > CONTRADICTS_ALIKE
    assert told.contradiction == 0.0


def test_a_bad_row_in_the_middle_costs_its_own_row():
    responses = swept(np.vstack([first_points(REGION, 1), unseen(6, 2)]))
    status = np.full(len(F_HZ), "ok", dtype="U12")
    status[5] = "noisy"
    y = responses[3].y.copy()
    y[5] *= 3.0
    bad = responses[3]
    responses[3] = FrequencyResponse(F_HZ, y, 50.0, status=np.where(status == "ok", "ok", "diverged"), meta=bad.meta)
    surrogate = build_surrogate(responses, region=REGION)
    assert relative_errors(surrogate, unseen(20, 7)).max() < 1e-3


def test_a_surrogate_is_read_back_as_it_was_written(tmp_path):
    responses = swept(np.vstack([first_points(REGION, 1), unseen(4, 2)]), 1e-5)
    meta = {
        "f1_hz": 50.0,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6},
        "power_meaning": "machine",
        "operating_points": [{"op_id": r.meta["op_id"], **{a: r.meta[a] for a in AXES}} for r in responses],
        "configuration": {},
        "plant": {"id": "dpmsg-v1"},
    }
    write_table(tmp_path / "y.parquet", responses, meta)
    table: Table = read_table(tmp_path / "y.parquet")
    made = build_surrogate(table.responses)
    write_surrogate(tmp_path / "s.parquet", made, table)
    again = read_surrogate(tmp_path / "s.parquet")
    at = unseen(5, 9)
    at[:, 2] = np.clip(at[:, 2], made.region.low[2], made.region.high[2])
    at = at[again.holds(at)]
    np.testing.assert_array_equal(again.evaluate(at).y, made.evaluate(at).y)
    np.testing.assert_array_equal(again.evaluate(at).radius, made.evaluate(at).radius)
