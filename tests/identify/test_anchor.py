"""What a disturbed run proved holds in the fit: no unstable pole of its own is free to be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import response_of

from ..support.sweeps import rows_of
from .test_fit import F1_HZ, F_HZ, circuit, noisy

IDEAL = {"stable_on": {"grid": "ideal", "basis": "shots"}}
UNSTABLE_PAIR = 17.0 + 84.0j  # in the dq frame, as a stiff grid-forming device's


def unstable_device(error: float = 0.0) -> FrequencyResponse:
    """A coupled device with one unstable pair of rank one, two stable pairs, and an error that is not real-rational."""
    s = 2j * np.pi * (F_HZ - F1_HZ)
    y = np.zeros((len(F_HZ), 2, 2), dtype=complex)
    for pole, left, right in (
        (UNSTABLE_PAIR, np.array([40.0, 10.0j]), np.array([1.0, 0.5 - 0.2j])),
        (-46.0 + 70.0j, np.array([60.0, -30.0j]), np.array([0.3, 1.0])),
        (-1400.0 + 5900.0j, np.array([2000.0, 900.0]), np.array([1.0, 1.0j])),
    ):
        residue = np.outer(left, right)
        y += residue / (s - pole)[:, None, None] + residue.conj() / (s - pole.conjugate())[:, None, None]
    y *= 1.0 + error * (s.imag / (2.0 * np.pi * 1000.0))[:, None, None] ** 2 * (1.0 + 0.3j)
    return FrequencyResponse(s.imag / (2.0 * np.pi), y, F1_HZ, frame="dq", meta={"op_id": "unstable"})


def test_turbine_swept_at_60_points_has_no_unstable_pole() -> None:
    """Its own shots end periodic; without that fact twelve poles of this table came out unstable, by 1e-6 of Y."""
    content = {
        "campaign": {"name": "anchor"},
        "plant": {"id": "dpmsg-v1"},
        "operating_point": [{"id": "p02", "active_power_mw": 0.2, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 60},
        "injection": {"kind": "series_voltage", "signal": "tone", "amplitude_pu": 0.002},
        "source": {"kind": "ideal"},
    }
    plant = make_plant("dpmsg-v1")
    plan = make_plan(Config.from_dict(content), plant)
    swept = response_of(plan, "p02", rows_of(plant, plan))
    model = fit_response(replace(swept, meta={**swept.meta, **IDEAL}))
    assert model.n_unstable == 0
    assert np.abs(model.poles - (-29.32 + 145.7j)).min() < 0.05


def test_proved_stable_means_that_every_pole_is() -> None:
    """Noise of a thousandth tempts the fit into the right half-plane; what experiment excludes is not open to it."""
    for seed in range(4):
        response = circuit(lambda s: 1.0 / (0.05 + s * 1e-3))
        y = noisy(response.y, 1e-3, seed)
        model = fit_response(FrequencyResponse(F_HZ, y, F1_HZ, meta=IDEAL))
        assert np.all(model.poles.real < 0.0)


@pytest.mark.parametrize("error", [0.0, 1e-6, 1e-5])
@pytest.mark.parametrize("known", [None, 2])
def test_a_true_instability_does_not_keep_spurious_ones(error: float, known: int | None) -> None:
    """Errors of a sweep, as small as the hold of a stepped device makes them, add no unstable pole and no rank."""
    model = fit_response(unstable_device(error), n_unstable=known)
    assert model.n_unstable == 2
    assert np.abs(model.poles - UNSTABLE_PAIR).min() < 0.01 + 1e4 * error


def test_count_that_experiment_proved_is_kept() -> None:
    assert fit_response(unstable_device(), n_unstable=0).n_unstable == 0


def test_misfits_below_the_stated_errors_buy_no_poles() -> None:
    """Rows that state errors of 1e-4 and hold a smooth systematic one of 1e-5: no mode is made of that."""
    exact = unstable_device()
    ripple = 1.0 + 1e-5 * np.sin(3.0 * np.log(F_HZ))[:, None, None]
    size = np.linalg.norm(exact.y, axis=(1, 2)) / 2.0
    covariance = (1e-4 * size)[:, None, None] ** 2 * np.eye(8)
    response = replace(exact, y=exact.y * ripple, covariance=covariance)
    assert fit_response(response, n_unstable=2).order == 6
