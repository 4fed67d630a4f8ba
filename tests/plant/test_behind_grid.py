"""Devices that must be waited for, settled where they can live: behind a grid, or walked there from a friendlier."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from seqsweep.plant.boxes.step_function import plant_from_step
from seqsweep.plant.protocol import Job, NotSettled, OperatingPoint, Source

U, S, W1 = 400.0, 10e3, 2.0 * pi * 50.0
BASE_OHM = U**2 / S
PEAK_A = (2.0 / 3.0) ** 0.5 * S / U
X_PU, R_PU, DROOP_RAD_S_PU, FILTER_RAD_S = 0.05, 0.005, 25.0, 200.0
"""A voltage behind 5 % whose angle droops with its power: on an ideal source its 50 Hz mode grows."""


def droop(limit_pu: float):
    """A step of the droop device; where its current exceeds the limit it lets go for good and only hunts."""

    def step(state, v, dt):
        i, angle, p, latched = state
        emf = (2.0 / 3.0) ** 0.5 * U * np.exp(1j * angle)
        if latched > 0.0:
            i = 0.3 * PEAK_A * np.exp(1j * 211.7 * latched * dt)
        else:
            i = i + dt * W1 / (X_PU * BASE_OHM) * (v - emf - R_PU * BASE_OHM * i)
        latched = latched + 1.0 if latched > 0.0 or abs(i) > limit_pu * PEAK_A else 0.0
        p = p + dt * FILTER_RAD_S * (-1.5 * (v * np.conj(i)).real / S - p)
        return (i, angle + dt * (W1 + DROOP_RAD_S_PU * (0.5 - p)), p, latched), i

    return plant_from_step(
        step, (0j, 0.0, 0.0, 0.0), dt_s=2e-4, voltage_v=U, power_va=S, settle_tolerance=1e-7, patience_s=2.0
    )


def grid(x_pu: float, **more) -> Source:
    return Source("thevenin", 0.1 * x_pu * BASE_OHM, x_pu * BASE_OHM / W1, **more)


def terminals(plant, state) -> tuple[complex, complex]:
    ((_, record),) = plant.run([Job(state, None)], 100)
    turns = np.exp(-1j * W1 * record.time_s)
    return complex(np.mean(record.v * turns)), complex(np.mean(record.i * turns))


def test_it_hates_an_ideal_source_and_settles_behind_a_grid_at_the_voltage_asked():
    plant = droop(1e9)
    with pytest.raises(NotSettled):
        plant.settle(OperatingPoint(0.5 * S, U), Source())
    state = plant.settle(OperatingPoint(0.5 * S, U), grid(0.3))
    v, i = terminals(plant, state)
    assert abs(v) * 1.5**0.5 == pytest.approx(U, rel=2e-6)
    assert -1.5 * (v * i.conjugate()).real == pytest.approx(0.5 * S, rel=0.02)


def test_a_source_of_known_voltage_keeps_it():
    plant = droop(1e9)
    source = grid(0.3, voltage_v=1.03 * U, angle_rad=0.4)
    state = plant.settle(OperatingPoint(0.5 * S, None), source)
    v, i = terminals(plant, state)
    mean = (1.0 + np.exp(1j * W1 * plant.dt_s)) / 2.0  # the trapezoidal rule takes the source's mean over a step
    e = v / mean + plant.grid_impedance(source) * i
    assert abs(e) * 1.5**0.5 == pytest.approx(1.03 * U, rel=1e-6)
    assert np.angle(e) == pytest.approx(0.4, abs=1e-6)


def test_what_cannot_be_started_there_walks_there_from_a_friendlier_grid():
    """Started cold on a grid of 20 % the limit latches; the same point is reached by a walk from 50 %."""
    plant = droop(0.7)
    with pytest.raises(NotSettled):
        plant.settle(OperatingPoint(0.5 * S, U), grid(0.2))
    z = 0.5 * BASE_OHM
    walked = plant.settle(OperatingPoint(0.5 * S, U), grid(0.2, settle_on=(0.1 * z, z / W1)))
    free = droop(1e9)
    started = free.settle(OperatingPoint(0.5 * S, U), grid(0.2))
    for a, b in zip(terminals(plant, walked), terminals(free, started), strict=True):
        assert abs(a) == pytest.approx(abs(b), rel=1e-4)
    assert walked.source == grid(0.2, settle_on=(0.1 * z, z / W1))


def test_a_walk_that_is_lost_says_where():
    plant = droop(1e9)
    z = 0.3 * BASE_OHM
    with pytest.raises(NotSettled, match=r"on the way from settle_on the device was lost at 0\.\d+ \+ j\d"):
        plant.settle(OperatingPoint(0.5 * S, U), grid(0.001, settle_on=(0.1 * z, z / W1)))


def test_an_idle_device_is_settled_though_its_current_is_rounding():
    """Judged by a current's own peak nothing settles at P = 0: 1e-9 A of beat is all there is."""

    def step(state, v, dt):
        n = state + 1
        return n, 1e-7 * PEAK_A * np.exp(1j * 123.4 * n * dt)

    plant = plant_from_step(step, 0, dt_s=1e-4, voltage_v=U, power_va=S, settle_tolerance=1e-4, patience_s=0.5)
    plant.settle(OperatingPoint(0.0, U), Source())
