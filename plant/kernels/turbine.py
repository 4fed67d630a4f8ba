"""The reference turbine, stepped in lanes: independent experiments in lock step.

Everything of a batch lives in ONE flat array, ``x[slot * LANES + lane]``: LLVM gives up on vector
code when a loop writes through several base pointers. The grid side is written in the dq frame that
rotates at w1 (suffixes re, im), where an operating point is a fixed point; quantities are
power-invariant. Controllers work in the PLL frame (suffixes d, q).

Integrator: classical Runge-Kutta of order four. With an ideal source the shunt Rf-Cf (10 us) is
driven by the source alone and drives nothing: it is solved exactly, because RK4 at that time
constant would cost percents (see docs/turbine.md).

Each source comes plain and *compensated*. A compensated lane has a block between measurement and
controller that tells the controller another voltage than the PCC's (docs/damping.md); the circuit
goes on with the PCC's. The block knows v, i and its own four states, nothing of the controller.

This file stays whole: a cached kernel must call nothing outside its own file, because numba does not notice an edit
elsewhere and would go on with the old machine code. The four steps at its end write their Runge-Kutta stages
out one by one: their states are tuples of different lengths, which numba types apart, and what a stage does
between two evaluations (turning the PLL's phasor, the shunt, the block) differs in each.
"""

from __future__ import annotations

import math

from .compiled import njit

LANES = 8
"""Lanes of one flat array: one 512-bit or two 256-bit vectors of doubles."""

# States. The first thirteen are the device's own, the rest belong to the network at the PCC.
I_L_RE, I_L_IM, DELTA, X_PLL, XI_DC, XI_D, XI_Q, V_DC = range(8)
I_SD, I_SQ, XI_SD, XI_SQ, W_M = range(8, 13)
V_C_RE, V_C_IM, I_G_RE, I_G_IM = range(13, 17)
# The notch at the measurement port: what it holds back (in the order of a tuple of its own), and 90 degrees behind it.
B_RE, B_IM, Q_RE, Q_IM = range(4)
NOTCH = 17
N_STATES = 21

# Constants of a lane: wind speed, source voltage and Thevenin impedance; reactive current asked for, and what the limit
# of the current leaves to i_d.
WIND, V_S_RE, V_S_IM, GRID_R, GRID_1_L, V_CS_RE, V_CS_IM, I_Q_REF, I_D_LIMIT = range(21, 30)
# The sample at the start of the last step (voltage at the PCC, current out of the turbine).
V_RE, V_IM, I_RE, I_IM = range(30, 34)
# Demodulation: phasor exp(j (2 pi f - w1) t), the taper's phasor, their rotations per step, its gain.
LINE_RE, LINE_IM, LINE_ROT_RE, LINE_ROT_IM = range(34, 38)
TAPER_RE, TAPER_IM, TAPER_ROT_RE, TAPER_ROT_IM, TAPER_GAIN = range(38, 43)
# Sums of w re(x) re(line), w im(x) im(line), w im(x) re(line), w re(x) im(line), for v and for i.
SUM_V, SUM_I = 43, 47
# Compensation: impedance Rv + j w_r Lv (ohm), centre w0 and width 2 xi w0 of the notch (rad/s).
COMP_R, COMP_X, NOTCH_W0, NOTCH_WIDTH = range(51, 55)
# Fault at the PCC: v_pcc = share w + skew exp(-2j w1 t) conj(w) of the voltage w without it; the skew is kept turned.
FAULT_SHARE, FAULT_SKEW_RE, FAULT_SKEW_IM = range(55, 58)
# The source of the step at hand, but for the first tone: voltage at its start, middle and end; the shunt
# voltage that it forces there.
SOURCE = 58
N_SOURCE_SLOTS = 12
# Tones: phasor in the dq frame, rotation per half step, response of the ideal source's shunt. The first
# one has a place of its own before the list.
TONE = SOURCE + N_SOURCE_SLOTS
N_TONE_SLOTS = 6
# Behind a network: v and i out of the turbine that it shows at start, middle and end of the step if nothing is fed in;
# what is fed in at start, middle and end; the phasor of its frame.
FREE = TONE + N_TONE_SLOTS
FED = FREE + 12
FRAME = FED + 6
# How far beyond a limit a calm lane came, positive where it met one; see `_asked`.
BEYOND = FRAME + 2
TONES = BEYOND + 1

# Blackman's taper, 0.42 - 0.5 cos + 0.08 cos(2 .) in powers of the cosine.
TAPER_0, TAPER_1, TAPER_2 = 0.34, -0.5, 0.16

# No "nnan" and no "ninf": a diverged lane must be seen.
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


