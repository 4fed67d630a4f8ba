"""Noise in the sweep: told from drift, averaged, carried to the covariance; devices that are not linear say so."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.settling import steady_mean, trend
from seqsweep.plant.rl_branch import RLBranch, admittance
from seqsweep.sweep.measure.linearity import compared, judged

from ..support import plants
from ..support.resonances import ResonantBank
from ..support.sweeps import errors, inside, planned, rows_of

F_HZ = [20.0, 70.0, 100.0, 130.0, 300.0]  # 100 and 300 Hz are harmonics of f1: the baseline's own noise counts there

STEP_S = 200e-6
"""The branch is exact at any step, and noise costs by the sample."""

LEVELS = ((1e-4, 0.005), (1e-3, 0.01), (1e-2, 0.02), (3e-2, 0.05))
"""Noise (rms over rated peak) and the amplitude (pu) that goes with it."""


def coverage(level, amplitude_pu, n_trials, first_seed=0):
    """Share of elements inside their 95 % regions, and the median relative standard error."""
    found, residuals = [], []
    for seed in range(first_seed, first_seed + n_trials):
        plant = plants.NoisyBranch(level, seed=seed, dt_s=STEP_S)
        sweep = {"probes": 0, "uncertainty": 0.1}
        rows = rows_of(plant, planned(plant, f_hz=F_HZ, sweep=sweep, injection={"amplitude_pu": amplitude_pu}))
        assert {row.status for row in rows} == {"ok"}
        found.append(inside(rows, admittance(plant, np.array(F_HZ))))
        residuals += [row.residual for row in rows]
    return float(np.mean(found)), float(np.median(residuals))


def test_regions_of_noisy_rows_hold_their_level():
    share, _ = coverage(1e-3, 0.01, 12)
    # 240 elements: three standard errors are 4 %.
    assert 0.91 <= share <= 0.99


@pytest.mark.evidence
@pytest.mark.parametrize(("level", "amplitude_pu"), LEVELS)
def test_regions_of_noisy_rows_over_2000_trials(level, amplitude_pu):
    share, residual = coverage(level, amplitude_pu, 400)  # of five rows each
    print(f"noise {level:g} of the peak, tone {amplitude_pu:g} pu: 95 % regions hold {share:.1%}, {residual:.1%} wide")
    assert 0.93 <= share <= 0.97


def test_what_is_asked_of_a_noisy_row_is_reached_or_said():
    plant = plants.NoisyBranch(1e-2, dt_s=STEP_S)
    loose, tight = (
        rows_of(
            plant,
            planned(
                plant,
                f_hz=[70.0],
                sweep={"uncertainty": uncertainty, "max_simulated_s": 20.0, "probes": 0},
                injection={"amplitude_pu": 0.02},
            ),
        )[0]
        for uncertainty in (0.02, 0.001)
    )
    assert loose.status == "ok"
    assert loose.residual <= 0.02
    assert tight.status == "noisy"
    assert "the standard error is 0.0" in tight.reason
    assert "0.001 is asked" in tight.reason
    assert tight.window_s > loose.window_s
    assert np.all(np.isfinite(tight.y))


def test_an_asynchronous_ripple_is_noise_and_does_no_harm():
    plant = plants.RippledBranch()
    rows = rows_of(plant, planned(plant, f_hz=F_HZ, injection={"amplitude_pu": 0.01}))
    assert {row.status for row in rows} == {"ok"}
    # 0.02 pu of ripple against 0.01 pu of tone: the tapers leave 1e-4 of it.
    assert errors(rows, admittance(plant, np.array(F_HZ))).max() <= 1e-4


def test_a_limit_cycle_is_swept_and_called_nonlinear_where_it_is():
    coarse, fine = plants.QuantisedConverter(5.0), plants.QuantisedConverter(0.001)
    plan = {"f_hz": [20.0, 130.0, 700.0], "injection": {"amplitude_pu": 0.01}}
    assert {row.status for row in rows_of(coarse, planned(coarse, **plan))} == {"nonlinear"}
    rows = rows_of(fine, planned(fine, **plan))
    assert {row.status for row in rows} == {"ok"}
    # Steps of 0.001 A against tones of some amperes.
    assert errors(rows, fine.exact(np.array(plan["f_hz"]))).max() <= 1e-4


@pytest.mark.parametrize("how", ["saturation", "dead_band"])
@pytest.mark.parametrize("signal", ["tone", "multisine"])
def test_a_bent_characteristic_turns_every_row_nonlinear(how, signal):
    plant = plants.BentBranch(how)
    injection = {"signal": signal, "amplitude_pu": 5e-4 if signal == "tone" else 2e-3}
    rows = rows_of(
        plant, planned(plant, sweep={"f_min_hz": 10.0, "f_max_hz": 800.0, "points": 12}, injection=injection)
    )
    assert {row.status for row in rows} == {"nonlinear"}
    assert min(row.linearity for row in rows) > 0.01
    assert "Y depends on the amplitude by" in rows[0].reason
    # The spread is in the regions: their radius is no smaller than it.
    assert all(np.sqrt(row.cov[0] + row.cov[8]) > 0.5 * row.linearity * abs(row.admittance[0, 0]) / 2 for row in rows)


def test_a_saturation_that_is_not_reached_changes_nothing():
    plant = plants.BentBranch("saturation", 0.01)
    rows = rows_of(plant, planned(plant, f_hz=[20.0, 130.0]))
    assert {row.status for row in rows} == {"ok"}
    assert max(row.linearity for row in rows) <= 1e-6


def test_rows_between_probes_take_the_larger_spread():
    plant = RLBranch()
    rows = rows_of(plant, planned(plant, f_hz=[10.0, 20.0, 30.0, 70.0, 80.0], sweep={"probes": 0}))
    assert all(np.isnan(row.linearity) for row in rows)
    bent = [
        compared(row, _scaled(row, by), 0.0) if by else row
        for row, by in zip(rows, (0.002, 0, 0.01, 0, 0.001), strict=True)
    ]
    told = [row.linearity for row in judged(bent, 1.0)]
    np.testing.assert_allclose(told, [0.002, 0.01, 0.01, 0.01, 0.001], rtol=1e-3)
    assert [row.status for row in judged(bent, 0.005)] == ["ok", "nonlinear", "nonlinear", "nonlinear", "ok"]


def _scaled(row, by):
    return row._replace(y=tuple((1.0 + by) * x for x in row.y))


# The judgements behind it


def test_a_trend_is_told_in_its_own_errors():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(200, 48, 2)) @ [1.0, 1j]
    assert max(trend(x)[1] for x in noise) < 6.0
    moved, errors_of = trend(noise[0] + 0.5 * np.arange(48))
    assert moved == pytest.approx(0.5 * 47, rel=0.1)
    assert errors_of > 6.0


def test_windows_before_rest_are_left_out():
    rng = np.random.default_rng(1)
    noise = 0.01 * rng.normal(size=(20, 2, 2)) @ [1.0, 1j]
    x = 1.0 + noise + np.exp(-np.arange(20))[:, None]
    found = steady_mean(np.ones((20, 2)), x, 0.01)
    assert found.agreed
    assert 10 <= len(found.i) <= 18
    assert abs(found.i.mean() - 1.0) < 0.01


def test_a_shot_that_moves_on_is_not_at_rest():
    rng = np.random.default_rng(2)
    x = 1.0 + 0.01 * rng.normal(size=(20, 2, 2)) @ [1.0, 1j] + 0.05 * np.arange(20)[:, None]
    assert not steady_mean(np.ones((20, 2)), x, 0.1).at_rest


def test_noise_that_only_the_perturbation_wakes_is_told_in_the_end():
    """Unperturbed this bank is quiet: its shots find no agreement, and are averaged when their time is over."""
    plant = ResonantBank(0.01, (110.0, 480.0), noise=2e-5)
    sweep = {"uncertainty": 0.05, "max_simulated_s": 8.0, "probes": 0}
    rows = rows_of(plant, planned(plant, f_hz=[20.0, 70.0, 130.0, 250.0], sweep=sweep))
    assert {row.status for row in rows} == {"ok"}
    assert errors(rows, plant.admittance(np.array([row.f_hz for row in rows]))).max() <= 0.02
    assert inside(rows, plant.admittance(np.array([row.f_hz for row in rows])), 0.999).all()
