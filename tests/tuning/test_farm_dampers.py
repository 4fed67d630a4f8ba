"""Grid-side damping converters in a farm, against one explicit linearisation of turbines, network and converter."""

from __future__ import annotations

import jsonschema
import numpy as np
import pytest

from seqsweep.identify.fit.rational import evaluate
from seqsweep.plant.damping.grid_side import GridSideDamper
from seqsweep.tuning.farm.dampers import held_amplitude, model_of, seen_from
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.farm import judged
from seqsweep.tuning.farm.result import schema, text_of, to_json
from seqsweep.tuning.farm.units import Library

from ..support.farm_oracle import Star, closed_loop
from ..support.farms import document, library_of
from .test_farm import nearest

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.125j)
POWERS_W = [0.45e6, 0.6e6, 0.8e6]


@pytest.fixture(scope="module")
def library() -> Library:
    return library_of(STAR, POWERS_W)


def damped(library, **keys):
    return judged(farm_of({**document(STAR, 3), "damper": [{"name": "gsdc", "bus": "pcc", **keys}]}), library)


@pytest.fixture(scope="module")
def best(library):
    return damped(library)


@pytest.mark.parametrize("washout_rad_s", [2.0 * np.pi, 0.0])
def test_partial_fractions_are_the_converter_s_admittance(washout_rad_s):
    device = GridSideDamper(170.0, 0.03 - 0.04j, -0.01 + 0.002j, washout_rad_s=washout_rad_s)
    s = np.array([3.0 + 170j, -7.0 - 170j, 1j, 900j, -40.0 + 12j])
    np.testing.assert_allclose(evaluate(model_of(device), s), device.admittance(s), rtol=1e-10)


def test_modes_with_a_damper_without_a_washout_are_those_of_the_exact_farm(library):
    found = damped(library, washout_hz=0.0)
    truth, _ = closed_loop(STAR, POWERS_W, at_bus=tuple(found.dampers[0].device.states()))
    assert nearest(found.judgement.critical.pole, truth) < 1e-4
    assert found.judgement.verdict == "stable"
    assert np.abs(found.system.poles()).min() > 1.0  # no mode at f1: there is nothing that would remember


def test_modes_with_a_damper_are_those_of_the_exact_farm(best):
    (damper,) = best.dampers
    truth, _ = closed_loop(STAR, POWERS_W, at_bus=tuple(damper.device.states()))
    assert nearest(best.judgement.critical.pole, truth) < 1e-4
    assert max(nearest(mode.pole, truth) for mode in best.judgement.modes) < 2e-3
    assert best.judgement.n_unstable_locus == best.judgement.n_unstable_poles == int(np.sum(truth.real > 0.0))


def test_it_makes_an_unstable_farm_stable(best, library):
    without, _ = closed_loop(STAR, POWERS_W)
    with_it, _ = closed_loop(STAR, POWERS_W, at_bus=tuple(best.dampers[0].device.states()))
    assert without.real.max() > 1.0
    assert with_it.real.max() < 0.0
    assert best.judgement.verdict == "stable"


def test_a_small_one_moves_the_mode_straight_to_the_left(library):
    """By its size times what the mode sees of the bus, to first order."""
    plain = judged(farm_of(document(STAR, 3)), library)
    pole = plain.judgement.critical.pole
    effect = float(np.hypot(*np.abs(seen_from(plain.entry, "pcc", plain.units, pole))))
    moved = damped(library, size_s=0.05 / effect).judgement.critical.pole - pole
    assert moved == pytest.approx(-0.05, abs=2e-3)


def test_the_limit_holds_a_mode_up_to_the_amplitude_where_its_part_is_just_enough(best, library):
    """With the part of its admittance that is left at that amplitude the exact farm stands at the edge."""
    (damper,) = best.dampers
    amplitude = held_amplitude(best.entry, best.units, damper)
    part = damper.device.limit_a / (damper.size_s * amplitude)
    truth, _ = closed_loop(STAR, POWERS_W, at_bus=tuple(damper.device.scaled(part).states()))
    assert 0.0 < part < 1.0
    assert truth.real.max() == pytest.approx(0.0, abs=1e-2)


def test_a_converter_twice_as_large_holds_twice_the_oscillation(best, library):
    twice = damped(library, share=0.2)
    held = [held_amplitude(farm.entry, farm.units, farm.dampers[0]) for farm in (best, twice)]
    assert held[1] == pytest.approx(2.0 * held[0], rel=1e-6)


def test_it_is_told_with_its_limit(best):
    """Ten per cent of three times 1.632 MVA at 690 V."""
    assert "gsdc: grid-side damper at pcc" in text_of(best)
    told = to_json(best)["dampers"][0]
    assert told["limit_a"] == pytest.approx(0.1 * 3 * 1.632e6 / 690.0)
    assert "gsdc" in to_json(best)["modes"][0]["devices"]
    jsonschema.validate(to_json(best), schema())


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bus": "pc"}, r"is no bus \(did you mean 'pcc'"),
        ({"share": 10.1}, "needed is a part of the farm's rating"),
        ({"share": 0.0}, "needed is a number above 0"),
        ({"shair": 0.1}, "did you mean 'share'"),
    ],
)
def test_a_damper_that_makes_no_sense_is_refused(keys, words, library):
    with pytest.raises(FarmError, match=words):
        damped(library, **keys)
