"""One farm on many sources by its reduction to 2x2, against the whole pencil and the explicit linearisation."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.frames import dq_to_pn
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.farm import admittance_at_source, judged
from seqsweep.tuning.farm.pairs import to_dq
from seqsweep.tuning.farm.sources import judge_sources, with_source
from seqsweep.tuning.farm.system import System
from seqsweep.tuning.farm.tree import reduced, tree_of

from ..support.farm_oracle import Star, closed_loop
from ..support.farms import document, table_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)
POWERS_W = [0.45e6, 0.6e6, 0.8e6]


@pytest.fixture(scope="module")
def farm():
    _, v = closed_loop(STAR, POWERS_W)
    tables = {f"t{k}": table_of(p, abs(v[k])) for k, p in enumerate(POWERS_W)}
    return judged(farm_of(document(STAR, 3)), tables.__getitem__)


def test_the_tree_shows_the_source_what_the_whole_network_does(farm):
    tree = tree_of(farm.entry.network, "pcc", farm.entry.network.branches[-1], 100.0 * np.pi)
    f = np.array([12.0, 49.0, 77.0, 430.0])
    s = 2j * np.pi * (f - 50.0)
    found = dq_to_pn(to_dq(reduced(tree, s, farm.system.by_bus(s)).y))
    np.testing.assert_allclose(found, admittance_at_source(farm, f), rtol=1e-9)


def test_every_source_is_judged_as_the_whole_farm_would_be(farm):
    """Counts, and the deciding mode to 1e-6 rad/s, by the pencil of all devices on that source."""
    scales = [0.7, 1.0, 1.25, 1.32, 1.8]
    for one in judge_sources(farm, [scale * STAR.z_s for scale in scales]):
        system = System(farm.units, with_source(farm.entry, one.z_ohm).network, farm.system.ports, 50.0)
        poles = system.poles()
        assert np.abs(poles - one.pole).min() < 1e-6
        assert one.n_unstable == int(np.sum(poles[np.abs(poles) < 1e4].real > 0.0))
        assert one.verdict == ("unstable" if one.n_unstable else "stable")
        assert not one.whole


def test_its_error_is_that_of_the_whole_farm(farm):
    (one,) = judge_sources(farm, [STAR.z_s])
    assert one.pole == pytest.approx(farm.judgement.critical.pole, rel=1e-8)
    assert one.std == pytest.approx(farm.judgement.critical.std.real, rel=1e-4)


def test_a_network_with_a_loop_is_refused():
    looped = document(STAR, 3)
    looped["series"] = [*looped["series"], {"name": "loop", "from": "t0", "to": "t1", "r_ohm": 0.001, "x_ohm": 0.01}]
    entry = farm_of(looped)
    with pytest.raises(FarmError, match="the network has a loop"):
        tree_of(entry.network, "pcc", entry.network.branches[-1], 100.0 * np.pi)


def test_a_farm_with_a_loop_is_judged_over_all_terminals():
    """The locus then follows the whole matrix, and says what the poles say."""
    looped = document(STAR, 2)
    looped["series"] = [*looped["series"], {"name": "loop", "from": "t0", "to": "t1", "r_ohm": 0.001, "x_ohm": 0.01}]
    found = judged(farm_of(looped), lambda name: table_of(0.6e6, 690.0))
    assert found.system.tree is None
    assert found.judgement.n_unstable_locus == found.judgement.n_unstable_poles == 0
