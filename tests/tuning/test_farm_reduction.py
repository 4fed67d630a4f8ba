"""What makes a farm of a hundred quick: 2x2 matrices by their elements, few places of the locus, sparse shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.frames import T_INVERSE, T
from seqsweep.tuning.farm import pairs
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.farm import Farm, judged
from seqsweep.tuning.farm.judge import MODES
from seqsweep.tuning.farm.participation import parts_of
from seqsweep.tuning.farm.system import System
from seqsweep.tuning.network.assembly import Network

from ..support.farm_oracle import Star
from ..support.farms import document, library_of, table_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)
POWERS_W = [0.45e6, 0.6e6, 0.8e6]


def test_pairs_are_matrices_in_the_basis_of_the_sequences():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 9, 2, 2)) + 1j * rng.normal(size=(2, 9, 2, 2))
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    first, second = pairs.from_dq(a), pairs.from_dq(b)
    close = np.testing.assert_allclose
    close(np.stack([first.pp, first.pn, first.np, first.nn], -1).reshape(-1, 2, 2), T @ a @ T_INVERSE, atol=1e-14)
    close(pairs.to_dq(first), a, atol=1e-14)
    close(pairs.to_dq(pairs.product(first, second)), a @ b, atol=1e-13)
    close(pairs.to_dq(pairs.inverse(first)), np.linalg.inv(a), rtol=1e-11)
    close(pairs.to_dq(pairs.turned(first, 0.3, 2.0)), 2.0 * turn @ a @ turn.T, atol=1e-13)
    close(pairs.determinant(first), np.linalg.det(a), rtol=1e-12)
    own = np.sort_complex(np.stack(pairs.eigenvalues(first), -1))
    close(own, np.sort_complex(np.linalg.eigvals(a)), rtol=1e-10)


@pytest.fixture(scope="module")
def farm() -> Farm:
    return judged(farm_of(document(STAR, 3)), library_of(STAR, POWERS_W))


@pytest.fixture(scope="module")
def looped() -> Farm:
    """The same with a loop in its network."""
    content = document(STAR, 3)
    content["series"] = [*content["series"], {"name": "l", "from": "t0", "to": "t1", "r_ohm": 0.01, "x_ohm": 0.1}]
    return judged(farm_of(content), library_of(STAR, POWERS_W))


def moved(system: System, pole: complex, branches: list) -> complex:
    """Where a mode goes with other branches."""
    poles = System(system.units, Network(tuple(branches)), system.ports, system.f1_hz).poles()
    return complex(poles[np.abs(poles - pole).argmin()])


@pytest.mark.parametrize("name", ["farm", "looped"])
def test_participation_of_every_branch_is_the_difference_of_two_farms(name, request):
    """By a change of each impedance, R, L and 1/C alike, within 1e-6 of the largest."""
    found: Farm = request.getfixturevalue(name)
    assert (found.system.tree is None) == (name == "looped")
    mode, branches = found.judgement.critical, list(found.entry.network.branches)
    for k, branch in enumerate(branches):
        ends = []
        for factor in (1.0 + 1e-4, 1.0 - 1e-4):
            other = replace(branch, r_ohm=branch.r_ohm * factor, l_h=branch.l_h * factor, c_f=branch.c_f / factor)
            ends.append(moved(found.system, mode.pole, [*branches[:k], other, *branches[k + 1 :]]))
        difference = (ends[0] - ends[1]) / 2e-4
        assert abs(mode.branches[k] - difference) < 1e-6 * np.abs(mode.branches).max()


def test_participation_of_every_device_and_bus_is_the_difference_of_two_farms(farm):
    """Within 1e-6: the device made larger and smaller, a conductance put at the bus and taken away."""
    mode, system = farm.judgement.critical, farm.system
    for k, unit in enumerate(system.units):
        ends = []
        for step in (1e-4, -1e-4):
            units = (*system.units[:k], replace(unit, factor=1.0 + step), *system.units[k + 1 :])
            poles = System(units, system.network, system.ports, 50.0).poles()
            ends.append(poles[np.abs(poles - mode.pole).argmin()])
        assert abs(mode.devices[k] - (ends[0] - ends[1]) / 2e-4) < 1e-6 * np.abs(mode.devices).max()
    for k, unit in enumerate(system.units):
        ends = []
        for step in (1e-3, -1e-3):
            model = replace(unit.model, d=unit.model.d + step * np.eye(2))
            units = (*system.units[:k], replace(unit, model=model), *system.units[k + 1 :])
            poles = System(units, system.network, system.ports, 50.0).poles()
            ends.append(poles[np.abs(poles - mode.pole).argmin()])
        assert abs(mode.buses[k] - (ends[0] - ends[1]) / 2e-3) < 1e-6 * np.abs(mode.buses).max()


def test_a_mode_that_the_connection_point_does_not_see_has_a_shape():
    """Two equal turbines against each other: the bus between them stands still, both take part alike."""
    farm = judged(farm_of({**document(STAR, 2)}), lambda name: table_of(0.6e6, 690.0))
    poles = farm.system.poles()
    behind = farm.judgement.in_band
    common = [parts_of(farm.system, complex(p)) for p in behind if abs(p.imag) < 2.0 * np.pi * 60.0]
    assert len(common) >= 2
    for mode in common:
        assert mode.shares == pytest.approx([0.5, 0.5], abs=1e-4)
        assert np.abs(poles - mode.pole).min() < 1e-9 * abs(mode.pole)


def test_more_equal_turbines_are_looked_at_no_closer():
    """The places of the locus are those of the modes, and many turbines have them in common."""
    sizes = []
    for n in (3, 12):
        star = Star(STAR.z_t, STAR.c_f, STAR.z_s * 3.0 / n)
        sizes.append(len(judged(farm_of(document(star, n)), lambda name: table_of(0.5e6, 690.0)).judgement.turns_hz))
    assert sizes[1] < 1.3 * sizes[0]


def test_the_slowest_mode_is_told_however_many_are_less_damped():
    """Ten resonances of filters have smaller damping ratios than the farm's mode, and die out much sooner."""
    content = document(STAR, 3)
    content["shunt"] = [
        *content["shunt"],
        *(
            {"name": f"f{k}", "bus": "pcc", "kind": "filter", "c_uf": 10.0, "tuned_hz": 400.0 + 40.0 * k}
            for k in range(10)
        ),
    ]
    found = judged(farm_of(content), library_of(STAR, POWERS_W))
    told = np.array([mode.pole for mode in found.judgement.modes])
    assert len(told) == MODES
    assert found.judgement.critical.pole == found.judgement.in_band[np.argmax(found.judgement.in_band.real)]
    nu = found.judgement.critical.pole.imag / (2.0 * np.pi)
    assert 15.0 < nu < 45.0
    assert f"mode at {50.0 - nu:.4g}/{50.0 + nu:.4g} Hz" in repr(found)
