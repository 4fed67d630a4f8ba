"""Many reference turbines on one network, and grid-side dampers: lanes are turbines, the network is taken exactly.

Equations, slots and lanes are those of `turbine`; every group of lanes has a flat array of its own. What joins them is
one network whose states go through a step by the matrices of `plant.circuits.coupled`: what a turbine's own terminals
do stands in slots of its lane, what all exchange is summed over the lanes and told to them. The stages of the
Runge-Kutta step wait for each other: each turbine's current at a stage is what all others feel. The key of the
compiled code knows all files.

Inputs that belong to no turbine: other states of the network, currents of the dampers. Outputs: voltages of the
dampers' buses, and whatever else is watched.
"""

from __future__ import annotations

from typing import NamedTuple

from .compiled import njit
from .dampers import add_rates, begin_dampers, damper_stage, dampers_look, end_dampers, feed_dampers, turned_on
from .exchange import from_2, from_4, from_6, gather, scatter
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
    _turned,
)

# Voltage at the terminals and current out of the turbine at the stage at hand, and the PLL's phasor at the start.
SEEN, UNIT = FREE, FREE + 4
# The state at the stage at hand, that at the end as far as it is summed, and the torque law of the lane.
STAGE, SUM, LAW = TONES, TONES + 17, TONES + 34
# What sources force of what is seen: what stands still in the dq frame, and what turns with -2 w1.
FORCED = TONES + 35
# In the network's frame, real parts before imaginary ones: the lane's two states and its current at the start.
IN, FED_0 = FORCED + 8, FORCED + 10
# What is seen; what is held of it for the middle and for the end, and of the next states.
RAW = IN + 6
HELD_MIDDLE, HELD_END, NEXT = IN + 10, IN + 12, IN + 14
# The current less that of the start; the mean of the two middle stages' differences, and that of the last.
DIFFERENCE, LAST = IN + 22, IN + 24
# What the lane's terminals do to themselves, in the order of `Coupled`.
OWN_START, OWN_MIDDLE, OWN_END, OWN_NEXT = IN + 28, IN + 52, IN + 76, IN + 100
OWN_DIRECT, OWN_FIRST, OWN_SECOND, OWN_LAST = IN + 124, IN + 132, IN + 140, IN + 148
N_SLOTS = IN + 164
NETWORK = [IN, IN + 1, IN + 3, IN + 4]
"""Slots of the lane's two states of the network: real parts, imaginary parts."""


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
    """What lies between the network's frame and the dampers' and turbines'.

    Attributes
    ----------
    forced : (2, f) float
        What the source forces of the outputs that belong to no turbine: what stands still in the dq frame, and what
        turns with -2 w1.
    turns : (3, 2) float
        Phasors at the start: the network's frame against dq, exp(-2j w1 t), and the latter's turn in half a step.
    w1 : float
        Speed of the network's frame against dq (rad/s).
    dampers : (d, N_DAMPER) float
        Their rows.
    """

    forced: object
    turns: object
    w1: float
    dampers: object


