"""What a model may lack: products that the sweeps do not tell from those that it has."""

from __future__ import annotations

import numpy as np

from seqsweep.identify.surrogate.certainty import all_alike, certainty, what_each_tells
from seqsweep.identify.surrogate.design import WIDER, next_point
from seqsweep.identify.surrogate.piece import piece_of
from seqsweep.identify.surrogate.sparse_rational import Data, Shape, fit_shape
from seqsweep.identify.surrogate.surrogate import Chosen, build_surrogate

from ..support.regions import PQV, TURBINE, errors_of, unseen

PLANE = Shape(((0, 0), (0, 1), (1, 0)), ())
CROSS = np.array(
    [[1.0, 0.0], [-1.0, 0.02], [0.5, 0.0], [-0.5, -0.02], [0.02, 1.0], [0.0, -1.0], [-0.02, 0.5], [0.0, 0.0]]
)
CORNER = np.array([[1.0, 1.0]])


def plane_with(x):
    """A device of a constant and two slopes but for 1e-6, modelled as such from sweeps x (m, 2)."""
    random = np.random.default_rng(3)
    y = (1.0 + 0.3 * x[:, 0] - 0.2j * x[:, 1])[None, :, None] * np.array([1.0, 0.1, 0.1j, 1.0])
    y = np.repeat(y, 5, axis=0) * (1.0 + 1e-6 * random.normal(size=(5, len(x), 4)))
    data = Data(x, y, 1.0 / np.linalg.norm(y, axis=2))
    fitted = fit_shape(data, PLANE)
    return piece_of((fitted,), data, None)


def caution_of(piece, x):
    """How many times the radius is larger for what the model may lack."""
    return (piece.cautious.evaluate(x)[1] / piece.evaluate(x)[1]).max()


def test_a_product_that_no_sweep_tells_is_in_the_cautious_radius():
    """On a cross xy is next to nothing at every sweep, whatever its coefficient."""
    assert caution_of(plane_with(CROSS), CORNER) > 10.0


def test_where_the_sweeps_tell_every_product_caution_costs_little():
    grid = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    assert 1.0 <= caution_of(plane_with(grid), CORNER) < 2.0


def test_caution_leaves_the_prediction_alone():
    piece = plane_with(CROSS)
    assert np.array_equal(piece.cautious.evaluate(CORNER)[0], piece.evaluate(CORNER)[0])


def test_a_region_of_few_free_sweeps_is_as_cautious_as_its_certificate():
    """Five sweeps leave a plane two: what they show may be small by luck."""
    few, more = plane_with(CROSS[[0, 1, 4, 5, 7]]), plane_with(CROSS)
    assert np.array_equal(few.evaluate(CORNER)[1], few.cautious.evaluate(CORNER)[1])
    assert more.evaluate(CORNER)[1].max() < more.cautious.evaluate(CORNER)[1].max()


def test_no_region_is_smaller_than_rounding():
    """A device that the model meets exactly, but for the rounding of its three products."""
    y = (1.0 + 0.3 * CROSS[:, 0] - 0.2j * CROSS[:, 1])[None, :, None] * np.array([1.0, 0.1, 0.1j, 1.0])
    data = Data(CROSS, y, 1.0 / np.linalg.norm(y, axis=2))
    radius = piece_of((fit_shape(data, PLANE),), data, None).evaluate(CORNER)[1]
    assert radius.min() >= 3.0 * np.finfo(float).eps


def lacking_of(x, y, counts):
    """What a plane through sweeps x (m, 2) of Y (m, 4) lacks, relative to ||Y||^2, sweeps counted by ``counts``."""
    data = Data(x, y[None], 1.0 / np.linalg.norm(y, axis=1)[None])
    fitted = fit_shape(data, PLANE)
    return certainty(fitted, data, None, counts(fitted, data)).lacking[0]


def residual_variance(x, y):
    """The textbook's: sum of squares over sweeps without coefficients, by an ordinary least squares."""
    weight = 1.0 / np.linalg.norm(y, axis=1)[:, None]
    columns = weight * np.column_stack([np.ones(len(x)), x])
    off = weight * y - columns @ np.linalg.lstsq(columns, weight * y, rcond=None)[0]
    return np.sum(np.abs(off) ** 2) / (len(x) - 3)


def test_counted_by_what_each_tells_sweeps_show_the_residual_over_its_degrees_of_freedom():
    """Whatever their leverages are; half of it is what the model lacks everywhere."""
    random = np.random.default_rng(5)
    y = np.array([1.0, 0.1, 0.1j, 1.0]) + random.normal(size=(len(CROSS), 4, 2)) @ [1e-3, 1e-3j]
    assert np.isclose(lacking_of(CROSS, y, what_each_tells), 0.5 * residual_variance(CROSS, y), rtol=1e-6)


def test_a_sweep_that_holds_a_corner_alone_counts_for_less():
    """Without it the model extrapolates over ten times the distance; on the safe side it counts in full."""
    near = 0.1 * np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    x = np.vstack([near, CORNER])
    y = (1.0 + 0.01 * x[:, 0] * x[:, 1])[:, None] * np.array([1.0, 0.1, 0.1j, 1.0])
    assert lacking_of(x, y, what_each_tells) < 0.75 * lacking_of(x, y, all_alike)


BLIND = np.transpose(
    [
        [1.25, 0.2, 0.87, 1.3, 0.25, 0.41, 1.09, 0.63, 0.2, 0.23, 0.2, 0.2],
        [-0.25, 0.25, 0.09, -0.4, 0.4, -0.36, 0.36, -0.09, -0.4, 0.08, 0.0, 0.4],
        [1.02, 1.06, 1.09, 0.9, 0.91, 1.1, 0.94, 0.98, 0.9, 0.92, 0.98, 1.1],
    ]
)
"""Twelve points (MW, Mvar, pu) that a region was certified from while a product hid among those of `LACKING`."""

LACKING = Shape(
    ((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 0, 3), (0, 1, 0), (0, 1, 1), (1, 0, 0), (1, 0, 1), (2, 0, 0)),
    ((0, 0, 1), (0, 0, 2), (1, 0, 0)),
)
"""What a search that follows its last step alone finds at these points."""


def test_a_turbine_that_hides_a_product_from_twelve_sweeps_is_not_certified():
    surrogate = build_surrogate([TURBINE.swept(point) for point in BLIND], Chosen(None, ((LACKING,),)), PQV)
    off = off_by(surrogate)
    assert off > 1e-4
    assert WIDER * surrogate.worst_bar[0] > off
    assert WIDER * next_point(surrogate, PQV)[1] > 1e-4


def test_the_product_that_was_hidden_is_found_among_the_best_of_every_size():
    """The same twelve sweeps determine the turbine to rounding; without the product 2.3e-4 is off."""
    surrogate = build_surrogate([TURBINE.swept(point) for point in BLIND], region=PQV)
    off = off_by(surrogate)
    assert off < 1e-8
    assert WIDER * surrogate.worst_bar[0] > off


def off_by(surrogate):
    """The largest true error over sixty unseen points, relative to ||Y||."""
    points = unseen(PQV, 60, 20250)
    return errors_of(surrogate, points, np.array([TURBINE.exact(point) for point in points]))[0].max()
