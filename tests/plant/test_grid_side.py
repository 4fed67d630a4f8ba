"""The grid-side damper against an integration of its own equations, and its aim against an eigenvalue."""

import numpy as np
import pytest

from seqsweep.plant.damping.grid_side import N_STATES, GridSideDamper, aimed_at
from seqsweep.plant.errors import SeqsweepError

DAMPER = GridSideDamper(180.0, 3.0 + 2.0j, -0.5 + 1.0j, lag_s=1.3e-3)


def _stepped(damper: GridSideDamper, s: complex, sign: float) -> complex:
    """i / v by Heun's method on the four complex equations, written afresh; v = exp(s t) with s or conj(s)."""
    h, x = 2e-5, np.zeros(4, complex)
    s = s if sign > 0.0 else s.conjugate()

    def slope(x, v):
        m, x1, x2, i = x
        w_b, w_w, nu = damper.bandwidth_rad_s, damper.washout_rad_s, damper.nu_rad_s
        asked = damper.y_mode * x1 + damper.y_mirror * x2
        return np.array(
            [
                w_w * (v - m),
                (1j * nu - w_b) * x1 + w_b * (v - m),
                (-1j * nu - w_b) * x2 + w_b * (v - m),
                (asked - i) / damper.lag_s,
            ]
        )

    n = 45_000
    v = np.exp(s * h * np.arange(n + 1))
    for k in range(n):
        a = slope(x, v[k])
        x = x + 0.5 * h * (a + slope(x + h * a, v[k + 1]))
    return x[3] / v[n]


def test_the_closed_form_is_what_the_equations_do():
    s = 4.0 + 150.0j  # grows, so that what was there at the beginning is soon outgrown
    assert abs(_stepped(DAMPER, s, 1.0) - DAMPER.positive(np.array([s]))[0]) < 1e-3 * abs(DAMPER.y_mode)


def test_admittance_and_states_are_one_thing():
    s = np.array([3.0 + 170.0j, -2.0 - 60.0j, 11.0 + 0.0j])
    a, b, c = DAMPER.states()
    assert a.shape == (N_STATES, N_STATES)
    by_states = np.array([c @ np.linalg.solve(x * np.eye(N_STATES) - a, b) for x in s])
    assert np.allclose(DAMPER.admittance(s), by_states, rtol=1e-12, atol=1e-14)


def test_a_real_voltage_draws_a_real_current():
    y = DAMPER.admittance(np.array([5.0 + 100.0j]))[0]
    mirrored = DAMPER.admittance(np.array([5.0 - 100.0j]))[0]
    assert np.allclose(y.conj(), mirrored, rtol=1e-12)


def test_nothing_is_drawn_at_rest():
    assert np.allclose(DAMPER.admittance(np.array([0.0j])), 0.0)


def _loop(damper: GridSideDamper) -> np.ndarray:
    """Poles of an R-L-C bus with a negative conductance in dq, and the damper at it: by one explicit matrix."""
    r, ell, cap, g, w1 = 0.02, 2e-3, 0.8e-3, -0.012, 314.159
    one, j = np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]])
    grid = np.block([[-r / ell * one - w1 * j, -one / ell], [one / cap, -g / cap * one - w1 * j]])
    a, b, c = damper.states()
    drawn = np.zeros((4, N_STATES))
    drawn[2:] = -c / cap
    seen = np.hstack([np.zeros((2, 2)), one])
    return np.linalg.eigvals(np.block([[grid, drawn], [b @ seen, a]]))


@pytest.mark.parametrize("component", ["plus", "minus"])
def test_the_aim_moves_a_mode_straight_to_the_left(component):
    """One component sees M(s) = s' C + G + 1 / (R + s' L) with s' = s + j w1, or s - j w1; l = r = 1, D = M'."""
    r, ell, cap, g, w1 = 0.02, 2e-3, 0.8e-3, -0.012, 314.159
    turned = {"plus": 1j * w1, "minus": -1j * w1}[component]
    roots = np.roots([ell * cap, r * cap + ell * g, 1.0 + r * g])
    pole = next(s for s in roots - turned if s.imag > 0.0)
    residue = 1.0 / (cap - ell / (r + (pole + turned) * ell) ** 2)
    plus, minus = (residue, 0.0j) if component == "plus" else (0.0j, residue)
    for lag_s in (1e-3, 3e-3):
        moved = _loop(aimed_at(pole, plus, minus, 1e-4, lag_s=lag_s))
        shift = moved[np.argmin(np.abs(moved - pole))] - pole
        assert abs(shift.imag) < 0.02 * abs(shift.real)
        assert shift.real == pytest.approx(-1e-4 * abs(residue), rel=0.02)


@pytest.mark.parametrize(("change", "word"), [({"nu_rad_s": 0.0}, "nu_rad_s"), ({"lag_s": np.nan}, "lag_s")])
def test_refused(change, word):
    with pytest.raises(SeqsweepError, match=word):
        GridSideDamper(**{"nu_rad_s": 1.0, "y_mode": 1.0, "y_mirror": 0.0, **change})


def test_an_aim_without_a_target_is_refused():
    with pytest.raises(SeqsweepError, match="not seen"):
        aimed_at(-1.0 + 100.0j, 0.0j, 0.0j, 1.0)
    with pytest.raises(SeqsweepError, match="oscillate"):
        aimed_at(-1.0 + 0.0j, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("washout_rad_s", [6.0, 0.0])
def test_at_rest_its_states_do_not_move_and_without_a_washout_the_fundamental_is_in_them(washout_rad_s):
    damper = GridSideDamper(180.0, 0.01 + 0.02j, 0.001, washout_rad_s=washout_rad_s)
    v = 3.0 - 4.0j
    a, b, _ = damper.states()
    x = damper.at_rest(v)
    moved = (a @ x + b @ [v.real, v.imag])[:6]  # the current is held at zero as long as it does not act
    np.testing.assert_allclose(moved, 0.0, atol=1e-12)
    passed = 0.0 if washout_rad_s else damper.bandwidth_rad_s / abs(damper.bandwidth_rad_s - 180j)
    assert abs(complex(*x[2:4])) / abs(v) == pytest.approx(passed)
