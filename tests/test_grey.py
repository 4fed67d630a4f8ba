"""A real-code controller in the turbine's circuit, against the turbine itself and the sampled model's own linearisation.

Figures: ``python -m pytest -s tests/test_grey.py``.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seqsweep.plant.check import check_plant
from seqsweep.plant.grey import GreyTurbine
from seqsweep.plant.protocol import Injection, Job, NotSettled, OperatingPoint, Source, Tone

from . import oracle, sampled
from .controllers import INPUTS, OUTPUTS, build, needs_compiler
from .test_accuracy import IN_PLACE, P_MW, U_V, relative, report, swept

pytestmark = needs_compiler

POINT = OperatingPoint(P_MW * 1e6, U_V)
BAND = {"f_min_hz": 1.0, "f_max_hz": 500.0, "points": 16}


def plant(*switches, **parameters):
    return GreyTurbine(f"cigre:{build(*switches)}", INPUTS, OUTPUTS, **parameters)


@cache
def sweep(switch="SAMPLE_TIME_S=20e-6", delay=0, lead=0.5, in_place=False):
    return swept(
        plant(switch, delay_samples=delay, settings={"Lead": lead}), BAND, source=IN_PLACE if in_place else None
    )


def numbers(state):
    """The circuit's states and the controller's, but for the flag that it has started; an ideal source leaves i_g out."""
    x = state.x[[0, 1, 3]] if state.source.kind == "ideal" else state.x
    return np.concatenate([x.real, x.imag, [state.energy], np.frombuffer(state.memory.double_states)[1:]])


def moved(state, values):
    kept = [0, 1, 3] if state.source.kind == "ideal" else [0, 1, 2, 3]
    n = len(kept)
    x = state.x.copy()
    x[kept] = values[:n] + 1j * values[n : 2 * n]
    doubles = np.append(np.frombuffer(state.memory.double_states)[:1], values[2 * n + 1 :])
    memory = state.memory._replace(double_states=doubles.tobytes())
    return replace(state, x=x, energy=float(values[2 * n]), memory=memory)


def linearised(device, f_hz, source=None):
    state = device.settle(POINT, source or Source())
    return sampled.admittance_pn(sampled.Orbit(device, state, numbers, moved), f_hz)


def test_controls_sampled_every_20_us_are_the_turbine():
    """The bar is the one asked of a library at 20 us; the zero-order hold leaves the error at the upper end."""
    f_hz, y = sweep()
    error = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))
    report("20 us", error, f_hz, 1e-3)
    assert error.max() <= 1e-3


@pytest.mark.parametrize(("step", "delay"), [("20e-6", 0), ("50e-6", 0), ("100e-6", 0), ("50e-6", 1), ("100e-6", 1)])
def test_a_sweep_is_the_exact_linearisation_of_the_sampled_model(step, delay):
    switch, lead = f"SAMPLE_TIME_S={step}", 0.5 + delay
    f_hz, y = sweep(switch, delay, lead)
    exact = linearised(plant(switch, delay_samples=delay, settings={"Lead": lead}), f_hz)
    error = relative(y, exact)
    report(f"{step} s, delay {delay}", error, f_hz, 1e-4)
    continuous = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))
    print(f"; {continuous.max():.1e} from the continuous turbine", end="")
    assert error.max() <= 1e-4
