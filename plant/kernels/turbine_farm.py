"""Many reference turbines on one network, and grid-side dampers: lanes are turbines, the network is taken exactly.

Equations, slots and lanes are those of `turbine`; every group of lanes has a flat array of its own. What joins them is
one network whose states go through a step by the matrices of `plant.circuits.stepping`. The stages of the Runge-Kutta
step wait for each other: each turbine's current at a stage is what all others feel. The key of the compiled code knows
both files.

Ports of the network: turbines, then dampers. Outputs (pairs): voltages of the ports, currents out of the turbines,
and whatever else is watched.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import njit
from .turbine import (
    _FAST,
    COMP_R,
    DELTA,
    FREE,
    I_L_IM,
    I_L_RE,
    LANES,
    NOTCH,
    TONES,
    V_DC,
    W_M,
    _asked,
    _cos_sin,
    _device,
    _load_4,
    _load_13,
    _moved_4,
    _moved_13,
    _notch,
    _store_4,
    _store_13,
    _told,
)

# Voltage at the terminals and current out of the turbine at the stage at hand.
SEEN = FREE
# The state at the stage at hand, that at the end as far as it is summed, and the torque law of the lane.
STAGE, SUM, LAW = TONES, TONES + 17, TONES + 34
N_SLOTS = TONES + 35

# A damper's row: nu, w_b, w_w, 1/T, y_mode, y_mirror (two each), largest current, whether it acts.
NU, W_B, W_W, RATE, Y_MODE, Y_MIRROR, LIMIT, ACTS, N_DAMPER = 0, 1, 2, 3, 4, 6, 8, 9, 10


class Law(NamedTuple):
    """The turbine's parameters that its equations use, with a torque law of its own."""

    w1_rad_s: float
    l_c_h: float
    c_dc_f: float
    v_dc_ref_v: float
    k_pp: float
    k_pi: float
    k_p: float
    k_i: float
    k_rd_ohm: float
    k_dcp: float
    k_dci: float
    k_mp: float
    k_mi: float
    k_mrd_ohm: float
    i_limit_a: float
    pole_pairs: float
    l_s_h: float
    r_s_ohm: float
    flux_wb: float
    inertia_kgm2: float
    k_opt: float
    rho_kgm3: float
    radius_m: float
    c_q1: float
    c_q2: float


class Wiring(NamedTuple):
    """How lanes and dampers hang on the network.

    Attributes
    ----------
    device : (groups LANES,) int
        The turbine of a lane; idle lanes follow the first.
    factor : (n,) float
        Equal turbines that a turbine stands for.
    forced : (2, o) float
        What the source forces: what stands still in the dq frame, and what turns with -2 w1.
    rates : (o, p) float
        Of the time derivatives of the port currents.
    turns : (3, 2) float
        Phasors at the start: the network's frame against dq, exp(-2j w1 t), and the latter's turn in half a step.
    w1 : float
        Speed of the network's frame against dq (rad/s).
    dampers : (d, N_DAMPER) float
        Their rows.
    """

    device: object
    factor: object
    forced: object
    rates: object
    turns: object
    w1: float
    dampers: object


class Room(NamedTuple):
    """Arrays that a step works in.

    Attributes
    ----------
    states : (m,) float
        Of the network; the kernel takes them on.
    next_states : (m,) float
        Room for them.
    fed, change : (5, p), (p,) float
        Port currents at the four stages and, last, their time derivatives; a difference of two stages.
    seen, held : (o,) float
        Outputs of a stage, and what of them does not depend on the stage's own currents.
    damper : (3, d, 8) float
        States of the dampers at the start, at the stage, and at the end as far as they are summed.
    """

    states: object
    next_states: object
    fed: object
    change: object
    seen: object
    held: object
    damper: object


