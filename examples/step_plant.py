"""A colleague's script as a plant: one step of an inductive load with a saturating core, in three phases.

    cd examples && seqsweep check python:step_plant:load

`step` takes the state, the voltage held for the step (a space vector, V, phase peak) and the step (s); it returns the
state and the current at the end of the step (A, into the device). Under `numba.njit` the same lines run a hundred
times as fast.
"""

from seqsweep.plant.boxes.step_function import plant_from_step


def step(i, v, dt):
    l_h = 5e-3 / (1.0 + abs(i) ** 2 / 4e4)
    i = i + dt / l_h * (v - 2.0 * i)
    return i, i


def load():
    return plant_from_step(step, 0j, dt_s=50e-6, voltage_v=400.0, power_va=10e3)
