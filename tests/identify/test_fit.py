"""The rational fit: closed forms, the exact linearisation, calibrated errors, an independent fit, refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.fit.dq_data import to_dq
from seqsweep.identify.fit.least_squares import costs_without, held, solve_residues, trial_at, weighted
from seqsweep.identify.fit.model import MIN_POINTS, fit_response
from seqsweep.identify.fit.partial_fractions import basis
from seqsweep.identify.fit.rational import RationalModel, derivative, evaluate, evaluate_pn, gradient
from seqsweep.identify.response import FrequencyResponse

from ..support import oracle

F1_HZ = 50.0
U_V = 690.0
W1 = 2.0 * np.pi * F1_HZ
F_HZ = np.geomspace(1.0, 1000.0, 100)
T_PN = np.array([[1.0, 1j], [1.0, -1j]])


def noisy(y: np.ndarray, relative: float, seed: int) -> np.ndarray:
    """Independent circular noise of a relative standard deviation on every element."""
    rng = np.random.default_rng(seed)
    return y * (1.0 + relative * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)) / np.sqrt(2.0))


def turbine(
    power_w: float = 0.65e6,
    voltage_v: float = 690.0,
    *,
    f_hz: np.ndarray = F_HZ,
    noise: float = 0.0,
    seed: int = 0,
    **fields: object,
) -> FrequencyResponse:
    """The reference turbine's table row by row, from its exact linearisation."""
    y = noisy(oracle.admittance_pn(f_hz, power_w, voltage_v), noise, seed)
    meta = {
        "op_id": f"p{power_w / 1e3:03.0f}",
        "active_power_mw": power_w / 1e6,
        "terminal_voltage_pu": voltage_v / 690.0,
    }
    return FrequencyResponse(f_hz, y, F1_HZ, meta=meta, **fields)


def circuit(y_of_s: Callable[[np.ndarray], np.ndarray], noise: float = 0.0) -> FrequencyResponse:
    """A balanced circuit: no coupling, the second component sees the mirror frequency."""
    y = np.zeros((len(F_HZ), 2, 2), dtype=complex)
    y[:, 0, 0] = y_of_s(2j * np.pi * F_HZ)
    y[:, 1, 1] = y_of_s(2j * np.pi * F_HZ - 2j * W1)
    return FrequencyResponse(F_HZ, noisy(y, noise, 1), F1_HZ, meta={"op_id": "circuit"})


def relative_error(model: RationalModel, f_hz: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.linalg.norm(evaluate_pn(model, f_hz) - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2))


def test_fit_agrees_with_the_linearisation_between_the_swept_frequencies() -> None:
    f = np.geomspace(1.3, 990.0, 333)
    error = relative_error(fit_response(turbine()), f, oracle.admittance_pn(f, 0.65e6, 690.0))
    assert error.max() < 1e-9  # the floor of the order selection is 1e-7


def test_poles_of_the_fit_are_the_device_s_own() -> None:
    model = fit_response(turbine())
    own = np.linalg.eigvals(oracle.linearise(0.65e6, 690.0).A)
    near = np.abs(model.poles) < 1e4  # the shunt's pole is at -1e5 rad/s, outside the band
    distance = np.abs(model.poles[near, None] - own).min(axis=1)
    assert model.order == 10
    assert np.all(distance < 1e-3)


def test_branch_gives_one_pair_of_rank_one_and_no_constant() -> None:
    model = fit_response(circuit(lambda s: 1.0 / (0.05 + s * 1e-3)))
    assert model.order == 2
    assert model.tail == 0
    assert model.ranks.tolist() == [1, 1]
    np.testing.assert_allclose(model.poles[0], -50.0 + 1j * W1, rtol=1e-9)


