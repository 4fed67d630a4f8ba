"""A mode between two rows: what it would have to be to matter, and what the rows say of it."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.fit.dq_data import DqData, to_dq
from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.rational import row_slopes
from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.rows import believed, rows_of
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune_point
from seqsweep.tuning.unseen import SHOWN, _columns, _evidence, _Harm, _harm, _left, _Places, overruled, unseen

F1_HZ = 50.0
MODE = -1.0 + 2j * np.pi * 30.0
BASE, RESIDUE = np.array([[2.0, 0.3], [-0.3, 2.0]]), np.exp(2j) * np.array([[0.5, 0.5j], [-0.5j, 0.5]])
GRID = SeriesRL(0.02, 0.3, F1_HZ)


def device(nu_hz: np.ndarray, size: float) -> np.ndarray:
    """A first-order device with one narrow mode at 30 Hz (dq), (n, 2, 2) in S."""
    s = 2j * np.pi * nu_hz[:, None, None]
    mode = RESIDUE / (s - MODE) + RESIDUE.conj() / (s - MODE.conjugate())
    return BASE / (1.0 + s / 400.0) + size * mode


def table(nu_hz: np.ndarray, size: float, noise: float, seed: int = 0) -> FrequencyResponse:
    """Rows above f1 with white noise of known covariance; the device rests on an ideal source."""
    rng = np.random.default_rng(seed)
    y = device(nu_hz, size)
    std = noise * np.linalg.norm(y, axis=(1, 2)) / 2.0
    y = y + std[:, None, None] * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2.0)
    covariance = std[:, None, None] ** 2 / 2.0 * np.eye(8)
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", "growth_bound_per_s": 0.7, "disturbed_s": 10.0}}
    return FrequencyResponse(F1_HZ + nu_hz, dq_to_pn(y), F1_HZ, covariance=covariance, meta=meta)


def unstable_poles(size: float) -> int:
    """By counting the turns of det(1 + Y Z) on a locus of a million points, the device itself being stable."""
    nu = np.concatenate([np.linspace(-60.0, 60.0, 700001), np.geomspace(60.0, 1e5, 2000)])
    nu = np.unique(np.concatenate([nu, -nu]))
    locus = np.linalg.det(np.eye(2) + device(nu, size) @ GRID.impedance_dq(2j * np.pi * nu))
    return -round(float(np.sum(np.angle(locus[1:] / locus[:-1])) / (2.0 * np.pi)))


AROUND = np.concatenate([np.geomspace(1.0, 27.0, 14), np.geomspace(33.0, 900.0, 16)])


def test_a_mode_between_two_rows_that_decides_keeps_a_stable_verdict_back() -> None:
    assert unstable_poles(4.0) == 2
    verdicts = [tune_point(table(AROUND, 4.0, 3e-2, seed), GRID) for seed in range(3)]
    assert {point.verdict for point in verdicts} <= {"undecided", "unstable"}


def test_noise_alone_asks_for_no_mode() -> None:
    """Between close rows; the mode's residue is zero."""
    assert unstable_poles(0.0) == 0
    rows = np.geomspace(1.0, 900.0, 60)
    for seed in range(3):
        response = table(rows, 0.0, 1e-2, seed)
        found = unseen(fit_response(response), to_dq(response), (GRID,), np.zeros(len(rows), dtype=bool))
        assert found is None or found.in_gap or found.evidence < SHOWN
        assert tune_point(response, GRID).verdict == "stable"


def test_a_row_that_would_decide_if_it_were_right_is_named() -> None:
    response = table(np.geomspace(1.0, 900.0, 60), 0.0, 1e-3)
    model, data = fit_response(response), to_dq(response)
    odd = data.y[20:21] - 3.0 * np.linalg.inv(GRID.impedance_dq(2j * np.pi * data.nu_hz[20:21]))
    assert overruled(model, DqData(data.nu_hz[20:21], odd, None), GRID) == pytest.approx(data.nu_hz[20])
    assert overruled(model, DqData(data.nu_hz[20:21], 1.001 * data.y[20:21], None), GRID) is None


def test_evidence_is_that_of_a_least_squares_of_fit_and_mode_together() -> None:
    """The slow twin: all columns in one `lstsq`."""
    response = table(np.geomspace(1.0, 900.0, 40), 0.3, 1e-2)
    model = fit_response(response, max_order=4)
    left, pole = _left(model, to_dq(response)), np.array([-1.0 + 2j * np.pi * 29.0])
    places = _Places(np.array([29.0]), pole, np.zeros(1), np.array([False]), np.full((1, 3), 29.0))
    evidence = _evidence(model, left, places, _Harm(np.zeros((1, 1, 8)), np.zeros((1, 1))))[0]
    everything = np.concatenate([row_slopes(model), _columns(model, pole)[0]], axis=1)
    everything = everything / np.linalg.norm(everything, axis=0)
    rest = left.misfit.ravel() - everything @ np.linalg.lstsq(everything, left.misfit.ravel(), rcond=1e-14)[0]
    freedom = left.misfit.size - len(model.covariance_root)
    assert evidence == pytest.approx(freedom * np.log(left.cost / np.sum(rest**2)), rel=1e-3)


def test_a_mode_matters_from_the_residue_on_with_which_it_crosses_the_axis() -> None:
    """Residues are counted as the exact locus does, 5 % to both sides; as large a one the other way does no harm."""
    model = fit_response(table(np.geomspace(1.0, 900.0, 40), 0.0, 0.0))
    at = np.array([MODE.imag / (2.0 * np.pi)])
    places = _Places(at, np.array([MODE]), np.zeros(1), np.array([True]), np.tile(at, (1, 3)))
    harm = _harm(model, (GRID,), places)
    residue = np.stack([RESIDUE.ravel().real, RESIDUE.ravel().imag], axis=1).ravel()
    with np.errstate(divide="ignore"):
        least = float(np.min(harm.needed / np.maximum(harm.push @ residue, 0.0)))
    assert [unstable_poles(size * least) for size in (0.95, 1.05, -1.05)] == [0, 2, 0]


def test_a_mode_that_the_grid_of_the_sweep_may_have_held_matters_on_a_stiffer_one() -> None:
    """A mode that grows by itself and that the weaker grid holds is as hard to exclude as one that decays and that the
    weaker grid lets grow."""
    response = table(np.geomspace(40.0, 900.0, 16), 0.0, 1e-2)
    model, data, nowhere = fit_response(response), to_dq(response), np.zeros(len(response), dtype=bool)
    stiff = SeriesRL(0.0002, 0.003, F1_HZ)
    alone, weak, both = (unseen(model, data, grids, nowhere) for grids in ((stiff,), (GRID,), (stiff, GRID)))
    assert weak is not None
    assert both is not None
    assert both.excess == pytest.approx(weak.excess, rel=0.1)
    assert alone is None or alone.excess < min(both.excess, weak.excess)


def test_of_two_rows_at_one_place_the_one_that_the_fit_misses_is_left_out() -> None:
    """At f and at its mirror image: what is judged has as many rows as the fit."""
    data, model = to_dq(table(AROUND, 0.0, 1e-3)), fit_response(table(AROUND, 0.0, 1e-3))
    for at in (4, 5):  # before or after the sound one
        twice = DqData(np.insert(data.nu_hz, at, data.nu_hz[4]), np.insert(data.y, at, 1.3 * data.y[4], axis=0), None)
        kept = believed(rows_of(twice), model)
        np.testing.assert_array_equal(kept.data.y, data.y)
        assert kept.left_out is not None
        np.testing.assert_array_equal(kept.left_out.y, 1.3 * data.y[4:5])