class Room(NamedTuple):
    """Arrays that a step works in.

    Attributes
    ----------
    rest : (q + 2 d,) float
        States of the network that belong to no turbine, then currents of the dampers at the start; taken on.
    sums, told : (r,) float
        What is exchanged.
    held : (4 d + q,) float
        Of the dampers' voltages in the middle and at the end, and of the next states.
    damper_fed : (2 d,) float
        The dampers' currents less those of the start.
    damper_last : (4 d,) float
        As the slots of `LAST`.
    rates : (2 d,) float
        Time derivatives of the dampers' currents.
    seen : (f,) float
        Outputs of the stage at hand: voltages of the dampers' buses, then what is watched.
    damper : (3, d, 8) float
        States of the dampers at the start, at the stage, and at the end as far as they are summed.
    """

    rest: object
    sums: object
    told: object
    held: object
    damper_fed: object
    damper_last: object
    rates: object
    seen: object
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
def _slopes(reactive, x, lane, z, o, c, s, p):
    """Derivatives of the device in state ``z`` and of the notch in state ``o``, under what the lane sees."""
    asked, block = _asked(x, lane, reactive, None), _load_4(x, COMP_R, lane)
    law = _law_of(p, x[LAW * LANES + lane])
    v_re, v_im, i_re, i_im = _load_4(x, SEEN, lane)
    u_re, u_im = _told(v_re, v_im, i_re, i_im, o, block)
    device, _ = _device(z, v_re, v_im, u_re, u_im, c, s, asked, law)
    return device, _notch(o, i_re, i_im, block, law.w1_rad_s)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _first_stage(reactive, x, h, p):
    """The stage at the start of a step."""
    for lane in range(LANES):
        y, n = _load_13(x, lane), _load_4(x, NOTCH, lane)
        c, s = _cos_sin(y[DELTA])
        x[UNIT * LANES + lane], x[(UNIT + 1) * LANES + lane] = c, s
        k, m = _slopes(reactive, x, lane, y, n, c, s, p)
        _store_13(x, lane + STAGE * LANES, _moved_13(y, 0.5 * h, k))
        _store_4(x, STAGE + 13, lane, _moved_4(n, 0.5 * h, m))
        _store_13(x, lane + SUM * LANES, _moved_13(y, h / 6.0, k))
        _store_4(x, SUM + 13, lane, _moved_4(n, h / 6.0, m))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _stage_slopes(reactive, x, lane, p):
    z, o = _load_13(x, lane + STAGE * LANES), _load_4(x, STAGE + 13, lane)
    c, s = _turned(x[UNIT * LANES + lane], x[(UNIT + 1) * LANES + lane], z[DELTA] - x[DELTA * LANES + lane])
    return _slopes(reactive, x, lane, z, o, c, s, p)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _middle_stage(reactive, x, part, ahead, p):
    """A stage in the middle: ``part`` times its derivatives into the sum, ``ahead`` of them to the next stage (s)."""
    for lane in range(LANES):
        k, m = _stage_slopes(reactive, x, lane, p)
        sums, notch_sums = _load_13(x, lane + SUM * LANES), _load_4(x, SUM + 13, lane)
        y, n = _load_13(x, lane), _load_4(x, NOTCH, lane)
        sums, notch_sums = _moved_13(sums, part, k), _moved_4(notch_sums, part, m)
        y, n = _moved_13(y, ahead, k), _moved_4(n, ahead, m)
        _store_13(x, lane + STAGE * LANES, y)
        _store_4(x, STAGE + 13, lane, n)
        _store_13(x, lane + SUM * LANES, sums)
        _store_4(x, SUM + 13, lane, notch_sums)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _last_stage(reactive, x, h, p):
    """The stage at the end: the sum becomes the state."""
    for lane in range(LANES):
        k, m = _stage_slopes(reactive, x, lane, p)
        sums, notch_sums = _load_13(x, lane + SUM * LANES), _load_4(x, SUM + 13, lane)
        _store_13(x, lane, _moved_13(sums, h / 6.0, k))
        _store_4(x, NOTCH, lane, _moved_4(notch_sums, h / 6.0, m))


@njit(forceinline=True)
def _load_parts(x, first, apart, lane):
    """Real parts of two numbers, then imaginary ones ``apart`` slots behind."""
    return (
        x[first * LANES + lane],
        x[(first + 1) * LANES + lane],
        x[(first + apart) * LANES + lane],
        x[(first + apart + 1) * LANES + lane],
    )


