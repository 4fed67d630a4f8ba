"""The reference turbine, each lane behind a network of its own that is taken exactly through every step.

Equations, slots and lanes are those of `turbine`; the shunt belongs to the network, which is fed the converter's
current i_L. What takes a network through a step: `plant.circuits.stepping`.
"""

from __future__ import annotations

from .compiled import njit
from .lanes import feed, show_free
from .turbine import (
    _FAST,
    COMP_R,
    DELTA,
    FED,
    FRAME,
    FREE,
    I_L_IM,
    I_L_RE,
    LANES,
    NOTCH,
    V_DC,
    V_RE,
    W_M,
    _asked,
    _clear_sums,
    _cos_sin,
    _device,
    _keep,
    _listen,
    _load_4,
    _load_13,
    _moved_4,
    _moved_13,
    _next_source,
    _notch,
    _prepare_source,
    _source,
    _store_4,
    _store_13,
    _told,
    _turned,
)


@njit(forceinline=True)
def _entries(m):
    """A (4, 2) matrix as a tuple: known before the loop over lanes."""
    return m[0, 0], m[0, 1], m[1, 0], m[1, 1], m[2, 0], m[2, 1], m[3, 0], m[3, 1]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _more(o, m, u):
    """``o + m u``."""
    re, im = u
    return (
        o[0] + m[0] * re + m[1] * im,
        o[1] + m[2] * re + m[3] * im,
        o[2] + m[4] * re + m[5] * im,
        o[3] + m[6] * re + m[7] * im,
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _turned_by(re, im, phasor):
    return re * phasor[0] - im * phasor[1], re * phasor[1] + im * phasor[0]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_network(o, phasor, v_re, v_im, i_re, i_im):
    """PCC voltage and current out of the turbine in the dq frame: what the network shows, and what sources force."""
    return (
        o[0] * phasor[0] + o[1] * phasor[1] + v_re,
        o[1] * phasor[0] - o[0] * phasor[1] + v_im,
        o[2] * phasor[0] + o[3] * phasor[1] + i_re,
        o[3] * phasor[0] - o[2] * phasor[1] + i_im,
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _network_compensated(x, n, seen, c, s, asked, block, p):
    """Derivatives of device and notch; ``seen`` is PCC voltage and current out of the turbine."""
    v_re, v_im, i_re, i_im = seen
    u_re, u_im = _told(v_re, v_im, i_re, i_im, n, block)
    device, _ = _device(x, v_re, v_im, u_re, u_im, c, s, asked, p)
    return device, _notch(n, i_re, i_im, block, p.w1_rad_s)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_network(reactive, x, p, h, net):
    """One step of the lanes, each behind a network of its own that is taken exactly through it; see `Weights`.

    The shunt belongs to the network, which is fed the converter's current i_L.
    """
    direct, by_start, by_first = _entries(net.direct), _entries(net.by_start), _entries(net.by_first)
    by_whole, by_second = _entries(net.by_whole), _entries(net.by_second)
    turn = net.turn[0], net.turn[1]
    for lane in range(LANES):
        asked, block = _asked(x, lane, reactive, None), _load_4(x, COMP_R, lane)
        voltage, current = _source(x, lane)
        y, n = _load_13(x, lane), _load_4(x, NOTCH, lane)
        free_0, free_1, free_2 = _load_4(x, FREE, lane), _load_4(x, FREE + 4, lane), _load_4(x, FREE + 8, lane)
        f0 = x[FRAME * LANES + lane], x[(FRAME + 1) * LANES + lane]
        f1 = _turned_by(f0[0], f0[1], turn)
        f2 = _turned_by(f1[0], f1[1], turn)
        x[FRAME * LANES + lane], x[(FRAME + 1) * LANES + lane] = f2
        u0 = _turned_by(y[I_L_RE], y[I_L_IM], f0)
        seen = _at_network(_more(free_0, direct, u0), f0, voltage[0], voltage[1], current[0], current[1])
        _listen(x, lane, seen[0], seen[1], seen[2], seen[3])
        c, s = _cos_sin(y[DELTA])
        k1, m1 = _network_compensated(y, n, seen, c, s, asked, block, p)
        z, o = _moved_13(y, 0.5 * h, k1), _moved_4(n, 0.5 * h, m1)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        u1 = _turned_by(z[I_L_RE], z[I_L_IM], f1)
        held = _more(free_1, by_start, u0)
        seen = _at_network(_more(held, direct, u1), f1, voltage[2], voltage[3], current[2], current[3])
        k2, m2 = _network_compensated(z, o, seen, cz, sz, asked, block, p)
        z, o = _moved_13(y, 0.5 * h, k2), _moved_4(n, 0.5 * h, m2)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        u2 = _turned_by(z[I_L_RE], z[I_L_IM], f1)
        held = _more(held, by_first, (u1[0] - u0[0], u1[1] - u0[1]))
        seen = _at_network(_more(held, direct, u2), f1, voltage[2], voltage[3], current[2], current[3])
        k3, m3 = _network_compensated(z, o, seen, cz, sz, asked, block, p)
        z, o = _moved_13(y, h, k3), _moved_4(n, h, m3)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        u3 = _turned_by(z[I_L_RE], z[I_L_IM], f2)
        held = _more(_more(free_2, by_whole, u0), by_second, (u2[0] - u0[0], u2[1] - u0[1]))
        seen = _at_network(_more(held, direct, u3), f2, voltage[4], voltage[5], current[4], current[5])
        k4, m4 = _network_compensated(z, o, seen, cz, sz, asked, block, p)
        y = _moved_13(_moved_13(_moved_13(_moved_13(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        n = _moved_4(_moved_4(_moved_4(_moved_4(n, h / 6.0, m1), h / 3.0, m2), h / 3.0, m3), h / 6.0, m4)
        _store_13(x, lane, y)
        _store_4(x, NOTCH, lane, n)
        x[(FED + 0) * LANES + lane], x[(FED + 1) * LANES + lane] = u0
        x[(FED + 2) * LANES + lane] = 0.5 * (u1[0] + u2[0])
        x[(FED + 3) * LANES + lane] = 0.5 * (u1[1] + u2[1])
        x[(FED + 4) * LANES + lane], x[(FED + 5) * LANES + lane] = u3


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_network(reactive, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, net):
    """`advance_ideal` with every lane behind a network of its own, all alike; compensated.

    Parameters
    ----------
    reactive, table, x, n_tones, p, h, block_steps, slot, kept
        As of `advance_ideal`; the source's voltage is what sources force at the PCC, its shunt voltage the current out
        of the turbine that they force.
    xi, work : (m, LANES) array
        States of the lanes' networks, and room for them.
    net : Weights
        What takes them through a step.
    """
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            show_free(x, FREE, xi, net.seen)
            _step_network(reactive, x, p, h, net)
            feed(x, FED, xi, work, net)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_tracing_network(reactive, x, n_tones, p, h, samples, xi, work, net):
    """`advance_tracing` behind a network, a sample before each step."""
    _prepare_source(x, n_tones)
    for k in range(samples.shape[0]):
        samples[k, 4], samples[k, 5], samples[k, 6] = x[V_DC * LANES], x[W_M * LANES], x[DELTA * LANES]
        show_free(x, FREE, xi, net.seen)
        _step_network(reactive, x, p, h, net)
        feed(x, FED, xi, work, net)
        for quantity in range(4):
            samples[k, quantity] = x[(V_RE + quantity) * LANES]
