"""The reference turbine integrated by a classical Runge-Kutta: records that owe nothing to the plant's kernel.

The equations are those of `oracle.rhs`, written out in scalars and compiled; `test_hear` holds them against it. The PCC
voltage is given (ideal source), in the frame that rotates at f1, so the shunt branch, which is linear and sees nothing
else, is taken in closed form: it is the only stiff part.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from scipy.special import jv

from seqsweep.plant.protocol import Record
from seqsweep.plant.turbine.parameters import TABLE_I

from . import oracle

POWER_W, VOLTAGE_V = 0.65e6, 690.0
STEPS = 4
"""Runge-Kutta steps per sample of 100 us: the current loop (600 us) and 1 kHz are far above them."""


@njit(cache=True)
def derivative(x, v_d, v_q, wind, p, out):
    """`oracle.rhs` in scalars, the shunt branch (2, 3) at rest."""
    delta = x[4]
    c, s = np.cos(delta), np.sin(delta)
    i_d, i_q = c * x[0] + s * x[1], c * x[1] - s * x[0]
    v_pll_q = c * v_q - s * v_d
    error_dc = x[9] - p.v_dc_ref_v
    e_d, e_q = p.k_dcp * error_dc + x[6] - i_d, -i_q
    u_d = p.k_p * e_d + x[7] - p.k_rd_ohm * i_q
    u_q = p.k_p * e_q + x[8] + p.k_rd_ohm * i_d
    c_d, c_q = c * u_d - s * u_q, c * u_q + s * u_d
    out[0] = (c_d - v_d) / p.l_c_h + p.w1_rad_s * x[1]
    out[1] = (c_q - v_q) / p.l_c_h - p.w1_rad_s * x[0]
    out[2] = out[3] = 0.0
    out[4] = p.k_pp * v_pll_q + x[5]
    out[5] = p.k_pi * v_pll_q
    out[6] = p.k_dci * error_dc
    out[7] = p.k_i * e_d
    out[8] = p.k_i * e_q
    w_m = x[14]
    w_e = p.pole_pairs * w_m
    i_ref_q = p.k_opt * w_m * w_m / (p.pole_pairs * p.flux_wb)
    m_d, m_q = x[10], x[11] - i_ref_q
    u_md = p.k_mp * m_d + x[12] + p.k_mrd_ohm * x[11]
    u_mq = p.k_mp * m_q + x[13] - p.k_mrd_ohm * x[10]
    out[9] = (u_md * x[10] + u_mq * x[11] - (c_d * x[0] + c_q * x[1])) / (p.c_dc_f * x[9])
    out[10] = (-u_md - p.r_s_ohm * x[10]) / p.l_s_h + w_e * x[11]
    out[11] = (w_e * p.flux_wb - u_mq - p.r_s_ohm * x[11]) / p.l_s_h - w_e * x[10]
    out[12] = p.k_mi * m_d
    out[13] = p.k_mi * m_q
    ratio = w_m * p.radius_m / wind
    torque = 0.5 * p.rho_kgm3 * np.pi * p.radius_m**3 * wind**2 * (p.c_q1 * ratio - p.c_q2 * ratio**2)
    out[14] = (torque - p.pole_pairs * p.flux_wb * x[11]) / p.inertia_kgm2


@njit(cache=True)
def _sum_of(t, steady, f_hz, a):
    """A steady value and lines (Hz) in the rotating frame."""
    total = steady
    for k in range(len(f_hz)):
        total += a[k] * np.exp(2j * np.pi * f_hz[k] * t)
    return total


@njit(cache=True)
def integrate(x, wind, p, v0, f_hz, a, t0, dt, steps, n):
    """Voltage and current (n,) in the rotating frame, power invariant, from state ``x`` on; ``x`` goes on."""
    shunt0 = v0 * 1j * p.w1_rad_s * p.c_f_f / (1.0 + 1j * p.w1_rad_s * p.c_f_f * p.r_f_ohm)
    s = 1j * (2.0 * np.pi * f_hz + p.w1_rad_s)
    shunt = a * s * p.c_f_f / (1.0 + s * p.c_f_f * p.r_f_ohm)
    v, i = np.empty(n, dtype=np.complex128), np.empty(n, dtype=np.complex128)
    k1, k2, k3, k4 = np.empty(15), np.empty(15), np.empty(15), np.empty(15)
    h = dt / steps
    for sample in range(n):
        now = _sum_of(t0 + sample * dt, v0, f_hz, a)
        v[sample] = now
        i[sample] = _sum_of(t0 + sample * dt, shunt0, f_hz, shunt) - complex(x[0], x[1])
        for step in range(steps):
            t = t0 + sample * dt + step * h
            mid = _sum_of(t + 0.5 * h, v0, f_hz, a)
            end = _sum_of(t + h, v0, f_hz, a)
            derivative(x, now.real, now.imag, wind, p, k1)
            derivative(x + 0.5 * h * k1, mid.real, mid.imag, wind, p, k2)
            derivative(x + 0.5 * h * k2, mid.real, mid.imag, wind, p, k3)
            derivative(x + h * k3, end.real, end.imag, wind, p, k4)
            x += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            now = end
    return v, i


@dataclass(frozen=True)
class Stretch:
    """v and i as phase-peak space vectors (V, A; load direction), sampled at 10 kHz."""

    v: np.ndarray
    i: np.ndarray
    dt_s: float = 1e-4


@cache
def at_rest(f1_hz):
    """Parameters, equilibrium and wind (m/s) on a grid of this frequency (Hz)."""
    p = TABLE_I._replace(w1_rad_s=2.0 * np.pi * f1_hz)
    x, wind = oracle.equilibrium(POWER_W, VOLTAGE_V, p)
    return p, x, wind


def turbine(
    tones,
    *,
    f1_hz=49.97,
    settle_s=8.0,
    length_s=10.0,
    amplitude=0.01,
    background=(),
    drift=(0.0, 1.0),
    angle=0.3,
    dt_s=1e-4,
):
    """A stretch of the turbine at 0.65 MW under ``tones`` (Hz, signed, in phase quantities) of ``amplitude`` (pu).

    ``background`` are further lines (Hz, relative amplitude), ``drift`` the peak (Hz) and the period (s) of a
    sinusoidal wandering of the fundamental, ``angle`` its angle at the beginning (rad).
    """
    p, x, wind = at_rest(f1_hz)
    lines = [(f, amplitude * np.exp(1j * k)) for k, f in enumerate(tones)] + list(background)
    index = drift[0] * drift[1]  # a wandering frequency is a phase-modulated fundamental: lines J_n(index)
    lines += [(f1_hz + n / drift[1], jv(n, index)) for n in range(-12, 13) if n and index]
    f_hz = np.array([f - f1_hz for f, _ in lines])
    a = np.array([VOLTAGE_V * size for _, size in lines], dtype=complex)
    x = x.copy()
    before = round(settle_s / dt_s)
    integrate(x, wind, p, complex(VOLTAGE_V * jv(0, index)), f_hz, a, -settle_s, dt_s, STEPS, before)
    n = round(length_s / dt_s)
    v, i = integrate(x, wind, p, complex(VOLTAGE_V * jv(0, index)), f_hz, a, 0.0, dt_s, STEPS, n)
    turn = np.sqrt(2.0 / 3.0) * np.exp(1j * (2.0 * np.pi * f1_hz * dt_s * np.arange(n) + angle))
    return Stretch(v * turn, i * turn, dt_s)


def phases(x):
    """Three phases (n, 3) of a space vector, without a zero sequence."""
    return np.real(x[:, None] * np.exp(-2j * np.pi / 3.0 * np.arange(3)))


class Heard:
    """A stretch as the waveforms that `hear` reads."""

    def __init__(self, stretch, origin="", t0_s=0.0):
        self.stretch, self.dt_s, self.t0_s, self.origin = stretch, stretch.dt_s, t0_s, origin
        self.n_samples = len(stretch.v)

    def record(self, start, stop):
        s = self.stretch
        return Record(self.t0_s + start * self.dt_s, self.dt_s, s.v[start:stop], s.i[start:stop], np.nan)
