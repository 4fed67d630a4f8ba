"""Grid-following and grid-forming inverters, stepped in lanes: independent experiments in lock step.

One circuit serves both: L_f R_f, the capacitor C_f with R_c in series, L_g R_g, the point of common coupling
(PCC), and the line of the source. The ideal source is a line of no impedance: no case of its own. Two
controls, following and forming, give the bridge voltage; their variants are coefficients, not flags.

Everything is per unit on the device's rating, in the frame that rotates at w1, where an operating point is
a fixed point; currents flow out of the device. Everything of a batch lives in ONE flat array,
``x[slot * LANES + lane]``: see `turbine` for the reason. What steps the network behind a lane is in `lanes`.
Integrator: classical Runge-Kutta of order four.

A *compensated* lane has a block between measurement and controller that tells the controller another
voltage than the capacitor's (docs/damping.md); the circuit goes on with its own.
"""

from __future__ import annotations

import math

from .compiled import njit
from .lanes import FAST as _FAST
from .lanes import LANES, feed, show_free

# States: circuit, then one of the two controls, then the notch at the measurement port. Complex ones take two slots.
I_C, V_C, I_G, V_DC = 0, 2, 4, 6
THETA, OMEGA, Q_M, V_P, EPS, THETA_P, XI, GAMMA, PHI = 7, 8, 9, 10, 12, 13, 14, 16, 18
DELTA, X_PLL, S_P, S_Q, P_F, Q_F, GAMMA_F, V_F = 7, 8, 9, 10, 11, 12, 13, 15
NOTCH_B, NOTCH_Q = 20, 22
N_STATES = 24

# Constants of a lane: source, line, references, current into the DC link and its slope, compensation.
V_S, LINE_R, LINE_L = 24, 26, 27
P_REF, Q_REF, V_REF = 28, 29, 30
DC_I, DC_SLOPE = 31, 32
COMP, NOTCH_WIDTH = 33, 35
# The sample at the start of the last step: voltage at the PCC, current out of the device.
V_RE, V_IM, I_RE, I_IM = range(36, 40)
# Demodulation: phasor exp(j (2 pi f - w1) t), the taper's phasor, their rotations per step, its gain.
LINE, LINE_ROT, TAPER, TAPER_ROT, TAPER_GAIN = 40, 42, 44, 46, 48
# Sums of w re(x) re(line), w im(x) im(line), w im(x) re(line), w re(x) im(line), for v and for i.
SUM_V, SUM_I = 49, 53
# The source of the step at hand, but for the first tone: at its start, middle and end.
SOURCE = 57
# Behind a network: the voltage that it shows at start, middle and end of the step if nothing is fed in, and what is fed
# in then.
FREE, FED = 63, 69
# Tones: phasor in the dq frame, rotation per half step. The first one's place, then the list of all.
TONE, TONES = 75, 79
N_TONE_SLOTS = 4

# Blackman taper as a0 + a1 c + a2 c^2 with the cosine c of the taper's phase.
TAPER_0, TAPER_1, TAPER_2 = 0.42 - 0.08, -0.5, 2.0 * 0.08

# Whether there is a block at the measurement port, or a DC link that moves: tuples, whose lengths the compiler knows,
# so that no test is left in the code.
ABSENT, PRESENT = (), (True,)


def array_slots(n_tones):
    """Slots of a flat array with room for ``n_tones`` tones."""
    return TONES + N_TONE_SLOTS * n_tones