def test_capacitor_asks_for_a_slope() -> None:
    model = fit_response(circuit(lambda s: s * 5e-4))
    assert model.tail == 2
    np.testing.assert_allclose(model.e, 5e-4 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(model.d, 5e-4 * W1 * np.array([[0.0, -1.0], [1.0, 0.0]]), atol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_unstable_device_is_counted_not_mended(noise: float) -> None:
    model = fit_response(circuit(lambda s: 1.0 / (-0.05 + s * 1e-3), noise))
    assert model.n_unstable == 2
    assert any("unstable on an ideal source" in note for note in model.notes)


def test_noise_is_not_taken_for_modes() -> None:
    orders = [fit_response(turbine(noise=1e-3, seed=seed)).order for seed in range(20)]
    assert set(orders) == {7}  # shunt, filter, PLL and DC link; the filter's two pairs are one at 0.1 %


def test_row_that_disagrees_with_its_neighbours_is_left_out_and_named() -> None:
    """One row off by 5 %: it would ask for a mode of its own, on the edge of stability, at just that frequency."""
    y = turbine(noise=1e-3).y.copy()
    row = int(np.argmin(np.abs(F_HZ - 76.0)))
    y[row] *= 1.05
    model = fit_response(FrequencyResponse(F_HZ, y, F1_HZ))
    assert model.order == 7
    assert len(model.nu_hz) == len(F_HZ) - 1
    assert f"|f - f1| = {F_HZ[row] - F1_HZ:.4g} Hz does not agree with its neighbours" in model.notes[0]


def test_faint_systematic_error_makes_no_unstable_device() -> None:
    """1e-5 at 1 kHz, growing with f^2 and not real-rational: the fit follows it with poles of no meaning."""
    y = turbine().y * (1.0 + 1e-5 * (F_HZ / 1000.0) ** 2 * (1.0 + 0.3j))[:, None, None]
    model = fit_response(FrequencyResponse(F_HZ, y, F1_HZ))
    assert model.n_unstable == 0
    assert "left out of the fit" in model.remarks[0]


def test_standard_errors_of_the_poles_are_calibrated() -> None:
    """80 trials leave 8 % of doubt on a standard deviation; the noise is not quite the one of the weights."""
    own = np.linalg.eigvals(oracle.linearise(0.65e6, 690.0).A)
    true = own[np.argmin(np.abs(own - (-27.5 + 141.3j)))]
    scores = []
    for seed in range(40):
        model = fit_response(turbine(noise=1e-3, seed=seed))
        k = int(np.argmin(np.abs(model.poles - true)))
        error, std = model.poles[k] - true, model.pole_std[k]
        scores += [error.real / std.real, error.imag / std.imag]
    assert 0.7 < np.std(scores) < 1.3


def test_gradient_is_the_derivative_of_the_model() -> None:
    model = fit_response(turbine(noise=1e-3))
    s, weight = np.array([0.3 + 170j]), np.array([[[0.7, 0.2j], [-0.4, 1.1 - 0.3j]]])

    def weighed(m: RationalModel) -> complex:
        return complex(np.sum(weight * evaluate(m, s)))

    g = gradient(model, s, weight)[0]
    n_real = int(np.sum(model.poles.imag == 0.0))
    n_pair = (model.order - n_real) // 2
    h = 1e-4
    shift_real, shift_pair = np.zeros(model.order, dtype=complex), np.zeros(model.order, dtype=complex)
    shift_real[0] = h
    shift_pair[n_real], shift_pair[n_real + n_pair] = 1j * h, -1j * h
    for index, shift in ((0, shift_real), (n_real + n_pair, shift_pair)):
        by_difference = (
            weighed(replace(model, poles=model.poles + shift)) - weighed(replace(model, poles=model.poles - shift))
        ) / (2.0 * h)
        assert abs(g[index] - by_difference) < 1e-6 * abs(by_difference) + 1e-12
    assert abs(g[-1] - weight[0, 1, 1]) < 1e-15  # the constant of qq
    by_difference = (evaluate(model, s + h) - evaluate(model, s - h))[0] / (2.0 * h)
    np.testing.assert_allclose(derivative(model, complex(s[0])), by_difference, rtol=1e-6)


def test_covariance_of_the_table_sets_the_weights() -> None:
    """Half the points ten times worse: with their covariance known the fit is as good as without them."""
    exact = oracle.admittance_pn(F_HZ, 0.65e6, 690.0)
    std = np.abs(exact) * np.where(np.arange(len(F_HZ)) % 2, 1e-3, 1e-2)[:, None, None]
    rng = np.random.default_rng(3)
    y = exact + std * (rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)) / np.sqrt(2.0)
    covariance = np.array([np.diag(np.repeat(row.ravel() ** 2 / 2.0, 2)) for row in std])
    known = fit_response(FrequencyResponse(F_HZ, y, F1_HZ, covariance=covariance))
    unknown = fit_response(FrequencyResponse(F_HZ, y, F1_HZ))
    assert known.weighting == "covariance"
    assert 0.8 < known.residual < 1.2  # in standard deviations
    assert np.median(relative_error(known, F_HZ, exact)) < 0.5 * np.median(relative_error(unknown, F_HZ, exact))


def test_rows_that_are_not_ok_leave_no_trace() -> None:
    bad = np.arange(len(F_HZ)) % 7 == 0
    y = oracle.admittance_pn(F_HZ, 0.65e6, 690.0)
    y[bad] = 1e3
    y[3] = np.nan
    status = np.where(bad, "noisy", "ok")
    response = FrequencyResponse(F_HZ, y, F1_HZ, status=status)
    assert len(to_dq(response).nu_hz) == np.sum(~bad) - 1
    assert fit_response(response).residual < 1e-9


def test_both_frames_give_the_same_model() -> None:
    pn = turbine()
    y_dq = np.linalg.inv(T_PN) @ pn.y @ T_PN
    a, b = fit_response(pn), fit_response(FrequencyResponse(pn.f_hz - F1_HZ, y_dq, F1_HZ, frame="dq"))
    f = np.array([10.0, 76.0, 300.0])
    np.testing.assert_allclose(evaluate_pn(a, f), evaluate_pn(b, f), rtol=1e-9)


def test_neighbouring_model_is_a_good_start() -> None:
    start = fit_response(turbine(0.60e6))
    warm = fit_response(turbine(0.65e6), start=start)
    assert warm.order == 10
    assert warm.residual < 1e-9


def test_too_few_rows_are_refused() -> None:
    with pytest.raises(ValueError, match=f"5 of 5 rows are usable; a rational model needs at least {MIN_POINTS}"):
        fit_response(turbine(f_hz=np.geomspace(10.0, 100.0, 5)))


def test_rows_none_of_which_is_usable_fold_to_nothing() -> None:
    assert len(to_dq(turbine(f_hz=F_HZ[:3], status=["failed"] * 3)).nu_hz) == 0
    with pytest.raises(ValueError, match="0 of 3 rows are usable"):
        fit_response(turbine(f_hz=F_HZ[:3], status=["failed"] * 3))


def test_scikit_rf_fits_the_same_admittance() -> None:
    """Independent vector fitting of the same noisy dq data, given the order; twice the noise is left between them."""
    vector_fitting = pytest.importorskip("skrf.vectorFitting")
    import skrf

    response = turbine(noise=1e-3)
    data, model = to_dq(response), fit_response(response)
    fitting = vector_fitting.VectorFitting(skrf.Network(f=data.nu_hz, y=data.y, f_unit="hz"))
    fitting.vector_fit(n_poles_real=1, n_poles_cmplx=3, init_pole_spacing="log", parameter_type="y", enforce_dc=False)
    nu = np.geomspace(10.0, 40.0, 50)  # around the resonance of the dq frame
    ours = evaluate(model, 2j * np.pi * nu)
    theirs = np.array([[fitting.get_model_response(i, j, nu) for j in range(2)] for i in range(2)]).transpose(2, 0, 1)
    difference = np.linalg.norm(theirs - ours, axis=(1, 2)) / np.linalg.norm(ours, axis=(1, 2))
    assert difference.max() < 2e-3


def test_a_pole_at_the_frequency_of_a_row_is_moved_off_the_axis() -> None:
    """There its partial fraction has no value; a relocated pole once came to lie there to the last bit."""
    problem = weighted(to_dq(circuit(lambda s: 1.0 / (0.05 + s * 1e-3))), 1e-7)
    moved = held(problem, problem.s[3:4])
    assert moved.real < 0.0
    assert moved == pytest.approx(problem.s[3:4], rel=1e-11)
    assert np.all(np.isfinite(basis(problem.s, moved, 1)))


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_what_a_pole_or_the_constant_is_worth_is_what_a_fit_without_it_costs(noise: float) -> None:
    response = turbine(noise=noise)
    model = fit_response(response)
    problem = weighted(to_dq(response), 1e-6)
    poles = model.poles[model.poles.imag >= 0.0]
    trial = trial_at(problem, poles, 2)
    without = [trial_at(problem, np.delete(poles, k), 2).cost for k in range(len(poles))]
    costs = costs_without(problem, trial)
    np.testing.assert_allclose(costs[: len(poles)], without, rtol=1e-6)
    assert costs[-1] == pytest.approx(trial_at(problem, poles, 1).cost, rel=1e-6)
    assert trial.cost == pytest.approx(solve_residues(problem, poles, 2).cost, rel=1e-6)
