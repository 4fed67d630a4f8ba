"""Grid-forming inverters: droop and virtual synchronous machine behind an LC filter and a reactor. Per unit.

    Ta w' = P* - p - kd (w - w_pll) - kw (w - 1)    th' = wb (w - 1)    q_m' = wf (q - q_m)    V* = Vr + kq (Q* - q_m)
    v* = V* - (rv + j w lv) i_g        i* = kpv (v* - v) + kiv xi + j w cf v + kffi i_g              xi' = v* - v
    e = kpc (i* - i_c) + kic gam + j w lf i_c + kffv v - kad (v - phi)     gam' = i* - i_c     phi' = wad (v - phi)

Control in the frame of th; v at the capacitor; p = Re(v conj i_g). The PLL serves kd alone and is left out without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .linear import Bases, J, Linear, in_si, jacobian, pair, parallel, turned


@dataclass(frozen=True)
class Forming:
    """Parameters in pu; the defaults are a published virtual synchronous machine."""

    lf: float = 0.08
    rf: float = 0.003
    cf: float = 0.074
    lg: float = 0.2
    rg: float = 0.01
    kpv: float = 0.59
    kiv: float = 736.0
    kffv: float = 0.0
    kffi: float = 0.0
    rv: float = 0.0
    lv: float = 0.2
    kpc: float = 1.27
    kic: float = 14.3
    wad: float = 50.0
    kad: float = 0.2
    kq: float = 0.2
    wf: float = 1000.0
    ta: float = 2.0
    kd: float = 400.0
    kw: float = 20.0
    wlp: float = 500.0
    kpp: float = 0.084
    kip: float = 4.69
    p: float = 0.5
    q: float = 0.0
    v: float = 1.0


DROOP = {"kd": 0.0, "kw": 20.0, "ta": 1.0 / (0.05 * 2.0 * np.pi * 5.0)}
"""What makes the same equations a droop of 5 % with a power filter of 5 Hz."""

STIFF = {"lg": 0.1, "rg": 0.005, "lv": 0.0}
"""A bare transformer of 10 %: unstable on an ideal source."""


def linear_forming(g: Forming, bases: Bases) -> Linear:
    """The exact linearisation at the operating point of ``g``."""
    x, refs = _equilibrium(g)
    u = np.array([g.v, 0.0])

    def rhs(z: np.ndarray, w: np.ndarray) -> np.ndarray:
        return _rhs(z, w, g, refs, bases.w1)

    rest = np.abs(rhs(x, u)).max()
    if rest > 1e-7:
        raise AssertionError(f"the operating point is no equilibrium: {rest:.1e}")
    c = np.zeros((2, len(x)))
    c[0, 4], c[1, 5] = -1.0, -1.0
    return in_si(jacobian(lambda z: rhs(z, u), x), jacobian(lambda w: rhs(x, w), u), c, np.zeros((2, 2)), 0.0, bases)


def _rhs(z: np.ndarray, u: np.ndarray, g: Forming, refs: tuple[float, float, float], wb: float) -> np.ndarray:
    i_c, v, i_g, xi, gam, phi = (z[2 * k : 2 * k + 2] for k in range(6))
    th, w, q_m = z[12], z[13], z[14]
    p_ref, q_ref, v_r = refs
    v_, c_, g_ = turned(v, -th), turned(i_c, -th), turned(i_g, -th)
    p, q = v @ i_g, v[1] * i_g[0] - v[0] * i_g[1]
    v_ref = np.array([v_r + g.kq * (q_ref - q_m), 0.0]) - g.rv * g_ - w * g.lv * J @ g_
    i_ref = g.kpv * (v_ref - v_) + g.kiv * xi + w * g.cf * J @ v_ + g.kffi * g_
    e = g.kpc * (i_ref - c_) + g.kic * gam + w * g.lf * J @ c_ + g.kffv * v_ - g.kad * (v_ - phi)
    w_pll, d_pll = _pll(z[15:], v, g, wb)
    return np.concatenate(
        [
            wb / g.lf * (turned(e, th) - v - g.rf * i_c - g.lf * J @ i_c),
            wb / g.cf * (i_c - i_g - g.cf * J @ v),
            wb / g.lg * (v - u - g.rg * i_g - g.lg * J @ i_g),
            v_ref - v_,
            i_ref - c_,
            g.wad * (v_ - phi),
            np.array(
                [
                    wb * (w - 1.0),
                    (p_ref - p - g.kd * (w - w_pll) - g.kw * (w - 1.0)) / g.ta,
                    g.wf * (q - q_m),
                ]
            ),
            d_pll,
        ]
    )


def _pll(z: np.ndarray, v: np.ndarray, g: Forming, wb: float) -> tuple[complex, np.ndarray]:
    """Frequency (pu) that the PLL sees, and derivatives of its states (v_p, eps, th_p)."""
    if g.kd == 0.0:
        return 1.0, np.zeros(0)
    v_p, eps, th_p = z[0:2], z[2], z[3]
    a = v_p[1] / v_p[0]
    w_pll = 1.0 + g.kpp * a + g.kip * eps
    return w_pll, np.concatenate([g.wlp * (turned(v, -th_p) - v_p), np.array([a, wb * (w_pll - 1.0)])])


def _equilibrium(g: Forming) -> tuple[np.ndarray, tuple[float, float, float]]:
    i = np.conj((g.p + 1j * g.q) / g.v)
    v = g.v + (g.rg + 1j * g.lg) * i
    i_c = i + 1j * g.cf * v
    e = v + (g.rf + 1j * g.lf) * i_c
    inner = v + (g.rv + 1j * g.lv) * i
    th = float(np.angle(inner))
    v_, g_, c_, e_ = (x * np.exp(-1j * th) for x in (v, i, i_c, e))
    xi = (c_ - 1j * g.cf * v_ - g.kffi * g_) / g.kiv
    gam = (e_ - 1j * g.lf * c_ - g.kffv * v_) / g.kic
    s = v * np.conj(i)
    parts = [pair(x) for x in (i_c, v, i, xi, gam, v_)]
    parts += [np.array([th, 1.0, s.imag])]
    if g.kd != 0.0:
        parts += [np.array([abs(v), 0.0, 0.0, np.angle(v)])]
    return np.concatenate(parts), (s.real, s.imag, abs(inner))


def draw_forming(rng: np.random.Generator, bases: Bases) -> tuple[Linear, str, Forming | None]:
    """A random one and its parameters, or two different ones at the same terminals."""
    one, text, parameters = _draw_one(rng, bases)
    if rng.random() > 0.2:
        return one, text, parameters
    other, more, _ = _draw_one(rng, bases)
    return parallel(one, other), f"{text} beside {more}", None


def _draw_one(rng: np.random.Generator, bases: Bases) -> tuple[Linear, str, Forming]:
    def about(x: float, spread: float = 0.3) -> float:
        return float(x * np.exp(rng.uniform(-spread, spread)))

    droop = bool(rng.random() < 0.6)
    kind = {"kd": 0.0, "kw": about(20.0, 0.7), "ta": about(DROOP["ta"], 0.7)} if droop else {"ta": about(2.0)}
    lv = float(rng.choice([0.0, rng.uniform(0.05, 0.3)]))
    g = Forming(
        lf=about(0.08),
        cf=about(0.074),
        lg=float(np.exp(rng.uniform(np.log(0.05), np.log(0.3)))),
        rg=about(0.005, 0.7),
        kpv=about(0.59),
        kiv=about(736.0),
        lv=lv,
        kpc=about(1.27),
        kic=about(14.3),
        kad=about(0.2),
        kq=about(0.15, 0.7),
        p=rng.uniform(-0.5, 1.0),
        q=rng.uniform(-0.2, 0.2),
        v=rng.uniform(0.95, 1.05),
        **kind,
    )
    name = "droop" if droop else "VSM"
    return linear_forming(g, bases), f"{name}, lg {g.lg:.3f}, lv {lv:.2f}, P {g.p:.2f}", g