# ---------------------------------------------------------------------- arithmetic


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _cis(angle):
    """exp(j angle) without a branch or a call, to about 1e-16 (polynomials after reduction)."""
    quadrant = math.floor(angle * 0.6366197723675814 + 0.5)
    r = angle - quadrant * 1.5707963267948966
    r = r - quadrant * 6.123233995736766e-17
    z = r * r
    s = 1.58969099521155010221e-10
    s = -2.50507602534068634195e-08 + z * s
    s = 2.75573137070700676789e-06 + z * s
    s = -1.98412698298579493134e-04 + z * s
    s = 8.33333333332248946124e-03 + z * s
    sin_r = r + r * z * (-1.66666666666666324348e-01 + z * s)
    c = -1.13596475577881948265e-11
    c = 2.08757232129817482790e-09 + z * c
    c = -2.75573143513906633035e-07 + z * c
    c = 2.48015872894767294178e-05 + z * c
    c = -1.38888888888741095749e-03 + z * c
    cos_r = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * c)
    quarter = quadrant - 4.0 * math.floor(quadrant * 0.25)
    odd = quarter - 2.0 * math.floor(quarter * 0.5)
    sign = 1.0 - 2.0 * math.floor(quarter * 0.5)
    return complex(sign * (cos_r - odd * (sin_r + cos_r)), sign * (sin_r + odd * (cos_r - sin_r)))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _turned(unit, angle):
    """``unit`` turned by a small further ``angle`` (|angle| << 1, error angle^5 / 120)."""
    z = angle * angle
    sin_a = angle * (1.0 - z * (1.0 / 6.0) * (1.0 - z * 0.05))
    cos_a = 1.0 - 0.5 * z * (1.0 - z * (1.0 / 12.0) * (1.0 - z * (1.0 / 30.0)))
    return unit * complex(cos_a, sin_a)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _times(a, z):
    """``a z`` for a real ``a``; numba would make ``a`` complex first, and multiply by its zero."""
    return complex(a * z.real, a * z.imag)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _j_times(a, z):
    """``j a z`` for a real ``a``."""
    return complex(-a * z.imag, a * z.real)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _conj_times(a, z):
    """``conj(a) z``."""
    return complex(a.real * z.real + a.imag * z.imag, a.real * z.imag - a.imag * z.real)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _on(x, h, k):
    """``x + h k``, real."""
    return x + h * k


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _on_2(x, h, k):
    """``x + h k``, complex."""
    return complex(x.real + h * k.real, x.imag + h * k.imag)


@njit(forceinline=True)
def _get(x, slot, lane):
    return complex(x[slot * LANES + lane], x[(slot + 1) * LANES + lane])


@njit(forceinline=True)
def _put(x, slot, lane, value):
    x[slot * LANES + lane] = value.real
    x[(slot + 1) * LANES + lane] = value.imag


