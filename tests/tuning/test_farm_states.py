"""Switching states: a state is a farm of its own, and damping control may stop where that farm needs none."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError
from seqsweep.tuning.farm.farm import judged
from seqsweep.tuning.farm.margin import crossing_at_source
from seqsweep.tuning.farm.result import states_json, states_text
from seqsweep.tuning.farm.states import State, farm_in, judge_states, states_of
from seqsweep.tuning.farm.units import Library

from ..support.farm_oracle import Star
from ..support.farms import document, library_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)
POWERS_W = [0.45e6, 0.6e6, 0.8e6]


@pytest.fixture(scope="module")
def library() -> Library:
    return library_of(STAR, POWERS_W)


def with_states(*states: dict) -> dict:
    return {**document(STAR, 3), "state": list(states)}


def test_lists_are_multiplied_out_and_every_state_has_its_name():
    states = states_of(with_states({"name": "weak", "source_scale": [1.0, 1.5], "devices": [2, 3]}))
    assert [(s.source_scale, s.devices) for s in states] == [(1.0, 2), (1.5, 2), (1.0, 3), (1.5, 3)]
    assert len({s.name for s in states}) == 4


def test_without_states_there_is_the_farm_as_it_is():
    assert states_of(document(STAR, 2)) == (State("as it is"),)


@pytest.mark.parametrize(
    ("state", "same"),
    [
        ({"devices": 2}, {"device": document(STAR, 3)["device"][:2]}),
        ({"out": ["wt1"]}, {"device": [document(STAR, 3)["device"][k] for k in (0, 2)]}),
        ({"only": ["wt0", "wt2"]}, {"device": [document(STAR, 3)["device"][k] for k in (0, 2)]}),
        ({"out": ["z1"]}, {"device": [document(STAR, 3)["device"][k] for k in (0, 2)]}),
        ({"source_scale": 1.5}, {"source": [{"bus": "pcc", "r_ohm": 0.006, "x_ohm": 0.1275}]}),
        (
            {"count": {"wt0": 2}},
            {"device": [{**document(STAR, 3)["device"][0], "count": 2}, *document(STAR, 3)["device"][1:]]},
        ),
    ],
)
def test_a_state_is_judged_as_a_farm_of_its_own(state, same, library):
    """A transformer that is out takes the turbine behind it with it."""
    (found,) = judge_states(with_states(state), library)
    own = judged(farm_of({**document(STAR, 3), **same}), library)
    assert found.farm.judgement.critical.pole == pytest.approx(own.judgement.critical.pole, rel=1e-9)
    assert found.verdict == own.judgement.verdict


def test_damping_control_may_stop_where_the_farm_is_stable_with_the_margin(library):
    states = with_states({"source_scale": [0.8, 1.0, 1.3, 1.6]})
    plain, strict = judge_states(states, library), judge_states(states, library, margin=1.3)
    m = [found.crossing.m for found in plain]
    assert m == sorted(m, reverse=True)
    assert [found.cause_gone for found in plain] == [found.verdict == "stable" for found in plain]
    assert [found.cause_gone for found in strict] == [value >= 1.3 for value in m]
    assert plain[0].cause_gone
    assert not plain[-1].cause_gone


def test_margin_at_the_source_is_one_at_the_edge(library):
    """m is the factor on Z that the farm bears: with Z times m the critical mode stands on the axis, nearly."""
    (state,) = judge_states(with_states({"source_scale": 1.0}), library)
    edge = farm_in(document(STAR, 3), State("edge", source_scale=state.crossing.m))
    farm = judged(edge, library)
    assert abs(farm.judgement.critical.pole.real) < 4.0
    assert crossing_at_source(farm).m == pytest.approx(1.0, abs=0.06)


def test_a_state_without_an_operating_point_says_so(library):
    found = judge_states(with_states({"name": "far", "source_scale": [1.0, 9.0]}), library)
    assert found[1].verdict == "no operating point"
    assert "% of it has one" in found[1].reason
    assert "no operating point" in states_text(found)
    assert states_json("f", found)["states"][1]["verdict"] is None


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"outt": ["wt0"]}, "did you mean 'out'"),
        ({"out": ["wt9"]}, "nothing in the farm is called 'wt9'"),
        ({"only": ["wt9"]}, "no device is called 'wt9'"),
        ({"devices": 7}, "the farm has 3"),
        ({"count": 3}, "needed is a table"),
        ({"source_scale": -1.0}, "needed is a number above 0"),
        ({"source_scale": []}, "an empty list"),
        ({"only": []}, "nothing to judge"),
        ({"source_scale": list(np.linspace(1.0, 2.0, 50)), "devices": [1] * 50}, "at most 2000"),
    ],
)
def test_a_state_that_makes_no_sense_is_refused(state, words, library):
    with pytest.raises(FarmError, match=words):
        judge_states(with_states(state), library)


def test_long_names_of_states_are_told_whole_within_the_width(library):
    long = "the northern string behind the second cable is out of service, spring tides "
    states = judge_states(
        with_states({"name": long + "a", "out": ["wt1"]}, {"name": long + "b", "out": ["wt2"]}), library
    )
    lines = states_text(states).splitlines()
    assert max(map(len, lines)) <= 80
    told = " ".join(" ".join(lines).split())
    assert long + "a" in told
    assert long + "b" in told
