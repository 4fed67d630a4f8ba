"""Step functions that tests make plants of, found in a child by name."""

from __future__ import annotations

import time

import numpy as np
from numba import njit

from seqsweep.plant.boxes.step_function import plant_from_lanes, plant_from_step

R_OHM, L_H, DT_S = 0.1, 1e-3, 50e-6
DECAY = float(np.exp(-R_OHM * DT_S / L_H))
GAIN = (1.0 - DECAY) / R_OHM
KEEP = {"dt_s": DT_S, "voltage_v": 690.0, "power_va": 1e6}


def admittance(f_hz):
    """Closed form of the branch under a voltage that is held: i_k+1 = DECAY i_k + GAIN v_k."""
    return GAIN / (np.exp(2j * np.pi * np.asarray(f_hz) * DT_S) - DECAY)


def branch_step(i, v, dt):
    i = DECAY * i + GAIN * v
    return i, i


compiled_step = njit(branch_step)


def branch():
    return plant_from_step(branch_step, 0j, **KEEP)


def compiled_branch():
    return plant_from_step(compiled_step, 0j, **KEEP)


@njit
def unbalanced_step(state, v, dt):
    """Another inductance in alpha than in beta, and iron that saturates: neither balanced nor linear."""
    a, b = state
    a = a + dt / L_H * (v.real - R_OHM * a - 1e-9 * a * a * a)
    b = b + dt / (2.0 * L_H) * (v.imag - R_OHM * b)
    return (a, b), complex(a, b)


def unbalanced():
    return plant_from_step(unbalanced_step, (0.0, 0.0), **KEEP)


def three_phase_step(state, v, dt):
    """As a colleague writes it: three phases, an array of currents."""
    from seqsweep.plant.space_vectors import abc_of, vector_of

    i_abc = state + dt / L_H * (abc_of(v) - R_OHM * state)
    return i_abc, complex(vector_of(i_abc))


def three_phase():
    return plant_from_step(three_phase_step, np.zeros(3), **KEEP)


def generator_step(state, v, dt):
    """A current source of the power asked for behind a first-order lag, in phase with v: constant power."""
    power_w, i = state
    wanted = -2.0 / 3.0 * power_w * v / max(abs(v) ** 2, 1.0)
    i = i + dt / 5e-3 * (wanted - i)
    return (power_w, i), i


def generator():
    limits = {"active_power_w": (0.0, 1e6)}
    return plant_from_step(generator_step, lambda point: (point.active_power_w, 0j), **KEEP, **limits)


def restless_step(state, v, dt):
    i = DECAY * state[0] + GAIN * v
    turn = state[1] * np.exp(2j * np.pi * 13.7 * dt)
    return (i, turn), i + turn


def restless():
    return plant_from_step(restless_step, (0j, 1 + 0j), **KEEP, patience_s=0.5)


def explosive_step(i, v, dt):
    return 1.1 * i + v, i


def explosive():
    return plant_from_step(explosive_step, 0j, **KEEP)


@njit
def mistyped_step(state, v, dt):
    return (state, v), v


def mistyped():
    return plant_from_step(mistyped_step, 0j, **KEEP)


@njit
def converter_step(state, v, dt):
    """The converter of ``boxes/box_fmu.c``, in space vectors: another text, the same device."""
    power_w, i, theta, x_pll, x = state
    r_ohm, l_h, w1 = 3e-3, 0.2e-3, 100.0 * np.pi
    turn = np.exp(1j * theta)
    v_dq, i_dq = v / turn, -i / turn
    e = power_w / (1.5 * max(abs(v_dq.real), 100.0)) - i_dq
    x_pll += dt * 10.0 * v_dq.imag
    theta = (theta + dt * (w1 + 0.5 * v_dq.imag + x_pll)) % (2.0 * np.pi)
    x += dt * 40.0 * e
    u = (0.9 * v_dq.real + 0.3 * e + x + 1j * w1 * l_h * i_dq) * turn
    i += dt / l_h * (v - u - r_ohm * i)
    return (power_w, i, theta, x_pll, x), i


def converter():
    limits = {"active_power_w": (-1e9, 1e9)}
    return plant_from_step(converter_step, lambda p: (p.active_power_w, 0j, 0.0, 0.0, 0j), **KEEP, **limits)


def lane_step(x, v, dt):
    """Two branches in parallel, one beside the other, in as many lanes as there are."""
    r_ohm, l_h = np.array([[R_OHM], [0.5]]), np.array([[L_H], [5e-3]])
    x = x + dt / l_h * (v - r_ohm * x)
    return x, x[0] + x[1]


def lanes():
    return plant_from_lanes(lane_step, np.zeros(2, complex), **KEEP)


@njit
def compiled_lane_step(i, v, dt):
    i = DECAY * i + GAIN * v
    return i, i


def compiled_lanes():
    return plant_from_lanes(compiled_lane_step, 0j, **KEEP)


def slow_branch(rest_s=0.05, every=2000):
    """The branch, resting for a moment once in every so many steps: a device whose shots take long."""

    def slow_step(state, v, dt):
        i, steps = state
        if steps % every == 0:
            time.sleep(rest_s)
        i, _ = branch_step(i, v, dt)
        return (i, steps + 1), i

    return plant_from_step(slow_step, (0j, 0), **KEEP)