# ---------------------------------------------------------------------- physics


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _circuit(y, e, v, v_s, line, p):
    """Derivatives of (i_c, v_C, i_g) under the bridge voltage ``e``; ``v`` is the capacitor branch's voltage.

    ``line`` is (r, wb / (l_g + l)).
    """
    i_c, v_c, i_g = y
    r, w_over_l = line
    wb = p.w1_rad_s
    through_f = e - v - _times(p.r_f_pu, i_c)
    through_g = v - v_s - _times(p.r_g_pu + r, i_g)
    return (
        _times(wb / p.l_f_pu, through_f) - _j_times(wb, i_c),
        _times(wb / p.c_f_pu, i_c - i_g) - _j_times(wb, v_c),
        _times(w_over_l, through_g) - _j_times(wb, i_g),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _link(w, e, i_c, dc, inverse_v_dc, p):
    """Derivative of v_dc, the one of ``w``; ``dc`` is the current into the link at rated voltage and its slope."""
    if len(w) == 0:
        return ()
    power = e.real * i_c.real + e.imag * i_c.imag
    return ((dc[0] + dc[1] * (w[0] - 1.0) - power * inverse_v_dc) / p.c_dc_s,)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_pcc(y, v_s, r, share, p):
    """v_pcc = v_s + (r + j l + l/wb d/dt) i_g, with ``share`` = l / (l_g + l)."""
    i_c, v_c, i_g = y
    v = v_c + _times(p.r_c_pu, i_c - i_g)
    return v_s + _times(r, i_g) + _times(share, v - v_s - _times(p.r_g_pu + r, i_g))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _told(v, i_g, n, block):
    """Voltage that the controller is told: v - (R + j X) H_NF i_g, with i_g out of the device."""
    if len(block) == 0:
        return v
    return v - block[0] * (i_g - n[0])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _notch(n, i_g, block, wb):
    """Derivatives of the notch's states b, q: H_NF i = i - b, b' = width (i - b) - wb q, q' = wb b, seen at w1."""
    if len(n) == 0:
        return ()
    b, q = n
    width = block[1]
    return (
        _times(width, i_g - b) - _times(wb, q) - _j_times(wb, b),
        _times(wb, b) - _j_times(wb, q),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _forming(c, v, i_c, i_g, units, refs, w, p):
    """Derivatives of a virtual synchronous machine's control, its bridge voltage, and 1 / v_dc.

    ``v`` is the voltage it is told, ``units`` are exp(j theta) and exp(j theta_p), ``refs`` (P*, Q*, V*), ``w`` v_dc in
    a tuple, or nothing where it is constant.
    """
    _, speed, q_m, v_p, eps, _, xi, gamma, phi = c
    unit, unit_p = units
    p_ref, q_ref, v_ref = refs
    s = _conj_times(i_g, v)
    # PLL: only damping of the rotor needs it. One division serves it and the DC link.
    if len(w) == 0:
        a, inverse_v_dc = v_p.imag / v_p.real, 1.0
    else:
        inverse = 1.0 / (w[0] * v_p.real)
        a, inverse_v_dc = v_p.imag * w[0] * inverse, inverse * v_p.real
    w_pll = 1.0 + p.k_ppll * a + p.k_ipll * eps
    # Rotor and reactive droop.
    acceleration = (p_ref - s.real - p.k_d * (speed - w_pll) - p.k_w * (speed - 1.0)) / p.t_a_s
    v_wanted = v_ref + p.k_q * (q_ref - q_m)
    # Virtual impedance, voltage and current control, active damping.
    v_dq, i_c_dq, i_g_dq = _conj_times(unit, v), _conj_times(unit, i_c), _conj_times(unit, i_g)
    error_v = v_wanted - _times(p.r_v_pu, i_g_dq) - _j_times(speed * p.l_v_pu, i_g_dq) - v_dq
    i_wanted = _times(p.k_pv, error_v) + _times(p.k_iv, xi) + _j_times(speed * p.c_f_pu, v_dq) + _times(p.k_ffi, i_g_dq)
    error_i = i_wanted - i_c_dq
    e_dq = (
        _times(p.k_pc, error_i)
        + _times(p.k_ic, gamma)
        + _j_times(speed * p.l_f_pu, i_c_dq)
        + _times(p.k_ffv - p.k_ad, v_dq)
        + _times(p.k_ad, phi)
    )
    k = (
        p.w1_rad_s * (speed - 1.0),
        acceleration,
        p.w_f_rad_s * (s.imag - q_m),
        _times(p.w_lp_rad_s, _conj_times(unit_p, v) - v_p),
        a,
        p.w1_rad_s * (w_pll - 1.0),
        error_v,
        error_i,
        _times(p.w_ad_rad_s, v_dq - phi),
    )
    return k, unit * e_dq, inverse_v_dc


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _following(c, v, i_c, i_g, unit, refs, w, p):
    """Derivatives of a grid-following control, its bridge voltage, and 1 / v_dc; arguments as `_forming`."""
    _, x_pll, s_p, s_q, p_m, q_m, gamma, v_f = c
    p_ref, q_ref, v_ref = refs
    s = _conj_times(i_g, v)
    v_dq, i_dq = _conj_times(unit, v), _conj_times(unit, i_c)
    size = math.sqrt(v.real * v.real + v.imag * v.imag)
    # Outer loops: active power and DC voltage, reactive power and AC voltage, by their weights.
    if len(w) == 0:
        error_p, inverse_v_dc = p.c_p * (p_ref - p_m), 1.0
    else:
        error_p, inverse_v_dc = p.c_p * (p_ref - p_m) + p.c_dc * (w[0] - 1.0), 1.0 / w[0]
    error_q = p.c_q * (q_ref - q_m) + p.c_v * (v_ref - size)
    i_wanted = complex(p.k_p * error_p + s_p, -(p.k_q * error_q + s_q))
    error_i = i_wanted - i_dq
    e_dq = _times(p.k_pc, error_i) + gamma + _j_times(p.k_rd, i_dq) + _times(p.k_ff, v_f)
    k = (
        p.w1_rad_s * (p.k_ppll * v_dq.imag + x_pll),
        p.k_ipll * v_dq.imag,
        p.k_i * error_p,
        p.k_iq * error_q,
        p.w_m_rad_s * (s.real - p_m),
        p.w_m_rad_s * (s.imag - q_m),
        _times(p.k_ic, error_i),
        _times(p.w_ff_rad_s, v_dq - v_f),
    )
    return k, unit * e_dq, inverse_v_dc


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _forming_all(y, w, c, n, v_s, units, constants, block, p):
    """Derivatives of circuit, DC link, forming control and notch; ``w``, ``n`` and ``block`` are empty without them."""
    line, refs, dc = constants
    i_c, v_c, i_g = y
    v = v_c + _times(p.r_c_pu, i_c - i_g)
    u = _told(v, i_g, n, block)
    k_c, e, inverse = _forming(c, u, i_c, i_g, units, refs, w, p)
    k_n = _notch(n, i_g, block, p.w1_rad_s)
    return _circuit(y, e, v, v_s, line, p), _link(w, e, i_c, dc, inverse, p), k_c, k_n


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _following_all(y, w, c, n, v_s, unit, constants, block, p):
    """Derivatives of circuit, DC link, following control, notch; ``w``, ``n`` and ``block`` are empty without them."""
    line, refs, dc = constants
    i_c, v_c, i_g = y
    v = v_c + _times(p.r_c_pu, i_c - i_g)
    u = _told(v, i_g, n, block)
    k_c, e, inverse = _following(c, u, i_c, i_g, unit, refs, w, p)
    k_n = _notch(n, i_g, block, p.w1_rad_s)
    return _circuit(y, e, v, v_s, line, p), _link(w, e, i_c, dc, inverse, p), k_c, k_n


# ---------------------------------------------------------------------- states in and out, and moved


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_circuit(y, h, k):
    """``y + h k`` for (i_c, v_C, i_g)."""
    return _on_2(y[0], h, k[0]), _on_2(y[1], h, k[1]), _on_2(y[2], h, k[2])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_link(w, h, k):
    if len(w) == 0:
        return ()
    return (_on(w[0], h, k[0]),)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_forming(c, h, k):
    return (
        _on(c[0], h, k[0]),
        _on(c[1], h, k[1]),
        _on(c[2], h, k[2]),
        _on_2(c[3], h, k[3]),
        _on(c[4], h, k[4]),
        _on(c[5], h, k[5]),
        _on_2(c[6], h, k[6]),
        _on_2(c[7], h, k[7]),
        _on_2(c[8], h, k[8]),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_following(c, h, k):
    return (
        _on(c[0], h, k[0]),
        _on(c[1], h, k[1]),
        _on(c[2], h, k[2]),
        _on(c[3], h, k[3]),
        _on(c[4], h, k[4]),
        _on(c[5], h, k[5]),
        _on_2(c[6], h, k[6]),
        _on_2(c[7], h, k[7]),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_notch(n, h, k):
    if len(n) == 0:
        return ()
    return _on_2(n[0], h, k[0]), _on_2(n[1], h, k[1])


@njit(forceinline=True)
def _load_circuit(x, lane):
    return _get(x, I_C, lane), _get(x, V_C, lane), _get(x, I_G, lane)


@njit(forceinline=True)
def _load_link(x, lane, link):
    if len(link) == 0:
        return ()
    return (x[V_DC * LANES + lane],)


@njit(forceinline=True)
def _store_link(x, lane, w):
    if len(w) != 0:
        x[V_DC * LANES + lane] = w[0]


@njit(forceinline=True)
def _store_circuit(x, lane, y):
    _put(x, I_C, lane, y[0])
    _put(x, V_C, lane, y[1])
    _put(x, I_G, lane, y[2])


@njit(forceinline=True)
def _load_forming(x, lane):
    return (
        x[THETA * LANES + lane],
        x[OMEGA * LANES + lane],
        x[Q_M * LANES + lane],
        _get(x, V_P, lane),
        x[EPS * LANES + lane],
        x[THETA_P * LANES + lane],
        _get(x, XI, lane),
        _get(x, GAMMA, lane),
        _get(x, PHI, lane),
    )


@njit(forceinline=True)
def _store_forming(x, lane, c):
    x[THETA * LANES + lane] = c[0]
    x[OMEGA * LANES + lane] = c[1]
    x[Q_M * LANES + lane] = c[2]
    _put(x, V_P, lane, c[3])
    x[EPS * LANES + lane] = c[4]
    x[THETA_P * LANES + lane] = c[5]
    _put(x, XI, lane, c[6])
    _put(x, GAMMA, lane, c[7])
    _put(x, PHI, lane, c[8])


@njit(forceinline=True)
def _load_following(x, lane):
    return (
        x[DELTA * LANES + lane],
        x[X_PLL * LANES + lane],
        x[S_P * LANES + lane],
        x[S_Q * LANES + lane],
        x[P_F * LANES + lane],
        x[Q_F * LANES + lane],
        _get(x, GAMMA_F, lane),
        _get(x, V_F, lane),
    )


@njit(forceinline=True)
def _store_following(x, lane, c):
    x[DELTA * LANES + lane] = c[0]
    x[X_PLL * LANES + lane] = c[1]
    x[S_P * LANES + lane] = c[2]
    x[S_Q * LANES + lane] = c[3]
    x[P_F * LANES + lane] = c[4]
    x[Q_F * LANES + lane] = c[5]
    _put(x, GAMMA_F, lane, c[6])
    _put(x, V_F, lane, c[7])


@njit(forceinline=True)
def _load_notch(x, lane, port):
    if len(port) == 0:
        return ()
    return _get(x, NOTCH_B, lane), _get(x, NOTCH_Q, lane)


@njit(forceinline=True)
def _load_block(x, lane, port):
    if len(port) == 0:
        return ()
    return _get(x, COMP, lane), x[NOTCH_WIDTH * LANES + lane]


@njit(forceinline=True)
def _store_notch(x, lane, n):
    if len(n) != 0:
        _put(x, NOTCH_B, lane, n[0])
        _put(x, NOTCH_Q, lane, n[1])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _constants(x, lane, p):
    """((r, wb / (l_g + l)), (P*, Q*, V*), (current into the DC link, its slope)) of a lane."""
    w_over_l = p.w1_rad_s / (p.l_g_pu + x[LINE_L * LANES + lane])
    return (
        (x[LINE_R * LANES + lane], w_over_l),
        (x[P_REF * LANES + lane], x[Q_REF * LANES + lane], x[V_REF * LANES + lane]),
        (x[DC_I * LANES + lane], x[DC_SLOPE * LANES + lane]),
    )


# ---------------------------------------------------------------------- source and listening


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _listen(x, lane, v, i):
    """Keep the sample and add it, tapered and demodulated, to the sums of its line."""
    _put(x, V_RE, lane, v)
    _put(x, I_RE, lane, i)
    taper = _get(x, TAPER, lane)
    c = taper.real
    weight = x[TAPER_GAIN * LANES + lane] * (TAPER_0 + c * (TAPER_1 + c * TAPER_2))
    _put(x, TAPER, lane, taper * _get(x, TAPER_ROT, lane))
    line = _get(x, LINE, lane)
    w_re, w_im = weight * line.real, weight * line.imag
    x[(SUM_V + 0) * LANES + lane] += v.real * w_re
    x[(SUM_V + 1) * LANES + lane] += v.imag * w_im
    x[(SUM_V + 2) * LANES + lane] += v.imag * w_re
    x[(SUM_V + 3) * LANES + lane] += v.real * w_im
    x[(SUM_I + 0) * LANES + lane] += i.real * w_re
    x[(SUM_I + 1) * LANES + lane] += i.imag * w_im
    x[(SUM_I + 2) * LANES + lane] += i.imag * w_re
    x[(SUM_I + 3) * LANES + lane] += i.real * w_im
    _put(x, LINE, lane, line * _get(x, LINE_ROT, lane))


@njit(forceinline=True)
def _prepare_source(x, n_tones):
    """Source without tones into its place, and the first tone into its own, before the first step.

    The lone tone of a sweep stays there: a moving offset inside the step would hide from the compiler
    that the lanes do not overlap.
    """
    _still_source(x)
    for i in range(N_TONE_SLOTS * LANES):
        x[TONE * LANES + i] = x[TONES * LANES + i] if n_tones > 0 else 0.0


@njit(forceinline=True)
def _still_source(x):
    """The source voltage without any tone, at start, middle and end."""
    for lane in range(LANES):
        for place in range(3):
            x[(SOURCE + 2 * place) * LANES + lane] = x[V_S * LANES + lane]
            x[(SOURCE + 2 * place + 1) * LANES + lane] = x[(V_S + 1) * LANES + lane]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _further_tones(x, n_tones):
    """The source of this step with all tones but the first, and those tones one step on."""
    _still_source(x)
    for tone in range(1, n_tones):
        first = TONES + N_TONE_SLOTS * tone
        for lane in range(LANES):
            v, rotation = _get(x, first, lane), _get(x, first + 2, lane)
            for place in range(3):
                if place > 0:
                    v = v * rotation
                _put(x, SOURCE + 2 * place, lane, _get(x, SOURCE + 2 * place, lane) + v)
            _put(x, first, lane, v)


@njit(forceinline=True)
def _tabled_source(x, table, row):
    """The source of this step from its ``table``, whose rows are half steps of one period."""
    n_rows = table.shape[0]
    for place in range(3):
        at = (row + place) % n_rows
        for quantity in range(2):
            for lane in range(LANES):
                x[(SOURCE + 2 * place + quantity) * LANES + lane] = table[at, quantity, lane]


@njit(forceinline=True)
def _next_source(x, n_tones, table, row):
    """The source of the next step, but for the first tone; the row of the table after it."""
    if table.shape[0] > 0:
        _tabled_source(x, table, row)
        return (row + 2) % table.shape[0]
    if n_tones > 1:
        _further_tones(x, n_tones)
    return row


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _source(x, lane):
    """Source voltage at start, middle and end of the step; the first tone moves on."""
    tone, rotation = _get(x, TONE, lane), _get(x, TONE + 2, lane)
    tone_1 = tone * rotation
    tone_2 = tone_1 * rotation
    _put(x, TONE, lane, tone_2)
    return (
        _get(x, SOURCE, lane) + tone,
        _get(x, SOURCE + 2, lane) + tone_1,
        _get(x, SOURCE + 4, lane) + tone_2,
    )


# ---------------------------------------------------------------------- a network behind the terminals


@njit(forceinline=True)
def _load_free(x, lane, net):
    if len(net) == 0:
        return ()
    return _get(x, FREE, lane), _get(x, FREE + 2, lane), _get(x, FREE + 4, lane)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_start(v, free):
    """Voltage behind the line at the start of a step; the three that follow are the stages', fed by ``u`` so far."""
    if len(free) == 0:
        return v
    return v + free[0]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_first(v, free, net, u0):
    if len(free) == 0:
        return v
    return v + free[1] + net[0] * u0


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_second(v, free, net, u0, u1):
    if len(free) == 0:
        return v
    return v + free[1] + net[0] * u0 + net[1] * (u1 - u0)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_end(v, free, net, u0, u2):
    if len(free) == 0:
        return v
    return v + free[2] + net[2] * u0 + net[3] * (u2 - u0)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _store_fed(x, lane, net, u0, u1, u2, u3):
    if len(net) != 0:
        _put(x, FED, lane, u0)
        _put(x, FED + 2, lane, _times(0.5, u1 + u2))
        _put(x, FED + 4, lane, u3)


@njit(forceinline=True)
def _complex_of(m):
    """The complex number that a (2, 2) matrix of pairs stands for."""
    return complex(m[0, 0], m[1, 0])


# ---------------------------------------------------------------------- the steps


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _hear_pcc(x, lane, y, v_s, p):
    """Listen to the PCC at the start of the step."""
    line_l = x[LINE_L * LANES + lane]
    _listen(x, lane, _at_pcc(y, v_s, x[LINE_R * LANES + lane], line_l / (p.l_g_pu + line_l), p), y[2])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_forming(x, p, h, port, link, net):
    """One step of every lane; ``port`` and ``link`` are `ABSENT` or `PRESENT`, ``net`` is `ABSENT` or four weights."""
    for lane in range(LANES):
        constants, block = _constants(x, lane, p), _load_block(x, lane, port)
        v0, v1, v2 = _source(x, lane)
        y, c, n = _load_circuit(x, lane), _load_forming(x, lane), _load_notch(x, lane, port)
        w, free = _load_link(x, lane, link), _load_free(x, lane, net)
        v0 = _at_start(v0, free)
        _hear_pcc(x, lane, y, v0, p)
        u, u_p = _cis(c[0]), _cis(c[5])
        units = u, u_p
        a, b = h / 6.0, h / 3.0
        k, k_dc, m, r = _forming_all(y, w, c, n, v0, units, constants, block, p)
        w_end = _moved_link(w, a, k_dc)
        y_end, c_end, n_end = _moved_circuit(y, a, k), _moved_forming(c, a, m), _moved_notch(n, a, r)
        u_dc = _moved_link(w, 0.5 * h, k_dc)
        z, d, o = _moved_circuit(y, 0.5 * h, k), _moved_forming(c, 0.5 * h, m), _moved_notch(n, 0.5 * h, r)
        u1, v = z[2], _at_first(v1, free, net, y[2])
        units = _turned(u, d[0] - c[0]), _turned(u_p, d[5] - c[5])
        k, k_dc, m, r = _forming_all(z, u_dc, d, o, v, units, constants, block, p)
        w_end = _moved_link(w_end, b, k_dc)
        y_end, c_end, n_end = _moved_circuit(y_end, b, k), _moved_forming(c_end, b, m), _moved_notch(n_end, b, r)
        u_dc = _moved_link(w, 0.5 * h, k_dc)
        z, d, o = _moved_circuit(y, 0.5 * h, k), _moved_forming(c, 0.5 * h, m), _moved_notch(n, 0.5 * h, r)
        u2, v = z[2], _at_second(v1, free, net, y[2], u1)
        units = _turned(u, d[0] - c[0]), _turned(u_p, d[5] - c[5])
        k, k_dc, m, r = _forming_all(z, u_dc, d, o, v, units, constants, block, p)
        w_end = _moved_link(w_end, b, k_dc)
        y_end, c_end, n_end = _moved_circuit(y_end, b, k), _moved_forming(c_end, b, m), _moved_notch(n_end, b, r)
        u_dc = _moved_link(w, h, k_dc)
        z, d, o = _moved_circuit(y, h, k), _moved_forming(c, h, m), _moved_notch(n, h, r)
        v = _at_end(v2, free, net, y[2], u2)
        units = _turned(u, d[0] - c[0]), _turned(u_p, d[5] - c[5])
        k, k_dc, m, r = _forming_all(z, u_dc, d, o, v, units, constants, block, p)
        _store_fed(x, lane, net, y[2], u1, u2, z[2])
        _store_link(x, lane, _moved_link(w_end, a, k_dc))
        _store_circuit(x, lane, _moved_circuit(y_end, a, k))
        _store_forming(x, lane, _moved_forming(c_end, a, m))
        _store_notch(x, lane, _moved_notch(n_end, a, r))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_following(x, p, h, port, link, net):
    """One step of every lane; ``port`` and ``link`` are `ABSENT` or `PRESENT`, ``net`` is `ABSENT` or four weights."""
    for lane in range(LANES):
        constants, block = _constants(x, lane, p), _load_block(x, lane, port)
        v0, v1, v2 = _source(x, lane)
        y, c, n = _load_circuit(x, lane), _load_following(x, lane), _load_notch(x, lane, port)
        w, free = _load_link(x, lane, link), _load_free(x, lane, net)
        v0 = _at_start(v0, free)
        _hear_pcc(x, lane, y, v0, p)
        u = _cis(c[0])
        a, b = h / 6.0, h / 3.0
        k, k_dc, m, r = _following_all(y, w, c, n, v0, u, constants, block, p)
        w_end = _moved_link(w, a, k_dc)
        y_end, c_end, n_end = _moved_circuit(y, a, k), _moved_following(c, a, m), _moved_notch(n, a, r)
        u_dc = _moved_link(w, 0.5 * h, k_dc)
        z, d, o = _moved_circuit(y, 0.5 * h, k), _moved_following(c, 0.5 * h, m), _moved_notch(n, 0.5 * h, r)
        u1, v = z[2], _at_first(v1, free, net, y[2])
        k, k_dc, m, r = _following_all(z, u_dc, d, o, v, _turned(u, d[0] - c[0]), constants, block, p)
        w_end = _moved_link(w_end, b, k_dc)
        y_end, c_end, n_end = _moved_circuit(y_end, b, k), _moved_following(c_end, b, m), _moved_notch(n_end, b, r)
        u_dc = _moved_link(w, 0.5 * h, k_dc)
        z, d, o = _moved_circuit(y, 0.5 * h, k), _moved_following(c, 0.5 * h, m), _moved_notch(n, 0.5 * h, r)
        u2, v = z[2], _at_second(v1, free, net, y[2], u1)
        k, k_dc, m, r = _following_all(z, u_dc, d, o, v, _turned(u, d[0] - c[0]), constants, block, p)
        w_end = _moved_link(w_end, b, k_dc)
        y_end, c_end, n_end = _moved_circuit(y_end, b, k), _moved_following(c_end, b, m), _moved_notch(n_end, b, r)
        u_dc = _moved_link(w, h, k_dc)
        z, d, o = _moved_circuit(y, h, k), _moved_following(c, h, m), _moved_notch(n, h, r)
        v = _at_end(v2, free, net, y[2], u2)
        k, k_dc, m, r = _following_all(z, u_dc, d, o, v, _turned(u, d[0] - c[0]), constants, block, p)
        _store_fed(x, lane, net, y[2], u1, u2, z[2])
        _store_link(x, lane, _moved_link(w_end, a, k_dc))
        _store_circuit(x, lane, _moved_circuit(y_end, a, k))
        _store_following(x, lane, _moved_following(c_end, a, m))
        _store_notch(x, lane, _moved_notch(n_end, a, r))


@njit(forceinline=True)
def _clear_sums(x):
    for i in range(8 * LANES):
        x[SUM_V * LANES + i] = 0.0


@njit(forceinline=True)
def _keep(x, slot, kept, block):
    for quantity in range(kept.shape[1]):
        for lane in range(LANES):
            kept[block, quantity, lane] = x[(slot + quantity) * LANES + lane]


@njit(forceinline=True)
def _advance(step, port, link, table, x, n_tones, p, h, block_steps, slot, kept):
    """All lanes through all blocks with one of the two steps."""
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            step(x, p, h, port, link, ABSENT)
        _keep(x, slot, kept, block)


@njit(forceinline=True)
def _advance_network(step, link, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights):
    """`_advance` with every lane behind a network of its own, all alike; compensated."""
    net = (
        _complex_of(weights.by_start),
        _complex_of(weights.by_first),
        _complex_of(weights.by_whole),
        _complex_of(weights.by_second),
    )
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            show_free(x, FREE, xi, weights.seen)
            step(x, p, h, PRESENT, link, net)
            feed(x, FED, xi, work, weights)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming(table, x, n_tones, p, h, block_steps, slot, kept):
    """Advance all lanes of a grid-forming device by blocks.

    Parameters
    ----------
    table : (n, 2, LANES) array
        Source voltage (re, im; pu) at the half steps of one period from the first step on; of no rows where the
        source is made of tones.
    x : flat array
        Everything of the lanes; see the slots above.
    n_tones : int
        Tones of a lane, beside the table.
    p : FormingParameters
        The same for all lanes.
    h : float
        Step (s).
    block_steps : int
        Steps of a block.
    slot : int
        First slot that is kept of every block: `V_RE` for samples, `SUM_V` for sums.
    kept : (n_blocks, n_slots, LANES) array
        Receives, after each block, the slots from ``slot`` on: the sample at the start of the block's
        last step, or the block's sums.
    """
    _advance(_step_forming, ABSENT, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming_compensated(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_forming` with the lanes' compensation before the controller."""
    _advance(_step_forming, PRESENT, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_forming` for a grid-following device; ``p`` are `FollowingParameters`."""
    _advance(_step_following, ABSENT, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following_compensated(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_following` with the lanes' compensation before the controller."""
    _advance(_step_following, PRESENT, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming_linked(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_forming` with a DC link of finite capacitance."""
    _advance(_step_forming, ABSENT, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming_linked_compensated(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_forming` with a DC link of finite capacitance and the lanes' compensation before the controller."""
    _advance(_step_forming, PRESENT, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following_linked(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_following` with a DC link of finite capacitance."""
    _advance(_step_following, ABSENT, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following_linked_compensated(table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_following` with a DC link of finite capacitance and the lanes' compensation before the controller."""
    _advance(_step_following, PRESENT, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming_network(table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights):
    """`advance_forming_compensated` with every lane behind a network of its own, all alike.

    Parameters
    ----------
    table, x, n_tones, p, h, block_steps, slot, kept
        As of `advance_forming`; the lane's line is what the network lets through at once, the source's voltage what it
        shows if the device feeds nothing in.
    xi, work : (m, LANES) array
        States of the lanes' networks, and room for them.
    weights : Weights
        What takes them through a step.
    """
    _advance_network(_step_forming, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_forming_linked_network(table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights):
    """`advance_forming_network` with a DC link of finite capacitance."""
    _advance_network(_step_forming, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following_network(table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights):
    """`advance_forming_network` for a grid-following device."""
    _advance_network(_step_following, ABSENT, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_following_linked_network(table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights):
    """`advance_following_network` with a DC link of finite capacitance."""
    _advance_network(_step_following, PRESENT, table, x, n_tones, p, h, block_steps, slot, kept, xi, work, weights)
