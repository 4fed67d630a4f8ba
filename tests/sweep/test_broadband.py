"""Broadband signals in the sweep: against the exact linearisation, in little simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.transient_modes import transients
from seqsweep.plant.rl_branch import RLBranch, admittance
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.excitation.odd_lines import SignalError
from seqsweep.sweep.measure.measure import measure

from ..support import plants
from ..support.oracle import admittance_pn
from ..support.sweeps import errors, inside, planned, rows_of

SWEEP = {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 100}
STEP_S = 200e-6
"""The branch is exact at any step, and noise costs by the sample."""

FEW = {"f_min_hz": 10.0, "f_max_hz": 800.0, "points": 12}


class Clocked(ReferenceTurbine):
    """The turbine, counting the simulated seconds of its perturbed runs."""

    perturbed_s = 0.0

    def run(self, jobs, n_steps):
        self.perturbed_s += sum(job.injection is not None for job in jobs) * n_steps * self.dt_s
        return super().run(jobs, n_steps)


def injection(signal, amplitude_pu, **more):
    return {"signal": signal, "amplitude_pu": amplitude_pu, **more}


@pytest.mark.parametrize(
    ("amplitude_pu", "tolerance", "median", "worst"), [(0.01, 1e-4, 1e-5, 5e-4), (0.002, 1e-5, 1e-6, 1e-5)]
)
def test_a_multisine_gives_100_points_in_ten_simulated_seconds(amplitude_pu, tolerance, median, worst):
    """The bar of 5e-4 and 1e-5 at 0.01 pu; at 0.002 pu what is left is the step's own warping, 3e-6 at 740 Hz."""
    plant = Clocked()
    sweep = {**SWEEP, "tolerance": tolerance}
    rows = rows_of(plant, planned(plant, sweep=sweep, injection=injection("multisine", amplitude_pu)))
    error = errors(rows, admittance_pn(np.array([row.f_hz for row in rows]), 0.65e6, 690.0))
    print(
        f"\n  multisine of {amplitude_pu:g} pu: {len(rows)} points in {plant.perturbed_s:.1f} simulated s, "
        f"median {np.median(error):.1e}, largest {error.max():.1e}",
        end="",
    )
    assert {row.status for row in rows} == {"ok"}
    assert len(rows) == 100
    assert plant.perturbed_s <= 10.0 + 1e-9
    assert np.median(error) <= median
    assert error.max() <= worst


def test_what_a_multisine_says_of_its_distortion_is_the_size_of_its_error():
    plant = ReferenceTurbine()
    rows = rows_of(plant, planned(plant, sweep={**SWEEP, "tolerance": 1e-4}, injection=injection("multisine", 0.05)))
    error = errors(rows, admittance_pn(np.array([row.f_hz for row in rows]), 0.65e6, 690.0))
    linearity = np.array([row.linearity for row in rows])
    # At 0.05 pu distortion is all the error there is; level by level it is a random sum, known to a factor.
    assert 0.3 < np.median(error / linearity) < 3.0
    assert np.mean(error <= 10.0 * linearity) > 0.95


@pytest.mark.parametrize("signal", ["prbs", "qrb", "chirp"])
def test_every_other_signal_finds_the_turbine_too(signal):
    plant = ReferenceTurbine()
    sweep = {"f_min_hz": 5.0, "f_max_hz": 250.0, "points": 20, "tolerance": 1e-4}
    rows = rows_of(plant, planned(plant, sweep=sweep, injection=injection(signal, 0.01)))
    error = errors(rows, admittance_pn(np.array([row.f_hz for row in rows]), 0.65e6, 690.0))
    assert {row.status for row in rows} == {"ok"}
    # 0.01 pu: what is left is distortion, which nothing but a multisine keeps off its lines.
    assert np.median(error) <= 3e-5
    assert error.max() <= 3e-4


@pytest.mark.parametrize("kind", ["series_voltage", "shunt_current"])
def test_a_multisine_works_behind_a_grid(kind):
    plant = RLBranch()
    plan = planned(
        plant,
        sweep=FEW,
        injection=injection("multisine", 0.01, kind=kind),
        source={"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25},
    )
    rows = rows_of(plant, plan)
    # A linear device: only rounding is left.
    assert errors(rows, admittance(plant, np.array([row.f_hz for row in rows]))).max() <= 1e-8


def test_regions_of_a_noisy_multisine_hold_their_level():
    found = []
    for seed in range(12):
        plant = plants.NoisyBranch(1e-3, seed=seed, dt_s=STEP_S)
        rows = rows_of(plant, planned(plant, sweep={**FEW, "uncertainty": 0.2}, injection=injection("multisine", 0.02)))
        found.append(inside(rows, admittance(plant, np.array([row.f_hz for row in rows]))))
    # 12 x 12 x 4 elements, a pair of neighbours from the same data: three standard errors are 4 %.
    assert 0.91 <= np.mean(found) <= 0.99


def test_a_slow_mode_is_told_from_the_period_it_outlasts():
    """Slow, fast and real modes under lines of their own: what two periods show is enough for all of them."""
    time_s = 1e-3 * np.arange(2000)
    modes = np.exp(np.multiply.outer([-0.8 + 4j, -13.0 + 160j, -0.3], time_s))
    shares = np.array([[1.0, 0.3, 0.2], [0.5j, 0.1, -0.4]])
    decaying = (shares @ modes).real
    periodic = np.sin(2.0 * np.pi * np.multiply.outer([3.0, 7.0], time_s))
    before, after = np.split(decaying + periodic, 2, axis=1)
    found = np.concatenate(transients(before, after, 1e-3), axis=1)
    np.testing.assert_allclose(found, decaying, atol=1e-7)


def test_what_repeats_has_no_transient():
    x = np.sin(np.arange(1000.0)).reshape(1, -1)
    assert not np.any(transients(x, x, 1e-3))


# What cannot work


@pytest.mark.parametrize(
    ("sweep", "how", "words"),
    [
        (
            {"f_hz": [20.0, 51.0]},
            injection("multisine", 0.01),
            "20 Hz is no odd multiple of 1 Hz away from f1.*19 or 21",
        ),
        ({"f_hz": [51.0, 51.01]}, injection("multisine", 0.01), "two listed frequencies share a line"),
        ({"f_hz": [50.0]}, injection("qrb", 0.01), "fundamental itself"),
        (FEW, injection("multisine", 0.01, period_s=0.513), "not whole periods of f1 = 50 Hz.*0.5 s or 0.52 s"),
        ({**SWEEP, "points": 900}, injection("multisine", 0.01), "900 points.*period of"),
        (FEW, injection("multisine", 1e-6), "leaves .* pu for a line"),
        ({"f_min_hz": 1.0, "f_max_hz": 12000.0, "points": 20}, injection("chirp", 0.01), "Nyquist"),
    ],
)
def test_a_signal_that_cannot_do_it_says_what_could(sweep, how, words):
    with pytest.raises(SignalError, match=words):
        planned(RLBranch(), sweep=sweep, injection=how)


def test_a_plant_that_fails_under_a_broadband_signal_costs_the_operating_point():
    plant = plants.FailingRecordingBranch("raises")
    plan = planned(plant, sweep=FEW, injection=injection("multisine", 0.01))
    (batch,) = plan.batches()
    assert {(row.status, row.reason) for row in measure(plant, batch).rows} == {("failed", "the converter tripped")}