@njit(forceinline=True)
def _store_parts(x, first, apart, lane, y):
    x[first * LANES + lane] = y[0]
    x[(first + 1) * LANES + lane] = y[1]
    x[(first + apart) * LANES + lane] = y[2]
    x[(first + apart + 1) * LANES + lane] = y[3]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _look(x, frame, backward):
    """What each lane sees at the stage at hand, in the dq frame."""
    c, s = frame
    b, e = backward
    for lane in range(LANES):
        v_re, i_re, v_im, i_im = _load_4(x, RAW, lane)
        still, turning = _load_4(x, FORCED, lane), _load_4(x, FORCED + 4, lane)
        v_re, v_im, i_re, i_im = v_re * c + v_im * s, v_im * c - v_re * s, i_re * c + i_im * s, i_im * c - i_re * s
        x[SEEN * LANES + lane] = v_re + still[0] + turning[0] * b - turning[1] * e
        x[(SEEN + 1) * LANES + lane] = v_im + still[1] + turning[1] * b + turning[0] * e
        x[(SEEN + 2) * LANES + lane] = i_re + still[2] + turning[2] * b - turning[3] * e
        x[(SEEN + 3) * LANES + lane] = i_im + still[3] + turning[3] * b + turning[2] * e


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _feed_start(x, frame):
    """Currents at the start of a step; what the lanes' terminals make of them and of their states by themselves."""
    for lane in range(LANES):
        u_re, u_im = turned_on((x[I_L_RE * LANES + lane], x[I_L_IM * LANES + lane]), frame)
        x[FED_0 * LANES + lane], x[(FED_0 + 3) * LANES + lane] = u_re, u_im
        z = _load_parts(x, IN, 3, lane)
        a = z[0], z[1], u_re, z[2], z[3], u_im
        seen, middle = from_6(x, OWN_START, lane, a), from_6(x, OWN_MIDDLE, lane, a)
        end, next_one = from_6(x, OWN_END, lane, a), from_6(x, OWN_NEXT, lane, a)
        _store_4(x, RAW, lane, seen)
        _store_parts(x, HELD_MIDDLE, 6, lane, middle)
        _store_parts(x, HELD_END, 6, lane, end)
        _store_parts(x, NEXT, 6, lane, next_one)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _feed_stage(x, frame, held):
    """Currents of the stage at hand less those of the start, and what the terminals show with them by themselves."""
    for lane in range(LANES):
        at = (STAGE + I_L_RE) * LANES + lane
        u_re, u_im = turned_on((x[at], x[at + LANES]), frame)
        d = u_re - x[FED_0 * LANES + lane], u_im - x[(FED_0 + 3) * LANES + lane]
        x[DIFFERENCE * LANES + lane], x[(DIFFERENCE + 1) * LANES + lane] = d
        _store_4(x, RAW, lane, _moved_4(_load_parts(x, held, 6, lane), 1.0, from_2(x, OWN_DIRECT, lane, d)))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _hold_more(x, held, own, kept):
    """What the difference of a middle stage adds to what is held; half of it for the end, with ``kept`` of the last."""
    for lane in range(LANES):
        d = x[DIFFERENCE * LANES + lane], x[(DIFFERENCE + 1) * LANES + lane]
        _store_parts(x, held, 6, lane, _moved_4(_load_parts(x, held, 6, lane), 1.0, from_2(x, own, lane, d)))
        x[LAST * LANES + lane] = kept * x[LAST * LANES + lane] + 0.5 * d[0]
        x[(LAST + 2) * LANES + lane] = kept * x[(LAST + 2) * LANES + lane] + 0.5 * d[1]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _go_on(x):
    """The lanes' states of the network at the end of the step."""
    for lane in range(LANES):
        a = _load_4(x, LAST, lane)
        y = _moved_4(_load_parts(x, NEXT, 6, lane), 1.0, from_4(x, OWN_LAST, lane, a))
        _store_parts(x, IN, 3, lane, y)


@njit(forceinline=True)
def _keep_last(x):
    """The difference of the last stage, beside the mean of the middle ones'."""
    for lane in range(LANES):
        re, im = x[DIFFERENCE * LANES + lane], x[(DIFFERENCE + 1) * LANES + lane]
        x[(LAST + 1) * LANES + lane], x[(LAST + 3) * LANES + lane] = re, im


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _begin_network(x, wiring, room, net, frame, backward):
    """All that a step needs of the network's states and of the currents at its start."""
    first = room.rest.shape[0] - room.rates.shape[0]
    for k in range(room.rates.shape[0]):
        room.rest[first + k] = 0.0
    feed_dampers(wiring, room, frame, first)
    for k in range(room.rates.shape[0]):
        room.rest[first + k], room.damper_last[k] = room.damper_fed[k], 0.0
    for k in range(room.seen.shape[0]):
        room.seen[k] = 0.0
    for k in range(room.held.shape[0]):
        room.held[k] = 0.0
    for g in range(x.shape[0]):
        _feed_start(x[g], frame)
    gather(room.sums, room.told, net.at_start, x, IN, 3, room.rest)
    scatter(room.told, net.at_start, x, RAW, 2, 2, room.seen, 0, room.seen.shape[0])
    gather(room.sums, room.told, net.by_start, x, IN, 3, room.rest)
    scatter(room.told, net.by_start, x, HELD_MIDDLE, 6, 6, room.held, 0, room.held.shape[0])
    add_rates(x, RAW, room, net)
    dampers_look(wiring, room, frame, backward, room.seen.shape[0])
    for g in range(x.shape[0]):
        _look(x[g], frame, backward)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _network_stage(x, wiring, room, net, frame, backward, held, first_held):
    """What is seen at a later stage: what was held, and what the currents of the stage add at once."""
    n = room.rates.shape[0]
    feed_dampers(wiring, room, frame, room.rest.shape[0] - n)
    for k in range(n):
        room.seen[k] = room.held[first_held + k]
    for g in range(x.shape[0]):
        _feed_stage(x[g], frame, held)
    gather(room.sums, room.told, net.direct, x, DIFFERENCE, 1, room.damper_fed)
    scatter(room.told, net.direct, x, RAW, 2, 2, room.seen, 0, n)
    add_rates(x, RAW, room, net)
    dampers_look(wiring, room, frame, backward, n)
    for g in range(x.shape[0]):
        _look(x[g], frame, backward)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _after_middle(x, room, coupling, held, own, first_held, kept):
    """What the currents of a middle stage do later."""
    for k in range(room.damper_fed.shape[0]):
        room.damper_last[k] += 0.5 * room.damper_fed[k]
    for g in range(x.shape[0]):
        _hold_more(x[g], held, own, kept)
    gather(room.sums, room.told, coupling, x, DIFFERENCE, 1, room.damper_fed)
    scatter(room.told, coupling, x, held, 2, 6, room.held, first_held, room.damper_fed.shape[0])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _end_network(x, room, net):
    """The network's states at the end of the step."""
    n = room.damper_fed.shape[0]
    for k in range(n):
        room.damper_last[n + k] = room.damper_fed[k]
    for g in range(x.shape[0]):
        _keep_last(x[g])
    gather(room.sums, room.told, net.at_end, x, LAST, 2, room.damper_last)
    scatter(room.told, net.at_end, x, NEXT, 2, 6, room.held, 2 * n, room.rest.shape[0] - n)
    for g in range(x.shape[0]):
        _go_on(x[g])
    for k in range(room.rest.shape[0] - n):
        room.rest[k] = room.held[2 * n + k]