@njit(forceinline=True)
def _law_of(p, k_opt):
    return Law(
        p.w1_rad_s,
        p.l_c_h,
        p.c_dc_f,
        p.v_dc_ref_v,
        p.k_pp,
        p.k_pi,
        p.k_p,
        p.k_i,
        p.k_rd_ohm,
        p.k_dcp,
        p.k_dci,
        p.k_mp,
        p.k_mi,
        p.k_mrd_ohm,
        p.i_limit_a,
        p.pole_pairs,
        p.l_s_h,
        p.r_s_ohm,
        p.flux_wb,
        p.inertia_kgm2,
        k_opt,
        p.rho_kgm3,
        p.radius_m,
        p.c_q1,
        p.c_q2,
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _add_product(out, matrix, vector):
    """``out += matrix vector``."""
    for row in range(matrix.shape[0]):
        total = 0.0
        for column in range(matrix.shape[1]):
            total += matrix[row, column] * vector[column]
        out[row] += total


@njit(forceinline=True)
def _copy(out, vector):
    for k in range(out.shape[0]):
        out[k] = vector[k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _begin(x):
    """The stage at the start of a step."""
    for k in range(13 * LANES):
        x[STAGE * LANES + k] = x[k]
        x[SUM * LANES + k] = x[k]
    for k in range(4 * LANES):
        x[(STAGE + 13) * LANES + k] = x[NOTCH * LANES + k]
        x[(SUM + 13) * LANES + k] = x[NOTCH * LANES + k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _end(x):
    """The sum of a step becomes the state."""
    for k in range(13 * LANES):
        x[k] = x[SUM * LANES + k]
    for k in range(4 * LANES):
        x[NOTCH * LANES + k] = x[(SUM + 13) * LANES + k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _stage(reactive, x, part, ahead, p):
    """Derivatives at the stage at hand: ``part`` times them into the sum, ``ahead`` of them to the next stage (s)."""
    for lane in range(LANES):
        asked, block = _asked(x, lane, reactive), _load_4(x, COMP_R, lane)
        law = _law_of(p, x[LAW * LANES + lane])
        z, o = _load_13(x, lane + STAGE * LANES), _load_4(x, STAGE + 13, lane)
        v_re, v_im, i_re, i_im = _load_4(x, SEEN, lane)
        c, s = _cos_sin(z[DELTA])
        u_re, u_im = _told(v_re, v_im, i_re, i_im, o, block)
        k = _device(z, v_re, v_im, u_re, u_im, c, s, asked, law)
        m = _notch(o, i_re, i_im, block, law.w1_rad_s)
        sums, notch_sums = _load_13(x, lane + SUM * LANES), _load_4(x, SUM + 13, lane)
        y, n = _moved_13(_load_13(x, lane), ahead, k), _moved_4(_load_4(x, NOTCH, lane), ahead, m)
        sums, notch_sums = _moved_13(sums, part, k), _moved_4(notch_sums, part, m)
        _store_13(x, lane + STAGE * LANES, y)
        _store_4(x, STAGE + 13, lane, n)
        _store_13(x, lane + SUM * LANES, sums)
        _store_4(x, SUM + 13, lane, notch_sums)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _asked_of(row, state):
    """Current (A) that a damper asks for, within its limit; a complex number."""
    asked = complex(row[Y_MODE], row[Y_MODE + 1]) * complex(state[2], state[3])
    asked += complex(row[Y_MIRROR], row[Y_MIRROR + 1]) * complex(state[4], state[5])
    size = math.sqrt(asked.real * asked.real + asked.imag * asked.imag)
    share = row[ACTS] * min(1.0, row[LIMIT] / max(size, 1e-300))
    return complex(share * asked.real, share * asked.imag)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _damper_stage(wiring, room, n, part, ahead):
    """The dampers' derivatives at the stage at hand, from the voltages seen at the ports after the ``n`` turbines'."""
    start, stage, sums = room.damper[0], room.damper[1], room.damper[2]
    for d in range(wiring.dampers.shape[0]):
        row, state = wiring.dampers[d], stage[d]
        v = complex(room.seen[2 * (n + d)], room.seen[2 * (n + d) + 1])
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
def _feed_in(x, wiring, room, at, frame):
    """Port currents of the stage at hand as row ``at``, and the dampers' derivatives, which act at once."""
    n = wiring.factor.shape[0]
    c, s = frame
    for k in range(n):
        lanes, lane, factor = x[k // LANES], k % LANES, wiring.factor[k]
        re, im = lanes[(STAGE + I_L_RE) * LANES + lane], lanes[(STAGE + I_L_IM) * LANES + lane]
        room.fed[at, 2 * k] = factor * (re * c - im * s)
        room.fed[at, 2 * k + 1] = factor * (re * s + im * c)
    for d in range(wiring.dampers.shape[0]):
        row, state = wiring.dampers[d], room.damper[1, d]
        i = complex(state[6], state[7])
        rate = row[RATE] * (_asked_of(row, state) - i) + complex(-wiring.w1 * i.imag, wiring.w1 * i.real)
        turned, turned_rate = i * complex(c, s), rate * complex(c, s)
        room.fed[at, 2 * (n + d)] = -turned.real
        room.fed[at, 2 * (n + d) + 1] = -turned.imag
        room.fed[4, 2 * (n + d)] = -turned_rate.real
        room.fed[4, 2 * (n + d) + 1] = -turned_rate.imag


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _look(x, wiring, room, net, at, frame, backward):
    """Outputs of the stage at hand, in the dq frame, and what of them each lane sees."""
    _copy(room.seen, room.held)
    _add_product(room.seen, net.direct, room.fed[at])
    if wiring.dampers.shape[0] > 0:
        _add_product(room.seen, wiring.rates, room.fed[4])
    c, s = frame
    b, e = backward
    for k in range(room.seen.shape[0] // 2):
        re, im = room.seen[2 * k], room.seen[2 * k + 1]
        f_re, f_im = wiring.forced[1, 2 * k], wiring.forced[1, 2 * k + 1]
        room.seen[2 * k] = re * c + im * s + wiring.forced[0, 2 * k] + f_re * b - f_im * e
        room.seen[2 * k + 1] = im * c - re * s + wiring.forced[0, 2 * k + 1] + f_im * b + f_re * e
    n = wiring.factor.shape[0]
    first = n + wiring.dampers.shape[0]  # of the currents
    for place in range(wiring.device.shape[0]):
        lanes, lane, k = x[place // LANES], place % LANES, wiring.device[place]
        one = 1.0 / wiring.factor[k]
        lanes[SEEN * LANES + lane], lanes[(SEEN + 1) * LANES + lane] = room.seen[2 * k], room.seen[2 * k + 1]
        lanes[(SEEN + 2) * LANES + lane] = one * room.seen[2 * (first + k)]
        lanes[(SEEN + 3) * LANES + lane] = one * room.seen[2 * (first + k) + 1]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _differ(room, at):
    """``change`` becomes the difference of row ``at`` from the first."""
    for k in range(room.change.shape[0]):
        room.change[k] = room.fed[at, k] - room.fed[0, k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _hold(room, net, place, by_start):
    """What the network shows of its states and of the first currents alone, at a place of the step."""
    for k in range(room.held.shape[0]):
        room.held[k] = 0.0
    _add_product(room.held, net.seen[place], room.states)
    if place > 0:
        _add_product(room.held, by_start, room.fed[0])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _go_on(room, net):
    """The network's states at the end of the step."""
    for k in range(room.change.shape[0]):
        room.change[k] = 0.5 * (room.fed[1, k] + room.fed[2, k])
    for k in range(room.states.shape[0]):
        room.next_states[k] = 0.0
    _add_product(room.next_states, net.keep, room.states)
    _add_product(room.next_states, net.start, room.fed[0])
    _add_product(room.next_states, net.middle, room.change)
    _add_product(room.next_states, net.end, room.fed[3])
    _copy(room.states, room.next_states)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _all_stages(reactive, x, wiring, room, part, ahead, p):
    for g in range(x.shape[0]):
        _stage(reactive, x[g], part, ahead, p)
    _damper_stage(wiring, room, wiring.factor.shape[0], part, ahead)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _turned_on(phasor, turn):
    return phasor[0] * turn[0] - phasor[1] * turn[1], phasor[0] * turn[1] + phasor[1] * turn[0]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _keep_sample(x, wiring, room, samples, watched):
    """v and i (re, im), v_dc, w_m and delta of every turbine at the start of a step; what is watched."""
    n = wiring.factor.shape[0]
    for k in range(n):
        lanes, lane = x[k // LANES], k % LANES
        for quantity in range(4):
            samples[k, quantity] = lanes[(SEEN + quantity) * LANES + lane]
        samples[k, 4], samples[k, 5] = lanes[V_DC * LANES + lane], lanes[W_M * LANES + lane]
        samples[k, 6] = lanes[DELTA * LANES + lane]
    first = 2 * (2 * n + wiring.dampers.shape[0])
    for k in range(watched.shape[0]):
        watched[k] = room.seen[first + k]


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_farm(reactive, x, p, h, samples, watched, net, wiring, room):
    """Advance a farm by as many steps as there are samples.

    Parameters
    ----------
    reactive : True or None
        As of `turbine.advance_ideal`.
    x : (groups, N_SLOTS LANES) array
        Everything of the turbines' lanes.
    p : TurbineParameters
        The same for all turbines but for the torque law, which is in their slots.
    h : float
        Step (s).
    samples : (n_steps, n, 7) array
        Receives v_pcc (re, im), i out of a turbine (re, im), v_dc, w_m, delta at the start of each step.
    watched : (n_steps, 2 w) array
        Receives the outputs after those, in pairs.
    net : Weights
        What takes the network through a step.
    wiring, room
        See there.
    """
    frame, backward = (wiring.turns[0, 0], wiring.turns[0, 1]), (wiring.turns[1, 0], wiring.turns[1, 1])
    turn, turn_back = (net.turn[0], net.turn[1]), (wiring.turns[2, 0], wiring.turns[2, 1])
    for step in range(samples.shape[0]):
        for g in range(x.shape[0]):
            _begin(x[g])
        for d in range(room.damper.shape[1]):
            for j in range(8):
                room.damper[1, d, j] = room.damper[0, d, j]
                room.damper[2, d, j] = room.damper[0, d, j]
        _feed_in(x, wiring, room, 0, frame)
        _hold(room, net, 0, net.by_start)
        _look(x, wiring, room, net, 0, frame, backward)
        _keep_sample(x, wiring, room, samples[step], watched[step])
        _all_stages(reactive, x, wiring, room, h / 6.0, 0.5 * h, p)
        frame, backward = _turned_on(frame, turn), _turned_on(backward, turn_back)
        _feed_in(x, wiring, room, 1, frame)
        _hold(room, net, 1, net.by_start)
        _look(x, wiring, room, net, 1, frame, backward)
        _all_stages(reactive, x, wiring, room, h / 3.0, 0.5 * h, p)
        _differ(room, 1)
        _feed_in(x, wiring, room, 2, frame)
        _add_product(room.held, net.by_first, room.change)
        _look(x, wiring, room, net, 2, frame, backward)
        _all_stages(reactive, x, wiring, room, h / 3.0, h, p)
        frame, backward = _turned_on(frame, turn), _turned_on(backward, turn_back)
        _feed_in(x, wiring, room, 3, frame)
        _hold(room, net, 2, net.by_whole)
        _differ(room, 2)
        _add_product(room.held, net.by_second, room.change)
        _look(x, wiring, room, net, 3, frame, backward)
        _all_stages(reactive, x, wiring, room, h / 6.0, 0.0, p)
        _go_on(room, net)
        for g in range(x.shape[0]):
            _end(x[g])
        for d in range(room.damper.shape[1]):
            for j in range(8):
                room.damper[0, d, j] = room.damper[2, d, j]
