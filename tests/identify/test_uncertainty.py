"""Covariances of the 2x2 against Monte Carlo, and Student's widening against the quantiles of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, f

from seqsweep.identify.admittance import components, solve_pn
from seqsweep.identify.uncertainty import propagate, real_covariance, scatter, student_factor

Y = np.array([[-0.17 - 1.9j, 0.22 + 1.5j], [0.2 + 1.5j, -0.17 - 2.2j]])
PHI1 = 0.7


def experiments(rng, n_trials, n_windows, noise):
    """Voltages and currents (trials, 2, windows, 2) of a device Y with circular noise on i, correlated by ``noise``."""
    v_pn = np.array([[1.0, 0.2j], [0.1, 1.0]])  # columns: experiments
    root = np.linalg.cholesky(noise)
    white = rng.normal(size=(n_trials, 2, n_windows, 2, 2)) @ [1.0, 1j] * np.sqrt(0.5)
    i_pn = (Y @ v_pn).T[None, :, None, :] + white @ root.T
    v = np.broadcast_to(phasors(v_pn.T[None, :, None, :]), i_pn.shape)
    return v, phasors(i_pn)


def phasors(x_pn):
    """Components of the pn frame back to phasors at f and at the mirror."""
    return np.stack([x_pn[..., 0], np.conj(x_pn[..., 1] * np.exp(-2j * PHI1))], axis=-1)


def identified(v, i):
    """Y (2, 2) and its covariance (8, 8) of one trial, (experiments, windows, 2) phasors."""
    n_windows = v.shape[1]
    mean_v, mean_i = v.mean(axis=1), i.mean(axis=1)
    y, _ = solve_pn(mean_v, mean_i, PHI1)
    noise, freedom = scatter(y, v, i, PHI1)
    return y, propagate(mean_v, noise / n_windows, PHI1), freedom


def test_components_and_phasors_are_inverse():
    x = np.array([[1.0 + 2j, 3.0 - 1j]])
    np.testing.assert_allclose(phasors(components(x, PHI1).T), x, rtol=1e-15)


def test_propagated_covariance_is_that_of_many_trials():
    rng = np.random.default_rng(1)
    noise = 1e-6 * np.array([[1.0, 0.4 + 0.3j], [0.4 - 0.3j, 2.0]])
    v, i = experiments(rng, 20_000, 1, noise)
    found = np.array([solve_pn(a[:, 0], b[:, 0], PHI1)[0] for a, b in zip(v, i, strict=True)])
    parts = np.ascontiguousarray(found.reshape(-1, 4)).view(float)
    expected = propagate(v[0, :, 0], noise, PHI1)
    # 20,000 trials leave a covariance known to about 1 % of its larger entries.
    np.testing.assert_allclose(np.cov(parts.T), expected, atol=0.03 * expected.max())


def test_scatter_finds_the_covariance_of_the_noise():
    rng = np.random.default_rng(2)
    noise = 1e-4 * np.array([[1.0, -0.5j], [0.5j, 3.0]])
    v, i = experiments(rng, 1, 4000, noise)
    found, freedom = scatter(identified(v[0], i[0])[0], v[0], i[0], PHI1)
    assert freedom == 2 * 3999
    np.testing.assert_allclose(found, noise, atol=0.1e-4)


@pytest.mark.parametrize("n_windows", [2, 3, 6])
def test_regions_hold_their_level_however_few_the_windows(n_windows):
    rng = np.random.default_rng(3)
    noise = 1e-6 * np.array([[1.0, 0.4], [0.4, 2.0]])
    v, i = experiments(rng, 2000, n_windows, noise)
    inside = []
    for a, b in zip(v, i, strict=True):
        y, covariance, freedom = identified(a, b)
        variance = student_factor(freedom) * np.diagonal(covariance).reshape(4, 2).sum(axis=1)
        inside.append(np.abs(y - Y).ravel() ** 2 < -np.log(0.05) * variance)
    # 2,000 trials of each of four elements: three standard errors are 1.5 %.
    np.testing.assert_allclose(np.mean(inside, axis=0), 0.95, atol=0.015)


@pytest.mark.parametrize("freedom", [1, 2, 7, 100])
def test_student_factor_is_the_ratio_of_the_quantiles(freedom):
    assert student_factor(freedom) == pytest.approx(f.ppf(0.95, 2, 2 * freedom) / (chi2.ppf(0.95, 2) / 2.0), rel=1e-9)


def test_one_window_has_no_variance():
    with pytest.raises(ValueError, match="at least two windows"):
        student_factor(0)


def test_real_form_of_a_circular_covariance_has_its_variances():
    gamma = np.array([[2.0, 1.0 + 0.5j], [1.0 - 0.5j, 3.0]])
    real = real_covariance(gamma)
    z = real[0::2, 0::2] + real[1::2, 1::2] + 1j * (real[1::2, 0::2] - real[0::2, 1::2])
    np.testing.assert_allclose(z, gamma)
    assert np.all(np.linalg.eigvalsh(real) > 0.0)