@njit(forceinline=True)
def _keep_sample(x, room, samples, watched):
    """v and i (re, im), v_dc, w_m and delta of every lane at the start of a step; what is watched."""
    for g in range(x.shape[0]):
        for k in range(4 * LANES):
            samples[g, k] = x[g, SEEN * LANES + k]
        for k in range(LANES):
            samples[g, 4 * LANES + k] = x[g, V_DC * LANES + k]
            samples[g, 5 * LANES + k] = x[g, W_M * LANES + k]
            samples[g, 6 * LANES + k] = x[g, DELTA * LANES + k]
    first = room.rates.shape[0]
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
    samples : (n_steps, groups, 7 LANES) array
        Receives v_pcc (re, im), i out of a turbine (re, im), v_dc, w_m, delta at the start of each step.
    watched : (n_steps, 2 w) array
        Receives what is watched, in pairs.
    net : Coupled
        What takes the network through a step.
    wiring, room
        See there.
    """
    frame, backward = (wiring.turns[0, 0], wiring.turns[0, 1]), (wiring.turns[1, 0], wiring.turns[1, 1])
    turn, turn_back = (net.turn[0], net.turn[1]), (wiring.turns[2, 0], wiring.turns[2, 1])
    n = room.rates.shape[0]
    for step in range(samples.shape[0]):
        begin_dampers(room)
        _begin_network(x, wiring, room, net, frame, backward)
        _keep_sample(x, room, samples[step], watched[step])
        for g in range(x.shape[0]):
            _first_stage(reactive, x[g], h, p)
        damper_stage(wiring, room, h / 6.0, 0.5 * h)
        frame, backward = turned_on(frame, turn), turned_on(backward, turn_back)
        _network_stage(x, wiring, room, net, frame, backward, HELD_MIDDLE, 0)
        _after_middle(x, room, net.by_first, HELD_MIDDLE, OWN_FIRST, 0, 0.0)
        for g in range(x.shape[0]):
            _middle_stage(reactive, x[g], h / 3.0, 0.5 * h, p)
        damper_stage(wiring, room, h / 3.0, 0.5 * h)
        _network_stage(x, wiring, room, net, frame, backward, HELD_MIDDLE, 0)
        _after_middle(x, room, net.by_second, HELD_END, OWN_SECOND, n, 1.0)
        for g in range(x.shape[0]):
            _middle_stage(reactive, x[g], h / 3.0, h, p)
        damper_stage(wiring, room, h / 3.0, h)
        frame, backward = turned_on(frame, turn), turned_on(backward, turn_back)
        _network_stage(x, wiring, room, net, frame, backward, HELD_END, n)
        for g in range(x.shape[0]):
            _last_stage(reactive, x[g], h, p)
        damper_stage(wiring, room, h / 6.0, 0.0)
        _end_network(x, room, net)
        end_dampers(room)
