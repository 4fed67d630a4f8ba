"""A turbine whose machine stands still and that meets no limit is stepped without either, and to the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
from seqsweep.plant.turbine.asked import Kind, kinds_of
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.plant.turbine.steps import CalmSteps, PlainSteps

IDEAL, LINE = Source(), Source("thevenin", 0.003, 5e-5)


class Complete(ReferenceTurbine):
    """The same turbine, stepped with its machine and its limits always."""

    def steps_of(self, kind: Kind, table: np.ndarray) -> PlainSteps | CalmSteps:
        return super().steps_of(kind._replace(calm=False), table)


class Heedless(ReferenceTurbine):
    """The same turbine, which does not look whether it met a limit."""

    def steps_of(self, kind: Kind, table: np.ndarray) -> PlainSteps:
        steps = super().steps_of(kind, table)
        assert isinstance(steps, CalmSteps)
        return steps.calm


def jobs_of(plant, source, peaks_v, q_var=0.0):
    """A tone of each peak (V) at frequencies of its own, all from one operating point."""
    state = plant.settle(OperatingPoint(0.9e6, 690.0, q_var), source)
    f_hz = np.linspace(3.0, 900.0, len(peaks_v))
    return [Job(state, Injection("series_voltage", (Tone(f, v),))) for f, v in zip(f_hz, peaks_v, strict=True)]


def heard(plant, jobs, n_blocks=10):
    """Phasors (n, 2, n_blocks, 2) and states (n, 21) of the jobs, together."""
    answers = plant.run_phasors(jobs, [Window(job.injection.tones[0].f_hz, n_blocks) for job in jobs], 400, n_blocks)
    return np.array([[p.v, p.i] for _, p in answers]), np.array([state.values for state, _ in answers])


@pytest.mark.parametrize("parameters", [{}, {"damping_gain": 0.5}])
@pytest.mark.parametrize(("source", "q_var"), [(IDEAL, 0.0), (LINE, 0.0), (IDEAL, 1e5)])
def test_a_calm_turbine_is_the_complete_one(parameters, source, q_var):
    calm, complete = ReferenceTurbine(**parameters), Complete(**parameters)
    jobs = jobs_of(calm, source, np.full(3, 0.6), q_var)
    assert all(kind.calm for kind in kinds_of(jobs, calm.parameters))
    for found, expected in zip(heard(calm, jobs), heard(complete, jobs), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_a_limit_that_is_met_is_kept_and_no_neighbour_knows_of_it():
    """One of eight shots has a tone of half the rated voltage: it ends as the complete turbine, to the last bit."""
    calm, complete = ReferenceTurbine(), Complete()
    jobs = jobs_of(calm, IDEAL, [0.6, 0.6, 280.0, 0.6, 0.6, 0.6, 0.6, 0.6])
    phasors, states = heard(calm, jobs)
    loud, loud_states = heard(complete, jobs)
    assert np.array_equal(phasors[2], loud[2])
    assert np.array_equal(states[2], loud_states[2])
    quiet = [0, 1, 3, 4, 5, 6, 7]
    alone, _ = heard(calm, [jobs[k] for k in quiet])
    assert np.array_equal(phasors[quiet], alone)
    heedless, _ = heard(Heedless(), jobs)
    assert np.abs(heedless[2] - phasors[2]).max() > 0.01 * np.abs(phasors[2]).max()  # the limits do act
    assert np.array_equal(heedless[quiet], phasors[quiet])


def test_samples_keep_limits_too():
    calm, complete = ReferenceTurbine(), Complete()
    jobs = jobs_of(calm, LINE, [0.6, 280.0])
    (_, still), (_, loud) = calm.run(jobs, 2000)
    (_, still_twin), (_, loud_twin) = complete.run(jobs, 2000)
    assert np.array_equal(loud.i, loud_twin.i)
    np.testing.assert_allclose(still.i, still_twin.i, rtol=0.0, atol=1e-12 * np.abs(still_twin.i).max())


def test_a_machine_that_moves_is_stepped():
    plant = ReferenceTurbine()
    state = plant.settle(OperatingPoint(0.9e6, 690.0), IDEAL)
    gust = replace(state, wind_m_s=1.01 * state.wind_m_s)
    slow = state.values.copy()
    slow[12] *= 1.0 - 1e-6
    jobs = [Job(moved, None) for moved in (state, gust, replace(state, values=slow))]
    assert [kind.calm for kind in kinds_of(jobs, plant.parameters)] == [True, False, False]
    (end, _), (faster, _), (back, _) = plant.run(jobs, 4000)
    assert np.array_equal(end.values[8:13], state.values[8:13])
    assert faster.values[12] > (1.0 + 1e-6) * state.values[12]
    assert slow[12] < back.values[12] < state.values[12]
