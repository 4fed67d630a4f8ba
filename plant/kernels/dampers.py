"""Grid-side dampers beside the lanes of a farm: band-passes, washout, lag and limit (`plant.damping.grid_side`)."""

from __future__ import annotations

import math

from .compiled import njit
from .lanes import FAST as _FAST
from .lanes import LANES

# A damper's row: nu, w_b, w_w (rad/s), 1/T (1/s), y_mode, y_mirror (S, two each), largest current (A), whether it acts.
NU, W_B, W_W, RATE, Y_MODE, Y_MIRROR, LIMIT, ACTS, N_DAMPER = 0, 1, 2, 3, 4, 6, 8, 9, 10


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def turned_on(phasor, turn):
    """A phasor (re, im) turned by another."""
    return phasor[0] * turn[0] - phasor[1] * turn[1], phasor[0] * turn[1] + phasor[1] * turn[0]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _asked_of(row, state):
    """Current (A) that a damper asks for, within its limit; a complex number."""
    asked = complex(row[Y_MODE], row[Y_MODE + 1]) * complex(state[2], state[3])
    asked += complex(row[Y_MIRROR], row[Y_MIRROR + 1]) * complex(state[4], state[5])
    size = math.sqrt(asked.real * asked.real + asked.imag * asked.imag)
    share = row[ACTS] * min(1.0, row[LIMIT] / max(size, 1e-300))
    return complex(share * asked.real, share * asked.imag)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def damper_stage(wiring, room, part, ahead):
    """The dampers' derivatives at the stage at hand, from the voltages seen at their buses."""
    start, stage, sums = room.damper[0], room.damper[1], room.damper[2]
    for d in range(wiring.dampers.shape[0]):
        row, state = wiring.dampers[d], stage[d]
        v = complex(room.seen[2 * d], room.seen[2 * d + 1])
        steady, nu = complex(state[0], state[1]), complex(0.0, row[NU])
        fast = v - steady
        k_0 = row[W_W] * fast
        k_1 = (nu - row[W_B]) * complex(state[2], state[3]) + row[W_B] * fast
        k_2 = (-nu - row[W_B]) * complex(state[4], state[5]) + row[W_B] * fast
        k_3 = row[RATE] * (_asked_of(row, state) - complex(state[6], state[7]))
        for j, k in ((0, k_0), (2, k_1), (4, k_2), (6, k_3)):
            sums[d, j] += part * k.real
            sums[d, j + 1] += part * k.imag
            stage[d, j] = start[d, j] + ahead * k.real
            stage[d, j + 1] = start[d, j + 1] + ahead * k.imag


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def feed_dampers(wiring, room, frame, first):
    """Currents that the dampers feed in at the stage at hand, which act at once, and their rates; the network's frame.

    At the start of a step they are put beside the other states from number ``first`` on, later their differences taken.
    """
    for d in range(wiring.dampers.shape[0]):
        row, state = wiring.dampers[d], room.damper[1, d]
        i = complex(state[6], state[7])
        rate = row[RATE] * (_asked_of(row, state) - i) + complex(-wiring.w1 * i.imag, wiring.w1 * i.real)
        turned, turned_rate = i * complex(frame[0], frame[1]), rate * complex(frame[0], frame[1])
        room.damper_fed[2 * d], room.damper_fed[2 * d + 1] = -turned.real, -turned.imag
        room.rates[2 * d], room.rates[2 * d + 1] = -turned_rate.real, -turned_rate.imag
    for k in range(room.damper_fed.shape[0]):
        room.damper_fed[k] -= room.rest[first + k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def add_rates(x, raw, room, net):
    """What the rates of the dampers' currents add at once, to the lanes from slot ``raw`` on."""
    n = room.rates.shape[0]
    for g in range(x.shape[0]):
        for j in range(n):
            rate = room.rates[j]
            for k in range(4 * LANES):
                x[g, raw * LANES + k] += net.rates_seen[g, j, k] * rate
    for row in range(net.by_rates.shape[0] if n > 0 else 0):
        for j in range(n):
            room.seen[row] += net.by_rates[row, j] * room.rates[j]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def dampers_look(wiring, room, frame, backward, n_rows):
    """The first ``n_rows`` outputs that belong to no turbine, in the dq frame."""
    c, s = frame
    b, e = backward
    for k in range(n_rows // 2):
        re, im = room.seen[2 * k], room.seen[2 * k + 1]
        f_re, f_im = wiring.forced[1, 2 * k], wiring.forced[1, 2 * k + 1]
        room.seen[2 * k] = re * c + im * s + wiring.forced[0, 2 * k] + f_re * b - f_im * e
        room.seen[2 * k + 1] = im * c - re * s + wiring.forced[0, 2 * k + 1] + f_im * b + f_re * e


@njit(forceinline=True)
def begin_dampers(room):
    """The stage at the start of a step."""
    for d in range(room.damper.shape[1]):
        for j in range(8):
            room.damper[1, d, j] = room.damper[0, d, j]
            room.damper[2, d, j] = room.damper[0, d, j]


@njit(forceinline=True)
def end_dampers(room):
    """The sum of a step becomes the state."""
    for d in range(room.damper.shape[1]):
        for j in range(8):
            room.damper[0, d, j] = room.damper[2, d, j]
