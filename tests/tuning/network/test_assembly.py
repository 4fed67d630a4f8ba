"""Small networks against impedances written down by hand."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.tuning.network.assembly import GROUND, Branch, Line, Network, assemble, port_impedance
from seqsweep.tuning.network.descriptor import rotating, transfer, transfer_slope, triangular
from seqsweep.tuning.network.equipment import between, high_pass, pi_line, single_tuned, transformer

W1 = 2.0 * np.pi * 50.0
S = 2j * np.pi * np.array([0.1, 3.0, 50.0, 180.0, 912.0, 2500.0]) - np.array([0.0, 4.0, 0.3, 80.0, 7.0, 0.0])
CABLE = Line("cable", "a", GROUND, 0.05, 0.35e-3, 0.0, 0.25e-6, 120.0)


def ladder() -> Network:
    """A shunt C at the port, then R-L, a series capacitor and a tuned filter behind it, R-L to the source."""
    return Network(
        (
            Branch("c", between("a", GROUND), c_f=2e-4),
            Branch("l1", between("a", "b"), 0.01, 5e-4),
            Branch("cs", between("b", "c"), c_f=0.02),
            *single_tuned("f5", "c", 1e-4, 250.0, 30.0),
            Branch("l2", between("c", GROUND), 0.02, 4e-4),
        )
    )


def ladder_by_hand(s: np.ndarray) -> np.ndarray:
    l_f = 1.0 / ((2.0 * np.pi * 250.0) ** 2 * 1e-4)
    y_f = 1.0 / (2.0 * np.pi * 250.0 * l_f / 30.0 + s * l_f + 1.0 / (s * 1e-4))
    behind = 1.0 / (y_f + 1.0 / (0.02 + s * 4e-4)) + 1.0 / (s * 0.02) + 0.01 + s * 5e-4
    return 1.0 / (s * 2e-4 + 1.0 / behind)


def test_a_ladder_is_its_continued_fraction() -> None:
    np.testing.assert_allclose(port_impedance(ladder(), ["a"], S)[:, 0, 0], ladder_by_hand(S), rtol=1e-12)


def test_the_triangular_form_says_the_same_and_its_slope_is_the_derivative() -> None:
    form = triangular(assemble(ladder(), ["a"]))
    value, slope = transfer(form, S), transfer_slope(form, S)
    np.testing.assert_allclose(-value, ladder_by_hand(S), rtol=1e-11)
    step = 1e-5 * np.abs(S)
    expected = (ladder_by_hand(S + step) - ladder_by_hand(S - step)) / (2.0 * step)
    np.testing.assert_allclose(-slope, expected, rtol=1e-8)


def test_poles_of_the_triangular_form_are_the_networks_own_modes() -> None:
    """Three capacitors and three inductors, whose currents meet in one node: five modes, one of them at zero."""
    poles = triangular(assemble(ladder(), ["a"])).poles
    assert len(poles) == 5
    assert np.min(np.abs(poles)) < 1e-9
    assert np.all(np.abs(1.0 / ladder_by_hand(poles)) < 1e-8)


def test_the_rotating_frame_shifts_every_mode_by_the_fundamental_either_way() -> None:
    system = assemble(ladder(), ["a"])
    turned = rotating(system, W1)
    v = turned.c @ np.linalg.solve(S[2] * turned.e - turned.a, turned.b)
    z1, z2 = ladder_by_hand(S[2:3] + 1j * W1)[0], ladder_by_hand(S[2:3] - 1j * W1)[0]
    np.testing.assert_allclose(-v[0, 0], (z1 + z2) / 2.0, rtol=1e-11)
    np.testing.assert_allclose(-v[1, 0], (z1 - z2) / 2j, rtol=1e-11)


def test_a_distributed_cable_is_zc_tanh() -> None:
    """Against the ideal source, and at s = 0, where the closed form is 0/0, its resistance."""
    z, y = 0.05 + S * 0.35e-3, S * 0.25e-6
    x = 120.0 * np.sqrt(z * y)
    expected = z * 120.0 * np.tanh(x) / x
    found = port_impedance(Network((), (CABLE,)), ["a"], S)[:, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    at_zero = port_impedance(Network((), (CABLE,)), ["a"], np.array([0j]))[0, 0, 0]
    assert at_zero == pytest.approx(0.05 * 120.0)


@pytest.mark.parametrize("sections", [4, 8])
def test_pi_sections_come_to_the_cable_with_the_square_of_their_number(sections: int) -> None:
    exact = port_impedance(Network((), (CABLE,)), ["a"], S[:4])[:, 0, 0]
    errors = [
        np.abs(port_impedance(Network(pi_line(CABLE, n)), ["a"], S[:4])[:, 0, 0] / exact - 1.0).max()
        for n in (sections, 2 * sections)
    ]
    assert errors[1] < errors[0] / 3.5


def test_a_transformer_shows_what_is_behind_it_by_the_square_of_its_ratio() -> None:
    leak = transformer("t", "a", "b", 0.69 / 35.0, 2e6, 690.0, 0.06, 0.006, W1)
    behind = Branch("line", between("b", GROUND), 1.0, 0.03)
    base = 690.0**2 / 2e6
    expected = 0.006 * base + S * np.sqrt(0.06**2 - 0.006**2) * base / W1 + (0.69 / 35.0) ** 2 * (1.0 + S * 0.03)
    np.testing.assert_allclose(port_impedance(Network((leak, behind)), ["a"], S)[:, 0, 0], expected, rtol=1e-12)


def test_a_high_pass_is_c_in_series_with_l_and_r_in_parallel() -> None:
    c_f, w = 1e-4, 2.0 * np.pi * 550.0
    l_h = 1.0 / (w**2 * c_f)
    r_ohm = 2.0 * w * l_h
    expected = 1.0 / (S * c_f) + 1.0 / (1.0 / r_ohm + 1.0 / (S * l_h))
    found = port_impedance(Network(high_pass("f", "a", c_f, 550.0, 2.0)), ["a"], S)[:, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
