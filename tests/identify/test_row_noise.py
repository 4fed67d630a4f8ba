"""Rows trusted for what they are: the way between rows, noise seen in the misfit, rows that stand out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.fit.dq_data import DqData, to_dq
from seqsweep.identify.fit.least_squares import Problem
from seqsweep.identify.fit.local_rational import between_rows, local_rational
from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.order import left_out_hz, without_rows
from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse

from ..support import oracle
from .test_anchor import unstable_device
from .test_fit import F1_HZ, F_HZ, turbine


@pytest.mark.parametrize("points", [30, 90])
def test_the_way_between_rows_is_the_device_s_own(points: int) -> None:
    """A lightly damped pole, narrower than the rows, and its conjugate below f1: no row is at it."""
    pole, residue = -5.0 + 2j * np.pi * 33.3, np.array([[3.0, 1.0j], [-1.0, 2.0]])
    nu = np.geomspace(0.5, 1000.0, points)

    def y(at: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * at[:, None, None]
        return residue / (s - pole) + residue.conj() / (s - pole.conjugate()) + 0.01 * np.eye(2)

    middle = np.sqrt(nu[1:] * nu[:-1])
    found = between_rows(local_rational(DqData(nu, y(nu), None)), middle)
    assert np.max(np.linalg.norm(found - y(middle), axis=(1, 2)) / np.linalg.norm(y(middle), axis=(1, 2))) < 1e-6


def test_several_outlying_rows_are_named_and_cost_no_accuracy() -> None:
    response = turbine(noise=1e-3)
    wrong = [60, 70, 71]
    y = np.array(response.y)
    y[wrong] *= 1.3 + 0.2j
    model = fit_response(replace(response, y=y))
    for row in wrong:
        assert any(f"{abs(F_HZ[row] - F1_HZ):.4g} Hz" in note for note in model.notes), model.notes
    own = np.linalg.eigvals(oracle.linearise(0.65e6, 690.0).A)
    true = own[np.argmin(np.abs(own - (-27.5 + 141.3j)))]
    assert np.abs(model.poles - true).min() < 0.1


def test_noise_that_differs_from_row_to_row_buys_no_poles() -> None:
    """Rows near f1 fifty times noisier than the others, and no covariance that says so."""
    exact = unstable_device()
    nu = np.abs(exact.f_hz)
    level = 1e-4 + 5e-3 / (1.0 + nu / 10.0)
    rng = np.random.default_rng(5)
    noise = rng.standard_normal(exact.y.shape) + 1j * rng.standard_normal(exact.y.shape)
    size = np.linalg.norm(exact.y, axis=(1, 2))[:, None, None] / 2.0
    model = fit_response(replace(exact, y=exact.y + level[:, None, None] * size * noise), n_unstable=2)
    assert model.order <= 7
    assert model.n_unstable == 2


def test_a_table_without_outliers_loses_no_row() -> None:
    response = turbine(noise=1e-3, seed=3)
    assert len(fit_response(response).nu_hz) == len(to_dq(response).nu_hz)


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_a_pole_that_no_row_asks_for_goes_and_no_row_with_it(noise: float) -> None:
    """Two real poles and white noise: the search may end with a narrow pair beside them, where a row went with it."""
    nu = np.geomspace(0.5, 1500.0, 120)
    s = 2j * np.pi * nu[:, None, None]
    exact = np.array([[2.0, -1.0], [1.0, -0.05]]) / (1.0 + s / 300.0) + np.eye(2) * 0.4 * s / (s + 4000.0)
    std = noise * np.linalg.norm(exact, axis=(1, 2)) / 2.0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        y = exact + std[:, None, None] * (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)) / 2.0**0.5
        covariance = std[:, None, None] ** 2 / 2.0 * np.eye(8)
        model = fit_response(FrequencyResponse(F1_HZ + nu, dq_to_pn(y), F1_HZ, covariance=covariance))
        assert len(model.nu_hz) == len(nu)
        assert np.abs(model.poles[:, None] / np.array([-300.0, -4000.0]) - 1.0).min(axis=0).max() < 20.0 * noise


def test_an_outlying_row_beside_one_of_the_same_frequency_is_named() -> None:
    """At f and at its mirror image, measured by experiments of their own: once an IndexError."""
    s, y = 2j * np.pi * np.array([1.0, 2.0, 2.0, 3.0]), np.zeros((4, 4), dtype=complex)
    problem = Problem(s, y, np.ones((4, 4)), None, 1e-7, "relative", 1e-7)
    kept = [without_rows(problem, np.array([row])).s for row in range(4)]
    assert [left_out_hz(s, rest) for rest in kept] == pytest.approx([1.0, 2.0, 2.0, 3.0])
