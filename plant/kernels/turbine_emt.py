"""The reference turbine by a second-order step in the manner of EMT programs: one evaluation of the controls per step.

The same flat array, slots and drivers as `turbine`, whose equations these are; half the work, and a larger
error (docs/turbine.md). Every quantity stands at whole steps; the step looks at its own middle:

1. the PLL's phasor exp(j delta) is turned to the middle of the step by what it saw in its first half;
2. machine and DC link are taken to the middle;
3. the controller of the current speaks once, there, and the network answers over the whole step. The
   controller's gain is solved together with the network, so that neither waits for the other;
4. everything else goes the whole step with what was found.

The network is exact with an ideal source (an exponential, the source a parabola over the step: `_Current`) and
goes by the trapezoidal rule behind a line (`_Branches`, `_companion`). An equilibrium of the equations is a
fixed point, whatever the step. While a limit acts the step is of first order, because the limit is laid on a
voltage foreseen without it; the limit itself is kept.

Complex numbers are space vectors in the dq frame at w1 or, after ``* unit.conjugate()``, in the PLL's.

This file stays whole: a cached kernel must call nothing outside its own file, because numba does not notice an edit
elsewhere and would go on with the old machine code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import njit
from .turbine import (
    DELTA,
    GRID_1_L,
    GRID_R,
    I_D_LIMIT,
    I_G_RE,
    I_L_RE,
    I_Q_REF,
    I_RE,
    I_SD,
    I_SQ,
    LANES,
    LINE_RE,
    LINE_ROT_RE,
    N_TONE_SLOTS,
    SOURCE,
    SUM_I,
    SUM_V,
    TAPER_0,
    TAPER_1,
    TAPER_2,
    TAPER_GAIN,
    TAPER_RE,
    TAPER_ROT_RE,
    TONE,
    TONES,
    V_C_RE,
    V_CS_RE,
    V_DC,
    V_RE,
    V_S_RE,
    W_M,
    WIND,
    X_PLL,
    XI_D,
    XI_DC,
    XI_Q,
    XI_SD,
    XI_SQ,
)

# What a step leaves to the next in the source's slots: the PLL's phasor. Then, with an ideal source, its voltage at
# start, middle and end of the step and the shunt voltage that it forces at start and end; behind a line, its mean and
# the lane's companion network (`_companion`).
UNIT = SOURCE
V_START, V_MIDDLE, V_END, V_C_START, V_C_END = range(SOURCE + 2, SOURCE + 12, 2)
V_MEAN, G_LINE, KEEP_LINE, DRIVE_V, LIMIT = range(SOURCE + 2, SOURCE + 12, 2)

# No "nnan" and no "ninf": a diverged lane must be seen.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


class _Current(NamedTuple):
    """Lc di/dt = u - k i - v - j w1 Lc i over a step, k the controller's gain: what drives i_L, and how much.

    The controller's own ramp within the step counts to third order: its integrator's by ``ramp`` and a
    slightly smaller Lc, the PLL's by ``late``. Without that the whole would be as inexact as a trapezoid.

    Attributes
    ----------
    keep : complex
        What is left of the current.
    drive : complex
        Weight of a constant u (S).
    limit : complex
        Weight of the voltage that the limit takes (S).
    start, middle, end : complex
        Weights of v, a parabola through its three values (S).
    mean, change : complex
        Mean current of the step: mean (u - mean v) - change (new - old current) (S, 1).
    limit_mean : complex
        Weight, in the mean current, of the voltage that the limit takes (S).
    ramp : float
        Gain that the current controller's integrator adds to u by ramping (ohm).
    late : float
        How much further than the middle, in half steps, the PLL stands where u counts.
    """

    keep: complex
    drive: complex
    limit: complex
    start: complex
    middle: complex
    end: complex
    mean: complex
    change: complex
    limit_mean: complex
    ramp: float
    late: float


class _Branches(NamedTuple):
    """Lc with the controller's gain, and the shunt, in the middle of a step; ' at its start.

    i_L = g_c (u + from_i i_L' - v) and v = keep v_C' + z_f (i_L - i_g).

    Attributes
    ----------
    g_c, r_c : complex
        Conductance of Lc and its inverse (S, ohm).
    z_f : complex
        Impedance of the shunt (ohm).
    from_i : float
        Weight of i_L' (ohm).
    from_v_c : complex
        Weight of v_C' in the units of u: keep r_c / z_f.
    """

    g_c: complex
    r_c: complex
    z_f: complex
    from_i: float
    from_v_c: complex


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _get(x, slot, lane):
    return complex(x[slot * LANES + lane], x[(slot + 1) * LANES + lane])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _put(x, slot, lane, value):
    x[slot * LANES + lane], x[(slot + 1) * LANES + lane] = value.real, value.imag


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _dot(a, b):
    """Re(a conj b): power of voltage and current."""
    return a.real * b.real + a.imag * b.imag


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _turned(unit, angle):
    """A phasor after a small further ``angle`` (|angle| << 1, error angle^6 / 720), its length set right."""
    z = angle * angle
    sin_a = angle * (1.0 - z * (1.0 / 6.0) * (1.0 - z * 0.05))
    cos_a = 1.0 - 0.5 * z * (1.0 - z * (1.0 / 12.0))
    return unit * (1.5 - 0.5 * _dot(unit, unit)) * complex(cos_a, sin_a)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _pll_gain(p, h):
    return p.k_pp + 0.5 * h * p.k_pi


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _current_gain(p, h):
    """Current controller's gain over half a step (ohm): v_conv = exp(j delta) (Re k i* + xi) - k i_L.

    To the middle its integrator moves by half a step of Ki (i* - i).
    """
    return complex(p.k_p + 0.5 * h * p.k_i, -p.k_rd_ohm)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _machine(x, lane, p, h):
    """Machine, its current control and the rotor go one step; power into the DC link in the middle (W)."""
    i_d, i_q = x[I_SD * LANES + lane], x[I_SQ * LANES + lane]
    xi_d, xi_q, w_m = x[XI_SD * LANES + lane], x[XI_SQ * LANES + lane], x[W_M * LANES + lane]
    wind = x[WIND * LANES + lane]
    w_mid = w_m + 0.5 * h * _acceleration(w_m, i_q, wind, p)
    w_e = p.pole_pairs * w_mid
    i_q_ref = p.k_opt / (p.pole_pairs * p.flux_wb) * w_mid * w_mid
    # Currents: d = half their change, (gain + j turn) d = their drift over half a step. turn << gain.
    per_v = 0.5 * h / p.l_s_h
    k = p.k_mp + 0.5 * h * p.k_mi
    gain = 1.0 / (1.0 + per_v * (k + p.r_s_ohm))
    x_e = w_e * p.l_s_h - p.k_mrd_ohm
    drift_d = per_v * gain * (x_e * i_q - (k + p.r_s_ohm) * i_d - xi_d)
    drift_q = per_v * gain * (w_e * p.flux_wb + k * i_q_ref - (k + p.r_s_ohm) * i_q - x_e * i_d - xi_q)
    turn = per_v * gain * x_e
    d_d, d_q = drift_d + turn * drift_q, drift_q - turn * drift_d
    i_d_mid, i_q_mid = i_d + d_d, i_q + d_q
    error_q = i_q_mid - i_q_ref
    x[I_SD * LANES + lane], x[I_SQ * LANES + lane] = i_d_mid + d_d, i_q_mid + d_q
    x[XI_SD * LANES + lane] = xi_d + h * p.k_mi * i_d_mid
    x[XI_SQ * LANES + lane] = xi_q + h * p.k_mi * error_q
    x[W_M * LANES + lane] = w_m + h * _acceleration(w_mid, i_q_mid, wind, p)
    return (k * i_d_mid + xi_d) * i_d_mid + (k * error_q + xi_q) * i_q_mid


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _acceleration(w_m, i_q, wind, p):
    """Of the rotor (rad/s^2): aerodynamic less electric torque."""
    slip = p.radius_m * w_m
    torque_aero = 0.5 * p.rho_kgm3 * math.pi * p.radius_m**3 * slip * (p.c_q1 * wind - p.c_q2 * slip)
    return (torque_aero - p.pole_pairs * p.flux_wb * i_q) * (1.0 / p.inertia_kgm2)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _pll_to_middle(x, lane, v, p, h):
    """The PLL's phasor half a step on, and the angle it took (rad); ``v`` of the first half, or of the start."""
    unit = _get(x, UNIT, lane)
    angle = 0.5 * h * (p.k_pp * (v * unit.conjugate()).imag + x[X_PLL * LANES + lane])
    return _turned(unit, angle), angle


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _pll_to_end(x, lane, v, unit, angle, p, h):
    """The PLL goes one step, by the voltage ``v`` and the phasor of its middle (or their means)."""
    v_q = (v * unit.conjugate()).imag
    whole = h * (_pll_gain(p, h) * v_q + x[X_PLL * LANES + lane])
    x[X_PLL * LANES + lane] += h * p.k_pi * v_q
    x[DELTA * LANES + lane] += whole
    _put(x, UNIT, lane, _turned(unit, whole - angle))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _reference(reactive, x, lane, i_d_wanted, p):
    """Reference of the current within its limit (A): d + j q, but d alone where ``reactive`` is None."""
    if reactive is None:
        return min(max(i_d_wanted, -p.i_limit_a), p.i_limit_a)
    limit = x[I_D_LIMIT * LANES + lane]
    return complex(min(max(i_d_wanted, -limit), limit), x[I_Q_REF * LANES + lane])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _dc_to_middle(reactive, x, lane, i, power_in, p, h):
    """DC voltage (V), current reference (A) in the middle, and the volts a watt adds over the step; xi_dc moves.

    ``i`` at the start, ``power_in`` in the middle.
    """
    v_dc, xi_dc = x[V_DC * LANES + lane], x[XI_DC * LANES + lane]
    # What the converter takes at the start.
    i_ref = _reference(reactive, x, lane, p.k_dcp * (v_dc - p.v_dc_ref_v) + xi_dc, p)
    v_conv = (_get(x, XI_D, lane) + p.k_p * i_ref) * _get(x, UNIT, lane) - p.k_p * i  # but for what turns with i
    power_out = _dot(v_conv, i)
    inverse = 1.0 / v_dc
    per_w = h / p.c_dc_f * inverse
    rise = 0.5 * per_w * (power_in - power_out)
    v_dc_mid = v_dc + rise
    error_dc = v_dc_mid - p.v_dc_ref_v
    i_d_wanted = (p.k_dcp + 0.5 * h * p.k_dci) * error_dc + xi_dc
    i_ref = _reference(reactive, x, lane, i_d_wanted, p)
    x[XI_DC * LANES + lane] = xi_dc + h * (p.k_dci * error_dc + p.k_dci / p.k_dcp * (i_ref.real - i_d_wanted))
    return v_dc_mid, i_ref, per_w - per_w * inverse * rise


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _limited(wanted, v_dc):
    """Share of the ``wanted`` converter voltage that v_dc / sqrt(2) lets through."""
    squared = _dot(wanted, wanted)
    return min(1.0, v_dc * (math.sqrt(0.5 * squared) * (1.0 / squared)))  # root and division side by side


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _control_to_end(reactive, x, lane, i_ref, i, unit, lost, p, h):
    """The current controller's integrators go one step; ``lost`` is what the limit took (V), ``i`` the current (A)."""
    slope = (p.k_i / p.k_p * lost - p.k_i * i) * unit.conjugate()
    x[XI_D * LANES + lane] += h * (p.k_i * i_ref.real + slope.real)
    x[XI_Q * LANES + lane] += h * slope.imag if reactive is None else h * (p.k_i * i_ref.imag + slope.imag)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _listen(x, lane, v, i):
    """Keep the sample and add it, tapered and demodulated, to the sums of its line."""
    _put(x, V_RE, lane, v)
    _put(x, I_RE, lane, i)
    taper, line = _get(x, TAPER_RE, lane), _get(x, LINE_RE, lane)
    weight = x[TAPER_GAIN * LANES + lane] * (TAPER_0 + taper.real * (TAPER_1 + taper.real * TAPER_2))
    _put(x, TAPER_RE, lane, taper * _get(x, TAPER_ROT_RE, lane))
    _put(x, LINE_RE, lane, line * _get(x, LINE_ROT_RE, lane))
    w_re, w_im = weight * line.real, weight * line.imag
    x[(SUM_V + 0) * LANES + lane] += v.real * w_re
    x[(SUM_V + 1) * LANES + lane] += v.imag * w_im
    x[(SUM_V + 2) * LANES + lane] += v.imag * w_re
    x[(SUM_V + 3) * LANES + lane] += v.real * w_im
    x[(SUM_I + 0) * LANES + lane] += i.real * w_re
    x[(SUM_I + 1) * LANES + lane] += i.imag * w_im
    x[(SUM_I + 2) * LANES + lane] += i.imag * w_re
    x[(SUM_I + 3) * LANES + lane] += i.real * w_im


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _add(x, slot, lane, value):
    x[slot * LANES + lane] += value.real
    x[(slot + 1) * LANES + lane] += value.imag


@njit(forceinline=True)
def _clear(x, slot, n_slots):
    for k in range(n_slots * LANES):
        x[slot * LANES + k] = 0.0


@njit(forceinline=True)
def _fetch_tone(x, tone):
    """Put a tone where it is worked on: a moving offset would hide from the compiler that lanes do not overlap."""
    first = (TONES + N_TONE_SLOTS * tone) * LANES
    for k in range(N_TONE_SLOTS * LANES):
        x[TONE * LANES + k] = x[first + k]


@njit(forceinline=True)
def _return_tone(x, tone):
    first = (TONES + N_TONE_SLOTS * tone) * LANES
    for k in range(2 * LANES):
        x[first + k] = x[TONE * LANES + k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _tone_at_pcc(x, lane):
    """The tone at hand at start, middle and end of the step, and the shunt voltages it forces at start and end.

    It goes one step.
    """
    start, half, shunt = _get(x, TONE, lane), _get(x, TONE + 2, lane), _get(x, TONE + 4, lane)
    middle = start * half
    end = middle * half
    _put(x, TONE, lane, end)
    return start, middle, end, shunt * start, shunt * end


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _tone_behind_line(x, lane):
    """The tone at hand, the mean of its start and end of the step; it goes one step."""
    start, half = _get(x, TONE, lane), _get(x, TONE + 2, lane)
    end = start * half * half
    _put(x, TONE, lane, end)
    return 0.5 * (start + end)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _further_tones_at_pcc(x, n_tones):
    """Sums over all tones but the first, which is always at hand."""
    _clear(x, V_START, 10)
    _return_tone(x, 0)
    for tone in range(1, n_tones):
        _fetch_tone(x, tone)
        for lane in range(LANES):
            start, middle, end, forced_start, forced_end = _tone_at_pcc(x, lane)
            _add(x, V_START, lane, start)
            _add(x, V_MIDDLE, lane, middle)
            _add(x, V_END, lane, end)
            _add(x, V_C_START, lane, forced_start)
            _add(x, V_C_END, lane, forced_end)
        _return_tone(x, tone)
    _fetch_tone(x, 0)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _further_tones_behind_line(x, n_tones):
    """Sum over all tones but the first, which is always at hand."""
    _clear(x, V_MEAN, 2)
    _return_tone(x, 0)
    for tone in range(1, n_tones):
        _fetch_tone(x, tone)
        for lane in range(LANES):
            _add(x, V_MEAN, lane, _tone_behind_line(x, lane))
        _return_tone(x, tone)
    _fetch_tone(x, 0)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_ideal(reactive, x, n_tones, p, h, decay, w):
    """One step with the source at the PCC itself; ``decay`` is the shunt's over a step, ``w`` a `_Current`."""
    if n_tones > 1:
        _further_tones_at_pcc(x, n_tones)
    k = _current_gain(p, h)
    for lane in range(LANES):
        tone = _tone_at_pcc(x, lane)
        v_s, v_cs = _get(x, V_S_RE, lane), _get(x, V_CS_RE, lane)
        v0 = v_s + _get(x, V_START, lane) + tone[0]
        v1 = v_s + _get(x, V_MIDDLE, lane) + tone[1]
        v2 = v_s + _get(x, V_END, lane) + tone[2]
        i, v_c = _get(x, I_L_RE, lane), _get(x, V_C_RE, lane)
        _listen(x, lane, v0, i - (v0 - v_c) * (1.0 / p.r_f_ohm))
        # Shunt: exact forced response plus the decaying rest of what went before.
        rest = v_c - v_cs - _get(x, V_C_START, lane) - tone[3]
        _put(x, V_C_RE, lane, v_cs + _get(x, V_C_END, lane) + tone[4] + rest * decay)
        v_third, v_mean = (2.0 * v0 + 8.0 * v1 - v2) * (1.0 / 9.0), (v0 + 4.0 * v1 + v2) * (1.0 / 6.0)
        unit, angle = _pll_to_middle(x, lane, v_third, p, h)
        power_in = _machine(x, lane, p, h)
        v_dc, i_ref, per_w = _dc_to_middle(reactive, x, lane, i, power_in, p, h)
        u = (_get(x, XI_D, lane) + k.real * i_ref) * unit
        u_counts = u * complex(1.0, w.late * angle) + (w.ramp * i_ref) * unit
        free = w.keep * i + w.drive * u_counts - w.start * v0 - w.middle * v1 - w.end * v2
        mean = w.mean * (u - v_mean) - w.change * (free - i)
        wanted = u - k * mean
        share = _limited(wanted, v_dc)
        lost = (share - 1.0) * wanted
        i_mid = mean + w.limit_mean * lost
        _put(x, I_L_RE, lane, free + w.limit * lost)
        x[V_DC * LANES + lane] += per_w * (power_in - share * _dot(wanted, i_mid))
        _control_to_end(reactive, x, lane, i_ref, i_mid, unit, lost, p, h)
        _pll_to_end(x, lane, v_mean, unit, angle, p, h)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_thevenin(reactive, x, n_tones, p, h, branches):
    """One step behind the lane's Thevenin impedance; ``branches`` from `_branches`.

    In the middle of the step v and i_L are what the network remembers, plus what u drives; u is the
    converter's voltage less the controller's gain times i_L, which belongs to the network.
    """
    if n_tones > 1:
        _further_tones_behind_line(x, n_tones)
    k = _current_gain(p, h)
    for lane in range(LANES):
        i, v_c, i_g = _get(x, I_L_RE, lane), _get(x, V_C_RE, lane), _get(x, I_G_RE, lane)
        v0 = v_c + p.r_f_ohm * (i - i_g)
        _listen(x, lane, v0, i_g)
        unit, angle = _pll_to_middle(x, lane, v0, p, h)
        power_in = _machine(x, lane, p, h)
        v_dc, i_ref, per_w = _dc_to_middle(reactive, x, lane, i, power_in, p, h)
        v_s = _get(x, V_S_RE, lane) + _get(x, V_MEAN, lane) + _tone_behind_line(x, lane)
        g_line, drive_v = _get(x, G_LINE, lane), _get(x, DRIVE_V, lane)
        from_line = _get(x, KEEP_LINE, lane) * i_g - g_line * v_s
        from_i = branches.from_i * i
        v_at_rest = drive_v * (from_i + branches.from_v_c * v_c - branches.r_c * from_line)
        i_at_rest, drive_i = branches.g_c * (from_i - v_at_rest), branches.g_c * (1.0 - drive_v)
        u = (_get(x, XI_D, lane) + k.real * i_ref) * unit
        wanted = u - k * i_at_rest - (k * drive_i) * u
        share = _limited(wanted, v_dc)
        lost = (share - 1.0) * wanted
        u += _get(x, LIMIT, lane) * lost
        v1, i_mid = v_at_rest + drive_v * u, i_at_rest + drive_i * u
        i_g_mid = from_line + g_line * v1
        v_c_mid = v1 - p.r_f_ohm * (i_mid - i_g_mid)
        _put(x, I_L_RE, lane, 2.0 * i_mid - i)
        _put(x, V_C_RE, lane, 2.0 * v_c_mid - v_c)
        _put(x, I_G_RE, lane, 2.0 * i_g_mid - i_g)
        x[V_DC * LANES + lane] += per_w * (power_in - share * _dot(wanted, i_mid))
        _control_to_end(reactive, x, lane, i_ref, i_mid, unit, lost, p, h)
        _pll_to_end(x, lane, v1, unit, angle, p, h)


@njit(fastmath=_FAST, error_model="numpy")
def _decay(z):
    """exp(-z)."""
    return math.exp(-z.real) * complex(math.cos(z.imag), -math.sin(z.imag))


@njit(fastmath=_FAST, error_model="numpy")
def _current(p, h):
    """Weights of the current's step; see `_Current`. Integrals of exp(-z (1 - s)) s^m, s from 0 to 1, are sums."""
    k = _current_gain(p, h)
    late = h / 6.0 * k.real / p.l_c_h
    ramp = 0.5 * h * p.k_i * late
    z_0 = k + 1j * p.w1_rad_s * p.l_c_h
    per_v = h / (p.l_c_h - p.k_i * h * h / 12.0)
    z = per_v * (z_0 + ramp)
    m_0, m_1, m_2 = 0j, 0j, 0j
    term = 1.0 + 0j
    for j in range(30):  # (-z)^j m! / (j + m + 1)!
        term = term * (1.0 / (j + 1.0))
        m_0 += term
        m_1 += term * (1.0 / (j + 2.0))
        m_2 += term * (2.0 / ((j + 2.0) * (j + 3.0)))
        term = -z * term
    drive = per_v * m_0
    mean = _inverse(z_0)
    change = mean * (1.0 / per_v)
    mean_drive = mean - change * drive
    limit = _inverse(1.0 - k * mean_drive)
    return _Current(
        1.0 - z * m_0,
        drive,
        drive * limit,
        per_v * (m_0 - 3.0 * m_1 + 2.0 * m_2),
        per_v * (4.0 * m_1 - 4.0 * m_2),
        per_v * (2.0 * m_2 - m_1),
        mean,
        change,
        mean_drive * limit,
        ramp,
        late,
    )


@njit(fastmath=_FAST, error_model="numpy")
def _inverse(z):
    return z.conjugate() * (1.0 / _dot(z, z))


@njit(fastmath=_FAST, error_model="numpy")
def _branches(p, h):
    """The trapezoidal rule on Lc with the controller's gain, and on the shunt; see `_Branches`."""
    turn = 0.5j * h * p.w1_rad_s
    per_v = 0.5 * h / p.l_c_h
    keep = _inverse(1.0 + turn)
    r_c = (1.0 + turn + per_v * _current_gain(p, h)) * (1.0 / per_v)
    z_f = p.r_f_ohm + 0.5 * h / p.c_f_f * keep
    return _Branches(_inverse(r_c), r_c, z_f, 1.0 / per_v, r_c * keep * _inverse(z_f))


@njit(fastmath=_FAST, error_model="numpy")
def _companion(x, p, h, branches):
    """The trapezoidal rule on the lanes' lines, and the node that joins the branches, into the source's slots.

    In the middle of a step i_g = KEEP_LINE i_g' + G_LINE (v - v_g), ' at the start. DRIVE_V is what a
    volt of u adds to v; LIMIT is what a volt lost to the limit adds to u, the gain k seeing less current.
    """
    turn = 0.5j * h * p.w1_rad_s
    for lane in range(LANES):
        per_v = 0.5 * h * x[GRID_1_L * LANES + lane]
        keep = _inverse(1.0 + turn + per_v * x[GRID_R * LANES + lane])
        through = branches.z_f * branches.g_c
        drive_v = through * _inverse(1.0 + through + branches.z_f * per_v * keep)
        _put(x, G_LINE, lane, per_v * keep)
        _put(x, KEEP_LINE, lane, keep)
        _put(x, DRIVE_V, lane, drive_v)
        _put(x, LIMIT, lane, _inverse(1.0 - _current_gain(p, h) * branches.g_c * (1.0 - drive_v)))


@njit
def _place_unit(x):
    """The PLL's phasor from its angle; the steps turn both."""
    for lane in range(LANES):
        angle = x[DELTA * LANES + lane]
        _put(x, UNIT, lane, complex(math.cos(angle), math.sin(angle)))


@njit
def _keep(x, slot, kept, block):
    for quantity in range(kept.shape[1]):
        for lane in range(LANES):
            kept[block, quantity, lane] = x[(slot + quantity) * LANES + lane]


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_ideal(reactive, x, n_tones, p, h, block_steps, slot, kept):
    """Advance all lanes by blocks, with the source at the PCC itself; see `turbine.advance_ideal`."""
    # What is left, after a step, of a free voltage of the shunt.
    decay = _decay(h * complex(1.0 / (p.r_f_ohm * p.c_f_f), p.w1_rad_s))
    weights = _current(p, h)
    _clear(x, V_START, 10)
    _place_unit(x)
    if n_tones > 0:
        _fetch_tone(x, 0)
    for block in range(kept.shape[0]):
        _clear(x, SUM_V, 8)
        for _ in range(block_steps):
            _step_ideal(reactive, x, n_tones, p, h, decay, weights)
        _keep(x, slot, kept, block)
    if n_tones > 0:
        _return_tone(x, 0)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_thevenin(reactive, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_ideal` with the lanes' Thevenin impedances before the PCC."""
    branches = _branches(p, h)
    _clear(x, V_MEAN, 2)
    _companion(x, p, h, branches)
    _place_unit(x)
    if n_tones > 0:
        _fetch_tone(x, 0)
    for block in range(kept.shape[0]):
        _clear(x, SUM_V, 8)
        for _ in range(block_steps):
            _step_thevenin(reactive, x, n_tones, p, h, branches)
        _keep(x, slot, kept, block)
    if n_tones > 0:
        _return_tone(x, 0)