def array_slots(n_tones):
    """Slots of a flat array with room for ``n_tones`` tones."""
    return TONES + N_TONE_SLOTS * n_tones


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _cos_sin(angle):
    """Cosine and sine without a branch or a call, to about 1e-16 (polynomials after reduction)."""
    quadrant = math.floor(angle * 0.6366197723675814 + 0.5)
    r = angle - quadrant * 1.5707963267948966
    r = r - quadrant * 6.123233995736766e-17
    z = r * r
    sin_r = r + r * z * (
        -1.66666666666666324348e-01
        + z
        * (
            8.33333333332248946124e-03
            + z
            * (
                -1.98412698298579493134e-04
                + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
            )
        )
    )
    cos_r = (
        1.0
        - 0.5 * z
        + z
        * z
        * (
            4.16666666666666019037e-02
            + z
            * (
                -1.38888888888741095749e-03
                + z
                * (
                    2.48015872894767294178e-05
                    + z
                    * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
                )
            )
        )
    )
    quarter = quadrant - 4.0 * math.floor(quadrant * 0.25)
    odd = quarter - 2.0 * math.floor(quarter * 0.5)
    sign = 1.0 - 2.0 * math.floor(quarter * 0.5)
    return sign * (cos_r - odd * (sin_r + cos_r)), sign * (sin_r + odd * (cos_r - sin_r))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _turned(c, s, angle):
    """Cosine and sine after a small further ``angle`` (|angle| << 1, error angle^5 / 120)."""
    z = angle * angle
    sin_a = angle * (1.0 - z * (1.0 / 6.0) * (1.0 - z * 0.05))
    cos_a = 1.0 - 0.5 * z * (1.0 - z * (1.0 / 12.0) * (1.0 - z * (1.0 / 30.0)))
    return c * cos_a - s * sin_a, s * cos_a + c * sin_a


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _machine(x, wind, p):
    """Derivatives of machine, its current control and the rotor; power into the DC link (W).

    No wind (None) is that of a calm lane, whose machine stands still: nothing but the wind reaches it.
    """
    i_d, i_q, xi_d, xi_q, w_m = x[I_SD], x[I_SQ], x[XI_SD], x[XI_SQ], x[W_M]
    w_e = p.pole_pairs * w_m
    torque_ref = p.k_opt * w_m * w_m
    error_d = i_d
    error_q = i_q - torque_ref / (p.pole_pairs * p.flux_wb)
    v_d = p.k_mp * error_d + xi_d + p.k_mrd_ohm * i_q
    v_q = p.k_mp * error_q + xi_q - p.k_mrd_ohm * i_d
    if wind is None:
        return (None, None, None, None, None), v_d * i_d + v_q * i_q
    slip = p.radius_m * w_m
    torque_aero = 0.5 * p.rho_kgm3 * math.pi * p.radius_m**3 * slip * (p.c_q1 * wind - p.c_q2 * slip)
    return (
        (-v_d - p.r_s_ohm * i_d + w_e * p.l_s_h * i_q) / p.l_s_h,
        (-v_q - p.r_s_ohm * i_q - w_e * p.l_s_h * i_d + w_e * p.flux_wb) / p.l_s_h,
        p.k_mi * error_d,
        p.k_mi * error_q,
        (torque_aero - p.pole_pairs * p.flux_wb * i_q) / p.inertia_kgm2,
    ), v_d * i_d + v_q * i_q


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _missing(i_q, i_q_ref):
    """Error of the reactive current; see `_asked` for a set-point of None."""
    if i_q_ref is None:
        return -i_q
    return i_q_ref - i_q


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _limited(i_d_wanted, i_d_limit, p):
    """The reference of i_d within its limit; see `_asked` for a limit of None."""
    if i_d_limit is None:
        return min(max(i_d_wanted, -p.i_limit_a), p.i_limit_a)
    return min(max(i_d_wanted, -i_d_limit), i_d_limit)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _reference(i_d_wanted, wind, i_d_limit, p):
    """The reference of i_d, and how far (A) what is wanted lies beyond its limit: a calm lane does not look."""
    if wind is None:
        limit = p.i_limit_a if i_d_limit is None else i_d_limit
        return i_d_wanted, abs(i_d_wanted) - limit
    return _limited(i_d_wanted, i_d_limit, p), 0.0


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _converter(v_d_wanted, v_q_wanted, v_dc, wind):
    """The converter's voltage, v_dc / sqrt(2) at most, and how far (V^2) what is wanted lies beyond that.

    Between the two stand the factors of 1 / v_dc: one division serves the limit and the DC link.
    """
    wanted_squared = v_d_wanted * v_d_wanted + v_q_wanted * v_q_wanted
    if wind is None:
        return v_d_wanted, v_q_wanted, 1.0 / v_dc, 1.0, 2.0 * wanted_squared - v_dc * abs(v_dc)
    inverse = 1.0 / (v_dc * wanted_squared)
    share = min(1.0, v_dc * math.sqrt(0.5 * v_dc * inverse))
    return share * v_d_wanted, share * v_q_wanted, inverse, wanted_squared, 0.0


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _device(x, v_re, v_im, u_re, u_im, c, s, asked, p):
    """Derivatives of the device's thirteen states at PCC voltage ``v`` and PLL angle (c, s), and `BEYOND`.

    ``u`` is the voltage that the controller is told; without compensation it is ``v``. ``asked`` is (wind, reactive
    current, limit of |i_d|); see `_asked`.
    """
    wind, i_q_ref, i_d_limit = asked
    i_re, i_im, v_dc = x[I_L_RE], x[I_L_IM], x[V_DC]
    i_d, i_q = c * i_re + s * i_im, c * i_im - s * i_re
    v_q = c * u_im - s * u_re
    # DC voltage control; its integrator is held back while the current reference is limited.
    error_dc = v_dc - p.v_dc_ref_v
    i_d_wanted = p.k_dcp * error_dc + x[XI_DC]
    i_d_ref, beyond_current = _reference(i_d_wanted, wind, i_d_limit, p)
    # Current control; the converter gives v_dc / sqrt(2) at most, line-to-line RMS.
    error_d, error_q = i_d_ref - i_d, _missing(i_q, i_q_ref)
    v_d_wanted = p.k_p * error_d + x[XI_D] - p.k_rd_ohm * i_q
    v_q_wanted = p.k_p * error_q + x[XI_Q] + p.k_rd_ohm * i_d
    v_conv_d, v_conv_q, inverse, factor, beyond_voltage = _converter(v_d_wanted, v_q_wanted, v_dc, wind)
    v_conv_re, v_conv_im = c * v_conv_d - s * v_conv_q, s * v_conv_d + c * v_conv_q
    machine, power_in = _machine(x, wind, p)
    power_out = v_conv_re * i_re + v_conv_im * i_im
    return (
        (v_conv_re - v_re) / p.l_c_h + p.w1_rad_s * i_im,
        (v_conv_im - v_im) / p.l_c_h - p.w1_rad_s * i_re,
        p.k_pp * v_q + x[X_PLL],
        p.k_pi * v_q,
        p.k_dci * error_dc + p.k_dci / p.k_dcp * (i_d_ref - i_d_wanted),
        p.k_i * error_d + p.k_i / p.k_p * (v_conv_d - v_d_wanted),
        p.k_i * error_q + p.k_i / p.k_p * (v_conv_q - v_q_wanted),
        (power_in - power_out) * inverse * factor / p.c_dc_f,
    ) + machine, max(beyond_current, beyond_voltage)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _behind_grid(x, v_re, v_im, c, s, asked, r_grid, inverse_l_grid, p):
    """Derivatives of all states with the device behind a Thevenin source ``v``, and `BEYOND`."""
    i_f_re, i_f_im = x[I_L_RE] - x[I_G_RE], x[I_L_IM] - x[I_G_IM]
    v_pcc_re, v_pcc_im = x[V_C_RE] + p.r_f_ohm * i_f_re, x[V_C_IM] + p.r_f_ohm * i_f_im
    device, beyond = _device(x, v_pcc_re, v_pcc_im, v_pcc_re, v_pcc_im, c, s, asked, p)
    return device + (
        i_f_re / p.c_f_f + p.w1_rad_s * x[V_C_IM],
        i_f_im / p.c_f_f - p.w1_rad_s * x[V_C_RE],
        (v_pcc_re - v_re - r_grid * x[I_G_RE]) * inverse_l_grid + p.w1_rad_s * x[I_G_IM],
        (v_pcc_im - v_im - r_grid * x[I_G_IM]) * inverse_l_grid - p.w1_rad_s * x[I_G_RE],
    ), beyond


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _told(v_re, v_im, i_re, i_im, n, block):
    """Voltage that the controller is told: v - (Rv + j w_r Lv) H_NF i, with i out of the turbine.

    ``block`` is (Rv, w_r Lv, w0, width). The impedance is a constant: it may stand before or behind the
    notch, and behind it switching does not excite the notch.
    """
    through_re, through_im = i_re - n[B_RE], i_im - n[B_IM]
    return (
        v_re - block[0] * through_re + block[1] * through_im,
        v_im - block[0] * through_im - block[1] * through_re,
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _notch(n, i_re, i_im, block, w1):
    """Derivatives of the notch's states, alpha and beta seen from the frame at w1.

    H_NF i = i - b with b = width s / (s^2 + width s + w0^2) i:  b' = width (i - b) - w0 q, q' = w0 b.
    """
    w0, width = block[2], block[3]
    return (
        width * (i_re - n[B_RE]) - w0 * n[Q_RE] + w1 * n[B_IM],
        width * (i_im - n[B_IM]) - w0 * n[Q_IM] - w1 * n[B_RE],
        w0 * n[B_RE] + w1 * n[Q_IM],
        w0 * n[B_IM] - w1 * n[Q_RE],
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _ideal_compensated(x, n, v_re, v_im, v_c_re, v_c_im, c, s, asked, block, p):
    """Derivatives of device and notch at PCC voltage ``v``, shunt voltage ``v_c``, and `BEYOND`."""
    i_re, i_im = x[I_L_RE] - (v_re - v_c_re) / p.r_f_ohm, x[I_L_IM] - (v_im - v_c_im) / p.r_f_ohm
    u_re, u_im = _told(v_re, v_im, i_re, i_im, n, block)
    device, beyond = _device(x, v_re, v_im, u_re, u_im, c, s, asked, p)
    return device, _notch(n, i_re, i_im, block, p.w1_rad_s), beyond


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _at_pcc(x, fault, p):
    """PCC voltage, and the current into the shunt, with a fault (share, skew) at the PCC.

    v_pcc = (1 + Rf G)^-1 w with w = v_C + Rf (i_L - i_line) and the fault's conductance G.
    """
    w_re, w_im = x[V_C_RE] + p.r_f_ohm * (x[I_L_RE] - x[I_G_RE]), x[V_C_IM] + p.r_f_ohm * (x[I_L_IM] - x[I_G_IM])
    v_re = fault[0] * w_re + fault[1] * w_re + fault[2] * w_im
    v_im = fault[0] * w_im + fault[2] * w_re - fault[1] * w_im
    return v_re, v_im, (v_re - x[V_C_RE]) / p.r_f_ohm, (v_im - x[V_C_IM]) / p.r_f_ohm


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _grid_compensated(x, n, v_re, v_im, fault, c, s, lane, block, p):
    """Derivatives of all states and of the notch behind a Thevenin source ``v``; ``lane`` is (asked, R, 1/L).

    The line carries i_g less the fault's current.
    """
    asked, r_grid, inverse_l_grid = lane
    v_pcc_re, v_pcc_im, i_f_re, i_f_im = _at_pcc(x, fault, p)
    i_re, i_im = x[I_L_RE] - i_f_re, x[I_L_IM] - i_f_im
    u_re, u_im = _told(v_pcc_re, v_pcc_im, i_re, i_im, n, block)
    device, beyond = _device(x, v_pcc_re, v_pcc_im, u_re, u_im, c, s, asked, p)
    return (
        device
        + (
            i_f_re / p.c_f_f + p.w1_rad_s * x[V_C_IM],
            i_f_im / p.c_f_f - p.w1_rad_s * x[V_C_RE],
            (v_pcc_re - v_re - r_grid * x[I_G_RE]) * inverse_l_grid + p.w1_rad_s * x[I_G_IM],
            (v_pcc_im - v_im - r_grid * x[I_G_IM]) * inverse_l_grid - p.w1_rad_s * x[I_G_RE],
        ),
        _notch(n, i_re, i_im, block, p.w1_rad_s),
        beyond,
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_4(x, h, k):
    """``x + h k`` for the notch's states."""
    return x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved(x, h, k):
    """``x + h k``; ``x`` where there is no derivative."""
    if k is None:
        return x
    return x + h * k


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_13(x, h, k):
    """``x + h k`` for the device's states."""
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
        x[5] + h * k[5],
        x[6] + h * k[6],
        x[7] + h * k[7],
        _moved(x[8], h, k[8]),
        _moved(x[9], h, k[9]),
        _moved(x[10], h, k[10]),
        _moved(x[11], h, k[11]),
        _moved(x[12], h, k[12]),
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _moved_17(x, h, k):
    """``x + h k`` for all states."""
    return _moved_13(x, h, k) + (
        x[13] + h * k[13],
        x[14] + h * k[14],
        x[15] + h * k[15],
        x[16] + h * k[16],
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _load_13(x, lane):
    return (
        x[0 * LANES + lane],
        x[1 * LANES + lane],
        x[2 * LANES + lane],
        x[3 * LANES + lane],
        x[4 * LANES + lane],
        x[5 * LANES + lane],
        x[6 * LANES + lane],
        x[7 * LANES + lane],
        x[8 * LANES + lane],
        x[9 * LANES + lane],
        x[10 * LANES + lane],
        x[11 * LANES + lane],
        x[12 * LANES + lane],
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _asked(x, lane, reactive, calm):
    """What the lane's device is asked for: wind speed, reactive current, and the limit of |i_d|.

    ``reactive`` is None where no lane of a batch is asked for reactive power: numba then compiles the kernel without
    it, to the last bit the one that knows no reactive power (a sum with a zero would be rounded in another order).

    ``calm`` is None or True. The machine of a calm lane stands still, and no limit is met: the kernel is compiled
    without the machine and without the limits, whose square root and division are what each stage of a step waits for
    longest. `BEYOND` says of each lane whether that was right: where it is positive the lane is to go the way again.
    """
    wind = _wind(x, lane, calm)
    if reactive is None:
        return wind, None, None
    return wind, x[I_Q_REF * LANES + lane], x[I_D_LIMIT * LANES + lane]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _wind(x, lane, calm):
    """Wind speed (m/s); none where it reaches nothing."""
    if calm is None:
        return x[WIND * LANES + lane]
    return None


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _remember(x, lane, calm, beyond):
    """How far beyond a limit a calm lane came in the four stages of a step."""
    if calm is not None:
        far = max(max(beyond[0], beyond[1]), max(beyond[2], beyond[3]))
        x[BEYOND * LANES + lane] = max(far, x[BEYOND * LANES + lane])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _store_13(x, lane, y):
    x[0 * LANES + lane] = y[0]
    x[1 * LANES + lane] = y[1]
    x[2 * LANES + lane] = y[2]
    x[3 * LANES + lane] = y[3]
    x[4 * LANES + lane] = y[4]
    x[5 * LANES + lane] = y[5]
    x[6 * LANES + lane] = y[6]
    x[7 * LANES + lane] = y[7]
    x[8 * LANES + lane] = y[8]
    x[9 * LANES + lane] = y[9]
    x[10 * LANES + lane] = y[10]
    x[11 * LANES + lane] = y[11]
    x[12 * LANES + lane] = y[12]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _load_4(x, first, lane):
    return (
        x[(first + 0) * LANES + lane],
        x[(first + 1) * LANES + lane],
        x[(first + 2) * LANES + lane],
        x[(first + 3) * LANES + lane],
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _store_4(x, first, lane, y):
    x[(first + 0) * LANES + lane] = y[0]
    x[(first + 1) * LANES + lane] = y[1]
    x[(first + 2) * LANES + lane] = y[2]
    x[(first + 3) * LANES + lane] = y[3]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _listen(x, lane, v_re, v_im, i_re, i_im):
    """Keep the sample and add it, tapered and demodulated, to the sums of its line."""
    x[V_RE * LANES + lane], x[V_IM * LANES + lane] = v_re, v_im
    x[I_RE * LANES + lane], x[I_IM * LANES + lane] = i_re, i_im
    c, s = x[TAPER_RE * LANES + lane], x[TAPER_IM * LANES + lane]
    weight = x[TAPER_GAIN * LANES + lane] * (TAPER_0 + c * (TAPER_1 + c * TAPER_2))
    rot_c, rot_s = x[TAPER_ROT_RE * LANES + lane], x[TAPER_ROT_IM * LANES + lane]
    x[TAPER_RE * LANES + lane], x[TAPER_IM * LANES + lane] = c * rot_c - s * rot_s, s * rot_c + c * rot_s
    line_re, line_im = x[LINE_RE * LANES + lane], x[LINE_IM * LANES + lane]
    w_re, w_im = weight * line_re, weight * line_im
    x[(SUM_V + 0) * LANES + lane] += v_re * w_re
    x[(SUM_V + 1) * LANES + lane] += v_im * w_im
    x[(SUM_V + 2) * LANES + lane] += v_im * w_re
    x[(SUM_V + 3) * LANES + lane] += v_re * w_im
    x[(SUM_I + 0) * LANES + lane] += i_re * w_re
    x[(SUM_I + 1) * LANES + lane] += i_im * w_im
    x[(SUM_I + 2) * LANES + lane] += i_im * w_re
    x[(SUM_I + 3) * LANES + lane] += i_re * w_im
    rot_re, rot_im = x[LINE_ROT_RE * LANES + lane], x[LINE_ROT_IM * LANES + lane]
    x[LINE_RE * LANES + lane] = line_re * rot_re - line_im * rot_im
    x[LINE_IM * LANES + lane] = line_im * rot_re + line_re * rot_im


@njit(forceinline=True)
def _prepare_source(x, n_tones):
    """Source without tones into its place, and the first tone into its own, before the first step.

    The lone tone of a sweep stays there: a moving offset inside the step would hide from the compiler
    that the lanes do not overlap.
    """
    _still_source(x)
    if n_tones > 0:
        for i in range(N_TONE_SLOTS * LANES):
            x[TONE * LANES + i] = x[TONES * LANES + i]


@njit(forceinline=True)
def _still_source(x):
    """The source voltage without any tone, at start, middle and end; so the shunt voltage it forces."""
    for lane in range(LANES):
        for place in range(3):
            x[(SOURCE + 2 * place) * LANES + lane] = x[V_S_RE * LANES + lane]
            x[(SOURCE + 2 * place + 1) * LANES + lane] = x[V_S_IM * LANES + lane]
            x[(SOURCE + 6 + 2 * place) * LANES + lane] = x[V_CS_RE * LANES + lane]
            x[(SOURCE + 7 + 2 * place) * LANES + lane] = x[V_CS_IM * LANES + lane]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _further_tones(x, n_tones):
    """The source of this step with all tones but the first, and those tones one step on."""
    _still_source(x)
    for tone in range(1, n_tones):
        first = (TONES + N_TONE_SLOTS * tone) * LANES
        for lane in range(LANES):
            re, im = x[first + lane], x[first + LANES + lane]
            rot_re, rot_im = x[first + 2 * LANES + lane], x[first + 3 * LANES + lane]
            h_re, h_im = x[first + 4 * LANES + lane], x[first + 5 * LANES + lane]
            for place in range(3):
                if place > 0:
                    re, im = re * rot_re - im * rot_im, im * rot_re + re * rot_im
                x[(SOURCE + 2 * place) * LANES + lane] += re
                x[(SOURCE + 2 * place + 1) * LANES + lane] += im
                x[(SOURCE + 6 + 2 * place) * LANES + lane] += h_re * re - h_im * im
                x[(SOURCE + 7 + 2 * place) * LANES + lane] += h_re * im + h_im * re
            x[first + lane], x[first + LANES + lane] = re, im


@njit(forceinline=True)
def _tabled_source(x, table, row):
    """The source of this step from its ``table``, whose rows are half steps of one period."""
    n_rows = table.shape[0]
    for place in range(3):
        at = (row + place) % n_rows
        for quantity in range(2):
            for lane in range(LANES):
                x[(SOURCE + 2 * place + quantity) * LANES + lane] = table[at, quantity, lane]
                x[(SOURCE + 6 + 2 * place + quantity) * LANES + lane] = table[at, 2 + quantity, lane]


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
    """Source voltage at start, middle and end of the step, and the shunt voltage it forces; the first tone moves on."""
    re, im = x[(TONE + 0) * LANES + lane], x[(TONE + 1) * LANES + lane]
    rot_re, rot_im = x[(TONE + 2) * LANES + lane], x[(TONE + 3) * LANES + lane]
    h_re, h_im = x[(TONE + 4) * LANES + lane], x[(TONE + 5) * LANES + lane]
    re_1, im_1 = re * rot_re - im * rot_im, im * rot_re + re * rot_im
    re_2, im_2 = re_1 * rot_re - im_1 * rot_im, im_1 * rot_re + re_1 * rot_im
    x[(TONE + 0) * LANES + lane], x[(TONE + 1) * LANES + lane] = re_2, im_2
    voltage = (
        x[(SOURCE + 0) * LANES + lane] + re,
        x[(SOURCE + 1) * LANES + lane] + im,
        x[(SOURCE + 2) * LANES + lane] + re_1,
        x[(SOURCE + 3) * LANES + lane] + im_1,
        x[(SOURCE + 4) * LANES + lane] + re_2,
        x[(SOURCE + 5) * LANES + lane] + im_2,
    )
    forced = (
        x[(SOURCE + 6) * LANES + lane] + h_re * re - h_im * im,
        x[(SOURCE + 7) * LANES + lane] + h_re * im + h_im * re,
        x[(SOURCE + 8) * LANES + lane] + h_re * re_1 - h_im * im_1,
        x[(SOURCE + 9) * LANES + lane] + h_re * im_1 + h_im * re_1,
        x[(SOURCE + 10) * LANES + lane] + h_re * re_2 - h_im * im_2,
        x[(SOURCE + 11) * LANES + lane] + h_re * im_2 + h_im * re_2,
    )
    return voltage, forced


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_ideal(reactive, calm, x, p, h, decay):
    """One step with the source at the PCC itself; ``decay`` is the shunt's over a step."""
    decay_re, decay_im = decay
    for lane in range(LANES):
        asked = _asked(x, lane, reactive, calm)
        (v0_re, v0_im, v1_re, v1_im, v2_re, v2_im), forced = _source(x, lane)
        y = _load_13(x, lane)
        v_c_re, v_c_im = x[V_C_RE * LANES + lane], x[V_C_IM * LANES + lane]
        _listen(
            x,
            lane,
            v0_re,
            v0_im,
            y[I_L_RE] - (v0_re - v_c_re) / p.r_f_ohm,
            y[I_L_IM] - (v0_im - v_c_im) / p.r_f_ohm,
        )
        # Shunt: exact forced response plus the decaying rest of what went before.
        rest_re, rest_im = v_c_re - forced[0], v_c_im - forced[1]
        x[V_C_RE * LANES + lane] = forced[4] + rest_re * decay_re - rest_im * decay_im
        x[V_C_IM * LANES + lane] = forced[5] + rest_im * decay_re + rest_re * decay_im
        c, s = _cos_sin(y[DELTA])
        k1, b1 = _device(y, v0_re, v0_im, v0_re, v0_im, c, s, asked, p)
        z = _moved_13(y, 0.5 * h, k1)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k2, b2 = _device(z, v1_re, v1_im, v1_re, v1_im, cz, sz, asked, p)
        z = _moved_13(y, 0.5 * h, k2)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k3, b3 = _device(z, v1_re, v1_im, v1_re, v1_im, cz, sz, asked, p)
        z = _moved_13(y, h, k3)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k4, b4 = _device(z, v2_re, v2_im, v2_re, v2_im, cz, sz, asked, p)
        y = _moved_13(_moved_13(_moved_13(_moved_13(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        _store_13(x, lane, y)
        _remember(x, lane, calm, (b1, b2, b3, b4))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_thevenin(reactive, calm, x, p, h):
    """One step behind the lane's Thevenin impedance."""
    for lane in range(LANES):
        asked, r, l_1 = _asked(x, lane, reactive, calm), x[GRID_R * LANES + lane], x[GRID_1_L * LANES + lane]
        (v0_re, v0_im, v1_re, v1_im, v2_re, v2_im), _ = _source(x, lane)
        y = _load_13(x, lane) + (
            x[V_C_RE * LANES + lane],
            x[V_C_IM * LANES + lane],
            x[I_G_RE * LANES + lane],
            x[I_G_IM * LANES + lane],
        )
        _listen(
            x,
            lane,
            y[V_C_RE] + p.r_f_ohm * (y[I_L_RE] - y[I_G_RE]),
            y[V_C_IM] + p.r_f_ohm * (y[I_L_IM] - y[I_G_IM]),
            y[I_G_RE],
            y[I_G_IM],
        )
        c, s = _cos_sin(y[DELTA])
        k1, b1 = _behind_grid(y, v0_re, v0_im, c, s, asked, r, l_1, p)
        z = _moved_17(y, 0.5 * h, k1)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k2, b2 = _behind_grid(z, v1_re, v1_im, cz, sz, asked, r, l_1, p)
        z = _moved_17(y, 0.5 * h, k2)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k3, b3 = _behind_grid(z, v1_re, v1_im, cz, sz, asked, r, l_1, p)
        z = _moved_17(y, h, k3)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k4, b4 = _behind_grid(z, v2_re, v2_im, cz, sz, asked, r, l_1, p)
        y = _moved_17(_moved_17(_moved_17(_moved_17(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        _store_13(x, lane, y)
        _remember(x, lane, calm, (b1, b2, b3, b4))
        x[V_C_RE * LANES + lane], x[V_C_IM * LANES + lane] = y[V_C_RE], y[V_C_IM]
        x[I_G_RE * LANES + lane], x[I_G_IM * LANES + lane] = y[I_G_RE], y[I_G_IM]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_ideal_compensated(reactive, calm, x, p, h, decay):
    """`_step_ideal` with the lanes' compensation before the controller; ``decay`` is over half a step."""
    half_re, half_im = decay
    for lane in range(LANES):
        asked, block = _asked(x, lane, reactive, calm), _load_4(x, COMP_R, lane)
        (v0_re, v0_im, v1_re, v1_im, v2_re, v2_im), forced = _source(x, lane)
        y, n = _load_13(x, lane), _load_4(x, NOTCH, lane)
        # Shunt: exact forced response plus the decaying rest of what went before.
        c0_re, c0_im = x[V_C_RE * LANES + lane], x[V_C_IM * LANES + lane]
        rest_re, rest_im = c0_re - forced[0], c0_im - forced[1]
        rest_re, rest_im = rest_re * half_re - rest_im * half_im, rest_im * half_re + rest_re * half_im
        c1_re, c1_im = forced[2] + rest_re, forced[3] + rest_im
        rest_re, rest_im = rest_re * half_re - rest_im * half_im, rest_im * half_re + rest_re * half_im
        c2_re, c2_im = forced[4] + rest_re, forced[5] + rest_im
        x[V_C_RE * LANES + lane], x[V_C_IM * LANES + lane] = c2_re, c2_im
        _listen(
            x,
            lane,
            v0_re,
            v0_im,
            y[I_L_RE] - (v0_re - c0_re) / p.r_f_ohm,
            y[I_L_IM] - (v0_im - c0_im) / p.r_f_ohm,
        )
        c, s = _cos_sin(y[DELTA])
        k1, m1, b1 = _ideal_compensated(y, n, v0_re, v0_im, c0_re, c0_im, c, s, asked, block, p)
        z, o = _moved_13(y, 0.5 * h, k1), _moved_4(n, 0.5 * h, m1)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k2, m2, b2 = _ideal_compensated(z, o, v1_re, v1_im, c1_re, c1_im, cz, sz, asked, block, p)
        z, o = _moved_13(y, 0.5 * h, k2), _moved_4(n, 0.5 * h, m2)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k3, m3, b3 = _ideal_compensated(z, o, v1_re, v1_im, c1_re, c1_im, cz, sz, asked, block, p)
        z, o = _moved_13(y, h, k3), _moved_4(n, h, m3)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k4, m4, b4 = _ideal_compensated(z, o, v2_re, v2_im, c2_re, c2_im, cz, sz, asked, block, p)
        y = _moved_13(_moved_13(_moved_13(_moved_13(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        n = _moved_4(_moved_4(_moved_4(_moved_4(n, h / 6.0, m1), h / 3.0, m2), h / 3.0, m3), h / 6.0, m4)
        _store_13(x, lane, y)
        _remember(x, lane, calm, (b1, b2, b3, b4))
        _store_4(x, NOTCH, lane, n)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _step_thevenin_compensated(reactive, calm, x, p, h, turn):
    """`_step_thevenin` with compensation, and the lanes' fault at the PCC, turned by ``turn`` a half step."""
    turn_re, turn_im = turn
    for lane in range(LANES):
        constants = _asked(x, lane, reactive, calm), x[GRID_R * LANES + lane], x[GRID_1_L * LANES + lane]
        block = _load_4(x, COMP_R, lane)
        (v0_re, v0_im, v1_re, v1_im, v2_re, v2_im), _ = _source(x, lane)
        share, re, im = (
            x[FAULT_SHARE * LANES + lane],
            x[FAULT_SKEW_RE * LANES + lane],
            x[FAULT_SKEW_IM * LANES + lane],
        )
        fault_0 = share, re, im
        re, im = re * turn_re - im * turn_im, im * turn_re + re * turn_im
        fault_1 = share, re, im
        re, im = re * turn_re - im * turn_im, im * turn_re + re * turn_im
        fault_2 = share, re, im
        x[FAULT_SKEW_RE * LANES + lane], x[FAULT_SKEW_IM * LANES + lane] = re, im
        y, n = _load_13(x, lane) + _load_4(x, V_C_RE, lane), _load_4(x, NOTCH, lane)
        v_pcc_re, v_pcc_im, i_f_re, i_f_im = _at_pcc(y, fault_0, p)
        _listen(x, lane, v_pcc_re, v_pcc_im, y[I_L_RE] - i_f_re, y[I_L_IM] - i_f_im)
        c, s = _cos_sin(y[DELTA])
        k1, m1, b1 = _grid_compensated(y, n, v0_re, v0_im, fault_0, c, s, constants, block, p)
        z, o = _moved_17(y, 0.5 * h, k1), _moved_4(n, 0.5 * h, m1)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k2, m2, b2 = _grid_compensated(z, o, v1_re, v1_im, fault_1, cz, sz, constants, block, p)
        z, o = _moved_17(y, 0.5 * h, k2), _moved_4(n, 0.5 * h, m2)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k3, m3, b3 = _grid_compensated(z, o, v1_re, v1_im, fault_1, cz, sz, constants, block, p)
        z, o = _moved_17(y, h, k3), _moved_4(n, h, m3)
        cz, sz = _turned(c, s, z[DELTA] - y[DELTA])
        k4, m4, b4 = _grid_compensated(z, o, v2_re, v2_im, fault_2, cz, sz, constants, block, p)
        y = _moved_17(_moved_17(_moved_17(_moved_17(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        n = _moved_4(_moved_4(_moved_4(_moved_4(n, h / 6.0, m1), h / 3.0, m2), h / 3.0, m3), h / 6.0, m4)
        _store_13(x, lane, y)
        _remember(x, lane, calm, (b1, b2, b3, b4))
        _store_4(x, V_C_RE, lane, y[V_C_RE:])
        _store_4(x, NOTCH, lane, n)


def machine(x, wind, p):
    """`_machine` of plain Python, of arrays of states as well, without the compiler."""
    return getattr(_machine, "py_func", _machine)(x, wind, p)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _shunt_decay(p, duration):
    """What is left, after ``duration``, of a free voltage of the ideal source's shunt: re, im in the dq frame."""
    decay = math.exp(-duration / (p.r_f_ohm * p.c_f_f))
    return decay * math.cos(p.w1_rad_s * duration), -decay * math.sin(p.w1_rad_s * duration)


@njit(forceinline=True)
def _clear_sums(x):
    for i in range(8 * LANES):
        x[SUM_V * LANES + i] = 0.0


@njit(forceinline=True)
def _keep(x, slot, kept, block):
    for quantity in range(kept.shape[1]):
        for lane in range(LANES):
            kept[block, quantity, lane] = x[(slot + quantity) * LANES + lane]


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_ideal(reactive, calm, table, x, n_tones, p, h, block_steps, slot, kept):
    """Advance all lanes by blocks, with the source at the PCC itself.

    Parameters
    ----------
    reactive, calm : True or None
        Whether a lane is asked for reactive power; whether all machines stand still and no limit is met: see `_asked`.
    table : (n, 4, LANES) array
        Source voltage (re, im) and the shunt voltage that it forces, at the half steps of one period from the first
        step on; of no rows where the source is made of tones.
    x : flat array
        Everything of the lanes; see the slots above.
    n_tones : int
        Tones of a lane, beside the table.
    p : TurbineParameters
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
    decay = _shunt_decay(p, h)
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            _step_ideal(reactive, calm, x, p, h, decay)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_thevenin(reactive, calm, table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_ideal` with the lanes' Thevenin impedances before the PCC."""
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            _step_thevenin(reactive, calm, x, p, h)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_ideal_compensated(reactive, calm, table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_ideal` with the source at the PCC and the lanes' compensation before the controller."""
    decay = _shunt_decay(p, 0.5 * h)
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            _step_ideal_compensated(reactive, calm, x, p, h, decay)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_thevenin_compensated(reactive, calm, table, x, n_tones, p, h, block_steps, slot, kept):
    """`advance_ideal` with the lanes' impedances, compensations and faults."""
    turn = math.cos(p.w1_rad_s * h), -math.sin(p.w1_rad_s * h)  # exp(-2j w1 h / 2)
    _prepare_source(x, n_tones)
    row = 0
    for block in range(kept.shape[0]):
        _clear_sums(x)
        for _ in range(block_steps):
            row = _next_source(x, n_tones, table, row)
            _step_thevenin_compensated(reactive, calm, x, p, h, turn)
        _keep(x, slot, kept, block)


@njit(nogil=True, fastmath=_FAST, error_model="numpy", cache=True)
def advance_tracing(reactive, x, p, h, sample_steps, samples):
    """Advance behind the grid, compensated; ``samples[k]`` is the first lane before each ``sample_steps`` steps.

    Columns: v_pcc (re, im), i_g (re, im), v_dc, w_m, delta.
    """
    turn = math.cos(p.w1_rad_s * h), -math.sin(p.w1_rad_s * h)
    _prepare_source(x, 0)
    for k in range(samples.shape[0]):
        samples[k, 4], samples[k, 5], samples[k, 6] = x[V_DC * LANES], x[W_M * LANES], x[DELTA * LANES]
        for step in range(sample_steps):
            _step_thevenin_compensated(reactive, None, x, p, h, turn)
            if step == 0:
                for quantity in range(4):
                    samples[k, quantity] = x[(V_RE + quantity) * LANES]
