"""Sparse rows without noise: the fit finds every mode of the device, whatever their width."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from verdict_families.linear import Bases
from verdict_families.rational_devices import draw_rational

from seqsweep.identify.fit.dq_data import to_dq
from seqsweep.identify.fit.exact_rows import from_interpolant
from seqsweep.identify.fit.least_squares import weighted
from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.order import select_order
from seqsweep.identify.fit.rational import evaluate
from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse

BASES = Bases(690.0, 2.75e6, 50.0)


def rows(seed: int, noise: float = 0.0) -> tuple[FrequencyResponse, np.ndarray, np.ndarray]:
    """A random device of order 4 to 18 behind 45 rows above f1; beside it the device exactly, between the rows."""
    rng = np.random.default_rng(seed)
    device = None
    while device is None or len(device.a) > 18:
        device, _ = draw_rational(rng, BASES)
    nu = np.geomspace(0.8, 1500.0, 45)
    y = device.admittance(nu)
    y = y * (1.0 + noise * rng.standard_normal(y.shape))
    middle = np.sqrt(nu[1:] * nu[:-1])
    response = FrequencyResponse(50.0 + nu, dq_to_pn(y), 50.0, meta={"stable_on": {"grid": "ideal"}})
    return response, middle, device.admittance(middle)


@pytest.mark.parametrize("seed", range(6))
def test_a_fit_of_sparse_exact_rows_is_exact_between_them(seed: int) -> None:
    response, middle, exact = rows(seed)
    found = evaluate(fit_response(response), 2j * np.pi * middle)
    error = np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert np.quantile(error, 0.9) < 1e-4


def test_noise_is_no_start() -> None:
    """With a thousandth of noise no interpolant describes the rows, and the search of the order is left alone."""
    data = to_dq(rows(0, 1e-3)[0])
    problem = weighted(data, 1e-7)
    trial = select_order(problem, 22, None)
    assert from_interpolant(problem, data, trial, 22) is trial


def test_rows_measured_twice_are_fitted_without_an_interpolant() -> None:
    """At f and at its mirror image, each with noise of its own and no covariance: once a crash."""
    response = rows(1, 1e-2)[0]
    mirrored = rows(1, 2e-2)[0]
    both = FrequencyResponse(
        np.concatenate([100.0 - mirrored.f_hz[19::-1], response.f_hz]),
        np.concatenate([np.conj(mirrored.y[19::-1])[:, ::-1, ::-1], response.y]),
        50.0,
        meta=response.meta,
    )
    assert fit_response(both).order > 0


def test_exact_rows_of_a_device_of_more_modes_than_are_tried_are_fitted_exactly() -> None:
    """The search of the order ends at 24; an interpolant of all rows finds the 26 poles."""
    rng = np.random.default_rng(5)
    poles = -2.0 * np.pi * np.geomspace(2.0, 900.0, 13) * (0.02 - 1j)
    residues = rng.normal(size=(13, 2, 2)) * np.abs(poles.real)[:, None, None]
    nu = np.unique(np.round(np.exp(rng.uniform(0.0, np.log(1500.0), 220)), 1))
    s = 2j * np.pi * nu[:, None, None, None]
    y = np.eye(2) + np.sum(residues / (s - poles[:, None, None]) + residues / (s - poles.conj()[:, None, None]), axis=1)
    found = fit_response(FrequencyResponse(50.0 + nu, dq_to_pn(y), 50.0, meta={"stable_on": {"grid": "ideal"}}))
    assert max(np.abs(found.poles - pole).min() / abs(pole) for pole in poles) < 1e-9


@pytest.mark.parametrize("seed", [0, 4])
def test_many_exact_rows_are_fitted_exactly_where_the_search_ended_by_itself(seed: int) -> None:
    """Pairs of real poles 0.5 % apart and a bare capacitor: the search of seed 4 ends at poles that are none."""
    rng = np.random.default_rng(seed)
    poles = np.array([-15.6, -23.9, -196.4, -198.5, -554.4, -557.2, -1627.9, -1636.9, -58.5 + 51.9j, -58.5 - 51.9j])
    real = rng.normal(size=(8, 2, 2)) * 0.3 * np.abs(poles[:8])[:, None, None]
    pair = 30.0 * (rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2)))
    residues = np.concatenate([real, [pair, pair.conj()]])
    nu = np.linspace(1.0, 2000.0, 221)
    s = 2j * np.pi * nu[:, None, None, None]
    capacitor = 1e-3 * s[:, 0] * np.eye(2) + 0.3 * np.array([[0.0, -1.0], [1.0, 0.0]])
    y = capacitor + np.sum(residues / (s - poles[:, None, None]), axis=1)
    found = fit_response(FrequencyResponse(50.0 + nu, dq_to_pn(y), 50.0, meta={"stable_on": {"grid": "ideal"}}))
    assert found.order == 10
    assert max(np.abs(found.poles - pole).min() / abs(pole) for pole in poles) < 1e-6


@pytest.mark.parametrize("n_unstable", [0, None])
def test_rows_that_are_met_exactly_keep_a_mode_whose_side_of_the_axis_they_hardly_tell(n_unstable: int | None) -> None:
    """A slow mode in a wide hole around f1, worth less than 1e-4 of every row: without it, all others were off."""
    nu = np.append(49.0, np.linspace(62.0, 1950.0, 18))
    s = 2j * np.pi * nu[:, None, None]
    ring, slow = -800.0 + 1300.0j, -0.9 + 4.2j
    y = 2e-4 * np.eye(2) + 900.0 / (s + 28.0) * np.array([[1.0, 0.3], [-0.3, 1.0]])
    for pole, residue in ((ring, np.array([[90.0, 40.0], [-40.0, 80.0]])), (slow, np.array([[0.5, 0.1], [0.2, 0.4]]))):
        y = y + residue / (s - pole) + residue / (s - np.conj(pole))
    found = fit_response(FrequencyResponse(50.0 + nu, dq_to_pn(y), 50.0), n_unstable=n_unstable)
    off = [np.abs(found.poles - pole).min() / abs(pole) for pole in (ring, slow)]
    assert off[0] < 1e-7
    assert off[1] < 1e-2


def sparse(order: int, nu_hz: np.ndarray, noise: float, seed: int) -> tuple[FrequencyResponse, np.ndarray]:
    """Fewer rows than a search of the order allows poles, with white noise; beside them the device's poles."""
    rng = np.random.default_rng(seed)
    poles = -2.0 * np.pi * np.geomspace(4.0, 700.0, order // 2) * (0.15 - 1j)
    residues = rng.normal(size=(order // 2, 2, 2)) * np.abs(poles.real)[:, None, None]
    s = 2j * np.pi * nu_hz[:, None, None, None]
    y = np.eye(2) + np.sum(residues / (s - poles[:, None, None]) + residues / (s - poles.conj()[:, None, None]), axis=1)
    y = y * (1.0 + noise * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)))
    return FrequencyResponse(50.0 + nu_hz, dq_to_pn(y), 50.0, meta={"stable_on": {"grid": "ideal"}}), poles


@pytest.mark.parametrize(("order", "n"), [(14, 16), (20, 19), (24, 24)])
def test_exact_rows_tell_more_than_one_pole_each(order: int, n: int) -> None:
    """Each row holds eight numbers, each pole asks for five: rows met to rounding are proved by what is left."""
    response, poles = sparse(order, np.geomspace(2.0, 1500.0, n), 0.0, seed=order)
    found = fit_response(response)
    assert found.order == order
    assert max(np.abs(found.poles - pole).min() / abs(pole) for pole in poles) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_rows_of_little_noise_tell_more_poles_than_the_search_takes(seed: int) -> None:
    """Of 20 rows the search takes 9 poles; the misfit asks for the 14 that are there."""
    response, poles = sparse(14, np.geomspace(2.0, 1500.0, 20), 3e-4, seed)
    found = fit_response(response)
    assert found.residual < 1e-3
    assert max(np.abs(found.poles - pole).min() / abs(pole) for pole in poles) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_noise_takes_no_pole_beyond_the_search(seed: int) -> None:
    """Twenty rows of a device of four poles, with noise, ask for no more than the search finds."""
    response, _ = sparse(4, np.geomspace(2.0, 1500.0, 20), 1e-2, seed)
    assert fit_response(response).order <= 6
