"""Many tones as one waveform: against the sum itself, and the turbine's answers against those to its tones."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
from seqsweep.plant.turbine import tone_table as module
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.plant.turbine.tone_table import common_period, waveform

RATE_HZ = 40e3
POINT = OperatingPoint(0.65e6, 690.0)


def spectrum(*f_hz):
    return [(f, 1.0 + 0.1j * k) for k, f in enumerate(f_hz)]


MANY = spectrum(*range(-60, 60, 5))


def test_a_waveform_is_the_sum_of_its_tones_from_any_sample_on():
    n_rows = common_period([MANY], RATE_HZ)
    assert n_rows == 8000
    for first in (0, 4711, -3, 10**9 + 1):
        n = first + np.arange(n_rows)
        expected = sum(v * np.exp(2j * np.pi * np.mod(f / RATE_HZ * n, 1.0)) for f, v in MANY)
        assert np.max(np.abs(waveform(MANY, RATE_HZ, n_rows, first) - expected)) <= 1e-7 * len(MANY)


@pytest.mark.parametrize(
    ("spectra", "why"),
    [
        ([spectrum(10.0, 20.0)], "few tones"),
        ([spectrum(*range(0, 120, 5), 12.3456)], "one is off the grid of the others"),
        ([spectrum(*(np.arange(24) * 0.1))], "ten seconds are more than is worth it"),
        ([spectrum(*(np.arange(24) * 7.0))], "a seventh of a second is no whole number of samples"),
    ],
)
def test_what_has_no_common_period_stays_a_sum(spectra, why):
    assert common_period(spectra, RATE_HZ) == 0, why


def test_lanes_repeat_together_or_not_at_all():
    assert common_period([MANY, spectrum(2.5)], RATE_HZ) == 16000
    assert common_period([MANY, spectrum(2.3456789)], RATE_HZ) == 0


BROAD = Injection("series_voltage", tuple(Tone(float(f), 0.3, 0.01 * f * f) for f in range(-95, 300, 10)))
ODD = Injection("series_voltage", tuple(Tone(50.0 + 64.0 * k, 0.3, 0.1 * k * k) for k in range(1, 15)))
"""Repeats after 625 half steps."""


@pytest.mark.parametrize("injection", [BROAD, ODD], ids=["10 Hz", "64 Hz"])
@pytest.mark.parametrize("k", [0.0, 0.5], ids=["plain", "compensated"])
@pytest.mark.parametrize("source", [Source(), Source("thevenin", LINE_R_OHM, LINE_L_H)], ids=["ideal", "line"])
def test_the_turbine_answers_a_waveform_as_it_answers_its_tones(monkeypatch, source, k, injection):
    """Begun at no particular step, over more than a period, a lane without injection beside it."""
    plant = ReferenceTurbine(damping_gain=k)
    ((state, _),) = plant.run([Job(plant.settle(POINT, source), None)], 137)
    jobs = [Job(state, injection), Job(state, None)]
    answers = []
    for fewest in (module.FEWEST, 1000):
        monkeypatch.setattr(module, "FEWEST", fewest)
        assert (len(plant._source_table(jobs)) > 0) == (fewest < 1000)
        records = [record for _, record in plant.run(jobs, 5000)]
        phasors = [found for _, found in plant.run_phasors(jobs, [Window(75.0, 10)] * 2, 400, 10)]
        answers.append([x for r in (*records, *phasors) for x in (r.v, r.i)])
    for tabled, summed in zip(*answers, strict=True):
        assert np.max(np.abs(tabled - summed)) <= 1e-9 * np.max(np.abs(summed))
