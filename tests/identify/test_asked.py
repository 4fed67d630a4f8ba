"""Values at any frequency with the error that is stated, impedance and dq with their covariances."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.views.asked import Look, as_asked, value_at
from seqsweep.plant.errors import SeqsweepError

from ..support import oracle

F_HZ = 50.0 + np.concatenate([-np.geomspace(1.0, 49.0, 25)[::-1], np.geomspace(1.3, 900.0, 60)])


def response(f_hz=F_HZ, noise=0.0, seed=0):
    y = oracle.admittance_pn(f_hz, 0.6e6, 690.0)
    random = np.random.default_rng(seed)
    size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
    y = y + noise * size * (random.normal(size=y.shape) + 1j * random.normal(size=y.shape)) / np.sqrt(8.0)
    covariance = (max(noise, 1e-7) * size) ** 2 / 8.0 * np.eye(8)
    return FrequencyResponse(f_hz, y, 50.0, covariance=covariance, meta={"op_id": "p"})


def test_a_row_is_given_as_it_stands():
    rows = response()
    value = value_at(rows, float(rows.f_hz[30]))
    assert value.between_hz is None
    assert value.error == 0.0
    assert np.array_equal(value.y, rows.y[30])


def test_between_the_rows_the_stated_error_holds():
    """Against the exact linearisation at frequencies by lot: the error of leaving rows out is that or more."""
    random = np.random.default_rng(7)
    rows = response()
    held = 0
    for f in random.uniform(3.0, 900.0, 12):
        value = value_at(rows, float(f))
        truth = oracle.admittance_pn(np.array([f]), 0.6e6, 690.0)[0]
        missed = np.linalg.norm(value.y - truth) / np.linalg.norm(truth)
        held += missed <= 2.0 * value.error + 1e-6
    assert held >= 11


def test_nothing_is_extrapolated():
    with pytest.raises(SeqsweepError, match=r"lies outside of its usable rows, 1 to 950 Hz"):
        value_at(response(), 2000.0)
    with pytest.raises(SeqsweepError, match="too few to interpolate"):
        value_at(response(F_HZ[:3]), float(F_HZ[:2].mean()))


def test_nearer_to_f1_than_every_row_nothing_is_told():
    """The turbine's slow modes turn Y within a hertz of f1, and no row shows it."""
    rows = response()
    nearest = float(np.abs(rows.f_hz - 50.0).min())
    for f in (50.0, 50.0 - 0.9 * nearest, 50.0 + 0.9 * nearest):
        with pytest.raises(SeqsweepError, match="nearer to f1 than every usable row"):
            value_at(rows, f)


def test_impedance_is_the_inverse_and_its_covariance_is_that_of_many_draws():
    rows = response()[40]
    shown = as_asked(rows, Look(impedance=True))
    assert shown.y[0] @ rows.y[0] == pytest.approx(np.eye(2), abs=1e-12)
    random = np.random.default_rng(3)
    wide = np.asarray(rows.covariance)[0] * 1e6
    draws = random.multivariate_normal(np.zeros(8), wide, 40_000).reshape(-1, 4, 2)
    z = np.linalg.inv(rows.y[0] + (draws[..., 0] + 1j * draws[..., 1]).reshape(-1, 2, 2)).reshape(-1, 4)
    seen = np.cov(np.stack([z.real, z.imag], axis=2).reshape(-1, 8).T)
    stated = np.asarray(shown.covariance)[0] * 1e6
    assert np.linalg.norm(seen - stated) < 0.05 * np.linalg.norm(stated)


def test_dq_folds_rows_below_f1_onto_those_above():
    """Ydq(-nu) is the conjugate of Ydq(nu): a pair of rows at f1 -+ nu gives one row, and the same."""
    rows = response(np.array([20.0, 30.0, 70.0, 400.0]))
    shown = as_asked(rows, Look(dq=True))
    assert shown.f_hz == pytest.approx([20.0, 30.0, 350.0])
    alone = as_asked(response(np.array([30.0])), Look(dq=True))
    assert alone.y[0] == pytest.approx(shown.y[0], rel=1e-9)
    exact = rows.to_frame("dq")
    assert shown.y[2] == pytest.approx(exact.y[3])


def test_dq_carries_the_covariance():
    rows = response()[60]
    shown = as_asked(rows, Look(dq=True))
    random = np.random.default_rng(5)
    draws = random.multivariate_normal(np.zeros(8), np.asarray(rows.covariance)[0], 40_000).reshape(-1, 4, 2)
    from seqsweep.identify.frames import pn_to_dq

    y = pn_to_dq(rows.y[0] + (draws[..., 0] + 1j * draws[..., 1]).reshape(-1, 2, 2)).reshape(-1, 4)
    seen = np.cov(np.stack([y.real, y.imag], axis=2).reshape(-1, 8).T)
    assert np.linalg.norm(seen - np.asarray(shown.covariance)[0]) < 0.05 * np.linalg.norm(seen)


def test_f1_itself_has_no_value_in_dq():
    with pytest.raises(SeqsweepError, match="at f1 itself"):
        value_at(response(np.array([20.0, 50.0, 90.0])), 50.0, Look(dq=True))
