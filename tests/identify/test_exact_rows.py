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
    assert from_interpolant(problem, data, trial) is trial


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
