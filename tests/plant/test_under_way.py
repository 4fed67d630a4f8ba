"""Jobs on their way together give the same bytes as jobs that are handed back and forth one by one."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.identify.settling import Agreements, first_agreement, norms, windows
from seqsweep.plant.protocol import Injection, Job, LanePlant, OperatingPoint, Phasors, Source, Tone, Window
from seqsweep.plant.registry import make_plant

IDEAL, LINE = Source(), Source("thevenin", 0.003, 5e-5)
STEPS = 400


def jobs_of(plant, sources, n):
    """Jobs at several operating points and lines, one of them unperturbed, one with two tones."""
    states = [plant.settle(OperatingPoint(p, 690.0), source) for p in (0.4e6, 0.7e6) for source in sources]
    tones = [(Tone(f_hz, 2.0, 0.1 * k),) for k, f_hz in enumerate(np.linspace(-60.0, 900.0, n))]
    tones[3] = (*tones[3], Tone(7.0, 1.0))
    injections = [None, *(Injection("series_voltage", of) for of in tones[1:])]
    jobs = [Job(states[k % len(states)], injection) for k, injection in enumerate(injections)]
    return jobs, [Window(10.0 * k + 5.0, 1 + k % 7, k % 3) for k in range(n)]


def handed_back_and_forth(plant, jobs, windows_of, rounds):
    """What every round hears, from `run_phasors` alone."""
    jobs, windows_of, heard = list(jobs), list(windows_of), []
    for who, n_blocks in rounds:
        answers = plant.run_phasors([jobs[k] for k in who], [windows_of[k] for k in who], STEPS, n_blocks)
        heard.append(np.array([[phasors.v, phasors.i] for _, phasors in answers]))
        for k, (state, _) in zip(who, answers, strict=True):
            jobs[k] = Job(state, jobs[k].injection)
            windows_of[k] = windows_of[k]._replace(first_block=windows_of[k].first_block + n_blocks)
    return heard


@pytest.mark.parametrize(
    ("plant_id", "parameters", "sources"),
    [
        ("dpmsg-v1", {}, [IDEAL, LINE]),
        ("dpmsg-v1", {"damping_gain": 0.5}, [LINE]),
        ("dpmsg-v1", {"integrator": "emt"}, [IDEAL]),
        ("gfl-v1", {}, [IDEAL]),
    ],
)
def test_jobs_on_their_way_hear_the_same_bytes_as_jobs_that_are_handed_back(plant_id, parameters, sources):
    plant = make_plant(plant_id, parameters)
    jobs, windows_of = jobs_of(plant, sources, 19)
    assert isinstance(plant, LanePlant)
    run = plant.phasor_run(jobs, windows_of, STEPS)
    rounds = [(np.arange(19), 2), (np.array([0, 3, 4, 7, 8, 9, 11, 12, 15, 18]), 3), (np.array([18, 3]), 2)]
    twin = handed_back_and_forth(plant, jobs, windows_of, rounds)
    for (who, n_blocks), expected in zip(rounds, twin, strict=True):
        assert np.array_equal(run.go_on(who, n_blocks), expected)


def test_an_heir_that_answers_in_its_own_way_is_asked_that_way():
    class Heir(type(make_plant("dpmsg-v1"))):
        def run_phasors(self, *arguments):
            return super().run_phasors(*arguments)

    plant = Heir()
    assert plant.phasor_run(*jobs_of(plant, [IDEAL], 8), STEPS) is None


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 0.0])
def test_agreements_found_while_blocks_come_in_are_those_of_all_windows(tolerance):
    """Decaying responses, one that is never heard, one that becomes infinite; in rounds, against the plain function."""
    rng = np.random.default_rng(7)
    n_blocks = np.array([1, 2, 3, 5, 8, 4, 4, 7])
    limit = n_blocks * 6
    decay = np.exp(-np.arange(60)[:, None] * rng.uniform(0.05, 2.0, (8, 1, 1, 1)))
    x = (rng.normal(size=(8, 2, 60, 2)) * decay + 1.0) * np.exp(1j * rng.normal(size=(8, 2, 1, 2)))
    x[5], x[6, 1, 9:] = 0.0, np.inf
    asked = Agreements(n_blocks, limit, np.full(8, tolerance))
    with np.errstate(invalid="ignore"):
        for done in range(0, 60, 15):
            who = np.flatnonzero(~asked.over)
            asked.hear(who, x[who, :, done : done + 15], done)
        for k in range(8):
            v, i = windows(Phasors(x[k, 0, : limit[k]], x[k, 1, : limit[k]]), n_blocks[k])
            expected, found = first_agreement(v, i, tolerance), asked.settled(k)
            assert repr(found) == repr(expected)
    assert asked.over.all()


def test_norms_are_those_of_each_vector():
    rng = np.random.default_rng(7)
    x = rng.normal(size=(50, 3, 2)) + 1j * rng.normal(size=(50, 3, 2))
    assert np.array_equal(norms(x), [[np.linalg.norm(row) for row in rows] for rows in x])
